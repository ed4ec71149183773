//! Steps of the preparation, each with the record before and after it.

use std::path::Path;

use crate::identify::result::{Identified, Stage};
use dynocal_files::csv_io;
use dynocal_files::table::{Cells, Table as Record};
use dynocal_report::{Axis, Block, Details, Section, XyPlot};

use crate::page::PageError;

/// Most channels that are drawn of a step.
const CHANNELS: usize = 4;
/// Most sentences that are shown at once.
const SENTENCES: usize = 12;

/// The section; none where nothing was prepared.
pub(super) fn section(found: &Identified, folder: &Path) -> Result<Option<Section>, PageError> {
    let Some(first) = found.preparation.first() else { return Ok(None) };
    let mut section = Section::new("Preparation").text(
        "What was done to the records before the fit, in this order. Means and scales are those of the estimation \
         records, for all parts. The plots show the first estimation record before and after each step; the files on \
         disk are as they were.",
    );
    for (k, note) in first.notes.iter().enumerate() {
        section = section.heading(format!("{}. {}", k + 1, note.step));
        let sizes = format!(
            "{} records with {} samples before, {} with {} after.",
            note.before.records, note.before.samples, note.after.records, note.after.samples
        );
        section = section.text(sizes);
        for part in &found.preparation {
            let Some(note) = part.notes.get(k) else { continue };
            section.push(sentences(&part.part, &note.sentences()));
        }
        if let (Some(before), Some(after)) = (first.stages.get(k), first.stages.get(k + 1)) {
            let (a, b) = (read(folder, before)?, read(folder, after)?);
            let named: Vec<&String> = note.changes.iter().filter_map(|c| c.channel.as_ref()).collect();
            let plots = plots(&a, &b, &named);
            for pair in plots.chunks(2) {
                section = section.columns(pair.to_vec());
            }
        }
    }
    Ok(Some(section))
}

fn sentences(part: &str, all: &[String]) -> Block {
    let shown = all.iter().take(SENTENCES).map(|s| format!("{part}: {s}")).collect::<Vec<_>>().join("\n");
    if all.len() <= SENTENCES {
        return Block::Paragraph {
            text: if all.is_empty() { format!("{part}: nothing to do") } else { shown },
        };
    }
    let text = all.iter().map(|s| format!("{part}: {s}")).collect::<Vec<_>>().join("\n");
    Details::new(format!("{part}: {} changes", all.len())).block(Block::Paragraph { text }).into()
}

fn read(folder: &Path, stage: &Stage) -> Result<Record, PageError> {
    Ok(csv_io::read(&folder.join(&stage.file))?)
}

fn numbers(record: &Record, name: &str) -> Option<Vec<f64>> {
    match &record.column(name).ok()?.cells {
        Cells::Number(v) => Some(v.clone()),
        Cells::Text(v) => Some(v.iter().map(|c| c.parse().unwrap_or(f64::NAN)).collect()),
    }
}

/// The channels that the step names, or the first ones.
fn plots(before: &Record, after: &Record, named: &[&String]) -> Vec<Block> {
    let wanted = |name: &str| named.is_empty() || named.iter().any(|n| *n == name);
    let columns = before.columns.iter().filter(|c| c.name != "time" && wanted(&c.name));
    let mut out = Vec::new();
    for c in columns.take(CHANNELS) {
        let (Some(t0), Some(v0)) = (numbers(before, "time"), numbers(before, &c.name)) else { continue };
        let unit = |r: &Record| r.column(&c.name).ok().and_then(|c| c.unit.as_ref().map(|u| u.0.clone()));
        let y = Axis::new(c.name.as_str(), unit(before).unwrap_or_else(|| "-".into()));
        let mut plot = XyPlot::new(c.name.as_str(), Axis::new("Time", "s"), y).line("before", t0, v0);
        if let (Some(t1), Some(v1)) = (numbers(after, "time"), numbers(after, &c.name)) {
            let label = if unit(before) == unit(after) {
                "after".to_string()
            } else {
                format!("after [{}]", unit(after).unwrap_or_else(|| "-".into()))
            };
            plot = plot.line(label, t1, v1);
        }
        out.push(plot.into());
    }
    out
}
