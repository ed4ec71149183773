//! The work: campaigns, and what they give in the numbers of the thesis.

use dynocal_calib::map::MapForm;
use dynocal_calib::map::structures::{InverseScore, r2};
use dynocal_calib::optimise::{OptimiseOptions, Way, optimise_record};
use dynocal_calib::problem::CalibrationProblem;
use dynocal_calib::validate::{MapScore, demand_steps, score};
use dynocal_files::dataset::read_dataset;
use dynocal_ident::data::{Channel, Dataset, Role};
use dynocal_ident::plan::{Plan, PlanChannel};
use dynocal_ident::plant::Plant;
use dynocal_ident::play::{Unwatched, play};
use dynocal_ident::stored::StoredModel;
use dynocal_jobs::calibrate::channels::Channels;
use dynocal_jobs::calibrate::job::{self, Campaign};
use dynocal_jobs::calibrate::records::RecordRef;
use dynocal_jobs::calibrate::run::ChainResult;
use dynocal_jobs::calibrate::spec::CalibrateSpec;
use dynocal_numerics::watch::Watch;
use serde::{Deserialize, Serialize};
use std::path::Path;

use super::{CALIBRATION, UNSEEN};
use crate::{StudyError, Surroundings};

/// Demanded outputs of the thesis.
pub(super) const OUTPUTS: [&str; 2] = ["torque", "lambda"];
/// Time before a record in s.
const LEAD_IN_S: f64 = 3.0;

/// What stands beside the thesis.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub(super) struct Found {
    /// Passes of the campaign: loops trim about the optimum.
    pub(super) passes: Vec<PassFound>,
    /// The identification record optimised, played without loops.
    pub(super) open: Vec<Open>,
    /// Inverse maps on the records that they learned from, and the delivered one's R2 by actuator on an optimal record of another
    /// campaign.
    pub(super) inverse: Vec<InverseScore>,
    pub(super) unseen: Vec<(String, Option<f64>)>,
    /// The map on the models.
    pub(super) on_models: Option<MapScore>,
    /// All maps on the engine.
    pub(super) maps: Vec<MapScore>,
    /// Bed times in s: of the dynamic map without the gains of the loops, which the static map needs as well, of its refinement (part of
    /// it), of the static map, of one identification record.
    pub(super) bed_s: f64,
    pub(super) refine_s: f64,
    pub(super) static_bed_s: Option<f64>,
    pub(super) record_s: f64,
}

/// A pass.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub(super) struct PassFound {
    /// Fuel over that of the start.
    pub(super) promised: f64,
    pub(super) measured: f64,
    /// R2 of what was measured against what was demanded, torque and lambda.
    pub(super) r2: [Option<f64>; 2],
    pub(super) usable: bool,
}

/// An optimisation of the identification record.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub(super) struct Open {
    pub(super) way: String,
    pub(super) rate: bool,
    pub(super) iterations: usize,
    /// Parts of the record, and those that were solved.
    pub(super) parts: usize,
    pub(super) solved: usize,
    /// Fuel over that of the start.
    pub(super) promised: f64,
    /// R2 of the engine's outputs against the demands with the optimal inputs alone.
    pub(super) r2: [Option<f64>; 2],
    /// Why there is nothing.
    pub(super) failed: Option<String>,
}

fn failed(reason: impl ToString) -> StudyError {
    StudyError::Task { what: CALIBRATION.into(), reason: reason.to_string() }
}

pub(super) fn calibrated(
    spec: &CalibrateSpec,
    reduced: bool,
    around: &Surroundings,
) -> Result<Found, StudyError> {
    let quiet = Watch { interrupt: around.watch.interrupt, ..Watch::silent() };
    let campaign = |name: &str, seed: u64| Campaign {
        name: name.into(),
        spec: CalibrateSpec { seed, ..spec.clone() },
        out: around.runs.join(name).into(),
    };
    let done = job::run(&campaign(CALIBRATION, spec.seed), "validate", quiet)?;
    let other = job::run(&campaign("unseen", spec.seed + UNSEEN), "optimise", quiet)?;
    let r = &done.result;
    let v = r.validate.as_ref().map(|d| &d.result);
    Ok(Found {
        passes: passes(r)?,
        open: opened(spec, r, reduced, around)?,
        inverse: r.invert.as_ref().map_or(Vec::new(), |d| d.result.scores.clone()),
        unseen: unseen(spec, r, &other.result)?,
        on_models: on_models(spec, r)?,
        maps: v.map_or(Vec::new(), |v| v.scores.clone()),
        bed_s: r.bed_s() - r.loops_bed_s(),
        refine_s: r.invert.as_ref().map_or(0.0, |d| d.result.refine_s),
        static_bed_s: v.map(|v| v.static_map.bed_s),
        record_s: spec.excite.record_s,
    })
}

fn read(folder: &Path, kept: &RecordRef, spec: &CalibrateSpec) -> Result<Dataset, StudyError> {
    let channels = Channels::of(spec);
    let inputs: Vec<&str> = channels.inputs.iter().chain(&channels.given).map(String::as_str).collect();
    let outputs = channels.outputs();
    let outputs: Vec<&str> = outputs.iter().map(String::as_str).collect();
    Ok(read_dataset(&folder.join(&kept.file), &inputs, &outputs)?)
}

fn passes(r: &ChainResult) -> Result<Vec<PassFound>, StudyError> {
    let Some(d) = &r.optimise else { return Ok(Vec::new()) };
    d.result
        .passes
        .iter()
        .map(|p| {
            let record = read_dataset(&d.folder.join(&p.records[1].file), &[], &OUTPUTS)?;
            let fit = |k: usize| -> Result<Option<f64>, StudyError> {
                let y = record.values(OUTPUTS[k]).map_err(failed)?;
                Ok(p.demands.get(k).and_then(|z| r2(&y[p.first..], &z[p.first..])))
            };
            Ok(PassFound {
                promised: p.promised_ratio,
                measured: p.measured_ratio,
                r2: [fit(0)?, fit(1)?],
                usable: p.usable,
            })
        })
        .collect()
}

/// Ways of section 7.5.3: all at once, and segments as published, with their seams smoothed.
fn ways(reduced: bool) -> Vec<(&'static str, Way, bool)> {
    let segments = |samples: u32| {
        let text = format!(
            "name = 'segments'\nlength_s = {}\nseam = {{ smoothed = {{ width_s = 0.12 }} }}",
            0.03 * f64::from(samples)
        );
        toml::from_str::<toml::Table>(&text).ok().and_then(|t| Way::try_from(t).ok()).unwrap_or_default()
    };
    let mut out = vec![("batch", Way::default(), true), ("segments of 100", segments(100), true)];
    if !reduced {
        out.push(("segments of 500", segments(500), true));
        out.push(("segments of 100", segments(100), false));
    }
    out.push(("batch", Way::default(), false));
    out
}

fn opened(
    spec: &CalibrateSpec,
    r: &ChainResult,
    reduced: bool,
    around: &Surroundings,
) -> Result<Vec<Open>, StudyError> {
    let (Some(excite), Some(models)) = (&r.excite, &r.identify) else { return Ok(Vec::new()) };
    let Some(kept) = excite.result.identification.first() else { return Ok(Vec::new()) };
    let start = read(&excite.folder, kept, spec)?;
    let chosen = models.result.chosen();
    ways(reduced)
        .into_iter()
        .map(|(name, way, rate)| {
            around
                .watch
                .note(&format!("  {name}, {} rate of the spark", if rate { "with" } else { "without" }));
            one(&spec.problem, &chosen, &start, (name, way, rate), around)
        })
        .collect()
}

fn one(
    problem: &CalibrationProblem,
    models: &[&StoredModel],
    start: &Dataset,
    (name, way, rate): (&str, Way, bool),
    around: &Surroundings,
) -> Result<Open, StudyError> {
    let mut problem = problem.clone();
    if !rate {
        problem.inputs.iter_mut().for_each(|i| i.rate_per_s = None);
    }
    let options = OptimiseOptions { way, ..OptimiseOptions::default() };
    let mut out = Open {
        way: name.into(),
        rate,
        iterations: 0,
        parts: 0,
        solved: 0,
        promised: f64::NAN,
        r2: [None, None],
        failed: None,
    };
    let found = match optimise_record(&problem, models, start, &options, around.watch.interrupt) {
        Ok(found) => found,
        Err(e) => {
            out.failed = Some(e.to_string());
            return Ok(out);
        }
    };
    if around.watch.interrupted() {
        return Err(StudyError::Interrupted);
    }
    out.iterations = found.iterations;
    out.parts = found.parts.len().max(1);
    let whole = usize::from(found.parts.is_empty() && found.status.is_success());
    out.solved = whole + found.parts.iter().filter(|p| p.status.is_success()).count();
    out.promised = found.objective / found.start_objective;
    let given = problem.given.iter().map(|g| start.channel(&g.name));
    let mut channels: Vec<PlanChannel> =
        found.inputs.iter().map(|c| PlanChannel::free(&c.name, &c.unit, c.values.clone())).collect();
    for g in given {
        let g = g.map_err(failed)?;
        channels.push(PlanChannel::free(&g.name, &g.unit, g.values.clone()));
    }
    let plan = Plan::open_loop(name, start.sample_time_s, channels).settled(LEAD_IN_S).recording(&OUTPUTS);
    let mut plant: Box<dyn Plant> = crate::chapter5::plant(false).map_err(failed)?;
    plant.reset(0);
    let record = play(plant.as_mut(), &plan, &mut Unwatched).and_then(|p| p.whole()).map_err(failed)?.record;
    for (k, output) in OUTPUTS.iter().enumerate() {
        let y = record.values(output).map_err(failed)?;
        let range = found.first..found.last.min(y.len());
        let demand = found.demands.iter().find(|d| d.name == *output);
        out.r2[k] = demand.and_then(|d| r2(&y[range.clone()], &d.values[range.clone()]));
    }
    Ok(out)
}

/// R2 of the delivered map by actuator on the last optimal record of another campaign.
fn unseen(
    spec: &CalibrateSpec,
    r: &ChainResult,
    other: &ChainResult,
) -> Result<Vec<(String, Option<f64>)>, StudyError> {
    let form = r.invert.as_ref().map(|d| d.result.dynamic.form());
    let (Some(MapForm::Terms(map)), Some(d)) = (form, &other.optimise) else { return Ok(Vec::new()) };
    let Some(last) = d.result.passes.last() else { return Ok(Vec::new()) };
    let record = read(&d.folder, &last.records[1], spec)?;
    let channels = Channels::of(spec);
    let response = channels.references(&record).map_err(failed)?;
    let actuators = channels.actuators(&record).map_err(failed)?;
    let mut u = vec![0.0; actuators.width()];
    let mut given = vec![Vec::new(); actuators.width()];
    for t in 0..response.len() {
        map.at(&response, t, &mut u);
        given.iter_mut().zip(&u).for_each(|(g, v)| g.push(*v));
    }
    Ok(channels
        .inputs
        .iter()
        .enumerate()
        .map(|(k, n)| (n.clone(), r2(&given[k], &actuators.column(k))))
        .collect())
}

/// The delivered map over the steps on the models of the last pass (section 7.6.3).
fn on_models(spec: &CalibrateSpec, r: &ChainResult) -> Result<Option<MapScore>, StudyError> {
    let (Some(invert), Some(optimise)) = (&r.invert, &r.optimise) else { return Ok(None) };
    let Some(last) = optimise.result.passes.last() else { return Ok(None) };
    let (problem, dt, asked) = (&spec.problem, spec.sample_time_s, &spec.validate.scenario);
    let steps = demand_steps(asked, problem, dt);
    let drive = invert.result.dynamic.drive(&steps.reference, dt);
    let channel =
        |name: &str, unit: &str, role, values| Channel { name: name.into(), unit: unit.into(), role, values };
    let moved = problem
        .inputs
        .iter()
        .enumerate()
        .map(|(k, i)| channel(&i.name, &i.unit, Role::Input, drive.column(k)));
    let given = problem.given.iter().enumerate().map(|(k, g)| {
        channel(&g.name, &g.unit, Role::Input, steps.reference.column(problem.demands.len() + k))
    });
    let mut record = Dataset {
        name: "steps on the models".into(),
        sample_time_s: dt,
        channels: moved.chain(given).collect(),
        init_samples: 0,
        origin: "models".into(),
    };
    let mut outputs = Vec::new();
    for model in last.models.chosen() {
        let Some(run) = model.simulate(&record, None).map_err(failed)?.into_iter().next() else {
            return Ok(None);
        };
        outputs.push(channel(&model.user_output().name, &model.user_output().unit, Role::Output, run.y));
    }
    record.channels.extend(outputs);
    let scores = score(asked, problem, &steps, &["dynamic map"], &[&record]).map_err(failed)?;
    Ok(scores.into_iter().next())
}
