//! The way from the cylinder to the number in the log: a delay with a part that shrinks with the flow, and a lag.

use serde::{Deserialize, Serialize};

use super::mask::{GAP_S, Mask};
use super::table::fit;
use super::{Keys, Log, Used};
use crate::error::LabelError;
use crate::label::Label;
use crate::linear::Options;
use crate::rows::Rows;

/// Flow at which `flow_delay_s` is what it says: speed in rpm times load.
pub const REFERENCE_FLOW: f64 = 2000.0 * 50.0;
/// Greatest delay and time constant that are searched, in s.
pub const MOST_S: f64 = 2.0;
/// Share of the lag's memory that is cut off.
const TAIL: f64 = 0.02;

/// A sensor.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Sensor {
    /// Delay that is always there, in s.
    pub delay_s: f64,
    /// Delay at the reference flow; it falls with the flow, in s.
    pub flow_delay_s: f64,
    /// Time constant of the sensor, in s.
    pub lag_s: f64,
}

impl Sensor {
    /// Delay at a speed and load.
    pub fn delay(&self, speed_rpm: f64, load: f64) -> f64 {
        self.delay_s + self.flow_delay_s * REFERENCE_FLOW / (speed_rpm * load).max(0.1 * REFERENCE_FLOW)
    }

    /// What lies on the bound of the search.
    pub fn on_bound(&self) -> Option<&'static str> {
        let parts = [
            (self.delay_s, "delay"),
            (self.flow_delay_s, "delay with the flow"),
            (self.lag_s, "time constant"),
        ];
        parts.into_iter().find(|p| p.0 >= MOST_S).map(|p| p.1)
    }

    fn parts(&self) -> usize {
        usize::from(self.delay_s > 0.0) + usize::from(self.flow_delay_s > 0.0) + usize::from(self.lag_s > 0.0)
    }
}

/// Samples of all logs that count with this sensor: the states that reach it are all usable.
pub fn samples(label: &Label, logs: &[Log], masks: &[Mask], sensor: &Sensor) -> Used {
    let mut used = Used { at: Vec::new(), rows: Rows::default(), y: Vec::new() };
    let (mut sums, mut touched) = (vec![0.0; label.len()], Vec::new());
    for (number, (log, mask)) in logs.iter().zip(masks).enumerate() {
        let mut window: Vec<(usize, f64)> = Vec::new();
        for t in 0..log.time_s.len() {
            if !mask.sensed[t] || !mask.burning[t] {
                continue;
            }
            let start_s = log.time_s[t] - sensor.delay(log.speed_rpm[t], log.load[t]);
            if !reach(log, start_s, t, sensor.lag_s, &mut window) {
                continue;
            }
            // What has left the cylinder before may be at any throttle, but it must have burnt.
            let states_ok = window.iter().all(|(k, _)| mask.burning[*k]);
            if !states_ok || !mask.use_at[window[0].0] {
                continue;
            }
            used.rows.start();
            touched.clear();
            for &(k, w) in &window {
                let factor = w * log.target[k] / (log.ve[k] * log.enrichment[k]);
                let (cells, weights, n) = label.weights(&[log.speed_rpm[k], log.load[k]]);
                for c in (0..n).filter(|c| weights[*c] != 0.0) {
                    if sums[cells[c]] == 0.0 {
                        touched.push(cells[c]);
                    }
                    sums[cells[c]] += factor * weights[c];
                }
            }
            // States of one window share cells: each comes once.
            touched.sort_unstable();
            for &c in &touched {
                used.rows.push(c, std::mem::take(&mut sums[c]));
            }
            used.at.push((number, t));
            used.y.push(log.lambda[t]);
        }
    }
    used
}

/// Samples whose gas the sensor sees, with weights of sum 1, the newest first; `false` at the ends of the log.
fn reach(log: &Log, start_s: f64, t: usize, lag_s: f64, window: &mut Vec<(usize, f64)>) -> bool {
    window.clear();
    let time_s = &log.time_s;
    let mut k = t;
    while k > 0 && time_s[k] > start_s {
        k -= 1;
    }
    if k == 0 || k + 1 >= time_s.len() {
        return false;
    }
    // A hole in the log is no state.
    if time_s[k + 1] - time_s[k] > GAP_S {
        return false;
    }
    if !(lag_s > 0.0) {
        let nearer = start_s - time_s[k] > time_s[k + 1] - start_s;
        window.push((if nearer { k + 1 } else { k }, 1.0));
        return true;
    }
    // Each sample acts until the next one: its share of the memory is what decays in that time.
    let mut left = 1.0;
    let mut end_s = start_s;
    loop {
        let decays = (-(end_s - time_s[k]) / lag_s).exp();
        window.push((k, left * (1.0 - decays)));
        left *= decays;
        end_s = time_s[k];
        if left < TAIL {
            break;
        }
        if k == 0 {
            return false;
        }
        k -= 1;
    }
    window.iter_mut().for_each(|w| w.1 /= 1.0 - left);
    true
}

/// The sensor that explains the first part of the samples best: `n ln(rms^2) + parts ln(n)` with n the independent samples, searched
/// part by part from coarse to fine, from none and from what the half height of steps says ([`super::steps`]).
///
/// # Errors
/// [`LabelError`]: no sensor leaves samples that count.
pub fn search(
    label: &Label,
    logs: &[Log],
    masks: &[Mask],
    keys: &Keys,
    half_height_s: Option<f64>,
    tell: &dyn Fn(&str),
) -> Result<(Sensor, Vec<(Sensor, f64)>), LabelError> {
    // The smoothness of the search is fixed: what is compared is the sensor.
    let options = Options { smooth: Some(0.01), ..keys.fit.clone() };
    let plain = Label { step: None, ..label.clone() };
    let mut tried: Vec<(Sensor, f64)> = Vec::new();
    let mut counted: Option<f64> = None;
    let mut score = |s: Sensor| -> Option<f64> {
        if let Some((_, known)) = tried.iter().find(|(t, _)| *t == s) {
            return Some(*known);
        }
        let used = samples(label, logs, masks, &s);
        let cut = (keys.train * used.at.len() as f64).round() as usize;
        if cut < 50 {
            return None;
        }
        let found = fit(&plain, &used.part(0..cut), &options).ok()?;
        // The same number of independent samples for all, else a sensor could win by leaving more of them out.
        let n = *counted.get_or_insert(cut as f64 / found.correlation_samples);
        let value = n * (found.rms[1] * found.rms[1]).ln() + s.parts() as f64 * n.max(1.0).ln();
        tried.push((s, value));
        Some(value)
    };
    let mut best = Sensor::default();
    let mut least = score(best).ok_or(LabelError::TooFew { found: 0, expected: 100 })?;
    // From none, and from what steps say: as a delay alone, and half of it as a lag.
    let step_s = half_height_s.unwrap_or(0.0).clamp(0.0, MOST_S);
    let round = |v: f64| (v * 20.0).round() / 20.0;
    let starts = [
        Sensor::default(),
        Sensor { delay_s: round(step_s), ..Sensor::default() },
        Sensor {
            delay_s: round(0.5 * step_s),
            lag_s: round(0.5 * step_s / std::f64::consts::LN_2),
            ..Sensor::default()
        },
    ];
    for (k, start) in starts.iter().enumerate().filter(|(k, _)| *k == 0 || step_s > 0.0) {
        if k == 0 {
            tell("looking for the delay and lag of the lambda sensor");
        } else {
            tell(&format!("looking for them from the half height of {step_s:.2} s of steps"));
        }
        if let Some((found, value)) = descend(*start, &mut score).filter(|(_, v)| *v < least || k == 0) {
            (best, least) = (found, value);
        }
    }
    Ok((best, tried))
}

/// From `start`, part by part in finer and finer steps; the sensor and its criterion.
fn descend(start: Sensor, score: &mut dyn FnMut(Sensor) -> Option<f64>) -> Option<(Sensor, f64)> {
    let (mut best, mut least) = (start, score(start)?);
    let parts: [fn(&mut Sensor) -> &mut f64; 3] =
        [|s| &mut s.delay_s, |s| &mut s.flow_delay_s, |s| &mut s.lag_s];
    for (step, count) in [(0.2, 6i32), (0.1, 1), (0.05, 1)] {
        for _ in 0..4 {
            let before = least;
            for part in parts {
                let centre = *part(&mut best.clone());
                for k in -count..=count {
                    let mut s = best;
                    // Adding 0 makes 0 of -0.
                    let v = ((centre + f64::from(k) * step) * 1000.0).round() / 1000.0 + 0.0;
                    if !(0.0..=MOST_S).contains(&v) {
                        continue;
                    }
                    *part(&mut s) = v;
                    if let Some(value) = score(s).filter(|v| *v < least) {
                        (best, least) = (s, value);
                    }
                }
            }
            if least >= before {
                break;
            }
        }
    }
    Some((best, least))
}
