//! The one PI step: a sampled controller with a feedforward value (thesis section 7.4, eq. 7.5).
//!
//! ```text
//! u(t) = f(t) + kp e(t) + i(t),    i(t) = i(t-1) + ki e(t) dt,    e = demand - measurement
//! ```
//!
//! with `i` clamped so that u stays in the actuator's range. What makes good gains is not asked here: a plan brings
//! them along ([`crate::plan::PlanLoop`]), and the player steps them ([`crate::play`]).

use serde::{Deserialize, Serialize};

/// Gains of one PI controller, `K = ki / s + kp`.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct PiGains {
    /// Integral gain, actuator unit per (output unit x s).
    pub ki: f64,
    /// Proportional gain, actuator unit per output unit.
    pub kp: f64,
}

/// A sampled PI controller with a feedforward value and anti-windup by clamping: the integral never asks for
/// more than the actuator has.
#[derive(Clone, Copy, Debug)]
pub struct Pi {
    gains: PiGains,
    integral: f64,
    lower: f64,
    upper: f64,
}

impl Pi {
    /// Controller whose output starts at `start` (with a feedforward of zero) and stays in `[lower, upper]`.
    pub fn new(gains: PiGains, start: f64, lower: f64, upper: f64) -> Self {
        Self { gains, integral: start, lower, upper }
    }

    /// The integral part, for a state that is saved.
    pub fn integral(&self) -> f64 {
        self.integral
    }

    /// Other gains from the next step on; the integral part stays what it is, and the proportional one changes with its gain.
    pub fn regain(&mut self, gains: PiGains) {
        self.gains = gains;
    }

    /// Actuator value for `error` (demand minus measurement) after a step of `dt_s` over the feedforward.
    pub fn step(&mut self, feedforward: f64, error: f64, dt_s: f64) -> f64 {
        let base = feedforward + self.gains.kp * error;
        // Clamping the integral itself leaves no wound-up part behind when the error changes sign.
        self.integral =
            (self.integral + self.gains.ki * error * dt_s).clamp(self.lower - base, self.upper - base);
        (base + self.integral).clamp(self.lower, self.upper)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A first-order lag `tau y' = k u - y` under PI settles on the demand without offset.
    #[test]
    fn integral_action_removes_the_offset() {
        let mut pi = Pi::new(PiGains { ki: 0.5, kp: 0.2 }, 0.0, 0.0, 90.0);
        let (mut y, dt) = (0.0, 0.03);
        for _ in 0..2000 {
            let u = pi.step(0.0, 50.0 - y, dt);
            y += dt / 0.3 * (4.0 * u - y);
        }
        assert!((y - 50.0).abs() < 1e-6, "{y}");
    }

    /// After a long time at the limit the output leaves it at once when the error changes sign.
    #[test]
    fn anti_windup_leaves_the_limit_at_once() {
        let mut pi = Pi::new(PiGains { ki: 1.0, kp: 0.1 }, 0.0, 0.0, 10.0);
        for _ in 0..1000 {
            pi.step(0.0, 100.0, 0.1);
        }
        let u = pi.step(0.0, -1.0, 0.1);
        assert!(u < 10.0, "{u}");
    }
}
