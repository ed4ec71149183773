//! The strong simple rival: the static map with a first-order lag on all actuators but the one that leads.
//!
//! The actuator that moves the air acts at once, the others follow it: with `tau` at the middle of the operating channel,
//! `tau(N) = tau m/N` (a delay of so many engine cycles). `tau` is a line search on the run's own data, so that the rival is at
//! its best.

use super::static_map::StaticMap;
use super::{FeedforwardMap, FirstOrder, Ports, Rows};

/// Static map with lagged followers.
pub struct LaggedStaticMap<'a> {
    /// The map behind it.
    pub map: &'a StaticMap,
    /// Time constant in s at the middle of the given axis.
    pub tau_s: f64,
    /// Number of the actuator that leads; the others are lagged.
    pub leader: usize,
}

impl FeedforwardMap for LaggedStaticMap<'_> {
    fn name(&self) -> &str {
        "static map with lag"
    }

    fn ports(&self) -> &Ports {
        &self.map.ports
    }

    fn steady(&self, reference: &[f64]) -> Vec<f64> {
        self.map.steady(reference)
    }

    fn drive(&self, reference: &Rows, sample_time_s: f64) -> Rows {
        let mut out = self.map.drive(reference, sample_time_s);
        if out.is_empty() {
            return out;
        }
        let middle = self.map.middle_of_given();
        let given = self.map.ports.demands.len();
        let mut lags: Vec<FirstOrder> = out.row(0).iter().map(|u| FirstOrder::new(*u)).collect();
        for t in 0..out.len() {
            let at = reference.row(t).get(given).copied();
            let tau = match (at, middle) {
                (Some(n), Some(m)) if n > 0.0 => self.tau_s * m / n,
                _ => self.tau_s,
            };
            for (c, (v, lag)) in out.row_mut(t).iter_mut().zip(&mut lags).enumerate() {
                if c != self.leader {
                    *v = lag.step(*v, sample_time_s, tau);
                }
            }
        }
        out
    }

    fn latency_s(&self, _sample_time_s: f64) -> f64 {
        0.0
    }
}
