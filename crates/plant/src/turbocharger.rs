//! Turbocharger: compressor by an ellipse, turbine as an orifice with an efficiency over its speed ratio, one shaft.
//!
//! Compressor, with psi = 2 dh_is/U^2 and phi = m'/(rho D^2 U): psi = psi_0 (1 - (phi/phi_0)^2), solved for the flow
//! that the pressure ratio lets through, m' = rho D^2 phi_0 sqrt(U^2 - 2 dh_is/psi_0); a pressure above the top of the
//! ellipse lets nothing through (surge). Efficiency eta (1 - c (phi/phi_eta - 1)^2). Form after Jensen et al. and Moraal
//! and Kolmanovsky (SAE 1999-01-0908). Turbine power P_t = eta_t m' c_p T (1 - (p_7/p_6)^((g-1)/g)), eta_t =
//! eta_max (2 s - s^2) with s the blade speed over jet speed relative to its best value. Shaft
//! J w w' = eta_m P_t - P_c - c_f w^2. The intercooler takes the share `cooling` of the compressor's heat.
//!
//! Valid from idle to about 1.1 times the speed of the best point; no map islands, no choke below the ellipse's foot,
//! no heat from turbine to compressor, no pressure loss of the intercooler.

use serde::{Deserialize, Serialize};

/// Constants of a turbocharger.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Turbocharger {
    /// Diameter D of the compressor wheel \[m\].
    pub compressor_m: f64,
    /// Head coefficient psi_0 at no flow \[-\].
    pub head_coefficient: f64,
    /// Flow coefficient phi_0 at no head \[-\].
    pub flow_coefficient: f64,
    /// Best compressor efficiency \[-\].
    pub compressor_efficiency: f64,
    /// Loss of efficiency c away from the best flow \[-\].
    pub compressor_falloff: f64,
    /// Flow coefficient of the best efficiency over phi_0 \[-\].
    pub best_flow_ratio: f64,
    /// Diameter of the turbine wheel \[m\].
    pub turbine_m: f64,
    /// Best turbine efficiency \[-\].
    pub turbine_efficiency: f64,
    /// Blade speed over isentropic jet speed at the best efficiency \[-\].
    pub best_speed_ratio: f64,
    /// Mechanical efficiency of the shaft \[-\].
    pub mechanical_efficiency: f64,
    /// Friction c_f \[W s2/rad2\].
    pub friction_w_s2: f64,
    /// Moment of inertia J of the rotor \[kg m2\].
    pub inertia_kg_m2: f64,
    /// Share of the heat of compression that the intercooler takes \[-\].
    pub cooling: f64,
    /// Least shaft speed \[rad/s\]: where it stands while the turbine gives nothing.
    pub least_rad_s: f64,
}

/// What the compressor does.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Compressor {
    /// Air flow \[kg/s\].
    pub flow_kg_s: f64,
    /// Power taken from the shaft \[W\].
    pub power_w: f64,
    /// The pressure is above the top of the ellipse.
    pub surge: bool,
}

/// Specific heat \[J/kg/K\] and exponent R/c_p of ambient air.
const CP_AIR: f64 = 1006.0;
const KAPPA_AIR: f64 = 0.286_5;

impl Turbocharger {
    /// Compressor between ambient air (`ambient_pa`, `ambient_k`, density \[kg/m3\]) and `p_pa` at shaft speed
    /// `w_rad_s`.
    pub fn compressor(
        &self,
        w_rad_s: f64,
        p_pa: f64,
        ambient_pa: f64,
        ambient_k: f64,
        rho: f64,
    ) -> Compressor {
        let u = 0.5 * self.compressor_m * w_rad_s;
        let head = CP_AIR * ambient_k * ((p_pa / ambient_pa).powf(KAPPA_AIR) - 1.0);
        let square = u * u - 2.0 * head / self.head_coefficient;
        if square <= 0.0 {
            return Compressor { surge: true, ..Compressor::default() };
        }
        // Near the top of the ellipse the root would have an infinite slope, which no explicit step can follow.
        let scale = 0.02 * u * u + 25.0;
        let speed = if square < scale { square / scale.sqrt() } else { square.sqrt() };
        let flow = rho * self.compressor_m * self.compressor_m * self.flow_coefficient * speed;
        let relative = speed / (u.max(1.0) * self.best_flow_ratio) - 1.0;
        let efficiency =
            (self.compressor_efficiency * (1.0 - self.compressor_falloff * relative * relative)).max(0.3);
        Compressor { flow_kg_s: flow, power_w: (flow * head / efficiency).max(0.0), surge: false }
    }

    /// Power of the turbine \[W\] for `flow_kg_s` of gas of c_p \[J/kg/K\] and R/c_p `kappa`, expanded from `t_k` over the
    /// pressure ratio `p7_p6`.
    pub fn turbine_power_w(
        &self,
        w_rad_s: f64,
        flow_kg_s: f64,
        cp: f64,
        kappa: f64,
        t_k: f64,
        p7_p6: f64,
    ) -> f64 {
        if flow_kg_s <= 0.0 || p7_p6 >= 1.0 {
            return 0.0;
        }
        let drop = cp * t_k * -(kappa * p7_p6.ln()).exp_m1();
        let ratio = 0.5 * self.turbine_m * w_rad_s / ((2.0 * drop).sqrt() * self.best_speed_ratio);
        let efficiency = self.turbine_efficiency * (ratio * (2.0 - ratio)).max(0.1);
        efficiency * flow_kg_s * drop
    }

    /// dw/dt \[rad/s2\].
    pub fn acceleration(&self, w_rad_s: f64, turbine_w: f64, compressor_w: f64) -> f64 {
        let power =
            self.mechanical_efficiency * turbine_w - compressor_w - self.friction_w_s2 * w_rad_s * w_rad_s;
        if w_rad_s <= self.least_rad_s && power < 0.0 {
            return 0.0;
        }
        power / (self.inertia_kg_m2 * w_rad_s.max(self.least_rad_s))
    }
}
