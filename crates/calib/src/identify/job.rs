//! The work of an identification, step by step into a run folder.

use std::path::Path;

use dynocal_files::dataset::{datasets, read_table};
use dynocal_files::run_folder::{RunFolder, digest};
use dynocal_files::{FilesError, csv_io, json};
use dynocal_ident::data::{DataError, Dataset};
use dynocal_ident::estimate::{self, EstimateError, Fit};
use dynocal_ident::experiment::{Experiment, experiments};
use dynocal_ident::model::{Model, poly::PolyNarx};
use dynocal_ident::select::frols::{SelectError, Step, frols};
use dynocal_ident::validate::{self, Kind, Reference, Seen};
use dynocal_numerics::registry::BuildError;
use dynocal_numerics::status::Status;

use super::result::{Identified, MODEL_SCHEMA, MODEL_VERSION, ModelFile, Parameter, Score};
use super::spec::Job;

/// The job could not be done.
#[derive(Debug, thiserror::Error)]
pub enum IdentifyError {
    /// Files.
    #[error(transparent)]
    Files(#[from] FilesError),
    /// Data.
    #[error(transparent)]
    Data(#[from] DataError),
    /// Estimation.
    #[error(transparent)]
    Estimate(#[from] EstimateError),
    /// Structure selection.
    #[error(transparent)]
    Select(#[from] SelectError),
    /// The checked estimator cannot be built any more.
    #[error(transparent)]
    Build(#[from] BuildError),
    /// The user stopped it.
    #[error("interrupted before the estimate was finished; run the same command again")]
    Interrupted,
}

/// Does the job: reads the data, estimates, scores, and writes model, records and summary.
///
/// `note` is told what happens, `interrupt` is asked often.
///
/// # Errors
/// [`IdentifyError`].
pub fn run(
    job: &Job,
    note: &dyn Fn(&str),
    interrupt: &dyn Fn() -> bool,
) -> Result<(Identified, RunFolder), IdentifyError> {
    let bytes = std::fs::read(&job.file).map_err(|_| missing(&job.file))?;
    let data_digest = digest(&bytes);
    drop(bytes);
    let mut folder = RunFolder::open(&job.out, "identify", job)?;
    let inputs = (job.inputs(), data_digest);
    let done = folder.step("identify", &inputs, |dir| work(job, dir, note, interrupt))?;
    if done.resumed {
        note("same spec and data as before: result taken from the earlier run");
    }
    folder.write_summary(&done.result)?;
    Ok((done.result, folder))
}

/// The reader knows best how to say what is wrong with a file that cannot even be opened.
fn missing(path: &Path) -> FilesError {
    match csv_io::read(path) {
        Err(e) => e,
        Ok(_) => FilesError::Read { path: path.display().to_string(), reason: "it changed meanwhile".into() },
    }
}

fn work(
    job: &Job,
    dir: &Path,
    note: &dyn Fn(&str),
    interrupt: &dyn Fn() -> bool,
) -> Result<Identified, IdentifyError> {
    note(&format!("reading {}", job.file.display()));
    let table = read_table(&job.file, job.format)?;
    let data = datasets(&table, &job.layout, &job.estimation)?;
    let estimation = experiments(&data, &job.inputs, &job.target)?;
    // A test record may hold an input still, so it is not asked to excite anything.
    let test = match &job.test {
        Some(select) => {
            let records = datasets(&table, &job.layout, select)?;
            let shaped = records.iter().map(|d| shape(d, job)).collect::<Result<Vec<_>, _>>()?;
            Some((records, shaped))
        }
        None => None,
    };
    drop(table);
    let (model, selection) = structure(job, &estimation, note)?;
    for e in test.iter().flat_map(|t| &t.1) {
        long_enough(&model, e)?;
    }
    let fit = fit(job, &model, &estimation, note, interrupt)?;
    note("scoring");
    let unit = data[0].channel(&job.target)?.unit.clone();
    let mut warnings = fit.warnings.clone();
    let mut scores = Vec::new();
    let mut files = vec!["model.json".to_string()];
    let mut parts = vec![(Seen::Identification, &data, &estimation)];
    match &test {
        Some((d, e)) => parts.push((Seen::Unseen, d, e)),
        None => {
            warnings.push("no test data in the split: nothing says how the model does on unseen data".into())
        }
    }
    let mut valid = fit.status.is_success();
    for (seen, records, shaped) in parts {
        let part = Part { job, model: &model, theta: &fit.theta, seen, dir };
        let (found, diverged) = part.score(records, shaped, &unit, &mut files)?;
        valid &= diverged.is_empty();
        scores.extend(found);
        // Divergence matters more than anything that the estimator says.
        warnings.splice(0..0, diverged);
    }
    let p = model.n_params();
    json::write_versioned(
        &dir.join("model.json"),
        MODEL_SCHEMA,
        MODEL_VERSION,
        &model_file(job, &model, &fit, &data[0])?,
    )?;
    Ok(Identified {
        verb: "identify".into(),
        name: job.name.clone(),
        status: fit.status,
        valid,
        warnings,
        target: job.target.clone(),
        inputs: job.inputs.clone(),
        structure: job.structure.clone(),
        estimator: job.estimator.clone(),
        parameters: p,
        rank: fit.rank,
        evaluations: fit.evaluations,
        samples: fit.samples,
        selection,
        scores,
        files: files.iter().map(|f| format!("steps/01-identify/{f}")).collect(),
    })
}

fn shape(d: &Dataset, job: &Job) -> Result<Experiment, DataError> {
    Ok(Experiment {
        name: d.name.clone(),
        u: d.matrix(&job.inputs)?,
        y: d.values(&job.target)?.to_vec(),
        init_samples: d.init_samples,
        weights: Vec::new(),
    })
}

fn long_enough(model: &PolyNarx, e: &Experiment) -> Result<(), DataError> {
    let first = e.first(model);
    if e.len() > first {
        return Ok(());
    }
    let why = format!("{first} samples initialise, one must be left to score");
    Err(DataError::TooShort { record: e.name.clone(), found: e.len(), expected: first + 1, why })
}

/// The structure of the spec, or the terms selected from it.
fn structure(
    job: &Job,
    data: &[Experiment],
    note: &dyn Fn(&str),
) -> Result<(PolyNarx, Vec<Step>), IdentifyError> {
    let Some(select) = &job.select else { return Ok((job.model.clone(), Vec::new())) };
    note(&format!("selecting terms from a pool of {}", job.model.n_params()));
    let selection = frols(&job.model, &share(data, select.max_samples, &job.model), select.stop)?;
    note(&format!("selected {}", selection.model.regressor_texts().join(", ")));
    Ok((selection.model, selection.path))
}

/// The same share of the start of every record, so that all together hold about `samples` samples.
fn share(data: &[Experiment], samples: usize, model: &PolyNarx) -> Vec<Experiment> {
    let total: usize = data.iter().map(Experiment::len).sum();
    if samples >= total {
        return data.to_vec();
    }
    data.iter()
        .map(|e| {
            let n = (e.len() * samples / total).clamp((e.first(model) + 1).min(e.len()), e.len());
            let m = e.u.len() / e.len().max(1);
            let weights = e.weights.iter().take(n).copied().collect();
            Experiment { u: e.u[..n * m].to_vec(), y: e.y[..n].to_vec(), weights, ..e.clone() }
        })
        .collect()
}

fn fit(
    job: &Job,
    model: &PolyNarx,
    data: &[Experiment],
    note: &dyn Fn(&str),
    interrupt: &dyn Fn() -> bool,
) -> Result<Fit, IdentifyError> {
    let estimator = estimate::estimator(&job.estimator, &job.estimator_keys)?;
    let rows: usize = data.iter().map(Experiment::len).sum();
    let mut start = None;
    if job.warm_start_samples > 0 && job.warm_start_samples < rows {
        let part = share(data, job.warm_start_samples, model);
        note(&format!("first estimate from {} samples", part.iter().map(Experiment::len).sum::<usize>()));
        let first = estimator.estimate(model, &part, None, interrupt)?;
        start = (first.status != Status::Interrupted).then_some(first.theta);
    }
    note(&format!(
        "estimating {} parameters by {} from {} records, {rows} samples",
        model.n_params(),
        job.estimator,
        data.len()
    ));
    let fit = estimator.estimate(model, data, start.as_deref(), interrupt)?;
    if fit.status == Status::Interrupted { Err(IdentifyError::Interrupted) } else { Ok(fit) }
}

/// One part of the data, estimation or test.
struct Part<'a> {
    job: &'a Job,
    model: &'a PolyNarx,
    theta: &'a [f64],
    seen: Seen,
    dir: &'a Path,
}

impl Part<'_> {
    /// Scores all records together and writes each; returns scores and divergence warnings.
    fn score(
        &self,
        records: &[Dataset],
        shaped: &[Experiment],
        unit: &str,
        files: &mut Vec<String>,
    ) -> Result<(Vec<Score>, Vec<String>), IdentifyError> {
        let label = if self.seen == Seen::Unseen { "test" } else { "estimation" };
        let mut warnings = Vec::new();
        let (mut z, mut one, mut free) = (Vec::new(), Vec::new(), Vec::new());
        for (d, e) in records.iter().zip(shaped) {
            let first = e.first(self.model);
            let predicted = validate::output(self.model, self.theta, e, Kind::OneStep);
            let simulated = validate::output(self.model, self.theta, e, Kind::FreeRun);
            if let Some(t) = simulated.iter().position(|v| !v.is_finite()) {
                warnings.push(format!(
                    "the free run of the model diverges on {label} record `{}` from sample {t} on: use the estimator `sem` or fewer output terms",
                    d.name
                ));
            }
            z.extend_from_slice(&e.y[first..]);
            one.extend_from_slice(&predicted[first..]);
            free.extend_from_slice(&simulated[first..]);
            let name = format!("{label}-{}.csv", file_name(&d.name));
            write_record(&self.dir.join(&name), self.job, d, &predicted, &simulated)?;
            files.push(name);
        }
        let scores = [(Kind::OneStep, &one), (Kind::FreeRun, &free)].map(|(kind, y)| {
            let s = validate::score_values(&z, y, kind, self.seen, Reference::Noisy);
            Score::new(&s, records.len(), unit)
        });
        Ok((scores.to_vec(), warnings))
    }
}

fn file_name(name: &str) -> String {
    name.chars().map(|c| if c.is_ascii_alphanumeric() || c == '.' || c == '-' { c } else { '_' }).collect()
}

fn write_record(
    path: &Path,
    job: &Job,
    d: &Dataset,
    predicted: &[f64],
    simulated: &[f64],
) -> Result<(), IdentifyError> {
    let y = d.channel(&job.target)?;
    let time: Vec<f64> = (0..d.len()).map(|t| t as f64 * d.sample_time_s).collect();
    let names = ["measured", "one_step", "free_run"].map(|k| format!("{}_{k}", y.name));
    let mut columns: Vec<(&str, &str, &[f64])> = vec![("time", "s", &time)];
    for (name, values) in names.iter().zip([y.values.as_slice(), predicted, simulated]) {
        columns.push((name, &y.unit, values));
    }
    for name in &job.inputs {
        let c = d.channel(name)?;
        columns.push((&c.name, &c.unit, &c.values));
    }
    Ok(csv_io::write_columns(path, &columns)?)
}

fn model_file(job: &Job, model: &PolyNarx, fit: &Fit, d: &Dataset) -> Result<ModelFile, IdentifyError> {
    let unit = |name: &String| -> Result<String, DataError> { Ok(d.channel(name)?.unit.clone()) };
    let parameters = fit.names.iter().zip(&fit.theta).zip(&fit.std_errors).map(|((n, v), s)| Parameter {
        name: n.clone(),
        value: *v,
        std_error: s.is_finite().then_some(*s),
    });
    Ok(ModelFile {
        structure: model.clone(),
        input_units: job.inputs.iter().map(unit).collect::<Result<_, _>>()?,
        output_unit: unit(&job.target)?,
        sample_time_s: d.sample_time_s,
        parameters: parameters.collect(),
        estimator: fit.estimator.clone(),
        origin: job.file.file_name().map(|n| n.to_string_lossy().into_owned()).unwrap_or_default(),
    })
}
