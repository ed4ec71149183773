//! How many facts a row of samples is: neighbours in time say nearly the same.

use std::ops::Range;

use statrs::distribution::{ContinuousCDF, StudentsT};

/// Integrated autocorrelation time of `residuals` in samples, `tau = 1 + 2 sum_k rho_k`, over the `segments` in which samples follow
/// each other: n samples are worth n / tau.
///
/// The sum ends at the first lag beyond five times what it has come to (A. Sokal, Monte Carlo methods in statistical mechanics, 1989,
/// section 3) or at the first correlation that is not positive; it is at least 1.
pub fn time_samples(residuals: &[f64], segments: &[Range<usize>]) -> f64 {
    time_and_window(residuals, segments).0
}

/// The same, and the greatest lag of the sum.
///
/// The estimate has a relative variance of `2 (2 window + 1) / n` (Sokal, section 3), as that of a variance with `n / (2 window + 1)`
/// degrees of freedom.
pub fn time_and_window(residuals: &[f64], segments: &[Range<usize>]) -> (f64, usize) {
    let n: usize = segments.iter().map(Range::len).sum();
    if n < 3 {
        return (1.0, 0);
    }
    let mean = segments.iter().flat_map(|s| &residuals[s.clone()]).sum::<f64>() / n as f64;
    let at = |lag: usize| -> f64 {
        segments
            .iter()
            .map(|s| {
                let r = &residuals[s.clone()];
                r.iter().zip(r.iter().skip(lag)).map(|(a, b)| (a - mean) * (b - mean)).sum::<f64>()
            })
            .sum()
    };
    let square = at(0);
    if !(square > 0.0) {
        return (1.0, 0);
    }
    let longest = segments.iter().map(Range::len).max().unwrap_or(0);
    let (mut tau, mut window) = (1.0, 0);
    for lag in 1..longest.min(n / 4 + 1) {
        let rho = at(lag) / square;
        if !(rho > 0.0) || lag as f64 > 5.0 * tau {
            break;
        }
        tau += 2.0 * rho;
        window = lag;
    }
    (tau, window)
}

/// Degrees of freedom of the variance of a sum over time: that of chi-squared with the mean and the variance of the squares of block sums
/// (F. E. Satterthwaite, An approximate distribution of estimates of variance components, Biometrics Bull. 2 (1946), 110-114). A few long
/// stretches that say the same make it small.
pub fn freedom(series: &[f64], segments: &[Range<usize>], block: usize) -> f64 {
    let block = block.max(1);
    let blocks = segments.iter().flat_map(|s| series[s.clone()].chunks(block));
    let squares: Vec<f64> = blocks.map(|b| b.iter().sum::<f64>().powi(2)).collect();
    let n = squares.len() as f64;
    let mean = squares.iter().sum::<f64>() / n;
    let variance = squares.iter().map(|s| (s - mean).powi(2)).sum::<f64>() / n;
    if mean > 0.0 && variance > 0.0 { 2.0 * mean * mean * n / variance } else { n }
}

/// Mean of a series, its standard error, and the independent measurements that it is worth. Samples hang together for as long as the series
/// says, and for `least` at least.
pub fn mean_and_error(v: &[f64], segments: &[Range<usize>], least: f64) -> (f64, f64, f64) {
    let n = v.len() as f64;
    if v.len() < 3 {
        return (0.0, 0.0, n / least.max(1.0));
    }
    let mean = v.iter().sum::<f64>() / n;
    let tau = time_samples(v, segments).max(least);
    let variance = v.iter().map(|x| (x - mean).powi(2)).sum::<f64>() / (n - 1.0);
    (mean, (variance * tau / n).sqrt(), n / tau)
}

/// One-sided 95 % of Student's distribution.
pub fn t_one_sided(freedom: f64) -> f64 {
    StudentsT::new(0.0, 1.0, freedom.max(1.0)).map_or(f64::INFINITY, |t| t.inverse_cdf(0.95))
}
