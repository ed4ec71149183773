//! Optimality conditions of a design whose criterion is a maximum (`g`) or an extreme eigenvalue (`e`).
//!
//! Such a criterion has no gradient where several of its pieces are equal, which is where its minima lie. A record x
//! is stationary when zero is in the sum of the subdifferential of ln J and the normal cone of the box,
//!
//! ```text
//! 0 in conv{ d ln v_k(x) : v_k(x) >= (1 - band) J(x) } + N(x)                  g: points of the objective signal
//! 0 in { d <Z, V' B(x) V> / J : Z >= 0, tr Z = 1 } + N(x)                       e: eigenvectors V of the largest ones
//! ```
//!
//! (Clarke, Optimization and nonsmooth analysis, 1983; Overton 1992 for eigenvalues). The least norm of the sum is
//! found by Frank-Wolfe steps with exact line searches.

use crate::channel::Layout;
use crate::problem::{DesignProblem, Evaluator};

/// How nearly a record meets the optimality conditions.
#[derive(Clone, Debug, PartialEq)]
pub struct Stationarity {
    /// Least norm of a convex combination of active gradients of ln J, per unit of range, after the bounds have taken
    /// what they can: zero at a stationary record.
    pub residual: f64,
    /// The same of the worst piece alone: what the slope would be if nothing else were active.
    pub steepest: f64,
    /// Pieces within the band.
    pub active: usize,
}

/// Frank-Wolfe steps.
const STEPS: usize = 3000;
/// Most pieces that are looked at, the worst first.
const MOST: usize = 40;

/// Optimality conditions of the record `u` (N x m) with the pieces within `band` (a share, e.g. 0.01) of the worst;
/// `None` where the criterion is smooth, there are several models, rates or output limits, or J is not finite at `u`.
pub fn stationarity(problem: &DesignProblem, u: &[f64], band: f64) -> Option<Stationarity> {
    let mut evaluator = Evaluator::new(problem).ok()?;
    let limited = problem.terms.len() != 1 || problem.terms[0].limits.is_some();
    if limited || !evaluator.layout().rates().is_empty() || !evaluator.has_extreme() {
        return None;
    }
    let layout = evaluator.layout().clone();
    let mut x = vec![0.0; layout.len()];
    layout.read(u, &mut x);
    let active = evaluator.active(&x, band)?;
    let (spectral, p) = (active.spectral, active.directions.first()?.len());
    let k = active.directions.len().min(if spectral { 8 } else { MOST });
    // Pairs (i, j) of directions; only equal ones where the pieces do not mix.
    let pairs: Vec<(usize, usize)> =
        (0..k).flat_map(|i| (0..=i).map(move |j| (i, j))).filter(|(i, j)| spectral || i == j).collect();
    let mut bar = vec![0.0; p * p];
    let gradients: Vec<Vec<f64>> = pairs
        .iter()
        .map(|(i, j)| {
            let (a, b) = (&active.directions[*i], &active.directions[*j]);
            for r in 0..p {
                for c in 0..p {
                    bar[r * p + c] = -0.5 * active.factor * (a[r] * b[c] + b[r] * a[c]) / active.worst;
                }
            }
            let mut g = vec![0.0; x.len()];
            evaluator.piece_gradient(&bar, &mut g);
            g
        })
        .collect();
    let set = Set { pairs, gradients, k, spectral };
    let cone = Cone { layout: &layout, x: &x };
    let steepest = norm(&cone.left(&set.gradients[0]));
    Some(Stationarity { residual: set.least(&cone), steepest, active: active.directions.len() })
}

fn norm(v: &[f64]) -> f64 {
    v.iter().map(|a| a * a).sum::<f64>().sqrt()
}

/// The normal cone of the box at x.
struct Cone<'a> {
    layout: &'a Layout,
    x: &'a [f64],
}

impl Cone<'_> {
    /// What is left of a gradient when the bounds have taken what they can.
    fn left(&self, g: &[f64]) -> Vec<f64> {
        let (lower, upper) = self.layout.bounds();
        let mut left = g.to_vec();
        for (j, v) in left.iter_mut().enumerate() {
            let (low, high) = (self.x[j] - lower[j] < 1e-9, upper[j] - self.x[j] < 1e-9);
            if low {
                *v = v.min(0.0);
            }
            if high {
                *v = v.max(0.0);
            }
        }
        left
    }
}

/// The gradients that can be combined.
struct Set {
    pairs: Vec<(usize, usize)>,
    gradients: Vec<Vec<f64>>,
    k: usize,
    spectral: bool,
}

impl Set {
    /// Least norm of what is left of a combination.
    fn least(&self, cone: &Cone) -> f64 {
        let mut g = self.gradients[0].clone();
        let mut best = norm(&cone.left(&g));
        for _ in 0..STEPS {
            let left = cone.left(&g);
            let vertex = self.vertex(&left);
            let d: Vec<f64> = vertex.iter().zip(&g).map(|(a, b)| a - b).collect();
            let slope = |step: f64| -> f64 {
                let at: Vec<f64> = g.iter().zip(&d).map(|(g, d)| g + step * d).collect();
                cone.left(&at).iter().zip(&d).map(|(a, b)| a * b).sum()
            };
            if slope(0.0) >= -1e-12 * best * best {
                break;
            }
            // The squared distance to the cone is convex along the segment: bisection of its slope.
            let (mut low, mut high) = (0.0, 1.0);
            for _ in 0..40 {
                let middle = 0.5 * (low + high);
                if slope(middle) < 0.0 { low = middle } else { high = middle }
            }
            g.iter_mut().zip(&d).for_each(|(g, d)| *g += high * d);
            best = best.min(norm(&cone.left(&g)));
        }
        best
    }

    /// The extreme gradient of the set that points most against `r`.
    fn vertex(&self, r: &[f64]) -> Vec<f64> {
        let along: Vec<f64> =
            self.gradients.iter().map(|g| g.iter().zip(r).map(|(a, b)| a * b).sum()).collect();
        if !self.spectral {
            let least = (0..along.len()).fold(0, |b, i| if along[i] < along[b] { i } else { b });
            return self.gradients[least].clone();
        }
        let weights = self.least_eigenvector(&along);
        let mut out = vec![0.0; r.len()];
        for ((i, j), g) in self.pairs.iter().zip(&self.gradients) {
            let w = weights[*i] * weights[*j] * if i == j { 1.0 } else { 2.0 };
            crate::kernel::axpy(w, g, &mut out);
        }
        out
    }

    /// Eigenvector of the least eigenvalue of the symmetric matrix with the entries `along`.
    fn least_eigenvector(&self, along: &[f64]) -> Vec<f64> {
        let k = self.k;
        let mut m = vec![0.0; k * k];
        for ((i, j), v) in self.pairs.iter().zip(along) {
            (m[i * k + j], m[j * k + i]) = (*v, *v);
        }
        // Shifted to be positive definite, so that its singular vectors are eigenvectors; the last one is the least.
        let shift = 1.0 + m.iter().map(|v| v.abs()).sum::<f64>();
        (0..k).for_each(|i| m[i * k + i] += shift);
        let (mut work, mut sigma, mut v) = (vec![0.0; k * k], vec![0.0; k], vec![0.0; k * k]);
        crate::kernel::svd(&m, k, &mut work, &mut sigma, &mut v);
        v[(k - 1) * k..].to_vec()
    }
}
