//! Correlation between inputs: inputs that move together cannot be told apart.
//!
//! ```text
//! r = cov(a, b) / (sigma_a sigma_b)                                  thesis eq. 2.45
//! r_a(l) = sum (a(t) - mean)(a(t - l) - mean) / sum (a(t) - mean)^2  thesis eq. 2.46
//! bound = 1.96 sqrt( sum_l r_a(l) r_b(l) / n ),  l = -L .. L
//! ```
//!
//! The bound holds for independent inputs that change slowly (M. S. Bartlett, J. R. Stat. Soc. 98 (1935) 536-543);
//! for white inputs it is 1.96 / sqrt(n). L is where the slower of the two autocorrelations has died out.

use dynocal_numerics::fft::RealDft;
use serde::Serialize;

/// Correlation of two inputs.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct InputCorrelation {
    /// One input.
    pub a: String,
    /// The other.
    pub b: String,
    /// At the same instant.
    pub r: f64,
    /// The largest in absolute value with either input later.
    pub r_max: f64,
    /// By how many samples `b` is later there; negative where it is earlier.
    pub lag: isize,
    /// 95 % bound of `r` for independent inputs with these autocorrelations.
    pub bound: f64,
}

/// Correlation of `a` and `b` at the lags up to `max_lag`; none for constants and fewer than three samples. Rows in
/// which one of them is missing are left out of every sum.
///
/// ```
/// use dynocal_ident::excitation::correlation::correlation;
/// let a: Vec<f64> = (0..100).map(|t| (0.05 * (t * t) as f64).sin()).collect();
/// let b: Vec<f64> = (0..100).map(|t| if t < 2 { 3.0 } else { 3.0 - 2.0 * a[t - 2] }).collect();
/// let c = correlation(("a", &a), ("b", &b), 5).unwrap();
/// assert!(c.lag == 2 && c.r_max < -0.95);
/// ```
pub fn correlation(a: (&str, &[f64]), b: (&str, &[f64]), max_lag: usize) -> Option<InputCorrelation> {
    let n = a.1.len().min(b.1.len());
    let known: Vec<bool> = (0..n).map(|t| !a.1[t].is_nan() && !b.1[t].is_nan()).collect();
    let count = known.iter().filter(|k| **k).count();
    if count < 3 {
        return None;
    }
    let centred = |v: &[f64]| -> Vec<f64> {
        let sum: f64 = (0..n).filter(|t| known[*t]).map(|t| v[t]).sum();
        (0..n).map(|t| if known[t] { v[t] - sum / count as f64 } else { 0.0 }).collect()
    };
    let (x, y) = (centred(a.1), centred(b.1));
    let (xx, yy) = (dot(&x, &x, 0), dot(&y, &y, 0));
    // A constant up to the rounding of its own size does not move.
    let size = |v: &[f64]| (0..n).filter(|t| known[*t]).map(|t| v[t] * v[t]).sum::<f64>();
    if xx <= 1e-24 * size(a.1) || yy <= 1e-24 * size(b.1) {
        return None;
    }
    let norm = (xx * yy).sqrt();
    let r = dot(&x, &y, 0) / norm;
    let (mut r_max, mut lag) = (r, 0);
    for l in 1..=max_lag.min(n - 1) {
        for (value, l) in [(dot(&y, &x, l) / norm, l as isize), (dot(&x, &y, l) / norm, -(l as isize))] {
            if value.abs() > r_max.abs() {
                (r_max, lag) = (value, l);
            }
        }
    }
    let white = 2.0 / (count as f64).sqrt();
    let (ra, rb) = (autocorrelation(&x), autocorrelation(&y));
    // From where both have died out on, what is left of them is noise.
    let died = (1..n / 4).find(|l| ra[*l].abs() < white && rb[*l].abs() < white);
    let sum = 1.0 + 2.0 * (1..died.unwrap_or(n / 4)).map(|l| ra[l] * rb[l]).sum::<f64>();
    let bound = 1.96 * (sum.max(1.0) / count as f64).sqrt();
    Some(InputCorrelation { a: a.0.into(), b: b.0.into(), r, r_max, lag, bound })
}

/// Equation 2.46 at all lags, by the transform of the power spectrum of the samples with as many zeros behind them.
fn autocorrelation(x: &[f64]) -> Vec<f64> {
    let size = (2 * x.len()).next_power_of_two();
    let dft = RealDft::new(size);
    let half: Vec<f64> = dft.transform(x).iter().map(|v| v.norm_sqr()).collect();
    // The spectrum is real and even, so that the same transform leads back.
    let power: Vec<f64> = (0..size).map(|k| half[k.min(size - k)]).collect();
    let r = dft.transform(&power);
    (0..x.len()).map(|l| r[l].re / r[0].re).collect()
}

/// `sum x(t) y(t - lag)`.
fn dot(x: &[f64], y: &[f64], lag: usize) -> f64 {
    dynocal_numerics::linalg::dot(&x[lag..], y)
}
