//! Tables of the study `design`.

use crate::chapter4::work::statistics::median;
use dynocal_report::{Cell, Column, Report, Section, Table};

use super::cases::CASES;
use super::{Found, TaskResult, best, of};

pub(super) fn sections(report: Report, results: &[TaskResult]) -> Report {
    report.section(objectives(results)).section(certificates(results)).section(conditions(results))
}

fn objectives(results: &[TaskResult]) -> Section {
    let mut table = Table::new(vec![
        Column::text("Case"),
        Column::number("Interior point, median of 10", "").digits(6),
        Column::number("Median of single starts", "").digits(6),
        Column::number("Interior point, best of 10", "").digits(6),
        Column::number("Best of single starts", "").digits(6),
        Column::number("Best known", "").digits(6),
        Column::number("Long search", "").digits(6),
        Column::number("Evaluations of a single start", "").digits(5),
        Column::number("Evaluations of the long search", "").digits(7),
    ])
    .caption("Objective reached");
    for case in &CASES {
        let found = of(results, case);
        let shown = |f: &dyn Fn(&Found) -> Option<f64>| found.as_ref().and_then(f).map(|v| case.shown(v));
        let row: Vec<Cell> = vec![
            case.title().into(),
            case.median.into(),
            shown(&|f| median(&f.singles)).into(),
            case.best_of_ten.into(),
            shown(&|f| best(&f.singles)).into(),
            case.best_known.into(),
            shown(&|f| Some(f.long)).into(),
            found.as_ref().map(|f| f.evaluations.0 as f64 / f.singles.len() as f64).into(),
            found.as_ref().map(|f| f.evaluations.1 as f64).into(),
        ];
        table = table.row(row);
    }
    Section::new("Objectives")
        .text("Reading: convention trim (y(1..10) = 0, sums over t = 11..100), ABV as a fraction, U0 one APRBS of five levels. E is the least eigenvalue of the scaled information, larger being better; all others are minimised. Interior point: CasADi with IPOPT; best known: the lowest of its starts and of an independent iterated local search of 40 to 120 s per chain. For output limits the single starts have twice the default number of evaluations.")
        .block(table)
}

fn certificates(results: &[TaskResult]) -> Section {
    let mut table = Table::new(vec![
        Column::text("Case"),
        Column::number("J_D", "").digits(7),
        Column::number("No record below", "").digits(7),
        Column::number("Efficiency at least", "").digits(3),
        Column::number("Bound: part of past outputs", "").digits(3),
        Column::text("Why none"),
    ])
    .caption("Optimality certificates");
    for case in CASES.iter().filter(|c| c.certifiable()) {
        let found = of(results, case);
        let c = found.as_ref().and_then(|f| f.certificate);
        let row: Vec<Cell> = vec![
            case.title().into(),
            found.as_ref().map(|f| f.long).into(),
            c.map(|c| c[0]).into(),
            c.map(|c| c[1]).into(),
            c.map(|c| c[2]).into(),
            found.as_ref().and_then(|f| f.no_certificate.clone()).unwrap_or_default().into(),
        ];
        table = table.row(row);
    }
    Section::new("Certificates of D")
        .text("The bound is the D-optimal design measure over all regressor windows of the box (equivalence theorem), with the windows majorised by a finite set; past outputs count as free within the range that they can have, and their recursion by the largest eigenvalues of its gain. That neighbouring windows share samples, rates, and output limits are left out of the bound, so that the true efficiency is higher.")
        .block(table)
}

fn conditions(results: &[TaskResult]) -> Section {
    let mut table = Table::new(vec![
        Column::text("Case"),
        Column::number("Active pieces", ""),
        Column::number("Residual", "").digits(3),
        Column::number("Worst piece alone", "").digits(3),
        Column::number("Residual of a random record", "").digits(3),
    ])
    .caption("Optimality conditions of G and E");
    for case in CASES.iter().filter(|c| ["g", "e"].contains(&c.criterion)) {
        let found = of(results, case).and_then(|f| f.stationarity);
        let number = |k: usize| found.map(|(r, _)| r[k]);
        let row: Vec<Cell> = vec![
            case.title().into(),
            found.map(|(_, n)| n as f64).into(),
            number(0).into(),
            number(1).into(),
            number(2).into(),
        ];
        table = table.row(row);
    }
    Section::new("Optimality conditions")
        .text("Least norm of a convex combination of the gradients of ln J of all pieces within 1 % of the worst (for E: of a combination of its eigenvectors), per unit of range, after the bounds have taken what they can. Zero at a stationary record.")
        .block(table)
}
