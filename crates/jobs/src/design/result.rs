//! What a design gives.

use dynocal_ident::excitation::correlation::InputCorrelation;
use dynocal_ident::excitation::coverage::{Coverage, PairCoverage};
use dynocal_numerics::status::{Iterate, Status};
use serde::{Deserialize, Serialize};

use super::margins::MarginUsed;

/// Name and unit.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Quantity {
    /// Name.
    pub name: String,
    /// Unit.
    pub unit: String,
}

/// Criterion of one model at the design.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct CriterionLine {
    /// Model.
    pub model: String,
    /// Criterion.
    pub criterion: String,
    /// Its weight in the sum.
    pub weight: f64,
    /// Its value, which the search makes small.
    pub value: f64,
}

/// Efficiency of a rival relative to the design: below 100 % the design tells more.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Efficiency {
    /// Model.
    pub model: String,
    /// Rival.
    pub rival: String,
    /// Signals that were found within all limits.
    pub signals: usize,
    /// Median share of the free values that were drawn anew until the outputs kept their limits, in percent.
    pub drawn_anew_percent: f64,
    /// Samples that the best of the signals needs for the mean prediction variance of the design, if it goes on as it began:
    /// the variance falls with the length.
    pub same_error_samples: f64,
    /// `100 exp(-(J_D,rival - J_D,design) / p)`: median, least and greatest.
    pub d_percent: (f64, f64, f64),
    /// `100 J_I,design / J_I,rival` over the objective signal: median, least and greatest.
    pub i_percent: (f64, f64, f64),
}

/// A predicted output against its limits.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct SafetyLine {
    /// Output.
    pub output: Quantity,
    /// Least and largest prediction.
    pub predicted: (f64, f64),
    /// Limits; absent where the output has none.
    pub limits: Option<(f64, f64)>,
    /// Margin and what it stands on.
    pub margin: Option<MarginUsed>,
    /// Least distance of the prediction to a limit, and when in s.
    pub least_distance: Option<(f64, f64)>,
    /// Least distance of the band to a limit (negative: the band passes it), and when in s.
    pub least_distance_of_band: Option<(f64, f64)>,
    /// Largest distance to what was identified in units of its boundary, and the share of samples outside (above 1).
    pub outside: Option<(f64, f64)>,
}

/// What the record (with earlier ones) tells about a model.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct InformationLine {
    /// Model.
    pub model: String,
    /// Parameters.
    pub parameters: usize,
    /// Numerical rank of the information.
    pub rank: usize,
    /// Combinations of parameters that leave no trace, in regressor names.
    pub unseen: Vec<Vec<(String, f64)>>,
    /// Name, value and least standard deviation (Cramer-Rao) of each parameter; absent where the rank is short.
    pub bounds: Vec<(String, f64, Option<f64>)>,
}

/// How near the design is to what no record can pass.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Bound {
    /// No record within the limits has a J_D below this; absent where no bound is known.
    pub bound: Option<f64>,
    /// D-efficiency of the design against the bound, at least, in percent.
    pub efficiency_percent: Option<f64>,
    /// Why there is no bound.
    pub none_because: Option<String>,
}

/// The design, the body of `summary.json`.
#[derive(Clone, Debug, Serialize)]
pub struct Designed {
    /// Always `design`.
    pub verb: String,
    /// Name of the run.
    pub name: String,
    /// Converged, all limits kept, every parameter seen.
    pub valid: bool,
    /// What the user should know, most important first.
    pub warnings: Vec<String>,
    /// How the search ended.
    pub status: Status,
    /// Length.
    pub samples: usize,
    /// Sample time in s.
    pub sample_time_s: f64,
    /// Channels.
    pub channels: Vec<Quantity>,
    /// Weighted sum of the criteria: at the design and at the start of the best chain.
    pub value: f64,
    /// The same of the start.
    pub start_value: f64,
    /// Criteria.
    pub criteria: Vec<CriterionLine>,
    /// Rivals of the same limits.
    pub efficiencies: Vec<Efficiency>,
    /// Optimality certificate, where the spec asks for it.
    pub certificate: Option<Bound>,
    /// What the objective signal is.
    pub objective: String,
    /// Safety report.
    pub safety: Vec<SafetyLine>,
    /// Rank and bounds.
    pub information: Vec<InformationLine>,
    /// Coverage of every channel within its limits.
    pub coverage: Vec<Coverage>,
    /// Coverage of pairs of channels.
    pub pairs: Vec<PairCoverage>,
    /// Correlation of pairs of channels (thesis eqs. 2.45, 2.46).
    pub correlations: Vec<InputCorrelation>,
    /// Improvements of the best chain.
    pub history: Vec<Iterate>,
    /// Evaluations of all starts and rounds.
    pub evaluations: usize,
    /// Designs that were made until the bands kept the limits.
    pub rounds: usize,
    /// Files, relative to the run folder.
    pub files: Vec<String>,
}

/// The curves of a design, for its files and its report.
#[derive(Clone, Debug)]
pub struct Curves {
    /// Samples (N x m).
    pub u: Vec<f64>,
    /// Per model: predicted output (N; NaN before the first computed sample) and half width of its band.
    pub outputs: Vec<(Vec<f64>, Vec<f64>)>,
}
