//! The run folder of a simulation.

use dynocal_files::run_folder::RunFolder;

use super::page;
use super::result::{Output, SimulateError, Simulated};
use crate::kept;

/// Writes a file for each record and output, the page and the summary.
///
/// # Errors
/// [`SimulateError::Files`], [`SimulateError::Page`].
pub fn write(folder: &RunFolder, found: &Simulated) -> Result<(), SimulateError> {
    let mut files = vec!["report.html".to_string()];
    for o in &found.outputs {
        let stem = format!("{}-{}", file_name(&o.record), file_name(&o.output));
        files.push(record(folder.path(), &stem, o)?);
    }
    page::write(found, folder.path())?;
    folder.write_summary(&Simulated { files, ..found.clone() })?;
    Ok(())
}

/// Time, simulated and measured output; a run that diverged ends with its last finite sample.
fn record(folder: &std::path::Path, stem: &str, o: &Output) -> Result<String, SimulateError> {
    let n = o.diverged_at.unwrap_or(o.samples);
    let time: Vec<f64> = (0..n).map(|t| t as f64 * o.sample_time_s).collect();
    let measured = format!("{}_measured", o.output);
    let mut columns: Vec<(&str, &str, &[f64])> = vec![("time", "s", &time), (&o.output, &o.unit, &o.y[..n])];
    if let Some(z) = &o.measured {
        columns.push((&measured, &o.unit, &z[..n]));
    }
    Ok(kept::write_columns(folder, stem, &columns)?)
}

/// A name of a file.
fn file_name(text: &str) -> String {
    text.chars().map(|c| if c.is_alphanumeric() || "-_.".contains(c) { c } else { '_' }).collect()
}
