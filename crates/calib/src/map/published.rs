//! The published dynamic map: the three recursive models of eq. (7.18) with delays removed by eq. (7.17).

use super::{Actuators, FeedforwardMap, MapLimits, Reference};
use dynocal_ident::model::poly::PolyNarx;
use dynocal_ident::model::{Model, Run, literature};
use serde::{Deserialize, Serialize};

/// The shift of eq. (7.17) in samples: longest delay of the engine models (5) plus that of the controller (3).
pub const PUBLISHED_SHIFT: usize = 8;

/// Three recursive inverse models with their parameters.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct PublishedMap {
    /// Structures of INJ, SA and throttle.
    pub models: [PolyNarx; 3],
    /// Their parameters.
    pub theta: [Vec<f64>; 3],
    /// Shift of eq. (7.17) in samples.
    pub shift: usize,
    /// Actuator limits.
    pub limits: MapLimits,
}

/// Structures of eq. (7.18) in the order INJ, SA, throttle.
pub fn structures() -> [PolyNarx; 3] {
    literature::inverse_7_18().map(|m| m.model)
}

/// Response as model inputs (torque, lambda, speed), N x 3 row-major.
pub fn input_rows(response: &[Reference]) -> Vec<f64> {
    response.iter().flat_map(|r| [r.torque_nm, r.lambda, r.speed_rpm]).collect()
}

impl FeedforwardMap for PublishedMap {
    fn name(&self) -> &str {
        "published map (7.18)"
    }

    fn drive(&self, demand: &[Reference], _sample_time_s: f64) -> Vec<Actuators> {
        // The models map y(t + shift) to u(t): fed with the demand itself, the engine answers `shift` samples late.
        let u = input_rows(demand);
        let n = demand.len();
        let columns: Vec<Vec<f64>> = (0..3)
            .map(|c| {
                let start = self.models[c].max_lag().min(n);
                let rest = self.steady(c, demand.first());
                let y0 = vec![rest; n];
                let mut y = vec![rest; n];
                let run = Run { u: &u, y: &y0, start };
                self.models[c].simulate(&self.theta[c], &run, &mut y);
                y
            })
            .collect();
        (0..n).map(|t| self.limits.clamp([columns[0][t], columns[1][t], columns[2][t]])).collect()
    }

    fn latency_s(&self, sample_time_s: f64) -> f64 {
        self.shift as f64 * sample_time_s
    }
}

impl PublishedMap {
    /// Value at which model `c` rests for a held reference: the fixed point found by running it.
    fn steady(&self, c: usize, reference: Option<&Reference>) -> f64 {
        let Some(r) = reference else { return 0.0 };
        let n = 400;
        let middle = 0.5 * (self.limits.lower[c] + self.limits.upper[c].min(30.0));
        let u = input_rows(&vec![*r; n]);
        let y0 = vec![middle; n];
        let mut y = y0.clone();
        let start = self.models[c].max_lag();
        self.models[c].simulate(&self.theta[c], &Run { u: &u, y: &y0, start }, &mut y);
        if y[n - 1].is_finite() { y[n - 1].clamp(self.limits.lower[c], self.limits.upper[c]) } else { middle }
    }
}
