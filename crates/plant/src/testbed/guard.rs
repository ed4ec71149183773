//! Limits: watched each tick, reported as events, and kept by backing off.
//!
//! A limit that is exceeded moves its actuator away at a fixed rate. What is still exceeded after half the allowed time
//! trips: fuel is cut and the wastegate opens (a limit that closes the throttle closes it) until the quantity has been
//! inside for the hold time. Without fuel, peak pressure, knock and exhaust temperature fall within a few cycles, boost
//! and shaft as fast as the turbine runs down, which is what the other half is for. The throttle stays open in a trip of
//! boost: behind a closed one the charge pipe would keep its pressure for seconds.

use serde::{Deserialize, Serialize};

/// What moves when a limit is exceeded.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Action {
    /// Nothing: the limit is only reported.
    #[default]
    Report,
    /// Spark later by up to 20 deg, 40 deg/s.
    RetardSpark,
    /// Throttle towards closed, all of it in 0.5 s.
    CloseThrottle,
    /// More fuel, up to 30 % in 0.6 s.
    Enrich,
    /// Less fuel, down to 60 % in 0.8 s.
    Lean,
    /// Wastegate open by up to 28 mm, 60 mm/s.
    OpenWastegate,
}

impl Action {
    /// Rate \[unit/s\] and greatest correction.
    fn pace(self) -> (f64, f64) {
        match self {
            Self::Report => (0.0, 0.0),
            Self::RetardSpark => (40.0, 20.0),
            Self::CloseThrottle => (2.0, 1.0),
            Self::Enrich => (0.5, 0.3),
            Self::Lean => (0.5, 0.4),
            Self::OpenWastegate => (60.0, 28.0),
        }
    }
}

/// One limit.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct LimitSettings {
    /// Name of the quantity.
    pub what: String,
    /// Greatest allowed value.
    pub max: Option<f64>,
    /// Least allowed value.
    pub min: Option<f64>,
    /// What backs off.
    pub action: Action,
    /// Longest time outside \[s\]; half of it passes before the trip.
    pub within_s: f64,
    /// Share of the correction that is given back each second inside.
    pub recover_per_s: f64,
}

impl Default for LimitSettings {
    fn default() -> Self {
        let what = String::new();
        Self { what, max: None, min: None, action: Action::Report, within_s: 1.0, recover_per_s: 0.2 }
    }
}

impl LimitSettings {
    /// A limit that is only reported.
    pub fn report(what: &str, min: f64, max: f64) -> Self {
        Self { what: what.into(), min: Some(min), max: Some(max), ..Self::default() }
    }

    /// The bound that `value` violates.
    pub fn violated(&self, value: f64) -> Option<f64> {
        match (self.max, self.min) {
            (Some(max), _) if value > max => Some(max),
            (_, Some(min)) if value < min => Some(min),
            _ => None,
        }
    }
}

/// What moves in a limit.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize)]
pub struct GuardState {
    /// Time outside without a break \[s\].
    pub outside_s: f64,
    /// Correction of the actuator.
    pub correction: f64,
    /// Time until a trip ends, counted while inside \[s\]; 0 when not tripped.
    pub trip_s: f64,
}

/// What a tick has found.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Found {
    /// Nothing new.
    Nothing,
    /// The limit is exceeded for the first time.
    Exceeded,
    /// The limit has tripped.
    Tripped,
}

/// A trip of a limit, from the event that tells of it until fuel returns.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Trip {
    /// As in the event.
    pub what: String,
    /// Time of the event \[s\].
    pub from_s: f64,
    /// Last time at which it lasted \[s\].
    pub to_s: f64,
}

/// Time inside after which a trip ends \[s\].
pub const HOLD_S: f64 = 0.5;

impl GuardState {
    /// One tick of `h_s`; `value` is absent while the quantity means nothing (lambda without fuel).
    pub fn tick(&mut self, limit: &LimitSettings, value: Option<f64>, h_s: f64) -> Found {
        let (rate, most) = limit.action.pace();
        let outside = value.is_some_and(|v| limit.violated(v).is_some());
        if !outside {
            self.outside_s = 0.0;
            self.trip_s = (self.trip_s - h_s).max(0.0);
            if self.trip_s == 0.0 {
                self.correction = (self.correction - limit.recover_per_s * most * h_s).max(0.0);
            }
            return Found::Nothing;
        }
        let first = self.outside_s == 0.0;
        self.outside_s += h_s;
        self.correction = (self.correction + rate * h_s).min(most);
        if limit.action != Action::Report && self.outside_s > 0.5 * limit.within_s {
            let new = self.trip_s == 0.0;
            self.trip_s = HOLD_S;
            return if new { Found::Tripped } else { Found::Nothing };
        }
        if first { Found::Exceeded } else { Found::Nothing }
    }

    pub(crate) fn visit(&mut self, f: &mut impl FnMut(&mut f64)) {
        [&mut self.outside_s, &mut self.correction, &mut self.trip_s].into_iter().for_each(f);
    }
}

/// Commands to the actuators.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Commands {
    /// Fuel \[mg per cylinder and cycle\].
    pub injection_mg: f64,
    /// Spark \[deg BTDC\].
    pub spark_deg: f64,
    /// Throttle \[deg\].
    pub throttle_deg: f64,
    /// Wastegate \[mm\].
    pub wastegate_mm: f64,
}

impl Commands {
    /// Commands after all corrections; sparks stay inside the box of the engine.
    #[must_use]
    pub fn backed_off(mut self, limits: &[LimitSettings], states: &[GuardState]) -> Self {
        for (limit, s) in limits.iter().zip(states) {
            match limit.action {
                Action::Report => {}
                Action::RetardSpark => self.spark_deg = (self.spark_deg - s.correction).max(-10.0),
                Action::CloseThrottle => self.throttle_deg *= 1.0 - s.correction,
                Action::Enrich => self.injection_mg = (self.injection_mg * (1.0 + s.correction)).min(120.0),
                Action::Lean => self.injection_mg *= 1.0 - s.correction,
                Action::OpenWastegate => self.wastegate_mm = (self.wastegate_mm + s.correction).min(28.0),
            }
        }
        if states.iter().any(|s| s.trip_s > 0.0) {
            self.injection_mg = 0.0;
            self.wastegate_mm = 28.0;
        }
        let closes =
            |(l, s): (&LimitSettings, &GuardState)| s.trip_s > 0.0 && l.action == Action::CloseThrottle;
        if limits.iter().zip(states).any(closes) {
            self.throttle_deg = 0.0;
        }
        self
    }
}
