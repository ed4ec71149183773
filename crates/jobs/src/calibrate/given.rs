//! Files that a campaign is given instead of steps of its own: records, models, maps. All are opened before anything is measured.

use super::context::Context;
use super::error::ChainError;
use super::records::stem;
use super::start_maps::start_maps;
use dynocal_files::{json, units};
use dynocal_ident::data::Dataset;
use dynocal_ident::stored::{MODEL_SCHEMA, MODEL_VERSION, StoredModel};
use std::path::{Path, PathBuf};

/// Opens every file that the spec gives, and compares channels, units and sample time with those of the campaign.
///
/// # Errors
/// [`ChainError`]: the first file that does not fit.
pub(super) fn check(ctx: &Context) -> Result<(), ChainError> {
    let e = &ctx.spec.excite;
    let lists = [
        ("excite.identification_files", &e.identification_files),
        ("excite.validation_files", &e.validation_files),
    ];
    let mut seen: Vec<(&str, &PathBuf, Dataset)> = Vec::new();
    for (key, files) in lists {
        for file in files {
            seen.push((key, file, record(ctx, key, file, &stem(file))?));
        }
    }
    if let Some(file) = &ctx.spec.design.record {
        seen.push(("design.record", file, record(ctx, "design.record", file, "design01")?));
    }
    told_apart(&seen)?;
    for (output, file) in &ctx.spec.identify.files {
        model(ctx, output, file)?;
    }
    start_maps(ctx).map(drop)
}

/// A record that models are identified from is not unseen, under whatever name.
fn told_apart(records: &[(&str, &PathBuf, Dataset)]) -> Result<(), ChainError> {
    let validation = |key: &str| key == "excite.validation_files";
    for (key, file, d) in records.iter().filter(|r| validation(r.0)) {
        let same = |other: &Dataset| {
            other.len() == d.len()
                && other
                    .channels
                    .iter()
                    .zip(&d.channels)
                    .all(|(a, b)| a.name == b.name && a.values == b.values)
        };
        if let Some((other, of, _)) = records.iter().find(|r| !validation(r.0) && same(&r.2)) {
            return Err(ChainError::Spec {
                key: (*key).into(),
                found: format!("`{}`, the same samples as `{}` of {other}", file.display(), of.display()),
                expected: "records that no model is identified from".into(),
            });
        }
    }
    Ok(())
}

/// A record with the channels of the problem in its units, sampled as the campaign is.
///
/// # Errors
/// [`ChainError`]: the file, a channel that it lacks, a unit of another dimension, another sample time.
pub(super) fn record(ctx: &Context, key: &str, file: &Path, name: &str) -> Result<Dataset, ChainError> {
    let fault = |found: String, expected: String| ChainError::Spec {
        key: key.into(),
        found: format!("`{}`, {found}", file.display()),
        expected,
    };
    let mut d = ctx.read_record(file, name)?;
    let dt = ctx.spec.sample_time_s;
    if !((d.sample_time_s - dt).abs() <= 1e-3 * dt) {
        let expected = format!(
            "records in the sample time of the campaign, {dt} s (`dynocal convert` brings them to it)"
        );
        return Err(fault(format!("sampled at {} s", d.sample_time_s), expected));
    }
    for c in &mut d.channels {
        let Some(unit) = ctx.spec.problem.unit(&c.name) else { continue };
        // A file without units is taken by its word.
        let bare = c.unit.is_empty() || c.unit == "-";
        let Some((scale, offset)) = units::conversion(&c.unit, unit).or(bare.then_some((1.0, 0.0))) else {
            let expected = format!("{unit} as in the problem, or a unit that converts to it");
            return Err(fault(format!("where `{}` is in {}", c.name, c.unit), expected));
        };
        c.values.iter_mut().for_each(|v| *v = *v * scale + offset);
        c.unit = unit.into();
    }
    Ok(d)
}

/// The model of `output` that was identified elsewhere.
///
/// # Errors
/// [`ChainError`]: the file, a model of another output or of another sample time.
pub(super) fn model(ctx: &Context, output: &str, file: &Path) -> Result<StoredModel, ChainError> {
    let model: StoredModel = json::read_versioned(file, MODEL_SCHEMA, MODEL_VERSION)?;
    let fault = |found: String, expected: String| ChainError::Spec {
        key: format!("identify.files.{output}"),
        found: format!("`{}`, {found}", file.display()),
        expected,
    };
    let found = model.user_output().name;
    if found != output {
        return Err(fault(format!("a model of `{found}`"), format!("a model of `{output}`")));
    }
    let dt = ctx.spec.sample_time_s;
    if !((model.sample_time_s - dt).abs() <= 1e-6 * dt) {
        let expected = format!("a model in the sample time of the campaign, {dt} s");
        return Err(fault(format!("sampled at {} s", model.sample_time_s), expected));
    }
    Ok(model)
}
