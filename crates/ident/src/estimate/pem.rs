//! Prediction-error estimation of linear models with noise models (maximum likelihood for Gaussian noise).
//!
//! ```text
//! theta = argmin sum_t w(t) eps(t; theta)^2,   eps = D/C (A y - sum B_i/F_i u_i)
//! ```
//!
//! by Levenberg-Marquardt with the exact gradient of [`crate::model::linear`]. Before the first sample of each record the
//! filters are at rest, hold measured values, or states that are estimated with the parameters ([`Initial`]);
//! initialising samples run through them and enter no score. NaN is a missing sample: see
//! [`crate::estimate::missing`]. A trial with an unstable filter gives a large or non-finite error and is a bad trial,
//! nothing more.
//!
//! The start is least squares throughout (one that is given besides is searched from as well, and the better end counts): a
//! high-order ARX model gives the innovations and the noise-free response, from which the wanted polynomials follow linearly.
//!
//! Reference: E. J. Hannan, J. Rissanen, Recursive estimation of mixed autoregressive-moving average order,
//! Biometrika 69 (1982); K. Steiglitz, L. E. McBride, IEEE Trans. Autom. Control 10 (1965); L. Ljung, System
//! Identification (1999), section 10.4.

mod further;
mod problem;
mod start;

use dynocal_numerics::lm::{LeastSquares, LmOptions, LmOutcome, levenberg_marquardt_interruptible};
use dynocal_numerics::registry::{self, MemberDoc, ParamDoc};
use serde::Deserialize;

use super::fit::Found;
use super::missing::Recovered;
use super::table::{EstimatorRow, Fits, Gaps};
use super::{EstimateError, Estimator, Fit, Minimised, made_for};
use crate::experiment::Experiment;
use crate::model::form::Form;
use crate::model::initial::Initial;
use crate::model::linear::LinearModel;
use problem::PredictionError;

/// Row of the table.
pub(super) const ROW: EstimatorRow = EstimatorRow {
    doc: MemberDoc {
        name: "pem",
        what: "prediction error of linear structures with a noise model, exact gradient; missing samples are unknowns",
        params: &[
            ParamDoc {
                name: "max_evaluations",
                unit: "-",
                default: "200",
                what: "most cost evaluations of one search",
            },
            ParamDoc {
                name: "cost_tolerance",
                unit: "-",
                default: "1e-14",
                what: "relative decrease of the cost at which the search has converged",
            },
            ParamDoc {
                name: "initial",
                unit: "-",
                default: "rest",
                what: "what stands before the first sample: `rest`, `measured` outputs, or `estimated` with the parameters",
            },
        ],
    },
    fits: Fits::Forms(&["linear"]),
    gaps: Gaps::Estimated,
    build: |keys| Ok(Box::new(registry::keys::<Pem>("pem", keys)?)),
};

/// Options of prediction-error estimation.
#[derive(Clone, Copy, Debug, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Pem {
    /// Most cost evaluations of one search.
    pub max_evaluations: usize,
    /// Relative decrease of the cost at which the search has converged.
    pub cost_tolerance: f64,
    /// What stands before the first sample.
    pub initial: Initial,
}

impl Default for Pem {
    fn default() -> Self {
        Self { max_evaluations: 200, cost_tolerance: 1e-14, initial: Initial::Rest }
    }
}

impl Estimator for Pem {
    fn estimate(
        &self,
        model: &dyn Form,
        data: &[Experiment],
        start: Option<&[f64]>,
        interrupt: &dyn Fn() -> bool,
    ) -> Result<Fit, EstimateError> {
        Pem::estimate(self, made_for::<LinearModel>("pem", model)?, data, start, interrupt)
    }

    fn estimate_selecting(
        &self,
        model: &dyn Form,
        data: &[Experiment],
        _selecting: &[Experiment],
        start: Option<&[f64]>,
        interrupt: &dyn Fn() -> bool,
    ) -> Result<Fit, EstimateError> {
        let model = made_for::<LinearModel>("pem", model)?;
        Ok(self.search_starts(model, data, Starts::Competing(start), interrupt)?.0)
    }
}

impl Pem {
    /// Estimates the parameters of `model` from all experiments together; `start` (p) replaces the least-squares start.
    ///
    /// ```
    /// use dynocal_ident::estimate::pem::Pem;
    /// use dynocal_ident::experiment::Experiment;
    /// use dynocal_ident::model::linear::LinearModel;
    /// // y(t) = 0.8 y(t-1) + u(t-1) without noise: an output-error model with F = 1 - 0.8 q^-1.
    /// let u: Vec<f64> = (0..60).map(|t| f64::from((t * t / 3) % 5) - 2.0).collect();
    /// let mut y = vec![0.0; 60];
    /// (1..60).for_each(|t| y[t] = 0.8 * y[t - 1] + u[t - 1]);
    /// let data = [Experiment { name: "a".into(), u, y, init_samples: 0, weights: vec![] }];
    /// let fit = Pem::default().estimate(&LinearModel::oe(&["u"], "y", 1, 1, 1), &data, None, &|| false)?;
    /// assert!((fit.theta[0] - 1.0).abs() < 1e-8 && (fit.theta[1] + 0.8).abs() < 1e-8);
    /// # Ok::<(), dynocal_ident::estimate::EstimateError>(())
    /// ```
    ///
    /// # Errors
    /// [`EstimateError`]: orders or records that do not fit, too few samples, a start of the wrong length, overflow.
    pub fn estimate(
        &self,
        model: &LinearModel,
        data: &[Experiment],
        start: Option<&[f64]>,
        interrupt: &dyn Fn() -> bool,
    ) -> Result<Fit, EstimateError> {
        Ok(self.estimate_missing(model, data, start, interrupt)?.0)
    }

    /// The same with the missing samples (NaN) as the fit reconstructs them.
    ///
    /// # Errors
    /// As of [`Pem::estimate`].
    pub fn estimate_missing(
        &self,
        model: &LinearModel,
        data: &[Experiment],
        start: Option<&[f64]>,
        interrupt: &dyn Fn() -> bool,
    ) -> Result<(Fit, Vec<Recovered>), EstimateError> {
        self.search_starts(model, data, start.map_or(Starts::Competing(None), Starts::Given), interrupt)
    }

    fn search_starts(
        &self,
        model: &LinearModel,
        data: &[Experiment],
        start: Starts,
        interrupt: &dyn Fn() -> bool,
    ) -> Result<(Fit, Vec<Recovered>), EstimateError> {
        model.check()?;
        let p = model.n_params();
        let mut problem = PredictionError::new(model, data, self.initial)?;
        if let Starts::Competing(Some(theta)) | Starts::Given(theta) = start
            && theta.len() != p
        {
            return Err(EstimateError::Start { found: theta.len(), expected: p });
        }
        // A start is a guess: when it is worse than no model at all, no model is the better one.
        let nothing = vec![0.0; p];
        let own = |problem: &PredictionError| -> Result<Vec<Vec<f64>>, EstimateError> {
            let mut starts = own_starts(problem, model)?;
            starts.push(nothing.clone());
            Ok(starts)
        };
        let groups = match start {
            Starts::Given(theta) => vec![vec![theta.to_vec(), nothing.clone()]],
            Starts::Competing(None) => vec![own(&problem)?],
            // The better start need not lead to the better end.
            Starts::Competing(Some(theta)) => vec![vec![theta.to_vec()], own(&problem)?],
        };
        let given = matches!(start, Starts::Given(_));
        let found = self.search(&mut problem, model, groups, given, interrupt);
        let fit = report(&mut problem, model, data, found)?;
        let recovered = problem.recovered(&fit);
        Ok((fit, recovered))
    }

    /// The best end from the best start of each group; when that took many steps and was not the caller's own, from further
    /// starts too.
    fn search(
        &self,
        problem: &mut PredictionError,
        model: &LinearModel,
        groups: Vec<Vec<Vec<f64>>>,
        given: bool,
        interrupt: &dyn Fn() -> bool,
    ) -> LmOutcome {
        let options = LmOptions {
            max_evaluations: self.max_evaluations,
            cost_tolerance: self.cost_tolerance,
            ..LmOptions::default()
        };
        let mut r = vec![0.0; problem.rows];
        let mut first: Vec<Vec<f64>> = Vec::new();
        for mut starts in groups {
            let costs: Vec<f64> = starts.iter().map(|theta| problem.cost(theta, &mut r)).collect();
            let best = (0..costs.len()).min_by(|i, j| costs[*i].total_cmp(&costs[*j])).unwrap_or(0);
            first.push(starts.swap_remove(best));
        }
        let mut found: Option<LmOutcome> = None;
        let mut doubtful = false;
        for theta in &first {
            let other = levenberg_marquardt_interruptible(problem, theta, &options, interrupt);
            doubtful |= other.evaluations > further::DOUBTFUL;
            found = Some(better(found, other));
        }
        let Some(mut found) = found else {
            // No group: nothing was asked for.
            return levenberg_marquardt_interruptible(
                problem,
                &vec![0.0; model.n_params()],
                &options,
                interrupt,
            );
        };
        if given || !doubtful {
            return found;
        }
        for theta in further::starts(problem, model, &found.x) {
            if interrupt() {
                break;
            }
            let other = levenberg_marquardt_interruptible(problem, &theta, &options, interrupt);
            found = better(Some(found), other);
        }
        found
    }
}

/// The one with the lower cost, with the evaluations of both.
fn better(found: Option<LmOutcome>, mut other: LmOutcome) -> LmOutcome {
    let Some(mut found) = found else { return other };
    let evaluations = found.evaluations + other.evaluations;
    if other.cost < found.cost {
        std::mem::swap(&mut found, &mut other);
    }
    found.evaluations = evaluations;
    found
}

/// Where the search begins.
#[derive(Clone, Copy)]
enum Starts<'a> {
    /// At the caller's point.
    Given(&'a [f64]),
    /// At the best of least squares and, where there is one, the caller's point.
    Competing(Option<&'a [f64]>),
}

fn own_starts(problem: &PredictionError, model: &LinearModel) -> Result<Vec<Vec<f64>>, EstimateError> {
    let records: Vec<&Experiment> = problem.records.iter().map(|r| r.e.as_ref()).collect();
    start::least_squares_starts(model, &records).map_err(numeric)
}

fn numeric(source: dynocal_numerics::linalg::LinalgError) -> EstimateError {
    EstimateError::Numeric { estimator: "pem", source }
}

fn report(
    problem: &mut PredictionError,
    model: &LinearModel,
    data: &[Experiment],
    found: LmOutcome,
) -> Result<Fit, EstimateError> {
    let p = model.n_params();
    let (mut r, mut jac) = (vec![0.0; problem.rows], vec![0.0; problem.rows * p]);
    problem.residual_jacobian(&found.x, &mut r, &mut jac);
    // The factor of the likelihood belongs to the search, not to the errors.
    let gain = problem.likelihood_scale();
    r.iter_mut().chain(&mut jac).for_each(|v| *v /= gain);
    let unstable = model.unstable_parts(&found.x).into_iter().map(|part| {
        format!(
            "{part} has a root on or outside the unit circle: there are no standard errors there; try a lower order"
        )
    });
    let warnings: Vec<String> = unstable.collect();
    let known = warnings.is_empty();
    let found = Found {
        estimator: "pem",
        minimised: Minimised::OneStep,
        theta: found.x,
        names: model.param_names(),
        status: found.status,
        evaluations: found.evaluations,
        history: found.history,
        warnings,
    };
    let samples = problem.samples;
    let mut fit = Fit::from_stored(found, &r, &jac, data, samples)?;
    // States and missing inputs were fitted too.
    let free = samples.saturating_sub(fit.rank) as f64;
    let factor = free / (free - problem.nuisance_parameters() as f64).max(1.0);
    fit.noise_variance *= factor;
    fit.covariance.iter_mut().for_each(|v| *v *= factor);
    fit.std_errors.iter_mut().for_each(|v| *v *= factor.sqrt());
    if !known {
        // Sensitivities that grow without bound make every parameter look certain.
        fit.std_errors.fill(f64::NAN);
    }
    Ok(fit)
}
