//! The Smith predictor that runs: a PID about the undelayed output of a linear model, corrected by what the plant shows.
//!
//! ```text
//! m(t) = sum_k b_k u(t-k) - sum_k a_k m(t-k)                      model without the delay that is predicted, b_0 = 0
//! c(t) = c(t-1) + (1 - exp(-dt/T)) (y(t) - m(t - d) - c(t-1))     what the model does not know; T = 0: all of it at once
//! u(t) = PID(r(t) - m(t) - c(t))
//! ```
//!
//! The delay d may change from sample to sample (transport through a pipe takes a time that goes with one over the flow): it is
//! clipped to what the line holds, and m is read between samples. A step allocates nothing. (Thesis (7.28), Figure 7.28; filter:
//! J. E. Normey-Rico, E. F. Camacho, Control of Dead-time Processes (2007), chapter 6.)

use serde::{Deserialize, Serialize};

use crate::error::ControlError;
use crate::runtime::{ActuatorLimits, Pid, PidGains};
use crate::system::{Time, Transfer};

/// Transport through a pipe: its delay goes with one over a flow.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct TransportFlow {
    /// Channel of the flow.
    pub channel: String,
    /// Its unit.
    pub unit: String,
    /// Flow at which the delay is the one that is given, in that unit.
    pub nominal: f64,
}

/// What a predictor knows of its plant.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct PredictedModel {
    /// Model from actuator to output without the delay that is predicted, sampled, in deviations from a point of rest.
    pub model: Transfer,
    /// Delay in samples beyond the model.
    pub delay_samples: f64,
    /// Longest delay in samples that can be set.
    pub longest_samples: usize,
    /// Time constant in s of the filter of the prediction error; 0: none.
    #[serde(default)]
    pub filter_s: f64,
    /// What the delay goes by; none: it stays as it is.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub flow: Option<TransportFlow>,
}

/// A PID with a Smith predictor.
///
/// ```
/// use dynocal_control::predictor::{PredictedModel, Predictor};
/// use dynocal_control::runtime::{ActuatorLimits, PidGains};
/// use dynocal_control::system::Transfer;
/// let model = Transfer::sampled(&[0.0, 0.2], &[1.0, -0.8]);
/// let known = PredictedModel { model, delay_samples: 5.0, longest_samples: 8, filter_s: 0.0, flow: None };
/// let limits = ActuatorLimits { lower: -10.0, upper: 10.0, rate_per_s: None };
/// let mut c = Predictor::new(PidGains::pi(2.0, 4.0), limits, 0.1, 0.0, &known)?;
/// // Nothing has been seen yet: the first step is that of the PI alone.
/// assert!((c.step(0.0, 1.0, 0.0) - 2.4).abs() < 1e-15);
/// # Ok::<(), dynocal_control::error::ControlError>(())
/// ```
#[derive(Clone, Debug, PartialEq)]
pub struct Predictor {
    pid: Pid,
    /// Numerator without its first, denominator without its first, both over the first of the denominator.
    b: Vec<f64>,
    a: Vec<f64>,
    /// Past actuator values less the start, and model outputs, latest first.
    u: Vec<f64>,
    m: Vec<f64>,
    start: f64,
    /// Line of model outputs, `at` is the present one.
    line: Vec<f64>,
    at: usize,
    delay_samples: f64,
    /// Share of the prediction error that is taken over in a step.
    share: f64,
    correction: f64,
}

impl Predictor {
    /// A predictor at rest whose actuator is at `start`; outputs are deviations from what the plant shows there.
    ///
    /// # Errors
    /// [`ControlError`]: as of [`Pid::new`]; a model that answers within its sample or is none, a delay that the line does not
    /// hold, a filter time that is not 0 or positive.
    pub fn new(
        gains: PidGains,
        limits: ActuatorLimits,
        dt_s: f64,
        start: f64,
        known: &PredictedModel,
    ) -> Result<Self, ControlError> {
        let pid = Pid::new(gains, limits, dt_s, start)?;
        known.check(dt_s)?;
        let first = known.model.den[0];
        let b: Vec<f64> = known.model.num[1..].iter().map(|v| v / first).collect();
        let a: Vec<f64> = known.model.den[1..].iter().map(|v| v / first).collect();
        let share = if known.filter_s > 0.0 { -(-dt_s / known.filter_s).exp_m1() } else { 1.0 };
        Ok(Self {
            start: pid.state().output,
            pid,
            u: vec![0.0; b.len()],
            m: vec![0.0; a.len()],
            b,
            a,
            line: vec![0.0; known.longest_samples + 2],
            at: 0,
            delay_samples: known.delay_samples,
            share,
            correction: 0.0,
        })
    }

    /// Other delay from now on, clipped to what the line holds: transport by flow.
    pub fn set_delay(&mut self, samples: f64) {
        if samples.is_finite() {
            self.delay_samples = samples.clamp(0.0, (self.line.len() - 2) as f64);
        }
    }

    /// Value of the actuator for a demand and a measurement (deviations from rest) over a feedforward. A measurement that is no
    /// number leaves the correction what it was.
    pub fn step(&mut self, feedforward: f64, demand: f64, measured: f64) -> f64 {
        let forward: f64 = self.b.iter().zip(&self.u).map(|(b, u)| b * u).sum();
        let back: f64 = self.a.iter().zip(&self.m).map(|(a, m)| a * m).sum();
        let model = forward - back;
        self.at = (self.at + 1) % self.line.len();
        self.line[self.at] = model;
        let error = measured - self.delayed();
        if error.is_finite() {
            self.correction += self.share * (error - self.correction);
        }
        let u = self.pid.step(feedforward, demand - model - self.correction);
        push(&mut self.u, u - self.start);
        push(&mut self.m, model);
        u
    }

    /// The model's output the set delay ago, between samples on the line.
    fn delayed(&self) -> f64 {
        let n = self.line.len();
        let whole = self.delay_samples.floor();
        let past = |k: usize| self.line[(self.at + n - k) % n];
        let (k, share) = (whole as usize, self.delay_samples - whole);
        if share == 0.0 { past(k) } else { past(k) + share * (past(k + 1) - past(k)) }
    }

    /// The PID within.
    pub fn pid(&self) -> &Pid {
        &self.pid
    }
}

impl PredictedModel {
    /// Delay in samples at a flow: `delay nominal / flow`, at most the longest one (no flow, or one that is no number); without a flow
    /// that it goes by, the delay.
    pub fn samples_at(&self, flow: f64) -> f64 {
        let Some(f) = &self.flow else { return self.delay_samples };
        self.delay_samples * f.nominal / flow.max(self.least_flow(f))
    }

    /// Flow at which the delay is the longest one.
    pub fn least_flow(&self, f: &TransportFlow) -> f64 {
        f.nominal * self.delay_samples / self.longest_samples as f64
    }

    fn check(&self, dt_s: f64) -> Result<(), ControlError> {
        let time = Time::Sampled { sample_time_s: dt_s };
        crate::system::System::single(time, self.model.clone())?;
        if self.model.num[0] != 0.0 || self.model.delay_s != 0.0 {
            return Err(ControlError::number(
                "the answer of the predicted model within its own sample, or its delay_s",
                if self.model.num[0] != 0.0 { self.model.num[0] } else { self.model.delay_s },
                "0: the actuator is known only after the prediction, and the delay is given in samples",
            ));
        }
        if !(self.delay_samples >= 0.0 && self.delay_samples <= self.longest_samples as f64) {
            return Err(ControlError::number(
                "the delay of the predictor in samples",
                self.delay_samples,
                "0 to its longest one",
            ));
        }
        if !(self.filter_s >= 0.0 && self.filter_s.is_finite()) {
            return Err(ControlError::number(
                "filter_s of the predictor",
                self.filter_s,
                "0 or a positive number of seconds",
            ));
        }
        let sound = |f: &TransportFlow| f.nominal > 0.0 && f.nominal.is_finite() && self.delay_samples > 0.0;
        if let Some(f) = self.flow.as_ref().filter(|f| !sound(f)) {
            let what = format!("the flow `{}` of the predictor at its delay", f.channel);
            return Err(ControlError::number(what, f.nominal, "a positive number, beside a delay"));
        }
        Ok(())
    }
}

fn push(past: &mut [f64], value: f64) {
    let n = past.len();
    if n > 0 {
        past.copy_within(0..n - 1, 1);
        past[0] = value;
    }
}
