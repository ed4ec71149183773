//! The delay of the lambda sensor from steps: when fuel comes back after a cut, air at the sensor gives way to burnt gas.
//!
//! ```text
//! half height     last stamp after the return at which lambda falls below (before + settled) / 2,  less the stamp of the return
//! ```
//!
//! A delay d before a lag T reaches half of a step after `d + T ln 2`: one number of both, without a model of the table. The median over
//! all steps is what the search for the sensor begins with beside none ([`super::sensor::search`]), and what the page shows beside what it
//! found. The first stamp beyond a threshold, in its place, depends on the noise and on the height of the step.

use serde::{Deserialize, Serialize};

use super::Log;
use super::mask::{GAP_S, Mask};

/// Time in s that fuel is cut before, at least: the sensor then sees air.
const CUT_S: f64 = 1.0;
/// Time in s after the return in which fuel stays, and from which on lambda counts as settled.
const AFTER_S: f64 = 3.0;
const SETTLED_S: f64 = 2.0;
/// Height of a step in lambda, at least.
const HEIGHT: f64 = 0.1;

/// Half heights of all steps.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct HalfHeight {
    /// Steps.
    pub steps: usize,
    /// Time in s from the return of fuel to half height: lower quartile, median, upper quartile.
    pub quartiles_s: [f64; 3],
}

/// Half heights in `logs`; none without a clean return of fuel.
pub fn half_height(logs: &[Log], masks: &[Mask]) -> Option<HalfHeight> {
    let mut times: Vec<f64> = logs.iter().zip(masks).flat_map(|(l, m)| of(l, &m.burning)).collect();
    times.sort_by(f64::total_cmp);
    let at = |share: f64| times.get((share * (times.len().max(1) - 1) as f64).round() as usize).copied();
    Some(HalfHeight { steps: times.len(), quartiles_s: [at(0.25)?, at(0.5)?, at(0.75)?] })
}

/// Time to half height of each return of fuel in a log.
fn of(log: &Log, burning: &[bool]) -> Vec<f64> {
    let (t, n) = (&log.time_s, log.time_s.len());
    let mut out = Vec::new();
    for k in (1..n).filter(|k| burning[*k] && !burning[k - 1]) {
        let cut = (0..k).rev().take_while(|i| !burning[*i]).last().unwrap_or(k);
        let after: Vec<usize> = (k..n).take_while(|i| t[*i] - t[k] <= AFTER_S).collect();
        let end = after.last().copied().unwrap_or(k);
        let whole = t[k - 1] - t[cut] >= CUT_S
            && t[end] - t[k] >= SETTLED_S
            && after.iter().all(|i| burning[*i])
            && (cut.max(1)..=end).all(|i| t[i] - t[i - 1] <= GAP_S);
        let late = after.iter().filter(|i| t[**i] - t[k] >= SETTLED_S);
        let settled: Vec<f64> = late.map(|i| log.lambda[*i]).collect();
        let low = settled.iter().sum::<f64>() / settled.len().max(1) as f64;
        // What the sensor still sees of the cut may come after the return.
        let high = after.iter().map(|i| log.lambda[*i]).fold(log.lambda[k - 1], f64::max);
        if !(whole && high - low >= HEIGHT) {
            continue;
        }
        let half = 0.5 * (high + low);
        // Between two stamps on a straight line.
        let crossed = after.windows(2).rfind(|w| log.lambda[w[0]] > half && log.lambda[w[1]] <= half);
        if let Some(w) = crossed {
            let share = (log.lambda[w[0]] - half) / (log.lambda[w[0]] - log.lambda[w[1]]);
            out.push(t[w[0]] + share * (t[w[1]] - t[w[0]]) - t[k]);
        }
    }
    out
}

#[cfg(test)]
mod tests {
    use dynocal_numerics::rng::Rng64;

    use super::*;
    use crate::ve::mask;

    /// A log at 15 Hz with fuel cuts of 2 s, seen through a delay and a lag.
    fn log(delay_s: f64, lag_s: f64, noise: f64) -> Log {
        let n = 6000;
        let time_s: Vec<f64> = (0..n).map(|k| k as f64 / 15.0).collect();
        let cut = |t: f64| (t % 17.3) > 8.0 && (t % 17.3) < 10.0;
        let mut rng = Rng64::new(4);
        // The gas in fine steps, so that the sensor is that of continuous time.
        let (mut y, mut s, fine) = (1.0, 0.0, 1e-3);
        let lambda = time_s.iter().map(|t| {
            while s < *t {
                let gas = if cut(s - delay_s) { 2.0 } else { 1.0 };
                y += (gas - y) * fine / lag_s;
                s += fine;
            }
            y + noise * rng.normal()
        });
        let lambda = lambda.collect();
        let ones = vec![1.0; n];
        Log {
            name: "planted".into(),
            speed_rpm: vec![2000.0; n],
            load: vec![40.0; n],
            ve: vec![50.0; n],
            enrichment: ones.clone(),
            lambda,
            target: ones,
            pulse_ms: time_s.iter().map(|t| if cut(*t) { 0.0 } else { 4.0 }).collect(),
            time_s,
            ..Log::default()
        }
    }

    #[test]
    fn half_height_is_delay_and_lag_times_ln_2() {
        for (delay_s, lag_s) in [(0.43, 0.05), (0.2, 0.3), (0.99, 0.2)] {
            let log = log(delay_s, lag_s, 0.01);
            let masks = [mask::of(&log, &mask::Keys::default())];
            let found = half_height(&[log], &masks).unwrap();
            let wanted = delay_s + lag_s * std::f64::consts::LN_2;
            println!("{delay_s} and {lag_s}: {found:?}, expected {wanted:.3}");
            assert!(found.steps > 15);
            // A stamp is 67 ms, and the return lies anywhere between two.
            assert!((found.quartiles_s[1] - wanted).abs() < 0.067, "{found:?} {wanted}");
            assert!(found.quartiles_s[2] - found.quartiles_s[0] < 0.1);
        }
    }

    #[test]
    fn without_a_cut_there_is_no_step() {
        let mut log = log(0.3, 0.1, 0.01);
        log.pulse_ms.fill(4.0);
        let masks = [mask::of(&log, &mask::Keys::default())];
        assert_eq!(half_height(&[log], &masks), None);
    }
}
