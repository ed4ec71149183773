//! Simulation-error estimation.
//!
//! ```text
//! theta = argmin sum_t w(t) rho(y(t) - yhat(t; theta)),   yhat the free run, rho the square or Huber's cost
//! ```
//!
//! (thesis section 5.2) by Levenberg-Marquardt with the exact recursive sensitivities dyhat/dtheta, or by another search
//! of [`super::search`]. Each free run starts from the measured outputs before its first scored sample. The start is the
//! least-squares estimate; when its free run is useless, the output terms are shrunk until one is found that is not.

use dynocal_numerics::lm::{LeastSquares, LmOutcome};
use dynocal_numerics::rng::Rng64;
use dynocal_numerics::status::Status;
use serde::Deserialize;

use super::cost::{Cost, CostKind, HUBER_THRESHOLD, fit_scale, outlier_note};
use super::covariance::CovarianceChoice;
use super::search::{Limits, SearchMethod, search};
use super::simulation::free_run_samples;
use super::{EstimateError, Estimator, Fit};
use crate::experiment::Experiment;
use crate::model::Model;

pub(super) use super::simulation::{SimulationError, further_start, least_squares_start};

/// Options of simulation-error estimation.
#[derive(Clone, Copy, Debug, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Sem {
    /// Most cost evaluations per start; 0 for what is usual for the search.
    pub max_evaluations: usize,
    /// Relative decrease of the cost at which the search has converged.
    pub cost_tolerance: f64,
    /// Further starts, drawn around the first one.
    pub restarts: usize,
    /// Relative standard deviation of the further starts.
    pub spread: f64,
    /// Seed of the further starts.
    pub seed: u64,
    /// Ridge weight as in [`super::ols::Ols`]: parameters count in units of their regressor's rms. A little of it keeps
    /// models with many terms from cancelling large contributions against each other.
    pub ridge: f64,
    /// Search method.
    pub search: SearchMethod,
    /// Cost of an error.
    pub cost: CostKind,
    /// Threshold of Huber's cost in robust standard deviations of the errors.
    pub threshold: f64,
    /// What the covariance assumes of the errors.
    pub covariance: CovarianceChoice,
}

impl Default for Sem {
    fn default() -> Self {
        Self {
            max_evaluations: 0,
            cost_tolerance: 1e-12,
            restarts: 0,
            spread: 0.1,
            seed: 0,
            ridge: 0.0,
            search: SearchMethod::default(),
            cost: CostKind::Squared,
            threshold: HUBER_THRESHOLD,
            covariance: CovarianceChoice::Auto,
        }
    }
}

impl Estimator for Sem {
    fn estimate(
        &self,
        model: &dyn Model,
        data: &[Experiment],
        start: Option<&[f64]>,
        interrupt: &dyn Fn() -> bool,
    ) -> Result<Fit, EstimateError> {
        let samples = free_run_samples(model, data)?;
        let mut problem = SimulationError::new(model, data, self.ridge, samples);
        let mut warnings = Vec::new();
        let given = start.is_some() || model.random_start(&mut Rng64::stream(self.seed, 0)).is_some();
        let start = match start {
            Some(theta) if theta.len() != model.n_params() => {
                return Err(EstimateError::Start { found: theta.len(), expected: model.n_params() });
            }
            Some(theta) => theta.to_vec(),
            None => match model.random_start(&mut Rng64::stream(self.seed, 0)) {
                Some(theta) => theta,
                None => least_squares_start(model, data, samples, self.ridge, &mut problem, &mut warnings)?,
            },
        };
        // A least-squares start has been looked at.
        if given && !problem.cost(&start).is_finite() {
            return Err(problem.unstable(&start));
        }
        if self.cost == CostKind::Squared {
            let best = self.search(&mut problem, model, &start, interrupt);
            return problem.report_as(best, samples, warnings, self.covariance, Cost::SQUARED);
        }
        let rows = problem.rows;
        // Further starts serve the first scale only: the later ones set out from a minimum.
        let mut first = true;
        let (best, cost) = fit_scale(&mut problem, rows, self.threshold, &start, |costed, x| {
            let restarts = if std::mem::take(&mut first) { self.restarts } else { 0 };
            Self { restarts, ..*self }.search(costed, model, x, interrupt)
        });
        warnings.extend(outlier_note(cost, &problem.errors(&best.x)));
        problem.report_as(best, samples, warnings, self.covariance, cost)
    }
}

impl Sem {
    /// The best of all starts.
    fn search(
        &self,
        problem: &mut dyn LeastSquares,
        model: &dyn Model,
        start: &[f64],
        interrupt: &dyn Fn() -> bool,
    ) -> LmOutcome {
        let limits = Limits { evaluations: self.max_evaluations, cost_tolerance: self.cost_tolerance };
        let mut best = search(self.search, problem, start, limits, interrupt);
        for i in 0..self.restarts {
            if best.status == Status::Interrupted {
                break;
            }
            let mut rng = Rng64::stream(self.seed, 1 + i as u64);
            let x0 = further_start(model, start, self.spread, &mut rng);
            let other = search(self.search, problem, &x0, limits, interrupt);
            let evaluations = best.evaluations + other.evaluations;
            // A diverged start has infinite cost and never wins.
            if other.cost < best.cost {
                best = other;
            }
            best.evaluations = evaluations;
        }
        best
    }
}
