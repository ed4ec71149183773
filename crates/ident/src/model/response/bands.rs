//! Bands that count what the choice of a structure took from the noise, and what the structure cannot follow.
//!
//! The structure (splits, functions) is chosen anew without each of ten folds; the slope of the splits and the width of the
//! functions are kept. With r_i the residual of the model of all points, e_i that of the model without the fold of point i, and
//! v_i = c_i'C c_i the variance of that model at the point for a noise of one:
//!
//! ```text
//! noise       a = mean r_i e_i
//! response    b v(z),   b the least with which  |e_i| <= 1.96 sqrt(a + b v_i)  for ceil(0.95 (n + 1)) of the n points
//! ```
//!
//! For a linear smoother of known structure, r_i = (1 - h_i) e_i and var e_i = a / (1 - h_i), so that r_i e_i has the mean a
//! whatever the leverage h_i is; a choice that follows the noise takes from r_i what they add to e_i. Both variances are never
//! below those that hold for a known structure. What the structure cannot follow counts as noise where it changes from point to
//! point, and as variance of the response where a model without the point misses it.
//!
//! A quantile and not the mean of e_i^2 / (a + b v_i): the few points at the edge that a model without them has to extrapolate to
//! carry such a mean, and the bands of all points would follow them.
//!
//! Sources: S. Geisser, The predictive sample reuse method with applications, JASA 70 (1975), 320-328; J. Ye, On measuring and
//! correcting the effects of data mining and model selection, JASA 93 (1998), 120-131; V. Vovk, Cross-conformal predictors, Ann. Math. Artif. Intell. 74 (2015), 9-28.

use rayon::prelude::*;

use super::features::{Coefficients, Features};
use super::score::shuffled;

/// Folds without which the structure is chosen.
const FOLDS: usize = 10;
/// Stream of the generator that deals the points to the folds.
const DEAL: u64 = 5 << 32;
/// Share of the points that a band holds, and the two-sided quantile of a normal distribution for it.
const HELD: f64 = 0.95;
const QUANTILE: f64 = 1.959_963_984_540_054;
/// Most steps of the bisection for b, each of a factor of two at first.
const STEPS: usize = 60;

/// Variances in units of the scaled output.
#[derive(Clone, Copy, Debug)]
pub(super) struct Bands {
    /// Noise of one measurement (a).
    pub(super) noise: f64,
    /// Variance of the response for a variance of one of its coefficients' noise (b).
    pub(super) response: f64,
    /// Noise that a known structure would give.
    known: f64,
    /// Folds without which there is a model.
    folds: usize,
}

impl Bands {
    /// For the covariance of a noise of one.
    pub(super) const UNIT: Self = Self { noise: 1.0, response: 1.0, known: 1.0, folds: 0 };

    /// Coefficients whose covariance was computed with the noise of a known structure, with these variances instead.
    pub(super) fn of(self, plain: Coefficients) -> Coefficients {
        let factor = if plain.noise > 0.0 { self.response / plain.noise } else { 1.0 };
        let covariance = plain.covariance.into_iter().map(|c| factor * c).collect();
        Coefficients { covariance, noise: self.noise, values: plain.values }
    }

    /// A sentence on bands that were not calibrated.
    pub(super) fn note(self) -> Option<String> {
        (self.folds < 2).then(|| {
            format!(
                "the bands take the structure for known, as too few points could be left out: standard deviation of the noise {:.3} of the output's",
                self.known.sqrt()
            )
        })
    }
}

/// A model that was learnt again without some points.
pub(super) struct Refit {
    /// Its features.
    pub(super) features: Box<dyn Features>,
    /// Its coefficients, with their covariance.
    pub(super) coefficients: Coefficients,
    /// Noise that the covariance was computed with.
    pub(super) noise: f64,
}

/// Learns without a fold (its number, from 0), from the scaled inputs and outputs of the other points.
type Learner<'a> = dyn Fn(usize, &[f64], &[f64]) -> Option<Refit> + Sync + 'a;

/// Residual of a point that a model has not seen, and the variance of that model there for a noise of one.
struct Unseen {
    row: usize,
    error: f64,
    variance: f64,
}

/// Noise and variance of the response from models that are learnt by `refit` (from scaled inputs and outputs) without each fold
/// in turn; `known` is the noise and `residuals` are those of the model of all points. After an interrupt, or where nothing can
/// be left out, the structure counts as known.
pub(super) fn calibrate(
    known: f64,
    residuals: &[f64],
    (z, y): (&[f64], &[f64]),
    refit: &Learner<'_>,
    interrupt: &dyn Fn() -> bool,
) -> Bands {
    let plain = Bands { noise: known, response: known, known, folds: 0 };
    if interrupt() {
        return plain;
    }
    let parts: Vec<Option<Vec<Unseen>>> =
        dealt(y.len()).par_iter().enumerate().map(|(k, held)| without((k, held), z, y, refit)).collect();
    let grown = parts.iter().flatten().count();
    let unseen: Vec<Unseen> = parts.into_iter().flatten().flatten().collect();
    if grown < 2 || unseen.is_empty() {
        return plain;
    }
    let count = unseen.len() as f64;
    let noise = (unseen.iter().map(|u| residuals[u.row] * u.error).sum::<f64>() / count).max(known);
    Bands { noise, response: response(&unseen, noise, known), known, folds: grown }
}

/// Rows of each fold, dealt by a seeded shuffle: tables often have an order.
pub(super) fn dealt(n: usize) -> Vec<Vec<usize>> {
    let rows = shuffled(n, DEAL);
    let count = FOLDS.min(n);
    (0..count).map(|k| rows.iter().skip(k).step_by(count).copied().collect()).collect()
}

/// The points of a fold under a model that is learnt without them.
fn without(
    (fold, held): (usize, &[usize]),
    z: &[f64],
    y: &[f64],
    refit: &Learner<'_>,
) -> Option<Vec<Unseen>> {
    let d = z.len() / y.len().max(1);
    let mut out = vec![false; y.len()];
    held.iter().for_each(|i| out[*i] = true);
    let rest: Vec<usize> = (0..y.len()).filter(|i| !out[*i]).collect();
    if rest.len() < d + 2 {
        return None;
    }
    let inputs: Vec<f64> = rest.iter().flat_map(|i| z[i * d..(i + 1) * d].iter().copied()).collect();
    let outputs: Vec<f64> = rest.iter().map(|i| y[*i]).collect();
    let Refit { features, coefficients, noise } = refit(fold, &inputs, &outputs)?;
    let Coefficients { values, covariance, .. } = coefficients;
    let mut c = vec![0.0; values.len()];
    let each = held.iter().map(|i| {
        features.values(&z[i * d..(i + 1) * d], &mut c, &mut []);
        let dot = |row: &[f64]| row.iter().zip(&c).map(|(a, b)| a * b).sum::<f64>();
        let whole: f64 = covariance.chunks_exact(c.len()).zip(&c).map(|(row, c)| c * dot(row)).sum();
        Unseen { row: *i, error: y[*i] - dot(&values), variance: whole / noise.max(f64::MIN_POSITIVE) }
    });
    Some(each.collect())
}

/// b: bisection, from `least` up; wider bands hold no fewer points.
fn response(unseen: &[Unseen], noise: f64, least: f64) -> f64 {
    let asked = (HELD * (unseen.len() + 1) as f64).ceil().min(unseen.len() as f64) as usize;
    let inside = |u: &&Unseen, b: f64| u.error * u.error <= QUANTILE * QUANTILE * (noise + b * u.variance);
    let enough = |b: f64| unseen.iter().filter(|u| inside(u, b)).count() >= asked;
    if enough(least) {
        return least;
    }
    let (mut low, mut high) = (least, noise.max(f64::MIN_POSITIVE));
    let mut steps = 0;
    while !enough(high) && steps < STEPS {
        (low, high) = (high, 2.0 * high);
        steps += 1;
    }
    for _ in 0..STEPS {
        let middle = 0.5 * (low + high);
        if enough(middle) { high = middle } else { low = middle }
    }
    high
}
