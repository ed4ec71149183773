//! What an engine controller adds under the bed's commands: fuel cut-off on overrun and idle control.

use super::dynamics::PiGains;
use super::guard::Commands;
use dynocal_numerics::interval::Interval;
use serde::{Deserialize, Serialize};

/// Settings.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct IdleSettings {
    /// Throttle command up to which the pedal counts as released \[deg\].
    pub released_deg: f64,
    /// Speed above which fuel is cut while released \[rpm\].
    pub cut_rpm: f64,
    /// Speed below which fuel returns \[rpm\].
    pub return_rpm: f64,
    /// Idle speed \[rpm\]; 880 for the 1.6 l engine (thesis Table 3.1).
    pub idle_rpm: f64,
    /// Throttle \[deg\] per speed error \[rpm\], and per second.
    pub gains: PiGains,
    /// Range of the throttle under idle control \[deg\].
    pub range_deg: Interval,
    /// Spark kept in reserve at idle \[deg\]: torque that the spark can give at once, before the manifold has filled.
    pub spark_reserve_deg: f64,
    /// Spark \[deg\] per speed error \[rpm\].
    pub spark_gain: f64,
}

impl Default for IdleSettings {
    fn default() -> Self {
        Self {
            released_deg: 0.5,
            cut_rpm: 1600.0,
            return_rpm: 1300.0,
            idle_rpm: 800.0,
            gains: PiGains { proportional: 0.02, integral: 0.015 },
            range_deg: Interval::new(0.0, 20.0),
            spark_reserve_deg: 12.0,
            spark_gain: 0.15,
        }
    }
}

/// What moves.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize)]
pub struct IdleState {
    /// Fuel is cut.
    pub cut: bool,
    /// Idle control is active.
    pub idle: bool,
    /// Integral of idle control \[deg\].
    pub integral_deg: f64,
}

/// The shaft as the controller sees it.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Shaft {
    /// Speed \[rpm\].
    pub rpm: f64,
    /// The speed follows from the torques (load mode), nothing imposes it.
    pub free: bool,
}

impl IdleSettings {
    /// Commands after cut-off and, where the speed is free, idle control; `fuel_mg` is the fuel for the air of the last
    /// cycle.
    pub fn step(&self, s: &mut IdleState, mut c: Commands, shaft: Shaft, fuel_mg: f64, h_s: f64) -> Commands {
        let released = c.throttle_deg <= self.released_deg;
        s.cut = released && shaft.rpm > if s.cut { self.return_rpm } else { self.cut_rpm };
        if !released || s.cut || !shaft.free {
            s.idle = false;
            if s.cut {
                c.injection_mg = 0.0;
            }
            return c;
        }
        if !s.idle {
            // Begin from the throttle that is open now.
            s.idle = true;
            s.integral_deg = c.throttle_deg.max(2.0);
        }
        let error = self.idle_rpm - shaft.rpm;
        c.throttle_deg = self.gains.step(&mut s.integral_deg, error, self.range_deg.into(), h_s);
        let reserve = self.spark_reserve_deg;
        let spark_deg = c.spark_deg - reserve + (self.spark_gain * error).clamp(-reserve, reserve);
        c.spark_deg = spark_deg.clamp(-10.0, 55.0);
        c.injection_mg = fuel_mg.clamp(0.0, 120.0);
        c
    }
}

impl IdleState {
    pub(crate) fn visit(&mut self, f: &mut impl FnMut(&mut f64)) {
        for flag in [&mut self.cut, &mut self.idle] {
            let mut x = f64::from(u8::from(*flag));
            f(&mut x);
            *flag = x != 0.0;
        }
        f(&mut self.integral_deg);
    }
}
