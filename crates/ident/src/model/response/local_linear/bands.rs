//! Bands that count what the search for the splits took from the noise, and what the splits cannot follow.
//!
//! The trees are grown anew without each of ten folds, with the slope that was chosen. With r_i the residual of the whole tree,
//! e_i that of the tree without the fold of point i, and v_i = c_i'C c_i the variance of that tree at the point for a noise of
//! one:
//!
//! ```text
//! noise       a = mean r_i e_i
//! response    b v(z),   b with  mean e_i^2 / (a + b v_i) = 1
//! ```
//!
//! For a linear smoother with known splits, r_i = (1 - h_i) e_i and var e_i = a / (1 - h_i), so that r_i e_i has the mean a
//! whatever the leverage h_i is; splits that follow the noise take from r_i what they add to e_i. Both variances are never
//! below those that hold for known splits. What the structure cannot follow counts as noise where it changes from point to
//! point, and as variance of the response where a tree without the point misses it.
//!
//! Sources: S. Geisser, The predictive sample reuse method with applications, JASA 70 (1975), 320-328; J. Ye, On measuring and
//! correcting the effects of data mining and model selection, JASA 93 (1998), 120-131.

use dynocal_numerics::rng::Rng64;
use rayon::prelude::*;

use super::super::features::{Coefficients, Features};
use super::LocalLinear;
use super::grow::{self, Grown};

/// Folds without which the trees are grown.
const FOLDS: usize = 10;
/// Stream of the generator that deals the points to the folds.
const DEAL: u64 = 5 << 32;
/// Most steps of the bisection for b, each of a factor of two at first.
const STEPS: usize = 60;

/// Variances in units of the scaled output.
#[derive(Clone, Copy, Debug)]
pub(super) struct Bands {
    /// Noise of one measurement (a).
    pub(super) noise: f64,
    /// Variance of the response for a variance of one of its coefficients' noise (b).
    pub(super) response: f64,
    /// Noise that known splits would give.
    known: f64,
    /// Folds that could be grown.
    folds: usize,
}

impl Bands {
    /// A sentence on bands that were not calibrated.
    pub(super) fn note(self) -> Option<String> {
        (self.folds < 2).then(|| {
            format!(
                "the bands take the splits for known, as too few points were left to grow without: standard deviation of the noise {:.3} of the output's",
                self.known.sqrt()
            )
        })
    }
}

/// Residual of a point that a tree has not seen, and the variance of that tree there for a noise of one.
struct Unseen {
    row: usize,
    error: f64,
    variance: f64,
}

/// Noise and variance of the response from trees that are grown without each fold in turn. After an interrupt, or where
/// nothing can be left out, the splits count as known.
pub(super) fn calibrate(
    keys: &LocalLinear,
    whole: &Grown,
    z: &[f64],
    y: &[f64],
    d: usize,
    interrupt: &dyn Fn() -> bool,
) -> Bands {
    let known = whole.noise();
    let plain = Bands { noise: known, response: known, known, folds: 0 };
    if interrupt() {
        return plain;
    }
    let folds = dealt(y.len());
    let keys = LocalLinear { steepness: vec![whole.slope], ..keys.clone() };
    let parts: Vec<Option<Vec<Unseen>>> =
        folds.par_iter().map(|held| without(&keys, held, z, y, d)).collect();
    let grown = parts.iter().flatten().count();
    let unseen: Vec<Unseen> = parts.into_iter().flatten().flatten().collect();
    if grown < 2 || unseen.is_empty() {
        return plain;
    }
    let residuals = whole.residuals();
    let count = unseen.len() as f64;
    let noise = (unseen.iter().map(|u| residuals[u.row] * u.error).sum::<f64>() / count).max(known);
    Bands { noise, response: response(&unseen, noise, known), known, folds: grown }
}

/// Rows of each fold, dealt by a seeded shuffle: tables often have an order.
fn dealt(n: usize) -> Vec<Vec<usize>> {
    let mut rows: Vec<usize> = (0..n).collect();
    let mut rng = Rng64::stream(0, DEAL);
    for i in (1..n).rev() {
        rows.swap(i, rng.below(i + 1));
    }
    let count = FOLDS.min(n);
    (0..count).map(|k| rows.iter().skip(k).step_by(count).copied().collect()).collect()
}

/// The points of a fold under a tree that is grown without them.
fn without(keys: &LocalLinear, held: &[usize], z: &[f64], y: &[f64], d: usize) -> Option<Vec<Unseen>> {
    let mut out = vec![false; y.len()];
    held.iter().for_each(|i| out[*i] = true);
    let rest: Vec<usize> = (0..y.len()).filter(|i| !out[*i]).collect();
    if rest.len() < d + 2 {
        return None;
    }
    let rows =
        |of: &[usize]| of.iter().flat_map(|i| z[i * d..(i + 1) * d].iter().copied()).collect::<Vec<_>>();
    let outputs: Vec<f64> = rest.iter().map(|i| y[*i]).collect();
    let tree = grow::best(keys, &rows(&rest), &outputs, d, &|| false)?;
    let one = Bands { noise: 1.0, response: 1.0, known: 1.0, folds: 1 };
    let Coefficients { values, covariance, .. } = tree.coefficients(one);
    let mut c = vec![0.0; values.len()];
    let each = held.iter().map(|i| {
        tree.tree.values(&z[i * d..(i + 1) * d], &mut c, &mut []);
        let dot = |row: &[f64]| row.iter().zip(&c).map(|(a, b)| a * b).sum::<f64>();
        let variance = covariance.chunks_exact(c.len()).zip(&c).map(|(row, c)| c * dot(row)).sum();
        Unseen { row: *i, error: y[*i] - dot(&values), variance }
    });
    Some(each.collect())
}

/// b: bisection of a decreasing function, from `least` up.
fn response(unseen: &[Unseen], noise: f64, least: f64) -> f64 {
    let ratio = |b: f64| {
        let each = unseen.iter().map(|u| u.error * u.error / (noise + b * u.variance).max(f64::MIN_POSITIVE));
        each.sum::<f64>() / unseen.len() as f64
    };
    if ratio(least) <= 1.0 {
        return least;
    }
    let (mut low, mut high) = (least, noise.max(f64::MIN_POSITIVE));
    let mut steps = 0;
    while ratio(high) > 1.0 && steps < STEPS {
        (low, high) = (high, 2.0 * high);
        steps += 1;
    }
    for _ in 0..STEPS {
        let middle = 0.5 * (low + high);
        if ratio(middle) > 1.0 { low = middle } else { high = middle }
    }
    0.5 * (low + high)
}
