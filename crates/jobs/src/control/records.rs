//! Records of tests as plants: spectra that no model stands behind, and linear models with their uncertainty.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use dynocal_control::error::ControlError;
use dynocal_control::identify::{ORDERS, identify};
use dynocal_control::response::{Response, Test, frequency_response};
use dynocal_control::system::Time;
use dynocal_files::dataset::read_dataset;
use dynocal_ident::stored::{Quantity, StoredModel};
use dynocal_numerics::watch::Watch;

use super::bed::{self, Distortion, tested};
use super::load::Loaded;
use super::result::ControlJobError;
use super::spec::{Job, Plants, Point};

/// Share of the samples at an end of its range from which an actuator counts as saturated in a closed loop.
const SATURATED: f64 = 0.1;
/// Free-run fit in percent below which a model says little.
const LITTLE: f64 = 50.0;

/// What one record shows.
#[derive(Clone, Debug)]
pub(super) struct Measured {
    /// By loop: what a multisine shows that is not linear; none where the test was none.
    pub(super) distortion: Vec<Option<Distortion>>,
    pub(super) response: Response,
    /// Orders of A and B of each output's model, and its free run over the half that chose them, in percent.
    pub(super) models: Vec<((usize, usize), f64)>,
}

/// One record in memory, deviations from its means.
pub(super) struct Record {
    pub(super) name: String,
    pub(super) inputs: Vec<(Quantity, Vec<f64>)>,
    pub(super) outputs: Vec<(Quantity, Vec<f64>)>,
    pub(super) demands: Vec<Vec<f64>>,
    pub(super) sample_time_s: f64,
}

pub(super) fn load(
    job: &Job,
    files: &[PathBuf],
    demands: &[String],
    segment_s: Option<f64>,
    watch: Watch,
) -> Result<Loaded, ControlJobError> {
    let mut out: Option<Loaded> = None;
    for (k, path) in files.iter().enumerate() {
        let record = read(job, path, demands)?;
        let refused = |source| ControlJobError::Record { file: path.display().to_string(), source };
        watch.fraction(0.1 * k as f64 / files.len() as f64);
        let time = Time::Sampled { sample_time_s: record.sample_time_s };
        let loaded = out.get_or_insert_with(|| Loaded::empty(time));
        if loaded.time != time {
            let found = record.sample_time_s;
            let what = "the sample time of a record beside others".into();
            return Err(refused(ControlError::Number {
                what,
                found,
                expected: "one sample time for all records",
            }));
        }
        taken(job, loaded, &record, (segment_s, k), Vec::new(), watch, &refused)?;
    }
    out.ok_or_else(|| ControlJobError::Record {
        file: job.name.clone(),
        source: ControlError::Model("no record was given".into()),
    })
}

/// Tests on a plant about its set points, as records.
pub(super) fn from_bed(job: &Job, watch: Watch) -> Result<Loaded, ControlJobError> {
    let Plants::Bed { plant, test, points } = &job.plants else {
        return Ok(Loaded::empty(Time::Continuous));
    };
    let mut loaded = Loaded::empty(Time::Sampled { sample_time_s: test.sample_time_s });
    loaded.channels = bed::units(plant);
    for (k, p) in points.iter().enumerate() {
        watch.note(&format!("{}: test on the plant", p.name));
        watch.fraction(0.1 * k as f64 / points.len() as f64);
        let (record, distortion) = tested(job, plant, test, p, k, watch)?;
        let refused = |source| ControlJobError::Point { point: p.name.clone(), source };
        taken(job, &mut loaded, &record, (None, k), distortion, watch, &refused)?;
    }
    Ok(loaded)
}

/// Spectra and models of a record, as a set point.
fn taken(
    job: &Job,
    loaded: &mut Loaded,
    record: &Record,
    (segment_s, number): (Option<f64>, usize),
    distortion: Vec<Option<Distortion>>,
    watch: Watch,
    refused: &dyn Fn(ControlError) -> ControlJobError,
) -> Result<(), ControlJobError> {
    watch.note(&format!("{}: spectra and models", record.name));
    let (response, warnings) = spectra(job, record, segment_s).map_err(refused)?;
    loaded.warnings.extend(warnings);
    let (models, found) = models(record, watch).map_err(|e| match watch.interrupted() {
        true => ControlJobError::Interrupted,
        false => refused(e),
    })?;
    for (l, (_, r2)) in job.loops.iter().zip(&found).filter(|(_, f)| f.1 < LITTLE) {
        loaded.warnings.push(format!(
            "{}: the model of `{}` explains {r2:.0} % of its movement in free run: margins of it say little",
            record.name, l.output
        ));
    }
    let units = record.outputs.iter().zip(&record.inputs).map(|(o, i)| (o.0.unit.clone(), i.0.unit.clone()));
    loaded.units = units.collect();
    loaded.measured.push(Measured { response, models: found, distortion });
    let values: BTreeMap<String, f64> = job.loops.iter().map(|l| (l.input.clone(), 0.0)).collect();
    loaded.add(job, &models, &Point { name: record.name.clone(), values }, number)
}

fn read(job: &Job, path: &Path, demands: &[String]) -> Result<Record, ControlJobError> {
    let inputs: Vec<&str> = job.loops.iter().map(|l| l.input.as_str()).collect();
    let outputs: Vec<&str> = job.loops.iter().map(|l| l.output.as_str()).collect();
    let all: Vec<&str> = inputs.iter().copied().chain(demands.iter().map(String::as_str)).collect();
    let d = read_dataset(path, &all, &outputs)?;
    let refused = |source| ControlJobError::Record { file: path.display().to_string(), source };
    let column = |name: &str| -> Result<(Quantity, Vec<f64>), ControlJobError> {
        let c = d.channel(name).map_err(|e| refused(ControlError::Model(e.to_string())))?;
        if let Some(k) = c.values.iter().position(|v| !v.is_finite()) {
            let what = format!("`{name}` in sample {}", k + 1);
            return Err(refused(ControlError::Number { what, found: c.values[k], expected: "a number" }));
        }
        let mean = c.values.iter().sum::<f64>() / c.values.len().max(1) as f64;
        let quantity = Quantity { name: name.into(), unit: c.unit.clone() };
        Ok((quantity, c.values.iter().map(|v| v - mean).collect()))
    };
    let columns = |names: &[&str]| names.iter().map(|n| column(n)).collect::<Result<Vec<_>, _>>();
    let found = Record {
        name: path.file_stem().map_or_else(|| d.name.clone(), |s| s.to_string_lossy().into_owned()),
        inputs: columns(&inputs)?,
        outputs: columns(&outputs)?,
        demands: columns(&demands.iter().map(String::as_str).collect::<Vec<_>>())?
            .into_iter()
            .map(|c| c.1)
            .collect(),
        sample_time_s: d.sample_time_s,
    };
    let length_s = d.len() as f64 * d.sample_time_s;
    if let Some(l) = job.loops.iter().find(|l| l.extra_delay_s >= length_s) {
        let what = format!("the delay of the loop of `{}` in s, against a record of {length_s} s", l.output);
        let expected = "less than the record lasts";
        return Err(refused(ControlError::Number { what, found: l.extra_delay_s, expected }));
    }
    Ok(found)
}

/// The response with what is to be said of it.
fn spectra(job: &Job, r: &Record, segment_s: Option<f64>) -> Result<(Response, Vec<String>), ControlError> {
    let columns = |c: &[(Quantity, Vec<f64>)]| c.iter().map(|c| c.1.clone()).collect::<Vec<_>>();
    let (inputs, outputs) = (columns(&r.inputs), columns(&r.outputs));
    let demands = (!r.demands.is_empty()).then_some(r.demands.as_slice());
    let test = Test { inputs: &inputs, outputs: &outputs, demands, sample_time_s: r.sample_time_s };
    let segment = segment_s.map(|s| (s / r.sample_time_s).round() as usize);
    let response = frequency_response(&test, segment)?;
    let mut warnings = Vec::new();
    for (k, l) in job.loops.iter().enumerate() {
        let share = at_an_end(&inputs[k]);
        if demands.is_some() && share > SATURATED {
            warnings.push(format!(
                "{}: `{}` stands at an end of its range in {:.0} % of the samples: a saturated actuator opens the loop, and the response is that of no linear plant",
                r.name, l.input, 100.0 * share
            ));
        }
        let n = response.frequency_hz.len();
        let seen = (0..n).filter(|f| response.coherence_at(*f, k) > 0.5).count();
        if 2 * seen < n {
            warnings.push(format!(
                "{}: the coherence of `{}` is above one half at {seen} of {n} frequencies: elsewhere the record shows noise",
                r.name, l.output
            ));
        }
    }
    Ok((response, warnings))
}

/// Share of the samples at the largest or at the least value.
fn at_an_end(x: &[f64]) -> f64 {
    let (low, high) = x.iter().fold((f64::INFINITY, f64::NEG_INFINITY), |(l, h), v| (l.min(*v), h.max(*v)));
    let slack = 1e-9 * (high - low);
    let ends = x.iter().filter(|v| **v - low <= slack || high - **v <= slack).count();
    ends as f64 / x.len().max(1) as f64
}

type Models = (Vec<StoredModel>, Vec<((usize, usize), f64)>);

fn models(r: &Record, watch: Watch) -> Result<Models, ControlError> {
    let (mut models, mut found) = (Vec::new(), Vec::new());
    for (quantity, y) in &r.outputs {
        let one =
            identify(&r.inputs, (quantity.clone(), y), r.sample_time_s, &ORDERS, &|| watch.interrupted())?;
        found.push((one.orders, one.selection_r2));
        models.push(one.model);
    }
    Ok((models, found))
}
