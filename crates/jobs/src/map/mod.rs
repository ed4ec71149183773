//! Steady calibration: from a day on the bed to maps.
//!
//! [`spec`] is what the user writes; [`job`] reads it and checks it as a whole; [`work`] measures on the plant, learns, optimises and verifies in
//! memory; [`result`] is what comes out; [`page`] draws it; [`store`] writes the run folder.

mod along;
mod answers;
mod bench;
mod between;
mod budget;
mod cells;
mod channels;
mod check;
mod choose;
mod deliver;
pub mod drive;
pub mod edits;
pub mod error;
pub mod estimate;
mod front;
mod halfway;
pub mod inverse;
pub mod job;
mod journal;
mod learn;
mod line;
mod line_time;
pub mod lines;
pub mod loops;
mod on_bed;
mod optimum;
pub mod page;
mod reach;
mod record;
pub mod refine;
pub mod rest;
pub mod result;
mod schedule;
mod setting;
mod shown;
mod slow;
pub mod spec;
pub mod store;
pub mod sweep;
mod verdict;
mod verify;
mod walk;
mod windows;
pub mod work;

use dynocal_files::run_folder::RunFolder;
use dynocal_numerics::watch::Watch;

pub use error::MapError;
pub use job::Job;
pub use result::Mapped;

/// Kind of the run folder.
pub const KIND: &str = "map";

/// Measures, learns, optimises, verifies; points, models, maps, `report.html` and `summary.json` go into the run folder. What an
/// interrupted run has measured is kept there and taken over by the next.
///
/// # Errors
/// [`MapError`].
pub fn run(job: &Job, watch: Watch) -> Result<(Mapped, RunFolder), MapError> {
    // A folder that cannot be written is known before the plant is run.
    let folder = RunFolder::open_at(&job.out, KIND, &job.spec)?;
    // Maps of another spec are not the result of this one, whatever becomes of it.
    if folder.had_another_spec()? {
        store::forget(folder.path());
    }
    let found = work::run_in(job, folder.path(), watch);
    // Nor are those of an earlier, shorter day. What is only interrupted comes to the same again.
    if found.as_ref().is_err_and(|e| !matches!(e, MapError::Interrupted)) {
        store::forget(folder.path());
    }
    let found = found?;
    let found = store::write(&folder, job, found)?;
    Ok((found, folder))
}
