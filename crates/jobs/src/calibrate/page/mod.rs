//! The report of a calibration: it arranges what the run folder holds and computes nothing but free runs of models.

mod asked;
mod compare;
mod design;
mod maps;
mod models;
mod optimise;
mod parts;

use std::path::{Path, PathBuf};

use super::context::Context;
use super::error::ChainError;
use super::run::ChainResult;
use super::summary::Summary;
use dynocal_files::atomic;
use dynocal_report::{Report, render};

/// Writes `report.html` into the run folder and returns its path. Of the contexts the second is that of the records up to the
/// optimisation.
pub(crate) fn write(
    run: &Path,
    contexts: (&Context, &Context),
    summary: &Summary,
    result: &ChainResult,
) -> Result<PathBuf, ChainError> {
    let report = build(contexts, summary, result)?;
    let html =
        render(&report).map_err(|e| ChainError::Identify { what: "report".into(), reason: e.to_string() })?;
    let path = run.join("report.html");
    atomic::write(&path, html.as_bytes())?;
    Ok(path)
}

/// Everything, the verdict and warnings first.
fn build((ctx, on): (&Context, &Context), summary: &Summary, r: &ChainResult) -> Result<Report, ChainError> {
    let mut report = asked::head(summary, r);
    report = report.section(asked::overview(summary, r));
    if let Some(excite) = &r.excite {
        report = report.section(models::records(on, excite, r)?);
    }
    if let Some(identify) = &r.identify {
        report = report.section(models::fits(&identify.result));
    }
    if let Some(d) = &r.design {
        report = report.section(design::section(on, d)?);
    }
    if let Some(o) = &r.optimise {
        let fixed = r.validate.as_ref().and_then(|v| v.result.static_on_record.as_ref());
        report = report.section(optimise::section(on, o, fixed)?);
    }
    if let Some(i) = &r.invert {
        let rival = r.validate.as_ref().map(|v| &v.result.static_map);
        report = report.section(maps::section(ctx, &i.result, rival));
    }
    if let Some(v) = &r.validate {
        report = report.section(compare::section(ctx, v, summary)?);
    }
    Ok(report.section(asked::spec(summary)).section(asked::files(summary)))
}
