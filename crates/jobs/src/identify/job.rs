//! The work of an identification, step by step into a run folder.

use std::path;

use dynocal_files::json;
use dynocal_files::run_folder::RunFolder;
use dynocal_ident::data::{DataError, Dataset};
use dynocal_ident::estimate::missing::bridged;
use dynocal_ident::estimate::{self, Minimised};
use dynocal_ident::experiment::{Experiment, experiments, experiments_marked};
use dynocal_ident::model::response::form::ResponseForm;
use dynocal_ident::model::response::{Response, ResponseModel};
use dynocal_ident::prepare::Note;
use dynocal_ident::stored::{self, MODEL_SCHEMA, MODEL_VERSION, Quantity, StoredError, StoredModel};
use dynocal_ident::validate::boundary::BoundaryModel;
use dynocal_ident::validate::{Kind, Seen};
use dynocal_numerics::watch::Watch;
use rayon::prelude::*;

use super::after::{After, after};
use super::baseline::baseline;
use super::before::before;
use super::bounds::free_run_bounds;
use super::curves::{InputCurves, curves, poles_at_rest};
use super::error::IdentifyError;
use super::estimate::of_parts;
use super::finding::{Finding, Grade, Topic, sorted};
use super::fit::{Estimated, estimate, saved};
use super::judge::{losses, of_fit, of_model, of_scores};
use super::load::{Part, digest_of_file, parts};
use super::odd::of_values;
use super::points::points;
use super::prepare::{own_unit, prepare_parts, restored};
use super::remembered::{Remembered, pieces};
use super::result::{Identified, Modelled, Path, Prepared, in_step};
use super::score::{Judged, Scored, score};
use super::set::{Member, Set, shape};
use super::spec::{Job, Target};
use super::verdict::verdict;
use crate::estimate::Estimate;

/// Does the job: reads the data, estimates, scores, and writes models, records and summary.
///
/// # Errors
/// [`IdentifyError`].
pub fn run(job: &Job, watch: Watch) -> Result<(Identified, RunFolder), IdentifyError> {
    let files = job.sources.iter().chain(job.tests.iter().map(|t| &t.source));
    let digests: Vec<String> = files.map(|s| digest_of_file(&s.file)).collect::<Result<_, _>>()?;
    let mut folder = RunFolder::open_at(&job.out, "identify", job)?;
    let inputs = (job.inputs(), digests);
    let done = folder.step_after(
        "identify",
        &inputs,
        || read(job, watch),
        |parts, dir| of_read(job, parts, dir, watch),
    )?;
    if done.resumed {
        watch.note("same spec and data as before: result taken from the earlier run");
    }
    folder.write_summary(&done.result)?;
    Ok((done.result, folder))
}

/// What a run would do and take, and what it would refuse of its records: they are read and prepared, nothing is written.
///
/// # Errors
/// [`IdentifyError`].
pub fn check(job: &Job, watch: Watch) -> Result<Estimate, IdentifyError> {
    let mut parts = parts(job, watch.note)?;
    let plan = of_parts(job, &parts)?;
    if plan.allowed().is_err() {
        return Ok(plan);
    }
    fit_records(job, &parts)?;
    prepare_parts(job, &mut parts, None)?;
    if !job.saved.is_empty() {
        sampled_alike(job, &parts)?;
        return Ok(plan);
    }
    for t in &job.targets {
        shaped(t, &parts[0].records)?;
        parts[1..]
            .iter()
            .flat_map(|p| &p.records)
            .try_for_each(|d| shape(d, &t.inputs, &t.target).map(drop))?;
    }
    Ok(plan)
}

/// The work of a job in memory; files go into `dir`.
///
/// # Errors
/// [`IdentifyError`].
pub fn work(job: &Job, dir: &path::Path, watch: Watch) -> Result<Identified, IdentifyError> {
    of_read(job, read(job, watch)?, dir, watch)
}

/// The records of a job, checked; writes nothing.
fn read(job: &Job, watch: Watch) -> Result<Vec<Part>, IdentifyError> {
    let parts = parts(job, watch.note)?;
    of_parts(job, &parts)?.allowed().map_err(|e| IdentifyError::Large(e.to_string()))?;
    fit_records(job, &parts)?;
    Ok(parts)
}

fn of_read(
    job: &Job,
    mut parts: Vec<Part>,
    dir: &path::Path,
    watch: Watch,
) -> Result<Identified, IdentifyError> {
    let measured = measured(&parts[0].records);
    let pieces = job.targets.iter().map(|t| pieces(job, t, &parts)).collect::<Result<Vec<_>, _>>()?;
    let preparation = prepare_parts(job, &mut parts, Some(dir))?;
    let dynamic = job.saved.is_empty() && !job.is_steady();
    let first = if dynamic { before(job, &parts[0].records)? } else { None };
    let estimated = if job.saved.is_empty() {
        // Targets share nothing but the data.
        job.targets.par_iter().map(|t| estimate_target(t, &parts, watch)).collect::<Result<Vec<_>, _>>()?
    } else {
        sampled_alike(job, &parts)?;
        job.saved.iter().map(saved).collect::<Result<Vec<_>, _>>()?
    };
    let estimated: Vec<Estimated> = estimated.into_iter().map(|e| e.starting(job.validate.initial)).collect();
    let set = Set::new(job.targets.iter().zip(&estimated).map(member).collect());
    if let Some((target, input)) = set.without_step() {
        return Err(IdentifyError::Together { target: target.into(), input: input.into() });
    }
    if let Some((target, input)) = set.loop_at_once() {
        return Err(IdentifyError::Loop { target: target.into(), input: input.into() });
    }
    watch.note("scoring");
    let fitted: Vec<Vec<Experiment>> = job
        .targets
        .iter()
        .map(|t| parts[0].records.iter().map(|d| Ok(bridged(&shape(d, &t.inputs, &t.target)?).0)).collect())
        .collect::<Result<_, DataError>>()?;
    let judged: Vec<Judged> =
        job.targets.iter().zip(&estimated).map(|(t, e)| judged(t, e, &measured)).collect();
    let mut scored = Vec::new();
    let ending = job.keep.ending(parts.iter().flat_map(|p| &p.records).map(Dataset::len).sum());
    for part in &parts {
        let notes = preparation.iter().find(|p| p.part == part.name).map_or(&[][..], |p| &p.notes);
        let bounds = |k: usize, r: &Experiment| {
            // The band of one model says nothing about a set that runs together.
            if set.is_coupled() || job.is_steady() {
                None
            } else {
                free_run_bounds(job, &estimated[k], &fitted[k], r)
            }
        };
        // Present values alone: every kind of output is the same.
        let kinds = if job.is_steady() { vec![Kind::FreeRun] } else { job.validate.kinds() };
        scored.push(score(part, notes, &set, &judged, (&kinds, &job.validate), &bounds, (dir, ending))?);
    }
    let mut models = Vec::new();
    for (k, (t, e)) in job.targets.iter().zip(&estimated).enumerate() {
        let judged = after(job, t, e, &parts, watch)?;
        let notes = preparation.first().map_or(&[][..], |p| &p.notes);
        let whole = (&parts[0].records[0], notes, measured.as_slice());
        let mut model = modelled(job, t, e, whole, &scored, judged, (dir, pieces[k].clone()))?;
        if job.saved.is_empty()
            && !set.is_coupled()
            && let Some((driven, _)) = e.model.simulated()
        {
            let notes =
                |part: &str| preparation.iter().find(|p| p.part == part).map_or(vec![], |p| p.notes.clone());
            model.baseline = baseline(t, driven, &parts, &notes)?;
        }
        if job.is_steady() {
            model.points = points(job, t, e, &parts, watch)?;
        } else if let Some((driven, theta)) = e.model.simulated() {
            let d = &parts[0].records[0];
            // The covariance belongs to the parameters of the form, which are those of what is driven only in NARX models.
            let fit = e.fit.as_ref().filter(|_| e.model.form().dynamics().is_some());
            let found = curves(driven, theta, fit, &t.inputs, &fitted[k], d.sample_time_s);
            let own = |values: &mut [f64]| restored(notes, d, &t.target, values);
            let level = job.validate.confidence;
            model.curves = found.into_iter().map(|c| c.restored(level, own)).collect::<Result<_, _>>()?;
            for c in &mut model.curves {
                c.unit.clone_from(&d.channel(&c.input)?.unit);
            }
            if e.model.form().goes_on_from_outputs() {
                model.poles = poles_at_rest(driven, theta, &fitted[k]);
            } else {
                // Steps and slopes at rest start from one output, which is not the rest of each member.
                model.curves.iter_mut().for_each(InputCurves::steady_only);
            }
            model.sample_time_s = Some(d.sample_time_s);
        }
        models.push(model);
    }
    let mut found = finish(job, &parts, &estimated, models, scored, &preparation);
    found.files.extend(preparation.iter().flat_map(|p| &p.stages).map(|s| s.file.clone()));
    found.preparation = preparation;
    found.before = first;
    found.verdict = verdict(&found);
    Ok(found)
}

pub(super) fn member((t, e): (&Target, &Estimated)) -> Member {
    Member { target: t.target.clone(), inputs: t.inputs.clone(), model: e.model.clone() }
}

/// The errors that should be small: of a saved model those of the free run.
fn minimised(e: &Estimated) -> Kind {
    match e.fit.as_ref().map(|f| f.minimised) {
        Some(Minimised::OneStep) => Kind::OneStep,
        Some(Minimised::FreeRun) | None => Kind::FreeRun,
    }
}

/// What is known of a target before it is scored.
pub(super) fn judged(t: &Target, e: &Estimated, measured: &[stored::Seen]) -> Judged {
    let seen = measured.iter().find(|s| s.name == t.target);
    let by_free_run = estimate::row("sem").is_ok_and(|r| r.fits.covers(e.model.form().row()));
    let one_step = e.fit.as_ref().is_some_and(|f| f.minimised == Minimised::OneStep);
    let advice = if by_free_run && one_step {
        "estimate it by the errors of its free run (estimator `sem`), or with fewer output terms"
    } else {
        "fewer output terms, a lower degree, or records that cover these inputs"
    };
    Judged {
        minimised: minimised(e),
        range: seen.map_or([f64::NAN; 2], |s| [s.minimum, s.maximum]),
        advice: advice.into(),
    }
}

/// Saved models take their channels in their own units.
pub(super) fn fit_records(job: &Job, parts: &[Part]) -> Result<(), IdentifyError> {
    for d in parts.iter().flat_map(|p| &p.records) {
        for m in &job.saved {
            for q in m.measured() {
                let c = d.channel(&q.name)?;
                if c.unit != q.unit {
                    return Err(StoredError::Unit {
                        record: d.name.clone(),
                        channel: q.name,
                        found: c.unit.clone(),
                        expected: q.unit,
                        output: m.output.name.clone(),
                    }
                    .into());
                }
            }
        }
    }
    Ok(())
}

/// A model counts samples: records in another sample time are another system.
pub(super) fn sampled_alike(job: &Job, parts: &[Part]) -> Result<(), DataError> {
    let dynamic = job.saved.iter().filter(|m| !m.is_steady());
    for (m, d) in dynamic.flat_map(|m| parts.iter().flat_map(|p| &p.records).map(move |d| (m, d))) {
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

/// The estimation records of a target. Missing samples are for those who asked for them.
fn shaped(t: &Target, records: &[Dataset]) -> Result<Vec<Experiment>, DataError> {
    let marked = records.iter().any(|d| d.channels.iter().any(|c| c.values.iter().any(|v| v.is_nan())));
    if marked {
        experiments_marked(records, &t.inputs, &t.target)
    } else {
        experiments(records, &t.inputs, &t.target)
    }
}

pub(super) fn estimate_target(t: &Target, parts: &[Part], watch: Watch) -> Result<Estimated, IdentifyError> {
    let data = shaped(t, &parts[0].records)?;
    let selecting = parts.iter().filter(|p| p.name == "selection").flat_map(|p| &p.records);
    let selecting: Vec<Experiment> =
        selecting.map(|d| shape(d, &t.inputs, &t.target)).collect::<Result<_, _>>()?;
    estimate(t, &data, &selecting, watch)
}

fn modelled(
    job: &Job,
    t: &Target,
    e: &Estimated,
    (d, notes, measured): (&Dataset, &[Note], &[stored::Seen]),
    scored: &[Scored],
    (after, boundary): (After, Option<BoundaryModel>),
    (dir, pieces): (&path::Path, Remembered),
) -> Result<Modelled, IdentifyError> {
    let origin = job.sources.iter().filter_map(|s| s.file.file_name()).map(|n| n.to_string_lossy());
    let from = From {
        origin: origin.collect::<Vec<_>>().join(", "),
        files: job.sources.iter().map(|s| digest_of_file(&s.file)).collect::<Result<_, _>>()?,
        pieces,
    };
    let file = stored_model(job, t, e, (d, notes, measured), boundary, from)?;
    let output = file.output.clone();
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
        what: response(e).map(|r| r.describe()),
        estimator: t.estimator.clone(),
        status: e.fit.as_ref().map(|f| f.status),
        parameters: e.parameters.clone(),
        // A fit without covariance of its parameters has no rank to tell.
        rank: e.fit.as_ref().filter(|f| f.covariance.len() == f.theta.len().pow(2)).map(|f| f.rank),
        evaluations: e.fit.as_ref().map(|f| f.evaluations),
        samples: e.fit.as_ref().map(|f| f.samples),
        selection: e.selection.as_ref().map(|s| Path { pool: s.pool, kept: s.steps, steps: s.path.clone() }),
        residuals: scored.iter().flat_map(own).collect(),
        baseline: None,
        curves: Vec::new(),
        poles: Vec::new(),
        sample_time_s: None,
        points: None,
        after,
        file: in_step(&name),
    })
}

/// Where the data of a model came from.
pub(super) struct From {
    /// In words.
    pub(super) origin: String,
    /// Digests of its files.
    pub(super) files: Vec<String>,
    /// What the model remembers of its records.
    pub(super) pieces: Remembered,
}

/// What is kept of a target: `d` is the first prepared record of the estimation, `measured` what its channels were before.
pub(super) fn stored_model(
    job: &Job,
    t: &Target,
    e: &Estimated,
    (d, notes, measured): (&Dataset, &[Note], &[stored::Seen]),
    boundary: Option<BoundaryModel>,
    from: From,
) -> Result<StoredModel, DataError> {
    let quantity = |name: &String| -> Result<Quantity, DataError> {
        Ok(Quantity { name: name.clone(), unit: own_unit(notes, d, name)? })
    };
    let mut file = StoredModel {
        structure: e.model.any().clone(),
        inputs: t.inputs.iter().map(quantity).collect::<Result<_, _>>()?,
        output: quantity(&t.target)?,
        sample_time_s: d.sample_time_s,
        parameters: e.parameters.clone(),
        correlation: None,
        estimator: t.estimator.clone(),
        noise_variance: e.fit.as_ref().map(|f| f.noise_variance),
        boundary,
        derived: derived_for(job, t),
        preparation: notes.to_vec(),
        initial: job.validate.initial,
        seen: measured.to_vec(),
        origin: from.origin,
        files: from.files,
        estimated_on: from.pieces.estimation,
        selected_on: from.pieces.selection,
    };
    if let Some(fit) = &e.fit {
        file.correlate(&fit.covariance);
    }
    let behind = file.measured();
    file.seen.retain(|s| behind.iter().any(|q| q.name == s.name));
    Ok(file)
}

/// What was learnt, of a response model.
fn response(e: &Estimated) -> Option<&ResponseModel> {
    e.model.form().is_a::<ResponseForm>()?.response()
}

/// Units and ranges of the channels of the estimation, as they were measured.
pub(super) fn measured(records: &[Dataset]) -> Vec<stored::Seen> {
    let channels = records.first().map_or(&[][..], |d| &d.channels);
    let one = |c: &dynocal_ident::data::Channel| {
        let values =
            || records.iter().filter_map(|d| d.values(&c.name).ok()).flatten().filter(|v| v.is_finite());
        let least = values().copied().fold(f64::INFINITY, f64::min);
        let most = values().copied().fold(f64::NEG_INFINITY, f64::max);
        (least <= most).then(|| stored::Seen {
            name: c.name.clone(),
            unit: c.unit.clone(),
            minimum: least,
            maximum: most,
        })
    };
    channels.iter().filter_map(one).collect()
}

/// The derived channels that the model of a target reads or computes, and those that they follow from.
fn derived_for(job: &Job, t: &Target) -> Vec<dynocal_ident::derived::Derived> {
    let mut needed: Vec<&String> = t.inputs.iter().chain([&t.target]).collect();
    let mut out = Vec::new();
    for d in job.derive.iter().rev().map(|d| &d.channel) {
        if needed.contains(&&d.name) {
            needed.extend(d.powers.keys());
            out.push(d.clone());
        }
    }
    out.reverse();
    out
}

fn finish(
    job: &Job,
    parts: &[Part],
    estimated: &[Estimated],
    models: Vec<Modelled>,
    scored: Vec<Scored>,
    preparation: &[Prepared],
) -> Identified {
    let mut findings: Vec<Finding> = scored.iter().flat_map(|s| s.findings.clone()).collect();
    findings.extend(scored.iter().flat_map(|s| of_scores(&s.scores)).filter(|_| !job.is_steady()));
    for (t, e) in job.targets.iter().zip(estimated) {
        findings.extend(e.fit.iter().flat_map(|f| of_fit(t, f)));
    }
    findings.extend(models.iter().flat_map(of_model));
    let read =
        |p: &Part| p.notes.iter().map(|n| Finding::new(Grade::Note, "", n.as_str())).collect::<Vec<_>>();
    findings.extend(parts.iter().flat_map(read));
    findings.extend(losses(preparation));
    findings.extend(parts.first().map_or(Vec::new(), |p| of_values(job, &p.records)));
    if parts.iter().all(|p| p.seen != Seen::Unseen) {
        let text = if job.saved.is_empty() {
            "no test data in the split: nothing says how the model does on unseen data"
        } else {
            "the model was estimated from this file: nothing says how it does on unseen data"
        };
        findings.push(Finding::new(Grade::Warning, "", text).on(Topic::NoTestData));
    }
    let findings = sorted(findings);
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
        verdict: Vec::new(),
        steady: job.is_steady(),
        valid: findings.iter().all(|f| f.grade != Grade::Fault),
        warnings: findings.iter().filter(|f| f.grade != Grade::Note).map(Finding::sentence).collect(),
        findings,
        files: files.collect(),
        preparation: Vec::new(),
        confidence: job.validate.confidence,
        before: None,
        models,
        scores,
        records,
    }
}
