//! The report of a calibration: it arranges what the run folder holds and computes nothing but free runs of models.

mod asked;
mod compare;
mod design;
mod maps;
mod models;
mod optimise;
mod parts;

use std::path::{Path, PathBuf};

use crate::calibrate::context::ChainError;
use crate::calibrate::run::ChainResult;
use dynocal_files::atomic;
use dynocal_report::{Report, render};

use crate::calibrate::summary::Summary;

/// Writes `report.html` into the run folder and returns its path.
pub(crate) fn write(run: &Path, summary: &Summary, result: &ChainResult) -> Result<PathBuf, ChainError> {
    let report = build(summary, result)?;
    let html =
        render(&report).map_err(|e| ChainError::Identify { what: "report".into(), reason: e.to_string() })?;
    let path = run.join("report.html");
    atomic::write(&path, html.as_bytes())?;
    Ok(path)
}

/// Everything, warnings first.
fn build(summary: &Summary, r: &ChainResult) -> Result<Report, ChainError> {
    let dt = summary.spec.sample_time_s;
    let mut report = asked::head(summary, r);
    report = report.section(asked::overview(summary, r));
    if let Some(excite) = &r.excite {
        report = report.section(models::records(excite, r, dt)?);
    }
    if let Some(identify) = &r.identify {
        report = report.section(models::fits(&identify.result));
    }
    if let Some(d) = &r.design {
        report = report.section(design::section(d, dt)?);
    }
    if let Some(o) = &r.optimise {
        let best = r.validate.as_ref().map(|v| &v.result.best_spark);
        report = report.section(optimise::section(o, best, dt)?);
    }
    if let Some(i) = &r.invert {
        let rival = r.validate.as_ref().map(|v| &v.result.static_map);
        report = report.section(maps::section(&i.result, rival, &summary.spec.validate.scenario));
    }
    if let Some(v) = &r.validate {
        report = report.section(compare::section(v, summary, dt)?);
    }
    Ok(report.section(asked::spec(summary)).section(asked::files(summary)))
}
