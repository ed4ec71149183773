//! The work of an identification, step by step into a run folder.

use std::path;

use dynocal_files::run_folder::{RunFolder, digest};
use dynocal_files::{FilesError, csv_io, json};
use dynocal_ident::data::{DataError, Dataset};
use dynocal_ident::estimate::missing::bridged;
use dynocal_ident::estimate::{EstimateError, Minimised};
use dynocal_ident::experiment::{Experiment, experiments, experiments_marked};
use dynocal_ident::prepare::{Note, PrepareError};
use dynocal_ident::select::SelectError;
use dynocal_ident::validate::Kind;
use dynocal_ident::validate::boundary::BoundaryModel;
use dynocal_numerics::registry::BuildError;
use dynocal_numerics::watch::Watch;
use rayon::prelude::*;

use super::after::{After, after};
use super::before::before;
use super::bounds::free_run_bounds;
use super::fit::{Estimated, estimate, saved};
use super::load::{Part, parts};
use super::prepare::prepare_parts;
use super::result::{Identified, MODEL_SCHEMA, MODEL_VERSION, ModelFile, Modelled, Path, Quantity};
use super::score::{Scored, score};
use super::set::{Member, Set, shape};
use super::spec::{Job, Target};

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
    /// Preparation.
    #[error(transparent)]
    Prepare(#[from] PrepareError),
    /// Structure selection.
    #[error(transparent)]
    Select(#[from] SelectError),
    /// A checked member cannot be built any more.
    #[error(transparent)]
    Build(#[from] BuildError),
    /// Records in different units.
    #[error(
        "{record}: channel `{channel}` is in `{found}`, in {other} it is in `{expected}`: convert one of them"
    )]
    Unit {
        /// Record.
        record: String,
        /// Channel.
        channel: String,
        /// Its unit.
        found: String,
        /// Unit elsewhere.
        expected: String,
        /// Record that has it.
        other: String,
    },
    /// Outputs that depend on each other at the same sample.
    #[error(
        "the model of `{target}` uses the output `{input}` of the same sample, which is computed by another model: use `{input}(t-1)` or an earlier sample"
    )]
    Loop {
        /// Target.
        target: String,
        /// Output that is used at once.
        input: String,
    },
    /// The user stopped it.
    #[error("interrupted before the estimate was finished; run the same command again")]
    Interrupted,
}

/// Does the job: reads the data, estimates, scores, and writes models, records and summary.
///
/// # Errors
/// [`IdentifyError`].
pub fn run(job: &Job, watch: Watch) -> Result<(Identified, RunFolder), IdentifyError> {
    let files = job.sources.iter().chain(job.tests.iter().map(|t| &t.source));
    let digests: Vec<String> = files.map(|s| digest_of_file(&s.file)).collect::<Result<_, _>>()?;
    let mut folder = RunFolder::open(&job.out, "identify", job)?;
    let inputs = (job.inputs(), digests);
    let done = folder.step("identify", &inputs, |dir| work(job, dir, watch))?;
    if done.resumed {
        watch.note("same spec and data as before: result taken from the earlier run");
    }
    folder.write_summary(&done.result)?;
    Ok((done.result, folder))
}

fn digest_of_file(path: &path::Path) -> Result<String, FilesError> {
    let bytes = std::fs::read(path).map_err(|_| missing(path))?;
    Ok(digest(&bytes))
}

/// The reader knows best how to say what is wrong with a file that cannot even be opened.
fn missing(path: &path::Path) -> FilesError {
    match csv_io::read(path) {
        Err(e) => e,
        Ok(_) => FilesError::Read { path: path.display().to_string(), reason: "it changed meanwhile".into() },
    }
}

fn work(job: &Job, dir: &path::Path, watch: Watch) -> Result<Identified, IdentifyError> {
    let mut parts = parts(job, watch.note)?;
    let preparation = prepare_parts(job, &mut parts, dir)?;
    let first = if job.saved.is_empty() { before(job, &parts[0].records)? } else { None };
    let estimated = if job.saved.is_empty() {
        // Targets share nothing but the data.
        job.targets.par_iter().map(|t| estimate_target(t, &parts, watch)).collect::<Result<Vec<_>, _>>()?
    } else {
        sampled_alike(job, &parts)?;
        job.saved.iter().map(saved).collect::<Result<Vec<_>, _>>()?
    };
    let set = Set::new(job.targets.iter().zip(&estimated).map(member).collect());
    if let Some((target, input)) = set.loop_at_once() {
        return Err(IdentifyError::Loop { target: target.into(), input: input.into() });
    }
    watch.note("scoring");
    let fitted: Vec<Vec<Experiment>> = job
        .targets
        .iter()
        .map(|t| parts[0].records.iter().map(|d| Ok(bridged(&shape(d, &t.inputs, &t.target)?).0)).collect())
        .collect::<Result<_, DataError>>()?;
    let minimised: Vec<Kind> = estimated.iter().map(minimised).collect();
    let mut scored = Vec::new();
    for part in &parts {
        let notes = preparation.iter().find(|p| p.part == part.name).map_or(&[][..], |p| &p.notes);
        let bounds = |k: usize, r: &Experiment| {
            // The band of one model says nothing about a set that runs together.
            if set.is_coupled() { None } else { free_run_bounds(job, &estimated[k], &fitted[k], r) }
        };
        scored.push(score(part, notes, &set, &minimised, &job.validate, &bounds, dir)?);
    }
    let mut models = Vec::new();
    for (t, e) in job.targets.iter().zip(&estimated) {
        let judged = after(job, t, e, &parts, watch)?;
        let notes = preparation.first().map_or(&[][..], |p| &p.notes);
        models.push(modelled(job, t, e, (&parts[0].records[0], notes), &scored, judged, dir)?);
    }
    let mut found = finish(job, &parts, &estimated, models, scored);
    found.files.extend(preparation.iter().flat_map(|p| &p.stages).map(|s| s.file.clone()));
    found.preparation = preparation;
    found.before = first;
    Ok(found)
}

fn member((t, e): (&Target, &Estimated)) -> Member {
    Member { target: t.target.clone(), inputs: t.inputs.clone(), model: e.model.clone() }
}

/// The errors that should be small: of a saved model those of the free run.
fn minimised(e: &Estimated) -> Kind {
    match e.fit.as_ref().map(|f| f.minimised) {
        Some(Minimised::OneStep) => Kind::OneStep,
        Some(Minimised::FreeRun) | None => Kind::FreeRun,
    }
}

/// A model counts samples: records in another sample time are another system.
fn sampled_alike(job: &Job, parts: &[Part]) -> Result<(), DataError> {
    for (m, d) in job.saved.iter().flat_map(|m| parts.iter().flat_map(|p| &p.records).map(move |d| (m, d))) {
        if (d.sample_time_s - m.sample_time_s).abs() > 1e-6 * m.sample_time_s {
            return Err(DataError::SampleTime {
                record: d.name.clone(),
                found: d.sample_time_s,
                expected: format!("{} s as in the model of `{}`", m.sample_time_s, m.output.name),
            });
        }
    }
    Ok(())
}

fn estimate_target(t: &Target, parts: &[Part], watch: Watch) -> Result<Estimated, IdentifyError> {
    // Missing samples are for those who asked for them.
    let marked =
        parts[0].records.iter().any(|d| d.channels.iter().any(|c| c.values.iter().any(|v| v.is_nan())));
    let data = if marked {
        experiments_marked(&parts[0].records, &t.inputs, &t.target)?
    } else {
        experiments(&parts[0].records, &t.inputs, &t.target)?
    };
    let selecting = parts.iter().filter(|p| p.name == "selection").flat_map(|p| &p.records);
    let selecting: Vec<Experiment> =
        selecting.map(|d| shape(d, &t.inputs, &t.target)).collect::<Result<_, _>>()?;
    estimate(t, &data, &selecting, watch)
}

fn modelled(
    job: &Job,
    t: &Target,
    e: &Estimated,
    (d, notes): (&Dataset, &[Note]),
    scored: &[Scored],
    (after, boundary): (After, Option<BoundaryModel>),
    dir: &path::Path,
) -> Result<Modelled, IdentifyError> {
    let quantity = |name: &String| -> Result<Quantity, DataError> {
        Ok(Quantity { name: name.clone(), unit: d.channel(name)?.unit.clone() })
    };
    let origin = job.sources.iter().filter_map(|s| s.file.file_name()).map(|n| n.to_string_lossy());
    let output = quantity(&t.target)?;
    let file = ModelFile {
        structure: e.model.stored().clone(),
        inputs: t.inputs.iter().map(quantity).collect::<Result<_, _>>()?,
        output: output.clone(),
        sample_time_s: d.sample_time_s,
        parameters: e.parameters.clone(),
        estimator: t.estimator.clone(),
        noise_variance: e.fit.as_ref().map(|f| f.noise_variance),
        boundary,
        preparation: notes.to_vec(),
        origin: origin.collect::<Vec<_>>().join(", "),
    };
    let file = job.saved.iter().find(|m| m.output.name == t.target).cloned().unwrap_or(file);
    let name = if job.targets.len() == 1 { "model.json".into() } else { format!("model-{}.json", t.target) };
    json::write_versioned(&dir.join(&name), MODEL_SCHEMA, MODEL_VERSION, &file)?;
    let own = |s: &Scored| {
        s.residuals.iter().filter(|(n, _)| *n == t.target).map(|(_, r)| r.clone()).collect::<Vec<_>>()
    };
    Ok(Modelled {
        target: t.target.clone(),
        unit: output.unit,
        inputs: t.inputs.clone(),
        structure: t.structure.name.clone(),
        estimator: t.estimator.clone(),
        status: e.fit.as_ref().map(|f| f.status),
        parameters: e.parameters.clone(),
        rank: e.fit.as_ref().map(|f| f.rank),
        evaluations: e.fit.as_ref().map(|f| f.evaluations),
        samples: e.fit.as_ref().map(|f| f.samples),
        selection: e.selection.as_ref().map(|s| Path { pool: s.pool, kept: s.steps, steps: s.path.clone() }),
        residuals: scored.iter().flat_map(own).collect(),
        after,
        file: in_step(&name),
    })
}

/// A file of the step, relative to the run folder.
pub(super) fn in_step(name: &str) -> String {
    format!("steps/01-identify/{name}")
}

fn finish(
    job: &Job,
    parts: &[Part],
    estimated: &[Estimated],
    models: Vec<Modelled>,
    scored: Vec<Scored>,
) -> Identified {
    // Divergence matters more than anything that the estimators say.
    let mut warnings: Vec<String> = scored.iter().flat_map(|s| s.diverged.clone()).collect();
    let mut valid =
        warnings.is_empty() && estimated.iter().flat_map(|e| &e.fit).all(|f| f.status.is_success());
    valid &= parts.iter().all(|p| !p.records.is_empty());
    for (t, e) in job.targets.iter().zip(estimated) {
        let of = |w: &String| if job.targets.len() > 1 { format!("{}: {w}", t.target) } else { w.clone() };
        warnings.extend(e.fit.iter().flat_map(|f| &f.warnings).map(of));
    }
    if parts.iter().all(|p| p.name == "estimation" || p.name == "selection") {
        warnings.push("no test data in the split: nothing says how the model does on unseen data".into());
    }
    let (mut scores, mut records) = (Vec::new(), Vec::new());
    for s in scored {
        scores.extend(s.scores);
        records.extend(s.records);
    }
    for r in &mut records {
        r.file = in_step(&r.file);
    }
    let files = models.iter().map(|m| m.file.clone()).chain(records.iter().map(|r| r.file.clone()));
    Identified {
        verb: "identify".into(),
        name: job.name.clone(),
        valid,
        warnings,
        files: files.collect(),
        preparation: Vec::new(),
        before: None,
        models,
        scores,
        records,
    }
}
