//! Samples that say nothing of the table, each with its reason.

use serde::{Deserialize, Serialize};

use super::Log;

/// What is left out.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Keys {
    /// Below this coolant temperature the engine is cold, in degC.
    pub least_coolant_c: f64,
    /// Throttle rate from which fuel on the wall and acceleration enrichment count, in %/s.
    pub most_throttle_rate: f64,
    /// Time after a fuel cut in which the exhaust still holds its air, in s.
    pub after_cut_s: f64,
    /// Speed below which the engine is started, not run, in rpm.
    pub least_speed_rpm: f64,
    /// Whether samples count in which the ECU enriches for start, warm-up or acceleration: by the correction that the log has of it.
    pub enriched: bool,
}

impl Default for Keys {
    fn default() -> Self {
        Self {
            least_coolant_c: 71.0,
            most_throttle_rate: 20.0,
            after_cut_s: 1.5,
            least_speed_rpm: 400.0,
            enriched: false,
        }
    }
}

/// What counts of a log.
#[derive(Clone, Debug, PartialEq)]
pub struct Mask {
    /// Whether a sample, as a state of the engine, may be used.
    pub use_at: Vec<bool>,
    /// Whether fuel was injected and the engine ran: nothing else may reach the sensor within its window.
    pub burning: Vec<bool>,
    /// Whether the sensor says a lambda.
    pub sensed: Vec<bool>,
    /// Samples by the first reason that holds.
    pub left_out: Vec<(String, usize)>,
}

/// Samples in a row at the same extreme value that make it a rail.
const RAIL_SAMPLES: usize = 5;
/// Stamps in s without any change of lambda that mean a sensor that is not ready.
const STUCK_S: f64 = 10.0;

/// Stamps in s between two samples beyond which nobody knows what the engine did.
pub const GAP_S: f64 = 1.0;

/// What counts of `log`.
pub fn of(log: &Log, keys: &Keys) -> Mask {
    let n = log.time_s.len();
    let burning: Vec<bool> = (0..n)
        .map(|k| {
            let positive = |v: f64| v > 0.0 && v.is_finite();
            log.speed_rpm[k] >= keys.least_speed_rpm
                && positive(log.pulse_ms[k])
                && positive(log.ve[k])
                && positive(log.enrichment[k])
                && positive(log.target[k])
                && log.load[k].is_finite()
        })
        .collect();
    let since = since_cut(log, &burning);
    let (railed, stuck) = (railed(&log.lambda), stuck(&log.time_s, &log.lambda));
    let sensed: Vec<bool> =
        (0..n).map(|k| log.lambda[k].is_finite() && log.lambda[k] > 0.0 && !railed[k] && !stuck[k]).collect();
    let cold = |k: usize| log.coolant_c.as_ref().is_some_and(|c| !(c[k] >= keys.least_coolant_c));
    let moving =
        |k: usize| log.throttle_rate.as_ref().is_some_and(|r| !(r[k].abs() < keys.most_throttle_rate));
    let enriching = |k: usize| !keys.enriched && log.enriching.as_ref().is_some_and(|e| e[k]);
    let reasons: [(&str, &dyn Fn(usize) -> bool); 7] = [
        ("engine stopped, started, or fuel cut", &|k| !burning[k]),
        ("after a fuel cut, a start, a hole in the log or a jump of its clock", &|k| {
            since[k] < keys.after_cut_s
        }),
        ("engine cold", &cold),
        ("enrichment of start, warm-up or acceleration active", &enriching),
        ("throttle moves", &moving),
        ("lambda sensor at its rail", &|k| railed[k]),
        ("lambda sensor not ready or without a value", &|k| !sensed[k]),
    ];
    let mut counts = [0usize; 7];
    let use_at = (0..n)
        .map(|k| match reasons.iter().position(|(_, holds)| holds(k)) {
            Some(r) => {
                counts[r] += 1;
                false
            }
            None => true,
        })
        .collect();
    let left_out = reasons.iter().zip(counts).map(|((name, _), c)| ((*name).to_string(), c)).collect();
    Mask { use_at, burning, sensed, left_out }
}

/// Whether the sensor says a lambda: a positive number that is not its rail, and not the same for seconds.
pub fn sensed(time_s: &[f64], lambda: &[f64]) -> Vec<bool> {
    let (railed, stuck) = (railed(lambda), stuck(time_s, lambda));
    (0..lambda.len()).map(|k| lambda[k].is_finite() && lambda[k] > 0.0 && !railed[k] && !stuck[k]).collect()
}

/// Time since the engine last ran without fuel; a log begins with one that is not known, and so does what follows a hole in it.
fn since_cut(log: &Log, burning: &[bool]) -> Vec<f64> {
    let mut last = log.time_s.first().copied().unwrap_or(0.0);
    (0..burning.len())
        .map(|k| {
            if !burning[k] || (k > 0 && log.time_s[k] - log.time_s[k - 1] > GAP_S) {
                last = log.time_s[k];
            }
            log.time_s[k] - last
        })
        .collect()
}

/// The least or greatest value of the log, held for several samples: a sensor that can say no more.
fn railed(lambda: &[f64]) -> Vec<bool> {
    let finite = || lambda.iter().copied().filter(|v| v.is_finite());
    let (low, high) = (finite().fold(f64::INFINITY, f64::min), finite().fold(f64::NEG_INFINITY, f64::max));
    let mut out = vec![false; lambda.len()];
    for extreme in [low, high] {
        let at: Vec<bool> = lambda.iter().map(|v| (v - extreme).abs() <= 1e-6 * extreme.abs()).collect();
        let mut from = 0;
        let mut rail = false;
        let runs = |from: usize, to: usize| to - from >= RAIL_SAMPLES;
        for k in 0..=at.len() {
            if k == at.len() || !at[k] {
                rail |= runs(from, k);
                from = k + 1;
            }
        }
        // Once it is a rail every sample there is at it; a constant signal is caught as stuck.
        if rail && low < high {
            out.iter_mut().zip(&at).for_each(|(o, a)| *o |= *a);
        }
    }
    out
}

/// Stretches in which lambda does not change at all: a sensor that warms up, or none.
fn stuck(time_s: &[f64], lambda: &[f64]) -> Vec<bool> {
    let n = lambda.len();
    let mut out = vec![false; n];
    let mut from = 0;
    for k in 1..=n {
        if k == n || lambda[k] != lambda[from] {
            if time_s[k - 1] - time_s[from] >= STUCK_S {
                out[from..k].fill(true);
            }
            from = k;
        }
    }
    out
}
