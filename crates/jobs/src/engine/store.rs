//! The files that a run of the engine is asked for.

use std::path::Path;

use dynocal_files::atomic;
use dynocal_report::{Report, render};

use super::EngineJobError;

/// Writes the page.
///
/// # Errors
/// [`EngineJobError`].
pub fn page(path: &Path, report: &Report) -> Result<(), EngineJobError> {
    let html = render(report).map_err(crate::page::PageError::from)?;
    atomic::write(path, html.as_bytes())?;
    Ok(())
}
