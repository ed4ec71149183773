//! Scenario 7: WLTC and US06 with vehicle and driver.
//!
//! The drives are those of the study of control (`control::cycles`), on the boosted engine: car and driver, steady throttle and spark
//! for all, wastegate and cams where the parameter set has them; air, manifold and film identified from two records of 240 s, on
//! which loops and the rival's extrapolation are tuned. The cycles are measured data and no part of the program: without a folder of
//! data there is no such task.

use serde::{Deserialize, Serialize};
use serde_json::json;

use super::judge::judged;
use crate::asked::Asked;
use crate::control::cycles::{CycleCase, Driven, FUELLED, METHOD, contest};
use crate::{Check, Options, StudyError, Surroundings, Task, TaskResult};
use dynocal_report::{Column, Report, Section, Table};

/// Parameter set, and engines like it beyond the first.
const ENGINE: &str = "gtdi_2l";
const OTHERS: u64 = 2;
const CYCLES: [&str; 2] = ["us06", "wltc_class3b"];
/// Ours, the production ECU with either feedback, and what is shown beside.
const OURS: &str = "dynamic map, Smith predictor";
const RIVALS: [&str; 3] = [
    "production ECU, feedback",
    "production ECU, Smith predictor",
    "production ECU, Smith predictor, long-term trim",
];
const BESIDE: [&str; 5] = [
    "dynamic map, adapted",
    "dynamic map, adapted, Smith predictor",
    "dynamic map, feedback",
    "static map, PI",
    "static map, Smith predictor, long-term trim",
];
/// Length at reduced length in s.
const SHORT_S: f64 = 60.0;

/// A cycle on an engine.
#[derive(Clone, Debug, Serialize, Deserialize)]
struct Case {
    seventh: CycleCase,
}

pub(super) fn tasks(o: &Options) -> Vec<Task> {
    let Some(data) = &o.data else { return Vec::new() };
    let (cycles, others) = if o.reduced { (&CYCLES[..1], 0) } else { (&CYCLES[..], OTHERS) };
    let length_s = o.reduced.then_some(SHORT_S);
    let task = |(cycle, engine): (&'static str, String)| {
        let name = format!("7-{cycle}-{}", engine.replace(':', "-"));
        let path = data.join(format!("data/drive_cycles/{cycle}.csv"));
        Task {
            name: name.clone(),
            inputs: json!([7, cycle, engine, length_s, METHOD]),
            run: Box::new(move |around: &Surroundings| {
                let failed = |reason: String| StudyError::Task { what: name.clone(), reason };
                let watch = around.watch;
                watch.note(&format!("scenario 7: {engine} along {cycle}"));
                let read = dynocal_jobs::engine::cycle::read(&path, length_s, &|_| {})
                    .map_err(|e| failed(e.to_string()))?;
                let named = |f: &&(&str, _, _)| f.0 == OURS || RIVALS.contains(&f.0) || BESIDE.contains(&f.0);
                let who: Vec<_> = FUELLED.iter().filter(named).copied().collect();
                let found = contest((ENGINE, &engine), &who, cycle, &read, &|| watch.interrupted());
                if watch.interrupted() {
                    return Err(StudyError::Interrupted);
                }
                let case = Case { seventh: found.map_err(failed)? };
                serde_json::to_value(case).map_err(|e| failed(e.to_string()))
            }),
        }
    };
    let engines = std::iter::once(ENGINE.to_string())
        .chain((1..=others).map(|k| format!("perturbed:{ENGINE}:{k}")))
        .collect::<Vec<_>>();
    cycles.iter().flat_map(|c| engines.iter().map(|e| (*c, e.clone()))).map(task).collect()
}

fn cases(results: &[TaskResult]) -> Vec<CycleCase> {
    let read = |r: &TaskResult| serde_json::from_value::<Case>(r.value.clone()).ok();
    results.iter().filter_map(read).map(|c| c.seventh).collect()
}

/// Number of results that are cases of this scenario.
pub(super) fn counted(results: &[TaskResult]) -> usize {
    cases(results).len()
}

type Of = fn(&Driven) -> f64;

/// Ours over the best rival's.
fn ratio(case: &CycleCase, of: Of) -> Option<f64> {
    let best = RIVALS.iter().filter_map(|r| case.drive(r).map(of)).reduce(f64::min)?;
    Some(of(case.drive(OURS)?) / best)
}

fn pollutants_g_km(d: &Driven) -> f64 {
    d.tailpipe_g_km.iter().sum()
}

/// The checks; none where no case was run.
pub(super) fn checks(results: &[TaskResult]) -> Vec<Check> {
    let all = cases(results);
    let asked: [(&str, &str, f64, Of); 3] = [
        ("outside", "fuelled time with lambda beyond 1 %", 0.5, |d| 1.0 - d.within),
        ("fuel", "fuel", 1.0, |d| d.fuel_g),
        ("tailpipe", "CO, HC and NO behind the catalyst", 0.9, pollutants_g_km),
    ];
    let mut out = Vec::new();
    for cycle in CYCLES {
        for (own, suffix, words) in [(true, "", "mean"), (false, "-others", "worst of engines like it")] {
            let of_it = || all.iter().filter(|c| c.cycle == cycle && (c.driven_engine == ENGINE) == own);
            if of_it().next().is_none() {
                continue;
            }
            for (id, what, most, of) in asked {
                let found: Vec<Option<f64>> = of_it().map(|c| ratio(c, of)).collect();
                let id = format!("7-{cycle}-{id}{suffix}");
                let what = format!("{cycle}: {what}, over the best rival's, {words}");
                out.push(judged(&id, &what, Asked::AtMost(most), &found, !own));
            }
        }
    }
    out
}

const WORDS: &str = "Car and driver along the cycle; all share throttle and spark of the steady points, wastegate and cams stand where \
    the parameter set has them, and there is no scatter: what differs is the fuel. Outside: share of the fuelled time with lambda \
    beyond 1 %.";

pub(super) fn section(report: Report, results: &[TaskResult]) -> Report {
    let all = cases(results);
    if all.is_empty() {
        return report;
    }
    let head = vec![
        Column::text("Cycle, engine"),
        Column::text("Controller"),
        Column::number("outside", "%").digits(3),
        Column::number("fuel", "g").digits(5),
        Column::number("CO", "g/km").digits(3),
        Column::number("HC", "g/km").digits(3),
        Column::number("NO", "g/km").digits(3),
    ];
    let mut table = Table::new(head);
    for c in &all {
        for d in &c.drives {
            let [co, hc, no] = d.tailpipe_g_km;
            let mut cells = vec![format!("{}, {}", c.cycle, c.driven_engine).into(), d.name.as_str().into()];
            cells.extend([100.0 * (1.0 - d.within), d.fuel_g, co, hc, no].map(Into::into));
            table = if d.name == OURS { table.stressed_row(cells) } else { table.row(cells) };
        }
    }
    report.section(Section::new("Drive cycles").text(WORDS).block(table))
}
