//! Linear plants: stored models about their set points with draws, or transfer functions as given.

use std::collections::BTreeMap;

use dynocal_control::error::ControlError;
use dynocal_control::linear::{AtPoint as Linear, about, drawn};
use dynocal_control::system::{System, Time, Transfer};
use dynocal_files::json;
use dynocal_ident::stored::{MODEL_SCHEMA, MODEL_VERSION, StoredModel};
use dynocal_numerics::watch::Watch;

use super::loop_spec::MOST_LATE;
use super::records::Measured;
use super::result::ControlJobError;
use super::spec::{Job, Plants, Point};

/// The plants of one set point.
pub(super) struct AtPoint {
    pub(super) name: String,
    /// The model as it was estimated.
    pub(super) nominal: System,
    /// Draws of its parameters.
    pub(super) draws: Vec<System>,
}

/// All plants with what is to be said of them.
pub(super) struct Loaded {
    pub(super) time: Time,
    /// What was measured, for each set point that is a record.
    pub(super) measured: Vec<Measured>,
    /// Units of outputs and inputs of the loops, where they are known.
    pub(super) units: Vec<(String, String)>,
    /// Units of the channels that set points give, where they are known.
    pub(super) channels: BTreeMap<String, String>,
    pub(super) points: Vec<AtPoint>,
    /// Set points at which a model was not identified.
    pub(super) beyond: Vec<String>,
    /// What stands between the controllers and all these plants.
    pub(super) decoupler: Option<System>,
    pub(super) warnings: Vec<String>,
}

/// The plant without the extra delay of loops that predict it: leading zeros of the numerators taken off again.
pub(super) fn without_predicted(job: &Job, plant: &System) -> Result<System, ControlError> {
    let mut out = plant.clone();
    let dt_s = plant.time.sample_time_s().unwrap_or(1.0);
    for (k, l) in job.loops.iter().enumerate().filter(|(_, l)| l.predictor) {
        let n = (l.extra_delay_s / dt_s).round() as usize;
        for g in &mut out.channels[k * plant.inputs..(k + 1) * plant.inputs] {
            if !g.is_zero() {
                g.num.drain(..n.min(g.num.len().saturating_sub(1)));
            }
        }
    }
    System::new(plant.time, plant.outputs, plant.inputs, out.channels)
}

pub(super) fn load(job: &Job, watch: Watch) -> Result<Loaded, ControlJobError> {
    let mut loaded = plants(job, watch)?;
    loaded.decoupler = super::decouple::made(job, &loaded)?;
    Ok(loaded)
}

fn plants(job: &Job, watch: Watch) -> Result<Loaded, ControlJobError> {
    match &job.plants {
        Plants::Bed { .. } => super::records::from_bed(job, watch),
        Plants::Records { files, demands, segment_s } => {
            super::records::load(job, files, demands, *segment_s, watch)
        }
        Plants::Given { time, plants } => {
            let mut points = Vec::new();
            for p in plants {
                let n = job.loops.len();
                let nominal = System::new(*time, n, n, p.channels.clone()).and_then(|s| delayed(job, s));
                let refused = |source| ControlJobError::Point { point: p.name.clone(), source };
                points.push(AtPoint {
                    name: p.name.clone(),
                    nominal: nominal.map_err(refused)?,
                    draws: Vec::new(),
                });
            }
            Ok(Loaded { points, ..Loaded::empty(*time) })
        }
        Plants::Models { files, points } => {
            let models = models(job, files)?;
            let mut out = Loaded::empty(Time::Sampled { sample_time_s: models[0].sample_time_s });
            let unit = |l: &super::spec::LoopSpec, m: &StoredModel| {
                let inputs = m.measured_inputs();
                let own = inputs.iter().find(|q| q.name == l.input).map_or("-", |q| q.unit.as_str());
                (m.user_output().unit, own.to_string())
            };
            let all = models.iter().flat_map(StoredModel::measured_inputs);
            out.channels = all.map(|q| (q.name, q.unit)).collect();
            out.units = job.loops.iter().zip(&models).map(|(l, m)| unit(l, m)).collect();
            if job.draws > 0 {
                for m in models.iter().filter(|m| m.covariance().is_none()) {
                    out.warnings.push(format!(
                        "the model of `{}` keeps no covariance of its parameters: its draws are all alike, and margins over draws say nothing of its uncertainty",
                        m.user_output().name
                    ));
                }
            }
            for (k, p) in points.iter().enumerate() {
                if watch.interrupted() {
                    return Err(ControlJobError::Interrupted);
                }
                watch.fraction(0.1 * k as f64 / points.len() as f64);
                out.add(job, &models, p, k)?;
            }
            Ok(out)
        }
    }
}

/// The models in the order of the loops.
fn models(job: &Job, files: &[std::path::PathBuf]) -> Result<Vec<StoredModel>, ControlJobError> {
    let mut all: Vec<(String, StoredModel)> = Vec::new();
    for path in files {
        let file = path.display().to_string();
        let model: StoredModel = json::read_versioned(path, MODEL_SCHEMA, MODEL_VERSION)?;
        model.check().map_err(|source| ControlJobError::Model { file: file.clone(), source })?;
        let output = model.user_output().name;
        if all.iter().any(|(o, _)| *o == output) {
            return Err(ControlJobError::Twice { file, output });
        }
        all.push((output, model));
    }
    let names = |n: Vec<&str>| n.iter().map(|n| format!("`{n}`")).collect::<Vec<_>>().join(", ");
    job.loops
        .iter()
        .map(|l| {
            let known = || names(all.iter().map(|(o, _)| o.as_str()).collect());
            let missing = || ControlJobError::NoModel { output: l.output.clone(), known: known() };
            let model = &all.iter().find(|(o, _)| *o == l.output).ok_or_else(missing)?.1;
            let inputs = model.measured_inputs();
            if !inputs.iter().any(|q| q.name == l.input) {
                let known = names(inputs.iter().map(|q| q.name.as_str()).collect());
                return Err(ControlJobError::NoInput {
                    output: l.output.clone(),
                    input: l.input.clone(),
                    known,
                });
            }
            Ok(model.clone())
        })
        .collect()
}

impl Loaded {
    pub(super) fn empty(time: Time) -> Self {
        let (points, warnings) = (Vec::new(), Vec::new());
        Self {
            time,
            points,
            warnings,
            decoupler: None,
            measured: Vec::new(),
            units: Vec::new(),
            beyond: Vec::new(),
            channels: BTreeMap::new(),
        }
    }

    pub(super) fn add(
        &mut self,
        job: &Job,
        models: &[StoredModel],
        p: &Point,
        k: usize,
    ) -> Result<(), ControlJobError> {
        let moved: Vec<String> = job.loops.iter().map(|l| l.input.clone()).collect();
        let refused = |source| ControlJobError::Point { point: p.name.clone(), source };
        let at = |models: &[StoredModel]| {
            let models: Vec<&StoredModel> = models.iter().collect();
            about(&models, &moved, &p.values)
        };
        let nominal = at(models).map_err(refused)?;
        if !nominal.warnings.is_empty() {
            self.beyond.push(p.name.clone());
        }
        self.warnings.extend(nominal.warnings.iter().map(|w| format!("{}: {w}", p.name)));
        let mut draws = Vec::new();
        let (mut restless, mut unstable) = (0, 0);
        // A factor that numerator and denominator nearly share may lie outside in a draw: that is no plant which came to rest in the test.
        let runs_away = |found: &Linear| nominal.slowest_pole < 1.0 && found.slowest_pole >= 1.0;
        let unknown =
            |m: &&StoredModel| m.covariance().is_none() || m.parameters.iter().any(|p| p.std_error.is_none());
        let sure = models.iter().filter(unknown).map(|m| m.user_output().name.clone());
        let sure: Vec<String> = sure.map(|name| format!("`{name}`")).collect();
        if job.draws > 0 && !sure.is_empty() {
            self.warnings.push(format!(
                "{}: the model of {} has parameters without a deviation: they are the same in all draws, and margins over draws say less than they seem to",
                p.name,
                sure.join(", ")
            ));
        }
        for d in 0..job.draws {
            // One stream for each model, set point and draw: equal for any order.
            let own = |(i, m): (usize, &StoredModel)| {
                let stream = ((k * job.draws + d) * models.len() + i) as u64;
                drawn(m, job.seed, stream).unwrap_or_else(|| m.clone())
            };
            let these: Vec<StoredModel> = models.iter().enumerate().map(own).collect();
            match at(&these) {
                Ok(found) if runs_away(&found) => unstable += 1,
                Ok(found) => draws.push(delayed(job, found.system).map_err(refused)?),
                Err(_) => restless += 1,
            }
        }
        if restless > 0 {
            self.warnings.push(format!(
                "{}: {restless} of {} draws of the parameters do not come to rest and are left out",
                p.name, job.draws
            ));
        }
        if unstable > 0 {
            self.warnings.push(left_out(&p.name, unstable, job.draws));
        }
        self.points.push(AtPoint {
            name: p.name.clone(),
            nominal: delayed(job, nominal.system).map_err(refused)?,
            draws,
        });
        Ok(())
    }
}

/// Draws that are unstable by themselves where the model is not.
fn left_out(point: &str, unstable: usize, draws: usize) -> String {
    let many = match 2 * unstable > draws {
        true => {
            ": most of them, so that what is judged over draws says little; the test is too short or too noisy for the orders of the model"
        }
        false => "",
    };
    format!(
        "{point}: {unstable} of {draws} draws of the parameters are unstable by themselves where the model is stable, and are left out{many}"
    )
}

/// With the delay from measurement to actuator, and that which loops have beyond.
fn delayed(job: &Job, plant: System) -> Result<System, ControlError> {
    let whole = |delay_s: f64, sample_time_s: f64| {
        let found = delay_s / sample_time_s;
        if (found - found.round()).abs() < 1e-6 {
            return Ok(found.round() as usize);
        }
        let what = format!("the delay {delay_s} s in samples of {sample_time_s} s");
        Err(ControlError::Number { what, found, expected: "a whole number" })
    };
    let own = |extra_delay_s: f64| match plant.time {
        Time::Continuous => Ok(Transfer::gain(1.0).delayed(extra_delay_s)),
        Time::Sampled { sample_time_s } => {
            let mut num = vec![0.0; whole(extra_delay_s, sample_time_s)? + job.reaction_samples];
            num.push(1.0);
            Ok(Transfer::sampled(&num, &[1.0]))
        }
    };
    if let Time::Sampled { sample_time_s } = plant.time {
        for (k, g) in plant.channels.iter().enumerate() {
            let l = &job.loops[k / plant.inputs];
            let own = whole(g.delay_s, sample_time_s)? + g.num.len();
            let found = (own + whole(l.extra_delay_s, sample_time_s)? + job.reaction_samples) as f64;
            if found > MOST_LATE {
                return Err(ControlError::Number {
                    what: format!(
                        "samples by which `{}` is late; check the unit of its delay, or take longer samples",
                        l.output
                    ),
                    found,
                    expected: "at most 1000",
                });
            }
        }
    }
    let factors = job.loops.iter().map(|l| own(l.extra_delay_s)).collect::<Result<Vec<Transfer>, _>>()?;
    plant.after(&factors)
}
