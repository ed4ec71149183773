//! What an identification gives.

use dynocal_ident::model::poly::PolyNarx;
use dynocal_ident::select::frols::Step;
use dynocal_ident::validate::{self, Kind, Reference, Seen};
use dynocal_numerics::status::Status;
use serde::{Deserialize, Serialize};

/// Schema name of a model file.
pub const MODEL_SCHEMA: &str = "dynocal/model";
/// Version of the model file.
pub const MODEL_VERSION: u32 = 1;

/// A model with everything that is needed to simulate it elsewhere.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct ModelFile {
    /// Inputs, output and regressors.
    pub structure: PolyNarx,
    /// Units of the inputs.
    pub input_units: Vec<String>,
    /// Unit of the output.
    pub output_unit: String,
    /// Sample time in s.
    pub sample_time_s: f64,
    /// Parameters with their names.
    pub parameters: Vec<Parameter>,
    /// Estimator.
    pub estimator: String,
    /// Where the data came from.
    pub origin: String,
}

/// One estimated parameter.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Parameter {
    /// Regressor that it multiplies.
    pub name: String,
    /// Value.
    pub value: f64,
    /// Standard error for white errors; absent where the data do not determine the parameter.
    pub std_error: Option<f64>,
}

/// Fit numbers over all scored samples of all records together.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Score {
    /// Whether the parameters have seen the data.
    pub data: Seen,
    /// One step ahead or free run.
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
    /// `1 - SSE / SST` in percent (thesis eq. 2.48), SST about the mean of the scored samples.
    pub r2_percent: Option<f64>,
    /// `1 - sqrt(SSE / SST)` in percent.
    pub nrmse_fit_percent: Option<f64>,
    /// 95 % of the absolute errors are at most this.
    pub error_95: Option<f64>,
    /// Unit of the output.
    pub unit: String,
}

impl Score {
    /// The score of `ident` over `records` records. JSON has no NaN, so a diverged free run has no numbers.
    pub fn new(s: &validate::Score, records: usize, unit: &str) -> Self {
        let finite = |x: f64| x.is_finite().then_some(x);
        Self {
            data: s.data,
            kind: s.kind,
            reference: s.reference,
            records,
            samples: s.samples,
            rmse: finite(s.rmse),
            mse: finite(s.mse),
            r2_percent: finite(100.0 * s.r2),
            nrmse_fit_percent: finite(100.0 * s.nrmse_fit),
            error_95: finite(s.error_95),
            unit: unit.into(),
        }
    }
}

/// Result of the job: the body of `summary.json`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Identified {
    /// Always `identify`.
    pub verb: String,
    /// Name of the run.
    pub name: String,
    /// How the estimator ended.
    pub status: Status,
    /// Whether the model may be used without a warning: converged, and every free run finite.
    pub valid: bool,
    /// What the user should know, most important first.
    pub warnings: Vec<String>,
    /// Modelled channel.
    pub target: String,
    /// Driving channels.
    pub inputs: Vec<String>,
    /// Structure and estimator.
    pub structure: String,
    /// Estimator.
    pub estimator: String,
    /// Number of parameters.
    pub parameters: usize,
    /// Numerical rank of the problem.
    pub rank: usize,
    /// Cost evaluations.
    pub evaluations: usize,
    /// Samples that entered the estimate.
    pub samples: usize,
    /// Path of the structure selection; empty without one.
    pub selection: Vec<Step>,
    /// Fit numbers.
    pub scores: Vec<Score>,
    /// Files of the step, relative to the run folder.
    pub files: Vec<String>,
}
