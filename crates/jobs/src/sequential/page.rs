//! The page of a campaign.

use std::path::Path;

use dynocal_files::atomic;
use dynocal_ident::data::Role;
use dynocal_report::{Cell, Column, Panel, Report, Section, Table, TimePlot, render};

use super::result::{Sequenced, SequentialError};
use crate::page::PageError;

/// Most samples of a plot.
const DRAWN: usize = 5000;

/// Writes `report.html` into the run folder.
///
/// # Errors
/// [`SequentialError::Page`].
pub fn write(found: &Sequenced, folder: &Path) -> Result<(), SequentialError> {
    let html = render(&report(found)).map_err(PageError::from)?;
    atomic::write(&folder.join("report.html"), html.as_bytes())?;
    Ok(())
}

/// The page.
pub fn report(found: &Sequenced) -> Report {
    let mut report = Report::new(format!("Rounds of design and measurement: {}", found.name))
        .fact("Bed time [s]", format!("{:.0}", found.bed_s))
        .fact("Held-out record [s]", format!("{:.0}", found.held_out_s));
    report = report.verdict(found.verdict.as_str());
    for warning in &found.warnings {
        report = report.warning(warning.as_str());
    }
    report = report
        .section(Section::new("Errors").block(errors(found)))
        .section(Section::new("Rounds").block(rounds(found)))
        .section(held_out(found))
        .section(Section::new("Designed records").block(records(found)));
    for o in &found.outputs {
        let title = format!("Parameters of {}", o.output);
        let head = vec![
            Column::text("Parameter"),
            Column::number("Value", "").digits(5),
            Column::number("Standard error", "").digits(3),
            Column::number("After the first record", "").digits(3),
        ];
        let table = o.parameters.iter().fold(Table::new(head), |t, p| {
            let cells: Vec<Cell> =
                vec![p.name.as_str().into(), p.value.into(), p.std_error.into(), p.std_error_first.into()];
            t.row(cells)
        });
        report = report.section(Section::new(title).block(table));
    }
    report
}

fn errors(found: &Sequenced) -> Table {
    let head = vec![
        Column::text("Output"),
        Column::text("Unit"),
        Column::number("First record", "").digits(4),
        Column::number("With the designed records", "").digits(4),
        Column::number("With random records instead", "").digits(4),
    ];
    let table =
        Table::new(head).caption("RMS of the free-run error on the held-out record: no model was estimated from it, the stop rule reads it");
    found.outputs.iter().fold(table, |t, o| {
        let cells: Vec<Cell> = vec![
            o.output.as_str().into(),
            o.unit.as_str().into(),
            o.rmse_first.into(),
            o.rmse_designed.into(),
            o.rmse_random.into(),
        ];
        t.row(cells)
    })
}

fn rounds(found: &Sequenced) -> Table {
    let head = vec![
        Column::text("Round"),
        Column::text("Search"),
        Column::number("Criterion", "").digits(4),
        Column::number("Error before", "").digits(4),
        Column::number("Expected reduction", "%").digits(3),
        Column::text("Measured"),
    ];
    let caption = "Error before: RMS of the first output on the held-out record. Expected reduction: of its square, by the record of the round, before it was measured.";
    found.rounds.iter().fold(Table::new(head).caption(caption), |t, r| {
        let cells: Vec<Cell> = vec![
            r.round.to_string().into(),
            format!("{:?}", r.status).to_lowercase().into(),
            r.criterion.into(),
            r.rmse_before.into(),
            r.forecast.map(|f| 100.0 * f.relative).into(),
            (if r.measured { "yes" } else { "no: worth too little" }).into(),
        ];
        t.row(cells)
    })
}

fn held_out(found: &Sequenced) -> Section {
    let n = found.held_out.len().min(DRAWN);
    let mut plot = TimePlot::sampled("Held-out record", found.held_out.sample_time_s, n);
    for (o, y) in found.outputs.iter().zip(&found.computed) {
        let mut panel = Panel::new(o.output.as_str(), o.unit.as_str());
        if let Ok(z) = found.held_out.values(&o.output) {
            panel = panel.measured(z[..n].to_vec());
        }
        plot = plot.panel(panel.simulated(y[..n].to_vec()));
    }
    Section::new("Held-out record").text("Free run of the models from all records.").block(plot)
}

/// The first record and the designed ones, one after the other.
fn records(found: &Sequenced) -> TimePlot {
    let n: usize = found.records.iter().map(|r| r.len()).sum::<usize>().min(DRAWN);
    let dt = found.held_out.sample_time_s;
    let mut plot = TimePlot::sampled("First and designed records, joined", dt, n);
    let Some(first) = found.records.first() else { return plot };
    for c in &first.channels {
        let joined = found.records.iter().filter_map(|r| r.values(&c.name).ok());
        let values: Vec<f64> = joined.flat_map(|v| v.iter().copied()).take(n).collect();
        let panel = Panel::new(c.name.as_str(), c.unit.as_str());
        let shown = c.role == Role::Input || found.outputs.iter().any(|o| o.output == c.name);
        if shown {
            plot = plot.panel(match c.role {
                Role::Input => panel.held(c.name.as_str(), values),
                _ => panel.line(c.name.as_str(), values),
            });
        }
    }
    plot
}
