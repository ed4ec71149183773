//! When to stop testing: the reduction of the prediction error that a further minute is worth.
//!
//! With held-out mean squared errors E_k after stages k = 1..n and the relative variances
//! `v_k = tr(M_k^-1 W) / N0` (M_k the sensitivities' Gram matrix of all records so far, W that of an objective signal of
//! N0 samples; the V criterion at unit noise),
//!
//! ```text
//! E_k = floor + c v_k + e_k,     var e_k = 2 (c v_k)^2 / p
//! ```
//!
//! floor holds the noise of the held-out records and the error of the structure, c the variance of what the structure
//! does not explain. Both are fitted to the history by weighted least squares; because a short history says
//! little about c, the variance of the identification residuals stands as one more observation of it. A planned record
//! gives `v_(n+1)` before it is measured, hence the expected reduction `c (v_n - v_(n+1))`.

use serde::{Deserialize, Serialize};

use super::LoopError;

/// One finished stage of a campaign.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Stage {
    /// Mean squared error on held-out records.
    pub held_out: f64,
    /// Relative variance v of the predictions.
    pub variance: f64,
    /// Variance of the identification residuals.
    pub residual: f64,
    /// Number of parameters p.
    pub parameters: usize,
}

/// What a further record is expected to be worth.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Forecast {
    /// Error that more of the same test cannot remove: noise of the held-out records and structure.
    pub floor: f64,
    /// Fitted factor c.
    pub factor: f64,
    /// Expected reduction of the mean squared error by the planned record.
    pub reduction: f64,
    /// The same as a share of the present error without the noise of the held-out records, where that is known.
    pub relative: f64,
    /// Whether the share is below the threshold.
    pub stop: bool,
}

/// Relative standard deviation of the residual variance as an observation of c: unmodelled dynamics make it up to half
/// too small or too large.
const RESIDUAL_SPREAD: f64 = 0.3;

/// Expected worth of a planned record whose information brings the relative variance to `planned`.
///
/// `noise` is the variance of the measurement noise of the held-out records where it is known, else 0; `threshold`
/// the share of the present error (without that noise) below which testing on does not pay.
///
/// # Errors
/// [`LoopError::Shape`] for an empty history; [`LoopError::Number`] for a number that makes no sense.
///
/// ```
/// use dynocal_calib::loops::stop::{Stage, forecast};
/// // Errors that follow 1 + 4 v exactly, and residuals that say 4.
/// let stage = |v: f64| Stage { held_out: 1.0 + 4.0 * v, variance: v, residual: 4.0, parameters: 6 };
/// let found = forecast(&[stage(0.1), stage(0.05), stage(0.033)], 0.025, 1.0, 0.5)?;
/// assert!((found.reduction - 4.0 * (0.033 - 0.025)).abs() < 1e-12 && found.stop);
/// # Ok::<(), dynocal_calib::loops::LoopError>(())
/// ```
pub fn forecast(history: &[Stage], planned: f64, noise: f64, threshold: f64) -> Result<Forecast, LoopError> {
    let Some(last) = history.last() else {
        return Err(LoopError::Shape { what: "stages of a campaign", found: 0, expected: 1 });
    };
    let positive = |v: f64| v.is_finite() && v > 0.0;
    for s in history {
        if !(positive(s.variance) && positive(s.held_out) && positive(s.residual) && s.parameters > 0) {
            let what = "variance, error or residual of a stage";
            return Err(LoopError::Number { what, found: s.variance, expected: "positive numbers" });
        }
    }
    if !(planned.is_finite() && planned >= 0.0) {
        return Err(LoopError::Number { what: "planned variance", found: planned, expected: "0 or more" });
    }
    let (floor, factor) = fit(history, last.residual);
    let reduction = factor * (last.variance - planned).max(0.0);
    let present = (floor - noise).max(0.0) + factor * last.variance;
    let relative = reduction / present;
    Ok(Forecast { floor, factor, reduction, relative, stop: relative < threshold })
}

/// Weighted least squares of `E = floor + c v` with the residual variance as an observation of c; neither below zero.
fn fit(history: &[Stage], residual: f64) -> (f64, f64) {
    let prior = 1.0 / (RESIDUAL_SPREAD * residual).powi(2);
    let (mut s0, mut s1, mut s2, mut t0, mut t1) = (0.0, 0.0, prior, 0.0, prior * residual);
    for s in history {
        let weight = s.parameters as f64 / (2.0 * (residual * s.variance).powi(2));
        s0 += weight;
        s1 += weight * s.variance;
        s2 += weight * s.variance * s.variance;
        t0 += weight * s.held_out;
        t1 += weight * s.variance * s.held_out;
    }
    let factor = ((s0 * t1 - s1 * t0) / (s0 * s2 - s1 * s1)).max(0.0);
    (((t0 - s1 * factor) / s0).max(0.0), factor)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn stage(held_out: f64, variance: f64) -> Stage {
        Stage { held_out, variance, residual: 2.0, parameters: 10 }
    }

    /// One stage says nothing about c: the residuals do.
    #[test]
    fn a_single_stage_takes_the_residual_variance() {
        let found = forecast(&[stage(3.0, 0.2)], 0.1, 0.0, 0.1).unwrap();
        assert!((found.factor - 2.0).abs() < 1e-12 && (found.floor - 2.6).abs() < 1e-12, "{found:?}");
        // 0.2 of 3.0: below a tenth, above a twentieth.
        assert!((found.reduction - 0.2).abs() < 1e-12 && found.stop);
        assert!(!forecast(&[stage(3.0, 0.2)], 0.1, 0.0, 0.05).unwrap().stop);
    }

    /// A long exact history outweighs a wrong residual variance, in proportion to its spread.
    #[test]
    fn a_long_history_moves_the_factor_from_the_residuals_to_the_data() {
        let history: Vec<Stage> = (1..40).map(|k| stage(1.0 + 5.0 / k as f64, 1.0 / k as f64)).collect();
        let found = forecast(&history, 0.0, 0.0, 0.1).unwrap();
        assert!(found.factor > 3.0 && found.factor < 5.0, "{found:?}");
    }

    /// Errors that rise with more data give no reduction, not a negative one.
    #[test]
    fn nothing_is_promised_against_the_evidence() {
        let history: Vec<Stage> = (1..200).map(|k| stage(1.0 + 0.5 * k as f64, 1.0 / k as f64)).collect();
        let found = forecast(&history, 0.0, 0.0, 0.1).unwrap();
        assert!(found.factor >= 0.0 && found.reduction >= 0.0 && found.stop, "{found:?}");
    }

    #[test]
    fn wrong_numbers_are_refused() {
        assert!(matches!(forecast(&[], 0.1, 0.0, 0.1), Err(LoopError::Shape { .. })));
        assert!(matches!(forecast(&[stage(1.0, 0.0)], 0.1, 0.0, 0.1), Err(LoopError::Number { .. })));
        assert!(matches!(forecast(&[stage(1.0, 0.1)], f64::NAN, 0.0, 0.1), Err(LoopError::Number { .. })));
    }
}
