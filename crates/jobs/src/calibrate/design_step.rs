//! Step 3: an optimal test signal for the identified models, by the job `design`, played on the plant, and what it gained.
//!
//! The inputs are designed within the limits of the problem, outputs predicted within the demanded ranges; the plan is played
//! with trimming loops about the predicted outputs, so that what the models do not know does not carry the plant away.

use super::context::{Context, Tone};
use super::design_spec::{design_text, predicted};
use super::error::ChainError;
use super::excite_step::extra_record;
use super::given;
use super::models::{ModelData, ModelsResult, identify_all, with_predecessors};
use super::records::{RecordRef, save_records};
use crate::design::result::{CriterionLine, Designed, SafetyLine};
use crate::design::{self, Overrides};
use dynocal_files::atomic;
use dynocal_ident::data::Dataset;
use dynocal_numerics::status::Status;
use serde::{Deserialize, Serialize};
use std::path::{Path, PathBuf};

/// Mean R2 on the unseen records with different identification data.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Gain {
    /// Identification data.
    pub data: String,
    /// Mean R2 by output; none where a free run diverged.
    pub r2: Vec<(String, Option<f64>)>,
}

/// What step 3 leaves behind.
#[derive(Clone, Debug, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct DesignResult {
    /// How the search ended; none when no design was made.
    pub status: Option<Status>,
    /// Why there is no designed record, in a sentence; empty when there is one.
    pub left_out: String,
    /// Evaluations of criterion and gradient.
    pub evaluations: usize,
    /// Criteria.
    pub criteria: Vec<CriterionLine>,
    /// Predicted outputs and their limits.
    pub safety: Vec<SafetyLine>,
    /// Least and largest measured value of each demanded output when the design was played.
    pub measured: Vec<(String, f64, f64)>,
    /// What it gained, beside a further record of the first recipe.
    pub gains: Vec<Gain>,
    /// Measured record of the design.
    pub records: Vec<RecordRef>,
    /// Models from all records including the design.
    pub models: ModelsResult,
    /// Bed time of the designed record in s.
    pub bed_s: f64,
    /// Bed time of the comparison record in s.
    pub comparison_bed_s: f64,
}

fn gain(data: &str, models: &ModelsResult) -> Gain {
    let r2 = models.outputs.iter().map(|o| (o.output.clone(), o.best().unseen_r2)).collect();
    Gain { data: data.into(), r2 }
}

fn nothing(models: &ModelsResult, left_out: &str) -> DesignResult {
    DesignResult {
        status: None,
        left_out: left_out.into(),
        evaluations: 0,
        criteria: Vec::new(),
        safety: Vec::new(),
        measured: Vec::new(),
        gains: vec![gain("identification records", models)],
        records: Vec::new(),
        models: models.clone(),
        bed_s: 0.0,
        comparison_bed_s: 0.0,
    }
}

/// Designs, measures, identifies again.
///
/// # Errors
/// [`ChainError`].
pub fn design(
    ctx: &Context,
    folder: &Path,
    models: &ModelsResult,
    identification: &[(Dataset, PathBuf)],
    validation: &[Dataset],
) -> Result<DesignResult, ChainError> {
    let spec = &ctx.spec.design;
    if let Some(file) = &spec.record {
        let record = given::record(ctx, "design.record", file, "design01")?;
        return measured(ctx, folder, models, record, None, identification, validation);
    }
    if !spec.enabled {
        return Ok(nothing(models, "no design was asked for (`design.enabled = false`)"));
    }
    if !ctx.channels.read.is_empty() {
        return Ok(nothing(
            models,
            "a design knows no models that read each other, as those of engine and fuelling as one plant do",
        ));
    }
    let found = match make(ctx, folder, models, identification)? {
        Ok(found) => found,
        Err(reason) => return Ok(nothing(models, &reason)),
    };
    ctx.fraction(0.5);
    let columns = |names: &[String]| -> Result<Vec<Vec<f64>>, ChainError> {
        Ok(names.iter().map(|n| found.1.values(n).map(<[f64]>::to_vec)).collect::<Result<_, _>>()?)
    };
    let (inputs, given) = (columns(&ctx.channels.inputs)?, columns(&ctx.channels.given)?);
    let demands = predicted(ctx, &found.1, &models.chosen())?;
    let plan = ctx.plan("design01", inputs, given, demands, Tone::Trim);
    let record = ctx.measure_with(folder, &plan, true, &models.chosen())?;
    measured(ctx, folder, models, record, Some(found.0), identification, validation)
}

/// The design by its job; a sentence where there is none.
fn make(
    ctx: &Context,
    folder: &Path,
    models: &ModelsResult,
    identification: &[(Dataset, PathBuf)],
) -> Result<Result<(Designed, Dataset), String>, ChainError> {
    let path = folder.join("design.toml");
    let text = design_text(ctx, folder, models, identification)?;
    atomic::write(&path, text.as_bytes())?;
    let overrides = Overrides { seed: Some(ctx.spec.seed), out: Some(folder.join("design")) };
    let job = design::read(&path, &overrides).map_err(|e| ChainError::Design(e.to_string()))?;
    let found = design::load::load(&job)
        .and_then(|inputs| design::run::make(&job, &inputs, super::design_spec::watch(ctx)));
    ctx.check_interrupt()?;
    match found {
        Ok((designed, curves)) => {
            let record = super::design_spec::as_record(ctx, &curves);
            Ok(Ok((designed, record)))
        }
        Err(e) => Ok(Err(format!("no test was designed: {e}"))),
    }
}

fn measured(
    ctx: &Context,
    folder: &Path,
    before: &ModelsResult,
    record: Dataset,
    designed: Option<Designed>,
    identification: &[(Dataset, PathBuf)],
    validation: &[Dataset],
) -> Result<DesignResult, ChainError> {
    let spec = &ctx.spec.design;
    let records = save_records(folder, std::slice::from_ref(&record))?;
    let with = |extra: &Dataset, file: PathBuf| -> Vec<(Dataset, PathBuf)> {
        identification.iter().cloned().chain([(extra.clone(), file)]).collect()
    };
    let place = |name: &str| -> Result<PathBuf, ChainError> {
        let place = folder.join(name);
        std::fs::create_dir_all(&place).map_err(|e| ChainError::Design(e.to_string()))?;
        Ok(place)
    };
    let data = with(&record, folder.join(&records[0].file));
    // Models that were given learn from no record: there is nothing that it gains.
    let learns = ctx.channels.outputs().iter().any(|o| !ctx.spec.identify.files.contains_key(o));
    // A record of the first recipe beside it, where a plant can measure one.
    let rival = || -> Result<Option<ModelsResult>, ChainError> {
        if ctx.plants.is_none() || !learns {
            return Ok(None);
        }
        let rival = extra_record(ctx, folder, "comparison01", 0)?;
        let saved = save_records(folder, std::slice::from_ref(&rival))?;
        let data = with(&rival, folder.join(&saved[0].file));
        let data = ModelData { identification: &data, validation };
        identify_all(ctx, &place("comparison")?, &data).map(Some)
    };
    let own = || identify_all(ctx, &place("models")?, &ModelData { identification: &data, validation });
    let (models, other) = rayon::join(own, rival);
    let (models, other) = (models?, other?);
    ctx.fraction(0.9);
    let mut gains = vec![gain("identification records", before)];
    if learns {
        gains.push(gain("with the designed record", &models));
    }
    let models = with_predecessors(ctx, models, before, &ModelData { identification: &data, validation })?;
    let mut comparison_bed_s = 0.0;
    if let Some(other) = &other {
        gains.push(gain("with one more record of the first recipe instead", other));
        comparison_bed_s = ctx.spec.excite.record_s + ctx.spec.excite.lead_in_s;
    }
    let span = |name: &String| -> Result<(String, f64, f64), ChainError> {
        let v = record.values(name)?;
        let (lo, hi) = v.iter().fold((f64::INFINITY, f64::NEG_INFINITY), |(a, b), x| (a.min(*x), b.max(*x)));
        Ok((name.clone(), lo, hi))
    };
    let bed_s = if designed.is_some() { spec.record_s + ctx.spec.excite.lead_in_s } else { 0.0 };
    Ok(DesignResult {
        status: designed.as_ref().map(|d| d.status),
        left_out: String::new(),
        evaluations: designed.as_ref().map_or(0, |d| d.evaluations),
        criteria: designed.as_ref().map_or(Vec::new(), |d| d.criteria.clone()),
        safety: designed.as_ref().map_or(Vec::new(), |d| d.safety.clone()),
        measured: ctx.channels.demands.iter().map(span).collect::<Result<_, _>>()?,
        gains,
        records,
        models,
        bed_s,
        comparison_bed_s,
    })
}
