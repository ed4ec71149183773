//! The report of a study: warnings, checks, then what the study adds.

use crate::StudyError;
use dynocal_report::{Report, render};

use super::{Check, Options, Study, TaskResult};

/// The page.
pub(crate) fn html(
    study: &Study,
    options: &Options,
    checks: &[Check],
    warnings: &[String],
    results: &[TaskResult],
) -> Result<String, StudyError> {
    let title = if options.reduced { "reduced length" } else { "full length" };
    let mut report = Report::new(format!("Study: {}", study.doc.name))
        .subtitle(study.doc.what)
        .fact("First seed", options.seed.to_string())
        .fact("Length", title)
        .fact("Tasks", results.len());
    for warning in warnings {
        report = report.warning(warning.as_str());
    }
    for c in checks {
        report = report.check(dynocal_report::Check {
            id: c.id.clone(),
            what: c.what.clone(),
            asked: c.asked.clone().into(),
            measured: c.measured.into(),
            unit: c.unit.into(),
            holds: c.holds,
            note: c.note.clone(),
        });
    }
    let report = (study.sections)(report, results);
    render(&report)
        .map_err(|e| StudyError::Task { what: "report of the study".into(), reason: e.to_string() })
}
