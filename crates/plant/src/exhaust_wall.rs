//! Walls of the hot side: water-cooled ports, and a manifold that warms up by itself.
//!
//! Gas of the exhaust manifold at T loses q = U_p (T - T_p) + U_m (T - T_m). Ports stand in the head, near the coolant; the
//! wall of the manifold takes U_m (T - T_m) and gives U_a (T_m - T_a) to the air around it. Both conductances grow with the
//! mean flow of a cycle, U = U_0 (m'/m'_0)^n (Heywood 1988, 12.6: n 0.4 to 0.8 for ports).
//!
//! By itself an engine has a wall of the manifold that is at rest: T_m = (U_m T + U_a T_a)/(U_m + U_a), so that both
//! conductances act in series. Warm-up is the bed's, as that of the cylinder walls ([`crate::testbed::thermal`]).

use crate::deviations::Deviations;
use serde::{Deserialize, Serialize};

/// Constants.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ExhaustWall {
    /// Conductance between gas and all ports at the flow `reference_kg_s` \[W/K\].
    pub port_w_k: f64,
    /// Wall of the ports of a warm engine \[K\]; where the coolant is below [`WARM_K`] it lies lower by as much.
    pub port_k: f64,
    /// Conductance between gas and manifold at the flow `reference_kg_s` \[W/K\].
    pub manifold_w_k: f64,
    /// Heat capacity of the manifold \[J/K\].
    pub manifold_j_k: f64,
    /// Conductance between manifold and the air around it \[W/K\].
    pub ambient_w_k: f64,
    /// Flow m'_0 \[kg/s\].
    pub reference_kg_s: f64,
    /// Exponent n of flow \[-\].
    pub flow_exponent: f64,
}

/// Coolant of a warm engine \[K\].
pub const WARM_K: f64 = 363.15;
/// Least flow of the law \[kg/s\]: an engine that stands still.
const LEAST_KG_S: f64 = 1e-3;

/// Conductances \[W/K\] and temperatures \[K\] at which they end.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Sinks {
    /// To the ports.
    pub port: (f64, f64),
    /// To the manifold, or through its resting wall to the air.
    pub manifold: (f64, f64),
}

impl Sinks {
    /// Both together: conductance, and the temperature at which nothing is lost.
    pub fn joined(&self) -> (f64, f64) {
        let ((a, ta), (b, tb)) = (self.port, self.manifold);
        (a + b, if a + b > 0.0 { (a * ta + b * tb) / (a + b) } else { ta })
    }
}

impl ExhaustWall {
    /// Sinks at a mean flow \[kg/s\]: ports of `port_k`, a manifold of `manifold_k`, or one at rest in air of `ambient_k`.
    ///
    /// ```
    /// use dynocal_plant::exhaust_wall::ExhaustWall;
    /// let w = ExhaustWall {
    ///     port_w_k: 8.0, port_k: 400.0, manifold_w_k: 3.0, manifold_j_k: 920.0, ambient_w_k: 6.0, reference_kg_s: 0.02,
    ///     flow_exponent: 0.5,
    /// };
    /// // A wall at rest loses what it takes: 3 and 6 W/K in series.
    /// let rest = w.sinks(0.02, 400.0, None, 300.0);
    /// assert!((rest.manifold.0 - 2.0).abs() < 1e-12 && rest.manifold.1 == 300.0);
    /// // A cold one takes more; twice the conductance at four times the flow.
    /// assert_eq!(w.sinks(0.08, 400.0, Some(300.0), 300.0).joined(), (22.0, (16.0 * 400.0 + 6.0 * 300.0) / 22.0));
    /// ```
    pub fn sinks(&self, flow_kg_s: f64, port_k: f64, manifold_k: Option<f64>, ambient_k: f64) -> Sinks {
        let more = if self.flow_exponent == 0.0 {
            1.0
        } else {
            (flow_kg_s.max(LEAST_KG_S) / self.reference_kg_s).powf(self.flow_exponent)
        };
        let inner = more * self.manifold_w_k;
        let manifold = match manifold_k {
            Some(t) => (inner, t),
            None if inner > 0.0 => (inner * self.ambient_w_k / (inner + self.ambient_w_k), ambient_k),
            None => (0.0, ambient_k),
        };
        Sinks { port: (more * self.port_w_k, port_k), manifold }
    }

    /// Sinks of an engine with deviations in air of `ambient_k`.
    pub(crate) fn of(&self, ambient_k: f64, d: &Deviations, flow_kg_s: f64) -> Sinks {
        let colder = d.coolant_k.map_or(0.0, |t| (t - WARM_K).min(0.0));
        self.sinks(flow_kg_s, self.port_k + colder, d.manifold_wall_k, ambient_k)
    }
}
