//! Measured against computed outputs, and how the errors are spread.

use std::path::Path;

use dynocal_files::dataset::read_table;
use dynocal_files::table::Cells;
use dynocal_ident::validate::{Kind, Seen};
use dynocal_report::{Axis, Block, Section, XyPlot};

use crate::identify::result::{Histogram, Identified, Modelled};
use crate::page::PageError;

/// Most points of a cloud.
const POINTS: usize = 3000;

/// The section: the last unseen part, else that of the estimation.
pub(super) fn section(found: &Identified, folder: &Path) -> Result<Section, PageError> {
    let mut section = Section::new("Agreement").text(
        "Free run against measurement: on the diagonal they agree. Errors of the free run (measured minus computed): a hump \
         beside zero is an offset, two humps are two regimes, long tails are single events.",
    );
    for m in found.models.iter().filter(|_| !found.records.is_empty()) {
        let part = part(found);
        let mut blocks: Vec<Block> = vec![cloud(found, folder, m, part)?.into()];
        let scored =
            found.scores.iter().find(|s| s.output == m.target && s.part == part && s.kind == Kind::FreeRun);
        if let Some(h) = scored.and_then(|s| s.histogram.as_ref()) {
            blocks.push(histogram(m, h).into());
        }
        section = section.columns(blocks);
    }
    Ok(section)
}

fn part(found: &Identified) -> &str {
    let unseen = found.records.iter().rev().find(|r| r.data == Seen::Unseen);
    unseen.or(found.records.first()).map_or("", |r| r.part.as_str())
}

fn cloud(found: &Identified, folder: &Path, m: &Modelled, part: &str) -> Result<XyPlot, PageError> {
    let (mut x, mut y) = (Vec::new(), Vec::new());
    for r in found.records.iter().filter(|r| r.part == part) {
        let table = read_table(&folder.join(&r.file), None)?;
        let column = |name: String| -> Result<Vec<f64>, PageError> {
            Ok(match &table.column(&name)?.cells {
                Cells::Number(v) => v.clone(),
                Cells::Text(v) => v.iter().map(|c| c.parse().unwrap_or(f64::NAN)).collect(),
            })
        };
        if table.column(&format!("{}_free_run", m.target)).is_err() {
            continue;
        }
        x.extend(column(format!("{}_measured", m.target))?);
        y.extend(column(format!("{}_free_run", m.target))?);
    }
    let each = x.len().div_ceil(POINTS).max(1);
    let thin = |v: &[f64]| v.iter().copied().step_by(each).collect::<Vec<f64>>();
    let finite = x.iter().filter(|v| v.is_finite());
    let (low, high) = finite.fold((f64::INFINITY, f64::NEG_INFINITY), |(a, b), v| (a.min(*v), b.max(*v)));
    let axis = |what: &str| Axis::new(format!("{} {what}", m.target), m.unit.as_str());
    let mut plot = XyPlot::new(format!("{}, {part}", m.target), axis("measured"), axis("free run")).points(
        "samples",
        thin(&x),
        thin(&y),
    );
    if low < high {
        plot = plot.line("agreement", vec![low, high], vec![low, high]);
    }
    if each > 1 {
        plot = plot.caption(format!("Every {each}th of {} samples.", x.len()));
    }
    Ok(plot)
}

/// Steps over the cells, from edge to edge.
fn histogram(m: &Modelled, h: &Histogram) -> XyPlot {
    let half = match h.centres[..] {
        [a, b, ..] => 0.5 * (b - a),
        _ => 0.5,
    };
    let edges: Vec<f64> = h.centres.iter().flat_map(|c| [c - half, c + half]).collect();
    let counts: Vec<f64> = h.counts.iter().flat_map(|n| [*n as f64; 2]).collect();
    let axis = Axis::new(format!("error of {}", m.target), m.unit.as_str());
    XyPlot::new("Errors of the free run", axis, Axis::new("Samples", ""))
        .band("samples", edges.clone(), vec![0.0; edges.len()], counts.clone())
        .line("", edges, counts)
}
