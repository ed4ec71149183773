//! The run folder of a fit.

use std::path::Path;

use dynocal_files::atomic;
use dynocal_files::run_folder::RunFolder;
use dynocal_numerics::watch::Watch;

use super::read::read;
use super::{FitResult, Spec, report, run};
use crate::engine::{Engine, EngineJobError};
use crate::kept;

/// What a fit leaves beside its spec and log; the points are a table of one format or the other.
const RESULTS: [&str; 5] = ["summary.json", "report.html", "fitted.toml", "points.csv", "points.parquet"];

/// Fits and writes `fitted.toml` (a parameter set), the points, the page and the summary.
///
/// # Errors
/// [`EngineJobError`].
pub fn fit(
    engine: &Engine,
    spec: &Spec,
    out: &Path,
    watch: Watch,
) -> Result<(FitResult, RunFolder), EngineJobError> {
    // A map that cannot be read leaves a folder as it was; a folder that cannot be written is known before anything is computed.
    read(&spec.map)?;
    let folder = RunFolder::open(out, "engine fit", spec)?;
    // Whatever comes of this fit, what an earlier one has left is no result of it.
    for name in RESULTS {
        // What is not there needs no removal.
        let _ = std::fs::remove_file(folder.path().join(name));
    }
    let found = run(engine, spec, watch)?;
    if let Some(params) = &found.params {
        atomic::write(&folder.path().join("fitted.toml"), params.to_toml().as_bytes())?;
    }
    points(folder.path(), &found)?;
    let page = dynocal_report::render(&report(&found)).map_err(crate::page::PageError::from)?;
    atomic::write(&folder.path().join("report.html"), page.as_bytes())?;
    folder.write_summary(&found)?;
    Ok((found, folder))
}

/// Measured and simulated, a row a point.
fn points(folder: &Path, found: &FitResult) -> Result<(), EngineJobError> {
    let column = |f: &dyn Fn(&super::Compare) -> f64| -> Vec<f64> { found.points.iter().map(f).collect() };
    let or_nan = |v: Option<f64>| v.unwrap_or(f64::NAN);
    let columns = [
        ("row", "-", column(&|c| c.row as f64)),
        ("judged", "-", column(&|c| f64::from(u8::from(c.judged)))),
        ("speed", "rpm", column(&|c| c.measured.at.speed_rpm)),
        ("p_intake", "kPa", column(&|c| 1e-3 * c.measured.at.intake_pa)),
        ("lambda", "-", column(&|c| c.measured.at.lambda)),
        ("torque_measured", "Nm", column(&|c| or_nan(c.measured.torque_nm))),
        ("torque", "Nm", column(&|c| c.answer.torque_nm)),
        ("air_measured", "g/s", column(&|c| 1e3 * or_nan(c.measured.air_kg_s))),
        ("air", "g/s", column(&|c| 1e3 * c.answer.air_kg_s)),
        ("egt_measured", "K", column(&|c| or_nan(c.measured.exhaust_k))),
        ("egt", "K", column(&|c| c.answer.exhaust_k)),
        ("exhaust_measured", "kPa", column(&|c| 1e-3 * or_nan(c.measured.exhaust_pa))),
        ("exhaust", "kPa", column(&|c| 1e-3 * c.answer.exhaust_pa)),
        ("system_measured", "kPa", column(&|c| 1e-3 * or_nan(c.measured.system_pa))),
        ("system", "kPa", column(&|c| 1e-3 * c.answer.system_pa)),
        ("spark", "deg", column(&|c| c.answer.spark_deg)),
        ("retard", "deg", column(&|c| c.answer.retard_deg)),
        ("wastegate", "mm", column(&|c| c.answer.wastegate_mm)),
        ("surplus", "-", column(&|c| c.answer.surplus)),
        ("turbo", "rpm", column(&|c| c.answer.turbo_rpm)),
        ("residual", "-", column(&|c| c.answer.residual)),
        ("loss", "bar", column(&|c| c.answer.loss_bar)),
        ("intake_cam", "deg", column(&|c| c.answer.inputs.intake_mop_deg_btdc)),
        ("exhaust_cam", "deg", column(&|c| c.answer.inputs.exhaust_mop_deg_atdc)),
        ("settled", "-", column(&|c| f64::from(u8::from(c.answer.settled)))),
    ];
    let columns: Vec<(&str, &str, &[f64])> = columns.iter().map(|(n, u, v)| (*n, *u, v.as_slice())).collect();
    kept::write_columns(folder, "points", &columns)?;
    Ok(())
}
