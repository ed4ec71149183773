//! The strong simple rival: the static map with a first-order lag on INJ and SA.
//!
//! Throttle acts at once, fuel and spark follow the air: `tau = 0.12 s x 2000 / N`.

use super::static_map::StaticMap;
use super::{Actuators, FeedforwardMap, FirstOrder, Reference};

/// Static map with lagged fuel and spark.
pub struct LaggedStaticMap<'a> {
    /// The map behind it.
    pub map: &'a StaticMap,
    /// Time constant at 2000 rpm in s.
    pub tau_at_2000_rpm_s: f64,
}

impl FeedforwardMap for LaggedStaticMap<'_> {
    fn name(&self) -> &str {
        "static map with lag"
    }

    fn drive(&self, demand: &[Reference], sample_time_s: f64) -> Vec<Actuators> {
        let Some(first) = demand.first() else { return Vec::new() };
        let start = self.map.at(first);
        let (mut inj, mut spark) = (FirstOrder::new(start[0]), FirstOrder::new(start[1]));
        demand
            .iter()
            .map(|r| {
                let u = self.map.at(r);
                let tau = self.tau_at_2000_rpm_s * 2000.0 / r.speed_rpm;
                [inj.step(u[0], sample_time_s, tau), spark.step(u[1], sample_time_s, tau), u[2]]
            })
            .collect()
    }

    fn latency_s(&self, _sample_time_s: f64) -> f64 {
        0.0
    }
}
