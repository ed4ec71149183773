//! Means, medians and standard errors of populations.

use serde::{Deserialize, Serialize};

/// A population in numbers.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Stat {
    /// Members.
    pub n: usize,
    /// Mean.
    pub mean: f64,
    /// Standard error of the mean.
    pub se: f64,
    /// Median.
    pub median: f64,
    /// 2.5 % quantile (nearest rank).
    pub low: f64,
    /// 97.5 % quantile (nearest rank).
    pub high: f64,
}

impl Stat {
    /// Statistics of `values`; none when there are fewer than two or one is not finite.
    ///
    /// ```
    /// let s = dynocal_studies::chapter4::work::statistics::Stat::of(&[1.0, 2.0, 3.0, 6.0]).unwrap();
    /// assert_eq!((s.mean, s.median), (3.0, 2.5));
    /// assert!((s.se - (14.0f64 / 3.0 / 4.0).sqrt()).abs() < 1e-15);
    /// ```
    pub fn of(values: &[f64]) -> Option<Self> {
        let n = values.len();
        if n < 2 || values.iter().any(|v| !v.is_finite()) {
            return None;
        }
        let mean = values.iter().sum::<f64>() / n as f64;
        let se = variance_of_mean(values).sqrt();
        let mut sorted = values.to_vec();
        sorted.sort_by(f64::total_cmp);
        let quantile = |q: f64| sorted[((q * n as f64).ceil() as usize).clamp(1, n) - 1];
        Some(Self { n, mean, se, median: median(values)?, low: quantile(0.025), high: quantile(0.975) })
    }
}

/// Median; none of nothing.
pub fn median(values: &[f64]) -> Option<f64> {
    let mut v = values.to_vec();
    v.sort_by(f64::total_cmp);
    let n = v.len();
    if n == 0 { None } else { Some(0.5 * (v[(n - 1) / 2] + v[n / 2])) }
}

/// Mean and standard error of crossed scores r(i, j) of models i on validation signals j (row-major).
///
/// ```text
/// se^2 = var_i(mean_j r) / n + var_j(mean_i r) / m
/// ```
///
/// Both the models and the validation signals are samples of their kinds; the variance of the interaction enters both
/// terms, so that the error is not understated.
pub fn crossed(scores: &[f64], m: usize) -> (f64, f64) {
    let n = scores.len() / m;
    let rows: Vec<f64> = scores.chunks_exact(m).map(|r| r.iter().sum::<f64>() / m as f64).collect();
    let columns: Vec<f64> =
        (0..m).map(|j| scores.iter().skip(j).step_by(m).sum::<f64>() / n as f64).collect();
    let mean = rows.iter().sum::<f64>() / n as f64;
    (mean, (variance_of_mean(&rows) + variance_of_mean(&columns)).sqrt())
}

fn variance_of_mean(v: &[f64]) -> f64 {
    let n = v.len() as f64;
    let mean = v.iter().sum::<f64>() / n;
    v.iter().map(|x| (x - mean).powi(2)).sum::<f64>() / (n - 1.0) / n
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Additive scores a_i + b_j: the two variances add exactly.
    #[test]
    fn crossed_scores_count_models_and_signals() {
        let (a, b) = ([1.0, 3.0, 8.0], [0.0, 2.0, 10.0, 4.0]);
        let scores: Vec<f64> = a.iter().flat_map(|x| b.iter().map(move |y| x + y)).collect();
        let (mean, se) = crossed(&scores, 4);
        assert!((mean - 8.0).abs() < 1e-14);
        let expected = 13.0 / 3.0 + (56.0 / 3.0) / 4.0;
        assert!((se * se - expected).abs() < 1e-12, "{} {expected}", se * se);
    }

    #[test]
    fn a_population_with_a_value_that_is_not_a_number_has_no_statistics() {
        assert_eq!(Stat::of(&[1.0, f64::INFINITY]), None);
        assert_eq!(Stat::of(&[1.0]), None);
        assert_eq!(median(&[3.0, 1.0, 2.0]), Some(2.0));
    }
}
