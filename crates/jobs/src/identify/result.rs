//! What an identification gives.

use dynocal_ident::model::poly::StructureError;
use dynocal_ident::prepare::Note;
use dynocal_ident::select::Step;
use dynocal_ident::validate::boundary::BoundaryModel;
use dynocal_ident::validate::{Correlation, Kind, Reference, Seen};
use dynocal_numerics::status::Status;
use serde::{Deserialize, Serialize};

use super::after::After;
use super::before::Before;
use super::stored::{Fitted, Stored};

/// Schema name of a model file.
pub const MODEL_SCHEMA: &str = "dynocal/model";
/// Version of the model file.
pub const MODEL_VERSION: u32 = 2;

/// A model with everything that is needed to simulate it elsewhere.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct ModelFile {
    /// Inputs, output and form; networks with their scaling.
    pub structure: Stored,
    /// Inputs.
    pub inputs: Vec<Quantity>,
    /// Output.
    pub output: Quantity,
    /// Sample time in s.
    pub sample_time_s: f64,
    /// Parameters with their names.
    pub parameters: Vec<Parameter>,
    /// Estimator.
    pub estimator: String,
    /// Variance of the errors that the estimator made small, in squared units of the output.
    pub noise_variance: Option<f64>,
    /// What of the space of lagged inputs and outputs was identified; absent where it could not be learnt.
    #[serde(default)]
    pub boundary: Option<BoundaryModel>,
    /// What was done to the records before the estimate: other records need the same.
    #[serde(default)]
    pub preparation: Vec<Note>,
    /// Where the data came from.
    pub origin: String,
}

impl ModelFile {
    /// The model, ready to simulate.
    ///
    /// # Errors
    /// [`StructureError`] when parameters and structure do not belong together.
    pub fn fitted(&self) -> Result<Fitted, StructureError> {
        let theta: Vec<f64> = self.parameters.iter().map(|p| p.value).collect();
        let p = self.structure.n_params();
        if theta.len() != p {
            return Err(StructureError::Orders {
                output: self.output.name.clone(),
                found: theta.len(),
                expected: p,
                inputs: self.inputs.iter().map(|q| q.name.clone()).collect(),
            });
        }
        Fitted::new(self.structure.clone(), theta)
    }
}

/// A channel of a model.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Quantity {
    /// Name.
    pub name: String,
    /// Unit.
    pub unit: String,
}

/// One estimated parameter.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Parameter {
    /// Regressor that it multiplies.
    pub name: String,
    /// Value.
    pub value: f64,
    /// Standard error; absent where the data do not determine the parameter.
    pub std_error: Option<f64>,
}

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
    pub cross: Vec<(String, Correlation)>,
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
    /// Spread, stability, boundary.
    pub after: After,
    /// Model file, relative to the run folder.
    pub file: String,
}

/// Result of the job: the body of `summary.json`.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct Identified {
    /// Always `identify`.
    pub verb: String,
    /// Name of the run.
    pub name: String,
    /// Whether the models may be used without a warning: converged, and every free run finite.
    pub valid: bool,
    /// What the user should know, most important first.
    pub warnings: Vec<String>,
    /// What was done to the records of each part before the fit; empty where nothing was.
    pub preparation: Vec<Prepared>,
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
