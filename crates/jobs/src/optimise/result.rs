//! What an optimisation over a record gives.

use dynocal_calib::optimise::{
    GridValue, Guard, OptimiseError, Optimum, PartOutcome, Robust, Shortfall, Spread, TermValue,
};
use dynocal_calib::problem::CalibrationProblem;
use dynocal_files::FilesError;
use dynocal_ident::data::{DataError, Dataset};
use dynocal_ident::stored::StoredError;
use dynocal_numerics::status::Status;
use serde::Serialize;

use crate::estimate::TooLarge;
use crate::page::PageError;

/// An optimisation, the body of `summary.json` (without the samples).
#[derive(Clone, Debug, Serialize)]
pub struct Optimised {
    /// Always `optimise`.
    pub verb: &'static str,
    /// Name of the run.
    pub name: String,
    /// Whether the search ended at an optimum and everything asked is kept.
    pub valid: bool,
    /// What came out, in sentences.
    pub verdict: Vec<String>,
    /// What the user should know, most important first.
    pub warnings: Vec<String>,
    /// Models, in the order of the spec.
    pub models: Vec<Used>,
    /// Record that it started from.
    pub record: RecordUsed,
    /// How the search ended.
    pub status: Status,
    /// Its iterations, over all parts.
    pub iterations: usize,
    /// Objective at the start and at the optimum: sum of the weighted terms.
    pub objective: Objective,
    /// Its terms.
    pub terms: Vec<TermValue>,
    /// What was asked, and by how much the free run of the models on the optimal inputs misses it.
    pub asked: Vec<Asked>,
    /// What demands and limits cost, the dearest first; empty where the record was not optimised as a whole.
    pub prices: Vec<PriceLine>,
    /// Parts of a record that was gone through in parts, or the starts of a batch with several.
    pub parts: Vec<PartOutcome>,
    /// Where the problem cannot be met; empty when it was solved.
    pub shortfalls: Vec<Shortfall>,
    /// The guard that was asked for.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub guard: Option<Guard>,
    /// The draws that were asked for.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub robust: Option<Robust>,
    /// How far those of demanded outputs are from the demand.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub spreads: Vec<Spread>,
    /// What the grid of dynamic programming gave.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub grid: Option<GridValue>,
    /// How far the optimum leaves what the models were identified on, where they know it.
    pub coverage: Vec<Left>,
    /// Files, relative to the run folder.
    pub files: Vec<String>,
    /// The problem.
    #[serde(skip)]
    pub problem: CalibrationProblem,
    /// The start record, with the outputs that it was started from.
    #[serde(skip)]
    pub start: Dataset,
    /// The optimum with its samples.
    #[serde(skip)]
    pub optimum: Optimum,
}

/// A model as it was used.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Used {
    /// File, as the spec names it.
    pub file: String,
    /// Output, in the user's terms.
    pub output: String,
    /// Its unit.
    pub unit: String,
    /// Channels that drive it.
    pub inputs: Vec<String>,
    /// Parameters.
    pub parameters: usize,
}

/// A record as it was used.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct RecordUsed {
    /// Name.
    pub name: String,
    /// Samples.
    pub samples: usize,
    /// Sample time in s.
    pub sample_time_s: f64,
    /// Samples that were decided.
    pub decided: DecidedSamples,
}

/// The samples that an optimisation decides. Files hold them as `[first, end]`.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(into = "(usize, usize)")]
pub struct DecidedSamples {
    /// The first one.
    pub first: usize,
    /// One past the last.
    pub end: usize,
}

impl From<DecidedSamples> for (usize, usize) {
    fn from(d: DecidedSamples) -> Self {
        (d.first, d.end)
    }
}

/// Objective at start and optimum.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Objective {
    /// At the start.
    pub start: f64,
    /// At the optimum.
    pub optimum: f64,
    /// Change in percent of the start; none where that is 0.
    pub change_percent: Option<f64>,
    /// What the search minimised at its end: the objective over the extension too, weights on increments, soft limits.
    pub minimised: Option<f64>,
}

/// One thing that was asked.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Asked {
    /// Channel.
    pub channel: String,
    /// Unit of `largest` and `allowed`.
    pub unit: String,
    /// `demand`, `lower`, `upper`, `mean_upper`, `rate`.
    pub of: String,
    /// Largest distance from it; none where the free run diverged.
    pub largest: Option<f64>,
    /// Distance up to which it counts as kept.
    pub allowed: f64,
    /// When, in s from the start of the record; none for means.
    pub at_s: Option<f64>,
    /// Whether it was kept.
    pub kept: bool,
    /// Whether the problem makes it soft: then it may be missed.
    pub soft: bool,
}

/// The price of one demand or limit.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct PriceLine {
    /// Channel.
    pub channel: String,
    /// What of it: `demand`, `lower`, `upper`, `rate`, `mean_upper`.
    pub of: String,
    /// Its unit; the price is per this.
    pub unit: String,
    /// Change of the objective for one unit more of it.
    pub price: f64,
    /// One percent of its size: of the range of the input or demand, of the rate, of the limit.
    pub percent_of_size: f64,
    /// Change of the objective for that much more.
    pub per_percent: f64,
}

/// How far the optimum leaves the boundary that is stored with a model.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Left {
    /// Output of the model.
    pub output: String,
    /// Share of the samples outside at the start, in percent.
    pub start_percent: f64,
    /// The same at the optimum.
    pub optimum_percent: f64,
    /// Largest distance at the optimum; 1 is the boundary.
    pub worst: f64,
    /// Where that is, in s.
    pub at_s: f64,
}

/// An optimisation is not possible.
#[derive(Debug, thiserror::Error)]
pub enum OptimiseJobError {
    /// Files.
    #[error(transparent)]
    Files(#[from] FilesError),
    /// A record.
    #[error(transparent)]
    Data(#[from] DataError),
    /// A model on a record.
    #[error("{file}: {source}")]
    Model {
        /// Model file.
        file: String,
        /// What is wrong.
        source: StoredError,
    },
    /// A part of the record that is not there.
    #[error("{file}: from_s and to_s leave no sample of its {samples} samples ({length_s} s)")]
    Part {
        /// File.
        file: String,
        /// Its samples.
        samples: usize,
        /// Its length in s.
        length_s: f64,
    },
    /// A free run from rest that ends nowhere.
    #[error(
        "{file}: the record has no `{output}`, and from rest the model diverges on its inputs: give the output in the record"
    )]
    Rest {
        /// Output.
        output: String,
        /// Model file.
        file: String,
    },
    /// Problem, models and record do not belong together.
    #[error(transparent)]
    Optimise(#[from] OptimiseError),
    /// More than a machine has.
    #[error(transparent)]
    TooLarge(#[from] TooLarge),
    /// The page.
    #[error(transparent)]
    Page(#[from] PageError),
    /// The user stopped it.
    #[error("interrupted before an optimum was found")]
    Interrupted,
}
