//! Inputs, warped where that is asked, and output in numbers of size one.

use serde::{Deserialize, Serialize};

use super::points::Points;
use super::warp::{Warp, WarpChoice};

/// `z_j = (w_j(x_j) - mean_j) / std_j` for the inputs, w the warp (none: x itself), and the same without a warp for the output.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Scaling {
    /// Means of the warped inputs (d).
    pub mean: Vec<f64>,
    /// Standard deviations of the warped inputs (d), n in the denominator.
    pub std: Vec<f64>,
    /// Mean of the output.
    pub output_mean: f64,
    /// Standard deviation of the output.
    pub output_std: f64,
    /// Warp of the inputs.
    #[serde(default, skip_serializing_if = "Warp::is_none")]
    pub warp: Warp,
}

impl Scaling {
    /// Mean and spread of points that passed [`Points::check`].
    pub fn of(points: &Points) -> Self {
        Self::warped(WarpChoice::None, points)
    }

    /// The same of warped inputs.
    pub fn warped(choice: WarpChoice, points: &Points) -> Self {
        let warp = Warp::of(choice, points);
        let d = points.dim();
        let (mut mean, mut std) = (vec![0.0; d], vec![1.0; d]);
        for j in 0..d {
            (mean[j], std[j]) = mean_std(points.column(j).map(|x| warp.at(j, x)[0]));
        }
        let (output_mean, output_std) = mean_std(points.y.iter().copied());
        Self { mean, std, output_mean, output_std, warp }
    }

    /// Scaled inputs of one point into `z` (d).
    pub fn input(&self, x: &[f64], z: &mut [f64]) {
        for (j, (((z, x), m), s)) in z.iter_mut().zip(x).zip(&self.mean).zip(&self.std).enumerate() {
            *z = (self.warp.at(j, *x)[0] - m) / s;
        }
    }

    /// All scaled inputs, n x d row-major.
    pub fn inputs(&self, points: &Points) -> Vec<f64> {
        let mut z = vec![0.0; points.x.len()];
        let d = points.dim().max(1);
        points.x.chunks_exact(d).zip(z.chunks_exact_mut(d)).for_each(|(x, z)| self.input(x, z));
        z
    }

    /// Scaled outputs (n).
    pub fn outputs(&self, points: &Points) -> Vec<f64> {
        points.y.iter().map(|y| (y - self.output_mean) / self.output_std).collect()
    }
}

/// Mean and standard deviation (n in the denominator); a spread of zero counts as one.
pub fn mean_std(values: impl Iterator<Item = f64> + Clone) -> (f64, f64) {
    let n = values.clone().count().max(1) as f64;
    let mean = values.clone().sum::<f64>() / n;
    let std = (values.map(|v| (v - mean).powi(2)).sum::<f64>() / n).sqrt();
    (mean, if std > 0.0 { std } else { 1.0 })
}
