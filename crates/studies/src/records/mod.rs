//! Study `records`: what a minute of bed tells the models of a calibration, by how its record was made and by how rich the models may be.
//!
//! One task per engine and seed. Models are judged by their free runs on records that neither estimated nor chose; an error counts as the
//! minutes of bed that records of random levels, of which nothing was tuned, need for the same one.

mod arms;
mod judge;

use std::cmp::Ordering;
use std::path::Path;

use dynocal_jobs::calibrate::job;
use dynocal_jobs::calibrate::models::{Candidate, ModelsResult, OutputModels};
use dynocal_numerics::registry::MemberDoc;
use dynocal_numerics::watch::Watch;
use serde::{Deserialize, Serialize};
use serde_json::json;

use crate::{Options, Study, StudyError, Surroundings, Task, TaskResult};
use arms::{ARMS, Arm, ENGINES, Engine};

pub(super) const STUDY: Study = Study {
    doc: MemberDoc {
        name: "records",
        what: "What a minute of bed tells the models of a calibration: levels, designs, lack of fit, sizes of models, in minutes of random levels",
        params: &[],
    },
    tasks,
    reduce: judge::reduce,
    sections: judge::sections,
};

/// Seeds of an engine.
const SEEDS: u64 = 5;
/// How a case is made: another number with every change of the procedure.
const METHOD: usize = 2;

/// Error of the models of one arm.
#[derive(Clone, Debug, Serialize, Deserialize)]
struct Scored {
    arm: String,
    /// Bed time of the records that estimate, in s.
    bed_s: f64,
    /// Root mean square errors of the free runs on the judging records, by output; none where one diverged.
    rmse: Vec<(String, Option<f64>)>,
    /// What the lack of fit said, where it was asked.
    choice: Vec<String>,
}

impl Scored {
    /// Mean of the logarithms of the errors; none where a model diverged.
    fn log_error(&self) -> Option<f64> {
        let logs: Option<Vec<f64>> = self.rmse.iter().map(|(_, v)| v.map(f64::ln)).collect();
        logs.filter(|l| !l.is_empty()).map(|l| l.iter().sum::<f64>() / l.len() as f64)
    }
}

/// All arms of one engine and seed.
#[derive(Clone, Debug, Serialize, Deserialize)]
struct Case {
    engine: String,
    seed: u64,
    arms: Vec<Scored>,
    /// Arms that did not end, and why.
    failed: Vec<(String, String)>,
}

impl Case {
    fn arm(&self, name: &str) -> Option<&Scored> {
        self.arms.iter().find(|a| a.arm == name)
    }
}

fn tasks(o: &Options) -> Vec<Task> {
    let engines = if o.reduced { &ENGINES[..1] } else { &ENGINES[..] };
    let seeds = if o.reduced { 2 } else { SEEDS };
    let reduced = o.reduced;
    let all = engines.iter().flat_map(|e| (o.seed..o.seed + seeds).map(move |seed| (e, seed)));
    let task = |(engine, seed): (&'static Engine, u64)| Task {
        name: format!("{}-{seed}", engine.name),
        inputs: json!([METHOD, engine.name, seed, engine.texts(reduced), engine.fuelling]),
        run: Box::new(move |around: &Surroundings| {
            let case = case(engine, seed, reduced, around)?;
            serde_json::to_value(case).map_err(|e| refused(engine.name, e.to_string()))
        }),
    };
    all.map(task).collect()
}

fn refused(what: &str, reason: String) -> StudyError {
    StudyError::Task { what: what.into(), reason }
}

fn case(engine: &Engine, seed: u64, reduced: bool, around: &Surroundings) -> Result<Case, StudyError> {
    let mut out = Case { engine: engine.name.into(), seed, arms: Vec::new(), failed: Vec::new() };
    let place = around.runs.join(format!("{}-{seed}", engine.name));
    if let Some(fuelling) = engine.fuelling {
        dynocal_files::atomic::write(&place.join(FUELLING), fuelling.as_bytes())?;
    }
    // Who injects is identified once.
    let mut model = None;
    for arm in ARMS.iter().filter(|a| a.counts(reduced)) {
        if around.watch.interrupted() {
            return Err(StudyError::Interrupted);
        }
        around.watch.note(&format!("  {}, seed {seed}: {}", engine.name, arm.name));
        let text = engine.text(arm, reduced, model.as_deref()).map_err(|e| refused(engine.name, e))?;
        match scored(&place, arm, seed, &text, around) {
            Ok(scored) => out.arms.push(scored),
            Err(e @ StudyError::Interrupted) => return Err(e),
            Err(e) => out.failed.push((arm.name.into(), e.to_string())),
        }
        let found = place.join(arm.name).join(IDENTIFIED);
        if model.is_none() && found.is_file() {
            model = Some(format!("{}/{IDENTIFIED}", arm.name));
        }
    }
    Ok(out)
}

/// Name of the spec of the fuelling, and where a run leaves what it identified.
const FUELLING: &str = "fuelling.toml";
const IDENTIFIED: &str = "steps/01-excite/fuelling/fuelling.json";

fn scored(
    place: &Path,
    arm: &Arm,
    seed: u64,
    text: &str,
    around: &Surroundings,
) -> Result<Scored, StudyError> {
    let file = place.join("calibrate.toml");
    let campaign = job::parse(&file.display().to_string(), text, Some(seed), Some(&place.join(arm.name)))
        .map_err(|e| refused(arm.name, e.to_string()))?;
    let watch = Watch { interrupt: around.watch.interrupt, ..Watch::silent() };
    let until = if arm.design.is_some() { "design" } else { "identify" };
    let done = match job::run(&campaign, until, watch) {
        Ok(done) => done,
        Err(_) if around.watch.interrupted() => return Err(StudyError::Interrupted),
        Err(e) => return Err(refused(arm.name, e.to_string())),
    };
    let r = &done.result;
    let excite_s = r.excite.as_ref().map_or(0.0, |d| d.result.identification_bed_s);
    let (models, bed_s, choice) = match (&r.design, &r.identify) {
        (Some(d), _) if arm.design.is_some() => {
            if d.result.records.is_empty() {
                return Err(refused(arm.name, d.result.left_out.clone()));
            }
            (&d.result.models, excite_s + d.result.bed_s, d.result.choice.clone())
        }
        (_, Some(d)) => (&d.result, excite_s, Vec::new()),
        _ => return Err(refused(arm.name, "no models".into())),
    };
    Ok(Scored { arm: arm.name.into(), bed_s, rmse: errors(models), choice })
}

/// Errors on the records that neither estimated nor chose, of models that were estimated from all records: an earlier one that goes on
/// in their place is a net that records of random levels do not have.
fn errors(models: &ModelsResult) -> Vec<(String, Option<f64>)> {
    let one = |o: &OutputModels| {
        let worth = |c: &&Candidate| (c.unstable_share == 0.0, c.choosing_r2.unwrap_or(f64::NEG_INFINITY));
        let own = o.candidates.iter().filter(|c| !c.earlier);
        let best = match o.best() {
            best if !best.earlier => best,
            best => {
                own.max_by(|a, b| worth(a).partial_cmp(&worth(b)).unwrap_or(Ordering::Equal)).unwrap_or(best)
            }
        };
        let judging =
            best.scores.iter().filter(|s| !s.chooses && s.data == dynocal_ident::validate::Seen::Unseen);
        let squares: Option<Vec<f64>> = judging.map(|s| s.rmse.map(|v| v * v)).collect();
        let mean = squares.filter(|s| !s.is_empty()).map(|s| (s.iter().sum::<f64>() / s.len() as f64).sqrt());
        (o.output.clone(), mean)
    };
    models.outputs.iter().map(one).collect()
}

fn cases(results: &[TaskResult]) -> Vec<Case> {
    results.iter().filter_map(|r| serde_json::from_value(r.value.clone()).ok()).collect()
}
