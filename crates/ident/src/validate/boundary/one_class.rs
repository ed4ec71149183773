//! A one-class kernel region: follows any shape, several islands included.
//!
//! ```text
//! f(z) = sum_i a_i exp(-|z - z_i|^2 / (2 w^2)),   inside where f >= rho
//! min a'K a / 2,   0 <= a_i <= 1/(nu n),   sum a_i = 1        at most nu of the points outside
//! distance = sqrt(log(F/f) / log(F/rho)),  F = (1 + sum a_i) k(0) = 2      1 at f = rho, in proportion to |z| far away
//! ```
//!
//! Source: B. Scholkopf, J. Platt, J. Shawe-Taylor, A. Smola, R. Williamson, Estimating the support of a high-dimensional
//! distribution, Neural Computation 13 (2001), 1443-1471; pairs as in J. Platt's sequential minimal optimisation (1998).

use serde::{Deserialize, Serialize};

/// Violation of the optimality conditions at which the pairs are done, in units of the largest f.
const OPTIMAL: f64 = 1e-5;
/// Above every value of f.
const TOP: f64 = 2.0;

/// Weights on points, in white coordinates.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub(super) struct OneClass {
    /// Points with a weight above 0, row by row.
    points: Vec<f64>,
    weights: Vec<f64>,
    rho: f64,
    width: f64,
}

impl OneClass {
    /// From points (row by row, d each), of which a share `nu` may lie outside; at most `most` evenly taken points.
    pub(super) fn fit(points: &[f64], d: usize, most: usize, nu: f64) -> Self {
        let step = (points.len() / d).div_ceil(most.max(2)).max(1);
        let taken: Vec<f64> = points.chunks_exact(d).step_by(step).flatten().copied().collect();
        let n = taken.len() / d;
        // Half of the usual distance of two points in white coordinates, whose square is 2 d.
        let width = (0.5 * d as f64).sqrt();
        let row = |i: usize| &taken[i * d..(i + 1) * d];
        let kernel: Vec<f64> = (0..n * n).map(|p| value(row(p / n), row(p % n), width)).collect();
        let cap = (1.0 / (nu.clamp(1e-6, 1.0) * n as f64)).min(1.0);
        let mut weights = vec![1.0 / n as f64; n];
        let mut f: Vec<f64> =
            (0..n).map(|i| kernel[i * n..(i + 1) * n].iter().sum::<f64>() / n as f64).collect();
        for _ in 0..200 * n {
            // Weight goes from where f is largest to where it is least.
            let to = (0..n).filter(|i| weights[*i] < cap - 1e-15).min_by(|a, b| f[*a].total_cmp(&f[*b]));
            let from = (0..n).filter(|i| weights[*i] > 1e-15).max_by(|a, b| f[*a].total_cmp(&f[*b]));
            let (Some(to), Some(from)) = (to, from) else { break };
            if f[from] - f[to] < OPTIMAL * f[from].abs() {
                break;
            }
            let curvature = (2.0 - 2.0 * kernel[to * n + from]).max(1e-12);
            let step = ((f[from] - f[to]) / curvature).min(cap - weights[to]).min(weights[from]);
            weights[to] += step;
            weights[from] -= step;
            for i in 0..n {
                f[i] += step * (kernel[i * n + to] - kernel[i * n + from]);
            }
        }
        // rho is f at the points that are neither at zero nor at the cap; the least f of those inside else.
        let free: Vec<f64> =
            (0..n).filter(|i| weights[*i] > 1e-9 && weights[*i] < cap - 1e-9).map(|i| f[i]).collect();
        let rho = if free.is_empty() {
            (0..n).filter(|i| weights[*i] < cap - 1e-9).map(|i| f[i]).fold(f64::INFINITY, f64::min)
        } else {
            free.iter().sum::<f64>() / free.len() as f64
        };
        let kept: Vec<usize> = (0..n).filter(|i| weights[*i] > 1e-12).collect();
        Self {
            points: kept.iter().flat_map(|i| row(*i).iter().copied()).collect(),
            weights: kept.iter().map(|i| weights[*i]).collect(),
            rho: if rho.is_finite() && rho > 0.0 { rho } else { f64::MIN_POSITIVE },
            width,
        }
    }

    /// Distance at z and its gradient.
    pub(super) fn distance(&self, z: &[f64]) -> (f64, Vec<f64>) {
        let (d, inverse) = (z.len(), 1.0 / (self.width * self.width));
        let exponents: Vec<f64> = self
            .points
            .chunks_exact(d)
            .zip(&self.weights)
            .map(|(p, a)| a.ln() - 0.5 * inverse * squared(p, z))
            .collect();
        let largest = exponents.iter().copied().fold(f64::NEG_INFINITY, f64::max);
        // Of the logarithm, so that it neither underflows nor loses its slope far away.
        let parts: Vec<f64> = exponents.iter().map(|e| (e - largest).exp()).collect();
        let sum: f64 = parts.iter().sum();
        let unit = (TOP / self.rho).ln();
        let distance = ((TOP.ln() - largest - sum.ln()) / unit).max(0.0).sqrt();
        let mut gradient = vec![0.0; d];
        for (p, part) in self.points.chunks_exact(d).zip(&parts) {
            for j in 0..d {
                gradient[j] += part / sum * inverse * (z[j] - p[j]) / (2.0 * distance * unit);
            }
        }
        (distance, gradient)
    }
}

fn squared(a: &[f64], b: &[f64]) -> f64 {
    a.iter().zip(b).map(|(a, b)| (a - b).powi(2)).sum()
}

fn value(a: &[f64], b: &[f64], width: f64) -> f64 {
    (-0.5 * squared(a, b) / (width * width)).exp()
}

#[cfg(test)]
mod tests {
    use super::*;
    use dynocal_numerics::rng::Rng64;

    fn two_islands(n: usize, seed: u64) -> Vec<f64> {
        let mut rng = Rng64::new(seed);
        let mut point = |i: usize| {
            let side = if i.is_multiple_of(2) { 3.0 } else { -3.0 };
            [side + 0.5 * rng.normal(), 0.5 * rng.normal()]
        };
        (0..n).flat_map(&mut point).collect()
    }

    #[test]
    fn at_most_the_share_asked_for_lies_outside_and_the_gap_between_islands_does() {
        let points = two_islands(200, 3);
        for nu in [0.05, 0.2] {
            let region = OneClass::fit(&points, 2, 400, nu);
            let outside = points.chunks_exact(2).filter(|z| region.distance(z).0 > 1.0 + 1e-3).count();
            // The property of nu: at most that share lies outside, and at least that share carries weight.
            assert!(outside <= (200.0 * nu) as usize, "{outside}");
            assert!(region.weights.len() >= (200.0 * nu) as usize, "{}", region.weights.len());
            assert!(region.distance(&[0.0, 0.0]).0 > 1.0);
            assert!(region.distance(&[3.0, 0.0]).0 < 1.0);
        }
    }

    #[test]
    fn gradient_is_that_of_differences_also_far_away() {
        let region = OneClass::fit(&two_islands(100, 4), 2, 400, 0.1);
        for z in [[0.3, 0.4], [3.5, -1.0], [200.0, 40.0]] {
            let (distance, gradient) = region.distance(&z);
            assert!(distance.is_finite());
            for j in 0..2 {
                let h = 1e-6 * (1.0 + z[j].abs());
                let (mut up, mut down) = (z, z);
                up[j] += h;
                down[j] -= h;
                let difference = (region.distance(&up).0 - region.distance(&down).0) / (2.0 * h);
                assert!(
                    (gradient[j] - difference).abs() < 1e-6 * (1.0 + difference.abs()),
                    "{gradient:?} {difference}"
                );
            }
        }
    }
}
