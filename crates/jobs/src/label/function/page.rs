//! The page of a fitted function.

use std::path::Path;

use dynocal_files::atomic;
use dynocal_label::linear::Verdict;
use dynocal_report::{Axis, Cell, Column, Report, Section, Table, XyPlot, render};

use super::work::Fitted;
use crate::page::PageError;

/// Most points of a plot.
const DRAWN: usize = 4000;

/// Writes `report.html` into the run folder.
///
/// # Errors
/// [`PageError`].
pub fn write(found: &Fitted, folder: &Path) -> Result<(), PageError> {
    atomic::write(&folder.join("report.html"), render(&report(found))?.as_bytes())?;
    Ok(())
}

fn report(found: &Fitted) -> Report {
    let mut report = Report::new(format!("Labels: {}", found.name));
    for text in &found.verdict {
        report = report.verdict(text.as_str());
    }
    for text in &found.fit.held {
        report = report.warning(format!("the fit is held by a limit: {text}"));
    }
    report.section(cells(found)).section(plot(found))
}

fn cells(found: &Fitted) -> Section {
    let head = vec![
        Column::text("Label"),
        Column::text("Unit"),
        Column::text("Cell"),
        Column::number("Before", ""),
        Column::number("Fitted", ""),
        Column::number("Half width, 95 %", ""),
        Column::number("Independent measurements", "").digits(3),
        Column::text("Verdict"),
    ];
    let mut table = Table::new(head);
    let mut at = 0;
    for l in &found.labels {
        let nx = l.axes.first().map_or(1, |a| a.points.len());
        for k in 0..l.len() {
            let place = match l.axes.as_slice() {
                [] => "-".to_string(),
                [x] => format!("{}", x.points[k]),
                [x, y, ..] => format!("{}, {}", x.points[k % nx], y.points[k / nx]),
            };
            let verdict = match found.fit.verdicts[at] {
                Verdict::Determined => "determined",
                Verdict::Pulled => "pulled by neighbours or base",
                Verdict::Untouched => "untouched",
                Verdict::Locked => "locked",
            };
            table = table.row(vec![
                Cell::from(l.name.as_str()),
                l.unit.as_str().into(),
                place.into(),
                l.base[k].into(),
                found.fit.values[at].into(),
                Cell::from(found.half_width[at]),
                found.fit.facts[at].into(),
                verdict.into(),
            ]);
            at += 1;
        }
    }
    Section::new("Labels").block(table)
}

fn plot(found: &Fitted) -> Section {
    let [time, target, function] = &found.drawn;
    let every = time.len().div_ceil(DRAWN).max(1);
    let thin = |v: &[f64]| v.iter().copied().step_by(every).collect::<Vec<f64>>();
    Section::new("Function").text("Of the first record, masked samples included.").block(
        XyPlot::new(found.target.as_str(), Axis::new("Time", "s"), Axis::new(found.target.as_str(), ""))
            .line("measured", thin(time), thin(target))
            .line("function", thin(time), thin(function)),
    )
}
