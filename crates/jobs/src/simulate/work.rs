//! The work: read models and records, run every model on every record.

use std::path::Path;

use dynocal_files::dataset::{ChannelSpec, Layout, Select, Time, datasets, read_table};
use dynocal_files::{json, measurement};
use dynocal_ident::data::{Dataset, Role};
use dynocal_ident::stored::{Computed, MODEL_SCHEMA, MODEL_VERSION, Quantity, StoredModel};
use dynocal_ident::validate::departure;
use dynocal_numerics::interval::Interval;
use dynocal_numerics::watch::Watch;

use super::result::{Left, Output, SimulateError, Simulated, Used};
use super::spec::Job;
use crate::estimate::Estimate;

/// A model and the file that it came from.
struct Named {
    file: String,
    model: StoredModel,
}

/// Simulates in memory.
///
/// # Errors
/// [`SimulateError`]: files, channels, units, a start that needs outputs which are not there, an interruption.
pub fn simulate(job: &Job, watch: Watch) -> Result<Simulated, SimulateError> {
    let models: Vec<Named> = job.models.iter().map(|f| named(f)).collect::<Result<_, _>>()?;
    alone(&models)?;
    let mut records = Vec::new();
    for file in &job.data {
        watch.note(&format!("reading {}", file.display()));
        records.extend(read(file, &models, job, &|text| watch.note(text))?);
    }
    let (mut outputs, mut warnings) = (Vec::new(), Vec::new());
    for (k, named) in models.iter().enumerate() {
        for (i, record) in records.iter().enumerate() {
            if watch.interrupted() {
                return Err(SimulateError::Interrupted);
            }
            watch.fraction((k * records.len() + i) as f64 / (models.len() * records.len()) as f64);
            let refused = |source| SimulateError::Model { file: named.file.clone(), source };
            let computed = named.model.simulate(record, job.start).map_err(refused)?;
            let leaves = named.model.outside(record);
            warnings.extend(leaves.iter().map(|o| format!("{}: {}", record.name, o.sentence())));
            for c in computed {
                warnings.extend(c.remarks.iter().cloned());
                outputs.push(output(&named.model, c));
            }
        }
    }
    let diverged: Vec<String> = outputs.iter().filter_map(divergence).collect();
    let valid = diverged.is_empty();
    warnings.splice(0..0, diverged);
    let used = models.iter().map(used).collect();
    Ok(Simulated {
        verb: "simulate",
        name: job.name.clone(),
        valid,
        warnings,
        models: used,
        outputs,
        files: Vec::new(),
        records,
    })
}

/// What the simulation will do, and what it takes: the records with a copy for each model.
///
/// # Errors
/// [`SimulateError`]: models and records that cannot be read or do not fit.
pub fn estimate(job: &Job) -> Result<Estimate, SimulateError> {
    let models: Vec<Named> = job.models.iter().map(|f| named(f)).collect::<Result<_, _>>()?;
    alone(&models)?;
    let mut plan = Estimate::new(&job.name).line("run folder", job.out.display().to_string());
    for n in &models {
        let text = format!("{}, {} parameters", n.model.user_output().name, n.model.theta().len());
        plan = plan.line(format!("model {}", n.file), text);
    }
    let parameters: usize = models.iter().map(|n| n.model.theta().len()).sum();
    for file in &job.data {
        let records = read(file, &models, job, &|_| ())?;
        for (n, d) in models.iter().flat_map(|n| records.iter().map(move |d| (n, d))) {
            let refused = |source| SimulateError::Model { file: n.file.clone(), source };
            n.model.takes(d, job.start).map_err(refused)?;
        }
        let samples: usize = records.iter().map(Dataset::len).sum();
        let channels = records.first().map_or(0, |d| d.channels.len());
        plan = plan
            .line(format!("data {}", file.display()), format!("{} records, {samples} samples", records.len()))
            .memory(8.0 * (samples * (2 * channels + 3 * models.len())) as f64)
            .work(2.0 * (samples * parameters) as f64);
    }
    Ok(plan)
}

fn named(path: &Path) -> Result<Named, SimulateError> {
    let file = path.display().to_string();
    let model: StoredModel = json::read_versioned(path, MODEL_SCHEMA, MODEL_VERSION)?;
    model.check().map_err(|source| SimulateError::Model { file: file.clone(), source })?;
    Ok(Named { file, model })
}

fn used(n: &Named) -> Used {
    let output = n.model.user_output();
    Used {
        file: n.file.clone(),
        output: output.name,
        unit: output.unit,
        inputs: n.model.measured_inputs().into_iter().map(|q| q.name).collect(),
        parameters: n.model.theta().len(),
    }
}

/// No output twice, and none that is the input of another model.
fn alone(models: &[Named]) -> Result<(), SimulateError> {
    for (k, n) in models.iter().enumerate() {
        let output = n.model.user_output().name;
        if let Some(other) = models[..k].iter().find(|o| o.model.user_output().name == output) {
            return Err(SimulateError::Twice { file: n.file.clone(), output, other: other.file.clone() });
        }
        for other in models.iter().filter(|o| o.file != n.file) {
            let input = other.model.user_output().name;
            if n.model.measured_inputs().iter().any(|q| q.name == input) {
                return Err(SimulateError::Driven { file: n.file.clone(), input, other: other.file.clone() });
            }
        }
    }
    Ok(())
}

/// The records of a file: columns have the names of the channels, units are converted where they differ. Outputs are
/// read where the file has them.
fn read(
    file: &Path,
    models: &[Named],
    job: &Job,
    tell: &dyn Fn(&str),
) -> Result<Vec<Dataset>, SimulateError> {
    let table = read_table(file, None)?;
    table.notes.iter().for_each(|n| tell(n));
    let mut channels: Vec<ChannelSpec> = Vec::new();
    let mut add = |q: Quantity, role: Role| {
        if !channels.iter().any(|c| c.name == q.name) {
            channels.push(ChannelSpec {
                column: q.name.clone(),
                name: q.name,
                unit: Some(q.unit),
                convert: true,
                role,
            });
        }
    };
    for n in models {
        n.model.measured_inputs().into_iter().for_each(|q| add(q, Role::Input));
        let output = n.model.user_output();
        if table.column(&output.name).is_ok() {
            add(output, Role::Output);
        }
    }
    let stamps = measurement::time_column(&table).map(|c| c.name.clone());
    let time = match (stamps, models.first()) {
        (None, Some(n)) => Time::Sampled { sample_time_s: n.model.sample_time_s },
        (column, _) => Time::Column { column: column.unwrap_or("time".into()), unit: None },
    };
    let layout = Layout { channels, time, init_samples: job.init_samples, ..Layout::default() };
    let mut records = datasets(&table, &layout, &Select::All)?;
    if job.data.len() > 1 {
        let stem = file.file_stem().map(|s| s.to_string_lossy().into_owned()).unwrap_or_default();
        records.iter_mut().for_each(|d| d.name = format!("{stem}-{}", d.name));
    }
    Ok(records)
}

/// What a run without a single value is.
const NO_REST: &str = "has no rest to start from (the model does not settle under the first inputs; a record with the measured output \
                       and `start = \"measured\"` would do)";

/// Whether the free run stays near what was ever measured of the output: in the record, else in the identification.
fn output(model: &StoredModel, c: Computed) -> Output {
    let q = model.user_output();
    let seen = model.seen.iter().filter(|s| s.name == q.name).flat_map(|s| [s.minimum, s.maximum]);
    let range = seen.chain(c.measured.iter().flatten().copied());
    let departure = departure(&c.y, range, |_| true).map(|d| Left {
        sample: d.sample,
        words: if c.y.iter().any(|v| v.is_finite()) { d.words() } else { NO_REST.into() },
    });
    let diverged_at = c.y.iter().position(|v| !v.is_finite());
    let finite = &c.y[..diverged_at.unwrap_or(c.y.len())];
    let range = (!finite.is_empty()).then(|| Interval::spanning(finite.iter().copied()));
    let rmse = c.measured.as_ref().filter(|_| diverged_at.is_none()).and_then(|z| {
        let errors: Vec<f64> = z.iter().zip(&c.y).skip(c.first).map(|(z, y)| z - y).collect();
        let squares: f64 = errors.iter().map(|e| e * e).sum();
        (!errors.is_empty()).then(|| (squares / errors.len() as f64).sqrt())
    });
    Output {
        record: c.record,
        output: q.name.clone(),
        unit: q.unit.clone(),
        samples: c.y.len(),
        sample_time_s: c.sample_time_s,
        range,
        diverged_at,
        departure,
        rmse,
        y: c.y,
        measured: c.measured,
    }
}

fn divergence(o: &Output) -> Option<String> {
    let left = o.departure.as_ref()?;
    let time_s = left.sample as f64 * o.sample_time_s;
    Some(format!(
        "{}: the free run of `{}` {}, from {time_s} s (sample {}) on",
        o.record, o.output, left.words, left.sample
    ))
}
