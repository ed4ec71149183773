//! What may be chosen about an optimisation over a record.

use super::guard::Guard;
use super::robust::Robust;
use super::way::{MOST_S, Way};
use dynocal_files::spec::Faults;
use serde::{Deserialize, Serialize};

/// What becomes of the inputs at the end of the record, where part of what they do is not seen any more.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum EndCondition {
    /// They are free; inputs that act only after the end are held.
    #[default]
    Free,
    /// Inputs whose effect reaches beyond the end are those of the start record.
    Start,
}

/// What becomes of the inputs before the first sample that all models can compute.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum History {
    /// They are those of the start record.
    #[default]
    Fixed,
    /// They are decided as well.
    Free,
}

/// Where the demand of the demanded outputs comes from.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum DemandFrom {
    /// The models' own response to the start inputs: what these give can be met, by these at least.
    #[default]
    Response,
    /// The same, led back smoothly where it leaves the range of the problem's demand by more than half of it: there nothing is
    /// asked, and models rarely know much of it.
    Within,
    /// The output as it stands in the start record: whether it can be met is found out.
    Record,
}

/// Options of an optimisation over a record.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct OptimiseOptions {
    /// Where demands come from.
    pub demand: DemandFrom,
    /// Scaled KKT error at which it has converged.
    pub tolerance: f64,
    /// Most iterations (of each part, where the record is gone through in parts).
    pub max_iterations: usize,
    /// Inputs at the end.
    pub end: EndCondition,
    /// Time in s by which the record is continued, with its last inputs and given channels held, before it is optimised;
    /// what is added is cut off again. What an optimum does because nobody looks beyond its end it then does out of sight.
    pub extend_s: f64,
    /// Inputs before the first decided sample.
    pub history: History,
    /// How the record is gone through.
    pub way: Way,
    /// Weight on increments of the inputs whose problem gives none: increments as large as those of the start record add this
    /// share to the objective of the start. 0: none. Models know little of inputs that jump to and fro from sample to sample,
    /// and an optimum finds what they get wrong there.
    pub smoothing: f64,
    /// Where the search does not end with demands that are met exactly, they may give way: by this share of the range where the price
    /// of a demand is the objective of the start for the whole range, further in proportion to the price (a quadratic penalty). At a
    /// sample where hardly any input acts, meeting a demand costs more than anything else, and multipliers grow without bound.
    /// 0: never.
    pub give: f64,
    /// How far the optimum may go from what its models were identified on; absent: as far as it likes.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub guard: Option<Guard>,
    /// Draws of the models that every limit holds for; absent: the models as estimated are all.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub robust: Option<Robust>,
    /// Whether a search that failed is followed by one for where and by how much the problem cannot be met
    /// ([`Optimum::shortfalls`](super::Optimum::shortfalls)).
    pub explain: bool,
}

impl Default for OptimiseOptions {
    fn default() -> Self {
        Self {
            demand: DemandFrom::default(),
            tolerance: 1e-8,
            max_iterations: 500,
            end: EndCondition::default(),
            extend_s: 0.0,
            history: History::default(),
            way: Way::default(),
            smoothing: 0.0,
            give: 0.0,
            guard: None,
            robust: None,
            explain: true,
        }
    }
}

impl OptimiseOptions {
    /// Checks them as a whole; `key` is that of the options in their file.
    pub fn check(&self, key: &str, faults: &mut Faults) {
        let of = |field: &str| format!("{key}.{field}");
        faults.range(&of("tolerance"), self.tolerance, 1e-12, 1e-2, "of the scaled KKT error");
        faults.range(&of("max_iterations"), self.max_iterations as f64, 1.0, 1e6, "iterations");
        faults.range(&of("extend_s"), self.extend_s, 0.0, MOST_S, "s");
        faults.range(&of("smoothing"), self.smoothing, 0.0, 1e3, "of the objective");
        faults.range(&of("give"), self.give, 0.0, 0.1, "of the range of a demand");
        if let Some(guard) = self.guard {
            guard.check(&of("guard"), faults);
        }
        if let Some(robust) = self.robust {
            robust.check(&of("robust"), faults);
        }
        self.way.check(&of("way"), faults);
    }
}
