//! The controller that runs: PI or PID with filtered derivative, anti-windup, bumpless start and transfer, limits of range and rate.
//!
//! ```text
//! u(t) = f(t) + kp e(t) + i(t) + v(t)            i as in dynocal_ident::pi, whose step this is
//! v(t) = (T v(t-1) + kd (e(t) - e(t-1))) / (T + dt)
//! C(q) = kp + ki dt / (1 - q) + kd (1 - q) / (T + dt - T q),    q = z^-1
//! ```
//!
//! The limits of a step are those of the range and those that the rate leaves about the last value; the integral never asks for
//! more than them, so that a limit of either kind leaves nothing wound up. A step allocates nothing.

use dynocal_ident::pi::{Pi, PiGains};
use serde::{Deserialize, Serialize};

use crate::error::ControlError;
use crate::system::{Time, Transfer};

/// Gains of a PID controller; `kd = 0` is a PI.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct PidGains {
    /// Proportional gain, input unit per output unit.
    pub kp: f64,
    /// Integral gain, input unit per (output unit x s).
    #[serde(default)]
    pub ki: f64,
    /// Derivative gain, input unit x s per output unit.
    #[serde(default)]
    pub kd: f64,
    /// Time constant of the filter of the derivative in s.
    #[serde(default)]
    pub filter_s: f64,
}

impl PidGains {
    /// A PI.
    pub fn pi(kp: f64, ki: f64) -> Self {
        Self { kp, ki, kd: 0.0, filter_s: 0.0 }
    }

    /// As transfer function: what [`Pid`] does while no limit is met, or `kp + ki/s + kd s/(T s + 1)`.
    ///
    /// ```
    /// use dynocal_control::runtime::PidGains;
    /// use dynocal_control::system::Time;
    /// let c = PidGains::pi(2.0, 3.0).transfer(Time::Sampled { sample_time_s: 0.1 });
    /// // (2 + 0.3 - 2 q) / (1 - q)
    /// assert!((c.num[0] - 2.3).abs() < 1e-15 && c.num[1] == -2.0 && c.den == [1.0, -1.0]);
    /// ```
    pub fn transfer(&self, time: Time) -> Transfer {
        let proportional = Transfer::gain(self.kp);
        let mut out = proportional;
        let mut add = |num: Vec<f64>, den: Vec<f64>| {
            let sum = crate::poly::add(
                &crate::poly::multiply(&out.num, &den),
                &crate::poly::multiply(&num, &out.den),
            );
            out = Transfer { num: sum, den: crate::poly::multiply(&out.den, &den), delay_s: 0.0 };
        };
        match time {
            Time::Continuous => {
                if self.ki != 0.0 {
                    add(vec![self.ki], vec![0.0, 1.0]);
                }
                if self.kd != 0.0 {
                    add(vec![0.0, self.kd], vec![1.0, self.filter_s]);
                }
            }
            Time::Sampled { sample_time_s: dt } => {
                if self.ki != 0.0 {
                    add(vec![self.ki * dt], vec![1.0, -1.0]);
                }
                if self.kd != 0.0 {
                    add(vec![self.kd, -self.kd], vec![self.filter_s + dt, -self.filter_s]);
                }
            }
        }
        out
    }
}

/// What an actuator can do.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ActuatorLimits {
    /// Least value.
    pub lower: f64,
    /// Greatest value.
    pub upper: f64,
    /// Largest change in a second; none: any.
    #[serde(default)]
    pub rate_per_s: Option<f64>,
}

/// What a controller remembers: saved, it goes on where it was.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct PidState {
    /// Integral part.
    pub integral: f64,
    /// Filtered derivative part.
    pub derivative: f64,
    /// Last error; none before the first step.
    pub error: Option<f64>,
    /// Last output.
    pub output: f64,
}

/// A sampled PID controller of one loop.
///
/// ```
/// use dynocal_control::runtime::{ActuatorLimits, Pid, PidGains};
/// let limits = ActuatorLimits { lower: 0.0, upper: 10.0, rate_per_s: Some(20.0) };
/// let mut pid = Pid::new(PidGains::pi(1.0, 2.0), limits, 0.1, 4.0)?;
/// // A rate of 20 per s leaves 2 in a step of 0.1 s.
/// assert_eq!(pid.step(0.0, 50.0), 6.0);
/// let again: dynocal_control::runtime::PidState = pid.state();
/// let mut other = Pid::new(PidGains::pi(1.0, 2.0), limits, 0.1, 0.0)?;
/// other.restore(again);
/// assert_eq!(pid.step(0.0, -1.0), other.step(0.0, -1.0));
/// # Ok::<(), dynocal_control::error::ControlError>(())
/// ```
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Pid {
    gains: PidGains,
    limits: ActuatorLimits,
    dt_s: f64,
    state: PidState,
}

impl Pid {
    /// A controller whose actuator is at `start`, with sample time `dt_s`.
    ///
    /// # Errors
    /// [`ControlError::Number`]: gains that are no numbers, an empty range, a rate or a time that is not positive.
    pub fn new(gains: PidGains, limits: ActuatorLimits, dt_s: f64, start: f64) -> Result<Self, ControlError> {
        for (what, v) in [("kp", gains.kp), ("ki", gains.ki), ("kd", gains.kd)] {
            if !v.is_finite() {
                return Err(ControlError::number(what, v, "a finite number"));
            }
        }
        if !(gains.filter_s >= 0.0 && gains.filter_s.is_finite()) {
            return Err(ControlError::number(
                "filter_s",
                gains.filter_s,
                "0 or a positive number of seconds",
            ));
        }
        if !(dt_s > 0.0 && dt_s.is_finite()) {
            return Err(ControlError::number("the sample time", dt_s, "a positive number of seconds"));
        }
        if !(limits.upper > limits.lower) {
            return Err(ControlError::number("the upper limit", limits.upper, "above the lower one"));
        }
        if let Some(rate) = limits.rate_per_s.filter(|r| !(*r > 0.0)) {
            return Err(ControlError::number("rate_per_s", rate, "a positive number"));
        }
        let output = start.clamp(limits.lower, limits.upper);
        let state = PidState { integral: output, derivative: 0.0, error: None, output };
        Ok(Self { gains, limits, dt_s, state })
    }

    /// Value of the actuator for an error (demand less measurement) over a feedforward. A measurement that is no number holds
    /// the actuator where it is.
    pub fn step(&mut self, feedforward: f64, error: f64) -> f64 {
        if !(error.is_finite() && feedforward.is_finite()) {
            return self.state.output;
        }
        let (g, dt) = (&self.gains, self.dt_s);
        let change = error - self.state.error.unwrap_or(error);
        let derivative = (g.filter_s * self.state.derivative + g.kd * change) / (g.filter_s + dt);
        let (mut lower, mut upper) = (self.limits.lower, self.limits.upper);
        if let Some(rate) = self.limits.rate_per_s {
            lower = lower.max(self.state.output - rate * dt);
            upper = upper.min(self.state.output + rate * dt);
        }
        let mut pi = Pi::new(PiGains { kp: g.kp, ki: g.ki }, self.state.integral, lower, upper);
        let output = pi.step(feedforward + derivative, error, dt);
        self.state = PidState { integral: pi.integral(), derivative, error: Some(error), output };
        output
    }

    /// Takes over from another source (a driver, another controller) whose actuator value is `output`: the next step begins
    /// there and moves by its integral alone.
    pub fn take_over(&mut self, output: f64, feedforward: f64, error: f64) {
        let output = output.clamp(self.limits.lower, self.limits.upper);
        let integral = output - feedforward - self.gains.kp * error;
        self.state = PidState { integral, derivative: 0.0, error: Some(error), output };
    }

    /// Other gains without a bump: the output for the last error stays what it was.
    pub fn change_gains(&mut self, gains: PidGains) {
        let error = self.state.error.unwrap_or(0.0);
        self.state.integral += (self.gains.kp - gains.kp) * error;
        self.gains = gains;
    }

    /// What it remembers.
    pub fn state(&self) -> PidState {
        self.state
    }

    /// Goes on from a saved state.
    pub fn restore(&mut self, state: PidState) {
        self.state = state;
    }
}
