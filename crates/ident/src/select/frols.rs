//! Forward regression orthogonal least squares.
//!
//! ```text
//! g_i = w_i' y / w_i' w_i,    ERR_i = g_i^2 w_i' w_i / y' y,    w_i: candidate i orthogonal to those chosen
//! ```
//!
//! At each step the candidate with the largest error reduction ratio is taken, and all others are made orthogonal
//! to it (modified Gram-Schmidt), over all experiments together. The path holds every step, so that the number of
//! terms can be chosen afterwards.
//!
//! Reference: S. Chen, S. A. Billings, W. Luo, Int. J. Control 50 (1989) 1873-1896.

use dynocal_numerics::linalg::{axpy, dot};
use dynocal_numerics::registry::BuildError;
use serde::{Deserialize, Serialize};

use crate::estimate::EstimateError;
use crate::estimate::ols::regression;
use crate::experiment::{Experiment, usable_samples};
use crate::model::Model;
use crate::model::poly::{PolyNarx, Regressor};

/// A candidate whose part outside the chosen ones is shorter than this (relative to its length) is dependent.
const DEPENDENT: f64 = 1e-7;

/// When to stop taking terms.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Stop {
    /// This many terms.
    Terms(usize),
    /// Least Bayesian information criterion `n ln(mse) + k ln n` among the first `max_terms` terms.
    Bic {
        /// Most terms.
        max_terms: usize,
    },
}

/// One step of the path.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Step {
    /// Place in the pool.
    pub candidate: usize,
    /// Regressor in text form.
    pub regressor: String,
    /// Error reduction ratio.
    pub err: f64,
    /// Sum of the ratios so far.
    pub cumulative: f64,
    /// One-step mean squared error with the terms so far.
    pub mse: f64,
    /// Bayesian information criterion with the terms so far.
    pub bic: f64,
}

/// What was selected.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct Selection {
    /// Chosen structure: the first [`Selection::terms`] steps of the path, in the order of the pool.
    pub model: PolyNarx,
    /// Number of chosen terms.
    pub terms: usize,
    /// All steps that were taken.
    pub path: Vec<Step>,
    /// Size of the pool.
    pub pool: usize,
}

impl Selection {
    /// The structure of the first `terms` steps instead.
    ///
    /// # Errors
    /// As [`frols`] when `terms` is 0.
    pub fn first(&self, pool: &PolyNarx, terms: usize) -> Result<PolyNarx, BuildError> {
        chosen(pool, &self.path, terms)
    }
}

/// A selection could not be made.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum SelectError {
    /// The data do not fit.
    #[error(transparent)]
    Estimate(#[from] EstimateError),
    /// The pool or the options do not fit.
    #[error(transparent)]
    Build(#[from] BuildError),
}

/// Selects terms of `pool` for the one-step prediction of `data`.
///
/// # Errors
/// [`SelectError`]: too few samples for the number of terms asked for, or no term at all.
///
/// ```
/// use dynocal_ident::experiment::Experiment;
/// use dynocal_ident::model::poly::PolyNarx;
/// use dynocal_ident::select::frols::{Stop, frols};
///
/// // y(t) = 0.5 y(t-1) + u(t-1)^2, offered among six candidates.
/// let u: Vec<f64> = (0..200).map(|t| ((t * t * 7919) % 101) as f64 / 50.0 - 1.0).collect();
/// let mut y = vec![0.0; 200];
/// for t in 1..200 {
///     y[t] = 0.5 * y[t - 1] + u[t - 1] * u[t - 1];
/// }
/// let pool = PolyNarx::parse(&["u"], "y", &["1", "u(t-1)", "u(t-2)", "u(t-1)^2", "u(t-2)^2", "y(t-1)"])?;
/// let data = Experiment { name: "demo".into(), u, y, init_samples: 0, weights: vec![] };
/// let selection = frols(&pool, &[data], Stop::Bic { max_terms: 6 })?;
/// assert_eq!(selection.model.regressor_texts(), ["u(t-1)^2", "y(t-1)"]);
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
pub fn frols(pool: &PolyNarx, data: &[Experiment], stop: Stop) -> Result<Selection, SelectError> {
    let max_terms = match stop {
        Stop::Terms(n) | Stop::Bic { max_terms: n } => n.min(pool.n_params()),
    };
    let samples = scored(pool, data, max_terms)?;
    let path = forward(pool, data, samples, max_terms);
    let terms = match stop {
        Stop::Terms(_) => path.len(),
        Stop::Bic { .. } => {
            let best = path.iter().enumerate().min_by(|a, b| a.1.bic.total_cmp(&b.1.bic));
            best.map_or(0, |(i, _)| i + 1)
        }
    };
    let model = chosen(pool, &path, terms)?;
    Ok(Selection { model, terms, path, pool: pool.n_params() })
}

/// Scored samples; enough for the terms, not for the whole pool.
fn scored(pool: &PolyNarx, data: &[Experiment], max_terms: usize) -> Result<usize, SelectError> {
    match usable_samples(pool, data) {
        Ok(n) => Ok(n),
        Err(crate::data::DataError::TooShort { found, expected, .. })
            if expected == pool.n_params() && found >= max_terms =>
        {
            Ok(found)
        }
        Err(e) => Err(EstimateError::from(e).into()),
    }
}

/// Candidates, one contiguous column each, being made orthogonal step by step.
struct Columns {
    n: usize,
    values: Vec<f64>,
    /// w'w now and at the start, w'y.
    norm: Vec<f64>,
    norm_at_start: Vec<f64>,
    with_y: Vec<f64>,
    /// Place in the pool of each column that is left.
    candidate: Vec<usize>,
}

impl Columns {
    fn new(phi: &[f64], y: &[f64], p: usize) -> Self {
        let n = y.len();
        let mut values = vec![0.0; n * p];
        // Tiles of rows, so that writing p columns stays in the cache.
        for (tile, rows) in phi.chunks(p * 64).enumerate() {
            for k in 0..p {
                let column = &mut values[k * n + tile * 64..(k + 1) * n];
                for (x, v) in column.iter_mut().zip(rows[k..].iter().step_by(p)) {
                    *x = *v;
                }
            }
        }
        let columns = || values.chunks_exact(n);
        let norm: Vec<f64> = columns().map(|w| dot(w, w)).collect();
        let with_y = columns().map(|w| dot(w, y)).collect();
        Self { n, norm_at_start: norm.clone(), norm, with_y, candidate: (0..p).collect(), values }
    }

    /// The column with the largest error reduction.
    fn best(&self) -> Option<usize> {
        let gain = |i: usize| self.with_y[i] * self.with_y[i] / self.norm[i];
        (0..self.candidate.len())
            .filter(|&i| self.norm[i] > DEPENDENT * DEPENDENT * self.norm_at_start[i])
            .max_by(|&a, &b| gain(a).total_cmp(&gain(b)))
    }

    fn column(&self, i: usize) -> &[f64] {
        &self.values[i * self.n..(i + 1) * self.n]
    }

    /// Takes column i out and makes the others orthogonal to it.
    fn take(&mut self, i: usize, y: &[f64]) -> Vec<f64> {
        let q = self.column(i).to_vec();
        let qq = self.norm[i];
        let last = self.candidate.len() - 1;
        if i < last {
            self.values.copy_within(last * self.n..(last + 1) * self.n, i * self.n);
        }
        self.values.truncate(last * self.n);
        for v in [&mut self.norm, &mut self.norm_at_start, &mut self.with_y] {
            v.swap_remove(i);
        }
        self.candidate.swap_remove(i);
        for (j, w) in self.values.chunks_exact_mut(self.n).enumerate() {
            axpy(-dot(w, &q) / qq, &q, w);
            self.norm[j] = dot(w, w);
            self.with_y[j] = dot(w, y);
        }
        q
    }
}

fn forward(pool: &PolyNarx, data: &[Experiment], samples: usize, max_terms: usize) -> Vec<Step> {
    let (phi, mut y) = regression(pool, data, samples);
    let total = dot(&y, &y);
    let n = y.len();
    let mut columns = Columns::new(&phi, &y, pool.n_params());
    drop(phi);
    let mut path: Vec<Step> = Vec::with_capacity(max_terms);
    while path.len() < max_terms {
        let Some(i) = columns.best() else { break };
        let (candidate, gain) = (columns.candidate[i], columns.with_y[i] / columns.norm[i]);
        let err = gain * columns.with_y[i] / total;
        // The residual is deflated as well: products with it keep their digits when little is left of y.
        axpy(-gain, columns.column(i), &mut y);
        columns.take(i, &y);
        let mse = dot(&y, &y) / n as f64;
        let k = (path.len() + 1) as f64;
        path.push(Step {
            candidate,
            regressor: pool.param_name(candidate),
            err,
            cumulative: path.last().map_or(0.0, |s| s.cumulative) + err,
            mse,
            bic: n as f64 * mse.max(f64::MIN_POSITIVE).ln() + k * (n as f64).ln(),
        });
        // Rounding level: further terms would fit noise of the arithmetic.
        if mse <= 1e-26 * total / n as f64 {
            break;
        }
    }
    path
}

/// The first `terms` steps as a structure, in the order of the pool.
fn chosen(pool: &PolyNarx, path: &[Step], terms: usize) -> Result<PolyNarx, BuildError> {
    let mut places: Vec<usize> = path.iter().take(terms).map(|s| s.candidate).collect();
    places.sort_unstable();
    let regressors: Vec<Regressor> = places.iter().map(|&k| pool.regressors()[k].clone()).collect();
    PolyNarx::new(pool.inputs().to_vec(), pool.output().into(), regressors)
        .map_err(|e| BuildError::Keys { member: "frols".into(), message: e.to_string() })
}
