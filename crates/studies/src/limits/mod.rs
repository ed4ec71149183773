//! Study `limits`: fuel along the start of WLTC with nitric oxide and knock limited, on models of records of the boosted engine.
//!
//! The bed of `gtdi_2l` is excited (throttle, wastegate, spark, lambda demand, speed), torque, fuel-air ratio and knock get
//! polynomials, nitric oxide a network. The record of the cycle is the engine in a car that follows it. The limit of the mean flow
//! of nitric oxide then falls in steps, from what the optimum without it gives.

mod records;

use std::path::{Path, PathBuf};

use dynocal_files::atomic;
use dynocal_ident::validate::{Kind, Seen};
use dynocal_jobs::engine::Engine;
use dynocal_jobs::identify::error::IdentifyError;
use dynocal_jobs::place::Overrides;
use dynocal_jobs::{identify, optimise};
use dynocal_numerics::registry::MemberDoc;
use dynocal_numerics::status::Status;
use dynocal_report::{Column, Report, Section, Table};
use serde::{Deserialize, Serialize};
use serde_json::json;

use crate::asked::Asked;
use crate::{Check, Options, Study, StudyError, Surroundings, Task, TaskResult, check, result};
use records::Recorder;

pub(super) const STUDY: Study = Study {
    doc: MemberDoc {
        name: "limits",
        what: "Fuel along the start of WLTC, nitric oxide and knock limited, on models of the boosted engine (needs --data)",
        params: &[],
    },
    tasks,
    reduce,
    sections,
};

const BED: &str = include_str!("bed.toml");
const MODELS: &str = include_str!("models.toml");
const NITRIC_OXIDE: &str = include_str!("nitric_oxide.toml");
const OPTIMISE: &str = include_str!("optimise.toml");
/// The cycle below the folder of data.
const CYCLE: &str = "data/drive_cycles/wltc_class3b.csv";
/// Limits of nitric oxide, as shares of what the optimum without one gives.
const SHARES: [f64; 5] = [0.95, 0.9, 0.8, 0.7, 0.6];
/// Distance from a limit that counts as kept, as a share of its size.
const KEPT: f64 = 1e-6;

/// The optimum at one limit.
#[derive(Clone, Debug, Serialize, Deserialize)]
struct Step {
    /// Share of the flow without a limit; 1 without one.
    share: f64,
    status: Status,
    iterations: usize,
    fuel_kg_h: f64,
    /// What the search minimised: fuel and smoothing.
    minimised_kg_h: f64,
    no_g_h: f64,
    /// Fuel in kg/h for 1 g/h more nitric oxide.
    price: f64,
    /// Largest violation of anything asked, as a share of its size.
    missed: f64,
}

#[derive(Clone, Debug, Serialize, Deserialize)]
struct Found {
    /// Output, R2 in free run on the record that had no part in it, in percent.
    scores: Vec<Score>,
    start_kg_h: f64,
    steps: Vec<Step>,
}

/// How a model follows a record that had no part in it.
#[derive(Clone, Debug, Serialize, Deserialize)]
struct Score {
    output: String,
    r2_percent: Option<f64>,
}

fn tasks(o: &Options) -> Vec<Task> {
    let (seed, reduced, data) = (o.seed, o.reduced, o.data.clone());
    vec![Task {
        name: "wltc".into(),
        inputs: json!([seed, reduced, BED, MODELS, NITRIC_OXIDE, OPTIMISE, SHARES]),
        run: Box::new(move |around: &Surroundings| {
            let found = work(seed, reduced, data.as_deref(), around)?;
            serde_json::to_value(found).map_err(|e| failed(e.to_string()))
        }),
    }]
}

fn failed(reason: String) -> StudyError {
    StudyError::Task { what: "limits".into(), reason }
}

fn work(seed: u64, reduced: bool, data: Option<&Path>, around: &Surroundings) -> Result<Found, StudyError> {
    let Some(data) = data else {
        return Err(failed(
            "the cycle is not part of the program: --data FOLDER with data/drive_cycles".into(),
        ));
    };
    let folder = around.runs.join("records");
    std::fs::create_dir_all(&folder).map_err(|e| failed(format!("{}: {e}", folder.display())))?;
    let bed = folder.join("bed.toml");
    atomic::write(&bed, BED.as_bytes())?;
    let engine = Engine::named("gtdi_2l").map_err(|e| failed(e.to_string()))?;
    let recorder = Recorder { engine, folder: &folder, bed, seed, watch: around.watch };
    let (excited_s, cycle_s) = if reduced { (60.0, 40.0) } else { (200.0, 300.0) };
    for k in 0..4 {
        recorder.excite(&format!("rec{k}"), k, excited_s).map_err(failed)?;
    }
    recorder.drive("wltc", &data.join(CYCLE), cycle_s).map_err(failed)?;
    let mut scores = Vec::new();
    let others = models("models", MODELS, &folder, reduced, around, &mut scores)?;
    let nitric = models("nitric_oxide", NITRIC_OXIDE, &folder, reduced, around, &mut scores)?;
    let (start_kg_h, steps) = limited(&folder, [others, nitric], reduced, around)?;
    Ok(Found { scores, start_kg_h, steps })
}

/// Identifies the models of a spec; gives the folder that holds them.
fn models(
    name: &str,
    text: &str,
    folder: &Path,
    reduced: bool,
    around: &Surroundings,
    scores: &mut Vec<Score>,
) -> Result<PathBuf, StudyError> {
    let text = text.replace("FOLDER", &folder.display().to_string());
    let text = if reduced { text.replace("starts = 6", "starts = 1, max_evaluations = 20") } else { text };
    let out = Some(around.runs.join(name));
    let over = identify::spec::Overrides { out, ..identify::spec::Overrides::default() };
    let mut job =
        identify::spec::parse(&format!("{name}.toml"), &text, &over).map_err(|e| failed(e.to_string()))?;
    // Free runs are what an optimisation rests on; what else can be computed of a model takes its time.
    (job.validate.stability_runs, job.validate.folds) = (0, 0);
    let found = identify::job::run(&job, around.watch);
    let (found, kept) = match found {
        Err(IdentifyError::Interrupted) => return Err(StudyError::Interrupted),
        other => other.map_err(|e| failed(e.to_string()))?,
    };
    let unseen = found.scores.iter().filter(|s| s.kind == Kind::FreeRun && s.data == Seen::Unseen);
    scores.extend(unseen.map(|s| Score { output: s.output.clone(), r2_percent: s.r2_percent }));
    Ok(kept.path().join("steps/01-identify"))
}

/// The optimum without and with a limit of nitric oxide: the start's mean fuel, and the steps.
fn limited(
    folder: &Path,
    [models, nitric]: [PathBuf; 2],
    reduced: bool,
    around: &Surroundings,
) -> Result<(f64, Vec<Step>), StudyError> {
    let text = OPTIMISE
        .replace("FOLDER", &folder.display().to_string())
        .replace("MODELS", &models.display().to_string())
        .replace("NITRIC_OXIDE", &nitric.display().to_string());
    let over = Overrides { out: Some(around.runs.join("optimum")), ..Overrides::default() };
    let mut job = optimise::spec::parse("optimise.toml", &text, &over).map_err(|e| failed(e.to_string()))?;
    let shares = if reduced { &SHARES[..1] } else { &SHARES[..] };
    let (mut steps, mut start, mut free) = (Vec::new(), 0.0, None);
    for share in std::iter::once(1.0).chain(shares.iter().copied()) {
        if let Some(free) = free {
            let flow = job.problem.limits.iter_mut().filter(|l| l.mean_upper.is_some());
            flow.for_each(|l| l.mean_upper = Some(share * free));
        }
        let found = match optimise::work::optimise(&job, around.watch) {
            Err(optimise::OptimiseJobError::Interrupted) => return Err(StudyError::Interrupted),
            other => other.map_err(|e| failed(e.to_string()))?,
        };
        let step = step(share, &found).map_err(failed)?;
        start = found.objective.start;
        free = free.or(Some(step.no_g_h));
        steps.push(step);
    }
    Ok((start, steps))
}

fn step(share: f64, found: &optimise::Optimised) -> Result<Step, String> {
    let o = &found.optimum;
    let values = |name: &str| {
        let all = o.inputs.iter().chain(&o.outputs).chain(found.start.channels.iter());
        all.into_iter().find(|c| c.name == name).map(|c| c.values.as_slice()).ok_or(format!("no {name}"))
    };
    let (no, inj, speed) = (values("no")?, values("inj")?, values("speed")?);
    let factor = found.problem.monomial("no_flow").factor;
    let flow = (o.first..o.last).map(|t| factor * no[t] * inj[t] * speed[t]).sum::<f64>();
    let price = found.prices.iter().find(|p| p.channel == "no_flow").map_or(f64::NAN, |p| p.price);
    // What counts as kept is a millionth of the size.
    let missed = found.asked.iter().map(|a| a.largest.map_or(f64::INFINITY, |l| l * KEPT / a.allowed));
    Ok(Step {
        share,
        status: o.status,
        iterations: o.iterations,
        fuel_kg_h: found.objective.optimum,
        minimised_kg_h: found.objective.minimised.unwrap_or(f64::NAN),
        no_g_h: flow / (o.last - o.first) as f64,
        price,
        missed: missed.fold(0.0, f64::max),
    })
}

fn reduce(results: &[TaskResult]) -> Vec<Check> {
    let found: Option<Found> = result(results, "wltc");
    let of = |f: &dyn Fn(&Found) -> Option<f64>| found.as_ref().and_then(f);
    let worst = |f: &dyn Fn(&Step) -> f64| of(&|x| x.steps.iter().map(f).reduce(f64::max));
    let rise =
        |f: &dyn Fn(&Step) -> f64| of(&|x| x.steps.windows(2).map(|w| f(&w[1]) - f(&w[0])).reduce(f64::min));
    let not_solved = |s: &Step| f64::from(u8::from(s.status != Status::Converged));
    let mut checks = vec![
        check(
            "solved",
            "limits at which the search did not end at an optimum",
            Asked::AtMost(0.0),
            worst(&not_solved),
            "-",
            "",
        ),
        check(
            "kept",
            "largest violation of anything asked, as a share of its size",
            Asked::AtMost(KEPT),
            worst(&|s| s.missed),
            "-",
            "",
        ),
        check(
            "price-monotone",
            "least rise of the price of nitric oxide from limit to tighter limit",
            Asked::AtLeast(0.0),
            rise(&|s| -s.price),
            "kg/h per g/h",
            "",
        ),
        check(
            "minimised-rise",
            "least rise of what is minimised, fuel with smoothing, from limit to tighter limit",
            Asked::Reported,
            rise(&|s| s.minimised_kg_h),
            "kg/h",
            "below 0: the search is local, and the looser limit ended at another optimum",
        ),
        check(
            "fuel-rise",
            "least rise of the fuel alone from limit to tighter limit",
            Asked::Reported,
            rise(&|s| s.fuel_kg_h),
            "kg/h",
            "may fall by what smoothing rises",
        ),
    ];
    let saved = of(&|x| Some(100.0 * (x.steps.first()?.fuel_kg_h / x.start_kg_h - 1.0)));
    checks.push(check(
        "fuel",
        "fuel of the optimum without a limit of nitric oxide, against the start",
        Asked::Reported,
        saved,
        "%",
        "",
    ));
    for s in found.iter().flat_map(|f| &f.scores) {
        let what = format!("{}: R2 in free run on a record that had no part in the models", s.output);
        checks.push(check(format!("model-{}", s.output), what, Asked::Reported, s.r2_percent, "%", ""));
    }
    checks
}

fn sections(report: Report, results: &[TaskResult]) -> Report {
    let Some(found) = result::<Found>(results, "wltc") else { return report };
    let head = vec![
        Column::number("Nitric oxide, share of that without a limit", "").digits(3),
        Column::number("Nitric oxide", "g/h").digits(4),
        Column::number("Fuel", "kg/h").digits(5),
        Column::number("Fuel and smoothing", "kg/h").digits(5),
        Column::number("Price", "kg/h per g/h").digits(3),
        Column::number("Iterations", "").digits(4),
    ];
    let table = found.steps.iter().fold(Table::new(head), |t, s| {
        t.row(vec![
            s.share.into(),
            s.no_g_h.into(),
            s.fuel_kg_h.into(),
            s.minimised_kg_h.into(),
            s.price.into(),
            (s.iterations as f64).into(),
        ])
    });
    let text = format!(
        "Along the start of the cycle the inputs that the record begins with burn {:.4} kg/h. Fuel is made small with torque and lambda as they were, knock at most 0.3, and the mean flow of nitric oxide limited.",
        found.start_kg_h
    );
    report.section(Section::new("What less nitric oxide costs").text(text).block(table))
}
