//! Sequential against fixed design, and the stop rule.

use crate::loops::shown::engine::{Engine, SequencedEngine};
use crate::loops::shown::known::{Known, SequentialSeed, SequentialSize, compare};
use crate::loops::shown::paired::{Paired, Ratio};
use dynocal_report::{Cell, Column, Report, Section, Table};
use serde_json::json;

use super::super::asked::Asked;
use super::others::KNOWN_NOISE;
use super::{Check, NOISE, Options, Task, TaskResult, built, check, mean, plant, result, seeds, task};

const TASKS: [(&str, &str); 2] =
    [("sequential-known", "known system"), ("sequential-engine", "engine, quadratic NARX")];

fn sizes(o: &Options) -> [SequentialSize; 2] {
    let evaluations = if o.reduced { 100 } else { 1000 };
    let (samples, rounds) = if o.reduced { (20, 2) } else { (200, 3) };
    let known = SequentialSize {
        seed: o.seed,
        seeds: seeds(o, 20),
        initial: 30,
        samples: 60,
        rounds: if o.reduced { 2 } else { 4 },
        held_out: if o.reduced { 60 } else { 200 },
        evaluations,
    };
    [known, SequentialSize { initial: if o.reduced { 44 } else { 100 }, samples, rounds, ..known }]
}

pub(super) fn tasks(o: &Options) -> Vec<Task> {
    let [known, engine] = sizes(o);
    let unseen = if o.reduced { 1 } else { 6 };
    vec![
        task(TASKS[0].0, json!({ "size": known, "noise": KNOWN_NOISE, "unseen": 10 }), move |around| {
            compare(&built(Known::new(KNOWN_NOISE))?, known, 10, around.watch.interrupt)
        }),
        task(TASKS[1].0, json!({ "size": engine, "noise": NOISE, "unseen": unseen }), move |around| {
            let bed = Engine::new(&plant)?;
            let system = SequencedEngine {
                engine: &bed,
                model: built(bed.quadratic())?,
                doubted: built(bed.doubted_quadratic())?,
                noise_variance: NOISE.torque_nm.powi(2),
            };
            compare(&system, engine, unseen, around.watch.interrupt)
        }),
    ]
}

fn column(all: &[SequentialSeed], f: impl Fn(&SequentialSeed) -> f64) -> Vec<f64> {
    all.iter().map(f).collect()
}

fn last(s: &SequentialSeed) -> f64 {
    s.errors.last().copied().unwrap_or(f64::NAN)
}

/// Predicted over observed reduction in round `k`.
fn calibration(all: &[SequentialSeed], k: usize) -> Option<Ratio> {
    let rounds = all.iter().map(|s| s.predicted.len()).min()?;
    (k < rounds).then_some(())?;
    let (predicted, observed): (Vec<f64>, Vec<f64>) =
        all.iter().filter_map(|s| Some((s.predicted[k]?, s.errors[k] - s.errors[k + 1]))).unzip();
    Ratio::of(&predicted, &observed)
}

/// All rounds but the first, whose prediction stands on a handful of samples.
fn overall(all: &[SequentialSeed]) -> Option<Ratio> {
    let predicted = column(all, |s| s.predicted.iter().skip(1).map(|p| p.unwrap_or(f64::NAN)).sum());
    Ratio::of(&predicted, &column(all, |s| s.errors.get(1).copied().unwrap_or(f64::NAN) - last(s)))
}

fn ratio(r: &Ratio) -> String {
    format!("{:.2} [{:.2}, {:.2}]", r.ratio, r.low, r.high)
}

pub(super) fn checks(results: &[TaskResult]) -> Vec<Check> {
    let mut checks = Vec::new();
    for (k, (name, system)) in TASKS.into_iter().enumerate() {
        let all: Option<Vec<SequentialSeed>> = result(results, name);
        let all = all.as_deref();
        let paired = all.and_then(|a| Paired::ratios(&column(a, |s| s.fixed), &column(a, last)));
        let geometric = paired.as_ref().map_or(String::new(), |p| {
            format!(
                "error of the fixed design is {:.2} times [{:.2}, {:.2}] that of the sequential one; sequential better in {} of {}",
                p.mean.exp(), p.low.exp(), p.high.exp(), p.greater, p.n
            )
        });
        // Where information hardly depends on the parameters a fixed design loses nothing.
        let asked = if k == 0 { Asked::Above(1.0) } else { Asked::Reported };
        checks.push(check(
            name,
            format!("{system}: error after equal test time, fixed over sequential, lower end of 95 %"),
            asked,
            paired.as_ref().map(|p| p.low.exp()),
            "",
            geometric,
        ));
        let found = all.and_then(overall);
        let note = found.as_ref().map(ratio).unwrap_or_default();
        let id = name.replace("sequential", "stop");
        let what = format!("{system}: predicted over observed reduction of the error after the first round");
        let measured = found.map(|r| r.ratio);
        checks.push(check(format!("{id}-most"), &what, Asked::AtMost(2.0), measured, "", &note));
        checks.push(check(format!("{id}-least"), what, Asked::AtLeast(0.5), measured, "", note));
    }
    checks
}

pub(super) fn sections(report: Report, results: &[TaskResult]) -> Report {
    let mut section = Section::new("Sequential design and when to stop").id("sequential").text(
        "One long test: after a first random stretch every further one is designed given all data so far and goes on where the plant is. The rival is one design, made after the first stretch for all the rest with as many evaluations. The rule fits held-out errors as floor plus a factor times the relative prediction variance and predicts what the next, designed stretch is worth before it is run; observed is the error without noise on other unseen records.",
    );
    for (name, system) in TASKS {
        let Some(all) = result::<Vec<SequentialSeed>>(results, name) else { continue };
        section = section.block(rounds_table(&all, system)).block(rivals_table(&all, system));
    }
    report.section(section)
}

fn rounds_table(all: &[SequentialSeed], system: &str) -> Table {
    let mut table = Table::new(vec![
        Column::number("Stretch", "").digits(2),
        Column::number("Median error before", "").digits(3),
        Column::number("Mean predicted reduction", "").digits(3),
        Column::number("Mean observed", "").digits(3),
        Column::text("Predicted over observed, 95 %"),
        Column::number("Median predicted share", "%").digits(3),
    ])
    .caption(format!("Stop rule: {system}"));
    let rounds = all.iter().map(|s| s.predicted.len()).min().unwrap_or(0);
    for k in 0..rounds {
        let median = |v: Vec<f64>| crate::chapter4::work::statistics::median(&v);
        table = table.row(vec![
            (k as f64 + 2.0).into(),
            median(column(all, |s| s.errors[k])).into(),
            mean(&all.iter().filter_map(|s| s.predicted[k]).collect::<Vec<_>>()).into(),
            mean(&column(all, |s| s.errors[k] - s.errors[k + 1])).into(),
            calibration(all, k).as_ref().map(ratio).unwrap_or_default().into(),
            Cell::from(median(all.iter().filter_map(|s| s.relative[k]).map(|r| 100.0 * r).collect())),
        ]);
    }
    table
}

fn rivals_table(all: &[SequentialSeed], system: &str) -> Table {
    let mut table = Table::new(vec![
        Column::text("Test"),
        Column::number("Mean error", "").digits(3),
        Column::text("Its error over that of the sequential design, geometric mean and 95 %"),
    ])
    .caption(format!("After equal test time: {system}"));
    let sequential = column(all, last);
    for (name, errors) in [
        ("sequential designs", sequential.clone()),
        ("one fixed design", column(all, |s| s.fixed)),
        ("UDRN", column(all, |s| s.random)),
    ] {
        let against = Paired::ratios(&errors, &sequential)
            .map(|p| format!("{:.2} [{:.2}, {:.2}]", p.mean.exp(), p.low.exp(), p.high.exp()));
        table = table.row(vec![name.into(), mean(&errors).into(), Cell::from(against.unwrap_or_default())]);
    }
    table
}
