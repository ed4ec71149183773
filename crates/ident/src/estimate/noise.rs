//! What the errors of a fit look like: whiteness, an autoregressive description, the number of independent samples, and
//! which kind of noise they speak for.
//!
//! ```text
//! c(k) = mean of e(t) e(t-k)                         over pairs of scored samples of one record, about zero
//! Q = n (n+2) sum_k (c(k)/c(0))^2 / (n-k)            Ljung-Box, chi-squared with as many degrees as lags
//! e(t) = sum_j a_j e(t-j) + w(t), var w = v          Yule-Walker, order by AIC
//! n_eff = n c(0) A(1)^2 / v                          c(0) over the spectrum at frequency zero
//! ```
//!
//! Reference: G. M. Ljung, G. E. P. Box, Biometrika 65 (1978); thesis section 2.6.2 for the correlation tests.

use dynocal_numerics::linalg::dot;
use dynocal_numerics::status::Status;
use serde::{Deserialize, Serialize};
use statrs::distribution::{ChiSquared, ContinuousCDF};

use super::Minimised;
use crate::experiment::Experiment;
use crate::model::Model;

/// Chance to call white errors coloured.
const FALSE_ALARM: f64 = 0.001;
/// Share of the errors' variance that their own past predicts below which colour is of no consequence.
const NEGLIGIBLE: f64 = 0.02;
/// The same above which the kind of noise is worth a sentence.
const NOTABLE: f64 = 0.1;
/// Most coefficients of the autoregressive description.
const MOST_ORDER: usize = 40;

/// Whether the errors of a fit are white, and what follows.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(default)]
pub struct Residuals {
    /// Ljung-Box statistic over its degrees of freedom: about 1 for white errors.
    #[serde(deserialize_with = "crate::nullable::number")]
    pub whiteness: f64,
    /// Its degrees of freedom.
    pub lags: usize,
    /// Probability of a larger statistic with white errors.
    #[serde(deserialize_with = "crate::nullable::number")]
    pub p_value: f64,
    /// Autocorrelation at one lag.
    #[serde(deserialize_with = "crate::nullable::number")]
    pub lag_one: f64,
    /// Share of the variance that the errors' own past predicts.
    #[serde(deserialize_with = "crate::nullable::number")]
    pub predictable: f64,
    /// Number of independent samples that would give the same accuracy of a mean; at most the scored ones.
    #[serde(deserialize_with = "crate::nullable::number")]
    pub effective_samples: f64,
    /// Whether the errors are taken as coloured: significant and of consequence.
    pub coloured: bool,
}

/// An autoregressive description `e(t) = sum_j a_j e(t-j) + w(t)`.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Autoregression {
    /// Coefficients.
    pub(super) a: Vec<f64>,
    /// Variance of w.
    pub(super) variance: f64,
}

/// Autocovariances about zero at the lags `0..=max_lag` over all records; a zero is a sample that is not scored.
pub(super) fn autocovariance<'a>(
    records: impl Iterator<Item = &'a [f64]> + Clone,
    max_lag: usize,
) -> Vec<f64> {
    let (mut sums, mut pairs) = (vec![0.0; max_lag + 1], vec![0usize; max_lag + 1]);
    for e in records {
        let e = &e[e.iter().position(|v| *v != 0.0).unwrap_or(e.len())..];
        let gaps = e.contains(&0.0);
        for lag in 0..(max_lag + 1).min(e.len()) {
            sums[lag] += dot(&e[lag..], e);
            pairs[lag] += if gaps {
                e[lag..].iter().zip(e).filter(|(a, b)| **a != 0.0 && **b != 0.0).count()
            } else {
                e.len() - lag
            };
        }
    }
    sums.iter().zip(&pairs).map(|(sum, pairs)| sum / (*pairs).max(1) as f64).collect()
}

/// Yule-Walker by Levinson's recursion, order by AIC, from the autocovariances of `n` samples.
///
/// The covariances are tapered to those of a sequence that can be (divided by n instead of by the pairs), so that the
/// description is stable.
pub(super) fn autoregression(c: &[f64], n: usize) -> Autoregression {
    let taper = |k: usize| c[k] * (n.saturating_sub(k)) as f64 / n.max(1) as f64;
    let mut best = Autoregression { a: Vec::new(), variance: c[0] };
    let mut best_aic = n as f64 * c[0].ln();
    let (mut a, mut variance): (Vec<f64>, f64) = (Vec::new(), c[0]);
    for order in 1..c.len() {
        if variance.is_nan() || variance <= 0.0 {
            break;
        }
        let known: f64 = a.iter().enumerate().map(|(j, a)| a * taper(order - 1 - j)).sum();
        let reflection = (taper(order) - known) / variance;
        if reflection.is_nan() || reflection.abs() >= 1.0 {
            break;
        }
        let mirrored: Vec<f64> = a.iter().rev().copied().collect();
        a.iter_mut().zip(&mirrored).for_each(|(x, m)| *x -= reflection * m);
        a.push(reflection);
        variance *= 1.0 - reflection * reflection;
        let aic = n as f64 * variance.ln() + 2.0 * order as f64;
        if aic < best_aic {
            (best, best_aic) = (Autoregression { a: a.clone(), variance }, aic);
        }
    }
    best
}

/// Describes the errors of all records (zero where a sample is not scored) and tests them for whiteness.
pub(super) fn describe<'a>(records: impl Iterator<Item = &'a [f64]> + Clone) -> (Residuals, Autoregression) {
    let n: usize = records.clone().flatten().filter(|v| **v != 0.0).count();
    let longest = records.clone().map(<[f64]>::len).max().unwrap_or(0);
    // 10 log10 n lags for the description, as is usual; a quarter of them at least 10 for the test.
    let order = ((10.0 * (n.max(2) as f64).log10()) as usize).min(MOST_ORDER).min(longest / 4);
    let c = autocovariance(records, order);
    let size = n as f64;
    if !(c[0] > 0.0 && c[0].is_finite()) || order == 0 {
        let residuals = Residuals { p_value: 1.0, effective_samples: size, ..Residuals::default() };
        return (residuals, Autoregression { a: Vec::new(), variance: c[0].max(0.0) });
    }
    let lags = order.min(20);
    let q: f64 =
        (1..=lags).map(|k| (c[k] / c[0]).powi(2) / (size - k as f64)).sum::<f64>() * size * (size + 2.0);
    let p_value = ChiSquared::new(lags as f64).map_or(f64::NAN, |d| d.sf(q));
    let ar = autoregression(&c, n);
    let gain = 1.0 - ar.a.iter().sum::<f64>();
    let predictable = 1.0 - ar.variance / c[0];
    let residuals = Residuals {
        whiteness: q / lags as f64,
        lags,
        p_value,
        lag_one: c[1] / c[0],
        predictable,
        effective_samples: (size * c[0] * gain * gain / ar.variance).min(size),
        coloured: p_value < FALSE_ALARM && predictable > NEGLIGIBLE,
    };
    (residuals, ar)
}

/// How much less a fit of p parameters may make its own cost than the truth has it, in `p` over the effective number of
/// errors (their colour allowed for): least squares within that is as good.
const GAIN: f64 = 4.0;

/// A sentence when the errors speak for the other kind of noise than the one that the fit assumes: the free-run errors of
/// a system with equation noise are coloured and its one-step errors white, with output noise it is the other way round.
///
/// A structure that misses some of the system looks like equation noise too. `rival` tells the two apart: the free-run cost
/// of least squares over that of the fit. Least squares is consistent under equation noise and biased by a wrong structure.
pub(super) fn noise_warning(
    model: &dyn Model,
    theta: &[f64],
    data: &[Experiment],
    minimised: Minimised,
    own: &Residuals,
    rival: Option<f64>,
) -> Option<String> {
    if model.output_lag() == 0 || !own.coloured || own.predictable < NOTABLE {
        return None;
    }
    let other = other_errors(model, theta, data, minimised)?;
    let square = |v: &[f64]| v.iter().map(|x| x * x).sum::<f64>();
    let output: f64 = data.iter().map(|e| square(&e.y)).sum();
    // The colour of rounding says nothing.
    if other.iter().map(|e| square(e)).sum::<f64>() <= 1e-20 * output {
        return None;
    }
    let (other, _) = describe(other.iter().map(Vec::as_slice));
    let percent = |r: &Residuals| (100.0 * r.predictable).round();
    if other.predictable > 0.5 * own.predictable {
        return Some(format!(
            "the errors are coloured (their own past predicts {}% of their variance): noise with dynamics of its own, or \
             a structure that misses some of the system's; standard errors allow for the colour, not for what is missing",
            percent(own)
        ));
    }
    Some(match minimised {
        Minimised::FreeRun => {
            let seen = format!(
                "the past of the free-run errors predicts {}% of their variance, that of the one-step errors {}%",
                percent(own),
                percent(&other)
            );
            match rival {
                Some(r) if r <= 1.0 + GAIN * theta.len() as f64 / own.effective_samples.max(1.0) => format!(
                    "{seen}: equation noise; least squares (`ols`) was compared, its free-run error is {:.2} times as large, and \
                     its parameters are more exact",
                    r.sqrt()
                ),
                Some(r) if r.is_finite() => format!(
                    "{seen}: as equation noise does, or a structure that misses some of the system (inputs, lags, products); least \
                     squares was compared, its free-run error is {:.2} times as large, which speaks for the structure",
                    r.sqrt()
                ),
                Some(_) => format!(
                    "{seen}: a structure that misses some of the system (inputs, lags, products); least squares was compared, its \
                     free run diverges"
                ),
                None => format!(
                    "{seen}: equation noise, or a structure that misses some of the system (inputs, lags, products)"
                ),
            }
        }
        Minimised::OneStep => format!(
            "one-step method, but the residuals look like output noise (one-step errors predict {}% of their own \
             variance, free-run errors {}%): the parameters are biased, simulation error (`sem`) or an OE model would \
             not be",
            percent(own),
            percent(&other)
        ),
    })
}

/// Errors of the kind that was not minimised, zero where not scored; `None` when a free run diverges.
fn other_errors(
    model: &dyn Model,
    theta: &[f64],
    data: &[Experiment],
    minimised: Minimised,
) -> Option<Vec<Vec<f64>>> {
    let of = |e: &Experiment| {
        let run = e.run(model);
        let mut y = vec![0.0; e.len()];
        match minimised {
            Minimised::FreeRun => model.predict(theta, &run, &mut y),
            Minimised::OneStep if model.simulate(theta, &run, &mut y) != Status::Converged => return None,
            Minimised::OneStep => {}
        }
        for (t, v) in y.iter_mut().enumerate() {
            let error = e.weight(t).sqrt() * (*v - e.y[t]);
            *v = if t < run.start || error.is_nan() { 0.0 } else { error };
        }
        Some(y)
    };
    data.iter().map(of).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use dynocal_numerics::rng::Rng64;

    fn ar1(n: usize, a: f64, seed: u64) -> Vec<f64> {
        let mut rng = Rng64::new(seed);
        let mut e = vec![rng.normal() / (1.0 - a * a).sqrt(); n];
        (1..n).for_each(|t| e[t] = a * e[t - 1] + rng.normal());
        e
    }

    /// e(t) = 0.8 e(t-1) + w(t): coefficient 0.8, 64 % of the variance predictable, n_eff = n (1-0.8)/(1+0.8).
    #[test]
    fn a_first_order_process_is_described() {
        let e = ar1(20_000, 0.8, 1);
        let (r, ar) = describe(std::iter::once(e.as_slice()));
        assert!((ar.a[0] - 0.8).abs() < 0.03 && (ar.variance - 1.0).abs() < 0.05, "{ar:?}");
        assert!((r.predictable - 0.64).abs() < 0.03 && (r.lag_one - 0.8).abs() < 0.02, "{r:?}");
        assert!((r.effective_samples / 20_000.0 - 1.0 / 9.0).abs() < 0.03, "{r:?}");
        assert!(r.coloured && r.p_value < 1e-6);
    }

    /// The test keeps its level: at most a few false alarms at 5 % among 400 white records (20 expected, 4.4 the spread).
    #[test]
    fn white_errors_are_called_coloured_as_rarely_as_stated() {
        let alarms = (0..400).filter(|seed| {
            let e = ar1(500, 0.0, 1000 + seed);
            let (r, _) = describe(std::iter::once(e.as_slice()));
            assert!(!r.coloured || r.p_value < 0.001);
            r.p_value < 0.05
        });
        let alarms = alarms.count();
        assert!((6..=38).contains(&alarms), "{alarms} of 400 at 5 %");
    }

    /// Records are not glued together: the same values cut in many records have no correlation across the cuts.
    #[test]
    fn records_and_gaps_are_kept_apart() {
        let e = [1.0, 1.0, -1.0, -1.0];
        let c = autocovariance([&e[..2], &e[2..]].into_iter(), 1);
        assert_eq!(c, vec![1.0, 1.0]);
        // A sample that is not scored takes its pairs out.
        let c = autocovariance(std::iter::once([1.0, 0.0, 1.0, 1.0].as_slice()), 1);
        assert_eq!(c, vec![1.0, 1.0]);
    }

    #[test]
    fn errors_of_zero_and_very_short_records_are_no_fault() {
        for e in [vec![0.0; 50], vec![1.0; 2], Vec::new()] {
            let (r, ar) = describe(std::iter::once(e.as_slice()));
            assert!(!r.coloured && ar.a.is_empty(), "{r:?}");
        }
    }
}
