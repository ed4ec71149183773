//! The page of a record.

use dynocal_ident::data::Role;
use dynocal_report::{Block, Cell, Column, Panel, Report, Section, Table, TimePlot, significant};

use super::events::{EventGroup, grouped};
use super::{Spec, Transient};

/// Most stretches in the table.
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
    let groups = grouped(&found.events, &found.trips);
    let shown = if groups.len() > SHOWN { format!(", the first {SHOWN} are shown") } else { String::new() };
    let said = format!(
        "Limits that were touched: {} events in {} stretches of time{shown}.",
        found.events.len(),
        groups.len()
    );
    report.section(Section::new("Events").text(said).block(events(&groups)))
}

fn plot(found: &Transient, title: &str, role: Role) -> Block {
    let mut plot = TimePlot::new(title, found.time_s.clone());
    for c in found.channels.iter().filter(|c| (c.role == Role::Input) == (role == Role::Input)) {
        let panel = Panel::new(c.name.clone(), c.unit.clone());
        plot = plot.panel(match role {
            Role::Input => panel.held(c.name.clone(), c.values.clone()),
            _ => panel.line(c.name.clone(), c.values.clone()),
        });
    }
    plot.into()
}

fn events(groups: &[EventGroup]) -> Table {
    let columns = vec![
        Column::text("What"),
        Column::number("From", "s"),
        Column::number("To", "s"),
        Column::number("Events", ""),
        Column::number("Limit", ""),
        Column::number("Worst at an event", ""),
    ];
    groups.iter().take(SHOWN).fold(Table::new(columns), |table, g| {
        let cells: Vec<Cell> = vec![
            g.what.clone().into(),
            g.from_s.into(),
            g.to_s.into(),
            g.count.into(),
            g.limit.into(),
            g.worst.into(),
        ];
        table.row(cells)
    })
}
