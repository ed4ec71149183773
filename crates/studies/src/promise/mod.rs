//! Study `promise`: whole calibrations on real beds with noise, ten seeds of three parameter sets. What the last optimum promised to save
//! beside what was measured; bed time beyond that of the static map; whether a map that may be used holds lambda better than its rivals.
//!
//! The specs are the shipped examples, that of the thesis on its real bed.

mod judge;

use std::path::Path;

use dynocal_calib::validate::{DemandScore, MapScore};
use dynocal_jobs::calibrate::job;
use dynocal_jobs::calibrate::validate_step::DYNAMIC;
use dynocal_numerics::registry::MemberDoc;
use dynocal_numerics::watch::Watch;
use serde::{Deserialize, Serialize};
use serde_json::json;

use crate::{Options, Study, StudyError, Surroundings, Task, TaskResult};

pub(super) const STUDY: Study = Study {
    doc: MemberDoc {
        name: "promise",
        what: "Whole calibrations on real beds, ten seeds of three engines: promised beside measured saving, bed time, rivals",
        params: &[],
    },
    tasks,
    reduce: judge::reduce,
    sections: judge::sections,
};

const SEEDS: u64 = 10;
/// How a case is made: another number with every change of the procedure.
const METHOD: usize = 2;

/// A parameter set with the spec of its calibration.
struct Engine {
    name: &'static str,
    /// Its calibration, and the fuelling that it names.
    spec: &'static str,
    fuelling: Option<&'static str>,
    /// Keys that are added to the spec.
    keys: &'static str,
    /// Bed time that is asked beyond that of the static map, in s.
    most_bed_s: f64,
}

/// Name of the spec of the fuelling in the examples.
const FUELLING: &str = "fuelling.toml";

static ENGINES: [Engine; 3] = [
    Engine {
        name: "thesis",
        spec: include_str!("../../../../examples/gtdi/calibrate.toml"),
        fuelling: None,
        keys: "[plant.bed]\nreal = true\n",
        most_bed_s: 600.0,
    },
    Engine {
        name: "pfi_1_6l",
        spec: include_str!("../../../../examples/pfi_1_6l/calibrate.toml"),
        fuelling: Some(include_str!("../../../../examples/pfi_1_6l/fuelling.toml")),
        keys: "",
        most_bed_s: 600.0,
    },
    Engine {
        name: "gtdi_2l",
        spec: include_str!("../../../../examples/gtdi_2l/calibrate.toml"),
        fuelling: Some(include_str!("../../../../examples/gtdi_2l/fuelling.toml")),
        keys: "",
        most_bed_s: 1800.0,
    },
];
/// A run so short that its numbers mean nothing.
const SHORTEST: &str = include_str!("../shortest.toml");

/// A pass of the optimisation: objective over that of the start.
#[derive(Clone, Debug, Serialize, Deserialize)]
struct Promised {
    usable: bool,
    promised: f64,
    measured: f64,
}

impl Promised {
    /// Points between promise and measurement.
    fn gap(&self) -> f64 {
        100.0 * (self.measured - self.promised)
    }
}

/// The delivered map over the best rival of the same scenario, where fuel or demand is lambda.
#[derive(Clone, Debug, Serialize, Deserialize)]
struct Beside {
    scenario: String,
    integral: f64,
    spike: f64,
    /// Integral of the error of the leading demand.
    torque: f64,
    /// The rival that is better in both, where there is one.
    beaten_by: Option<String>,
}

/// A calibration.
#[derive(Clone, Debug, Serialize, Deserialize)]
struct Case {
    engine: String,
    seed: u64,
    /// Why there is none.
    failed: Option<String>,
    valid: bool,
    verdict: String,
    passes: Vec<Promised>,
    /// Beyond the gains of the loops, which the static map needs as well; those; the static map's points.
    bed_s: f64,
    loops_s: f64,
    static_s: f64,
    lambda: Vec<Beside>,
}

fn tasks(o: &Options) -> Vec<Task> {
    let engines = if o.reduced { &ENGINES[..1] } else { &ENGINES[..] };
    let seeds = if o.reduced { 1 } else { SEEDS };
    let reduced = o.reduced;
    let all = engines.iter().flat_map(|e| (o.seed..o.seed + seeds).map(move |seed| (e, seed)));
    let task = |(engine, seed): (&'static Engine, u64)| {
        let spec = text(engine, reduced);
        Task {
            name: format!("{}-{seed}", engine.name),
            inputs: json!([METHOD, engine.name, seed, spec, engine.fuelling]),
            run: Box::new(move |around: &Surroundings| {
                let case = case(engine, seed, &spec, around)?;
                serde_json::to_value(case).map_err(|e| refused(engine.name, e.to_string()))
            }),
        }
    };
    all.map(task).collect()
}

fn text(engine: &Engine, reduced: bool) -> String {
    let spec = if reduced { SHORTEST } else { engine.spec };
    if engine.keys.is_empty() { spec.to_string() } else { format!("{spec}\n{}", engine.keys) }
}

fn refused(what: &str, reason: String) -> StudyError {
    StudyError::Task { what: what.into(), reason }
}

/// A calibration; what fails in it is its result, and not the end of the study.
fn case(engine: &Engine, seed: u64, spec: &str, around: &Surroundings) -> Result<Case, StudyError> {
    let folder = around.runs.join(format!("{}-{seed}", engine.name));
    // The spec names its fuelling by a path that is relative to it.
    let beside = around.runs.join(engine.name);
    if let Some(fuelling) = engine.fuelling {
        dynocal_files::atomic::write(&beside.join(FUELLING), fuelling.as_bytes())?;
    }
    let file = beside.join("calibrate.toml");
    let campaign = job::parse(&file.display().to_string(), spec, Some(seed), Some(Path::new(&folder)))
        .map_err(|e| refused(engine.name, e.to_string()))?;
    let note = |text: &str| around.watch.note(&format!("  {text}"));
    let watch = Watch { interrupt: around.watch.interrupt, note: &note, ..Watch::silent() };
    let mut out = Case {
        engine: engine.name.into(),
        seed,
        failed: None,
        valid: false,
        verdict: String::new(),
        passes: Vec::new(),
        bed_s: 0.0,
        loops_s: 0.0,
        static_s: 0.0,
        lambda: Vec::new(),
    };
    match job::run(&campaign, "validate", watch) {
        Ok(done) => filled(&mut out, &done),
        Err(e) if around.watch.interrupted() => return Err(e.into()),
        Err(e) => out.failed = Some(e.to_string()),
    }
    Ok(out)
}

fn filled(out: &mut Case, done: &job::Finished) {
    let r = &done.result;
    (out.valid, out.verdict) = (done.valid, done.verdict.clone());
    (out.bed_s, out.loops_s) = (r.bed_s() - r.loops_bed_s(), r.loops_bed_s());
    for p in r.optimise.iter().flat_map(|d| &d.result.passes) {
        let (promised, measured) = (p.promised_ratio, p.measured_ratio);
        out.passes.push(Promised { usable: p.usable, promised, measured });
    }
    if let Some(v) = r.validate.as_ref().map(|d| &d.result) {
        out.static_s = v.static_map.bed_s;
        out.lambda =
            v.scores.iter().filter(|s| s.map == DYNAMIC).filter_map(|s| beside(s, &v.scores)).collect();
    }
}

/// The delivered map beside the best of its rivals in its scenario; none where lambda is no demand.
fn beside(own: &MapScore, all: &[MapScore]) -> Option<Beside> {
    let mine = own.demand("lambda")?;
    // The same map with another fuel is no rival.
    let rival = |s: &MapScore| {
        s.scenario == own.scenario && !s.map.contains(DYNAMIC) && !s.map.starts_with("same map")
    };
    let rivals: Vec<(&str, &DemandScore)> =
        all.iter().filter(|s| rival(s)).filter_map(|s| Some((s.map.as_str(), s.demand("lambda")?))).collect();
    let best = |of: fn(&DemandScore) -> f64| rivals.iter().map(|r| of(r.1)).reduce(f64::min);
    let leading = |s: &MapScore| s.demands.first().map(|d| d.integral_s);
    let torque = all.iter().filter(|s| rival(s)).filter_map(leading).reduce(f64::min)?;
    let beaten_by = rivals.iter().find(|(_, d)| d.integral_s < mine.integral_s && d.spike() < mine.spike());
    Some(Beside {
        scenario: own.scenario.clone(),
        integral: mine.integral_s / best(|d| d.integral_s)?,
        spike: mine.spike() / best(DemandScore::spike)?,
        torque: leading(own)? / torque,
        beaten_by: beaten_by.map(|r| r.0.to_string()),
    })
}

fn cases(results: &[TaskResult]) -> Vec<Case> {
    results.iter().filter_map(|r| serde_json::from_value(r.value.clone()).ok()).collect()
}
