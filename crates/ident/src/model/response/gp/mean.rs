//! Mean functions: known functions with unknown coefficients under the process.

use serde::{Deserialize, Serialize};

/// Mean of a Gaussian process, in scaled inputs.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Mean {
    /// None: far from the data the prediction goes to the mean of the measured output.
    Zero,
    /// An unknown constant.
    Constant,
    /// Constant and slopes: outside the data the response goes on as its trend.
    #[default]
    Linear,
    /// All products up to the second degree.
    Quadratic,
}

impl Mean {
    /// Number of functions q for d inputs.
    pub fn count(self, d: usize) -> usize {
        match self {
            Self::Zero => 0,
            Self::Constant => 1,
            Self::Linear => 1 + d,
            Self::Quadratic => 1 + d + d * (d + 1) / 2,
        }
    }

    /// Functions at z (d) into h (q): 1, z_j, z_i z_j with i <= j.
    pub fn values(self, z: &[f64], h: &mut [f64]) {
        let d = z.len();
        if self != Self::Zero {
            h[0] = 1.0;
        }
        if matches!(self, Self::Linear | Self::Quadratic) {
            h[1..=d].copy_from_slice(z);
        }
        if self == Self::Quadratic {
            for (h, (i, j)) in h[d + 1..].iter_mut().zip(pairs(d)) {
                *h = z[i] * z[j];
            }
        }
    }

    /// Inputs whose product each function is.
    pub(super) fn products(self, d: usize) -> Vec<Vec<usize>> {
        let mut all: Vec<Vec<usize>> = std::iter::once(vec![]).chain((0..d).map(|j| vec![j])).collect();
        all.extend(pairs(d).map(|(i, j)| vec![i, j]));
        all.truncate(self.count(d));
        all
    }

    /// Derivatives of the functions with respect to z_k into h (q).
    pub fn slopes(self, z: &[f64], k: usize, h: &mut [f64]) {
        let d = z.len();
        h.fill(0.0);
        if matches!(self, Self::Linear | Self::Quadratic) {
            h[1 + k] = 1.0;
        }
        if self == Self::Quadratic {
            for (h, (i, j)) in h[d + 1..].iter_mut().zip(pairs(d)) {
                *h = f64::from(u8::from(i == k)) * z[j] + f64::from(u8::from(j == k)) * z[i];
            }
        }
    }

    /// Second derivative with respect to z_k and z_l of function `at` (constant).
    pub fn curvature(self, d: usize, at: usize, k: usize, l: usize) -> f64 {
        if self != Self::Quadratic || at <= d {
            return 0.0;
        }
        let (i, j) = pairs(d).nth(at - d - 1).unwrap_or((d, d));
        match ((i, j) == (k.min(l), k.max(l)), i == j) {
            (true, true) => 2.0,
            (true, false) => 1.0,
            _ => 0.0,
        }
    }
}

fn pairs(d: usize) -> impl Iterator<Item = (usize, usize)> {
    (0..d).flat_map(move |i| (i..d).map(move |j| (i, j)))
}
