//! Whether a new table is taken, on samples that it was not fitted to.

use serde::{Deserialize, Serialize};

use super::Used;
use super::sensor::Sensor;
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

/// Why it is done.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Reason {
    /// Unseen samples are explained better.
    Better,
    /// Unseen samples are explained worse.
    Worse,
    /// Unseen samples show no difference.
    NoDifference,
    /// A true table would be improved as much by fitting its noise.
    Noise,
    /// Unseen samples are worth too few independent measurements.
    TooFew,
    /// The mean of the nearest cell explains unseen samples better.
    NearestIsBetter,
    /// Delay or lag of the sensor lie on the bound of their search.
    OnBound,
    /// Lambda is left by more than an engine can run with.
    NoEngine,
}

/// Numbers on unseen samples.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Judgement {
    /// What is done.
    pub decision: Decision,
    /// Why.
    pub reason: Reason,
    /// Unseen samples whose cells were fitted.
    pub samples: usize,
    /// Independent measurements that these are worth.
    pub facts: f64,
    /// Unseen samples that are left out because they lie in cells with less than one independent measurement.
    pub unknown: usize,
    /// Root mean square of measured over expected lambda less 1, with the table as it was.
    pub rms_before: f64,
    /// The same with the new table.
    pub rms_after: f64,
    /// The same with the mean of the nearest cell, what tuning tools do.
    pub rms_nearest: f64,
    /// Improvement of the squared share over its standard error, correlated samples counted as what they are worth.
    pub improvement: f64,
    /// What it must be to count, either way: one-sided 95 % of Student's distribution with as many facts.
    pub needed: f64,
    /// What the samples of the fit say against the table as it was, `n ln(rms_before^2 / rms_after^2)` with n the independent ones,
    /// and what a true table would reach in 1 of 20 cases.
    pub evidence: [f64; 2],
    /// Mean share by which unseen samples are leaner than the new table says, and its standard error: a drift.
    pub drift: [f64; 2],
}

/// One-sided 95 % of the normal distribution.
const COUNTS: f64 = 1.645;
/// Weight of unfitted cells at which a sample is unknown.
const UNKNOWN: f64 = 0.05;
/// Independent measurements from which the variance of their gain is known to a quarter, `1 / sqrt(2 (n - 1))`: with fewer a table is not
/// judged.
pub const NEEDED: f64 = 10.0;
/// Share by which measured lambda may leave the expected one: a mixture of half or one and a half times the air that was asked for does
/// not burn (J. B. Heywood, Internal combustion engine fundamentals, 1988, chapter 9), so that the log is not what it is taken for.
const MOST_LEFT: f64 = 0.5;

/// Judges `found`, fitted to `train`, on `test`; samples count where the cells that they read are `covered` by the fit.
pub fn of(
    label: &Label,
    found: &Fit,
    covered: &[bool],
    train: &Used,
    test: &Used,
    sensor: &Sensor,
) -> Judgement {
    let nearest = nearest_mean(label, train);
    let mut errors: Vec<[f64; 3]> = Vec::new();
    let mut unknown = 0;
    let mut at = Vec::new();
    for k in 0..test.y.len() {
        let (cells, weights) = test.rows.row(k);
        let sum: f64 = weights.iter().sum();
        let outside: f64 = cells.iter().zip(weights).filter(|(c, _)| !covered[**c]).map(|(_, w)| w).sum();
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
    // Adding 0 makes 0 of the -0 of an empty sum.
    let rms = |c: usize| ((errors.iter().map(|e| e[c] * e[c]).sum::<f64>() + 0.0) / n).sqrt();
    let gain: Vec<f64> = errors.iter().map(|e| e[0] * e[0] - e[1] * e[1]).collect();
    let part = Used { at, rows: crate::rows::Rows::default(), y: Vec::new() };
    // A part of a few seconds does not tell how long its samples hang together: at least as long as those of the fit.
    let (mean_gain, se_gain, facts) = mean_and_error(&gain, &part, found.correlation_samples);
    let left: Vec<f64> = errors.iter().map(|e| e[1]).collect();
    let (drift, se_drift, _) = mean_and_error(&left, &part, found.correlation_samples);
    let improvement = if se_gain > 0.0 { mean_gain / se_gain } else { 0.0 };
    let evidence = evidence(found, train.y.len());
    let rms = [rms(0), rms(1), rms(2)];
    let needed = correlation::t_one_sided(facts - 1.0);
    let (decision, reason) = if !(rms[1] <= MOST_LEFT) && !errors.is_empty() {
        (Decision::Refuse, Reason::NoEngine)
    } else if facts < NEEDED {
        (Decision::Keep, Reason::TooFew)
    } else if evidence[0] <= evidence[1] {
        // What it fitted is noise: neither better nor worse is a statement about the engine.
        (Decision::Keep, Reason::Noise)
    } else if improvement < -needed {
        (Decision::Refuse, Reason::Worse)
    } else if improvement <= needed {
        (Decision::Keep, Reason::NoDifference)
    } else if sensor.on_bound().is_some() {
        (Decision::Keep, Reason::OnBound)
    } else if rms[1] > rms[2] {
        (Decision::Keep, Reason::NearestIsBetter)
    } else {
        (Decision::Change, Reason::Better)
    };
    Judgement {
        decision,
        reason,
        samples: errors.len(),
        facts,
        unknown,
        rms_before: rms[0],
        rms_after: rms[1],
        rms_nearest: rms[2],
        improvement,
        needed,
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

/// Mean of a series, its standard error, and the independent measurements that it is worth; samples hang together for `least` at least.
fn mean_and_error(v: &[f64], part: &Used, least: f64) -> (f64, f64, f64) {
    correlation::mean_and_error(v, &part.segments(), least)
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
