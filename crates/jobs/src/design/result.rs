//! What a design gives.

use dynocal_design::information::ParameterShare;
use dynocal_ident::excitation::correlation::InputCorrelation;
use dynocal_ident::excitation::coverage::{Coverage, PairCoverage};
use dynocal_numerics::interval::Interval;
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
    /// `100 exp(-(J_D,rival - J_D,design) / p)`.
    pub d_percent: MedianRange,
    /// `100 J_I,design / J_I,rival` over the objective signal.
    pub i_percent: MedianRange,
}

/// A figure over several signals. Files hold it as `[median, least, greatest]`.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
#[serde(into = "(f64, f64, f64)")]
pub struct MedianRange {
    /// Median.
    pub median: f64,
    /// Least.
    pub least: f64,
    /// Greatest.
    pub greatest: f64,
}

impl From<MedianRange> for (f64, f64, f64) {
    fn from(m: MedianRange) -> Self {
        (m.median, m.least, m.greatest)
    }
}

/// Where an output comes nearest to a limit. Files hold it as `[distance, at_s]`.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(from = "(f64, f64)", into = "(f64, f64)")]
pub struct LeastDistance {
    /// Distance in the unit of the output; negative: the limit is passed.
    pub distance: f64,
    /// When, in s.
    pub at_s: f64,
}

impl From<(f64, f64)> for LeastDistance {
    fn from((distance, at_s): (f64, f64)) -> Self {
        Self { distance, at_s }
    }
}

impl From<LeastDistance> for (f64, f64) {
    fn from(l: LeastDistance) -> Self {
        (l.distance, l.at_s)
    }
}

/// How far a record leaves what a model was identified on. Files hold it as `[worst, share]`.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(from = "(f64, f64)", into = "(f64, f64)")]
pub struct Outside {
    /// Largest distance in units of the boundary.
    pub worst: f64,
    /// Share of the samples outside (distance above 1).
    pub share: f64,
}

impl From<(f64, f64)> for Outside {
    fn from((worst, share): (f64, f64)) -> Self {
        Self { worst, share }
    }
}

impl From<Outside> for (f64, f64) {
    fn from(o: Outside) -> Self {
        (o.worst, o.share)
    }
}

/// A predicted output against its limits.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct SafetyLine {
    /// Output.
    pub output: Quantity,
    /// Least and largest prediction.
    pub predicted: Interval,
    /// Limits; absent where the output has none.
    pub limits: Option<Interval>,
    /// Margin and what it stands on.
    pub margin: Option<MarginUsed>,
    /// Least distance of the prediction to a limit.
    pub least_distance: Option<LeastDistance>,
    /// Least distance of the band to a limit (negative: the band passes it).
    pub least_distance_of_band: Option<LeastDistance>,
    /// How far the record leaves what its model was identified on; absent without a boundary.
    pub outside: Option<Outside>,
}

/// What a record tells of a parameter. Files hold it as `[name, value, least_std]`.
#[derive(Clone, Debug, PartialEq, Serialize)]
#[serde(into = "(String, f64, Option<f64>)")]
pub struct ParameterBound {
    /// Name.
    pub name: String,
    /// Value.
    pub value: f64,
    /// Least standard deviation (Cramer-Rao); absent where the rank is short.
    pub least_std: Option<f64>,
}

impl From<ParameterBound> for (String, f64, Option<f64>) {
    fn from(b: ParameterBound) -> Self {
        (b.name, b.value, b.least_std)
    }
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
    pub unseen: Vec<Vec<ParameterShare>>,
    /// Every parameter with what its standard deviation cannot fall below.
    pub bounds: Vec<ParameterBound>,
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

/// A predicted output over a record.
#[derive(Clone, Debug)]
pub struct OutputCurve {
    /// Prediction (N); NaN before the first computed sample.
    pub predicted: Vec<f64>,
    /// Half width of its band (N).
    pub half_width: Vec<f64>,
}

/// The curves of a design, for its files and its report.
#[derive(Clone, Debug)]
pub struct Curves {
    /// Samples (N x m).
    pub u: Vec<f64>,
    /// One per model.
    pub outputs: Vec<OutputCurve>,
}
