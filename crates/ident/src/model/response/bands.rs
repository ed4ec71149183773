//! Bands that count what the choice of a structure took from the noise, and what the structure cannot follow.
//!
//! The structure (splits; functions and their width) is chosen anew without each of ten folds; the slope of the splits and the number
//! of local models are kept. With e_i the residual of the model without the fold of point i, and v_i = c_i'C c_i the variance of that
//! model at the point for a noise of one:
//!
//! ```text
//! noise       a
//! response    b v(z),   a, b = argmax  sum_i log N(e_i; 0, a + b v_i)
//! ```
//!
//! At the maximum the mean of e_i^2 / (a + b v_i) is one. For a known structure b = a. Neither is below the noise that holds for a
//! known structure. What the structure cannot follow counts as noise where it changes from point to point, and as variance of the
//! response where a model without the point misses it. Both are estimated together: a b for a given a has to carry all that the a
//! leaves out, also where v is nearly zero, and bands at the edge would be many times too wide.
//!
//! Sources: S. Geisser, The predictive sample reuse method with applications, JASA 70 (1975), 320-328; J. Ye, On measuring and
//! correcting the effects of data mining and model selection, JASA 93 (1998), 120-131.

use rayon::prelude::*;

use super::features::{Coefficients, Features};
use super::score::shuffled;

/// Folds without which the structure is chosen.
const FOLDS: usize = 10;
/// Stream of the generator that deals the points to the folds.
const DEAL: u64 = 5 << 32;
/// Ratios b / a among which the likeliest is sought, in so many steps of their logarithm, and narrowings of the last interval.
const RATIOS: [f64; 2] = [1e-3, 1e4];
const GRID: usize = 40;
const NARROWINGS: usize = 40;

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
    error: f64,
    variance: f64,
}

/// Noise and variance of the response from models that are learnt by `refit` (from scaled inputs and outputs) without each of
/// the folds in turn; `known` is the noise of the model of all points if its structure had been known. After an interrupt, or
/// where nothing can be left out, the structure counts as known.
pub(super) fn calibrate(
    known: f64,
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
    let (noise, response) = likeliest(&unseen, known);
    Bands { noise, response, known, folds: grown }
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
        Unseen { error: y[*i] - dot(&values), variance: whole / noise.max(f64::MIN_POSITIVE) }
    });
    Some(each.collect())
}

/// a and b, neither below `known`; there is at least one point.
fn likeliest(unseen: &[Unseen], known: f64) -> (f64, f64) {
    let count = unseen.len() as f64;
    // For the ratio r = b / a the best a is the mean of e_i^2 / (1 + r v_i); what is left is minimised over log r.
    let noise = |ratio: f64| {
        unseen.iter().map(|u| u.error * u.error / (1.0 + ratio * u.variance)).sum::<f64>() / count
    };
    let loss = |log_ratio: f64| {
        let ratio = log_ratio.exp();
        let logs: f64 = unseen.iter().map(|u| (1.0 + ratio * u.variance).ln()).sum();
        count * noise(ratio).max(f64::MIN_POSITIVE).ln() + logs
    };
    let [low, high] = RATIOS.map(f64::ln);
    let step = (high - low) / GRID as f64;
    let at = |k: usize| low + step * k as f64;
    let best = (0..=GRID).min_by(|i, j| loss(at(*i)).total_cmp(&loss(at(*j)))).unwrap_or(0);
    let (mut left, mut right) = ((at(best) - step).max(low), (at(best) + step).min(high));
    for _ in 0..NARROWINGS {
        let third = (right - left) / 3.0;
        if loss(left + third) <= loss(right - third) { right -= third } else { left += third }
    }
    let ratio = (0.5 * (left + right)).exp();
    let noise = noise(ratio);
    (noise.max(known), (ratio * noise).max(known))
}
