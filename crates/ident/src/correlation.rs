//! Correlations of residuals with themselves and with inputs, with bounds and test statistics.
//!
//! A model that explains everything leaves white residuals that are independent of all past inputs. For an output-error
//! (free-run) fit only the second must hold.
//!
//! Reference: L. Ljung, System Identification, 2nd ed. (1999), section 16.6; S. A. Billings, W. S. F. Voon, Int. J.
//! Control 44 (1986) 235-244.

use dynocal_numerics::linalg::{cholesky, dot, solve_upper_transposed};
use serde::{Deserialize, Serialize};
use statrs::distribution::ContinuousCDF;

/// Standard normal quantiles of two-sided 95 % and 99 %.
const Z_95: f64 = 1.96;
const Z_99: f64 = 2.576;

/// Normalised correlation of two series over lags with its bounds for independent series.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Correlation {
    /// Lags in samples.
    pub lags: Vec<usize>,
    /// Correlation coefficients; zero where a series does not move.
    pub values: Vec<f64>,
    /// 95 % bound `1.96 sqrt(P / n)`: P is 1 for an autocorrelation, and for two series
    /// `1 + 2 sum_k r_e(k) r_u(k)` (Ljung eq. 16.72), at least 1.
    pub bound: f64,
    /// 99 % bound, `2.576 sqrt(P / n)`.
    pub bound_99: f64,
    /// Share of the values (lag 0 of an autocorrelation left out) outside the 95 % bound.
    pub share_outside: f64,
}

/// Autocorrelation of residuals at the lags 0 to `max_lag`.
pub fn autocorrelation(e: &[f64], max_lag: usize) -> Correlation {
    bounded(coefficients(e, e, max_lag), e.len(), 1.0, 1)
}

/// Correlation of residuals e(t) with past inputs u(t - lag), lags 0 to `max_lag`.
pub fn cross_correlation(e: &[f64], u: &[f64], max_lag: usize) -> Correlation {
    let n = e.len().min(u.len());
    let (own, drive) = (coefficients(e, e, max_lag), coefficients(u, u, max_lag));
    let p = 1.0 + 2.0 * own.iter().zip(&drive).skip(1).map(|(a, b)| a * b).sum::<f64>();
    bounded(coefficients(e, u, max_lag), n, p.max(1.0), 0)
}

/// `sum_t a(t) b(t - lag)` of the centred series over the product of their norms.
fn coefficients(a: &[f64], b: &[f64], max_lag: usize) -> Vec<f64> {
    let n = a.len().min(b.len());
    let centred = |v: &[f64]| -> Vec<f64> {
        let mean = v[..n].iter().sum::<f64>() / n as f64;
        v[..n].iter().map(|x| x - mean).collect()
    };
    let (a, b) = (centred(a), centred(b));
    let norm = (dot(&a, &a) * dot(&b, &b)).sqrt();
    let scale = if norm > 0.0 { 1.0 / norm } else { 0.0 };
    (0..=max_lag.min(n.saturating_sub(1))).map(|lag| scale * dot(&a[lag.min(n)..], &b)).collect()
}

fn bounded(values: Vec<f64>, n: usize, p: f64, first_tested: usize) -> Correlation {
    let unit = (p / n as f64).sqrt();
    let bound = Z_95 * unit;
    let tested = &values[first_tested.min(values.len())..];
    let outside = tested.iter().filter(|v| v.abs() > bound).count();
    let share_outside = if tested.is_empty() { 0.0 } else { outside as f64 / tested.len() as f64 };
    Correlation { lags: (0..values.len()).collect(), values, bound, bound_99: Z_99 * unit, share_outside }
}

/// A statistic that is chi-square distributed when the hypothesis (white, independent) holds.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct ChiSquared {
    /// Its value.
    #[serde(deserialize_with = "crate::nullable::number")]
    pub statistic: f64,
    /// Degrees of freedom.
    pub degrees: usize,
    /// Probability of a larger value when the hypothesis holds; below 0.01 it is rejected at 99 %.
    #[serde(deserialize_with = "crate::nullable::number")]
    pub p_value: f64,
}

impl ChiSquared {
    fn new(statistic: f64, degrees: usize) -> Self {
        let law = statrs::distribution::ChiSquared::new(degrees as f64);
        let p_value = law.map_or(f64::NAN, |l| if statistic.is_nan() { f64::NAN } else { l.sf(statistic) });
        Self { statistic, degrees, p_value }
    }
}

/// Whiteness of residuals (Ljung and Box):
///
/// ```text
/// Q = n (n + 2) sum_{k=1..lags} r(k)^2 / (n - k),     chi-square with lags - fitted degrees of freedom
/// ```
///
/// `fitted` is the number of noise-model parameters that were fitted to the same series (0 for other data).
pub fn whiteness(e: &[f64], lags: usize, fitted: usize) -> ChiSquared {
    let n = e.len() as f64;
    let r = coefficients(e, e, lags);
    let sum: f64 = r.iter().enumerate().skip(1).map(|(k, r)| r * r / (n - k as f64)).sum();
    ChiSquared::new(n * (n + 2.0) * sum, r.len().saturating_sub(1 + fitted))
}

/// Independence of (white) residuals and the inputs of the `lags` last samples, all lags together:
///
/// ```text
/// n r' R_u^-1 r,    r(k) = sum e(t) u(t-k) / sqrt(sum e^2 sum u^2),  k = 0 .. lags-1,    R_u: autocorrelations of u
/// ```
///
/// chi-square with `lags` degrees of freedom (Ljung eq. 16.71). NaN for an input whose lags are dependent.
pub fn independence(e: &[f64], u: &[f64], lags: usize) -> ChiSquared {
    let n = e.len().min(u.len());
    let r = coefficients(e, u, lags.saturating_sub(1));
    let m = r.len();
    let own = coefficients(u, u, m.saturating_sub(1));
    let mut gram: Vec<f64> = (0..m * m).map(|i| own[(i / m).abs_diff(i % m)]).collect();
    if cholesky(&mut gram, m).is_err() {
        return ChiSquared::new(f64::NAN, m);
    }
    // R_u = R'R: r' R_u^-1 r = |R^-T r|^2.
    let mut z = r;
    if solve_upper_transposed(&gram, m, &mut z).is_err() {
        return ChiSquared::new(f64::NAN, m);
    }
    ChiSquared::new(n as f64 * dot(&z, &z), m)
}

/// A correlation and what it is of.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct NamedCorrelation {
    /// `e,e u`: e(t) with e(t-1-lag) u(t-1-lag), `u^2,e`: u(t-lag)^2 with e(t), `u^2,e^2`: u(t-lag)^2 with e(t)^2.
    pub name: String,
    /// The correlation.
    pub correlation: Correlation,
}

/// Tests of nonlinear models that linear correlations cannot replace: products of residual and input, squared inputs
/// (Billings and Voon). All lie inside their bounds when nothing that u could predict is left in e.
pub fn nonlinear_tests(e: &[f64], u: &[f64], max_lag: usize) -> Vec<NamedCorrelation> {
    let n = e.len().min(u.len());
    if n < 2 {
        return Vec::new();
    }
    let (e, u) = (&e[..n], &u[..n]);
    let mean = u.iter().sum::<f64>() / n as f64;
    let u: Vec<f64> = u.iter().map(|v| v - mean).collect();
    let product: Vec<f64> = e.iter().zip(&u).map(|(e, u)| e * u).collect();
    let squares = |v: &[f64]| -> Vec<f64> { v.iter().map(|x| x * x).collect() };
    let named = |name: &str, correlation| NamedCorrelation { name: name.into(), correlation };
    vec![
        named("e,e u", cross_correlation(&e[1..], &product[..n - 1], max_lag)),
        named("u^2,e", cross_correlation(e, &squares(&u), max_lag)),
        named("u^2,e^2", cross_correlation(&squares(e), &squares(&u), max_lag)),
    ]
}
