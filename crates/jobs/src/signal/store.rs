//! The run folder of test signals.

use dynocal_files::csv_io;
use dynocal_files::measurement::parquet_io;
use dynocal_files::run_folder::RunFolder;
use dynocal_ident::data::{Channel, Dataset, Role};

use super::page;
use super::result::{Made, SignalError, Summary};
use super::spec::{Job, Wanted};
use crate::kept;

/// Files of the run folder: the record (Parquet where it is long) and the page.
pub fn files(job: &Job) -> [&'static str; 2] {
    [if kept::ending(job.samples) == "csv" { "signal.csv" } else { "signal.parquet" }, "report.html"]
}

/// Writes the record, the page and the summary.
///
/// # Errors
/// [`SignalError::Files`], [`SignalError::Page`].
pub fn write(folder: &RunFolder, job: &Job, made: &Made) -> Result<(), SignalError> {
    let files = files(job);
    let write = if files[0].ends_with("csv") { csv_io::write_dataset } else { parquet_io::write_dataset };
    write(&folder.path().join(files[0]), &record(job, made))?;
    page::write(job, made, folder.path())?;
    folder.write_summary(&Summary {
        verb: "signal",
        name: &job.name,
        valid: true,
        warnings: &made.warnings,
        signals: job,
        analyses: &made.analyses,
        coverage: &made.coverage,
        pairs: &made.pairs,
        correlations: &made.correlations,
        files,
    })?;
    Ok(())
}

/// The signals as a record of inputs.
pub fn record(job: &Job, made: &Made) -> Dataset {
    let channel = |(w, values): (&Wanted, &Vec<f64>)| Channel {
        name: w.name.clone(),
        unit: w.unit.clone(),
        role: Role::Input,
        values: values.clone(),
    };
    Dataset {
        name: job.name.clone(),
        sample_time_s: job.sample_time_s,
        channels: job.channels.iter().zip(&made.columns).map(channel).collect(),
        init_samples: 0,
        origin: format!("test signals with seed {}", job.seed),
    }
}
