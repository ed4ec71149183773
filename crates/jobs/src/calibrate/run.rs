//! The steps in order inside one run folder; finished steps of an earlier run are taken over.

use super::context::Context;
use super::design_step::{DesignResult, design};
use super::error::ChainError;
use super::excite_step::{ExciteResult, excite};
use super::fuel_plant::as_asked;
use super::invert_step::{InvertResult, finished, invert_refined};
use super::models::{ModelData, ModelsResult, identify_all, save_models};
use super::optimise_step::{OptimiseResult, Pass, optimise};
use super::poor;
use super::records::RecordRef;
use super::spec::OptimiseSpec;
use super::validate_step::{ValidateResult, validate};
use dynocal_files::json;
use dynocal_files::run_folder::{Done, RunFolder};
use dynocal_ident::data::Dataset;
use serde::Serialize;
use serde::de::DeserializeOwned;
use std::path::{Path, PathBuf};
use std::sync::atomic::Ordering;

/// Steps of a campaign that measure and compute; the report is the seventh.
pub const STEPS: [&str; 6] = ["excite", "identify", "design", "optimise", "invert", "validate"];

/// Everything that a campaign found, as far as it went.
#[derive(Debug, Default)]
pub struct ChainResult {
    /// Step 1.
    pub excite: Option<Done<ExciteResult>>,
    /// Step 2.
    pub identify: Option<Done<ModelsResult>>,
    /// Step 3.
    pub design: Option<Done<DesignResult>>,
    /// Step 4.
    pub optimise: Option<Done<OptimiseResult>>,
    /// Step 5.
    pub invert: Option<Done<InvertResult>>,
    /// Step 6.
    pub validate: Option<Done<ValidateResult>>,
}

impl ChainResult {
    /// Names of the steps that were taken from an earlier run.
    pub fn resumed(&self) -> Vec<&'static str> {
        let taken = [
            self.excite.as_ref().is_some_and(|d| d.resumed),
            self.identify.as_ref().is_some_and(|d| d.resumed),
            self.design.as_ref().is_some_and(|d| d.resumed),
            self.optimise.as_ref().is_some_and(|d| d.resumed),
            self.invert.as_ref().is_some_and(|d| d.resumed),
            self.validate.as_ref().is_some_and(|d| d.resumed),
        ];
        STEPS.into_iter().zip(taken).filter(|(_, taken)| *taken).map(|(name, _)| name).collect()
    }

    /// Bed time of the tests that gave the loops their gains, in s.
    pub fn loops_bed_s(&self) -> f64 {
        self.excite.as_ref().and_then(|d| d.result.tuned.as_ref()).map_or(0.0, |t| t.used_s)
    }

    /// Bed time of tests of loops, of identification, design and optimisation records, of points at rest and of records that identify
    /// fuelling, in s.
    pub fn bed_s(&self) -> f64 {
        self.loops_bed_s()
            + self.excite.as_ref().map_or(0.0, |d| d.result.identification_bed_s)
            + self.design.as_ref().map_or(0.0, |d| d.result.bed_s)
            + self.optimise.as_ref().map_or(0.0, |d| d.result.bed_s)
            + self.invert.as_ref().map_or(0.0, |d| d.result.refine_s)
            + self.at_rest_bed_s()
            + self.fuelling_bed_s()
    }

    /// Bed time of the records that identified who injects, in s; 0 where that came as a file.
    pub fn fuelling_bed_s(&self) -> f64 {
        let from = self.excite.as_ref().and_then(|d| d.result.fuelled.as_ref());
        from.map_or(0.0, |from| from.bed_s)
    }

    /// Bed time of the points that the map was moved onto, in s.
    pub fn at_rest_bed_s(&self) -> f64 {
        self.invert.as_ref().and_then(|d| d.result.at_rest.as_ref()).map_or(0.0, |r| r.bed_s)
    }
}

/// Runs all steps up to and including `until` (one of [`STEPS`]): those up to the optimisation on the plant of `on`, which is that of
/// `ctx` or engine and fuelling as one.
///
/// # Errors
/// [`ChainError`]; steps that were finished stay in the folder and are taken over by the next run.
pub fn run(
    ctx: &Context,
    on: &Context,
    folder: &mut RunFolder,
    until: &str,
) -> Result<ChainResult, ChainError> {
    let mut result = ChainResult::default();
    let last = STEPS.iter().position(|s| *s == until).ok_or_else(|| ChainError::Spec {
        key: "--until".into(),
        found: until.into(),
        expected: format!("one of {}", STEPS.join(", ")),
    })?;
    // A fault of a file that is given is told before anything is measured.
    super::given::check(on)?;
    super::fuelled::check(ctx)?;
    for (k, step) in STEPS.iter().enumerate() {
        ctx.check_interrupt()?;
        // Later steps that are finished and still belong to these inputs stay part of the run.
        let how = if k <= last { How::Run } else { How::Take };
        if how == How::Run {
            on.begun.store(k, Ordering::Relaxed);
            ctx.begin(k, STEPS.len() + 1, step);
        }
        if *step == "optimise"
            && let Some(why) = result.design.as_ref().and_then(|d| poor::refused(ctx.spec, &d.result.models))
        {
            if how == How::Run {
                ctx.watch.note(&why);
            }
            break;
        }
        let found = match *step {
            "excite" => kept(step_excite((ctx, on), folder, how)?, &mut result.excite),
            "identify" => kept(step_identify(on, folder, &result, how)?, &mut result.identify),
            "design" => kept(step_design(on, folder, &result, how)?, &mut result.design),
            "optimise" => kept(step_optimise(on, folder, &result, how)?, &mut result.optimise),
            "invert" => kept(step_invert((ctx, on), folder, &result, how)?, &mut result.invert),
            _ => kept(step_validate((ctx, on), folder, &result, how)?, &mut result.validate),
        };
        if !found {
            break;
        }
    }
    Ok(result)
}

/// Whether a step is run where it is not finished, or only taken where it is.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum How {
    Run,
    Take,
}

/// How a campaign of engine and fuelling as one plant is made: another number with every change of what its models read, so that steps
/// of another way are not taken over. All later steps stand on the first one.
const GOVERNED: usize = 2;

/// Inputs of the first step; the same as ever where a map injects.
#[derive(Serialize)]
#[serde(untagged)]
enum Inputs<I> {
    Plain(I),
    Governed(I, usize),
}

/// Keeps what was found; whether there was anything.
fn kept<T>(found: Option<Done<T>>, place: &mut Option<Done<T>>) -> bool {
    *place = found;
    place.is_some()
}

fn run_step<T: Serialize + DeserializeOwned, I: Serialize>(
    ctx: &Context,
    folder: &mut RunFolder,
    how: How,
    name: &'static str,
    inputs: &I,
    work: impl FnOnce(&Path) -> Result<T, ChainError>,
) -> Result<Option<Done<T>>, ChainError> {
    let s = ctx.spec;
    let common = (s.seed, s.sample_time_s, &s.plant, &s.problem, &s.loops, &s.abort);
    let inputs = (common, ctx.measured_digests(), inputs);
    if how == How::Take {
        return Ok(folder.finished(name, &inputs)?);
    }
    let done = folder.step(name, &inputs, |path| {
        let result = work(path)?;
        // An estimate that was interrupted is a result to its estimator, but none of a finished step.
        ctx.check_interrupt()?;
        Ok::<T, ChainError>(result)
    })?;
    if done.resumed {
        ctx.watch.note(&format!("{name}: taken from the earlier run"));
    }
    Ok(Some(done))
}

/// Digests of files that the spec names: another content is another input of the step.
fn digests(files: &[&PathBuf]) -> Result<Vec<String>, ChainError> {
    files
        .iter()
        .map(|path| {
            let bytes = std::fs::read(path).map_err(|e| dynocal_files::FilesError::Read {
                path: path.display().to_string(),
                reason: e.to_string(),
            })?;
            Ok(dynocal_files::run_folder::digest(&bytes))
        })
        .collect()
}

fn step_excite(
    (ctx, on): (&Context, &Context),
    folder: &mut RunFolder,
    how: How,
) -> Result<Option<Done<ExciteResult>>, ChainError> {
    let e = &ctx.spec.excite;
    let fuelling = super::fuelled::files(ctx);
    let files: Vec<&PathBuf> =
        e.identification_files.iter().chain(&e.validation_files).chain(&fuelling).collect();
    let inputs = (e, &ctx.spec.identify.init_samples, digests(&files)?, &ctx.spec.tune, &ctx.spec.fuelling);
    let inputs = match ctx.spec.fuelling.as_ref().is_some_and(|f| f.plant) {
        true => Inputs::Governed(inputs, GOVERNED),
        false => Inputs::Plain(inputs),
    };
    let done = run_step(ctx, folder, how, "excite", &inputs, |path| excite(ctx, on, path))?;
    for c in [ctx, on] {
        c.close_loops_with(done.as_ref().and_then(|d| d.result.tuned.as_ref()));
    }
    if let Some(d) = &done {
        super::fuelled::inject(ctx, &d.folder, d.result.fuelled.as_ref())?;
    }
    Ok(done)
}

/// A finished step that another one builds on; the order of [`STEPS`] makes it present.
fn needed<'a, T>(step: &'a Option<Done<T>>, name: &str) -> Result<&'a Done<T>, ChainError> {
    step.as_ref().ok_or_else(|| ChainError::Design(format!("step `{name}` has not run")))
}

struct Records {
    identification: Vec<(Dataset, PathBuf)>,
    validation: Vec<Dataset>,
}

fn with_files(
    ctx: &Context,
    folder: &Path,
    refs: &[RecordRef],
) -> Result<Vec<(Dataset, PathBuf)>, ChainError> {
    let records = ctx.load_records(folder, refs)?;
    Ok(records.into_iter().zip(refs).map(|(d, r)| (d, folder.join(&r.file))).collect())
}

fn records(ctx: &Context, result: &ChainResult) -> Result<Records, ChainError> {
    let excite = needed(&result.excite, "excite")?;
    Ok(Records {
        identification: with_files(ctx, &excite.folder, &excite.result.identification)?,
        validation: ctx.load_records(&excite.folder, &excite.result.validation)?,
    })
}

fn step_identify(
    ctx: &Context,
    folder: &mut RunFolder,
    result: &ChainResult,
    how: How,
) -> Result<Option<Done<ModelsResult>>, ChainError> {
    let files: Vec<&PathBuf> = ctx.spec.identify.files.values().collect();
    let inputs = (&ctx.spec.identify, &needed(&result.excite, "excite")?.digest, digests(&files)?);
    run_step(ctx, folder, how, "identify", &inputs, |path| {
        let r = records(ctx, result)?;
        let data = ModelData { identification: &r.identification, validation: &r.validation };
        let models = identify_all(ctx, path, &data)?;
        save_models(path, &models)?;
        Ok(models)
    })
}

fn step_design(
    ctx: &Context,
    folder: &mut RunFolder,
    result: &ChainResult,
    how: How,
) -> Result<Option<Done<DesignResult>>, ChainError> {
    let identify = needed(&result.identify, "identify")?;
    let files: Vec<&PathBuf> = ctx.spec.design.record.iter().collect();
    let inputs = (&ctx.spec.design, &ctx.spec.excite, &identify.digest, digests(&files)?);
    run_step(ctx, folder, how, "design", &inputs, |path| {
        let r = records(ctx, result)?;
        let done = design(ctx, path, &identify.result, &r.identification, &r.validation)?;
        save_models(path, &done.models)?;
        Ok(done)
    })
}

/// Identification records with the designed one.
fn all_identification(ctx: &Context, result: &ChainResult) -> Result<Records, ChainError> {
    let mut r = records(ctx, result)?;
    let design = needed(&result.design, "design")?;
    r.identification.extend(with_files(ctx, &design.folder, &design.result.records)?);
    Ok(r)
}

fn step_optimise(
    ctx: &Context,
    folder: &mut RunFolder,
    result: &ChainResult,
    how: How,
) -> Result<Option<Done<OptimiseResult>>, ChainError> {
    let design = needed(&result.design, "design")?;
    let files: Vec<&PathBuf> = ctx.spec.optimise.start_maps.iter().flat_map(|m| &m.files).collect();
    let before = format!("{}{}", design.digest, digests(&files)?.concat());
    // Whether it is sought at all is no input of what is found.
    let optimise_spec = OptimiseSpec { force: false, ..ctx.spec.optimise.clone() };
    let inputs = (&optimise_spec, &ctx.spec.identify, &ctx.spec.excite, &before);
    run_step(ctx, folder, how, "optimise", &inputs, |path| {
        let r = all_identification(ctx, result)?;
        let done = optimise(ctx, path, &design.result.models, &r.identification, &r.validation)?;
        if let Some(last) = done.passes.last() {
            save_models(path, &last.models)?;
        }
        Ok(done)
    })
}

/// The last pass, which is the best informed one.
fn last_pass(result: &OptimiseResult) -> Result<&Pass, ChainError> {
    result.passes.last().ok_or_else(|| ChainError::Spec {
        key: "optimise.passes".into(),
        found: "0".into(),
        expected: "at least 1".into(),
    })
}

fn step_invert(
    (ctx, on): (&Context, &Context),
    folder: &mut RunFolder,
    result: &ChainResult,
    how: How,
) -> Result<Option<Done<InvertResult>>, ChainError> {
    let optimise = needed(&result.optimise, "optimise")?;
    // The points at rest move as those of the comparison do, and dynamics are chosen on demands like them.
    let inputs = (&ctx.spec.invert, &ctx.spec.validate.scenario, &optimise.digest);
    run_step(ctx, folder, how, "invert", &inputs, |path| {
        let passes = &optimise.result.passes;
        let last = last_pass(&optimise.result)?;
        let any = passes.iter().any(|p| p.usable);
        let (mut optima, mut left_out) = (Vec::new(), Vec::new());
        for pass in passes {
            // Without a usable pass the map learns from the last one all the same, and the verdict says so.
            if pass.usable || (!any && pass.pass == last.pass) {
                // The second record of a pass is the optimum.
                optima.extend(on.load_records(&optimise.folder, &pass.records[1..])?);
            } else {
                left_out.push(format!("pass {}: {}", pass.pass, pass.reason));
            }
        }
        if let Some(by) = ctx.governs() {
            optima.iter_mut().for_each(|record| as_asked(record, by));
        }
        let models = last.models.chosen();
        let fitted = invert_refined(ctx, path, optima, &left_out, &models)?;
        let done = finished(ctx, path, fitted, &models)?;
        json::write_versioned(&path.join("dynamic_map.json"), "dynocal/dynamic-map", 3, &done.dynamic)?;
        Ok(done)
    })
}

fn step_validate(
    (ctx, on): (&Context, &Context),
    folder: &mut RunFolder,
    result: &ChainResult,
    how: How,
) -> Result<Option<Done<ValidateResult>>, ChainError> {
    let (invert, optimise) = (needed(&result.invert, "invert")?, needed(&result.optimise, "optimise")?);
    let inputs = (&ctx.spec.validate, &invert.digest);
    run_step(ctx, folder, how, "validate", &inputs, |path| {
        let last = last_pass(&optimise.result)?;
        let models = last.models.chosen();
        let last = (last, optimise.folder.as_path());
        let done = validate((ctx, on), path, &invert.result, last, &models)?;
        json::write_versioned(&path.join("static_map.json"), "dynocal/static-map", 2, &done.static_map)?;
        Ok(done)
    })
}
