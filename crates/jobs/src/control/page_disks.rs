//! Disk margins on the page of a control job.

use dynocal_control::disk::DiskMargin;
use dynocal_report::{Cell, Column, Section, Table};

use super::result::{Controlled, Together};

/// The section.
pub(super) fn section(found: &Controlled) -> Section {
    let head = vec![
        Column::text("Set point"),
        Column::text("Where"),
        Column::text("Of"),
        Column::number("alpha guaranteed", "").digits(5),
        Column::number("alpha lost", "").digits(5),
        Column::number("All gains from", "").digits(4),
        Column::number("to", "").digits(4),
        Column::number("All phases", "deg").digits(4),
        Column::number("At", "rad/s").digits(4),
    ];
    let several = found.loops.len() > 1;
    let table = found.together.iter().flat_map(|t| rows(t, several)).fold(Table::new(head), Table::row);
    let title = if several { "All loops at once" } else { "Disk margins" };
    Section::new(title)
        .text("Disk margins: every loop may change its gain or its phase at once, each in its own way; a loop alone has the others closed. Balanced takes S and T alike, the others S or T alone: their gains reach further up or down. Guaranteed is what the upper bound of the structured singular value leaves on the frequencies that were looked at; lost is where a perturbation that was found makes the loop unstable. The truth lies between.")
        .block(table)
}

fn rows(t: &Together, several: bool) -> Vec<Vec<Cell>> {
    let places = [("inputs", &t.inputs), ("outputs", &t.outputs), ("inputs and outputs", &t.both)];
    let balanced = places
        .into_iter()
        .filter(|(name, _)| several || *name == "outputs")
        .filter_map(|(name, d)| Some(row(t, name, d.as_ref()?)));
    balanced.chain(t.other_disks.iter().map(|(name, d)| row(t, name, d))).collect()
}

fn row(t: &Together, place: &str, d: &DiskMargin) -> Vec<Cell> {
    let of = if d.skew > 0.0 {
        "S"
    } else if d.skew < 0.0 {
        "T"
    } else {
        "balanced"
    };
    vec![
        Cell::from(t.point.as_str()),
        place.into(),
        of.into(),
        d.alpha.into(),
        d.alpha_lost.into(),
        d.gain_down.into(),
        Cell::from(d.gain_up),
        d.phase_deg.into(),
        d.peak_rad_s.into(),
    ]
}
