//! Rank and parameter bounds.

use crate::design::result::{Designed, InformationLine, ParameterBound};
use dynocal_report::{Cell, Column, Details, Section, Table};

pub(super) fn section(found: &Designed) -> Section {
    let mut section = Section::new("Parameters").text(
        "Rank of the information of the record (with earlier records where they were given), and the least standard \
         deviation that any unbiased estimate of a parameter can have (Cramer-Rao).",
    );
    for i in &found.information {
        section = section.text(rank(i)).block(
            Details::new(format!("{}: bounds of {} parameters", i.model, i.parameters)).block(bounds(i)),
        );
    }
    section
}

fn rank(i: &InformationLine) -> String {
    if i.rank == i.parameters {
        return format!(
            "{}: rank {} of {}, every parameter can be estimated.",
            i.model, i.rank, i.parameters
        );
    }
    let unseen: Vec<String> = i
        .unseen
        .iter()
        .map(|d| d.iter().take(6).map(ToString::to_string).collect::<Vec<_>>().join(" "))
        .collect();
    format!("{}: rank {} of {}; not seen: {}.", i.model, i.rank, i.parameters, unseen.join("; "))
}

fn bounds(i: &InformationLine) -> Table {
    let mut table = Table::new(vec![
        Column::text("Regressor"),
        Column::number("Value", "").digits(4),
        Column::number("Standard deviation at least", "").digits(3),
        Column::number("Share of the value", "%").digits(3),
    ]);
    for ParameterBound { name, value, least_std: std } in &i.bounds {
        let share = std.filter(|_| *value != 0.0).map(|s| 100.0 * s / value.abs());
        table = table.row(vec![name.as_str().into(), (*value).into(), Cell::from(*std), Cell::from(share)]);
    }
    table
}
