//! A smooth surface through points over the two axes of a table.
//!
//! ```text
//! s(x) = sum_k a_k k(x, x_k),      (K + q I) a = y,      k(x, z) = c + exp(-|x - z|^2 / (2 l^2))
//! ```
//!
//! the mean of a Gaussian process of amplitude one about a level that is as good as unknown (c), noise q. Of the lengths l and noises of
//! a grid that pair is taken which predicts each point best from the others (`y_k - s_k = a_k / ((K + q I)^-1)_kk`).
//!
//! C. E. Rasmussen, C. K. I. Williams, Gaussian Processes for Machine Learning (2006), sections 2.2 and 5.4.2.

use dynocal_numerics::linalg;

/// Lengths in the scaled axes, whose ranges are 2 wide, and noises over the amplitude.
const LENGTHS: [f64; 5] = [0.35, 0.5, 0.7, 1.0, 1.4];
const NOISES: [f64; 5] = [1e-4, 1e-3, 1e-2, 1e-1, 1.0];

/// Variance of the level, over the amplitude.
const LEVEL: f64 = 100.0;

/// A surface over two scaled axes.
#[derive(Clone, Debug)]
pub(super) struct Surface {
    places: Vec<[f64; 2]>,
    weights: Vec<f64>,
    length: f64,
}

fn kernel(a: [f64; 2], b: [f64; 2], length: f64) -> f64 {
    let d2 = (a[0] - b[0]).powi(2) + (a[1] - b[1]).powi(2);
    LEVEL + (-0.5 * d2 / (length * length)).exp()
}

impl Surface {
    /// Through `y` at `places`, and the sum over the points of `miss(k, s_k)^2`, s_k what the others say of point k; none where no surface
    /// can be had.
    pub(super) fn through(
        places: &[[f64; 2]],
        y: &[f64],
        miss: impl Fn(usize, f64) -> f64,
    ) -> Option<(Self, f64)> {
        let mut best: Option<(Self, f64)> = None;
        // Amplitudes and noises are of values of unit size.
        let level = y.iter().sum::<f64>() / y.len().max(1) as f64;
        let size = (y.iter().map(|v| (v - level).powi(2)).sum::<f64>() / y.len().max(1) as f64).sqrt();
        if !(size > 0.0 && size.is_finite()) {
            return None;
        }
        let unit: Vec<f64> = y.iter().map(|v| v / size).collect();
        for length in LENGTHS {
            for noise in NOISES {
                let Some((mut weights, missed)) = weighed(places, &unit, length, noise) else { continue };
                let said = missed.iter().zip(y).map(|(e, y)| y - e * size);
                let left: f64 = said.enumerate().map(|(k, s)| miss(k, s).powi(2)).sum();
                if left.is_finite() && best.as_ref().is_none_or(|b| left < b.1) {
                    weights.iter_mut().for_each(|w| *w *= size);
                    best = Some((Self { places: places.to_vec(), weights, length }, left));
                }
            }
        }
        best
    }

    pub(super) fn at(&self, x: [f64; 2]) -> f64 {
        self.places.iter().zip(&self.weights).map(|(p, a)| a * kernel(x, *p, self.length)).sum()
    }
}

/// Weights of the points, and errors of all points, each predicted by the others.
fn weighed(places: &[[f64; 2]], y: &[f64], length: f64, noise: f64) -> Option<(Vec<f64>, Vec<f64>)> {
    let n = places.len();
    let mut factor = vec![0.0; n * n];
    for i in 0..n {
        for j in i..n {
            factor[i * n + j] = kernel(places[i], places[j], length);
        }
        factor[i * n + i] += noise;
    }
    linalg::cholesky(&mut factor, n).ok()?;
    let (mut work, mut inverse) = (vec![0.0; n * n], vec![0.0; n * n]);
    linalg::cholesky_inverse(&factor, n, &mut work, &mut inverse).ok()?;
    // Its upper triangle is there.
    let of = |i: usize, j: usize| inverse[i.min(j) * n + i.max(j)];
    let weights: Vec<f64> = (0..n).map(|i| (0..n).map(|j| of(i, j) * y[j]).sum()).collect();
    let missed = weights.iter().enumerate().map(|(k, a)| a / of(k, k)).collect();
    Some((weights, missed))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn grid() -> Vec<[f64; 2]> {
        (0..25).map(|k| [f64::from(k / 5) * 0.5 - 1.0, f64::from(k % 5) * 0.5 - 1.0]).collect()
    }

    /// A bend is found between the points; the error of a point left out is that of a fit without it.
    #[test]
    fn a_bend_is_found_between_the_points() {
        let bend = |x: [f64; 2]| (2.0 * x[0]).tanh() * (1.0 + 0.5 * x[1]);
        let y: Vec<f64> = grid().iter().map(|x| bend(*x)).collect();
        let (surface, _) = Surface::through(&grid(), &y, |k, s| y[k] - s).unwrap();
        for x in [[-0.75, 0.3], [0.25, -0.6], [0.6, 0.8]] {
            assert!((surface.at(x) - bend(x)).abs() < 0.05, "{x:?}: {} {}", surface.at(x), bend(x));
        }
        let (_, missed) = weighed(&grid(), &y, 1.0, 0.01).unwrap();
        for k in 0..25 {
            let (mut places, mut rest) = (grid(), y.clone());
            places.remove(k);
            rest.remove(k);
            let (weights, _) = weighed(&places, &rest, 1.0, 0.01).unwrap();
            let without = y[k] - Surface { places, weights, length: 1.0 }.at(grid()[k]);
            assert!((missed[k] - without).abs() < 1e-9, "{k}: {} {without}", missed[k]);
        }
    }
}
