//! The run folder of a control job.

use dynocal_files::run_folder::RunFolder;

use super::page;
use super::result::{ControlJobError, Controlled};
use crate::kept;

/// Writes the gains that each set point alone would have, the page and the summary.
///
/// # Errors
/// [`ControlJobError::Files`], [`ControlJobError::Page`].
pub fn write(folder: &RunFolder, found: &Controlled) -> Result<(), ControlJobError> {
    let mut files = vec!["report.html".to_string()];
    let mut columns: Vec<(String, Vec<f64>)> = Vec::new();
    for l in found.loops.iter().filter(|l| !l.scheduled.is_empty()) {
        let column = |of: &dyn Fn(&(f64, f64)) -> f64| -> Vec<f64> {
            l.scheduled.iter().map(|g| g.as_ref().map_or(f64::NAN, |g| of(g) * l.sign)).collect()
        };
        columns.push((format!("{}_kp", l.output), column(&|g| g.0)));
        columns.push((format!("{}_ki", l.output), column(&|g| g.1)));
    }
    if !columns.is_empty() {
        let numbers: Vec<f64> = (1..=found.points.len()).map(|k| k as f64).collect();
        let mut all: Vec<(&str, &str, &[f64])> = vec![("point", "-", &numbers)];
        all.extend(columns.iter().map(|(name, v)| (name.as_str(), "-", v.as_slice())));
        files.push(kept::write_columns(folder.path(), "gains_by_point", &all)?);
    }
    page::write(found, folder.path())?;
    folder.write_summary(&Controlled { files, ..found.clone() })?;
    Ok(())
}
