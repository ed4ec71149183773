//! Feedforward maps: from a demand record to an actuator record.
//!
//! A map sees a window of the reference (torque, lambda, speed) around the present sample and gives INJ, SA and
//! throttle. Static maps see the present only; dynamic maps see the look-ahead that the reference filter buys.

use serde::{Deserialize, Serialize};

pub mod lagged;
pub mod published;
pub mod start;
pub mod static_map;
pub mod structured;

/// One sample of the reference that a map follows.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Reference {
    /// Torque in Nm.
    pub torque_nm: f64,
    /// Lambda.
    pub lambda: f64,
    /// Engine speed in rpm.
    pub speed_rpm: f64,
}

/// INJ in mg, SA in deg BTDC, throttle in deg.
pub type Actuators = [f64; 3];

/// A feedforward map.
pub trait FeedforwardMap: Send + Sync {
    /// Name for tables and plots.
    fn name(&self) -> &str;

    /// Actuators for a whole record of raw demands, as the map would have given them online, sample by sample
    /// (causal: its own reference filter, delay and look-ahead included).
    fn drive(&self, demand: &[Reference], sample_time_s: f64) -> Vec<Actuators>;

    /// Longest time in s that the map waits on purpose before it answers a demand.
    fn latency_s(&self, sample_time_s: f64) -> f64;
}

/// First-order lag, exact for a held input: `x+ = x + (1 - exp(-dt/tau)) (u - x)`.
#[derive(Clone, Copy, Debug)]
pub struct FirstOrder {
    state: f64,
}

impl FirstOrder {
    /// Lag at rest at `start`.
    pub fn new(start: f64) -> Self {
        Self { state: start }
    }

    /// Output after `u` is held for `dt_s`; `tau_s` may change from call to call.
    pub fn step(&mut self, u: f64, dt_s: f64, tau_s: f64) -> f64 {
        let gain = if tau_s > 0.0 { 1.0 - (-dt_s / tau_s).exp() } else { 1.0 };
        self.state += gain * (u - self.state);
        self.state
    }
}

/// Time constants of the reference filter, in s: the second one is the torque sensor's own lag, so that the filtered
/// reference is a response that the engine can give.
pub const REFERENCE_FILTER_S: [f64; 2] = [0.12, 0.15];

/// Torque demand through the reference filter: the response that a dynamic map asks for.
pub fn filter_torque(demand_nm: &[f64], sample_time_s: f64) -> Vec<f64> {
    let Some(&start) = demand_nm.first() else { return Vec::new() };
    let mut stages = REFERENCE_FILTER_S.map(|tau| (FirstOrder::new(start), tau));
    demand_nm
        .iter()
        .map(|&d| stages.iter_mut().fold(d, |x, (lag, tau)| lag.step(x, sample_time_s, *tau)))
        .collect()
}

/// Limits of the three actuators (thesis eq. 7.14, spark as in eq. 7.6).
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct MapLimits {
    /// Lower limits of INJ, SA, throttle.
    pub lower: Actuators,
    /// Upper limits.
    pub upper: Actuators,
}

impl MapLimits {
    /// `u` inside the limits.
    pub fn clamp(&self, u: Actuators) -> Actuators {
        std::array::from_fn(|c| u[c].clamp(self.lower[c], self.upper[c]))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn first_order_lag_has_the_exact_step_response() {
        let mut lag = FirstOrder::new(0.0);
        let mut y = 0.0;
        for _ in 0..10 {
            y = lag.step(1.0, 0.03, 0.12);
        }
        let exact = 1.0 - (-0.3f64 / 0.12).exp();
        assert!((y - exact).abs() < 1e-14);
    }

    #[test]
    fn filtered_reference_has_unit_gain_and_no_overshoot() {
        let step: Vec<f64> = (0..400).map(|t| if t < 10 { 30.0 } else { 70.0 }).collect();
        let y = filter_torque(&step, 0.03);
        assert_eq!(y[9], 30.0);
        assert!((y[399] - 70.0).abs() < 1e-9);
        assert!(y.windows(2).all(|w| w[1] >= w[0]));
    }
}
