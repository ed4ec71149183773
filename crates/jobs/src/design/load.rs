//! Models, records and the objective signal that a spec names.

use std::path::Path;

use dynocal_design::channel::Channel;
use dynocal_design::criterion::criterion;
use dynocal_design::error::DesignError;
use dynocal_design::information::sensitivities;
use dynocal_design::problem::Convention;
use dynocal_design::search::FIRST_FREE_STREAM;
use dynocal_files::dataset::{ChannelSpec, Layout, Select, Time, datasets, read_table_with};
use dynocal_files::measurement;
use dynocal_files::split::{self, Cut};
use dynocal_ident::data::{DataError, Dataset, Role};
use dynocal_ident::experiment::Experiment;
use dynocal_ident::model::{Model, Run};
use dynocal_ident::signal;
use dynocal_ident::validate::boundary::{BoundaryKeys, Space, learn};
use dynocal_numerics::registry::BuildError;
use dynocal_numerics::rng::Rng64;

use super::error::DesignJobError;
use super::loaded::{Loaded, NamedCriterion};
use super::{Job, ModelSpec, Objective, Source, literature, stored};

/// Everything that a design needs.
pub struct Inputs {
    /// Channels, those from files with their samples.
    pub channels: Vec<Channel>,
    /// Models.
    pub models: Vec<Loaded>,
    /// Objective signal (N0 x m) where the spec gives one.
    pub objective: Option<Vec<f64>>,
    /// What was decided or lost while files were read.
    pub notes: Vec<String>,
}

/// Reads what the job names and checks that it belongs together.
///
/// # Errors
/// [`DesignJobError`].
pub fn load(job: &Job) -> Result<Inputs, DesignJobError> {
    let (mut channels, mut notes) = (Vec::new(), Vec::new());
    for c in &job.channels {
        let mut channel = c.channel.clone();
        if let Some(file) = &c.file {
            let one = [(channel.name.clone(), c.unit.clone())];
            let record = record(job, file, &one, &mut notes)?;
            let regions = std::mem::take(&mut channel.regions);
            channel =
                Channel { regions, ..Channel::given(&channel.name, record.values(&one[0].0)?.to_vec()) };
        }
        channels.push(channel);
    }
    let models = job.models.iter().map(|m| loaded(job, m, &mut notes)).collect::<Result<Vec<_>, _>>()?;
    if let Some(m) = models.iter().find(|m| m.noise_variance.is_nan() || m.noise_variance <= 0.0) {
        let (what, expected) = (format!("{}: noise variance", m.name), "a positive number".into());
        return Err(DesignError::Number { what, found: m.noise_variance, expected }.into());
    }
    let objective = objective(job, &channels, &mut notes)?;
    notes.dedup();
    Ok(Inputs { channels, models, objective, notes })
}

fn loaded(job: &Job, spec: &ModelSpec, notes: &mut Vec<String>) -> Result<Loaded, DesignJobError> {
    let names: Vec<String> = job.channels.iter().map(|c| c.channel.name.clone()).collect();
    let (mut out, linear) = match &spec.source {
        Source::Literature(name) => (literature::loaded(name, &names, job.sample_time_s)?, None),
        Source::File(path) => stored::of_file(path, job, &names)?,
    };
    if let Some(s) = spec.noise_std {
        out.noise_variance = s * s;
    } else if out.noise_variance.is_nan() {
        return Err(DesignJobError::NoNoise { model: out.name, unit: out.unit });
    }
    if let Some(linear) = linear {
        let idle = if job.convention == Convention::Trim { linear.max_lag() } else { 0 };
        let samples = job.samples.saturating_sub(idle);
        out.prior.extend(linear.noise_rows(&out.theta, samples, out.noise_variance).unwrap_or_default());
    }
    let build = |name: &String| {
        let criterion = criterion(name, &toml::Table::new())?;
        Ok::<_, BuildError>(NamedCriterion { name: name.clone(), criterion })
    };
    out.criterion = spec.criterion.as_ref().map(build).transpose()?;
    if out.theta.is_empty() {
        return Err(DesignJobError::NoParameters { model: out.name });
    }
    out.weight = spec.weight;
    out.limits = spec.limits.clone();
    // Before a record within limits the output is somewhere between them.
    let middle = spec.limits.as_ref().map(|l| 0.5 * (l.lower + l.upper));
    out.initial_output = spec.initial_output.or(middle).unwrap_or(0.0);
    let inputs: Vec<(String, String)> =
        job.channels.iter().map(|c| (c.channel.name.clone(), c.unit.clone())).collect();
    let mut seen = Vec::new();
    for file in &spec.prior {
        for d in records(job, file, &inputs, None, notes)? {
            let (u, m) = (d.matrix(&names)?, names.len());
            let rows =
                sensitivities(out.model.as_ref(), &out.theta, &u, m, Convention::Trim, 0, out.initial_output)
                    .map_err(|_| DesignError::Diverged { term: out.name.clone(), record: d.name.clone() })?;
            out.prior.extend(rows);
        }
        // The same file again, with the output where it has one.
        seen.extend(experiments(job, file, &inputs, &out, &mut Vec::new()).unwrap_or_default());
    }
    for file in &spec.held_out {
        let found = experiments(job, file, &inputs, &out, notes)?;
        out.held_out.extend(found);
    }
    if out.boundary.is_none() && !seen.is_empty() {
        out.boundary = learn(Space::of(out.model.as_ref()), &seen, &BoundaryKeys::default()).ok();
    }
    Ok(out)
}

/// A whole file with the wanted inputs; other units are converted.
fn record(
    job: &Job,
    path: &Path,
    inputs: &[(String, String)],
    notes: &mut Vec<String>,
) -> Result<Dataset, DesignJobError> {
    let mut all = cut_records(job, path, inputs, None, None, notes)?;
    // Without a cut a file is one record.
    Ok(all.remove(0))
}

/// The experiments of a file of earlier records, with the output where it is wanted.
fn records(
    job: &Job,
    path: &Path,
    inputs: &[(String, String)],
    output: Option<(&str, &str)>,
    notes: &mut Vec<String>,
) -> Result<Vec<Dataset>, DesignJobError> {
    cut_records(job, path, inputs, output, job.records.cut.as_ref(), notes)
}

fn cut_records(
    job: &Job,
    path: &Path,
    inputs: &[(String, String)],
    output: Option<(&str, &str)>,
    cut: Option<&Cut>,
    notes: &mut Vec<String>,
) -> Result<Vec<Dataset>, DesignJobError> {
    let table = read_table_with(path, None, &job.records.keys)?;
    let name = path.file_name().map(|n| n.to_string_lossy().into_owned()).unwrap_or_default();
    notes.extend(table.notes.iter().map(|n| format!("{name}: {n}")));
    if let Some(cut) = cut {
        notes.push(format!("{name}: {}", split::experiments(&table, cut)?.note));
    }
    let spec = |name: &str, unit: &str, role| ChannelSpec {
        column: name.into(),
        name: name.into(),
        unit: Some(unit.into()),
        convert: true,
        role,
    };
    let mut channels: Vec<ChannelSpec> = inputs.iter().map(|(n, u)| spec(n, u, Role::Input)).collect();
    channels.extend(output.map(|(n, u)| spec(n, u, Role::Output)));
    let dt_s = job.sample_time_s;
    let time = match measurement::time_column(&table) {
        Some(c) => Time::Column { column: c.name.clone(), unit: None },
        None => Time::Sampled { sample_time_s: dt_s },
    };
    let layout = Layout { channels, time, cut: cut.cloned(), ..Layout::default() };
    let mut all = datasets(&table, &layout, &Select::All)?;
    let several = all.len() > 1;
    for d in &mut all {
        d.name = if several { format!("{name}, {}", d.name) } else { name.clone() };
        d.check()?;
        if (d.sample_time_s - dt_s).abs() > 1e-6 * dt_s {
            return Err(DataError::SampleTime {
                record: d.name.clone(),
                found: d.sample_time_s,
                expected: format!("{dt_s} s as in the spec"),
            }
            .into());
        }
    }
    Ok(all)
}

fn experiments(
    job: &Job,
    path: &Path,
    inputs: &[(String, String)],
    m: &Loaded,
    notes: &mut Vec<String>,
) -> Result<Vec<Experiment>, DesignJobError> {
    let names: Vec<String> = inputs.iter().map(|i| i.0.clone()).collect();
    let one = |d: Dataset| {
        Ok(Experiment {
            name: d.name.clone(),
            u: d.matrix(&names)?,
            y: d.values(&m.name)?.to_vec(),
            init_samples: 0,
            weights: Vec::new(),
        })
    };
    records(job, path, inputs, Some((&m.name, &m.unit)), notes)?.into_iter().map(one).collect()
}

fn objective(
    job: &Job,
    channels: &[Channel],
    notes: &mut Vec<String>,
) -> Result<Option<Vec<f64>>, DesignJobError> {
    let m = channels.len();
    let u = match &job.objective {
        Objective::Everywhere => return Ok(None),
        Objective::File(path) => {
            let inputs: Vec<(String, String)> =
                job.channels.iter().map(|c| (c.channel.name.clone(), c.unit.clone())).collect();
            let names: Vec<String> = inputs.iter().map(|i| i.0.clone()).collect();
            record(job, path, &inputs, notes)?.matrix(&names)?
        }
        Objective::Signals { samples, signals } => {
            let mut u = vec![0.0; samples * m];
            for (i, s) in signals.iter().enumerate() {
                let mut column = match (s, &channels[i].given) {
                    (None, Some(v)) => v.iter().copied().cycle().take(*samples).collect(),
                    _ => vec![0.0; *samples],
                };
                if let Some((name, keys)) = s {
                    let mut rng = Rng64::stream(job.seed, FIRST_FREE_STREAM + 1000 + i as u64);
                    signal::signal(name, keys)?.fill(&mut column, job.sample_time_s, &mut rng)?;
                }
                column.iter().enumerate().for_each(|(t, v)| u[t * m + i] = *v);
            }
            u
        }
    };
    for (k, v) in u.iter().enumerate() {
        let c = &channels[k % m];
        let slack = 1e-9 * (c.upper - c.lower).abs();
        if c.given.is_none() && !(c.lower - slack <= *v && *v <= c.upper + slack) {
            return Err(DesignJobError::Objective {
                channel: c.name.clone(),
                value: *v,
                unit: job.channels[k % m].unit.clone(),
                sample: k / m,
                lower: c.lower,
                upper: c.upper,
            });
        }
    }
    Ok(Some(u))
}

/// Samples over which a free run must not grow.
const STABLE_SAMPLES: usize = 4000;
/// Growth from the first to the last quarter that no stable model shows on a repeated record.
const GROWTH: f64 = 10.0;

/// Refuses a model whose free run grows on the record `u` (N x m), repeated.
///
/// # Errors
/// [`DesignJobError::Unstable`].
pub fn check_stable(m: &Loaded, u: &[f64]) -> Result<(), DesignJobError> {
    let width = m.model.n_inputs();
    let samples = STABLE_SAMPLES.max(4 * u.len() / width);
    let long: Vec<f64> = u.iter().copied().cycle().take(samples * width).collect();
    let initial = vec![m.initial_output; samples];
    let mut y = vec![0.0; samples];
    let run = Run { u: &long, y: &initial, start: m.model.max_lag().min(samples) };
    m.model.simulate(&m.theta, &run, &mut y);
    let largest = |part: &[f64]| {
        part.iter().fold(0.0f64, |a, v| if v.is_finite() { a.max(v.abs()) } else { f64::INFINITY })
    };
    let (early, late) = (largest(&y[..samples / 4]), largest(&y[3 * samples / 4..]));
    if late > GROWTH * early.max(m.noise_variance.sqrt()) || !late.is_finite() {
        let (model, unit) = (m.name.clone(), m.unit.clone());
        return Err(DesignJobError::Unstable { model, early, late, unit, samples });
    }
    Ok(())
}
