//! What a model remembers of its records.

use dynocal_ident::data::{DataError, Dataset};
use dynocal_ident::stored::Pieces;
use dynocal_ident::validate::Seen;

use super::load::Part;
use super::spec::{Job, Target};

/// Pieces of what estimated a model and of what chose it.
#[derive(Clone, Debug, Default)]
pub(super) struct Remembered {
    pub(super) estimation: Option<Pieces>,
    pub(super) selection: Option<Pieces>,
}

/// Pieces of the records as they were measured, before any preparation; of a model that is only scored none.
pub(super) fn pieces(job: &Job, t: &Target, parts: &[Part]) -> Result<Remembered, DataError> {
    if !job.saved.is_empty() {
        return Ok(Remembered::default());
    }
    let mut names = Vec::new();
    t.inputs.iter().chain([&t.target]).for_each(|n| behind(job, n, &mut names));
    let of = |seen: Seen| -> Result<Option<Pieces>, DataError> {
        let records: Vec<&Dataset> =
            parts.iter().filter(|p| p.seen == seen).flat_map(|p| &p.records).collect();
        (!records.is_empty()).then(|| Pieces::of(&records, &names, job.is_steady())).transpose()
    };
    Ok(Remembered { estimation: of(Seen::Identification)?, selection: of(Seen::Selection)? })
}

/// The measured channels behind one that may be derived.
fn behind(job: &Job, name: &String, out: &mut Vec<String>) {
    match job.derive.iter().find(|d| d.channel.name == *name) {
        Some(d) => d.channel.powers.keys().for_each(|n| behind(job, n, out)),
        None if out.contains(name) => {}
        None => out.push(name.clone()),
    }
}
