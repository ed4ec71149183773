//! Optimisation over a record: stored models and a calibration problem in, a plan and what it costs out (thesis section 7.5).
//!
//! [`spec`] reads what the user wrote and checks it as a whole, `load` reads models and record, [`work`] optimises in memory,
//! [`result`] is what comes out, [`words`] says it, [`page`] draws it, [`store`] writes the run folder with the plan as the
//! player reads it.

mod load;
pub mod page;
pub mod result;
pub mod spec;
pub mod store;
pub mod words;
pub mod work;

use dynocal_files::run_folder::RunFolder;
use dynocal_numerics::watch::Watch;

pub use result::{OptimiseJobError, Optimised};
pub use spec::Job;
pub use work::estimate;

/// Optimises, and writes plan, optimum, `report.html` and `summary.json` into the run folder.
///
/// # Errors
/// [`OptimiseJobError`].
pub fn run(job: &Job, watch: Watch) -> Result<(Optimised, RunFolder), OptimiseJobError> {
    let optimised = work::optimise(job, watch)?;
    let folder = store::write(job, &optimised)?;
    Ok((optimised, folder))
}
