//! Composite designs for both outputs: Tables 4.16 to 4.18.

use crate::chapter4::work::population::{Population, VALIDATION};
use crate::chapter4::work::published::tables::TABLE_4_16;
use crate::chapter4::work::source::{DesignCriterion, Source};
use crate::chapter4::work::{Output, published};
use dynocal_report::{Cell, Column, Section, Table};

use super::{LAMBDA_NOISE, TORQUE_NOISE, label, of, with_error};

pub(super) fn weights(all: &[Population]) -> Section {
    let mut table = Table::new(vec![
        Column::text("Criterion"),
        Column::number("w1: thesis", "").digits(5),
        Column::number("ours", "").digits(5),
        Column::number("SE", "").digits(2),
        Column::number("w2: thesis", "").digits(5),
        Column::number("ours", "").digits(5),
        Column::number("SE", "").digits(2),
    ])
    .caption(
        "Table 4.16: weights w1 = v(lambda) of torque and w2 = 2 v(torque) of lambda, v of UDRN signals",
    );
    for (criterion, thesis) in [DesignCriterion::D, DesignCriterion::Ai].into_iter().zip(TABLE_4_16) {
        let v = |output| of(all, Source::Udrn).and_then(|p| p.criterion(output, criterion));
        // The printed torque criterion of AI is in thousands.
        let unit = if criterion == DesignCriterion::Ai { 1e-3 } else { 1.0 };
        let cells = |s: Option<f64>, se: Option<f64>, thesis: f64| [Cell::from(thesis), s.into(), se.into()];
        let (lambda, torque) = (v(Output::Lambda), v(Output::Torque));
        let w1 = cells(lambda.map(|s| s.mean.abs()), lambda.map(|s| s.se), thesis[0]);
        let doubled = |x: f64| 2.0 * unit * x.abs();
        let w2 = cells(torque.map(|s| doubled(s.mean)), torque.map(|s| doubled(s.se)), thesis[1]);
        let head = [Cell::from(criterion.name().to_uppercase())];
        table = table.row(head.into_iter().chain(w1).chain(w2).collect::<Vec<_>>());
    }
    Section::new("Weights of the composite designs").id("weights").text(
        "Eq. (4.54): each criterion is weighted with the other's value for a white-noise signal, lambda counted twice. The thesis has one signal; ours are means of the population.",
    )
    .block(table)
}

pub(super) fn scores(all: &[Population]) -> Section {
    let mut section = Section::new("Composite designs for both outputs").id("mimo").text(
        "Reading: e is the mean over the parameters of |estimate - true| / |true| (eq. 4.37 prints a sum). Weights of Table 4.16, the torque criterion of AI in thousands: with the printed pair the two terms do not balance otherwise. Reference: an independent implementation, 10 signals.",
    );
    for (output, noise, caption) in [
        (Output::Torque, TORQUE_NOISE, "Table 4.17: torque models"),
        (Output::Lambda, LAMBDA_NOISE, "Table 4.18: lambda models"),
    ] {
        let mut columns = vec![
            Column::text("Model"),
            Column::number("e: thesis", "").digits(3),
            Column::number("ours (SE)", ""),
            Column::number("reference", "").digits(3),
        ];
        for kind in VALIDATION {
            columns.push(Column::number(format!("{}: thesis", label(kind)), "%").digits(4));
            columns.push(Column::number("ours (SE)", "%"));
            columns.push(Column::number("reference", "%").digits(3));
        }
        let mut table = Table::new(columns).caption(caption);
        for row in published::MIMO.iter().filter(|r| r.output == output) {
            table = table.row(row_of(all, row, noise));
        }
        section = section.block(table);
    }
    section
}

fn row_of(all: &[Population], row: &published::Mimo, noise: f64) -> Vec<Cell> {
    let population = of(all, row.source);
    let e = population.and_then(|p| p.parameter_error(row.output, noise));
    let mut cells: Vec<Cell> = vec![
        label(row.source).into(),
        row.error.0.into(),
        with_error(e.map(|s| (s.mean, s.se)), 2),
        row.error.1.into(),
    ];
    for (k, kind) in VALIDATION.into_iter().enumerate() {
        let score = population.and_then(|p| p.score(row.output, noise, kind));
        cells.extend([
            row.thesis[k].into(),
            with_error(score.map(|s| (s.r2, s.se)), 1),
            Cell::from(row.reference[k]),
        ]);
    }
    cells
}
