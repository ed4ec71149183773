//! Labels of an ECU from logs: the fuel table of an open ECU, from `.mlg` to `.msq`.
//!
//! [`spec`] holds what was asked for, [`channels`] finds the channels of a log and the labels of a tune, [`work`] fits and judges in
//! memory ([`dynocal_label::ve`]), [`result`] is what comes out, [`page`] draws it, [`store`] writes the run folder. A table that
//! explains unseen samples worse than the one before is refused, and no file of it is written.

pub mod channels;
pub mod film;
pub mod function;
pub mod known;
pub mod page;
pub mod result;
pub mod spec;
mod stamps;
pub mod store;
pub mod work;

use dynocal_files::run_folder::RunFolder;
use dynocal_numerics::watch::Watch;

pub use dynocal_label::linear::Verdict;
pub use result::{LabelJobError, Labelled};
pub use spec::Job;

/// Fits, judges, and writes table, tune, `report.html` and `summary.json` into the run folder.
///
/// # Errors
/// [`LabelJobError`].
pub fn run(job: &Job, watch: Watch) -> Result<(Labelled, RunFolder), LabelJobError> {
    // A folder that cannot be written is known before anything is computed.
    let folder = RunFolder::open_at(&job.out, "label", job)?;
    let found = work::fit(job, watch)?;
    let written = store::write(&folder, found)?;
    Ok((written, folder))
}

/// A curve of an ECU at `x`: straight between its points, flat beyond its ends.
pub fn curve(points: &[f64], values: &[f64], x: f64) -> f64 {
    dynocal_label::label::Label::curve("curve", "-", "x", "-", points, values).value(values, &[x])
}
