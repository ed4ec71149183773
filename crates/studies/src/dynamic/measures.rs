//! Measures of the table of rivals.

use super::bed::{Course, SAMPLE_S, Trace};
use serde::{Deserialize, Serialize};

/// Samples of the mean before a step, and of that at its end.
const BEFORE: usize = 20;
const END: usize = 150;
/// Time constant of the demand that torque is compared with, in s: that of the leading demand in the dynamic map of the chain.
const FILTER_S: f64 = 0.12;

/// What a controller did over a course.
#[derive(Clone, Copy, Debug, Default, Serialize, Deserialize)]
pub(super) struct Measures {
    /// Mean over the steps of the integral of |lambda - 1| in s.
    pub(super) integral_s: f64,
    /// Largest lambda - 1, and largest 1 - lambda.
    pub(super) lean: f64,
    pub(super) rich: f64,
    /// Mean time until 90 % of the way of the torque in s.
    pub(super) t90_s: f64,
    /// Largest mean error of lambda at the end of a step, and of the torque in Nm.
    pub(super) offset: f64,
    pub(super) torque_offset_nm: f64,
    /// Root of the mean squared difference of the torque and the demand behind a lag of [`FILTER_S`], from the first step on, in Nm.
    pub(super) torque_rms_nm: f64,
}

impl Measures {
    /// The larger of the two spikes.
    pub(super) fn spike(&self) -> f64 {
        self.lean.max(self.rich)
    }

    /// Mean of several; zero of none.
    pub(super) fn mean(of: &[&Measures]) -> Self {
        let share = 1.0 / of.len().max(1) as f64;
        let mean = |value: fn(&Measures) -> f64| share * of.iter().map(|m| value(m)).sum::<f64>();
        Self {
            integral_s: mean(|m| m.integral_s),
            lean: mean(|m| m.lean),
            rich: mean(|m| m.rich),
            t90_s: mean(|m| m.t90_s),
            offset: mean(|m| m.offset),
            torque_offset_nm: mean(|m| m.torque_offset_nm),
            torque_rms_nm: mean(|m| m.torque_rms_nm),
        }
    }

    pub(super) fn of(trace: &Trace, course: &Course) -> Self {
        let steps = course.switches.len() - 1;
        let share = 1.0 / steps as f64;
        let mut out = Self { torque_rms_nm: torque_rms_nm(trace, course), ..Self::default() };
        let mean = |v: &[f64]| v.iter().sum::<f64>() / v.len() as f64;
        for w in course.switches.windows(2) {
            let lambda = &trace.true_lambda[w[0]..w[1]];
            out.integral_s += share * integral_s(lambda);
            out.lean = lambda.iter().fold(out.lean, |m, l| m.max(l - 1.0));
            out.rich = lambda.iter().fold(out.rich, |m, l| m.max(1.0 - l));
            out.offset = out.offset.max((mean(&lambda[lambda.len() - END..]) - 1.0).abs());
            let torque = &trace.true_torque_nm;
            let (from, to) = (mean(&torque[w[0] - BEFORE..w[0]]), mean(&torque[w[1] - END..w[1]]));
            out.torque_offset_nm = out.torque_offset_nm.max((to - course.torque_nm[w[0]]).abs());
            let there = torque[w[0]..w[1]].iter().position(|y| (y - from) / (to - from) >= 0.9);
            out.t90_s += share * SAMPLE_S * there.unwrap_or(w[1] - w[0]) as f64;
        }
        out
    }
}

/// Integral of |lambda - 1| in s.
pub(super) fn integral_s(lambda: &[f64]) -> f64 {
    lambda.iter().map(|l| (l - 1.0).abs() * SAMPLE_S).sum()
}

fn torque_rms_nm(trace: &Trace, course: &Course) -> f64 {
    let follow = -(-SAMPLE_S / FILTER_S).exp_m1();
    let mut asked = course.torque_nm[0];
    let mut squares = 0.0;
    let first = course.switches[0];
    for (t, (demand, torque)) in course.torque_nm.iter().zip(&trace.true_torque_nm).enumerate() {
        asked += follow * (demand - asked);
        if t >= first {
            squares += (torque - asked).powi(2);
        }
    }
    (squares / (course.torque_nm.len() - first) as f64).sqrt()
}
