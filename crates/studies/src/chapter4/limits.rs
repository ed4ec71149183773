//! Output limits (Table 4.12) and rate limits (Table 4.13).

use crate::chapter4::work::Size;
use crate::chapter4::work::constrained::{Constrained, Kind, Limits, constrained};
use crate::chapter4::work::published::tables::{CONSTRAINED, Constrained as Printed};
use dynocal_report::{Cell, Column, Panel, Section, Table, TimePlot};
use serde_json::json;

use super::{Asked, Check, SAMPLE_S, Shared, Task, TaskResult, check, result, with_error};

const ALL: [Limits; 3] = [Limits::Output, Limits::Rate { levels: 9 }, Limits::Rate { levels: 5 }];

pub(super) fn tasks(shared: &Shared, size: Size) -> Vec<Task> {
    ALL.iter()
        .map(|&limits| {
            let inputs = json!({ "limits": limits, "size": size });
            super::task(shared, limits.name(), inputs, move |l, interrupt| {
                constrained(&l.setting, limits, l.size, interrupt)
            })
        })
        .collect()
}

fn found(results: &[TaskResult], limits: Limits) -> Option<Constrained> {
    result(results, &limits.name())
}

fn printed(limits: Limits, kind: Kind) -> Option<&'static Printed> {
    CONSTRAINED.iter().find(|p| p.limits == limits && p.kind == kind)
}

pub(super) fn checks(results: &[TaskResult]) -> Vec<Check> {
    ALL.iter().flat_map(|&limits| [order(results, limits), kept(results, limits)]).collect()
}

/// Lead of AI models over the best others, over all columns.
fn order(results: &[TaskResult], limits: Limits) -> Check {
    let found = found(results, limits);
    let column = |k: usize| -> Option<f64> {
        let rows = &found.as_ref()?.rows;
        let ai = rows.iter().find(|r| r.kind == Kind::Ai)?.r2.get(k)?.0;
        let others = rows.iter().filter(|r| r.kind != Kind::Ai).filter_map(|r| r.r2.get(k));
        Some(ai - others.map(|r| r.0).fold(f64::NEG_INFINITY, f64::max))
    };
    let leads: Vec<Option<f64>> = (0..limits.kinds().len()).map(column).collect();
    let asked = Asked::Above(0.0);
    check(
        format!("lead-{}", limits.name()),
        format!("Least lead of AI models over the next best, R2, {}", words(limits)),
        asked,
        asked.worst(&leads),
        "%",
        format!(
            "by column: {}",
            leads.iter().map(|l| format!("{:.1}", l.unwrap_or(f64::NAN))).collect::<Vec<_>>().join(", ")
        ),
    )
}

/// Limits are kept by what is designed and by what it is compared with.
fn kept(results: &[TaskResult], limits: Limits) -> Check {
    let worst = found(results, limits).map(|f| f.rows.iter().map(|r| r.violation).fold(0.0, f64::max));
    let (most, unit) = if limits == Limits::Output { (5e-5, "Nm") } else { (1e-9, "steps") };
    check(
        format!("kept-{}", limits.name()),
        format!("Largest violation over all signals, {}", words(limits)),
        Asked::AtMost(most),
        worst,
        unit,
        "predicted by the known model, which is the engine here",
    )
}

fn words(limits: Limits) -> String {
    match limits {
        Limits::Output => "output limits".into(),
        Limits::Rate { levels } => format!("rate limits, {levels} levels"),
    }
}

fn table(results: &[TaskResult], limits: Limits, caption: &str) -> Table {
    let found = found(results, limits);
    let mut columns = vec![Column::text("Model")];
    for kind in limits.kinds() {
        columns.push(Column::number(format!("{}: thesis", kind.name().to_uppercase()), "%").digits(4));
        columns.push(Column::number("ours (SE)", "%"));
        columns.push(Column::number("reference", "%").digits(3));
    }
    let mut table = Table::new(columns).caption(caption);
    for kind in limits.kinds() {
        let row = found.as_ref().and_then(|f| f.rows.iter().find(|r| r.kind == kind));
        let known = printed(limits, kind);
        let mut cells = vec![Cell::from(kind.name().to_uppercase())];
        for k in 0..limits.kinds().len() {
            let r2 = row.and_then(|r| r.r2.get(k));
            cells.extend([
                known.and_then(|p| p.thesis.get(k).copied()).into(),
                with_error(r2.copied(), 1),
                known.and_then(|p| p.reference.get(k).copied()).into(),
            ]);
        }
        table = table.row(cells);
    }
    table
}

/// What the signals of a table are like.
fn signals(results: &[TaskResult], limits: Limits) -> Table {
    let found = found(results, limits);
    let mut columns = vec![
        Column::text("Signals"),
        Column::number("J_AI, median", "").digits(3),
        Column::number("reference", "").digits(3),
    ];
    if limits == Limits::Output {
        columns.push(Column::number("Share of the box (SE)", ""));
        columns.push(Column::number("reference", "").digits(2));
    }
    let mut table = Table::new(columns).caption(format!("Signals of the table: {}", words(limits)));
    for kind in limits.kinds() {
        let row = found.as_ref().and_then(|f| f.rows.iter().find(|r| r.kind == kind));
        let known = printed(limits, kind);
        let criterion = match row.map(|r| r.criterion) {
            Some(None) => Cell::from("singular"),
            found => found.flatten().map(|s| s.median).into(),
        };
        let mut cells = vec![Cell::from(kind.name().to_uppercase()), criterion];
        cells.push(known.and_then(|p| p.share_criterion.1).into());
        if limits == Limits::Output {
            cells.push(with_error(row.and_then(|r| r.share).map(|s| (s.mean, s.se)), 3));
            cells.push(known.and_then(|p| p.share_criterion.0).into());
        }
        table = table.row(cells);
    }
    table
}

pub(super) fn outputs(results: &[TaskResult]) -> Section {
    Section::new("Output limits").id("output-limits").text(
        "u1 1800 to 6200 us, u2 0.35 to 0.65, u3 800 to 2200 rpm, torque -10 to 40 Nm over t = 11..100. Reading: each random signal is drawn towards the middle of the box until its predicted torque keeps the limits; the thesis tuned by hand, so that levels are not comparable and the order is. A design uses the limits instead of fleeing from them.",
    )
    .block(table(results, Limits::Output, "Table 4.12: mean R2 of torque models, noise variance 80"))
    .block(signals(results, Limits::Output))
}

pub(super) fn rates(results: &[TaskResult]) -> Section {
    let caption =
        |levels: usize| format!("Table 4.13, {levels} levels: mean R2 of torque models, noise variance 80");
    let section = Section::new("Rate limits").id("rate-limits").text(
        "The largest step is the range of the box divided by 8 (9 levels: 500 us, 0.025, 125 rpm) or 4 (5 levels). Random walks take the largest step at every sample and turn at the box; designs stay within it. Reference: an independent implementation; its J_AI of the design is the median of 10 interior-point starts.",
    )
    .block(table(results, ALL[1], &caption(9)))
    .block(signals(results, ALL[1]))
    .block(table(results, ALL[2], &caption(5)))
    .block(signals(results, ALL[2]));
    match examples(results) {
        Some(plot) => section.block(plot),
        None => section,
    }
}

/// Figure 4.20: a random walk and a design with the same largest step.
fn examples(results: &[TaskResult]) -> Option<TimePlot> {
    let rows = found(results, ALL[1])?.rows;
    let samples = rows.first().map(|r| r.example.len() / 3).filter(|n| *n > 0)?;
    let mut plot =
        TimePlot::sampled("A random walk and a rate-limited design (Figure 4.20)", SAMPLE_S, samples);
    for (i, (name, unit)) in [("u1", "us"), ("u2", ""), ("u3", "rpm")].into_iter().enumerate() {
        let mut panel = Panel::new(name, unit);
        for row in &rows {
            let u: Vec<f64> = row.example.iter().skip(i).step_by(3).copied().collect();
            panel = panel.held(row.kind.name().to_uppercase(), u);
        }
        plot = plot.panel(panel);
    }
    Some(plot.caption("9 levels: largest steps of 500 us, 0.025 and 125 rpm per sample of 0.1 s"))
}
