//! Objective values: Tables 4.3, 4.6 and 4.9.

use crate::chapter4::work::Output;
use crate::chapter4::work::population::{DESIGNED, Population, VALIDATION};
use crate::chapter4::work::published;
use crate::chapter4::work::published::tables::TABLE_4_3;
use crate::chapter4::work::source::{DesignCriterion, Source};
use dynocal_report::{Cell, Column, Panel, Section, Table, TimePlot};

use super::{Asked, Check, SAMPLE_S, check, label, of};

/// One start per design: what a user gets from one run.
pub(super) fn checks(all: &[Population]) -> Vec<Check> {
    let one = |row: &published::Objective| {
        let found = of(all, Source::Design(row.criterion));
        let best = found.and_then(|p| p.best_of_ten).map_or("none".into(), |b| format!("{b:.6}"));
        let name = row.criterion.name();
        check(
            format!("objective-{name}"),
            format!("Median objective of ten {}-designs, one start each", name.to_uppercase()),
            Asked::AtMost(row.median_of_ten),
            found.and_then(|p| p.median_of_ten),
            "",
            format!("best of ten {best} (interior point: {})", row.best_of_ten),
        )
    };
    published::OBJECTIVES.iter().map(one).collect()
}

pub(super) fn objectives(all: &[Population]) -> Section {
    let mut table = Table::new(vec![
        Column::text("Criterion"),
        Column::number("Thesis", "").digits(5),
        Column::number("Median of 10 starts", "").digits(6),
        Column::number("Best of 10", "").digits(6),
        Column::number("Median of all", "").digits(6),
        Column::number("Interior point, median of 10", "").digits(6),
        Column::number("Best known", "").digits(6),
    ])
    .caption("Objective reached by the default search, torque model, input box (4.16)");
    for row in published::OBJECTIVES {
        let found = of(all, Source::Design(row.criterion));
        table = table.row([
            row.criterion.name().to_uppercase().into(),
            row.thesis.into(),
            found.and_then(|p| p.median_of_ten).into(),
            found.and_then(|p| p.best_of_ten).into(),
            found.and_then(|p| p.objective).map(|o| o.median).into(),
            row.median_of_ten.into(),
            row.best_known.into(),
        ]);
    }
    Section::new("Objectives")
        .id("objectives")
        .text("Reading: convention trim (y(1..10) = 0, sums over t = 11..100), ABV as a fraction, U0 one APRBS of five levels. The thesis ran a pattern search with 50 000 evaluations, J_A from two different starting signals (3271 and 1671.8); every start here is uniform random.")
        .block(table)
        .block(table_4_3(all))
        .block(table_4_6(all))
}

fn table_4_3(all: &[Population]) -> Table {
    let mut table = Table::new(vec![
        Column::text("Signal"),
        Column::number("Thesis", "").digits(5),
        Column::number("Mean", "").digits(5),
        Column::number("SE", "").digits(2),
        Column::number("Least", "").digits(5),
    ])
    .caption(
        "Table 4.3: J_A of a random and of the optimal signal (the thesis' random signal is like an APRBS)",
    );
    let rows = [
        (Source::Udrn, Some(TABLE_4_3[0])),
        (Source::Aprbs, None),
        (Source::Design(DesignCriterion::A), Some(TABLE_4_3[1])),
    ];
    for (source, thesis) in rows {
        let s = of(all, source).and_then(|p| p.criterion(Output::Torque, DesignCriterion::A));
        table = table.row([
            Cell::from(label(source)),
            thesis.into(),
            s.map(|s| s.mean).into(),
            s.map(|s| s.se).into(),
            s.map(|s| s.low).into(),
        ]);
    }
    table
}

fn table_4_6(all: &[Population]) -> Table {
    let mut columns = vec![Column::text("Signal")];
    for name in ["J_D", "J_A"] {
        columns.push(Column::number(format!("{name}: thesis"), "").digits(5));
        columns.push(Column::number("mean", "").digits(5));
        columns.push(Column::number("SE", "").digits(2));
    }
    let mut table = Table::new(columns).caption(
        "Table 4.6: D- and A-optimal signals by both criteria (the thesis' random signal is like an APRBS)",
    );
    let rows = [
        (Source::Udrn, Some([-417.16, 9460.7])),
        (Source::Aprbs, None),
        (Source::Design(DesignCriterion::A), Some([-410.87, 3271.1])),
        (Source::Design(DesignCriterion::D), Some([-431.68, 4852.7])),
    ];
    for (source, thesis) in rows {
        let mut row = vec![Cell::from(label(source))];
        for (k, criterion) in [DesignCriterion::D, DesignCriterion::A].into_iter().enumerate() {
            let s = of(all, source).and_then(|p| p.criterion(Output::Torque, criterion));
            row.extend([thesis.map(|t| t[k]).into(), s.map(|s| s.mean).into(), s.map(|s| s.se).into()]);
        }
        table = table.row(row);
    }
    table
}

pub(super) fn criteria(all: &[Population]) -> Section {
    let mut table = Table::new(vec![
        Column::text("Signal"),
        Column::text("Criterion"),
        Column::number("Thesis (one signal)", "").digits(5),
        Column::number("Mean", "").digits(5),
        Column::number("SE", "").digits(2),
        Column::number("Median", "").digits(5),
        Column::number("2.5 %", "").digits(4),
        Column::number("97.5 %", "").digits(4),
    ])
    .caption("Table 4.9: criteria of populations of signals, torque model, with J_D of Table 4.16");
    let shown = |r: &&published::Criterion| !matches!(r.criterion, DesignCriterion::A) && !is_table_4_6(r);
    for row in published::CRITERIA.iter().filter(shown) {
        let population = of(all, row.source);
        let head: [Cell; 3] =
            [label(row.source).into(), row.criterion.name().to_uppercase().into(), row.thesis.into()];
        let rest: [Cell; 5] = match population.and_then(|p| p.criterion(Output::Torque, row.criterion)) {
            Some(s) => [s.mean.into(), s.se.into(), s.median.into(), s.low.into(), s.high.into()],
            None => {
                let rank = population.map_or((0, 0), |p| p.rank[0]);
                let none = || String::new().into();
                [format!("singular, rank {}", rank.0).into(), none(), none(), none(), none()]
            }
        };
        table = table.row(head.into_iter().chain(rest).collect::<Vec<_>>());
    }
    let section = Section::new("Criteria of the signals")
        .id("criteria")
        .text("Reading: the thesis' PRBS values are rounding noise of a singular matrix (rank 22 of 23: u1, u1^2 and 1 depend on each other on two levels). Its APRBS column is U0 itself, for which J_I is the number of parameters times the noise variance (1840); signals of other seeds are larger.")
        .block(table);
    match examples(all) {
        Some(plot) => section.block(plot),
        None => section,
    }
}

/// Figure 4.19: the fuel pulse width of one signal of each kind.
fn examples(all: &[Population]) -> Option<TimePlot> {
    let kinds = VALIDATION.into_iter().chain(DESIGNED);
    let samples = all.first().map(|p| p.example.len() / 3).filter(|n| *n > 0)?;
    let mut plot = TimePlot::sampled("One signal of each kind (Figure 4.19)", SAMPLE_S, samples);
    for source in kinds {
        let u1: Vec<f64> = of(all, source)?.example.iter().step_by(3).copied().collect();
        let panel = Panel::new(label(source), "us").range(1800.0, 6200.0).held("u1", u1);
        plot = plot.panel(panel);
    }
    Some(plot.caption("Fuel pulse width of the first signal of each population"))
}

fn is_table_4_6(row: &published::Criterion) -> bool {
    row.criterion == DesignCriterion::D && row.source != Source::Udrn
}
