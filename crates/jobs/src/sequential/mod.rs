//! Rounds of design and measurement on a plant: identify, design the next record, measure it, again, until the budget is
//! used or the next record is expected to be worth too little.
//!
//! [`spec`] reads what the user wrote and checks it as a whole, [`work`] plays on the plant in memory, [`result`] is what
//! comes out, [`page`] draws it, [`store`] writes the run folder. Every campaign is set beside its simplest rival: random
//! records of the same recipe and the same bed time, judged on the same held-out records.

pub mod estimate;
pub mod page;
pub mod result;
pub mod spec;
pub mod store;
pub mod work;

use dynocal_files::run_folder::RunFolder;
use dynocal_numerics::watch::Watch;

pub use result::{Sequenced, SequentialError};
pub use spec::Job;

/// Plays the campaign; records, models, `report.html` and `summary.json` go into the run folder.
///
/// # Errors
/// [`SequentialError`].
pub fn run(job: &Job, watch: Watch) -> Result<(Sequenced, RunFolder), SequentialError> {
    // A folder that cannot be written is known before the plant is run.
    let folder = RunFolder::open_at(&job.out, "sequential", job).map_err(SequentialError::Files)?;
    let found = work::play(job, watch)?;
    let found = store::write(&folder, found)?;
    Ok((found, folder))
}
