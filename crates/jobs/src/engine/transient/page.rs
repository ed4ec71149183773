//! The page of a record.

use dynocal_ident::data::Role;
use dynocal_report::{Block, Cell, Column, Panel, Report, Section, Table, TimePlot, significant};

use super::{Spec, Transient};

/// Most points of a plot.
const PLOTTED: usize = 4000;
/// Most events in the table.
const SHOWN: usize = 200;

/// The page.
pub fn report(spec: &Spec, found: &Transient) -> Report {
    let name = spec.file.file_stem().map(|n| n.to_string_lossy().into_owned()).unwrap_or_default();
    let mut report = Report::new(format!("Transient {name}"))
        .subtitle(found.bed.clone())
        .fact("Time [s]", significant(found.time_s.last().copied().unwrap_or(0.0), 5))
        .fact("Samples", found.time_s.len().to_string())
        .fact("Events", found.events.len().to_string());
    if let Some(stop) = &found.stop {
        report = report.warning(format!("the plan {stop}: a part of the record"));
    } else if found.interrupted {
        report = report.warning("interrupted: a part of the record");
    }
    report = report
        .section(Section::new("Outputs").block(plot(found, "Outputs", Role::Output)))
        .section(Section::new("Inputs").block(plot(found, "Inputs", Role::Input)));
    if found.events.is_empty() {
        return report;
    }
    let said =
        format!("Limits that were touched: {} in all, the first {SHOWN} are shown.", found.events.len());
    report.section(Section::new("Events").text(said).block(events(found)))
}

fn plot(found: &Transient, title: &str, role: Role) -> Block {
    let thin = found.time_s.len().div_ceil(PLOTTED).max(1);
    let thinned = |v: &[f64]| v.iter().copied().step_by(thin).collect::<Vec<f64>>();
    let mut plot = TimePlot::new(title, thinned(&found.time_s));
    for c in found.channels.iter().filter(|c| (c.role == Role::Input) == (role == Role::Input)) {
        let panel = Panel::new(c.name.clone(), c.unit.clone());
        plot = plot.panel(match role {
            Role::Input => panel.held(c.name.clone(), thinned(&c.values)),
            _ => panel.line(c.name.clone(), thinned(&c.values)),
        });
    }
    plot.into()
}

fn events(found: &Transient) -> Table {
    let columns = vec![
        Column::number("Time", "s"),
        Column::text("What"),
        Column::number("Value", ""),
        Column::number("Limit", ""),
    ];
    found.events.iter().take(SHOWN).fold(Table::new(columns), |table, e| {
        let cells: Vec<Cell> = vec![e.time_s.into(), e.what.clone().into(), e.value.into(), e.limit.into()];
        table.row(cells)
    })
}
