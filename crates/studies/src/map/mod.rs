//! Study `map`: steady maps that were made on a real bed, judged on the same engine without scatter.
//!
//! The job of the examples is run on the bed of each engine. Its maps are then held at operating points that no model has seen, on
//! the engine without scatter from cycle to cycle: limits, fuel against the best that a direct search on that engine finds, and
//! torque with the maps alone, no loop closed. Days of 60 points that follow the optimum stand beside days of 90 points that are all
//! planned.

mod search;
mod truth;

use dynocal_jobs::map;
use dynocal_jobs::place::Overrides;
use dynocal_numerics::registry::MemberDoc;
use dynocal_report::{Column, Report, Section, Table};
use serde::{Deserialize, Serialize};
use serde_json::json;

use crate::asked::Asked;
use crate::{Check, Options, Study, StudyError, Surroundings, Task, TaskResult, check, result};
use truth::{Best, Confirmed, Held};

pub(super) const STUDY: Study = Study {
    doc: MemberDoc {
        name: "map",
        what: "Steady maps from a day on the real bed, judged on the engine without scatter: limits, fuel against direct search, torque",
        params: &[],
    },
    tasks,
    reduce,
    sections,
};

/// An example with the engine that it is made for.
struct Example {
    name: &'static str,
    text: &'static str,
}

const EXAMPLES: [Example; 2] = [
    Example { name: "gtdi_2l", text: include_str!("../../../../examples/gtdi_2l/map.toml") },
    Example { name: "pfi_1_6l", text: include_str!("../../../../examples/pfi_1_6l/map.toml") },
];

/// Seeds of the engine as it is, perturbed engines, unseen points, and those at which the best is searched.
const SEEDS: u64 = 5;
const OTHERS: u64 = 3;
const UNSEEN: usize = 50;
const SEARCHED: usize = 12;
/// Number of the procedure of job and study: another one where they work otherwise with the same spec.
const PROCEDURE: u32 = 9;
/// Pairs of days for the comparison of plans.
const PAIRS: u64 = 10;
/// A day whose points follow the optimum beside one that is planned as a whole: name, points, share that follows the optimum, bed time in
/// minutes. The planned one has the time that its points take: in that of the example it would measure no more than the other.
const DAYS: [(&str, usize, Option<f64>, Option<f64>); 2] =
    [("follows-60", 60, None, None), ("planned-90", 90, Some(0.0), Some(120.0))];

/// One calibration with what the engine itself says about it.
#[derive(Clone, Debug, Serialize, Deserialize)]
struct Case {
    engine: String,
    seed: u64,
    /// Why there are no maps, where there are none.
    failed: Option<String>,
    valid: bool,
    optimal: usize,
    cells: usize,
    bed_min: f64,
    points: usize,
    held: Vec<Held>,
    best: Vec<Best>,
}

fn tasks(o: &Options) -> Vec<Task> {
    let mut tasks = Vec::new();
    for e in &EXAMPLES {
        let (seeds, others) = if o.reduced { (1, 0) } else { (SEEDS, OTHERS) };
        let own = (0..seeds).map(|k| (e.name.to_string(), o.seed + k));
        let engines: Vec<_> =
            own.chain((1..=others).map(|k| (format!("perturbed:{}:{k}", e.name), o.seed))).collect();
        for (parameters, seed) in engines {
            let counts = if o.reduced { (6, 1) } else { (UNSEEN, SEARCHED) };
            let name = format!("{}-{seed}", parameters.replace(':', "-"));
            tasks.push(task(name, e, parameters, seed, counts, None));
        }
    }
    for seed in (0..if o.reduced { 1 } else { PAIRS }).map(|k| o.seed + k) {
        for (day, points, share, minutes) in DAYS {
            // What is held at unseen points is not compared here: a few are enough to tell that limits are kept.
            let counts = if o.reduced { (2, 1) } else { (SEARCHED, SEARCHED) };
            let plan = Some((points, share, minutes));
            let parameters = EXAMPLES[0].name.to_string();
            tasks.push(task(format!("{day}-{seed}"), &EXAMPLES[0], parameters, seed, counts, plan));
        }
    }
    tasks
}

/// Points of a day, the share that follows the optimum, and its minutes, where they are not those of the example.
type Plan = Option<(usize, Option<f64>, Option<f64>)>;

fn task(
    name: String,
    e: &'static Example,
    parameters: String,
    seed: u64,
    counts: (usize, usize),
    plan: Plan,
) -> Task {
    // With all defaults of the job, and what a case records and how the job works: results of another form or procedure are not taken over.
    let understood = map::job::parse("map.toml", e.text, &Overrides::default());
    let understood = understood.map_or_else(|_| json!(e.text), |job| json!(job.spec));
    Task {
        name: name.clone(),
        inputs: json!([parameters, seed, counts, plan, understood, truth::WARM_S, PROCEDURE]),
        run: Box::new(move |around: &Surroundings| {
            let case = case(&name, e.text, &parameters, seed, counts, plan, around)?;
            serde_json::to_value(case)
                .map_err(|e| StudyError::Task { what: name.clone(), reason: e.to_string() })
        }),
    }
}

fn case(
    name: &str,
    text: &str,
    parameters: &str,
    seed: u64,
    (unseen, searched): (usize, usize),
    plan: Plan,
    around: &Surroundings,
) -> Result<Case, StudyError> {
    let refused = |reason: String| StudyError::Task { what: name.into(), reason };
    let over = Overrides { seed: Some(seed), out: Some(around.runs.join(name)) };
    let mut job = map::job::parse("map.toml", text, &over).map_err(|e| refused(e.to_string()))?;
    job.spec.plant.parameters = parameters.into();
    if let Some((points, share, minutes)) = plan {
        job.spec.bed.points = points;
        job.spec.bed.minutes = minutes.unwrap_or(job.spec.bed.minutes);
        job.spec.bed.refine.share = share.unwrap_or(job.spec.bed.refine.share);
    }
    let mut case = Case {
        engine: parameters.into(),
        seed,
        failed: None,
        valid: false,
        optimal: 0,
        cells: 0,
        bed_min: 0.0,
        points: 0,
        held: Vec::new(),
        best: Vec::new(),
    };
    // A calibration that gives no maps is a result of the study, not the end of it.
    let found = match map::run(&job, around.watch) {
        Ok((found, _)) => found,
        Err(map::MapError::Interrupted) => return Err(StudyError::Interrupted),
        Err(e) => return Ok(Case { failed: Some(e.to_string()), ..case }),
    };
    let optimal =
        |c: &&dynocal_calib::steady::grid::Cell| c.state == dynocal_calib::steady::grid::CellState::Optimal;
    case.valid = found.valid;
    case.optimal = found.cells.iter().filter(optimal).count();
    case.cells = found.cells.len();
    case.bed_min = found.bed.all_s() / 60.0;
    case.points = found.points.len();
    let truth = truth::Truth::new(&job.spec, &found, around.watch);
    (case.held, case.best) = truth.judge(unseen, searched).map_err(refused)?;
    Ok(case)
}

/// Names of the cases of an engine family, as results.
fn cases(results: &[TaskResult], family: &str) -> Vec<Option<Case>> {
    let of = results.iter().filter(|r| r.name.contains(family));
    of.map(|r| result::<Case>(results, &r.name)).collect()
}

/// Worst of each case, and in words.
fn over(cases: &[Option<Case>], f: &dyn Fn(&Case) -> Option<f64>) -> (Vec<Option<f64>>, String) {
    let values: Vec<Option<f64>> = cases.iter().map(|c| c.as_ref().and_then(f)).collect();
    let word = |(c, v): (&Option<Case>, &Option<f64>)| {
        let name = c.as_ref().map_or_else(|| "?".into(), |c| format!("{} seed {}", c.engine, c.seed));
        v.map_or_else(|| format!("{name}: none"), |v| format!("{name}: {v:.3}"))
    };
    let words: Vec<String> = cases.iter().zip(&values).map(word).collect();
    (values, words.join("; "))
}

fn most(values: impl Iterator<Item = f64>) -> Option<f64> {
    values.fold(None, |m, v| if v.is_nan() { Some(f64::NAN) } else { Some(m.map_or(v, |m: f64| m.max(v))) })
}

/// By how much a limit is passed on the engine, worst of the held points.
fn passed(c: &Case, output: &str) -> Option<f64> {
    most(c.held.iter().filter_map(|h| h.passed.get(output).copied()))
}

/// An output, how far it may pass its limit, and the unit.
type Limit = (&'static str, f64, &'static str);

/// Where fuel is lost: name, what it is, and how much at a point.
type Lost = (&'static str, &'static str, fn(&Best) -> f64);

fn reduce(results: &[TaskResult]) -> Vec<Check> {
    let mut checks = Vec::new();
    let limits: [(&str, &[Limit]); 2] = [
        ("gtdi_2l", &[("knock", 0.1, "-"), ("pmax", 3.3, "bar"), ("egt", 15.0, "K"), ("boost", 3.0, "kPa")]),
        ("pfi_1_6l", &[("egt", 15.0, "K")]),
    ];
    for (family, limits) in limits {
        let cases = cases(results, family);
        let mut add =
            |id: &str, what: &str, asked: Asked, unit: &'static str, f: &dyn Fn(&Case) -> Option<f64>| {
                let (values, words) = over(&cases, f);
                checks.push(check(format!("{family}-{id}"), what, asked, asked.worst(&values), unit, words));
            };
        for (output, most, unit) in limits {
            let what = format!("{family}: most that {output} passes its limit on the engine without scatter");
            add(&format!("limit-{output}"), &what, Asked::AtMost(*most), unit, &|c| passed(c, output));
        }
        add(
            "fuel",
            &format!("{family}: fuel above the best of a direct search, worst point"),
            Asked::AtMost(1.0),
            "%",
            &|c| most(c.best.iter().map(Best::above)),
        );
        // In the order of the map's making: models that err, caution and room for what they do not know, cells and smoothing.
        let lost: [Lost; 3] = [
            ("models", "the models' own optimum, above the best", |b| b.bold.fuel - b.best.fuel),
            ("caution", "what caution and room within limits add", |b| b.own.fuel - b.bold.fuel),
            ("cells", "what lies between the cells and smoothing add", |b| b.map.fuel - b.own.fuel),
        ];
        for (id, what, of) in lost {
            let what = format!("{family}: fuel lost to {id}: {what}, mean of the points");
            add(&format!("lost-{id}"), &what, Asked::Reported, "%", &|c| {
                let n = c.best.len() as f64;
                (n > 0.0).then(|| c.best.iter().map(|b| 100.0 * of(b) / b.best.fuel).sum::<f64>() / n)
            });
        }
        add(
            "torque",
            &format!("{family}: torque of the maps alone against the demand, worst point"),
            Asked::AtMost(2.0),
            "%",
            &|c| most(c.held.iter().map(|h| 100.0 * (h.open_torque / h.torque - 1.0).abs())),
        );
        add("torque-rms", &format!("{family}: the same, root mean square"), Asked::Reported, "%", &missed);
        add(
            "unsettled",
            &format!("{family}: unseen points that could not be held"),
            Asked::AtMost(0.0),
            "-",
            &|c| Some(c.held.iter().filter(|h| !h.settled).count() as f64),
        );
        add(
            "valid",
            &format!("{family}: runs whose own verdict lets the maps be used"),
            Asked::AtLeast(1.0),
            "-",
            &|c| Some(f64::from(u8::from(c.valid))),
        );
        add("bed", &format!("{family}: bed time"), Asked::AtMost(60.0), "min", &|c| {
            c.failed.is_none().then_some(c.bed_min)
        });
        add("points", &format!("{family}: points on the bed"), Asked::AtMost(90.0), "-", &|c| {
            c.failed.is_none().then_some(c.points as f64)
        });
        add(
            "cells",
            &format!("{family}: share of the cells that hold an optimum"),
            Asked::Reported,
            "%",
            &|c| Some(100.0 * c.optimal as f64 / c.cells.max(1) as f64),
        );
    }
    checks.extend(plans(results));
    checks
}

/// Root mean square of what the maps alone miss of the torque, in percent; none without maps.
fn missed(case: &Case) -> Option<f64> {
    let n = case.held.len() as f64;
    let squares = case.held.iter().map(|h| (100.0 * (h.open_torque / h.torque - 1.0)).powi(2));
    (n > 0.0).then(|| (squares.sum::<f64>() / n).sqrt())
}

/// Fuel of the maps above the best of the direct search in percent, mean of the searched points; none without maps.
fn above(case: &Case) -> Option<f64> {
    let n = case.best.len() as f64;
    (n > 0.0).then(|| case.best.iter().map(Best::above).sum::<f64>() / n)
}

/// What the days that follow the optimum with 60 points lose against those of 90 planned ones.
fn plans(results: &[TaskResult]) -> [Check; 3] {
    let less = "60 points that follow the optimum less 90 planned ones, median of the seeds";
    let check = |id: &str, what: &str, asked, unit, of: &dyn Fn(&Case) -> Option<f64>| {
        let (median, note) = pairs(results, of);
        check(id, format!("gtdi_2l: {what}, {less}"), asked, median, unit, note)
    };
    [
        check("plans", "fuel above the best", Asked::AtMost(0.0), "%", &above),
        check("plans-torque", "torque that the maps alone miss (rms)", Asked::AtMost(0.0), "%", &missed),
        check("plans-bed", "bed time", Asked::Reported, "min", &|c| c.failed.is_none().then_some(c.bed_min)),
    ]
}

/// Median over the seeds of a measure of the one day less that of the other, and all pairs in words. A day without maps loses everything.
fn pairs(results: &[TaskResult], of: &dyn Fn(&Case) -> Option<f64>) -> (Option<f64>, String) {
    let [(follows, ..), (planned, ..)] = DAYS;
    let seeds = results.iter().filter_map(|r| r.name.strip_prefix(follows)?.strip_prefix('-'));
    let pair = |seed: &str| {
        let of = |day: &str| result::<Case>(results, &format!("{day}-{seed}")).as_ref().and_then(of);
        (of(follows), of(planned))
    };
    let pairs: Vec<(Option<f64>, Option<f64>)> = seeds.map(pair).collect();
    let mut lost: Vec<f64> =
        pairs.iter().map(|(a, b)| a.unwrap_or(f64::INFINITY) - b.unwrap_or(1e9)).collect();
    lost.sort_by(f64::total_cmp);
    let n = lost.len();
    let median = (n > 0).then(|| 0.5 * (lost[(n - 1) / 2] + lost[n / 2]));
    let words = |v: &Option<f64>| v.map_or_else(|| "no maps".into(), |v| format!("{v:.3}"));
    let note: Vec<String> = pairs.iter().map(|(a, b)| format!("{} | {}", words(a), words(b))).collect();
    (median, note.join("; "))
}

/// The limit with the least room, in words.
fn room(c: &Confirmed) -> String {
    format!("{} {:+.1} %", c.limit, 100.0 * c.over)
}

fn sections(report: Report, results: &[TaskResult]) -> Report {
    EXAMPLES.iter().fold(report, |report, e| {
        let head = vec![
            Column::text("Engine"),
            Column::number("Seed", "").digits(4),
            Column::number("Torque", "Nm").digits(4),
            Column::number("Speed", "rpm").digits(4),
            Column::number("Fuel of the map", "kg/h").digits(5),
            Column::number("Optimum of the models here", "kg/h").digits(5),
            Column::number("The same without caution", "kg/h").digits(5),
            Column::number("Best found", "kg/h").digits(5),
            Column::text("Limit with least room at the best"),
            Column::number("Settings tried", "").digits(4),
        ];
        let mut table = Table::new(head).caption("Fuel against direct search on the engine without scatter");
        let mut words = Vec::new();
        for c in cases(results, e.name).into_iter().flatten() {
            if let Some(why) = &c.failed {
                words.push(format!("{}, seed {}: no maps: {why}", c.engine, c.seed));
            }
            for b in &c.best {
                table = table.row(vec![
                    c.engine.as_str().into(),
                    (c.seed as f64).into(),
                    b.at[0].into(),
                    b.at[1].into(),
                    b.map.fuel.into(),
                    b.own.fuel.into(),
                    b.bold.fuel.into(),
                    b.best.fuel.into(),
                    room(&b.best).into(),
                    (b.tried as f64).into(),
                ]);
            }
        }
        let mut section = Section::new(e.name).block(table);
        if !words.is_empty() {
            section = section.text(words.join("\n"));
        }
        report.section(section)
    })
}
