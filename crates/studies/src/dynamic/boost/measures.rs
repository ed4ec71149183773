//! What a tip-in and the tip-out after it cost.

use serde::{Deserialize, Serialize};

use super::super::bed::SAMPLE_S;
use super::super::measures::integral_s;
use super::bed::{Course, Trace};

/// Samples of the mean before a step, and of that at its end.
const BEFORE: usize = 20;
const END: usize = 150;
/// Time of a step over which work, and over which emissions are summed, and in which lambda and its integral are looked at, in s.
const WORK_S: f64 = 3.0;
const EMITTED_S: f64 = 4.0;
const STEP_S: f64 = 6.0;
/// Time before the tip-in over which consumption at rest is taken, in s.
const REST_S: f64 = 3.0;

/// Measures of the table of rivals, of a tip-in at one speed.
#[derive(Clone, Copy, Debug, Default, Serialize, Deserialize)]
pub(super) struct TipIn {
    /// Time until 50 and 90 % of the way of the true torque in s.
    pub(super) t50_s: f64,
    pub(super) t90_s: f64,
    /// Largest torque over the demand, less 1.
    pub(super) overshoot: f64,
    /// Mean torque at the end, less the demand, in Nm.
    pub(super) offset_nm: f64,
    /// Largest knock index from the tip-in to the tip-out.
    pub(super) knock: f64,
    /// Largest |lambda - 1| in both steps.
    pub(super) lambda: f64,
    /// Fuel per work of the first 3 s of the tip-in, and of the last 3 s before it, in g/kWh.
    pub(super) fuel_g_kwh: f64,
    pub(super) rest_g_kwh: f64,
    /// Mean over both steps of the integral of |lambda - 1| over 6 s, in s.
    pub(super) integral_s: f64,
    /// Carbon monoxide and unburned fuel of the first 4 s of both steps, and nitric oxide, before the catalyst in g.
    pub(super) co_hc_g: f64,
    pub(super) no_g: f64,
    /// Fuel of the same time in g.
    pub(super) fuel_g: f64,
}

fn mean(v: &[f64]) -> f64 {
    v.iter().sum::<f64>() / v.len() as f64
}

fn samples(time_s: f64) -> usize {
    (time_s / SAMPLE_S).round() as usize
}

impl TipIn {
    /// Of a course whose first two changes are the tip-in and the tip-out.
    pub(super) fn of(trace: &Trace, course: &Course) -> Self {
        let [tip, out, end] = [0, 1, 2].map(|k| course.switches[k]);
        let torque = &trace.true_torque_nm;
        let demand = course.torque_nm[tip];
        let (from, to) = (mean(&torque[tip - BEFORE..tip]), mean(&torque[out - END..out]));
        let after = |share: f64| {
            let there = torque[tip..out].iter().position(|y| (y - from) / (to - from) >= share);
            SAMPLE_S * there.map_or(out - tip, |k| k + 1) as f64
        };
        let per_work = |from: usize, time_s: f64| {
            let range = from..from + samples(time_s);
            let work = |t: usize| torque[t] * course.speed_rpm[t] * std::f64::consts::PI / 30.0;
            let joule: f64 = range.clone().map(|t| work(t) * SAMPLE_S).sum();
            trace.fuel_g_s[range].iter().sum::<f64>() * SAMPLE_S / joule * 3.6e6
        };
        let steps = [tip..end.min(tip + samples(STEP_S)), out..end.min(out + samples(STEP_S))];
        let first = [tip, out].map(|k| k..k + samples(EMITTED_S));
        let emitted = |of: fn(&[f64; 3]) -> f64| -> f64 {
            first.iter().flat_map(|r| trace.emitted_g_s[r.clone()].iter().map(of)).sum::<f64>() * SAMPLE_S
        };
        let largest = |v: &[f64]| v.iter().copied().fold(0.0, f64::max);
        Self {
            t50_s: after(0.5),
            t90_s: after(0.9),
            overshoot: largest(&torque[tip..out]) / demand - 1.0,
            offset_nm: to - demand,
            knock: largest(&trace.true_knock[tip..out]),
            lambda: trace.true_lambda[tip..end].iter().fold(0.0, |m: f64, l| m.max((l - 1.0).abs())),
            fuel_g_kwh: per_work(tip, WORK_S),
            rest_g_kwh: per_work(tip - samples(REST_S), REST_S),
            integral_s: steps.iter().map(|r| 0.5 * integral_s(&trace.true_lambda[r.clone()])).sum(),
            co_hc_g: emitted(|e| e[0] + e[1]),
            no_g: emitted(|e| e[2]),
            fuel_g: first.iter().flat_map(|r| &trace.fuel_g_s[r.clone()]).sum::<f64>() * SAMPLE_S,
        }
    }
}
