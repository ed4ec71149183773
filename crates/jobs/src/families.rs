//! The one list of all tables: what a spec can name, with every key.
//!
//! `dynocal list`, the forms of other faces and the conformance tests read it. The table of studies stands above this
//! crate and is added by the program.

use dynocal_calib::map::structures::MAP_STRUCTURES;
use dynocal_calib::optimise::WAYS;
use dynocal_design::criterion::CRITERIA;
use dynocal_design::search::SEARCHES;
use dynocal_ident::estimate::ESTIMATORS;
use dynocal_ident::model::kinds::MODEL_KINDS;
use dynocal_ident::prepare::STEPS;
use dynocal_ident::select::SELECTIONS;
use dynocal_ident::signal::SIGNALS;
use dynocal_numerics::optim::OPTIMISERS;
use dynocal_numerics::registry::{BuildError, Member, MemberDoc};
use dynocal_plant::params::PARAMETER_SETS;
use dynocal_plant::plants::PLANTS;

/// A family: everything that can stand in one place of a spec.
pub struct Family {
    /// Name, as `dynocal list` takes it.
    pub name: &'static str,
    /// One line.
    pub what: &'static str,
    /// Its members.
    pub docs: fn() -> Vec<MemberDoc>,
    /// What the member of that name says to keys; none where it takes them. None for a family without keys.
    pub refusal: Option<Refusal>,
}

/// What a member says to keys that it does not take.
pub type Refusal = fn(&str, &toml::Table) -> Option<String>;

/// All families, in the order of a campaign.
///
/// ```
/// use dynocal_jobs::families::FAMILIES;
/// let signals = FAMILIES.iter().find(|f| f.name == "signals").unwrap();
/// assert!((signals.docs)().iter().any(|member| member.name == "aprbs"));
/// ```
pub static FAMILIES: &[Family] = &[
    Family {
        name: "signals",
        what: "Test signals of one channel",
        docs: || docs(SIGNALS),
        refusal: Some(|name, keys| refused(SIGNALS, name, keys)),
    },
    Family {
        name: "models",
        what: "Kinds of models",
        docs: || MODEL_KINDS.iter().map(|k| k.doc).collect(),
        refusal: Some(|name, keys| {
            let kind = MODEL_KINDS.iter().find(|k| k.doc.name == name)?;
            said((kind.build)(keys))
        }),
    },
    Family {
        name: "estimators",
        what: "Estimators of the parameters of a model",
        docs: || ESTIMATORS.iter().map(|k| k.doc).collect(),
        refusal: Some(|name, keys| {
            let row = ESTIMATORS.iter().find(|k| k.doc.name == name)?;
            said((row.build)(keys))
        }),
    },
    Family {
        name: "preparation",
        what: "Steps that prepare records",
        docs: || docs(STEPS),
        refusal: Some(|name, keys| refused(STEPS, name, keys)),
    },
    Family {
        name: "selections",
        what: "Ways to select the terms of a structure",
        docs: || docs(SELECTIONS),
        refusal: Some(|name, keys| refused(SELECTIONS, name, keys)),
    },
    Family {
        name: "criteria",
        what: "Numbers of the information that a design makes small",
        docs: || docs(CRITERIA),
        refusal: Some(|name, keys| refused(CRITERIA, name, keys)),
    },
    Family {
        name: "searches",
        what: "Searches for test signals",
        docs: || docs(SEARCHES),
        refusal: Some(|name, keys| refused(SEARCHES, name, keys)),
    },
    Family {
        name: "parameters",
        what: "Parameter sets of the virtual engine",
        docs: || PARAMETER_SETS.iter().map(|s| s.doc).collect(),
        refusal: None,
    },
    Family {
        name: "plants",
        what: "Plants that a spec can name",
        docs: || PLANTS.iter().map(|p| p.doc).collect(),
        refusal: None,
    },
    Family {
        name: "formats",
        what: "Measurement files that are read",
        docs: || dynocal_files::measurement::FORMATS.iter().map(|f| f.doc).collect(),
        refusal: None,
    },
    Family {
        name: "exports",
        what: "Formats that are written",
        docs: || dynocal_export::format::EXPORTS.iter().map(|e| e.doc).collect(),
        refusal: None,
    },
    Family {
        name: "ways",
        what: "Ways to optimise over a record",
        docs: || docs(WAYS),
        refusal: Some(|name, keys| refused(WAYS, name, keys)),
    },
    Family {
        name: "maps",
        what: "Structures of dynamic maps",
        docs: || MAP_STRUCTURES.iter().map(|r| r.doc).collect(),
        refusal: Some(|name, keys| {
            let row = MAP_STRUCTURES.iter().find(|r| r.doc.name == name)?;
            said((row.build)(keys))
        }),
    },
    Family {
        name: "optimisers",
        what: "Bounded minimisation",
        docs: || docs(OPTIMISERS),
        refusal: Some(|name, keys| refused(OPTIMISERS, name, keys)),
    },
];

fn docs<T: ?Sized>(table: &[Member<T>]) -> Vec<MemberDoc> {
    table.iter().map(|m| m.doc).collect()
}

fn refused<T: ?Sized>(table: &[Member<T>], name: &str, keys: &toml::Table) -> Option<String> {
    said((table.iter().find(|m| m.doc.name == name)?.build)(keys))
}

fn said<T>(built: Result<T, BuildError>) -> Option<String> {
    built.err().map(|e| e.to_string())
}
