//! Study `control`: margins that are promised by an identified model, measured on the engine (thesis section 7.7).
//!
//! On three beds, with sensors and scatter: throttle and injected fuel are moved a little about a set point, a linear model of
//! torque and lambda is estimated from the record, and its steady gains are inverted, which is what a static map is about its
//! set point: `u = u0 + G(0)^-1 d`, d being demands of torque and lambda. Behind it the demands are moved, as in the thesis, and the
//! a model is estimated from that record: torque bends at lambda 1, and fuel that moves without its air sees another slope than
//! loops that move both. About this compensated engine two PI controllers are tuned by the search of the plane. They are rough: under
//! them the engine is tested a third time, their gains raised in turns, and what is built on that record is judged. The test grows until
//! its model says the gain margins to 1 dB. Gain and delay margins, each loop with the other closed, are then measured: gain or delay is put into one loop and grows until the
//! engine oscillates. The published gains are judged on the same models.
//!
//! Figures 7.22 to 7.30 are drawn on the same beds (`figures`): responses, steps under the loops, torque held by an estimate
//! (`estimator`), lambda with delay under a Smith predictor (`runs`). `worth` asks which test gives the safest controller,
//! `refine` makes the map again from data of the closed loop until feedback has nothing left to do.

mod bed;
pub(crate) mod cycles;
mod estimator;
mod figures;
mod horizon;
mod judge;
mod page;
mod page_figures;
mod plant;
mod refine;
mod runs;
mod worth;

use dynocal_control::identify::ORDERS;
use dynocal_control::margin::{Margins, Side, margins};
use dynocal_control::plane::Channel;
use dynocal_control::system::System;
use dynocal_numerics::registry::MemberDoc;
use serde::{Deserialize, Serialize};
use serde_json::json;

use crate::asked::Asked;
use crate::{Check, Options, Study, StudyError, Surroundings, Task, TaskResult, check};
use bed::{Bench, SAMPLE_S};
use cycles::CycleCase;
use figures::Figures;
use worth::WorthCase;

pub(super) const STUDY: Study = Study {
    doc: MemberDoc {
        name: "control",
        what: "PI loops about an identified engine: margins measured on the bed, Smith predictor, torque without a sensor, tests for control",
        params: &[],
    },
    tasks,
    reduce,
    sections: page::sections,
};

/// Beds, and seeds of their scatter.
const ENGINES: [&str; 3] = ["pfi_1_6l", "gtdi_2l", "other_1_8l"];
/// Least and greatest length of the records that identify, in s.
const RECORD_S: (f64, f64) = (240.0, 960.0);
/// Share of the scatter with which gain margins are measured again: a loop near its margin makes its scatter so large that the engine may be
/// tipped into a cycle of its actuators' whole range before the loop itself is unstable, which no linear model has.
const CALMER: f64 = 0.25;
/// Names of inputs and outputs.
const INPUTS: [&str; 2] = ["throttle", "inj"];
const OUTPUTS: [&str; 2] = ["torque", "lambda"];
const DEMANDED: [&str; 2] = ["torque_demand", "lambda_demand"];
/// The published gains: equation, kp and ki of torque, kp and ki of lambda.
const PUBLISHED: [(&str, [f64; 4]); 2] =
    [("(7.23)", [0.33, 2.64, 3.59, 19.34]), ("(7.33)", [0.33, 2.64, 0.5, 2.0])];

/// One loop: what was promised and what was measured.
#[derive(Clone, Debug, Serialize, Deserialize)]
struct LoopFound {
    kp: f64,
    ki: f64,
    promised: Margins,
    /// Half of the interval that holds nine tenths of the gain margins of draws of the model, in dB.
    half_db: f64,
    /// Factor of the gain at which the engine began to oscillate; none: not up to the largest that was tried.
    gain_measured: Option<f64>,
    /// The same with [`CALMER`] of the scatter.
    gain_calmer: Option<f64>,
    /// Delay in s at which it began to oscillate.
    delay_measured_s: Option<f64>,
}

/// Published gains on the identified model.
#[derive(Clone, Debug, Serialize, Deserialize)]
struct Judged {
    equation: String,
    output: String,
    stable: bool,
    gain_margin: Option<f64>,
    phase_deg: Option<f64>,
}

/// A bed.
#[derive(Clone, Debug, Serialize, Deserialize)]
struct Case {
    engine: String,
    failed: Option<String>,
    /// Orders of the models, and their free-run fit on the half that chose them, in percent.
    orders: Vec<(usize, usize)>,
    fits: Vec<f64>,
    /// Length of the test under loops in s.
    test_s: f64,
    /// Steady gains, outputs by inputs.
    steady: Vec<f64>,
    relative_gain: f64,
    loops: Vec<LoopFound>,
    published: Vec<Judged>,
    /// Frequency responses, runs of the loops, what estimates the torque: none where something failed before.
    figures: Option<Figures>,
}

fn tasks(o: &Options) -> Vec<Task> {
    let engines = if o.reduced { &ENGINES[..1] } else { &ENGINES[..] };
    let (seed, reduced) = (o.seed, o.reduced);
    let mut all = worth_tasks(o);
    let beds = engines.iter().map(|engine| Task {
        name: (*engine).into(),
        inputs: json!([engine, seed, reduced, RECORD_S, SAMPLE_S, ORDERS, bed::METHOD]),
        run: Box::new(move |around: &Surroundings| {
            let mut case = Case {
                engine: (*engine).into(),
                failed: None,
                orders: Vec::new(),
                fits: Vec::new(),
                test_s: f64::NAN,
                steady: Vec::new(),
                relative_gain: f64::NAN,
                loops: Vec::new(),
                published: Vec::new(),
                figures: None,
            };
            // What fails on a bed is its result, and not the end of the study.
            if let Err(reason) = fill(&mut case, seed, reduced, around) {
                if around.watch.interrupted() {
                    return Err(StudyError::Interrupted);
                }
                case.failed = Some(reason);
            }
            serde_json::to_value(case)
                .map_err(|e| StudyError::Task { what: (*engine).into(), reason: e.to_string() })
        }),
    });
    all.extend(beds);
    all.extend(cycle_tasks(o));
    all
}

/// Seeds of the tests for control.
const WORTH: u64 = 20;

fn worth_tasks(o: &Options) -> Vec<Task> {
    let task = |seed: u64| {
        let name = format!("test-for-control-{seed}");
        Task {
            name: name.clone(),
            inputs: json!(["test for control", seed]),
            run: Box::new(move |_: &Surroundings| {
                let failed = |reason: String| StudyError::Task { what: name.clone(), reason };
                let found = worth::contest(seed).map_err(failed)?;
                serde_json::to_value(found).map_err(|e| failed(e.to_string()))
            }),
        }
    };
    (o.seed..o.seed + if o.reduced { 3 } else { WORTH }).map(task).collect()
}

/// Cycles below the folder of data, the engine whose maps are used, and engines that are driven: on cycles beyond the first two, two of
/// them.
const CYCLES: [&str; 5] = ["us06", "wltc_class3b", "udds", "real_drive_tsdc42648", "real_drive_cmap4115766"];
const MAPPED: &str = "pfi_1_6l";
const DRIVEN: [&str; 8] = [
    "pfi_1_6l",
    "perturbed:pfi_1_6l:1",
    "perturbed:pfi_1_6l:2",
    "perturbed:pfi_1_6l:3",
    "perturbed:pfi_1_6l:4",
    "perturbed:pfi_1_6l:5",
    "perturbed:pfi_1_6l:6",
    "perturbed:pfi_1_6l:7",
];

/// Model in the loop, where the cycles are given: they are not part of the program.
fn cycle_tasks(o: &Options) -> Vec<Task> {
    let Some(data) = &o.data else { return Vec::new() };
    let (cycles, count) = if o.reduced { (&CYCLES[..1], 1) } else { (&CYCLES[..], DRIVEN.len()) };
    let length_s = o.reduced.then_some(60.0);
    let task = |(cycle, engine): (&'static str, &'static str)| {
        let name = format!("{cycle}-{}", engine.replace(':', "-"));
        let path = data.join(format!("data/drive_cycles/{cycle}.csv"));
        Task {
            name: name.clone(),
            inputs: json!([cycle, engine, length_s, cycles::FUELLED.map(|f| f.0), cycles::METHOD]),
            run: Box::new(move |around: &Surroundings| {
                let failed = |reason: String| StudyError::Task { what: name.clone(), reason };
                let watch = around.watch;
                watch.note(&format!("{cycle}: {engine} under {} controllers", cycles::FUELLED.len()));
                let read = dynocal_jobs::engine::cycle::read(&path, length_s, &|_| {})
                    .map_err(|e| failed(e.to_string()))?;
                let found = cycles::contest((MAPPED, engine), &cycles::FUELLED, cycle, &read, &|| {
                    watch.interrupted()
                });
                if watch.interrupted() {
                    return Err(StudyError::Interrupted);
                }
                serde_json::to_value(found.map_err(failed)?).map_err(|e| failed(e.to_string()))
            }),
        }
    };
    let engines = |k: usize| &DRIVEN[..if k < 2 { count } else { count.min(2) }];
    let all = cycles.iter().enumerate().flat_map(|(k, c)| engines(k).iter().map(move |e| (*c, *e)));
    all.map(task).collect()
}

fn driven(results: &[TaskResult]) -> Vec<CycleCase> {
    results.iter().filter_map(|r| serde_json::from_value(r.value.clone()).ok()).collect()
}

fn worths(results: &[TaskResult]) -> Vec<WorthCase> {
    results.iter().filter_map(|r| serde_json::from_value(r.value.clone()).ok()).collect()
}

fn fill(case: &mut Case, seed: u64, reduced: bool, around: &Surroundings) -> Result<(), String> {
    let text = |e: &dyn std::fmt::Display| e.to_string();
    let watch = around.watch;
    watch.note(&format!("{}: records", case.engine));
    let bench = Bench::new(&case.engine, seed, None)?;
    let (least_s, most_s) = if reduced { (60.0, 60.0) } else { RECORD_S };
    let first = plant::behind_a_map(&bench, least_s, watch)?;
    case.steady = first.steady.data.iter().map(|v| v.re).collect();
    case.relative_gain = first.relative_gain;
    let known = plant::under_loops(&bench, &first, (least_s, most_s), seed, watch)?;
    (case.orders, case.fits, case.test_s) = (known.orders, known.fits, known.test_s);
    case.published = PUBLISHED.iter().flat_map(|(name, g)| judged(&known.plant, name, g)).collect();
    case.figures = Some(figures::draw(
        &bench,
        (&first.record, &first.finer),
        &first.map,
        &known.plant,
        &known.gains,
        (&case.engine, seed, reduced),
        watch,
    )?);
    let closed = plant::closed(&known.plant, &known.gains)?;
    let calmer = Bench::scattering(&case.engine, seed, None, CALMER)?;
    for (k, g) in known.gains.iter().enumerate() {
        watch.note(&format!("{}: margins of the loop of {}", case.engine, OUTPUTS[k]));
        let promised = margins(&closed, Side::Outputs, k).map_err(|e| text(&e))?;
        let measure = |bench: &Bench, delay: bool| {
            bench.lost(&first.map, &known.gains, k, delay, &promised, &|| watch.interrupted())
        };
        case.loops.push(LoopFound {
            kp: g.kp,
            ki: g.ki,
            gain_measured: measure(&bench, false)?,
            gain_calmer: measure(&calmer, false)?,
            delay_measured_s: measure(&bench, true)?,
            promised,
            half_db: known.half_db[k],
        });
    }
    Ok(())
}

/// Published gains, each loop alone.
fn judged(plant: &System, equation: &str, g: &[f64; 4]) -> Vec<Judged> {
    (0..2)
        .filter_map(|k| {
            let channel = Channel::new(plant.time, plant.channel(k, k).clone()).ok()?;
            let m = channel.margins(g[2 * k], g[2 * k + 1]);
            Some(Judged {
                equation: equation.into(),
                output: OUTPUTS[k].into(),
                stable: m.is_some(),
                gain_margin: m.and_then(|m| m.gain_up),
                phase_deg: m.and_then(|m| m.phase_deg),
            })
        })
        .collect()
}

fn cases(results: &[TaskResult]) -> Vec<Case> {
    results.iter().filter_map(|r| serde_json::from_value(r.value.clone()).ok()).collect()
}

/// Measured over promised in dB.
fn gain_error_db(l: &LoopFound) -> Option<f64> {
    in_db(l.gain_measured, l)
}

/// The same where the combustion scatters less.
fn gain_error_calmer_db(l: &LoopFound) -> Option<f64> {
    in_db(l.gain_calmer, l)
}

fn in_db(gain: Option<f64>, l: &LoopFound) -> Option<f64> {
    Some(20.0 * (gain? / l.promised.gain_up?).log10())
}

/// Measured less promised delay margin, in deg at the frequency of the phase margin.
fn phase_error_deg(l: &LoopFound) -> Option<f64> {
    Some(((l.delay_measured_s? - l.promised.delay_s?) * l.promised.phase_rad_s?).to_degrees())
}

fn reduce(results: &[TaskResult]) -> Vec<Check> {
    let all = cases(results);
    let loops = || all.iter().flat_map(|c| &c.loops);
    let note = |of: &dyn Fn(&LoopFound) -> Option<f64>| {
        let each = all.iter().flat_map(|c| c.loops.iter().zip(OUTPUTS).map(move |(l, o)| (c, l, o)));
        let text = |(c, l, o): (&Case, &LoopFound, &str)| {
            format!("{} {o} {}", c.engine, of(l).map_or("-".into(), |v| format!("{v:.2}")))
        };
        each.map(text).collect::<Vec<_>>().join(", ")
    };
    let sizes =
        |of: &dyn Fn(&LoopFound) -> Option<f64>| loops().map(|l| of(l).map(f64::abs)).collect::<Vec<_>>();
    let mut checks = vec![
        check(
            "gain-margin",
            "gain margin on the engine over that of the model, worst of loops and beds",
            Asked::AtMost(1.0),
            Asked::AtMost(1.0).worst(&sizes(&gain_error_db)),
            "dB",
            note(&gain_error_db),
        ),
        check(
            "gain-margin-calmer",
            "the same where the combustion scatters a quarter as much: how much of it is scatter that the loop makes large",
            Asked::Reported,
            Asked::AtMost(1.0).worst(&sizes(&gain_error_calmer_db)),
            "dB",
            note(&gain_error_calmer_db),
        ),
        check(
            "phase-margin",
            "delay margin on the engine less that of the model, as phase at its frequency, worst of loops and beds",
            Asked::AtMost(5.0),
            Asked::AtMost(5.0).worst(&sizes(&phase_error_deg)),
            "deg",
            note(&phase_error_deg),
        ),
    ];
    for (equation, _) in PUBLISHED {
        let of = all.iter().flat_map(|c| &c.published).filter(|j| j.equation == equation);
        let stable: Vec<bool> = of.map(|j| j.stable).collect();
        let share = stable.iter().filter(|s| **s).count() as f64 / stable.len().max(1) as f64;
        checks.push(check(
            format!("published-{}", equation.trim_matches(['(', ')'])),
            format!("share of loops that are stable with the published gains {equation}"),
            Asked::Reported,
            Some(100.0 * share),
            "%",
            "gains of the compensated engine of the thesis, whose sample time and sensors are others",
        ));
    }
    checks.extend(judge::checks(&all, &worths(results)));
    checks.extend(judge::cycles(&driven(results)));
    let failed: Vec<String> =
        all.iter().filter_map(|c| c.failed.as_ref().map(|f| format!("{}: {f}", c.engine))).collect();
    let others = worths(results).len() + driven(results).len();
    let count = failed.len() + results.len() - all.len() - others;
    checks.push(check(
        "failed",
        "tasks without a result",
        Asked::AtMost(0.0),
        Some(count as f64),
        "-",
        failed.join("; "),
    ));
    checks
}
