//! Step 3: an optimal test signal for the identified models, by the job `design`, played on the plant, and what it gained.
//!
//! The inputs are designed within the limits of the problem, outputs predicted within the demanded ranges; the plan is played
//! with trimming loops about the predicted outputs, so that what the models do not know does not carry the plant away.

use super::context::{Context, Tone};
use super::design_spec::{design_text, predicted};
use super::error::ChainError;
use super::excite_step::{extra_record, telling_record};
use super::given;
use super::models::{ModelData, ModelsResult, errors, identify_all, with_predecessors};
use super::records::{RecordRef, save_records};
use super::spec::{AUTO, RICHEST};
use crate::design::result::{CriterionLine, Designed, SafetyLine};
use crate::design::{self, Overrides};
use dynocal_files::atomic;
use dynocal_ident::data::Dataset;
use dynocal_ident::validate::lack;
use dynocal_numerics::status::Status;
use dynocal_report::significant;
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
    /// What the models lack, and what record was made of that; empty where the spec names a criterion.
    #[serde(default)]
    pub choice: Vec<String>,
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
        choice: Vec::new(),
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
    if spec.criterion == AUTO {
        return by_lack(ctx, folder, models, identification, validation);
    }
    if !ctx.channels.read.is_empty() {
        return Ok(nothing(
            models,
            "a design knows no models that read each other, as those of engine and fuelling as one plant do",
        ));
    }
    by_criterion(ctx, folder, models, identification, validation, (&spec.criterion, spec.model == RICHEST))
}

/// One-sided quantile of the normal distribution at 99 %.
const Z: f64 = 2.33;
/// A ratio beyond which its number says no more.
const MUCH: f64 = 100.0;

/// Where errors are not white, levels that tell most of what a better structure would need; where nothing beyond white noise is found,
/// the record that tells the richest models most about the predictions that are wanted.
///
/// A model of p parameters and N samples predicts with a variance of about `s^2 p/N` where it is asked what it learned from. What the
/// test finds, `lack s^2` and more than about `2.33 s^2 / sqrt(N)`, is larger for all models of less than `2.33 sqrt(N)` parameters,
/// and no record of the same structure takes it away.
fn by_lack(
    ctx: &Context,
    folder: &Path,
    models: &ModelsResult,
    identification: &[(Dataset, PathBuf)],
    validation: &[Dataset],
) -> Result<DesignResult, ChainError> {
    let (mut choice, mut missing) = (Vec::new(), false);
    for o in &models.outputs {
        let mut all = Vec::new();
        for (record, _) in identification {
            all.extend(errors(&o.best().model, record)?);
        }
        let (text, lacks) = lacking(&o.unit, &all);
        missing |= lacks;
        choice.push(format!("{}: {text}", o.output));
    }
    if !ctx.channels.read.is_empty() && !missing {
        missing = true;
        choice.push("models read each other, and no design knows such models".into());
    }
    if !missing {
        let found = by_criterion(ctx, folder, models, identification, validation, ("i", true))?;
        if !found.records.is_empty() {
            choice.push("the record is I-optimal for the richest models over the records so far".into());
        }
        return Ok(DesignResult { choice, ..found });
    }
    choice.push("the levels of the record are those that tell most of all terms that a better structure may need, beside the records so far".into());
    let seen: Vec<Dataset> = identification.iter().map(|(d, _)| d.clone()).collect();
    let record = telling_record(ctx, folder, "design01", &seen)?;
    ctx.fraction(0.5);
    let found = measured(ctx, folder, models, record, None, identification, validation)?;
    let bed_s = ctx.spec.excite.record_s + ctx.spec.excite.lead_in_s;
    Ok(DesignResult { choice, bed_s, ..found })
}

/// What the errors of a model (one list a run) say of it, and whether something is missing.
fn lacking(unit: &str, errors: &[Vec<f64>]) -> (String, bool) {
    if errors.iter().flatten().any(|e| !e.is_finite()) {
        return ("its free run diverges".into(), true);
    }
    let runs: Vec<&[f64]> = errors.iter().map(Vec::as_slice).collect();
    let Some(found) = lack(&runs) else {
        return ("too few errors to tell structure from noise".into(), true);
    };
    let unit = if unit == "-" { String::new() } else { format!(" {unit}") };
    let fast = format!("{}{unit}", significant(found.noise_std, 2));
    if found.z <= Z {
        return (format!("beyond white noise of {fast} nothing was found in what the model leaves"), false);
    }
    let much = if found.lack > MUCH {
        format!("more than {MUCH} times the variance of")
    } else {
        format!("{} times the variance of", significant(found.lack, 2))
    };
    let text = format!(
        "what the model leaves changes slowly, {much} its fast part ({fast}): structure is missing, or a sensor drifts or smooths its noise"
    );
    (text, true)
}

/// A design by a criterion, for the chosen or the richest models.
fn by_criterion(
    ctx: &Context,
    folder: &Path,
    models: &ModelsResult,
    identification: &[(Dataset, PathBuf)],
    validation: &[Dataset],
    wanted: (&str, bool),
) -> Result<DesignResult, ChainError> {
    let found = match make(ctx, folder, models, identification, wanted)? {
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
    wanted: (&str, bool),
) -> Result<Result<(Designed, Dataset), String>, ChainError> {
    let path = folder.join("design.toml");
    let text = design_text(ctx, folder, models, identification, wanted)?;
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
        choice: Vec::new(),
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

#[cfg(test)]
mod tests {
    use super::lacking;
    use dynocal_numerics::rng::Rng64;

    #[test]
    fn what_diverges_or_cannot_be_told_lacks_something() {
        let mut rng = Rng64::new(2);
        let white: Vec<f64> = (0..600).map(|_| rng.normal()).collect();
        let slow: Vec<f64> =
            white.iter().enumerate().map(|(t, e)| e + 3.0 * (0.02 * t as f64).sin()).collect();
        let (text, lacks) = lacking("Nm", &[white.clone(), white.clone()]);
        assert!(!lacks && text.contains("nothing was found") && text.contains("Nm"), "{text}");
        let (text, lacks) = lacking("Nm", &[white, slow]);
        assert!(lacks && text.contains("times the variance of its fast part"), "{text}");
        assert_eq!(lacking("-", &[vec![0.1, f64::NAN]]), ("its free run diverges".into(), true));
        assert!(lacking("-", &[]).1);
    }
}
