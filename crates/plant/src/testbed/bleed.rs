//! Air-bleed valve beside the throttle (thesis 3.6): two orifices in parallel pass the air of one with the sum of their
//! effective areas, so the engine sees a throttle angle that has this area.

use super::dynamics::{ActuatorSettings, Lag};
use crate::params::Throttle;
use serde::{Deserialize, Serialize};

/// An air-bleed valve; gives the bed the input `air_bleed` \[-\], 0 closed to 1 open.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct BleedSettings {
    /// Effective area when open \[mm2\].
    pub open_mm2: f64,
    /// Opening at the start \[-\].
    pub start: f64,
    /// Its actuator.
    pub actuator: ActuatorSettings,
}

impl Default for BleedSettings {
    /// About 12 g/s when choked; a solenoid of 30 ms.
    fn default() -> Self {
        Self { open_mm2: 50.0, start: 0.0, actuator: ActuatorSettings { lag_s: 0.03, rate_per_s: 0.0 } }
    }
}

impl BleedSettings {
    /// One step of `h_s` towards `command`; returns the throttle angle \[deg\] whose area is that of throttle and valve.
    pub fn step(&self, valve: &mut Lag, command: f64, throttle: &Throttle, angle_deg: f64, h_s: f64) -> f64 {
        let opening = self.actuator.step(valve, command, h_s).clamp(0.0, 1.0);
        equivalent_angle_deg(throttle, angle_deg, 1e-6 * self.open_mm2 * opening)
    }
}

/// Throttle angle whose effective area is that at `angle_deg` and `more_m2`, at most 90 deg.
///
/// ```
/// use dynocal_plant::{params::EngineParams, testbed::bleed::equivalent_angle_deg};
/// let t = EngineParams::thesis().throttle;
/// let a = equivalent_angle_deg(&t, 5.0, 30e-6);
/// assert!((t.area_m2(a) - t.area_m2(5.0) - 30e-6).abs() < 1e-18);
/// ```
pub fn equivalent_angle_deg(throttle: &Throttle, angle_deg: f64, more_m2: f64) -> f64 {
    let area = throttle.area_m2(angle_deg) + more_m2;
    let diameter = (4.0 * area / (std::f64::consts::PI * throttle.discharge)).sqrt();
    ((diameter - throttle.diameter0_m) / throttle.slope_m_per_deg).clamp(0.0, 90.0)
}
