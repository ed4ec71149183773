//! Fuel by measured states: an air and film model identified from records of a bed, judged on records that it has not seen, and
//! what an ECU needs of it.
//!
//! [`spec`] reads what the user wrote and checks it as a whole, [`records`] reads files, [`places`] finds channels
//! of a plant, [`bed`] drives a plant that answers,
//! [`work`] identifies and judges in memory, [`result`] is what comes out, [`page`] draws it, [`store`] writes the run folder.
//! Equations: `dynocal_calib::fuelling`.

pub mod bed;
pub mod page;
pub mod places;
pub mod records;
pub mod result;
pub mod spec;
pub mod store;
pub mod stored;
mod verdict;
pub mod work;

use dynocal_files::run_folder::RunFolder;
use dynocal_numerics::watch::Watch;

pub use result::{Fuelled, FuellingJobError};
pub use spec::Job;

/// Identifies and judges, and writes the model, its tables, records, `report.html` and `summary.json` into the run folder.
///
/// # Errors
/// [`FuellingJobError`].
pub fn run(job: &Job, watch: Watch) -> Result<(Fuelled, RunFolder), FuellingJobError> {
    // A folder that cannot be written is known before anything is computed.
    let folder = RunFolder::open_at(&job.out, "fuelling", job)?;
    let found = work::fuelling(job, watch)?;
    store::write(&folder, &found)?;
    Ok((found, folder))
}
