//! The published dynamic map: the three recursive models of eq. (7.18) with delays removed by eq. (7.17).

use super::{FeedforwardMap, Ports, Rows};
use dynocal_ident::model::poly::PolyNarx;
use dynocal_ident::model::{Model, Run, literature};
use serde::{Deserialize, Serialize};

/// The shift of eq. (7.17) in samples: longest delay of the engine models (5) plus that of the controller (3).
pub const PUBLISHED_SHIFT: usize = 8;

/// References that the published structures read, in the order of their inputs.
pub const REFERENCES: [&str; 3] = ["torque", "lambda", "speed"];
/// Actuators that they give.
pub const ACTUATORS: [&str; 3] = ["inj", "spark", "throttle"];

/// Three recursive inverse models with their parameters.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct PublishedMap {
    /// What it reads and gives: [`REFERENCES`] and [`ACTUATORS`].
    pub ports: Ports,
    /// Structures of INJ, SA and throttle.
    pub models: [PolyNarx; 3],
    /// Their parameters.
    pub theta: [Vec<f64>; 3],
    /// Shift of eq. (7.17) in samples.
    pub shift: usize,
}

/// Whether the published structures are for these ports.
pub fn fits(ports: &Ports) -> bool {
    ports.demands.len() == 2 && ports.reference_names() == REFERENCES && ports.actuator_names() == ACTUATORS
}

/// Structures of eq. (7.18) in the order INJ, SA, throttle.
pub fn structures() -> [PolyNarx; 3] {
    literature::inverse_7_18().map(|m| m.model)
}

impl FeedforwardMap for PublishedMap {
    fn name(&self) -> &str {
        "published map (7.18)"
    }

    fn ports(&self) -> &Ports {
        &self.ports
    }

    fn drive(&self, reference: &Rows, _sample_time_s: f64) -> Rows {
        // The models map y(t + shift) to u(t): fed with the demand itself, the engine answers `shift` samples late.
        let n = reference.len();
        let mut out = Rows::from_values(3, vec![0.0; 3 * n]);
        for c in 0..3 {
            let start = self.models[c].max_lag().min(n);
            let rest = self.steady(c, reference);
            let (y0, mut y) = (vec![rest; n], vec![rest; n]);
            let run = Run { u: reference.values(), y: &y0, start };
            self.models[c].simulate(&self.theta[c], &run, &mut y);
            out.set_column(c, &y);
        }
        for t in 0..n {
            self.ports.clamp(out.row_mut(t));
        }
        out
    }

    fn latency_s(&self, sample_time_s: f64) -> f64 {
        self.shift as f64 * sample_time_s
    }
}

impl PublishedMap {
    /// Value at which model `c` rests for the first reference held: the fixed point found by running it.
    fn steady(&self, c: usize, reference: &Rows) -> f64 {
        if reference.is_empty() {
            return 0.0;
        }
        let n = 400;
        let port = &self.ports.actuators[c];
        let middle = 0.5 * (port.lower + port.upper.min(30.0));
        let u = reference.row(0).repeat(n);
        let y0 = vec![middle; n];
        let mut y = y0.clone();
        let start = self.models[c].max_lag();
        self.models[c].simulate(&self.theta[c], &Run { u: &u, y: &y0, start }, &mut y);
        if y[n - 1].is_finite() { y[n - 1].clamp(port.lower, port.upper) } else { middle }
    }
}
