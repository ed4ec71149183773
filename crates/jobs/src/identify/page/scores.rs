//! Fit numbers: one table for each target; rows of different kinds of output stay apart.

use crate::identify::result::{Identified, Score};
use dynocal_ident::validate::Kind;
use dynocal_report::{Cell, Column, Section, Table};

/// What was compared with the measurement.
pub fn kind_text(kind: Kind) -> String {
    match kind {
        Kind::OneStep => "one step".into(),
        Kind::KStep(k) => format!("{k} steps"),
        Kind::FreeRun => "free run".into(),
    }
}

/// The section.
pub(super) fn section(found: &Identified) -> Section {
    let text = if found.steady { POINTS } else { SAMPLES };
    let mut section = Section::new("Fit").text(text);
    for m in &found.models {
        let own: Vec<&Score> = found.scores.iter().filter(|s| s.output == m.target).collect();
        section.push(table(&m.target, &m.unit, &own, found.steady));
    }
    section
}

const SAMPLES: &str = "Errors in the unit of the output, over all scored samples of all records of a part together. One step: predicted \
     from measured outputs up to the sample before; k steps: from measured outputs up to k samples before; free run: \
     from the model's own outputs.";
const POINTS: &str = "Errors in the unit of the output over all points of a part, each predicted from its inputs alone. Those of \
                      the estimation flatter the model, which has seen them.";

fn table(target: &str, unit: &str, scores: &[&Score], steady: bool) -> Table {
    let band = scores.iter().find_map(|s| s.band);
    let mut columns = vec![
        Column::text("Data"),
        Column::text("Output"),
        Column::number("Records", "-"),
        Column::number("Samples", "-"),
        Column::number("RMSE", unit),
        Column::number("95 % within", unit),
    ];
    if let Some(half) = band {
        columns.push(Column::number(format!("Within ±{half} {unit}"), "%"));
    }
    columns.push(Column::number("R2", "%"));
    columns.push(Column::number("NRMSE fit", "%"));
    let mut out = Table::new(columns).caption(target);
    for s in scores {
        let number = |x: Option<f64>| x.map_or(Cell::from("diverged"), Cell::from);
        let mut row: Vec<Cell> = vec![
            s.part.as_str().into(),
            format!(
                "{}{}",
                if steady { "each point".into() } else { kind_text(s.kind) },
                if s.outside { " (useless: far outside)" } else { "" }
            )
            .into(),
            s.records.into(),
            s.samples.into(),
            number(s.rmse),
            number(s.error_95),
        ];
        if band.is_some() {
            row.push(s.in_band_percent.into());
        }
        row.push(number(s.r2_percent));
        row.push(number(s.nrmse_fit_percent));
        out = out.row(row);
    }
    out
}
