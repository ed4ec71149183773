//! What an identification gives.

use dynocal_ident::prepare::Note;
use dynocal_ident::select::Step;
use dynocal_ident::stored::Parameter;
use dynocal_ident::validate::{Correlation, Kind, Reference, Seen};
use dynocal_numerics::status::Status;
use serde::{Deserialize, Serialize};

use super::after::After;
use super::before::Before;
use super::curves::InputCurves;
use super::finding::Finding;
use super::points::PointsPage;
use super::poles::Pole;

/// Fit numbers over all scored samples of all records of one part together.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Score {
    /// Modelled channel.
    pub output: String,
    /// Part of the data: `estimation`, `selection`, `test`, or the name of a test set.
    pub part: String,
    /// Whether the parameters have seen the data.
    pub data: Seen,
    /// One step ahead, k steps ahead or free run.
    pub kind: Kind,
    /// What it is compared with (measured: noisy).
    pub reference: Reference,
    /// Whether a free run leaves everything that was measured: the numbers then say only that.
    #[serde(default)]
    pub outside: bool,
    /// Number of records.
    pub records: usize,
    /// Number of scored samples.
    pub samples: usize,
    /// Root of the mean squared error, in the unit of the output; absent when a free run diverges.
    pub rmse: Option<f64>,
    /// Mean squared error.
    pub mse: Option<f64>,
    /// 95 % of the absolute errors are at most this.
    pub error_95: Option<f64>,
    /// Half width of the band that was asked for.
    pub band: Option<f64>,
    /// Share of the errors inside it, in percent.
    pub in_band_percent: Option<f64>,
    /// `1 - SSE / SST` in percent (thesis eq. 2.48), SST about the mean of the scored samples.
    pub r2_percent: Option<f64>,
    /// `1 - sqrt(SSE / SST)` in percent.
    pub nrmse_fit_percent: Option<f64>,
    /// Unit of the output.
    pub unit: String,
    /// How the errors of a free run are spread.
    #[serde(default)]
    pub histogram: Option<Histogram>,
}

/// Numbers of errors in cells of equal width; what lies beyond the ends is in the cells there.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Histogram {
    /// Middle of each cell, in the unit of the output.
    pub centres: Vec<f64>,
    /// Errors in it.
    pub counts: Vec<usize>,
}

/// What the one-step errors of a part still hold.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct ResidualTests {
    /// Part of the data.
    pub part: String,
    /// Which errors: one step or free run.
    pub kind: Kind,
    /// Autocorrelation.
    pub auto: Correlation,
    /// Correlation with each input.
    pub cross: Vec<InputCrossCorrelation>,
}

/// Correlation of residuals with an input. Files hold it as `[input, correlation]`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(from = "(String, Correlation)", into = "(String, Correlation)")]
pub struct InputCrossCorrelation {
    /// Input.
    pub input: String,
    /// Correlation.
    pub correlation: Correlation,
}

impl From<(String, Correlation)> for InputCrossCorrelation {
    fn from((input, correlation): (String, Correlation)) -> Self {
        Self { input, correlation }
    }
}

impl From<InputCrossCorrelation> for (String, Correlation) {
    fn from(c: InputCrossCorrelation) -> Self {
        (c.input, c.correlation)
    }
}

/// The way of a selection of terms.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Path {
    /// Number of candidates.
    pub pool: usize,
    /// Number of steps that were kept.
    pub kept: usize,
    /// All steps.
    pub steps: Vec<Step>,
}

/// Scores of a linear model from the same records.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Baseline {
    /// Structure in words.
    pub structure: String,
    /// Part of the data that is scored.
    pub part: String,
    /// Root of the mean squared error of the free run, in the unit of the output; absent where it diverges.
    pub rmse: Option<f64>,
    /// `1 - SSE / SST` in percent.
    pub r2_percent: Option<f64>,
    /// What it does at rest, after a step and over frequency, input by input.
    #[serde(default)]
    pub curves: Vec<InputCurves>,
}

/// One modelled output.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct Modelled {
    /// Modelled channel.
    pub target: String,
    /// Its unit.
    pub unit: String,
    /// Driving channels.
    pub inputs: Vec<String>,
    /// Structure.
    pub structure: String,
    /// What was learnt into the structure, in words; of response models.
    #[serde(default)]
    pub what: Option<String>,
    /// Estimator.
    pub estimator: String,
    /// How the estimator ended; this and the next three are absent for a model from a file.
    pub status: Option<Status>,
    /// Parameters with standard errors.
    pub parameters: Vec<Parameter>,
    /// Numerical rank of the problem.
    pub rank: Option<usize>,
    /// Cost evaluations.
    pub evaluations: Option<usize>,
    /// Samples that entered the estimate.
    pub samples: Option<usize>,
    /// How the terms were selected; absent where they were given.
    pub selection: Option<Path>,
    /// Residual correlations, of the estimation and the last unseen part.
    pub residuals: Vec<ResidualTests>,
    /// A linear model from the same records: what every other one has to beat.
    #[serde(default)]
    pub baseline: Option<Baseline>,
    /// What the model does at rest, after a step and over frequency, input by input.
    #[serde(default)]
    pub curves: Vec<InputCurves>,
    /// Poles about the middle of the records, slowest first.
    #[serde(default)]
    pub poles: Vec<Pole>,
    /// Sample time in s; absent for steady tables.
    #[serde(default)]
    pub sample_time_s: Option<f64>,
    /// Each point predicted from the others, sections, effects; of response models of steady tables.
    #[serde(default)]
    pub points: Option<PointsPage>,
    /// Spread, stability, boundary.
    pub after: After,
    /// Model file, relative to the run folder.
    pub file: String,
}

impl Modelled {
    /// What the model is, in words.
    pub fn in_words(&self) -> String {
        match &self.what {
            Some(what) => format!("{what} ({})", self.structure),
            None => format!(
                "{} with {} parameters, estimated by {}",
                self.structure,
                self.parameters.len(),
                self.estimator
            ),
        }
    }
}

/// Result of the job: the body of `summary.json`.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct Identified {
    /// Always `identify`.
    pub verb: String,
    /// Name of the run.
    pub name: String,
    /// What came out, against what, and what to do next, in sentences.
    #[serde(default)]
    pub verdict: Vec<String>,
    /// Whether the data are points without time.
    #[serde(default)]
    pub steady: bool,
    /// Whether the models may be used: no finding is a fault.
    pub valid: bool,
    /// Findings that are faults or warnings, as sentences, most important first.
    pub warnings: Vec<String>,
    /// What the user should know, graded, most important first.
    #[serde(default)]
    pub findings: Vec<Finding>,
    /// What was done to the records of each part before the fit; empty where nothing was.
    pub preparation: Vec<Prepared>,
    /// Level of confidence of intervals and bounds.
    #[serde(default)]
    pub confidence: f64,
    /// What the estimation records say before the fit; absent for models that are only scored.
    pub before: Option<Before>,
    /// One for each target.
    pub models: Vec<Modelled>,
    /// Fit numbers of all targets.
    pub scores: Vec<Score>,
    /// Records with measured and computed outputs.
    pub records: Vec<RecordFile>,
    /// Files of the step, relative to the run folder.
    pub files: Vec<String>,
}

/// The preparation of one part.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Prepared {
    /// Part of the data.
    pub part: String,
    /// What each step did.
    pub notes: Vec<Note>,
    /// The first record before the first step and after each; of the estimation only.
    pub stages: Vec<Stage>,
}

/// A record between two steps.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Stage {
    /// Step that made it; `recorded` before the first.
    pub step: String,
    /// Name of the record.
    pub record: String,
    /// File, relative to the run folder.
    pub file: String,
}

/// A record with its computed outputs in a file.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct RecordFile {
    /// Part of the data.
    pub part: String,
    /// Name of the record.
    pub record: String,
    /// Whether the parameters have seen it.
    pub data: Seen,
    /// File, relative to the run folder.
    pub file: String,
}

/// A file of the step, relative to the run folder.
pub(crate) fn in_step(name: &str) -> String {
    format!("steps/01-identify/{name}")
}
