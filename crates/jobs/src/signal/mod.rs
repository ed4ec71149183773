//! Test signals for one or several channels: made, analysed, drawn, written as a record.
//!
//! [`spec`] reads what the user wrote and checks it as a whole, [`work`] makes and analyses the signals in memory,
//! [`result`] is what comes out, [`page`] draws it, [`store`] writes the run folder.
//!
//! ```
//! use dynocal_jobs::signal::{spec, work};
//! use dynocal_numerics::watch::Watch;
//! let text = r#"
//! length_s = 60.0
//! sample_time_s = 0.1
//! [[channels]]
//! name = "torque"
//! unit = "Nm"
//! signal = { name = "aprbs", lo = 10.0, hi = 90.0, hold_s = 0.5 }
//! "#;
//! let job = spec::parse("test.toml", text, &Default::default())?;
//! let made = work::make(&job, Watch::silent())?;
//! assert_eq!((made.columns[0].len(), made.analyses[0].maximum), (600, 90.0));
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```

pub mod page;
pub mod result;
pub mod spec;
pub mod store;
pub mod work;

use dynocal_files::run_folder::RunFolder;
use dynocal_numerics::watch::Watch;

pub use result::{Made, SignalError};
pub use spec::Job;

/// Makes the signals and writes `signal.csv` (`signal.parquet` above 100 000 samples), `report.html` and `summary.json` into the
/// run folder.
///
/// # Errors
/// [`SignalError`].
pub fn run(job: &Job, watch: Watch) -> Result<(Made, RunFolder), SignalError> {
    // A folder that cannot be written is known before anything is computed.
    let folder = RunFolder::open_at(&job.out, "signal", job)?;
    let made = work::make(job, watch)?;
    store::write(&folder, job, &made)?;
    Ok((made, folder))
}
