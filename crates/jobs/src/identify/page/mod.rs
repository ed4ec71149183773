//! The report of an identification: it arranges what the run folder holds and computes nothing.

mod after;
mod agreement;
mod before;
mod curves;
mod models;
mod points;
mod preparation;
mod records;
mod residuals;
mod scores;
mod selection;
mod verdict;

use std::path::Path;

use crate::identify::result::Identified;
use dynocal_files::atomic;
use dynocal_report::{Report, render};

use crate::page::PageError;

pub use models::ended;
pub use scores::kind_text;

/// Writes `report.html` into the run folder.
pub fn write(found: &Identified, folder: &Path) -> Result<(), PageError> {
    let mut report = Report::new(format!("Identification: {}", found.name)).subtitle(subtitle(found));
    for warning in &found.warnings {
        report = report.warning(warning.as_str());
    }
    report = report.section(verdict::section(found)).section(scores::section(found));
    if found.steady {
        for section in points::sections(found) {
            report = report.section(section);
        }
        report = report.section(after::section(found)).section(models::section(found));
        atomic::write(&folder.join("report.html"), render(&report)?.as_bytes())?;
        return Ok(());
    }
    for section in [preparation::section(found, folder)?, before::section(found)].into_iter().flatten() {
        report = report.section(section);
    }
    report = report.section(records::section(found, folder)?).section(agreement::section(found, folder)?);
    if let Some(section) = curves::section(found) {
        report = report.section(section);
    }
    report = report.section(residuals::section(found));
    report = report.section(after::section(found));
    report = report.section(models::section(found));
    atomic::write(&folder.join("report.html"), render(&report)?.as_bytes())?;
    Ok(())
}

fn subtitle(found: &Identified) -> String {
    let one = |m: &crate::identify::result::Modelled| {
        format!("{} from {}: {}", m.target, m.inputs.join(", "), m.in_words())
    };
    match found.models.as_slice() {
        [m] => one(m),
        all => {
            let targets: Vec<&str> = all.iter().map(|m| m.target.as_str()).collect();
            format!("{} outputs: {}", all.len(), targets.join(", "))
        }
    }
}
