//! Steps of a demand on the engine under different loops, averaged over repetitions.
//!
//! Each run is driven twice with the same scatter of engine and sensors, with the steps and without: the difference is what the steps did.
//! What is left at the end of a step is taken from the run with the steps alone: there a wrong level counts.

use std::collections::VecDeque;

use dynocal_control::interaction::beside_closed;
use dynocal_control::predictor::{PredictedModel, Predictor};
use dynocal_control::runtime::{ActuatorLimits, Pid, PidGains};
use dynocal_control::system::System;
use serde::{Deserialize, Serialize};

use super::bed::{Bench, Driven, SAMPLE_S};
use super::estimator::Estimator;

/// Rows for which a demand is held: 6 s, as in the validation of the thesis.
pub(super) const HOLD: usize = 300;
/// Share of the step within which a mean response counts as settled.
const SETTLED: f64 = 0.05;
/// Rows over which a mean response is smoothed before it is asked whether it is settled: a cycle and a half at 2000 rpm.
const SMOOTH: usize = 5;

/// What holds an output.
#[derive(Clone, Debug)]
pub(super) enum Feedback {
    /// The map alone: the demand goes to it.
    Map,
    /// A PI on the sensor.
    Pi(PidGains),
    /// A PI with a Smith predictor: filter time of the prediction error in s.
    Predicted(PidGains, f64),
}

/// A mean response to steps, as share of the step.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub(super) struct Steps {
    pub(super) name: String,
    pub(super) response: Vec<f64>,
    /// Time after which it stays within 5 %; none: not within the hold.
    pub(super) settling_s: Option<f64>,
    pub(super) overshoot: f64,
    /// Mean distance from the demand in the last second, in the output's unit.
    pub(super) offset: f64,
}

/// The engine behind its map with the loops of its other output.
pub(super) struct Rig<'a> {
    pub(super) bench: &'a Bench,
    pub(super) map: &'a [f64],
    /// Channels from demands to outputs, one sample of reaction within.
    pub(super) plant: &'a System,
    pub(super) gains: &'a [PidGains],
}

enum Running {
    Map,
    Pi(Pid),
    Predicted(Box<Predictor>),
}

impl Running {
    fn step(&mut self, demand: f64, shown: f64) -> f64 {
        match self {
            Self::Map => demand,
            Self::Pi(c) => c.step(0.0, demand - shown),
            Self::Predicted(c) => c.step(0.0, demand, shown),
        }
    }
}

impl Rig<'_> {
    fn running(&self, f: &Feedback, k: usize, delay: usize) -> Result<Running, String> {
        let wide = ActuatorLimits { lower: -1e6, upper: 1e6, rate_per_s: None };
        let text = |e: dynocal_control::error::ControlError| e.to_string();
        Ok(match f {
            Feedback::Map => Running::Map,
            Feedback::Pi(g) => Running::Pi(Pid::new(*g, wide, SAMPLE_S, 0.0).map_err(text)?),
            Feedback::Predicted(g, filter_s) => {
                // The other loop is closed meanwhile.
                let other = self.gains[1 - k].transfer(self.plant.time);
                let known = PredictedModel {
                    model: beside_closed(self.plant, &other, k).map_err(text)?,
                    delay_samples: delay as f64,
                    longest_samples: 2 * delay + 1,
                    filter_s: *filter_s,
                    flow: None,
                };
                let c = Predictor::new(*g, wide, SAMPLE_S, 0.0, &known).map_err(text)?;
                Running::Predicted(Box::new(c))
            }
        })
    }

    /// Actuators for demands behind the map.
    pub(super) fn actuators(&self, d: [f64; 2], spark: f64) -> [f64; 3] {
        let u0 = self.bench.point().0;
        let m = self.map;
        [u0[0] + m[0] * d[0] + m[1] * d[1], u0[1] + m[2] * d[0] + m[3] * d[1], u0[2] + spark]
    }

    /// `count` steps of `size` of output `k` held by `feedback`, its sensor `delay` samples late; the other output is held by its PI, or by
    /// the map where this one is.
    pub(super) fn steps(
        &self,
        name: &str,
        k: usize,
        size: f64,
        count: usize,
        feedback: &Feedback,
        delay: usize,
    ) -> Result<Steps, String> {
        let demand = |t: usize| if t / HOLD % 2 == 1 { size } else { 0.0 };
        let rows = (count + 1) * HOLD;
        let run = self.held(k, feedback, delay, rows, &demand)?;
        let still = self.held(k, feedback, delay, rows, &|_| 0.0)?;
        Ok(mean_of(name, [&run, &still], (k, delay), (self.bench.point().1[k], size), count, &demand))
    }

    /// A run of output `k` under `feedback`.
    fn held(
        &self,
        k: usize,
        feedback: &Feedback,
        delay: usize,
        rows: usize,
        demand: &dyn Fn(usize) -> f64,
    ) -> Result<Driven, String> {
        let y0 = self.bench.point().1;
        let mut own = self.running(feedback, k, delay)?;
        let beside =
            if matches!(feedback, Feedback::Map) { Feedback::Map } else { Feedback::Pi(self.gains[1 - k]) };
        let mut other = self.running(&beside, 1 - k, 0)?;
        let mut line: VecDeque<f64> = std::iter::repeat_n(0.0, delay).collect();
        self.bench.drive(rows, &mut |t, shown| {
            let shown = [shown[0] - y0[0], shown[1] - y0[1]];
            line.push_back(shown[k]);
            let late = line.pop_front().unwrap_or(0.0);
            let mut d = [0.0; 2];
            d[k] = own.step(demand(t), late);
            d[1 - k] = other.step(0.0, shown[1 - k]);
            self.actuators(d, 0.0)
        })
    }

    /// Torque held by an estimate of it, its steps as in [`Rig::steps`].
    pub(super) fn estimated_steps(
        &self,
        name: &str,
        size: f64,
        count: usize,
        estimator: &Estimator,
    ) -> Result<Steps, String> {
        let demand = |t: usize| if t / HOLD % 2 == 1 { size } else { 0.0 };
        let run = self.estimated((count + 1) * HOLD, estimator, &demand)?;
        let still = self.estimated((count + 1) * HOLD, estimator, &|_| 0.0)?;
        Ok(mean_of(name, [&run, &still], (0, 0), (self.bench.point().1[0], size), count, &demand))
    }

    /// A run under an estimate of the torque.
    pub(super) fn estimated(
        &self,
        rows: usize,
        estimator: &Estimator,
        demand: &dyn Fn(usize) -> f64,
    ) -> Result<Driven, String> {
        let y0 = self.bench.point().1;
        let mut torque = self.running(&Feedback::Pi(self.gains[0]), 0, 0)?;
        let mut lambda = self.running(&Feedback::Pi(self.gains[1]), 1, 0)?;
        let mut estimator = estimator.clone();
        estimator.torque_nm = y0[0];
        let (mut past_u, mut past_y): (Vec<[f64; 3]>, Vec<[f64; 4]>) = (Vec::new(), Vec::new());
        self.bench.drive(rows, &mut |t, shown| {
            past_y.push(*shown);
            if past_y.len() > 3 {
                past_y.remove(0);
            }
            let estimate = if past_u.len() == 3 { estimator.step(&past_u, &past_y) } else { y0[0] };
            let d = [torque.step(demand(t), estimate - y0[0]), lambda.step(0.0, shown[1] - y0[1])];
            let u = self.actuators(d, 0.0);
            past_u.push(u);
            if past_u.len() > 3 {
                past_u.remove(0);
            }
            u
        })
    }
}

/// Mean over the steps of what is shown `delay` samples late, torque without its sensor: of the run with the steps less the one
/// without them.
fn mean_of(
    name: &str,
    [run, still]: [&Driven; 2],
    (k, delay): (usize, usize),
    (y0, size): (f64, f64),
    count: usize,
    demand: &dyn Fn(usize) -> f64,
) -> Steps {
    let value = |d: &Driven, t: usize| if k == 0 { d.torque_nm[t - delay] } else { d.shown[t - delay][k] };
    let (mut response, mut level) = (vec![0.0; HOLD], vec![0.0; HOLD]);
    for s in 1..=count {
        let (from, to) = (demand(s * HOLD - 1), demand(s * HOLD));
        for (j, (r, l)) in response.iter_mut().zip(&mut level).enumerate() {
            let (t, share) = (s * HOLD + j, count as f64 * (to - from));
            *r += (value(run, t) - value(still, t) - from) / share;
            *l += (value(run, t) - y0 - from) / share;
        }
    }
    let smooth: Vec<f64> = response.windows(SMOOTH).map(|w| w.iter().sum::<f64>() / SMOOTH as f64).collect();
    let last = smooth.iter().rposition(|v| (v - 1.0).abs() > SETTLED);
    let settling_s = match last {
        Some(j) if j + 1 >= smooth.len() => None,
        Some(j) => Some((j + 1) as f64 * SAMPLE_S),
        None => Some(0.0),
    };
    let tail = 50;
    let end = level[HOLD - tail..].iter().sum::<f64>() / tail as f64;
    let overshoot = smooth.iter().copied().fold(0.0, f64::max) - 1.0;
    Steps { name: name.into(), response, settling_s, overshoot, offset: (end - 1.0).abs() * size }
}

/// How far a delayed response is from the undelayed one after the pure delay: sum of the sizes of the differences over that of
/// the distance of the undelayed one from its demand.
pub(super) fn apart(undelayed: &Steps, delayed: &Steps, delay: usize) -> f64 {
    let pairs = || undelayed.response.iter().zip(&delayed.response[delay..]);
    let off: f64 = pairs().map(|(a, b)| (a - b).abs()).sum();
    off / pairs().map(|(a, _)| (1.0 - a).abs()).sum::<f64>()
}
