//! The page of a simulation.

use std::path::Path;

use dynocal_files::atomic;
use dynocal_ident::data::Role;
use dynocal_report::{Cell, Column, Panel, Report, Section, Table, TimePlot, render};

use super::result::{Output, Simulated};
use crate::page::PageError;

/// Most samples of a plot.
const DRAWN: usize = 5000;

/// Writes `report.html` into the run folder.
///
/// # Errors
/// [`PageError`].
pub fn write(found: &Simulated, folder: &Path) -> Result<(), PageError> {
    atomic::write(&folder.join("report.html"), render(&report(found))?.as_bytes())?;
    Ok(())
}

/// The page.
pub fn report(found: &Simulated) -> Report {
    let mut report = Report::new(format!("Simulation: {}", found.name));
    for warning in &found.warnings {
        report = report.warning(warning.as_str());
    }
    report = report.section(numbers(found));
    let mut names: Vec<&str> = found.outputs.iter().map(|o| o.record.as_str()).collect();
    names.dedup();
    for name in names {
        report = report.section(record(found, name));
    }
    report
}

fn numbers(found: &Simulated) -> Section {
    let head = vec![
        Column::text("Record"),
        Column::text("Output"),
        Column::text("Unit"),
        Column::number("Samples", ""),
        Column::number("Least", "").digits(4),
        Column::number("Greatest", "").digits(4),
        Column::number("RMSE to measured", "").digits(4),
    ];
    let row = |o: &Output| {
        vec![
            Cell::from(o.record.as_str()),
            o.output.as_str().into(),
            o.unit.as_str().into(),
            (o.samples as f64).into(),
            Cell::from(o.range.map(|r| r.lower)),
            Cell::from(o.range.map(|r| r.upper)),
            Cell::from(o.rmse),
        ]
    };
    Section::new("Outputs").block(found.outputs.iter().fold(Table::new(head), |t, o| t.row(row(o))))
}

/// Outputs over time, and the inputs where the record is as it was read.
fn record(found: &Simulated, name: &str) -> Section {
    let outputs: Vec<&Output> = found.outputs.iter().filter(|o| o.record == name).collect();
    let Some(first) = outputs.first() else { return Section::new(name) };
    let n = first.samples.min(DRAWN);
    let cut = |v: &[f64]| v[..v.len().min(n)].to_vec();
    let mut plot = TimePlot::sampled(name, first.sample_time_s, n);
    for o in outputs.iter().filter(|o| o.samples == first.samples) {
        let mut panel = Panel::new(o.output.as_str(), o.unit.as_str());
        if let Some(z) = &o.measured {
            panel = panel.measured(cut(z));
        }
        plot = plot.panel(panel.simulated(cut(&o.y)));
    }
    let read = found.records.iter().find(|d| d.name == name && d.len() == first.samples);
    for c in read.iter().flat_map(|d| &d.channels).filter(|c| c.role == Role::Input) {
        plot = plot.panel(Panel::new(c.name.as_str(), c.unit.as_str()).held(c.name.as_str(), cut(&c.values)));
    }
    if n < first.samples {
        plot = plot.caption(format!(
            "The first {n} of {} samples; all are in the file of the record.",
            first.samples
        ));
    }
    Section::new(name).block(plot)
}
