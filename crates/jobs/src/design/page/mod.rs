//! The report of a design: it arranges what the run has found and computes nothing.

mod information;
mod plan;
mod value;

use std::path::Path;

use crate::design::Job;
use crate::design::result::{Curves, Designed};
use dynocal_files::atomic;
use dynocal_numerics::status::Status;
use dynocal_report::{Report, render};

use crate::page::PageError;

/// Writes `report.html` into the run folder.
pub fn write(job: &Job, found: &Designed, curves: &Curves, folder: &Path) -> Result<(), PageError> {
    let subtitle = format!(
        "{} channels, {} samples of {} s: {}",
        found.channels.len(),
        found.samples,
        found.sample_time_s,
        ended(found.status)
    );
    let mut report = Report::new(format!("Test design: {}", found.name))
        .subtitle(subtitle)
        .fact("Search", format!("{}, {} starts", job.search.name, job.search.starts))
        .fact("Evaluations", found.evaluations as f64)
        .fact("Seed", job.seed.to_string());
    for warning in &found.warnings {
        report = report.warning(warning.as_str());
    }
    let report = report
        .section(value::section(found))
        .section(plan::section(job, found, curves))
        .section(plan::safety(found))
        .section(plan::coverage(job, found, curves))
        .section(information::section(found))
        .section(value::search(found));
    atomic::write(&folder.join("report.html"), render(&report)?.as_bytes())?;
    Ok(())
}

/// How a search ended, in words.
pub fn ended(status: Status) -> &'static str {
    match status {
        Status::Converged => "converged",
        Status::Stalled | Status::Limit => "budget used up, the best design so far",
        Status::Infeasible => "no record that keeps all limits was found",
        Status::Diverged => "diverged",
        Status::Interrupted => "interrupted, the best design so far",
    }
}
