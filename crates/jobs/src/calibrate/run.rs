//! The seven steps in order inside one run folder; finished steps of an earlier run are taken over.

use super::context::{ChainError, Context, Event, RecordRef, load_records};
use super::design_step::{DesignResult, design};
use super::excite_step::{ExciteResult, excite};
use super::invert_step::{InvertResult, invert};
use super::models::{ModelsResult, OutputModels, identify_pair};
use super::optimise_step::{OptimiseResult, optimise};
use super::validate_step::{ValidateResult, validate};
use dynocal_files::run_folder::{Done, RunFolder};
use dynocal_ident::data::Dataset;
use serde::Serialize;
use serde::de::DeserializeOwned;
use std::path::Path;

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
    /// Bed time of identification, design and optimisation records in s.
    pub fn bed_s(&self) -> f64 {
        self.excite.as_ref().map_or(0.0, |d| d.result.identification_bed_s)
            + self.design.as_ref().map_or(0.0, |d| d.result.bed_s)
            + self.optimise.as_ref().map_or(0.0, |d| d.result.bed_s)
    }
}

/// Runs all steps up to and including `until` (one of [`STEPS`]).
///
/// # Errors
/// [`ChainError`]; steps that were finished stay in the folder and are taken over by the next run.
pub fn run(ctx: &Context, folder: &mut RunFolder, until: &str) -> Result<ChainResult, ChainError> {
    let mut result = ChainResult::default();
    let last = STEPS.iter().position(|s| *s == until).ok_or_else(|| ChainError::Spec {
        key: "step".into(),
        found: until.into(),
        expected: format!("one of {}", STEPS.join(", ")),
    })?;
    for (k, step) in STEPS.iter().enumerate().take(last + 1) {
        ctx.check_interrupt()?;
        (ctx.tell)(Event::Step(k + 1, STEPS.len() + 1, step));
        match *step {
            "excite" => result.excite = Some(step_excite(ctx, folder)?),
            "identify" => result.identify = Some(step_identify(ctx, folder, &result)?),
            "design" => result.design = Some(step_design(ctx, folder, &result)?),
            "optimise" => result.optimise = Some(step_optimise(ctx, folder, &result)?),
            "invert" => result.invert = Some(step_invert(ctx, folder, &result)?),
            _ => result.validate = Some(step_validate(ctx, folder, &result)?),
        }
    }
    Ok(result)
}

fn tell_resumed<T>(ctx: &Context, done: Done<T>, step: &'static str) -> Done<T> {
    if done.resumed {
        (ctx.tell)(Event::Resumed(step));
    }
    done
}

fn run_step<T: Serialize + DeserializeOwned, I: Serialize>(
    ctx: &Context,
    folder: &mut RunFolder,
    name: &'static str,
    inputs: &I,
    work: impl FnOnce(&Path) -> Result<T, ChainError>,
) -> Result<Done<T>, ChainError> {
    let common = (ctx.spec.seed, ctx.spec.sample_time_s, &ctx.spec.plant, ctx.measured_digests(), inputs);
    let done = folder.step(name, &common, |path| {
        let result = work(path)?;
        // An estimate that was interrupted is a result to its estimator, but none of a finished step.
        ctx.check_interrupt()?;
        Ok::<T, ChainError>(result)
    })?;
    Ok(tell_resumed(ctx, done, name))
}

fn step_excite(ctx: &Context, folder: &mut RunFolder) -> Result<Done<ExciteResult>, ChainError> {
    let inputs = (&ctx.spec.excite, &ctx.spec.identify.init_samples, ctx.actuator_limits_key());
    run_step(ctx, folder, "excite", &inputs, |path| excite(ctx, path))
}

/// A finished step that another one builds on; the order of [`STEPS`] makes it present.
fn needed<'a, T>(step: &'a Option<Done<T>>, name: &str) -> Result<&'a Done<T>, ChainError> {
    step.as_ref().ok_or_else(|| ChainError::Design(format!("step `{name}` has not run")))
}

struct Records {
    identification: Vec<Dataset>,
    validation: Vec<Dataset>,
}

fn records(ctx: &Context, result: &ChainResult) -> Result<Records, ChainError> {
    let excite = needed(&result.excite, "excite")?;
    let load = |refs: &[RecordRef]| -> Result<Vec<Dataset>, ChainError> {
        with_init(ctx, load_records(&excite.folder, refs, ctx.spec.sample_time_s)?)
    };
    Ok(Records {
        identification: load(&excite.result.identification)?,
        validation: load(&excite.result.validation)?,
    })
}

fn with_init(ctx: &Context, mut records: Vec<Dataset>) -> Result<Vec<Dataset>, ChainError> {
    for r in &mut records {
        r.init_samples = ctx.spec.identify.init_samples;
    }
    Ok(records)
}

fn step_identify(
    ctx: &Context,
    folder: &mut RunFolder,
    result: &ChainResult,
) -> Result<Done<ModelsResult>, ChainError> {
    let inputs = (&ctx.spec.identify, &needed(&result.excite, "excite")?.digest);
    run_step(ctx, folder, "identify", &inputs, |path| {
        let r = records(ctx, result)?;
        let (torque, lambda) = identify_pair(ctx, &r.identification, &r.validation)?;
        save_models(path, &torque, &lambda)?;
        Ok(ModelsResult { torque, lambda })
    })
}

/// Writes the chosen models as files of their own.
///
/// # Errors
/// [`ChainError::Files`].
pub fn save_models(path: &Path, torque: &OutputModels, lambda: &OutputModels) -> Result<(), ChainError> {
    for models in [torque, lambda] {
        let file = path.join(format!("{}_model.json", models.output));
        dynocal_files::json::write(&file, &models.best().model)?;
    }
    Ok(())
}

fn step_design(
    ctx: &Context,
    folder: &mut RunFolder,
    result: &ChainResult,
) -> Result<Done<DesignResult>, ChainError> {
    let identify = needed(&result.identify, "identify")?;
    let inputs = (&ctx.spec.design, &ctx.spec.excite, &identify.digest);
    run_step(ctx, folder, "design", &inputs, |path| {
        let r = records(ctx, result)?;
        let done = design(ctx, path, &identify.result, &r.identification, &r.validation)?;
        save_models(path, &done.torque, &done.lambda)?;
        Ok(done)
    })
}

/// Identification records with the designed one.
fn all_identification(ctx: &Context, result: &ChainResult) -> Result<Records, ChainError> {
    let mut r = records(ctx, result)?;
    let design = needed(&result.design, "design")?;
    let extra = load_records(&design.folder, &design.result.records, ctx.spec.sample_time_s)?;
    r.identification.extend(with_init(ctx, extra)?);
    Ok(r)
}

fn step_optimise(
    ctx: &Context,
    folder: &mut RunFolder,
    result: &ChainResult,
) -> Result<Done<OptimiseResult>, ChainError> {
    let design = needed(&result.design, "design")?;
    let inputs = (&ctx.spec.optimise, &ctx.spec.identify, &design.digest);
    run_step(ctx, folder, "optimise", &inputs, |path| {
        let r = all_identification(ctx, result)?;
        let models = (&design.result.torque, &design.result.lambda);
        let done = optimise(ctx, path, models, &r.identification, &r.validation)?;
        if let Some(last) = done.passes.last() {
            save_models(path, &last.torque, &last.lambda)?;
        }
        Ok(done)
    })
}

fn step_invert(
    ctx: &Context,
    folder: &mut RunFolder,
    result: &ChainResult,
) -> Result<Done<InvertResult>, ChainError> {
    let optimise = needed(&result.optimise, "optimise")?;
    let inputs = (&ctx.spec.invert, &optimise.digest);
    run_step(ctx, folder, "invert", &inputs, |path| {
        let mut optima = Vec::new();
        for pass in &optimise.result.passes {
            // The second record of a pass is the optimum.
            optima.extend(load_records(&optimise.folder, &pass.records[1..], ctx.spec.sample_time_s)?);
        }
        let last = optimise.result.passes.last().ok_or_else(|| ChainError::Spec {
            key: "optimise.passes".into(),
            found: "0".into(),
            expected: "at least 1".into(),
        })?;
        let optima = with_init(ctx, optima)?;
        let done = invert(ctx, &optima, &last.torque.best().model, &last.lambda.best().model)?;
        dynocal_files::json::write_versioned(
            &path.join("dynamic_map.json"),
            "dynocal/dynamic-map",
            1,
            &done.dynamic,
        )?;
        Ok(done)
    })
}

fn step_validate(
    ctx: &Context,
    folder: &mut RunFolder,
    result: &ChainResult,
) -> Result<Done<ValidateResult>, ChainError> {
    let (invert, optimise) = (needed(&result.invert, "invert")?, needed(&result.optimise, "optimise")?);
    let inputs = (&ctx.spec.validate, &invert.digest);
    run_step(ctx, folder, "validate", &inputs, |path| {
        let last = optimise.result.passes.last().ok_or(ChainError::Interrupted)?;
        let done = validate(ctx, path, &invert.result, last, &optimise.folder)?;
        dynocal_files::json::write_versioned(
            &path.join("static_map.json"),
            "dynocal/static-map",
            1,
            &done.static_map,
        )?;
        Ok(done)
    })
}

/// Measured records of a campaign by step, for plots.
///
/// # Errors
/// [`ChainError`].
pub fn step_records(ctx: &Context, folder: &Path, refs: &[RecordRef]) -> Result<Vec<Dataset>, ChainError> {
    with_init(ctx, load_records(folder, refs, ctx.spec.sample_time_s)?)
}
