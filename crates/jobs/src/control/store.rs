//! The run folder of a control job.

use dynocal_control::response::Response;
use dynocal_control::stored::{CONTROLLER_SCHEMA, CONTROLLER_VERSION};
use dynocal_files::json;
use dynocal_files::run_folder::RunFolder;

use super::decouple::Decoupled;
use super::page;
use super::result::{ControlJobError, Controlled};
use crate::kept;

/// Writes the gains by set point (those of the schedule, else what each alone would have), the controller, measured responses, the page and the summary.
///
/// # Errors
/// [`ControlJobError::Files`], [`ControlJobError::Page`].
pub fn write(folder: &RunFolder, found: &Controlled) -> Result<(), ControlJobError> {
    let mut files = vec!["report.html".to_string()];
    let mut columns: Vec<(String, String, Vec<f64>)> = Vec::new();
    for (k, l) in found.loops.iter().enumerate().filter(|(_, l)| !l.scheduled.is_empty()) {
        // Of the input over the output, where both are known.
        let known = found.controller.as_ref().and_then(|c| c.loops.get(k));
        let known = known.filter(|l| l.output_unit != "-" && l.input_unit != "-");
        let unit = known.map_or("-".to_string(), |l| format!("{}/{}", l.input_unit, l.output_unit));
        let per_s = if known.is_some() { format!("{unit}/s") } else { "1/s".into() };
        let times_s = if known.is_some() { format!("{unit}*s") } else { "s".into() };
        // With a schedule the rows that are delivered, made smaller as those are.
        let alone = |g: &Option<(f64, f64)>| g.map(|g| (g.0 * l.sign, g.1 * l.sign));
        let rows: Vec<Option<(f64, f64)>> = match l.by_point.is_empty() {
            true => l.scheduled.iter().map(alone).collect(),
            false => l.by_point.iter().copied().map(Some).collect(),
        };
        let column = |of: &dyn Fn(&(f64, f64)) -> f64| -> Vec<f64> {
            rows.iter().map(|g| g.as_ref().map_or(f64::NAN, of)).collect()
        };
        columns.push((format!("{}_kp", l.output), unit, column(&|g| g.0)));
        columns.push((format!("{}_ki", l.output), per_s, column(&|g| g.1)));
        if l.kd != 0.0 {
            let all = |v: f64| vec![v; l.scheduled.len()];
            columns.push((format!("{}_kd", l.output), times_s, all(l.kd)));
            columns.push((format!("{}_filter_s", l.output), "s".into(), all(l.derivative_filter_s)));
        }
    }
    if !columns.is_empty() {
        let numbers: Vec<f64> = (1..=found.points.len()).map(|k| k as f64).collect();
        let mut all: Vec<(&str, &str, &[f64])> = vec![("point", "-", &numbers)];
        all.extend(columns.iter().map(|(name, unit, v)| (name.as_str(), unit.as_str(), v.as_slice())));
        files.push(kept::write_columns(folder.path(), "gains_by_point", &all)?);
    }
    if let Some(c) = &found.controller {
        json::write_versioned(
            &folder.path().join("controller.json"),
            CONTROLLER_SCHEMA,
            CONTROLLER_VERSION,
            c,
        )?;
        files.push("controller.json".into());
    }
    if let Some(d) = &found.decoupler {
        files.push(decoupler(folder, found, d)?);
    }
    for (k, (m, r)) in found.measured.iter().zip(&found.picture.measured).enumerate() {
        files.push(response(folder, k, &m.point, found, r)?);
    }
    page::write(found, folder.path())?;
    folder.write_summary(&Controlled { files, ..found.clone() })?;
    Ok(())
}

/// The filters of a decoupler, coefficient by coefficient.
fn decoupler(folder: &RunFolder, found: &Controlled, d: &Decoupled) -> Result<String, ControlJobError> {
    let longest = d.filters.iter().map(Vec::len).max().unwrap_or(0);
    let n = found.loops.len();
    let lags: Vec<f64> = (0..longest).map(|k| k as f64).collect();
    let column = |(k, f): (usize, &Vec<f64>)| {
        let name = format!("{}_from_{}", found.loops[k / n].input, found.loops[k % n].output);
        (name, (0..longest).map(|l| f.get(l).copied().unwrap_or(0.0)).collect::<Vec<f64>>())
    };
    let columns: Vec<(String, Vec<f64>)> = d.filters.iter().enumerate().map(column).collect();
    let mut all: Vec<(&str, &str, &[f64])> = vec![("lag", "samples", &lags)];
    all.extend(columns.iter().map(|(name, v)| (name.as_str(), "-", v.as_slice())));
    Ok(kept::write_columns(folder.path(), "decoupler", &all)?)
}

/// A measured response as a table: frequency, and for each channel real and imaginary part with the deviation.
fn response(
    folder: &RunFolder,
    number: usize,
    point: &str,
    found: &Controlled,
    r: &Response,
) -> Result<String, ControlJobError> {
    let mut columns: Vec<(String, Vec<f64>)> = Vec::new();
    let n = r.frequency_hz.len();
    for (o, output) in found.loops.iter().enumerate() {
        for (i, input) in found.loops.iter().enumerate() {
            let name = |part: &str| format!("{}_by_{}_{part}", output.output, input.input);
            columns.push((name("re"), (0..n).map(|f| r.at(f, o, i).re).collect()));
            columns.push((name("im"), (0..n).map(|f| r.at(f, o, i).im).collect()));
            columns.push((name("std"), (0..n).map(|f| r.std_at(f, o, i)).collect()));
        }
        columns
            .push((format!("{}_coherence", output.output), (0..n).map(|f| r.coherence_at(f, o)).collect()));
    }
    let mut all: Vec<(&str, &str, &[f64])> = vec![("frequency", "Hz", &r.frequency_hz)];
    all.extend(columns.iter().map(|(name, v)| (name.as_str(), "-", v.as_slice())));
    let safe: String = point.chars().map(|c| if c.is_ascii_alphanumeric() { c } else { '_' }).collect();
    Ok(kept::write_columns(folder.path(), &format!("response_{}_{safe}", number + 1), &all)?)
}
