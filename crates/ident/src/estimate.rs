//! Parameter estimation: the contract, its table, and what every estimator reports.

pub mod bands;
pub mod cost;
mod covariance;
mod distribution;
pub mod els;
mod fit;
pub mod initial;
pub mod iv;
pub mod learn;
pub mod missing;
mod noise;
pub mod ols;
pub mod pem;
mod rank;
pub mod rls;
pub mod search;
pub mod sem;
pub mod several;
mod simulation;
mod stability;
mod table;
pub mod train;

use dynocal_numerics::linalg::LinalgError;

pub use covariance::{CovarianceChoice, CovarianceKind};
pub use distribution::ParameterDistribution;
pub use fit::{Fit, LearntForm, Minimised};
pub use noise::Residuals;
pub use table::{ESTIMATORS, EstimatorRow, Fits, Gaps, docs, estimator, row};

use crate::data::DataError;
use crate::experiment::Experiment;
use crate::model::Model;
use crate::model::form::Form;

/// An estimator: model structure and experiments in, parameters with what is known about them out.
pub trait Estimator: Send + Sync {
    /// Estimates the parameters of `model` from all experiments together. Which forms an estimator fits is in its row.
    ///
    /// `start` is a start point (p) for iterative estimators; without one they start from least squares.
    /// `interrupt` is asked often and ends the search with the best point so far.
    ///
    /// # Errors
    /// [`EstimateError`]: the data cannot give an answer, or no stable start exists.
    fn estimate(
        &self,
        model: &dyn Form,
        data: &[Experiment],
        start: Option<&[f64]>,
        interrupt: &dyn Fn() -> bool,
    ) -> Result<Fit, EstimateError>;

    /// The same where other records choose between what was found (early stopping, the best of several starts), and where
    /// `start` does not replace the estimator's own start but competes with it: both are searched from on all records, and the
    /// better end counts. What was found on a part of them may be useless on the whole, and a start that costs more may lead
    /// to the better minimum. An estimator that chooses nothing, or searches nothing, leaves them alone.
    ///
    /// # Errors
    /// As of [`Estimator::estimate`].
    fn estimate_selecting(
        &self,
        model: &dyn Form,
        data: &[Experiment],
        _selecting: &[Experiment],
        start: Option<&[f64]>,
        interrupt: &dyn Fn() -> bool,
    ) -> Result<Fit, EstimateError> {
        self.estimate(model, data, start, interrupt)
    }
}

/// No estimate is possible.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum EstimateError {
    /// The data do not fit the task.
    #[error(transparent)]
    Data(#[from] DataError),
    /// The orders do not fit the channels.
    #[error(transparent)]
    Structure(#[from] crate::model::poly::StructureError),
    /// A response model cannot be learnt from the points.
    #[error(transparent)]
    Response(#[from] crate::model::response::ResponseError),
    /// The keys of a learner, which were checked when its structure was built, are not those of its kind.
    #[error(transparent)]
    Keys(#[from] dynocal_numerics::registry::BuildError),
    /// The estimator is made for other forms of models.
    #[error("the estimator `{estimator}` does not fit a model of the form `{found}`, it fits {expected}")]
    Form {
        /// Estimator.
        estimator: &'static str,
        /// Form of the model.
        found: &'static str,
        /// What it fits.
        expected: String,
    },
    /// A start of the free runs that does not go with the model or the estimator.
    #[error("{estimator}: initial = \"{}\" does not go with {found}", .rule.key())]
    Initial {
        /// Estimator.
        estimator: &'static str,
        /// Start that was asked for.
        rule: crate::model::initial::Initial,
        /// What was found.
        found: String,
    },
    /// Least squares needs a model that is linear in its parameters.
    #[error(
        "{estimator}: the model is not linear in its {params} parameters; `train` and `sem` fit such models"
    )]
    NotLinear {
        /// Estimator.
        estimator: &'static str,
        /// Number of parameters.
        params: usize,
    },
    /// A start point of the wrong length.
    #[error("start point has {found} entries, the model has {expected} parameters")]
    Start {
        /// Entries found.
        found: usize,
        /// Parameters.
        expected: usize,
    },
    /// A linear start was asked of a structure that has no linear path.
    #[error(
        "start = \"linear\": the model `{model}` has no linear path; a network has one with `direct = true`"
    )]
    NoLinearPath {
        /// First parameters of the model.
        model: String,
    },
    /// A mean that cannot be made.
    #[error("train: found mean = {found}, expected {expected}")]
    Mean {
        /// Number of members that was asked for.
        found: usize,
        /// What goes.
        expected: String,
    },
    /// The free run diverges and no repaired start was found.
    #[error(
        "the free run of the model `{model}` diverges on {record} from sample {sample} on, also with all output terms shrunk; try fewer output terms or a lower degree"
    )]
    Unstable {
        /// First regressors of the model.
        model: String,
        /// Record.
        record: String,
        /// First non-finite sample.
        sample: usize,
    },
    /// More is unknown than can be estimated together.
    #[error(
        "{record}: {found} missing samples and initial states, expected at most {most}: bridge short gaps or split the record at long ones"
    )]
    Missing {
        /// Record.
        record: String,
        /// Unknowns.
        found: usize,
        /// Most that are estimated together.
        most: usize,
    },
    /// The linear algebra met values it cannot handle (overflow in the regressors).
    #[error("{estimator}: {source}")]
    Numeric {
        /// Estimator.
        estimator: &'static str,
        /// What happened.
        source: LinalgError,
    },
}

/// All parameter names.
fn names(model: &dyn Model) -> Vec<String> {
    (0..model.n_params()).map(|k| model.param_name(k)).collect()
}

/// The model in a few words, for messages.
fn short_name(names: &[String]) -> String {
    let head = names.iter().take(3).cloned().collect::<Vec<_>>().join(" + ");
    if names.len() > 3 { format!("{head} + ... ({} terms)", names.len()) } else { head }
}

/// The model as a NARX model, which the estimator needs.
fn narx<'a>(estimator: &'static str, model: &'a dyn Form) -> Result<&'a dyn Model, EstimateError> {
    model.dynamics().ok_or_else(|| unfit(estimator, model))
}

/// The model as the one form that the estimator is made for.
fn made_for<'a, T: Form>(estimator: &'static str, model: &'a dyn Form) -> Result<&'a T, EstimateError> {
    model.is_a().ok_or_else(|| unfit(estimator, model))
}

fn unfit(estimator: &'static str, model: &dyn Form) -> EstimateError {
    let fits = ESTIMATORS.iter().find(|r| r.doc.name == estimator).map(|r| r.fits.words());
    EstimateError::Form { estimator, found: model.row().name, expected: fits.unwrap_or_default() }
}
