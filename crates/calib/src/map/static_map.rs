//! The static map: actuators over a grid of the leading demand and one given channel, the other demands being held.

use super::lookup::Corners;
use super::{FeedforwardMap, Ports, Rows};
use serde::{Deserialize, Serialize};

/// Best setting found at one operating point.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct StaticPoint {
    /// Leading demand.
    pub demand: f64,
    /// Given channel; 0 where there is none.
    pub given: f64,
    /// Actuators.
    pub actuators: Vec<f64>,
    /// Mean of (measured - demanded) of every demand while averaging.
    pub errors: Vec<f64>,
    /// What is minimised, averaged.
    pub objective: f64,
    /// Why the point was not reached as asked; empty when it was.
    pub missed: String,
}

/// Look-up tables over the leading demand and one given channel.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct StaticMap {
    /// What it reads and gives.
    pub ports: Ports,
    /// Axis of the leading demand.
    pub demand: Vec<f64>,
    /// Axis of the given channel; one value where there is none.
    pub given: Vec<f64>,
    /// Points, demand index slow, given index fast.
    pub points: Vec<StaticPoint>,
    /// Bed seconds spent.
    pub bed_s: f64,
}

impl StaticMap {
    /// Middle of the given axis; none where the map has no given channel.
    pub fn middle_of_given(&self) -> Option<f64> {
        let ends = self.given.first().zip(self.given.last());
        ends.filter(|_| !self.ports.given.is_empty()).map(|(a, b)| 0.5 * (a + b))
    }

    /// Bilinear interpolation, held at the edges of the grid, at one row of references.
    pub fn at(&self, reference: &[f64], u: &mut [f64]) {
        let given = reference.get(self.ports.demands.len()).copied().unwrap_or(0.0);
        let corners = Corners::around(&self.demand, &self.given, reference[0], given);
        for (c, v) in u.iter_mut().enumerate() {
            *v = corners.of(|k| self.points[k].actuators[c]);
        }
    }
}

impl FeedforwardMap for StaticMap {
    fn name(&self) -> &str {
        "static map"
    }

    fn ports(&self) -> &Ports {
        &self.ports
    }

    fn drive(&self, reference: &Rows, _sample_time_s: f64) -> Rows {
        let width = self.ports.actuators.len();
        let mut out = Rows::from_values(width, vec![0.0; reference.len() * width]);
        for t in 0..reference.len() {
            self.at(reference.row(t), out.row_mut(t));
        }
        out
    }

    fn steady(&self, reference: &[f64]) -> Vec<f64> {
        let mut u = vec![0.0; self.ports.actuators.len()];
        self.at(reference, &mut u);
        u
    }

    fn latency_s(&self, _sample_time_s: f64) -> f64 {
        0.0
    }
}

#[cfg(test)]
mod tests {
    use super::super::{ActuatorPort, Port};
    use super::*;

    /// Bilinear data are reproduced exactly, edges are held.
    #[test]
    fn interpolation_is_exact_for_bilinear_tables() {
        let f = |t: f64, n: f64| vec![0.2 * t + 1e-3 * n, 30.0 - 0.1 * t, 1e-4 * t * n];
        let (demand, given) = (vec![20.0, 35.0, 80.0], vec![1100.0, 2000.0, 2900.0]);
        let point = |t: f64, n: f64| StaticPoint {
            demand: t,
            given: n,
            actuators: f(t, n),
            errors: vec![0.0; 2],
            objective: 0.0,
            missed: String::new(),
        };
        let points = demand.iter().flat_map(|&t| given.iter().map(move |&n| point(t, n))).collect();
        let port = |name: &str| Port { name: name.into(), unit: "-".into() };
        let actuator =
            |name: &str| ActuatorPort { name: name.into(), unit: "-".into(), lower: 0.0, upper: 1e3 };
        let ports = Ports {
            demands: vec![port("torque"), port("lambda")],
            given: vec![port("speed")],
            actuators: ["inj", "spark", "throttle"].map(actuator).to_vec(),
        };
        let map = StaticMap { ports, demand, given, points, bed_s: 0.0 };
        let at = |t: f64, n: f64| {
            let mut u = [0.0; 3];
            map.at(&[t, 1.0, n], &mut u);
            u
        };
        for (t, n) in [(20.0, 1100.0), (33.3, 1234.0), (80.0, 2900.0), (64.9, 2449.0)] {
            let (got, want) = (at(t, n), f(t, n));
            assert!((0..3).all(|c| (got[c] - want[c]).abs() < 1e-12), "{t} {n}: {got:?} {want:?}");
        }
        assert_eq!(at(5.0, 800.0).to_vec(), f(20.0, 1100.0));
    }
}
