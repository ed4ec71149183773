//! Models and record of an optimisation.

use std::path::Path;

use dynocal_calib::optimise::{DemandFrom, bound_channels};
use dynocal_files::dataset::{ChannelSpec, Layout, Select, Time, datasets, read_table};
use dynocal_files::json;
use dynocal_files::table::Table;
use dynocal_ident::data::{Channel, Dataset, Role};
use dynocal_ident::model::initial::Initial;
use dynocal_ident::stored::{MODEL_SCHEMA, MODEL_VERSION, StoredModel};
use dynocal_numerics::watch::Watch;

use super::result::OptimiseJobError;
use super::spec::Job;

/// A model and the file that it came from.
pub(super) struct Named {
    pub(super) file: String,
    pub(super) model: StoredModel,
}

/// What an optimisation starts from.
pub(super) struct Loaded {
    pub(super) models: Vec<Named>,
    pub(super) record: Dataset,
    /// Outputs that the record does not have: they start from rest.
    pub(super) from_rest: Vec<String>,
}

pub(super) fn load(job: &Job, watch: Watch) -> Result<Loaded, OptimiseJobError> {
    let models = job.models.iter().map(|f| model(f)).collect::<Result<Vec<_>, _>>()?;
    watch.note(&format!("reading {}", job.record.file.display()));
    let record = record(job, &models, watch)?;
    let mut loaded = Loaded { models, record, from_rest: Vec::new() };
    loaded.start_from_rest(job)?;
    Ok(loaded)
}

fn model(path: &Path) -> Result<Named, OptimiseJobError> {
    let file = path.display().to_string();
    let model: StoredModel = json::read_versioned(path, MODEL_SCHEMA, MODEL_VERSION)?;
    model.check().map_err(|source| OptimiseJobError::Model { file: file.clone(), source })?;
    Ok(Named { file, model })
}

/// The part of the record that is asked for: inputs and given channels, and the outputs that it has.
fn record(job: &Job, models: &[Named], watch: Watch) -> Result<Dataset, OptimiseJobError> {
    let table = read_table(&job.record.file, None)?;
    table.notes.iter().for_each(|n| watch.note(n));
    let layout =
        Layout { channels: channels(job, &table), time: time(job, models, &table), ..Layout::default() };
    let file = job.record.file.display().to_string();
    let empty = || OptimiseJobError::Part { file: file.clone(), samples: 0, length_s: 0.0 };
    let whole = datasets(&table, &layout, &Select::All)?.into_iter().next().ok_or_else(empty)?;
    let length_s = whole.len() as f64 * whole.sample_time_s;
    // A stamp that is meant to be a sample is one.
    let sample = |s: f64| (s / whole.sample_time_s - 1e-6).ceil().max(0.0) as usize;
    let from = sample(job.record.from_s);
    let to = job.record.to_s.map_or(whole.len(), sample).min(whole.len());
    if from >= to {
        return Err(OptimiseJobError::Part { file, samples: whole.len(), length_s });
    }
    let name = job.record.file.file_stem().map(|s| s.to_string_lossy().into_owned()).unwrap_or_default();
    Ok(whole.part(from, to, name.split('.').next().unwrap_or(&name).into()))
}

fn channels(job: &Job, table: &Table) -> Vec<ChannelSpec> {
    let p = &job.problem;
    let column = |name: &str| job.record.columns.get(name).cloned().unwrap_or_else(|| name.into());
    let spec = |name: &str, unit: &str, role| ChannelSpec {
        column: column(name),
        name: name.into(),
        unit: Some(unit.into()),
        convert: true,
        role,
    };
    let inputs = p.inputs.iter().map(|c| spec(&c.name, &c.unit, Role::Input));
    let given = p.given.iter().map(|c| spec(&c.name, &c.unit, Role::Input));
    let outputs = p.demand_names().into_iter().chain(p.other_outputs());
    // An output that the spec gives a column must be there.
    let there = |name: &String| {
        job.record.columns.contains_key(name)
            || table.column(name).is_ok()
            || job.optimise.demand == DemandFrom::Record && p.demand_names().contains(name)
    };
    let outputs: Vec<ChannelSpec> =
        outputs.filter(there).map(|name| spec(&name, p.unit(&name).unwrap_or("-"), Role::Output)).collect();
    // Bounds of each sample, where the record has some.
    let limits = p.limits.iter().map(|l| (&l.output, &l.unit));
    let bounded = p.inputs.iter().map(|c| (&c.name, &c.unit)).chain(limits);
    let bounds = bounded.flat_map(|(name, unit)| bound_channels(name).map(|name| (name, unit)));
    let bounds = bounds.filter(|(name, _)| table.column(name).is_ok());
    let bounds = bounds.map(|(name, unit)| spec(&name, unit, Role::Auxiliary));
    inputs.chain(given).chain(outputs).chain(bounds).collect()
}

fn time(job: &Job, models: &[Named], table: &Table) -> Time {
    let column = job.record.time.clone().unwrap_or_else(|| "time".into());
    match models.first() {
        Some(n) if job.record.time.is_none() && table.column(&column).is_err() => {
            Time::Sampled { sample_time_s: n.model.sample_time_s }
        }
        _ => Time::Column { column, unit: None },
    }
}

impl Loaded {
    /// Outputs that the record does not have become the free runs of their models from rest, in an order in which each
    /// model finds what drives it. One that finds it nowhere is left out: the optimisation says what it lacks.
    fn start_from_rest(&mut self, job: &Job) -> Result<(), OptimiseJobError> {
        let there = |d: &Dataset, name: &str| d.channels.iter().any(|c| c.name == name);
        loop {
            let ready = self.models.iter().find(|n| {
                let inputs = n.model.measured_inputs();
                !there(&self.record, &n.model.user_output().name)
                    && inputs.iter().all(|q| there(&self.record, &q.name))
            });
            let Some(n) = ready else { return Ok(()) };
            let q = n.model.user_output();
            let refused = |source| OptimiseJobError::Model { file: n.file.clone(), source };
            let mut runs = n.model.simulate(&self.record, Some(Initial::Rest)).map_err(refused)?;
            let values = match runs.len() {
                1 => std::mem::take(&mut runs[0].y),
                _ => Vec::new(),
            };
            if values.len() != self.record.len() || !values.iter().all(|v| v.is_finite()) {
                return Err(OptimiseJobError::Rest { output: q.name, file: n.file.clone() });
            }
            let unit = job.problem.unit(&q.name).unwrap_or(&q.unit).to_string();
            self.from_rest.push(q.name.clone());
            self.record.channels.push(Channel { name: q.name, unit, role: Role::Output, values });
        }
    }
}
