//! The free-run errors of all experiments as a least-squares problem, and where its searches start.

use dynocal_numerics::linalg::{GramRows, pivoted_from_gram, solve_upper, solve_upper_transposed};
use dynocal_numerics::lm::{LeastSquares, LmOutcome};
use dynocal_numerics::rng::Rng64;
use dynocal_numerics::status::Status;

use super::cost::Cost;
use super::covariance::{CovarianceChoice, Evidence, Rows, TakeRows};
use super::fit::Found;
use super::noise::noise_warning;
use super::ols::{regression, solve};
use super::stability::stability_warning;
use super::{EstimateError, Fit, Minimised, names, short_name};
use crate::data::DataError;
use crate::experiment::Experiment;
use crate::model::usable_samples;
use crate::model::{Model, Run};

/// Random parameters where the model has such, else `start` with a relative spread.
pub(super) fn further_start(model: &dyn Model, start: &[f64], spread: f64, rng: &mut Rng64) -> Vec<f64> {
    model
        .drawn()
        .map(|d| d.random_start(rng))
        .unwrap_or_else(|| start.iter().map(|v| v * (1.0 + spread * rng.normal())).collect())
}

/// The residuals of all experiments, one row per sample; rows before the first scored sample are zero.
pub(super) struct SimulationError<'a> {
    pub(super) model: &'a dyn Model,
    data: &'a [Experiment],
    pub(super) rows: usize,
    y: Vec<f64>,
    /// Entries of the Jacobian above which it is not stored whole.
    stored: usize,
    /// Weight of each parameter; empty without ridge.
    pub(super) ridge: Vec<f64>,
}

impl<'a> SimulationError<'a> {
    pub(super) fn new(model: &'a dyn Model, data: &'a [Experiment], ridge: f64, samples: usize) -> Self {
        let longest = data.iter().map(Experiment::len).max().unwrap_or(0);
        let rows = data.iter().map(Experiment::len).sum();
        let ridge = if ridge > 0.0 { ridge_weights(model, data, ridge, samples) } else { Vec::new() };
        Self { model, data, rows, y: vec![0.0; longest], stored: STORED, ridge }
    }

    /// Free-run errors, zero where not scored; all zero when a free run diverges.
    pub(super) fn errors(&mut self, theta: &[f64]) -> Vec<f64> {
        let mut r = vec![0.0; self.residuals()];
        if !self.residual(theta, &mut r) {
            r.fill(0.0);
        }
        r.truncate(self.rows);
        r
    }

    /// Sum of squares; infinite when a free run diverges.
    pub(super) fn cost(&mut self, theta: &[f64]) -> f64 {
        let mut r = vec![0.0; self.residuals()];
        let cost: f64 =
            if self.residual(theta, &mut r) { r.iter().map(|v| v * v).sum() } else { f64::INFINITY };
        if cost.is_finite() { cost } else { f64::INFINITY }
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

    /// The fit of a search that ended in `found`.
    pub(super) fn report_as(
        &mut self,
        found: LmOutcome,
        samples: usize,
        warnings: Vec<String>,
        choice: CovarianceChoice,
        cost: Cost,
    ) -> Result<Fit, EstimateError> {
        let theta = found.x.clone();
        let found = Found {
            estimator: "sem",
            minimised: Minimised::FreeRun,
            theta: found.x,
            names: names(self.model),
            status: found.status,
            evaluations: found.evaluations,
            history: found.history,
            warnings,
        };
        let (model, data) = (self.model, self.data);
        let mut evidence = Rerun { problem: self, theta: &theta };
        let mut fit = Fit::new(found, &mut evidence, samples, choice, cost)?;
        let own = self.cost(&theta);
        if own > spread(model, data) {
            // Sensitivities of a run that goes nowhere near the data say nothing of the data.
            fit.warnings.retain(|w| !w.starts_with("rank "));
            fit.warnings.push(format!(
                "the free run of the estimate is worse than the mean of the output (RMSE {:.4e}): no useful minimum was found",
                fit.mse.sqrt()
            ));
            return Ok(fit);
        }
        let least_squares =
            if model.is_linear_in_params() { normal_equations(model, data, 0.0) } else { None };
        let rival = least_squares.map(|theta| self.cost(&theta) / own.max(f64::MIN_POSITIVE));
        fit.notes.extend(noise_warning(model, &fit.theta, data, fit.minimised, &fit.residuals, rival));
        fit.warnings.extend(stability_warning(self.model, &fit.theta, self.data));
        Ok(fit)
    }
}

/// Entries of a Jacobian from which on it is not stored whole (128 MB).
const STORED: usize = 16_000_000;

/// Errors and Jacobian of a fit at its parameters, run again whenever they are asked for.
struct Rerun<'b, 'a> {
    problem: &'b mut SimulationError<'a>,
    theta: &'b [f64],
}

impl Evidence for Rerun<'_, '_> {
    fn params(&self) -> usize {
        self.theta.len()
    }

    fn exogenous(&self) -> bool {
        true
    }

    fn rows(&self) -> Rows {
        Rows::Sensitivities
    }

    fn penalties(&self) -> &[f64] {
        &self.problem.ridge
    }

    fn visit(&mut self, take: &mut TakeRows<'_>) {
        self.problem.blocks(self.theta, take);
    }
}

impl SimulationError<'_> {
    /// Weighted errors and sensitivities of the scored samples, `take(record, errors, rows)`.
    fn blocks(&mut self, x: &[f64], take: &mut TakeRows<'_>) -> bool {
        let p = self.model.n_params();
        let (mut r, mut rows) = (Vec::with_capacity(2 * ROWS), Vec::with_capacity(2 * ROWS * p));
        for (record, e) in self.data.iter().enumerate() {
            let (run, y) = (e.run(self.model), &mut self.y[..e.len()]);
            let mut each = |from: usize, y: &[f64], s: &[f64]| {
                if e.weights.is_empty() && !e.y[from..from + y.len()].iter().any(|v| v.is_nan()) {
                    r.clear();
                    r.extend(y.iter().zip(&e.y[from..]).map(|(a, b)| a - b));
                    return take(record, &r, s);
                }
                r.clear();
                rows.clear();
                for (i, row) in s.chunks_exact(p.max(1)).enumerate() {
                    let t = from + i;
                    // A missing output is not scored.
                    let root = if e.y[t].is_nan() { 0.0 } else { e.weight(t).sqrt() };
                    r.push(if root == 0.0 { 0.0 } else { root * (y[i] - e.y[t]) });
                    rows.extend(row.iter().map(|v| root * v));
                }
                take(record, &r, &rows);
            };
            if self.model.sensitivity_blocks(x, &run, ROWS, y, &mut each) != Status::Converged {
                return false;
            }
        }
        true
    }
}

impl LeastSquares for SimulationError<'_> {
    fn n(&self) -> usize {
        self.model.n_params()
    }

    fn by_blocks(&self) -> bool {
        self.rows * self.model.n_params() > self.stored
    }

    fn jacobian_blocks(&mut self, x: &[f64], take: &mut dyn FnMut(&[f64], &[f64])) -> bool {
        let finite = self.blocks(x, &mut |_, r, rows| take(r, rows));
        let p = self.ridge.len();
        let (mut r, mut rows) = (vec![0.0; p], vec![0.0; p * p]);
        for (k, w) in self.ridge.iter().enumerate() {
            r[k] = w * x[k];
            rows[k * p + k] = *w;
        }
        if p > 0 {
            take(&r, &rows);
        }
        finite
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
            for t in (run.start..e.len()).filter(|t| e.y[*t].is_nan()) {
                s[t * p..(t + 1) * p].fill(0.0);
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

/// Number of scored samples of a free run: all of [`usable_samples`] whose output is not missing (NaN).
///
/// # Errors
/// As of [`usable_samples`]; [`DataError::NonFinite`] for an input that is not a number or an output that a free run starts
/// from: those must be filled, the record be cut there, or the model be one that takes missing samples as unknowns.
pub(super) fn free_run_samples(model: &dyn Model, data: &[Experiment]) -> Result<usize, DataError> {
    let mut samples = usable_samples(model, data)?;
    for e in data {
        let m = model.n_inputs().max(1);
        let fault =
            |channel, sample, found| DataError::NonFinite { record: e.name.clone(), channel, sample, found };
        if let Some(k) = e.u.iter().position(|v| !v.is_finite()) {
            return Err(fault(format!("input {}", k % m + 1), k / m, e.u[k]));
        }
        let first = e.first(model);
        let infinite = |t: &usize| {
            e.y[*t].is_infinite() || (e.y[*t].is_nan() && *t < first && *t + model.output_lag() >= first)
        };
        if let Some(t) = (0..e.len()).find(infinite) {
            return Err(fault("output".into(), t, e.y[t]));
        }
        samples -= e.y[first..].iter().filter(|v| v.is_nan()).count();
    }
    let p = model.n_params();
    if samples < p {
        let record = data.iter().map(|e| e.name.as_str()).collect::<Vec<_>>().join(", ");
        return Err(DataError::TooShort {
            record,
            found: samples,
            expected: p,
            why: format!("{p} parameters"),
        });
    }
    Ok(samples)
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
        // A missing output is not scored.
        r[t] = if e.y[t].is_nan() { 0.0 } else { y[t] - e.y[t] };
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
    if !model.is_linear_in_params() {
        return Err(EstimateError::NotLinear { estimator: "ols", params: model.n_params() });
    }
    let theta = match normal_equations(model, data, ridge) {
        Some(theta) => theta,
        None => {
            let (phi, y) = regression(model, data, samples);
            solve(&phi, &y, model.n_params(), ridge)?.x
        }
    };
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
    let (mut total, mut sum) = (0.0, 0.0);
    let scored = |add: &mut dyn FnMut(f64, f64)| {
        for e in data {
            for t in e.first(model)..e.len() {
                if !e.y[t].is_nan() {
                    add(e.y[t], e.weight(t));
                }
            }
        }
    };
    scored(&mut |y, w| {
        total += w;
        sum += w * y;
    });
    let (mean, mut square) = (sum / total, 0.0);
    scored(&mut |y, w| square += w * (y - mean).powi(2));
    square
}

/// Rows of regressors that are gathered at a time.
const ROWS: usize = 512;

/// Least squares from normal equations, block by block: a start needs few digits. `None` where they keep too few.
fn normal_equations(model: &dyn Model, data: &[Experiment], ridge: f64) -> Option<Vec<f64>> {
    let (m, p, lag) = (model.n_inputs(), model.n_params(), model.max_lag());
    let w = p + 1;
    let theta = vec![0.0; p];
    let (mut regressors, mut rows) = (vec![0.0; (ROWS + lag) * p], Vec::with_capacity(ROWS * w));
    let mut gram = GramRows::new(w);
    for e in data {
        for from in (e.first(model)..e.len()).step_by(ROWS) {
            let to = (from + ROWS).min(e.len());
            let run = Run { u: &e.u[(from - lag) * m..to * m], y: &e.y[from - lag..to], start: lag };
            let regressors = &mut regressors[..run.len() * p];
            model.one_step_jacobian(&theta, &run, regressors);
            rows.clear();
            for (t, phi) in (from..to).zip(regressors[lag * p..].chunks_exact(p)) {
                let root = e.weight(t).sqrt();
                if e.y[t].is_nan() || phi.iter().any(|v| v.is_nan()) {
                    continue;
                }
                rows.extend(phi.iter().map(|v| root * v));
                rows.push(root * e.y[t]);
            }
            gram.push(&rows).ok()?;
        }
    }
    let mut normal = vec![0.0; p * p];
    for i in 0..p {
        normal[i * p + i..(i + 1) * p].copy_from_slice(&gram.gram[i * w + i..i * w + p]);
        normal[i * p + i] *= 1.0 + ridge;
    }
    let factor = pivoted_from_gram(&normal, p)?;
    let mut z: Vec<f64> = factor.order.iter().map(|k| gram.gram[k * w + p] / factor.scale[*k]).collect();
    solve_upper_transposed(&factor.r, p, &mut z).ok()?;
    solve_upper(&factor.r, p, &mut z).ok()?;
    let mut theta = vec![0.0; p];
    factor.order.iter().zip(&z).for_each(|(k, z)| theta[*k] = z / factor.scale[*k]);
    theta.iter().all(|v| v.is_finite()).then_some(theta)
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
