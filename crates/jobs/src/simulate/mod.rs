//! Stored models on new inputs: a free run without measured outputs.
//!
//! [`spec`] reads what the user wrote and checks it as a whole, [`work`] reads models and records and runs them in
//! memory, [`result`] is what comes out, [`page`] draws it, [`store`] writes the run folder. On the records of an
//! identification the outputs are those of its free run, bit for bit.

pub mod page;
pub mod result;
pub mod spec;
pub mod store;
pub mod work;

use dynocal_files::run_folder::RunFolder;
use dynocal_numerics::watch::Watch;

pub use result::{SimulateError, Simulated};
pub use spec::Job;

/// Simulates, and writes records, `report.html` and `summary.json` into the run folder.
///
/// # Errors
/// [`SimulateError`].
pub fn run(job: &Job, watch: Watch) -> Result<(Simulated, RunFolder), SimulateError> {
    // A folder that cannot be written is known before anything is computed.
    let folder = RunFolder::open_at(&job.out, "simulate", job)?;
    let simulated = work::simulate(job, watch)?;
    store::write(&folder, &simulated)?;
    Ok((simulated, folder))
}
