//! Feedback around stored models or given transfer functions: margins, the plane of PI gains, a tuned point (thesis section 7.7).
//!
//! [`spec`] reads what the user wrote and checks it as a whole, `load` makes linear plants of models at set points (`records` of
//! tests, which `bed` makes where a plant answers), [`work`] tunes and judges in memory, [`result`] is what comes out, `deliver`
//! makes it a controller that runs elsewhere, `settle` and `against` judge steps and what was measured, `trials` runs each margin, `words` says it, [`page`] draws it, [`store`] writes the run folder.

mod against;
mod bed;
mod decouple;
mod deliver;
mod gains;
mod load;
mod loop_spec;
mod loops;
pub mod page;
mod page_disks;
mod page_records;
mod picture;
mod records;
pub mod result;
mod settle;
pub mod spec;
pub mod store;
mod test_spec;
mod trials;
mod words;
pub mod work;

use dynocal_files::run_folder::RunFolder;
use dynocal_numerics::watch::Watch;

pub use result::{ControlJobError, Controlled};
pub use spec::Job;
pub use work::estimate;

/// Tunes and judges, and writes gains, `report.html` and `summary.json` into the run folder.
///
/// # Errors
/// [`ControlJobError`].
pub fn run(job: &Job, watch: Watch) -> Result<(Controlled, RunFolder), ControlJobError> {
    // A folder that cannot be written is known before anything is computed.
    let folder = RunFolder::open_at(&job.out, "control", job)?;
    let found = work::control(job, watch)?;
    store::write(&folder, &found)?;
    Ok((found, folder))
}
