//! Whether a new table is taken, on samples that it was not fitted to.

use serde::{Deserialize, Serialize};

use super::Used;
use crate::correlation;
use crate::label::Label;
use crate::linear::Fit;

/// What is done with a table.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Decision {
    /// It explains unseen samples better: take it.
    Change,
    /// The logs do not show that the table is wrong, or unseen samples no difference: leave it as it is.
    Keep,
    /// It explains unseen samples worse: it must not be used.
    Refuse,
}

/// Numbers on unseen samples.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Judgement {
    /// What is done.
    pub decision: Decision,
    /// Unseen samples whose cells were fitted.
    pub samples: usize,
    /// Unseen samples that are left out because they lie in cells without data.
    pub unknown: usize,
    /// Root mean square of measured over expected lambda less 1, with the table as it was.
    pub rms_before: f64,
    /// The same with the new table.
    pub rms_after: f64,
    /// The same with the mean of the nearest cell, what tuning tools do.
    pub rms_nearest: f64,
    /// Improvement of the squared share over its standard error, correlated samples counted as what they are worth.
    pub improvement: f64,
    /// What the samples of the fit say against the table as it was, `n ln(rms_before^2 / rms_after^2)` with n the independent ones,
    /// and what a true table would reach in 1 of 20 cases.
    pub evidence: [f64; 2],
    /// Mean share by which unseen samples are leaner than the new table says, and its standard error: a drift.
    pub drift: [f64; 2],
}

/// Standard errors that an improvement, or a loss, must have to count: one-sided 95 %.
const COUNTS: f64 = 1.645;
/// Weight of unfitted cells at which a sample is unknown.
const UNKNOWN: f64 = 0.05;

/// Judges `found`, fitted to `train`, on `test`.
pub fn of(label: &Label, found: &Fit, train: &Used, test: &Used) -> Judgement {
    let nearest = nearest_mean(label, train);
    let mut errors: Vec<[f64; 3]> = Vec::new();
    let mut unknown = 0;
    let mut at = Vec::new();
    for k in 0..test.y.len() {
        let (cells, weights) = test.rows.row(k);
        let sum: f64 = weights.iter().sum();
        let outside: f64 =
            cells.iter().zip(weights).filter(|(c, _)| found.visits[**c] < 1.0).map(|(_, w)| w).sum();
        if outside > UNKNOWN * sum {
            unknown += 1;
            continue;
        }
        let share = |expected: f64| test.y[k] / expected - 1.0;
        errors.push([
            // Both tables as the function reads them: what the ECU cuts off its look-ups is no fault of the present one.
            share(test.rows.times(k, &label.base)),
            share(test.rows.times(k, &found.values)),
            share(test.rows.times(k, &nearest)),
        ]);
        at.push(test.at[k]);
    }
    let n = errors.len().max(1) as f64;
    let rms = |c: usize| (errors.iter().map(|e| e[c] * e[c]).sum::<f64>() / n).sqrt();
    let gain: Vec<f64> = errors.iter().map(|e| e[0] * e[0] - e[1] * e[1]).collect();
    let part = Used { at, rows: crate::rows::Rows::default(), y: Vec::new() };
    let (mean_gain, se_gain) = mean_and_error(&gain, &part);
    let left: Vec<f64> = errors.iter().map(|e| e[1]).collect();
    let (drift, se_drift) = mean_and_error(&left, &part);
    let improvement = if se_gain > 0.0 { mean_gain / se_gain } else { 0.0 };
    let evidence = evidence(found, train.y.len());
    let decision = if evidence[0] <= evidence[1] {
        // What it fitted is noise: neither better nor worse is a statement about the engine.
        Decision::Keep
    } else if improvement > COUNTS {
        Decision::Change
    } else if improvement < -COUNTS {
        Decision::Refuse
    } else {
        Decision::Keep
    };
    Judgement {
        decision,
        samples: errors.len(),
        unknown,
        rms_before: rms(0),
        rms_after: rms(1),
        rms_nearest: rms(2),
        improvement,
        evidence,
        drift: [drift, se_drift],
    }
}

/// Ratio of likelihoods of the fit and the present table, and the 95 % point of chi-squared with the effective parameters (its normal
/// approximation).
fn evidence(found: &Fit, samples: usize) -> [f64; 2] {
    let n = samples as f64 / found.correlation_samples;
    let p = found.effective_parameters;
    [2.0 * n * (found.rms[0] / found.rms[1].max(1e-12)).ln(), p + COUNTS * (2.0 * p).sqrt()]
}

fn mean_and_error(v: &[f64], part: &Used) -> (f64, f64) {
    let n = v.len() as f64;
    if v.len() < 3 {
        return (0.0, 0.0);
    }
    let mean = v.iter().sum::<f64>() / n;
    let tau = correlation::time_samples(v, &part.segments());
    let variance = v.iter().map(|x| (x - mean).powi(2)).sum::<f64>() / (n - 1.0);
    (mean, (variance * tau / n).sqrt())
}

/// What tuning tools do: every sample corrects the cell that it is nearest to, by the ratio of measured and expected lambda.
fn nearest_mean(label: &Label, train: &Used) -> Vec<f64> {
    let (mut sum, mut count) = (vec![0.0; label.len()], vec![0.0; label.len()]);
    for k in 0..train.y.len() {
        let (cells, weights) = train.rows.row(k);
        let strongest = (0..cells.len()).max_by(|a, b| weights[*a].total_cmp(&weights[*b]));
        if let Some(c) = strongest {
            // The row holds L / (VE g): its sum times a value is a lambda.
            sum[cells[c]] += train.y[k] / weights.iter().sum::<f64>();
            count[cells[c]] += 1.0;
        }
    }
    (0..label.len()).map(|c| if count[c] > 0.0 { sum[c] / count[c] } else { label.base[c] }).collect()
}
