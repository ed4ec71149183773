//! First-order lags and actuators, advanced exactly for inputs that are held.

use serde::{Deserialize, Serialize};

/// First-order lag tau dy/dt = u - y with u held over each step: y' = u + (y - u) e^(-h/tau).
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Lag {
    /// Value y.
    pub value: f64,
}

impl Lag {
    /// At rest at `value`.
    pub fn new(value: f64) -> Self {
        Self { value }
    }

    /// One step of `h_s` towards `input`; a time constant of zero follows at once.
    ///
    /// ```
    /// use dynocal_plant::testbed::dynamics::Lag;
    /// let mut lag = Lag::new(0.0);
    /// for _ in 0..10 {
    ///     lag.step(2.0, 0.05, 0.01);
    /// }
    /// assert!((lag.value - 2.0 * (1.0 - (-0.1f64 / 0.05).exp())).abs() < 1e-14);
    /// ```
    pub fn step(&mut self, input: f64, tau_s: f64, h_s: f64) -> f64 {
        self.value = if tau_s > 0.0 { input + (self.value - input) * (-h_s / tau_s).exp() } else { input };
        self.value
    }
}

/// Lag and greatest rate of an actuator.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct ActuatorSettings {
    /// Time constant \[s\]; 0 follows at once.
    pub lag_s: f64,
    /// Greatest rate \[unit/s\]; 0 has no limit.
    pub rate_per_s: f64,
}

impl ActuatorSettings {
    /// Whether the actuator follows at once.
    pub fn ideal(&self) -> bool {
        self.lag_s == 0.0 && self.rate_per_s == 0.0
    }

    /// One step of `h_s` of an actuator towards `command`.
    pub fn step(&self, actuator: &mut Lag, command: f64, h_s: f64) -> f64 {
        let before = actuator.value;
        let wanted = actuator.step(command, self.lag_s, h_s);
        if self.rate_per_s > 0.0 {
            let most = self.rate_per_s * h_s;
            actuator.value = wanted.clamp(before - most, before + most);
        }
        actuator.value
    }
}

/// PI controller K(s) = p + i/s whose integral stops at the limits of its actuator (thesis eq. 6.1).
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct PiGains {
    /// Proportional gain \[actuator unit per unit of error\].
    pub proportional: f64,
    /// Integral gain \[actuator unit per unit of error and second\].
    pub integral: f64,
}

impl PiGains {
    /// One step of `h_s`: moves `integral` and returns the command, both within `range`.
    pub fn step(&self, integral: &mut f64, error: f64, range: (f64, f64), h_s: f64) -> f64 {
        *integral = (*integral + self.integral * error * h_s).clamp(range.0, range.1);
        (*integral + self.proportional * error).clamp(range.0, range.1)
    }
}
