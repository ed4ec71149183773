//! What folds take back of a tree that followed the noise.
//!
//! The left-out error with the splits held is too small, since the splits were placed with the same points. Each of ten folds is
//! left out in turn, the tree is grown anew without it, and every tree on the way is tested on it:
//!
//! ```text
//! E_i(L) = squared error of point i under the tree of L leaves that was grown without its fold
//! L* = argmin mean E_i(L);   the tree of all points keeps its L unless mean (E_i(L) - E_i(L*)) is above its standard error
//! ```
//!
//! Source: L. Breiman, J. Friedman, R. Olshen, C. Stone, Classification and Regression Trees (1984), chapter 3 (there the tree is
//! the smallest within the standard error; here the left-out error has chosen, and is overruled only by what is told from chance).

use rayon::prelude::*;

use super::super::bands::dealt;
use super::super::features::Features;
use super::LocalLinear;
use super::grow::{Grown, best};
use super::tree::Tree;

/// Trees that were grown without each fold.
pub(super) struct Regrown {
    /// Fold by fold, the trees of one leaf, two leaves, ..; none where too few points were left.
    paths: Vec<Vec<Tree>>,
}

impl Regrown {
    /// Grows without each fold in turn, with the slope of `grown`.
    pub(super) fn new(keys: &LocalLinear, grown: &Grown, z: &[f64], y: &[f64], d: usize) -> Self {
        let keys = LocalLinear {
            steepness: vec![grown.slope],
            most: grown.tree.leaves.len(),
            quadratic: keys.quadratic,
        };
        let path = |held: &Vec<usize>| {
            let (z, y) = without(held, z, y, d);
            if y.len() < d + 2 { None } else { best(&keys, &z, &y, d, &|| false) }
                .map_or(Vec::new(), |g| g.path)
        };
        Self { paths: dealt(y.len()).par_iter().map(path).collect() }
    }

    /// The tree of fold `fold` with at most `leaves` leaves.
    pub(super) fn tree(&self, fold: usize, leaves: usize) -> Option<&Tree> {
        let path = self.paths.get(fold)?;
        path.get(leaves.min(path.len()).checked_sub(1)?)
    }

    /// How many leaves `grown` keeps.
    pub(super) fn leaves(&self, grown: &Grown, z: &[f64], y: &[f64], d: usize) -> usize {
        let all = grown.tree.leaves.len();
        let folds = dealt(y.len());
        let of = |leaves: usize| -> Vec<f64> {
            let each = folds.par_iter().enumerate().map(|(k, held)| {
                let tree = self.tree(k, leaves)?;
                errors(tree, grown.slope, held, (z, y), d)
            });
            each.collect::<Vec<_>>().into_iter().flatten().flatten().collect()
        };
        let errors: Vec<Vec<f64>> = (1..=all).map(of).collect();
        let mean = |e: &[f64]| e.iter().sum::<f64>() / e.len().max(1) as f64;
        let last = &errors[all - 1];
        let fewest =
            (0..all).min_by(|a, b| mean(&errors[*a]).total_cmp(&mean(&errors[*b]))).unwrap_or(all - 1);
        if errors[fewest].len() != last.len() || last.len() < 2 {
            return all;
        }
        let gain: Vec<f64> = last.iter().zip(&errors[fewest]).map(|(a, b)| a - b).collect();
        let (gained, count) = (mean(&gain), gain.len() as f64);
        let spread = gain.iter().map(|g| (g - gained).powi(2)).sum::<f64>() / (count - 1.0);
        if gained > (spread / count).sqrt() { fewest + 1 } else { all }
    }
}

/// Squared errors of the points of a fold under a tree of the others.
fn errors(tree: &Tree, slope: f64, held: &[usize], (z, y): (&[f64], &[f64]), d: usize) -> Option<Vec<f64>> {
    let (inputs, outputs) = without(held, z, y, d);
    let values = Grown::of(tree, slope, &inputs, &outputs)?.values();
    let mut c = vec![0.0; values.len()];
    let each = held.iter().map(|i| {
        tree.values(&z[i * d..(i + 1) * d], &mut c, &mut []);
        (y[*i] - values.iter().zip(&c).map(|(w, c)| w * c).sum::<f64>()).powi(2)
    });
    Some(each.collect())
}

/// Inputs and outputs without some points.
fn without(held: &[usize], z: &[f64], y: &[f64], d: usize) -> (Vec<f64>, Vec<f64>) {
    let mut out = vec![false; y.len()];
    held.iter().for_each(|i| out[*i] = true);
    let rest: Vec<usize> = (0..y.len()).filter(|i| !out[*i]).collect();
    let inputs = rest.iter().flat_map(|i| z[i * d..(i + 1) * d].iter().copied()).collect();
    (inputs, rest.iter().map(|i| y[*i]).collect())
}
