//! The page opens with what came out, in words.

use dynocal_report::{Column, Details, Section, Table};

use crate::identify::finding::Grade;
use crate::identify::result::Identified;

/// The section.
pub(super) fn section(found: &Identified) -> Section {
    let mut section = Section::new("Verdict");
    for sentence in &found.verdict {
        section = section.text(sentence.as_str());
    }
    let notes = found.findings.iter().filter(|f| f.grade == Grade::Note).count();
    if !found.findings.is_empty() {
        let mut table = Table::new(vec![Column::text("Grade"), Column::text("About"), Column::text("What")]);
        for f in &found.findings {
            table = table.row([f.grade.word().into(), f.about.as_str().into(), f.text.as_str().into()]);
        }
        let rest = found.findings.len() - notes;
        let line = format!("{rest} faults and warnings, {notes} notes");
        section.push(Details::new(line).block(table));
    }
    section
}
