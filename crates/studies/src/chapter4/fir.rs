//! Example 1 and Table 4.2.

use crate::chapter4::work::Size;
use crate::chapter4::work::fir::{Rows, bound, search, udrn, variances};
use crate::chapter4::work::published;
use crate::chapter4::work::published::tables::TABLE_4_2;
use crate::chapter4::work::statistics::Stat;
use dynocal_report::{Cell, Column, Section, Table};
use serde::{Deserialize, Serialize};
use serde_json::json;

use super::{Asked, Check, Surroundings, Task, TaskResult, check, result};

const NAME: &str = "example-1";
/// Starts of the flip search.
const STARTS: usize = 8;

/// One reading of the example.
#[derive(Serialize, Deserialize)]
struct Reading {
    best: f64,
    bound: f64,
    variances: [f64; 3],
    udrn: Option<Stat>,
    udrn_variances: Vec<Option<Stat>>,
}

pub(super) fn task(size: Size) -> Task {
    let (n, seed) = (size.identification, size.seed);
    let of = move |rows| {
        let random = udrn(rows, n, seed);
        let (u, best) = search(rows, STARTS, seed);
        let column = |k: usize| Stat::of(&random.iter().map(|v| v[k]).collect::<Vec<f64>>());
        Reading {
            best,
            bound: bound(rows),
            variances: variances(&u, rows),
            udrn: Stat::of(&random.iter().map(|v| v.iter().sum()).collect::<Vec<f64>>()),
            udrn_variances: (0..3).map(column).collect(),
        }
    };
    Task {
        name: NAME.into(),
        inputs: json!({ "seed": seed, "starts": STARTS, "udrn": n }),
        run: Box::new(move |_: &Surroundings| Ok(json!([of(Rows::Trim), of(Rows::Zero)]))),
    }
}

const READINGS: [&str; 2] = ["rows 4 to 100", "rows 1 to 100, zeros before"];

fn readings(results: &[TaskResult]) -> Vec<Option<Reading>> {
    let found: Option<Vec<Reading>> = result(results, NAME);
    let mut found = found.into_iter().flatten();
    READINGS.iter().map(|_| found.next()).collect()
}

pub(super) fn checks(results: &[TaskResult]) -> Vec<Check> {
    let found = readings(results);
    (0..2)
        .map(|k| {
            let best = found[k].as_ref().map(|r| r.best);
            let limit = found[k].as_ref().map_or(f64::NAN, |r| r.bound);
            check(
                format!("example-1-{}", k + 1),
                format!("Example 1, {}: J_A against the best known, relative", READINGS[k]),
                Asked::AtMost(1e-9),
                best.map(|b| b / published::FIR_BEST[k] - 1.0),
                "",
                format!(
                    "J_A {:.7e}, bound {limit:.7e}, thesis {:.2e}",
                    best.unwrap_or(f64::NAN),
                    published::FIR_THESIS[1]
                ),
            )
        })
        .collect()
}

pub(super) fn section(results: &[TaskResult]) -> Section {
    let found = readings(results);
    let mut table = Table::new(vec![
        Column::text("Variance of"),
        Column::number("Thesis UDRN", "").digits(3),
        Column::number("UDRN mean", "").digits(3),
        Column::number("SE", "").digits(2),
        Column::number("Thesis optimal", "").digits(3),
        Column::number("Optimal", "").digits(4),
    ])
    .caption("Table 4.2: variances of the parameters, rows 4 to 100");
    for k in 0..3 {
        let random = found[0].as_ref().and_then(|r| r.udrn_variances.get(k).copied().flatten());
        table = table.row([
            Cell::from(format!("theta {}", k + 1)),
            TABLE_4_2[0][k].into(),
            random.map(|s| s.mean).into(),
            random.map(|s| s.se).into(),
            TABLE_4_2[1][k].into(),
            found[0].as_ref().map(|r| r.variances[k]).into(),
        ]);
    }
    Section::new("Example 1: a linear system")
        .id("example-1")
        .text("A finite impulse response with three taps (4.29), |u| at most 10, 100 samples, noise variance 1. The bound holds for every input within the amplitude; the thesis' optimum lies 5 % above it. A search over binary inputs, by flips of one and of two samples.")
        .block(table)
        .block(sums(&found))
}

fn sums(found: &[Option<Reading>]) -> Table {
    let mut table = Table::new(vec![
        Column::text("Rows"),
        Column::number("Thesis UDRN", "").digits(3),
        Column::number("UDRN mean", "").digits(3),
        Column::number("SE", "").digits(2),
        Column::number("Thesis optimal", "").digits(3),
        Column::number("Ours", "").digits(8),
        Column::number("Bound", "").digits(8),
    ])
    .caption("J_A, the sum of the variances, under two readings of the rows");
    for (reading, name) in found.iter().zip(READINGS) {
        let udrn = reading.as_ref().and_then(|r| r.udrn);
        table = table.row([
            Cell::from(name),
            published::FIR_THESIS[0].into(),
            udrn.map(|s| s.mean).into(),
            udrn.map(|s| s.se).into(),
            published::FIR_THESIS[1].into(),
            reading.as_ref().map(|r| r.best).into(),
            reading.as_ref().map(|r| r.bound).into(),
        ]);
    }
    table
}
