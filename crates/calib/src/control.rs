//! PI loops that hold torque by the throttle and lambda by the injected fuel (thesis section 7.4, eq. 7.5).

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

/// Gains of both loops: throttle in deg per Nm, fuel in mg per unit of lambda.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct LoopGains {
    /// Throttle from torque error.
    pub torque: PiGains,
    /// Fuel from lambda error (negative: too lean asks for more fuel).
    pub lambda: PiGains,
}

impl LoopGains {
    /// The published pair of eq. 7.5. It is stable but lets lambda swing from about 0.4 to 3.
    pub const THESIS: LoopGains =
        LoopGains { torque: PiGains { ki: 0.3, kp: 0.7 }, lambda: PiGains { ki: -20.0, kp: -1.5 } };

    /// Retuned pair: keeps lambda inside about 0.57 to 1.51 on the same references.
    pub const RETUNED: LoopGains =
        LoopGains { torque: PiGains { ki: 0.3, kp: 0.2 }, lambda: PiGains { ki: -40.0, kp: -8.0 } };

    /// The published pair of the static calibration, eq. 6.1.
    pub const STATIC: LoopGains =
        LoopGains { torque: PiGains { ki: 0.15, kp: 0.007 }, lambda: PiGains { ki: -20.0, kp: -1.5 } };

    /// A small pair that only trims a feedforward: it holds a promised torque and lambda without taking over.
    pub const TRIM: LoopGains =
        LoopGains { torque: PiGains { ki: 0.3, kp: 0.05 }, lambda: PiGains { ki: -10.0, kp: -1.5 } };

    /// The pair of that name.
    pub fn named(name: &str) -> Option<LoopGains> {
        match name {
            "thesis" => Some(Self::THESIS),
            "retuned" => Some(Self::RETUNED),
            "static" => Some(Self::STATIC),
            "trim" => Some(Self::TRIM),
            _ => None,
        }
    }

    /// Names that [`LoopGains::named`] knows.
    pub const NAMES: &'static [&'static str] = &["retuned", "thesis", "static", "trim"];
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
