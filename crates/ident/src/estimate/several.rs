//! Several outputs at once: a set of models that share their data and, through a weighting, their errors.
//!
//! ```text
//! theta = argmin sum_t e(t)' W e(t)         W given
//! theta = argmin log det S,  S = 1/n sum_t e(t) e(t)'      (maximum likelihood of Gaussian errors of unknown covariance)
//! ```
//!
//! with e(t) the free-run errors of all models. The determinant is made small by searches with W = S^-1 of the last one,
//! each of which lowers it. With a diagonal W the models do not know of each other and are those of single fits; where
//! errors of different outputs hang together, the others' errors say something of this one's and the fits gain.
//!
//! Reference: A. Zellner, J. Am. Stat. Assoc. 57 (1962), 348-368; L. Ljung, System Identification (1999), section 7.2;
//! G. A. F. Seber, C. J. Wild, Nonlinear Regression (1989), section 11.2.

use dynocal_numerics::linalg::{GramRows, cholesky, invert_upper, pivoted_from_gram, pivoted_r};
use dynocal_numerics::lm::{LeastSquares, LmOptions, levenberg_marquardt_interruptible};
use dynocal_numerics::status::Status;

use super::covariance::inverse;
use super::sem::{Sem, SimulationError};
use super::{EstimateError, Estimator, Fit};
use crate::data::DataError;
use crate::experiment::Experiment;
use crate::model::Model;

/// Most searches with a new weighting.
const MOST_ROUNDS: usize = 50;
/// Decrease of log det S at which they end.
const ROUND_TOLERANCE: f64 = 1e-10;

/// How the errors of the outputs are weighed.
#[derive(Clone, Debug, Default, PartialEq)]
pub enum Weighting {
    /// Determinant of the errors' covariance.
    #[default]
    Determinant,
    /// A symmetric positive definite matrix (q x q, row-major) in units of one over the outputs' product.
    Matrix(Vec<f64>),
}

/// The joint estimate of q models.
#[derive(Clone, Debug)]
pub struct SeveralFit {
    /// One fit per model; covariances are the blocks of the joint one.
    pub fits: Vec<Fit>,
    /// Covariance of all parameters, those of the first model first (P x P, row-major).
    pub covariance: Vec<f64>,
    /// Covariance S of the errors (q x q, row-major).
    pub error_covariance: Vec<f64>,
    /// Weighting of the last search (q x q, row-major).
    pub weighting: Vec<f64>,
    /// log det S after the single fits and after each search.
    pub log_det: Vec<f64>,
    /// How the last search ended.
    pub status: Status,
}

/// Estimates `models` together; `data` holds the records of each, of equal lengths. The single fits that `sem` gives are
/// the start (their cost, search and restarts are its own).
///
/// # Errors
/// [`EstimateError`]: as of [`Sem`], records that differ in length, a weighting that is no positive definite matrix.
pub fn estimate_several(
    models: &[&dyn Model],
    data: &[&[Experiment]],
    weighting: &Weighting,
    sem: &Sem,
    interrupt: &dyn Fn() -> bool,
) -> Result<SeveralFit, EstimateError> {
    check_shapes(models, data)?;
    let q = models.len();
    let mut fits = Vec::with_capacity(q);
    for (model, data) in models.iter().zip(data) {
        fits.push(sem.estimate(*model, data, None, interrupt)?);
    }
    let mut x: Vec<f64> = fits.iter().flat_map(|f| f.theta.iter().copied()).collect();
    let mut problem = Joint::new(models, data);
    let options = LmOptions { cost_tolerance: sem.cost_tolerance, ..LmOptions::default() };
    let mut s = problem.error_covariance(&x);
    let mut log_det = vec![log_determinant(&s, q)?];
    let mut status = Status::Converged;
    for _ in 0..MOST_ROUNDS {
        problem.root = match weighting {
            Weighting::Determinant => root_of_inverse(&s, q)?,
            Weighting::Matrix(w) => root(w, q)?,
        };
        let found = levenberg_marquardt_interruptible(&mut problem, &x, &options, interrupt);
        (x, status) = (found.x, found.status);
        s = problem.error_covariance(&x);
        log_det.push(log_determinant(&s, q)?);
        let gain = log_det[log_det.len() - 2] - log_det[log_det.len() - 1];
        let settled = matches!(weighting, Weighting::Matrix(_)) || gain < ROUND_TOLERANCE;
        if settled || status == Status::Interrupted {
            break;
        }
    }
    let covariance = problem.covariance(&x, &s)?;
    problem.split(&mut fits, &x, &covariance, &s, status);
    let weighting = problem.weighting();
    Ok(SeveralFit { fits, covariance, error_covariance: s, weighting, log_det, status })
}

/// Every model has as many records as the first, of the same lengths.
fn check_shapes(models: &[&dyn Model], data: &[&[Experiment]]) -> Result<(), EstimateError> {
    for (i, records) in data.iter().enumerate() {
        for (k, first) in data[0].iter().enumerate() {
            let found = records.get(k).map_or(0, Experiment::len);
            if found != first.len() {
                let channel = format!("output of model {}", i + 1);
                let record = first.name.clone();
                return Err(DataError::Length { record, channel, found, expected: first.len() }.into());
            }
        }
    }
    if models.is_empty() || models.len() != data.len() {
        let (record, why) = ("several outputs".into(), "records for each model".into());
        return Err(
            DataError::TooShort { record, found: data.len(), expected: models.len().max(1), why }.into()
        );
    }
    Ok(())
}

/// Errors of all models, times the root of the weighting.
struct Joint<'a> {
    parts: Vec<SimulationError<'a>>,
    /// First parameter of each model, and their number.
    places: Vec<usize>,
    rows: usize,
    /// Rows before the first sample that all models score are zero.
    scored: Vec<bool>,
    samples: usize,
    /// Upper triangular L with L'L = W (q x q).
    root: Vec<f64>,
    errors: Vec<Vec<f64>>,
    jacobians: Vec<Vec<f64>>,
}

impl<'a> Joint<'a> {
    fn new(models: &[&'a dyn Model], data: &[&'a [Experiment]]) -> Self {
        let parts: Vec<_> =
            models.iter().zip(data).map(|(m, d)| SimulationError::new(*m, d, 0.0, 0)).collect();
        let mut places = vec![0];
        models.iter().for_each(|m| places.push(places[places.len() - 1] + m.n_params()));
        let rows = parts[0].rows;
        let mut scored = Vec::with_capacity(rows);
        for (k, e) in data[0].iter().enumerate() {
            let first = models.iter().zip(data).map(|(m, d)| d[k].first(*m)).max().unwrap_or(0);
            scored.extend((0..e.len()).map(|t| t >= first));
        }
        let samples = scored.iter().filter(|s| **s).count();
        let errors = vec![vec![0.0; rows]; parts.len()];
        let jacobians = models.iter().map(|m| vec![0.0; rows * m.n_params()]).collect();
        Self { parts, places, rows, scored, samples, root: Vec::new(), errors, jacobians }
    }

    fn outputs(&self) -> usize {
        self.parts.len()
    }

    fn run(&mut self, x: &[f64], jacobian: bool) -> bool {
        for (i, part) in self.parts.iter_mut().enumerate() {
            let theta = &x[self.places[i]..self.places[i + 1]];
            let finite = if jacobian {
                part.residual_jacobian(theta, &mut self.errors[i], &mut self.jacobians[i])
            } else {
                part.residual(theta, &mut self.errors[i])
            };
            if !finite {
                return false;
            }
        }
        true
    }

    /// S (q x q).
    fn error_covariance(&mut self, x: &[f64]) -> Vec<f64> {
        let q = self.outputs();
        self.run(x, false);
        let mut s = vec![0.0; q * q];
        for t in (0..self.rows).filter(|t| self.scored[*t]) {
            for i in 0..q {
                for j in 0..q {
                    s[i * q + j] += self.errors[i][t] * self.errors[j][t] / self.samples as f64;
                }
            }
        }
        s
    }

    fn fill_errors(&self, r: &mut [f64]) {
        let q = self.outputs();
        for (t, r) in r.chunks_exact_mut(q).enumerate() {
            for (i, r) in r.iter_mut().enumerate() {
                let sum: f64 = (i..q).map(|j| self.root[i * q + j] * self.errors[j][t]).sum();
                *r = if self.scored[t] { sum } else { 0.0 };
            }
        }
    }

    fn weighting(&self) -> Vec<f64> {
        let q = self.outputs();
        let entry = |i: usize, j: usize| (0..q).map(|k| self.root[k * q + i] * self.root[k * q + j]).sum();
        (0..q * q).map(|ij| entry(ij / q, ij % q)).collect()
    }

    /// `B M B` with B the inverse of J'WJ summed over time and M the same of J'W S W J: whatever the weighting.
    fn covariance(&mut self, x: &[f64], s: &[f64]) -> Result<Vec<f64>, EstimateError> {
        let (q, p) = (self.outputs(), x.len());
        let (mut r, mut jac) = (vec![0.0; self.rows * q], vec![0.0; self.rows * q * p]);
        self.residual_jacobian(x, &mut r, &mut jac);
        let mut gram = GramRows::new(p);
        gram.push(&jac).map_err(numeric)?;
        let factor = match pivoted_from_gram(&gram.gram, p) {
            Some(factor) => factor,
            None => pivoted_r(&jac, self.rows * q, p, 0.0).map_err(numeric)?,
        };
        let bread = inverse(&factor, p).map_err(numeric)?;
        // Rows of one sample turn from J L' to R L J with R'R = L S L', whose squares sum to M.
        let free = self.samples as f64 / (self.samples as f64 - p as f64 / q as f64).max(1.0);
        let rotated = product(&product(&self.root, s, q), &transposed(&self.root, q), q);
        let spread = root(&rotated, q)?;
        for rows in jac.chunks_exact_mut(q * p) {
            let old = rows.to_vec();
            for i in 0..q {
                for k in 0..p {
                    rows[i * p + k] = (i..q).map(|j| spread[i * q + j] * old[j * p + k]).sum();
                }
            }
        }
        let mut meat = GramRows::new(p);
        meat.push(&jac).map_err(numeric)?;
        let full: Vec<f64> = (0..p * p)
            .map(|ij| {
                let (i, j) = (ij / p, ij % p);
                free * meat.gram[i.min(j) * p + i.max(j)]
            })
            .collect();
        Ok(product(&product(&bread, &full, p), &bread, p))
    }

    /// The joint parameters in the single fits.
    fn split(&self, fits: &mut [Fit], x: &[f64], covariance: &[f64], s: &[f64], status: Status) {
        let (q, p) = (self.outputs(), x.len());
        for (i, fit) in fits.iter_mut().enumerate() {
            let (from, to) = (self.places[i], self.places[i + 1]);
            fit.theta.copy_from_slice(&x[from..to]);
            fit.covariance = (from..to).flat_map(|k| covariance[k * p + from..k * p + to].to_vec()).collect();
            fit.std_errors = (from..to).map(|k| covariance[k * p + k].sqrt()).collect();
            fit.mse = s[i * q + i];
            fit.noise_variance = fit.mse * self.samples as f64 / (self.samples - (to - from)).max(1) as f64;
            fit.samples = self.samples;
            fit.status = status;
        }
    }
}

impl LeastSquares for Joint<'_> {
    fn n(&self) -> usize {
        self.places[self.outputs()]
    }

    fn residuals(&self) -> usize {
        self.rows * self.outputs()
    }

    fn residual(&mut self, x: &[f64], r: &mut [f64]) -> bool {
        let finite = self.run(x, false);
        self.fill_errors(r);
        finite
    }

    fn residual_jacobian(&mut self, x: &[f64], r: &mut [f64], jac: &mut [f64]) -> bool {
        let (q, p) = (self.outputs(), self.n());
        let finite = self.run(x, true);
        self.fill_errors(r);
        jac.fill(0.0);
        for (t, rows) in jac.chunks_exact_mut(q * p).enumerate().filter(|(t, _)| self.scored[*t]) {
            for (i, row) in rows.chunks_exact_mut(p).enumerate() {
                for j in i..q {
                    let (own, width) = (&self.jacobians[j], self.places[j + 1] - self.places[j]);
                    let gain = self.root[i * q + j];
                    for (x, v) in row[self.places[j]..].iter_mut().zip(&own[t * width..(t + 1) * width]) {
                        *x = gain * v;
                    }
                }
            }
        }
        finite
    }
}

fn numeric(source: dynocal_numerics::linalg::LinalgError) -> EstimateError {
    EstimateError::Numeric { estimator: "several outputs", source }
}

/// Upper triangular L with L'L = w.
fn root(w: &[f64], q: usize) -> Result<Vec<f64>, EstimateError> {
    let mut l = w.to_vec();
    cholesky(&mut l, q).map_err(numeric)?;
    (0..q).for_each(|i| l[i * q..i * q + i].fill(0.0));
    Ok(l)
}

/// The same of the inverse of s.
fn root_of_inverse(s: &[f64], q: usize) -> Result<Vec<f64>, EstimateError> {
    let l = root(s, q)?;
    let mut inverse = vec![0.0; q * q];
    invert_upper(&l, q, &mut inverse).map_err(numeric)?;
    root(&product(&inverse, &transposed(&inverse, q), q), q)
}

fn log_determinant(s: &[f64], q: usize) -> Result<f64, EstimateError> {
    let l = root(s, q)?;
    Ok((0..q).map(|i| 2.0 * l[i * q + i].ln()).sum())
}

fn product(a: &[f64], b: &[f64], n: usize) -> Vec<f64> {
    let entry = |i: usize, j: usize| (0..n).map(|k| a[i * n + k] * b[k * n + j]).sum();
    (0..n * n).map(|ij| entry(ij / n, ij % n)).collect()
}

fn transposed(a: &[f64], n: usize) -> Vec<f64> {
    (0..n * n).map(|ij| a[(ij % n) * n + ij / n]).collect()
}
