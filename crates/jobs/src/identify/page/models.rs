//! Parameters and the path of the selection.

use crate::identify::judge::in_words;
use crate::identify::result::{Identified, Modelled};
use dynocal_report::{Column, Details, KeyValue, Section, Table};

/// More parameters than this stand behind a line that opens on click.
const SHOWN: usize = 40;

/// The section.
pub(super) fn section(found: &Identified) -> Section {
    let mut section = Section::new("Models");
    if found.models.iter().any(|m| !m.parameters.is_empty()) {
        section = section.text(
            "Estimated parameters with standard errors. An estimate smaller than twice its standard error may as well be zero.",
        );
    }
    for m in &found.models {
        section = section.heading(m.target.as_str()).key_values(vec![
            KeyValue::new("Structure", m.structure.as_str(), ""),
            KeyValue::new("Learnt", m.what.clone(), ""),
            KeyValue::new("Estimator", m.estimator.as_str(), ""),
            KeyValue::new("Ended", ended(m), ""),
            KeyValue::new("Parameters", m.parameters.len(), ""),
            KeyValue::new("Rank", m.rank, ""),
            KeyValue::new("Samples", m.samples, ""),
            KeyValue::new("File", m.file.as_str(), ""),
        ]);
        if let Some(path) = &m.selection {
            section = super::selection::add(section, path);
        }
        if m.parameters.is_empty() {
            continue;
        }
        let parameters = parameters(m);
        if m.parameters.len() > SHOWN {
            let line = format!("{} parameters", m.parameters.len());
            section.push(Details::new(line).block(parameters));
        } else {
            section.push(parameters);
        }
    }
    section
}

/// How the estimate ended, in words.
pub fn ended(m: &Modelled) -> String {
    match (m.status, m.evaluations) {
        (Some(status), _) if m.what.is_some() && status.is_success() => "learnt".into(),
        (Some(status), Some(n)) => {
            format!("{} after {n} evaluations", in_words(status).trim_end_matches(','))
        }
        _ => "read from a file, not estimated".into(),
    }
}

fn parameters(m: &Modelled) -> Table {
    let mut table = Table::new(vec![
        Column::text("Parameter"),
        Column::number("Estimate", "").digits(6),
        Column::number("Standard error", "").digits(3),
        Column::number("Estimate / standard error", "-").digits(3),
    ]);
    for p in &m.parameters {
        let ratio = p.std_error.filter(|s| *s > 0.0).map(|s| p.value.abs() / s);
        table = table.row([p.name.as_str().into(), p.value.into(), p.std_error.into(), ratio.into()]);
    }
    table
}
