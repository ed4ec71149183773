//! Simulation-error estimation.
//!
//! ```text
//! theta = argmin sum_t w(t) (y(t) - yhat(t; theta))^2,   yhat the free run
//! ```
//!
//! (thesis section 5.2) by Levenberg-Marquardt with the exact recursive sensitivities dyhat/dtheta. Each free run
//! starts from the measured outputs before its first scored sample. The start is the least-squares estimate; when
//! its free run is useless, the output terms are shrunk until one is found that is not.

use dynocal_numerics::linalg::pivoted_r;
use dynocal_numerics::lm::{LeastSquares, LmOptions, LmOutcome, levenberg_marquardt_interruptible};
use dynocal_numerics::rng::Rng64;
use dynocal_numerics::status::Status;
use serde::Deserialize;

use super::covariance::{covariance, rank_warning};
use super::ols::{Ols, regression, solve};
use super::{EstimateError, Estimator, Fit, Minimised, names, short_name};
use crate::experiment::{Experiment, usable_samples};
use crate::model::Model;

/// Options of simulation-error estimation.
#[derive(Clone, Copy, Debug, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Sem {
    /// Most cost evaluations per start.
    pub max_evaluations: usize,
    /// Relative decrease of the cost at which the search has converged.
    pub cost_tolerance: f64,
    /// Further starts, drawn around the first one.
    pub restarts: usize,
    /// Relative standard deviation of the further starts.
    pub spread: f64,
    /// Seed of the further starts.
    pub seed: u64,
    /// Ridge weight as in [`Ols`]: parameters count in units of their regressor's rms. A little of it keeps
    /// models with many terms from cancelling large contributions against each other.
    pub ridge: f64,
}

impl Default for Sem {
    fn default() -> Self {
        Self { max_evaluations: 200, cost_tolerance: 1e-12, restarts: 0, spread: 0.1, seed: 0, ridge: 0.0 }
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
        let samples = usable_samples(model, data)?;
        let mut problem = SimulationError::new(model, data, self.ridge, samples);
        let mut warnings = Vec::new();
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
        if !problem.cost(&start).is_finite() {
            return Err(problem.unstable(&start));
        }
        let best = self.search(&mut problem, &start, interrupt);
        problem.report(best, samples, warnings)
    }
}

impl Sem {
    /// The best of all starts.
    fn search(
        &self,
        problem: &mut SimulationError,
        start: &[f64],
        interrupt: &dyn Fn() -> bool,
    ) -> LmOutcome {
        let options = LmOptions {
            max_evaluations: self.max_evaluations,
            cost_tolerance: self.cost_tolerance,
            ..LmOptions::default()
        };
        let mut best = levenberg_marquardt_interruptible(problem, start, &options, interrupt);
        for i in 0..self.restarts {
            if best.status == Status::Interrupted {
                break;
            }
            let mut rng = Rng64::stream(self.seed, 1 + i as u64);
            let x0 = further_start(problem.model, start, self.spread, &mut rng);
            let other = levenberg_marquardt_interruptible(problem, &x0, &options, interrupt);
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

/// Random parameters where the model has such, else `start` with a relative spread.
pub(super) fn further_start(model: &dyn Model, start: &[f64], spread: f64, rng: &mut Rng64) -> Vec<f64> {
    model
        .random_start(rng)
        .unwrap_or_else(|| start.iter().map(|v| v * (1.0 + spread * rng.normal())).collect())
}

/// The residuals of all experiments, one row per sample; rows before the first scored sample are zero.
pub(super) struct SimulationError<'a> {
    model: &'a dyn Model,
    data: &'a [Experiment],
    rows: usize,
    y: Vec<f64>,
    /// Weight of each parameter; empty without ridge.
    pub(super) ridge: Vec<f64>,
}

impl<'a> SimulationError<'a> {
    pub(super) fn new(model: &'a dyn Model, data: &'a [Experiment], ridge: f64, samples: usize) -> Self {
        let longest = data.iter().map(Experiment::len).max().unwrap_or(0);
        let rows = data.iter().map(Experiment::len).sum();
        let ridge = if ridge > 0.0 { ridge_weights(model, data, ridge, samples) } else { Vec::new() };
        Self { model, data, rows, y: vec![0.0; longest], ridge }
    }

    /// Sum of squares of the free-run errors alone.
    fn error_cost(&self, r: &[f64]) -> f64 {
        r[..self.rows].iter().map(|v| v * v).sum()
    }

    /// Sum of squares; infinite when a free run diverges.
    pub(super) fn cost(&mut self, theta: &[f64]) -> f64 {
        let mut r = vec![0.0; self.residuals()];
        let cost: f64 =
            if self.residual(theta, &mut r) { r.iter().map(|v| v * v).sum() } else { f64::INFINITY };
        if cost.is_finite() { cost } else { f64::INFINITY }
    }

    /// Mean of the squared (weighted) errors over the scored samples; infinite when a free run diverges.
    pub(super) fn mean_square(&mut self, theta: &[f64]) -> f64 {
        let samples: usize = self.data.iter().map(|e| e.len().saturating_sub(e.first(self.model))).sum();
        self.cost(theta) / samples.max(1) as f64
    }

    pub(super) fn unstable(&mut self, theta: &[f64]) -> EstimateError {
        let model = short_name(&names(self.model));
        for e in self.data {
            let y = &mut self.y[..e.len()];
            if self.model.simulate(theta, &e.run(self.model), y) != Status::Converged {
                let sample = y.iter().position(|v| !v.is_finite()).unwrap_or(e.len());
                return EstimateError::Unstable { model, record: e.name.clone(), sample };
            }
        }
        // Finite values whose squares overflow.
        let record = self.data.first().map(|e| e.name.clone()).unwrap_or_default();
        EstimateError::Unstable { model, record, sample: 0 }
    }

    pub(super) fn report(
        &mut self,
        found: LmOutcome,
        samples: usize,
        mut warnings: Vec<String>,
    ) -> Result<Fit, EstimateError> {
        let p = self.model.n_params();
        let rows = self.residuals();
        let (mut r, mut jac) = (vec![0.0; rows], vec![0.0; rows * p]);
        self.residual_jacobian(&found.x, &mut r, &mut jac);
        let cost = self.error_cost(&r);
        let numeric = |source| EstimateError::Numeric { estimator: "sem", source };
        let factor = pivoted_r(&jac, rows, p, 0.0).map_err(numeric)?;
        let noise_variance = cost / (samples - factor.rank).max(1) as f64;
        let (covariance, std_errors) = covariance(&factor, p, noise_variance).map_err(numeric)?;
        let names = names(self.model);
        warnings.extend(rank_warning(&factor, &names));
        if !found.status.is_success() {
            warnings.push(format!(
                "simulation-error search of `{}` ended as {:?} after {} evaluations",
                short_name(&names),
                found.status,
                found.evaluations
            ));
        }
        Ok(Fit {
            estimator: "sem".into(),
            minimised: Minimised::FreeRun,
            theta: found.x,
            names,
            covariance,
            std_errors,
            mse: cost / samples as f64,
            noise_variance,
            samples,
            rank: factor.rank,
            status: found.status,
            evaluations: found.evaluations,
            history: found.history,
            warnings,
        })
    }
}

impl LeastSquares for SimulationError<'_> {
    fn n(&self) -> usize {
        self.model.n_params()
    }

    fn residuals(&self) -> usize {
        self.rows + self.ridge.len()
    }

    fn residual(&mut self, x: &[f64], r: &mut [f64]) -> bool {
        let mut row = 0;
        for e in self.data {
            let (run, y) = (e.run(self.model), &mut self.y[..e.len()]);
            if self.model.simulate(x, &run, y) != Status::Converged {
                return false;
            }
            fill_residuals(e, run.start, y, &mut r[row..row + e.len()]);
            row += e.len();
        }
        self.fill_ridge(x, r);
        true
    }

    fn residual_jacobian(&mut self, x: &[f64], r: &mut [f64], jac: &mut [f64]) -> bool {
        let p = self.model.n_params();
        let mut row = 0;
        for e in self.data {
            let (run, y) = (e.run(self.model), &mut self.y[..e.len()]);
            let s = &mut jac[row * p..(row + e.len()) * p];
            if self.model.sensitivities(x, &run, y, s) != Status::Converged {
                return false;
            }
            fill_residuals(e, run.start, y, &mut r[row..row + e.len()]);
            if !e.weights.is_empty() {
                for (w, s) in e.weights.iter().zip(s.chunks_exact_mut(p)) {
                    s.iter_mut().for_each(|v| *v *= w.sqrt());
                }
            }
            row += e.len();
        }
        self.fill_ridge(x, r);
        jac[self.rows * p..].fill(0.0);
        for (k, w) in self.ridge.iter().enumerate() {
            jac[(self.rows + k) * p + k] = *w;
        }
        true
    }
}

impl SimulationError<'_> {
    fn fill_ridge(&self, x: &[f64], r: &mut [f64]) {
        for ((r, w), v) in r[self.rows..].iter_mut().zip(&self.ridge).zip(x) {
            *r = w * v;
        }
    }
}

/// `sqrt(ridge n) rms(phi_k)` of each parameter.
fn ridge_weights(model: &dyn Model, data: &[Experiment], ridge: f64, samples: usize) -> Vec<f64> {
    let p = model.n_params();
    let (phi, _) = regression(model, data, samples);
    let mut square = vec![0.0; p];
    for row in phi.chunks_exact(p) {
        square.iter_mut().zip(row).for_each(|(s, v)| *s += v * v);
    }
    square.iter().map(|s| (ridge * s).sqrt()).collect()
}

fn fill_residuals(e: &Experiment, start: usize, y: &[f64], r: &mut [f64]) {
    r[..start].fill(0.0);
    for t in start..e.len() {
        r[t] = y[t] - e.y[t];
    }
    for (v, w) in r.iter_mut().zip(&e.weights) {
        *v *= w.sqrt();
    }
}

/// Least squares, repaired when its free run is useless.
pub(super) fn least_squares_start(
    model: &dyn Model,
    data: &[Experiment],
    samples: usize,
    ridge: f64,
    problem: &mut SimulationError,
    warnings: &mut Vec<String>,
) -> Result<Vec<f64>, EstimateError> {
    let theta = Ols { ridge }.estimate(model, data, None, &|| false)?.theta;
    let cost = problem.cost(&theta);
    // Worse than twice the spread about the mean: the linear start misleads more than a shrunk one.
    if cost <= 2.0 * spread(model, data) {
        return Ok(theta);
    }
    let repaired = shrink_output_terms(model, data, samples, &theta, problem)?;
    match repaired {
        Some((better, gain, better_cost)) if better_cost < cost => {
            warnings.push(format!(
                "the free run of the least-squares start {}; the search started from output terms times {gain}",
                if cost.is_finite() { "is worse than the mean" } else { "diverges" },
            ));
            Ok(better)
        }
        _ if cost.is_finite() => Ok(theta),
        _ => Err(problem.unstable(&theta)),
    }
}

/// Weighted sum of squares of the scored outputs about their mean.
pub(super) fn spread(model: &dyn Model, data: &[Experiment]) -> f64 {
    let scored = || data.iter().flat_map(|e| (e.first(model)..e.len()).map(|t| (e.y[t], e.weight(t))));
    let total: f64 = scored().map(|(_, w)| w).sum();
    let mean = scored().map(|(y, w)| w * y).sum::<f64>() / total;
    scored().map(|(y, w)| w * (y - mean).powi(2)).sum()
}

/// Tries `theta` with all output coefficients times a gain below one and the others refitted by least squares;
/// returns the one with the least free-run error, its gain and its cost.
fn shrink_output_terms(
    model: &dyn Model,
    data: &[Experiment],
    samples: usize,
    theta: &[f64],
    problem: &mut SimulationError,
) -> Result<Option<(Vec<f64>, f64, f64)>, EstimateError> {
    let p = theta.len();
    let recursive = output_params(model, data);
    let free: Vec<usize> = (0..p).filter(|k| !recursive[*k]).collect();
    let (phi, y) = regression(model, data, samples);
    let exogenous: Vec<f64> = phi.chunks_exact(p).flat_map(|row| free.iter().map(|&k| row[k])).collect();
    let mut best: Option<(Vec<f64>, f64, f64)> = None;
    for gain in [0.99, 0.97, 0.95, 0.9, 0.8, 0.6, 0.4, 0.2, 0.0] {
        let mut trial: Vec<f64> = (0..p).map(|k| if recursive[k] { gain * theta[k] } else { 0.0 }).collect();
        if !free.is_empty() {
            let rest: Vec<f64> = phi
                .chunks_exact(p)
                .zip(&y)
                .map(|(row, y)| y - row.iter().zip(&trial).map(|(a, b)| a * b).sum::<f64>())
                .collect();
            for (k, v) in free.iter().zip(solve(&exogenous, &rest, free.len(), 0.0)?.x) {
                trial[*k] = v;
            }
        }
        let cost = problem.cost(&trial);
        if cost < best.as_ref().map_or(f64::INFINITY, |b| b.2) {
            best = Some((trial, gain, cost));
        }
    }
    Ok(best)
}

/// Which parameters multiply past outputs: those whose regressor changes with the output.
fn output_params(model: &dyn Model, data: &[Experiment]) -> Vec<bool> {
    let p = model.n_params();
    let mut reads = vec![false; p];
    for e in data {
        let run = e.run(model);
        let moved: Vec<f64> = e.y.iter().map(|v| 2.0 * v + 1.0).collect();
        let (mut a, mut b) = (vec![0.0; e.len() * p], vec![0.0; e.len() * p]);
        let theta = vec![0.0; p];
        model.one_step_jacobian(&theta, &run, &mut a);
        model.one_step_jacobian(&theta, &crate::model::Run { y: &moved, ..run }, &mut b);
        for (i, (x, y)) in a.iter().zip(&b).enumerate() {
            reads[i % p] |= x != y;
        }
    }
    reads
}
