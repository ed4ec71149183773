//! What an estimator reports, and the one place where it is put together.

use dynocal_numerics::status::{Iterate, Status};
use serde::{Deserialize, Serialize};

use super::EstimateError;
use super::cost::Cost;
use super::covariance::{CovarianceChoice, CovarianceKind, Evidence, Rows, Stored, Uncertainty, uncertainty};
use super::noise::Residuals;
use super::rank::rank_warning;
use crate::experiment::Experiment;
use crate::model::form::AnyForm;
use crate::model::response::LeftOut;
use crate::model::response::choose::Choice;

/// Which error a fit made small.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Minimised {
    /// One-step prediction error (PEM).
    OneStep,
    /// Free-run simulation error (SEM).
    FreeRun,
}

/// An estimate.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct Fit {
    /// Name of the estimator.
    pub estimator: String,
    /// Which error [`Fit::mse`] is.
    pub minimised: Minimised,
    /// Parameters (p).
    pub theta: Vec<f64>,
    /// Names of the parameters.
    pub names: Vec<String>,
    /// Covariance of the parameters, p x p row-major, as [`Fit::covariance_kind`] says. Zero rows for parameters that
    /// the data do not determine.
    pub covariance: Vec<f64>,
    /// `white`: `s2 (J'J)^-1` with `s2 = |e|^2 / (n - p)`; `robust`: the sandwich for coloured errors.
    #[serde(default)]
    pub covariance_kind: CovarianceKind,
    /// Standard errors (p): square roots of its diagonal; NaN for parameters that the data do not determine.
    #[serde(deserialize_with = "crate::nullable::numbers")]
    pub std_errors: Vec<f64>,
    /// Mean of the (weighted) squared errors on the data used.
    pub mse: f64,
    /// Variance of the errors, `|e|^2 / (n - p)`; with Huber's cost that of their pseudo-values.
    pub noise_variance: f64,
    /// Whether the errors are white.
    #[serde(default)]
    pub residuals: Residuals,
    /// Scored samples.
    pub samples: usize,
    /// Numerical rank of the Jacobian; below p some parameters are not determined.
    pub rank: usize,
    /// How the estimator ended.
    pub status: Status,
    /// Evaluations of the cost.
    pub evaluations: usize,
    /// Iterations (the objective is the sum of squares, or of the cost where that is another).
    pub history: Vec<Iterate>,
    /// What the user should know, in sentences.
    pub warnings: Vec<String>,
    /// What is good to know, in sentences.
    #[serde(default)]
    pub notes: Vec<String>,
    /// Mean squared error by which each start of a search with several was judged, in their order; infinite for those that
    /// diverged.
    #[serde(default, deserialize_with = "crate::nullable::numbers")]
    pub starts: Vec<f64>,
    /// What the estimator put into the structure, where theta alone does not say it; not kept with the report of the fit.
    #[serde(skip)]
    pub learnt: Option<LearntForm>,
}

/// A structure with what was learnt in it.
#[derive(Clone, Debug)]
pub struct LearntForm {
    /// The structure, ready to be used with [`Fit::theta`].
    pub form: AnyForm,
    /// Each point predicted from the others.
    pub left_out: LeftOut,
    /// How it was chosen, where there were several candidates.
    pub choice: Option<Choice>,
}

/// What a search found: a [`Fit`] without what follows from errors and Jacobian.
pub(super) struct Found {
    pub(super) estimator: &'static str,
    pub(super) minimised: Minimised,
    pub(super) theta: Vec<f64>,
    pub(super) names: Vec<String>,
    pub(super) status: Status,
    pub(super) evaluations: usize,
    pub(super) history: Vec<Iterate>,
    pub(super) warnings: Vec<String>,
}

impl Fit {
    /// The report of `found` with the covariance that `evidence` (errors and Jacobian there) gives.
    pub(super) fn new(
        found: Found,
        evidence: &mut dyn Evidence,
        samples: usize,
        choice: CovarianceChoice,
        cost: Cost,
    ) -> Result<Self, EstimateError> {
        let known = uncertainty(evidence, samples, choice, cost);
        let known = known.map_err(|source| EstimateError::Numeric { estimator: found.estimator, source })?;
        let Uncertainty { covariance, std_errors, kind, residuals, factor, sum_squares, noise_variance } =
            known;
        let mut warnings = found.warnings;
        warnings.extend(rank_warning(&factor, &found.names, &found.theta, evidence.rows()));
        Ok(Self {
            estimator: found.estimator.into(),
            minimised: found.minimised,
            theta: found.theta,
            names: found.names,
            covariance,
            covariance_kind: kind,
            std_errors,
            mse: sum_squares / samples.max(1) as f64,
            noise_variance,
            residuals,
            samples,
            rank: factor.rank,
            status: found.status,
            evaluations: found.evaluations,
            history: found.history,
            warnings,
            notes: Vec::new(),
            starts: Vec::new(),
            learnt: None,
        })
    }

    /// [`Fit::new`] from errors and Jacobian that are stored whole, row by row for all samples of `data`.
    pub(super) fn from_stored(
        found: Found,
        errors: &[f64],
        jacobian: &[f64],
        data: &[Experiment],
        samples: usize,
    ) -> Result<Self, EstimateError> {
        let records = data.iter().map(Experiment::len).collect();
        let mut evidence = Stored {
            errors,
            jacobian,
            params: found.theta.len(),
            records,
            penalties: &[],
            exogenous: false,
            rows: Rows::Sensitivities,
        };
        Self::new(found, &mut evidence, samples, CovarianceChoice::Auto, Cost::SQUARED)
    }
}
