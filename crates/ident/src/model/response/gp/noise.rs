//! Noise whose variance depends on the inputs.
//!
//! ```text
//! var e_i = s^2 g exp(h(z_i)),   h(z) = sum_k w_k exp(-|z - c_k|^2 / (2 r^2)) - mean over the points
//! ```
//!
//! The weights come from the left-out residuals e_(i) of the process, whose variance is that of the response without the
//! point plus that of its noise, so that repeated measurements count for what they are:
//!
//! ```text
//! e_(i) ~ N(0, v_i),  v_i = u_i + exp(h_i);     max  sum log N(e_(i); 0, v_i) - a |w|^2 / 2
//! ```
//!
//! by Fisher scoring; a and r maximise Laplace's approximation of the evidence, in which no change of the noise (a large) is
//! one of the choices. Process and noise take turns.
//!
//! Sources: P. Goldberg, C. Williams, C. Bishop, Regression with input-dependent noise, NIPS (1998); M. Binois, R. Gramacy,
//! M. Ludkovski, Practical heteroscedastic Gaussian process modeling, J. Comput. Graph. Stat. 27 (2018).

use dynocal_numerics::linalg::{axpy, cholesky, dot, log_det_gram, solve_upper, solve_upper_transposed};
use serde::{Deserialize, Serialize};

use super::super::rbf::spread_out;

/// Widths in standard deviations of the inputs, and precisions of the weights, that are tried.
const WIDTHS: [f64; 4] = [0.35, 0.6, 1.0, 2.0];
const PRECISIONS: [f64; 6] = [0.03, 0.1, 0.3, 1.0, 10.0, 1000.0];
/// Most functions.
const MOST: usize = 40;
/// Scoring steps.
const STEPS: usize = 30;

/// Logarithm of the noise variance relative to its geometric mean over the points.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct VaryingNoise {
    centres: Vec<f64>,
    width: f64,
    weights: Vec<f64>,
    offset: f64,
}

impl VaryingNoise {
    /// h at a scaled point.
    pub fn log_shape(&self, z: &[f64]) -> f64 {
        let centres = self.centres.chunks_exact(z.len()).zip(&self.weights);
        centres.map(|(c, w)| w * bump(z, c, self.width)).sum::<f64>() + self.offset
    }

    /// From left-out residuals and the variances u of the response without each point; the points are n x d, scaled.
    pub(super) fn learn(z: &[f64], d: usize, residuals: &[f64], response: &[f64]) -> Option<Self> {
        let count = (residuals.len() / 8).clamp(2, MOST);
        let centres: Vec<f64> =
            spread_out(z, d, count).into_iter().flat_map(|i| z[i * d..(i + 1) * d].iter().copied()).collect();
        let mut best: Option<(f64, f64, Vec<f64>)> = None;
        for width in WIDTHS {
            let features = features(z, d, &centres, width);
            for precision in PRECISIONS {
                if let Some((evidence, w)) = fit(&features, residuals, response, precision)
                    && best.as_ref().is_none_or(|(e, ..)| evidence > *e)
                {
                    best = Some((evidence, width, w));
                }
            }
        }
        let (_, width, w) = best?;
        let mut noise = Self { centres, width, weights: w[1..].to_vec(), offset: 0.0 };
        let n = residuals.len() as f64;
        noise.offset = -z.chunks_exact(d).map(|z| noise.log_shape(z)).sum::<f64>() / n;
        Some(noise)
    }
}

fn bump(z: &[f64], c: &[f64], width: f64) -> f64 {
    let r2: f64 = z.iter().zip(c).map(|(a, b)| (a - b).powi(2)).sum();
    (-0.5 * r2 / (width * width)).exp()
}

/// A constant and the functions at the points, n x (1 + m).
fn features(z: &[f64], d: usize, centres: &[f64], width: f64) -> Vec<f64> {
    let one = |z: &[f64]| {
        let bumps: Vec<f64> = centres.chunks_exact(d).map(|c| bump(z, c, width)).collect();
        std::iter::once(1.0).chain(bumps).collect::<Vec<f64>>()
    };
    z.chunks_exact(d).flat_map(one).collect()
}

/// Weights of largest penalised likelihood, and the logarithm of the evidence.
fn fit(features: &[f64], residuals: &[f64], response: &[f64], precision: f64) -> Option<(f64, Vec<f64>)> {
    let n = residuals.len();
    let k = features.len() / n;
    let mean_square = residuals.iter().map(|e| e * e).sum::<f64>() / n as f64;
    let least = 1e-6 * mean_square;
    let value = |w: &[f64]| -> f64 {
        let each = features.chunks_exact(k).zip(residuals).zip(response).map(|((row, e), u)| {
            let v = u + dot(row, w).exp() + least;
            -0.5 * (v.ln() + e * e / v)
        });
        each.sum::<f64>() - 0.5 * precision * dot(&w[1..], &w[1..])
    };
    let mut w = vec![0.0; k];
    w[0] = mean_square.ln();
    let mut now = value(&w);
    let mut matrix = vec![0.0; k * k];
    for _ in 0..STEPS {
        let mut step = vec![0.0; k];
        matrix.fill(0.0);
        for ((row, e), u) in features.chunks_exact(k).zip(residuals).zip(response) {
            let noise = dot(row, &w).exp();
            let v = u + noise + least;
            let share = noise / v;
            axpy(0.5 * share * (e * e / v - 1.0), row, &mut step);
            for i in 0..k {
                axpy(0.5 * share * share * row[i], &row[i..], &mut matrix[i * k + i..(i + 1) * k]);
            }
        }
        for i in 1..k {
            step[i] -= precision * w[i];
            matrix[i * k + i] += precision;
        }
        matrix[0] += 1e-9;
        cholesky(&mut matrix, k).ok()?;
        solve_upper_transposed(&matrix, k, &mut step).ok()?;
        solve_upper(&matrix, k, &mut step).ok()?;
        let mut share = 1.0;
        let next = loop {
            let trial: Vec<f64> = w.iter().zip(&step).map(|(w, s)| w + share * s).collect();
            let at = value(&trial);
            if at >= now || share < 1e-3 {
                break (trial, at);
            }
            share *= 0.5;
        };
        let gain = next.1 - now;
        if !(gain >= 0.0) {
            break;
        }
        (w, now) = next;
        if gain < 1e-6 {
            break;
        }
    }
    let evidence = now + 0.5 * (k - 1) as f64 * precision.ln() - 0.5 * log_det_gram(&matrix, k);
    evidence.is_finite().then_some((evidence, w))
}
