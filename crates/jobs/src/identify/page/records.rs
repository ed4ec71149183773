//! Measured and simulated outputs over time.

use std::path::Path;

use crate::identify::result::{Identified, RecordFile};
use dynocal_files::dataset::read_table;
use dynocal_files::table::{Cells, Table as Record};
use dynocal_ident::validate::Seen;
use dynocal_report::{Panel, Section, TimePlot};

use crate::page::PageError;

/// Most records that are drawn: the others are in the run folder, and a page must stay light.
const DRAWN: usize = 6;
/// Most samples of a record that are drawn.
const SAMPLES: usize = 6000;
/// Most inputs and outputs that are drawn of a record.
const PANELS: usize = 8;

/// The section: unseen records first, those of the estimation where there are no others.
pub(super) fn section(found: &Identified, folder: &Path) -> Result<Section, PageError> {
    let unseen = found.records.iter().any(|r| r.data == Seen::Unseen);
    let wanted = if unseen { Seen::Unseen } else { Seen::Identification };
    let title = if unseen { "Unseen records" } else { "Records of the estimation" };
    let mut section =
        Section::new(title).text("Measured output and free run, started from measured values only.");
    if found.records.is_empty() {
        section = section.text("The spec keeps no records: there is nothing to draw.");
    }
    for r in drawn(found, wanted) {
        section.push(plot(found, &read_table(&folder.join(&r.file), None)?, r)?);
    }
    Ok(section)
}

/// Records to draw: some of every part.
fn drawn(found: &Identified, wanted: Seen) -> Vec<&RecordFile> {
    let mut parts: Vec<&str> = Vec::new();
    for r in found.records.iter().filter(|r| r.data == wanted) {
        if !parts.contains(&r.part.as_str()) {
            parts.push(&r.part);
        }
    }
    let each = (DRAWN / parts.len().max(1)).max(1);
    let of = |part: &&str| {
        let part = part.to_string();
        found.records.iter().filter(move |r| r.data == wanted && r.part == part).take(each)
    };
    parts.iter().flat_map(of).collect()
}

fn plot(found: &Identified, record: &Record, r: &RecordFile) -> Result<TimePlot, PageError> {
    let rows = record.rows().min(SAMPLES);
    let column = |name: &str| -> Result<Vec<f64>, PageError> {
        let cells = &record.column(name)?.cells;
        // A free run that diverged is drawn as far as it goes.
        Ok(match cells {
            Cells::Number(v) => v[..rows].to_vec(),
            Cells::Text(v) => v[..rows].iter().map(|c| c.parse().unwrap_or(f64::NAN)).collect(),
        })
    };
    let unit = |name: &str| -> Result<String, PageError> {
        Ok(record.column(name)?.unit.as_ref().map_or_else(|| "-".to_string(), |u| u.0.clone()))
    };
    let mut plot = TimePlot::new(format!("{}: {}", r.part, r.record), column("time")?);
    let mut held: Vec<String> = Vec::new();
    if rows < record.rows() {
        held.push(format!("First {rows} of {} samples.", record.rows()));
    }
    for m in found.models.iter().take(PANELS) {
        let measured = format!("{}_measured", m.target);
        let free = format!("{}_free_run", m.target);
        let mut panel = Panel::new(m.target.as_str(), unit(&measured)?);
        let [low, high] = ["low", "high"].map(|side| format!("{}_{side}", m.target));
        if record.column(&low).is_ok() && record.column(&high).is_ok() {
            let label = format!("{:.0} % band", 100.0 * found.confidence);
            let (low, high) = (column(&low)?, column(&high)?);
            held.extend(inside(&column(&measured)?, &low, &high).map(|share| {
                format!("The {label} of {} holds {:.0} % of these samples.", m.target, 100.0 * share)
            }));
            panel = panel.band(label, low, high);
        }
        panel = panel.measured(column(&measured)?);
        if record.column(&free).is_ok() {
            panel = panel.simulated(column(&free)?);
        }
        plot = plot.panel(panel);
        if record.column(&free).is_ok() {
            let errors: Vec<f64> =
                column(&measured)?.iter().zip(column(&free)?).map(|(z, y)| z - y).collect();
            plot = plot
                .panel(Panel::new(format!("error of {}", m.target), unit(&measured)?).line("error", errors));
        }
    }
    let mut inputs: Vec<&String> = Vec::new();
    for name in found.models.iter().flat_map(|m| &m.inputs) {
        if !inputs.contains(&name) && record.column(name).is_ok() {
            inputs.push(name);
        }
    }
    for input in inputs.into_iter().take(PANELS.saturating_sub(found.models.len()).max(2)) {
        plot = plot.panel(Panel::new(input.as_str(), unit(input)?).line(input.as_str(), column(input)?));
    }
    Ok(plot.caption(held.join(" ")))
}

/// Share of the measured samples that lie in a band; none where there is no band.
fn inside(measured: &[f64], low: &[f64], high: &[f64]) -> Option<f64> {
    let all = measured.iter().zip(low.iter().zip(high));
    let known: Vec<bool> = all
        .filter(|(z, (l, h))| z.is_finite() && l.is_finite() && h.is_finite() && l < h)
        .map(|(z, (l, h))| l <= z && z <= h)
        .collect();
    let held = known.iter().filter(|in_it| **in_it).count();
    (!known.is_empty()).then(|| held as f64 / known.len() as f64)
}
