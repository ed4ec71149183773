//! Models that are linear in their coefficients over known features of the inputs: polynomials, radial functions, and
//! local models under their validities.
//!
//! ```text
//! mean     = w'c            d_j = w'c_j          d_jl = w'c_jl
//! variance = c'C c          d_j = 2 (C c)'c_j    d_jl = 2 c_j'C c_l + 2 (C c)'c_jl
//! ```
//!
//! c(z) are the features at scaled inputs, w their coefficients and C the covariance of w.

use dynocal_numerics::linalg::dot;
use serde::{Deserialize, Serialize};

use super::{Ask, Prediction, Scaling};

/// Features of scaled inputs z (d).
pub(super) trait Features: Send + Sync {
    /// Number of features p.
    fn count(&self) -> usize;

    /// Features into c (p) and, where `jacobian` (d x p) is not empty, their derivatives into it.
    fn values(&self, z: &[f64], c: &mut [f64], jacobian: &mut [f64]);

    /// Adds `sum_k w_k d^2 c_k / dz dz'` to `hessian` (d x d).
    fn curvature(&self, z: &[f64], w: &[f64], hessian: &mut [f64]);
}

/// Coefficients of features with their covariance, in the unit of the scaled output.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub(super) struct Coefficients {
    /// w (p).
    pub(super) values: Vec<f64>,
    /// C (p x p), symmetric.
    pub(super) covariance: Vec<f64>,
    /// Variance of the noise.
    pub(super) noise: f64,
}

/// Prediction of a model over features, in the units of inputs and output.
pub(super) fn predict(
    features: &dyn Features,
    of: &Coefficients,
    scaling: &Scaling,
    x: &[f64],
    ask: Ask,
    out: &mut Prediction,
) {
    let (d, p) = (x.len(), features.count());
    let mut work = out.take_work(d + 3 * p + d * p);
    let (z, rest) = work.split_at_mut(d);
    let (c, rest) = rest.split_at_mut(p);
    let (by_variance, rest) = rest.split_at_mut(p);
    let (product, rest) = rest.split_at_mut(p);
    let jacobian = &mut rest[..if ask >= Ask::Gradient { d * p } else { 0 }];
    scaling.input(x, z);
    features.values(z, c, jacobian);
    let unit = scaling.output_std;
    out.mean = scaling.output_mean + unit * dot(&of.values, c);
    if ask >= Ask::Variance {
        times(&of.covariance, c, by_variance);
        out.variance = (unit * unit * dot(c, by_variance)).max(0.0);
        out.noise = unit * unit * of.noise;
    }
    if ask >= Ask::Gradient {
        for j in 0..d {
            let column = &jacobian[j * p..(j + 1) * p];
            out.gradient[j] = unit * dot(&of.values, column) / scaling.std[j];
            out.variance_gradient[j] = 2.0 * unit * unit * dot(by_variance, column) / scaling.std[j];
        }
    }
    if ask == Ask::Hessian {
        out.hessian.fill(0.0);
        out.variance_hessian.fill(0.0);
        features.curvature(z, &of.values, &mut out.hessian);
        features.curvature(z, by_variance, &mut out.variance_hessian);
        for j in 0..d {
            times(&of.covariance, &jacobian[j * p..(j + 1) * p], product);
            for l in 0..d {
                let per = scaling.std[j] * scaling.std[l];
                let cross = dot(product, &jacobian[l * p..(l + 1) * p]);
                out.hessian[j * d + l] *= unit / per;
                let variance = out.variance_hessian[j * d + l] + cross;
                out.variance_hessian[j * d + l] = 2.0 * unit * unit * variance / per;
            }
        }
    }
    out.work = work;
    scaling.warp.back(x, ask, out);
}

fn times(matrix: &[f64], x: &[f64], out: &mut [f64]) {
    for (row, out) in matrix.chunks_exact(x.len().max(1)).zip(out) {
        *out = dot(row, x);
    }
}
