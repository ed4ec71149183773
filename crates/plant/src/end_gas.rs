//! The unburned gas of a cylinder from intake closing on: its temperature, the knock integral, and the burned zone.
//!
//! T_u follows compression with loss of heat, dT_u = kappa T_u dp/p - s h A (T_u - T_w)/(m c_p) dt with kappa = R/c_p of
//! the trapped mixture, h of the heat law of the cylinder, its surface A and charge m: the end gas has as much surface
//! to its mass as the whole charge; s = 0 leaves the isentrope. Knock is the Livengood-Wu integral of dt/tau until 90 % burned with the delay of Douaud and Eyzat (SAE 780080)
//!
//! tau \[ms\] = K 17.68 (ON/100)^3.402 p\[atm\]^-1.7 exp(3800/T_u);
//!
//! with `oxygen_exponent` a and `fuel_exponent` b times (Y/Y_0)^-a (phi/phi_0)^-b, Y the share of air in the charge, phi 1/lambda,
//! at the charge that the correlation was fitted on: phi_0 1.1, 6 % residual gas. Ignition delays of iso-octane give a 1.41, b
//! 0.77 (He, Donovan, Zigler et al., Combust. Flame 142 (2005), from memory). They were measured at phi 0.25 to 1, so that fuel beyond phi_0
//! is not taken to shorten the delay: the factor of the fuel stays there at 1, the value of the engine of the correlation.
//!
//! 1 is the onset. Valid for the gasoline of the correlation (octane 80 to 100), no two-stage ignition, no cyclic
//! scatter: it is an index. The burned zone holds what is left of the mean temperature, T_b = (T - (1 - x_b) T_u)/x_b
//! (equal gas constants); nitric oxide forms there.

use crate::gas::GasModel;
use crate::nitric_oxide::{FROZEN_K, ZeldovichTable};
use serde::{Deserialize, Serialize};

/// Constants of the knock integral.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct KnockModel {
    /// Octane number ON.
    pub octane: f64,
    /// Multiplier K of the delay \[-\]; 1 as published.
    pub delay_factor: f64,
    /// Share s of the wall heat of the cylinder that the end gas takes part in \[-\]; 0: isentropic.
    #[serde(default)]
    pub wall_share: f64,
    /// Exponent a of oxygen \[-\]; 0 leaves it out.
    #[serde(default)]
    pub oxygen_exponent: f64,
    /// Exponent b of fuel \[-\]; 0 leaves it out.
    #[serde(default)]
    pub fuel_exponent: f64,
}

/// Equivalence ratio and residual gas of the engine on which the delay was measured.
const FITTED: (f64, f64) = (1.1, 0.06);

impl KnockModel {
    /// Delay of a charge of `lambda` with the share `residual` of burned gas over that of the charge of the correlation.
    ///
    /// ```
    /// use dynocal_plant::end_gas::KnockModel;
    /// let k = KnockModel { octane: 95.0, delay_factor: 1.0, wall_share: 0.0, oxygen_exponent: 1.41, fuel_exponent: 0.77 };
    /// assert!((k.charge_factor(1.0 / 1.1, 0.06, 14.7) - 1.0).abs() < 1e-12);
    /// // Residual gas slows the end gas down, and so does less fuel.
    /// assert!(k.charge_factor(1.0, 0.20, 14.7) > k.charge_factor(1.0, 0.06, 14.7));
    /// assert!(k.charge_factor(1.0, 0.06, 14.7) > 1.05);
    /// // More fuel than on that engine does not speed it up: no ignition delay behind the exponents is so rich.
    /// assert!(k.charge_factor(0.75, 0.06, 14.7) >= 1.0);
    /// ```
    pub fn charge_factor(&self, lambda: f64, residual: f64, afr: f64) -> f64 {
        if self.oxygen_exponent == 0.0 && self.fuel_exponent == 0.0 {
            return 1.0;
        }
        let air = |lambda: f64, residual: f64| (1.0 - residual) * lambda * afr / (1.0 + lambda * afr);
        let (phi, rest) = FITTED;
        let oxygen = (air(lambda, residual) / air(1.0 / phi, rest)).max(0.05);
        oxygen.powf(-self.oxygen_exponent) * (lambda * phi).max(1.0).powf(self.fuel_exponent)
    }

    /// Ignition delay \[s\] of end gas at `p_pa`, `t_k`.
    ///
    /// ```
    /// use dynocal_plant::end_gas::KnockModel;
    /// let k = KnockModel { octane: 100.0, delay_factor: 1.0, wall_share: 0.0, oxygen_exponent: 0.0, fuel_exponent: 0.0 };
    /// let expected = 17.68e-3 * 40f64.powf(-1.7) * (3800.0f64 / 850.0).exp();
    /// assert!((k.delay_s(40.0 * 101_325.0, 850.0) / expected - 1.0).abs() < 1e-12);
    /// ```
    #[inline]
    pub fn delay_s(&self, p_pa: f64, t_k: f64) -> f64 {
        let octane = self.delay_factor * 17.68e-3 * (self.octane / 100.0).powf(3.402);
        octane * (3800.0 / t_k - 1.7 * (p_pa / 101_325.0).ln()).exp()
    }
}

/// Unburned gas and burned zone of one cylinder in the running cycle.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize)]
pub struct EndGas {
    /// Temperature of the unburned gas \[K\]; 0 while nothing is followed.
    pub t_k: f64,
    /// Pressure of the last step \[Pa\].
    pub p_pa: f64,
    /// Coefficients of the parabola kappa(T), lowest power first.
    pub kappa: [f64; 3],
    /// Knock integral.
    pub knock: f64,
    /// Mole fraction of NO in the burned zone.
    pub x_no: f64,
    /// Burned share at the last step.
    pub burned: f64,
    /// Hottest burned zone of the cycle \[K\].
    pub burned_k: f64,
    /// Mole fraction of NO that residual gas brings into the charge.
    pub entrained: f64,
    /// Delay of this charge over that of the correlation \[-\]; 0 until the charge is known, which counts as 1.
    pub slower: f64,
}

/// One step of a cylinder.
#[derive(Debug, Clone, Copy)]
pub struct ZoneStep {
    /// Time \[s\].
    pub dt_s: f64,
    /// Pressure in the middle of the step \[Pa\].
    pub p_pa: f64,
    /// Mean temperature \[K\].
    pub t_k: f64,
    /// Burned share of the charge.
    pub burned: f64,
    /// Lambda of the charge.
    pub lambda: f64,
    /// h A/(m R) of the cylinder \[1/s\], and the temperature of its walls \[K\].
    pub wall_1_s: f64,
    /// See `wall_1_s`.
    pub wall_k: f64,
}

impl EndGas {
    /// Intake closed: follow gas of these masses (air, fuel, products) from `p_pa`, `t_k`.
    pub fn closed(gas: &GasModel, mass_kg: [f64; 3], p_pa: f64, t_k: f64) -> Self {
        let r = gas.mass_r_j_k(mass_kg);
        let kappa = |t: f64| r / (gas.heat_capacity_j_k(mass_kg, t) + r);
        // Newton's form through three temperatures of a compression, expanded.
        let [a, b, c] = [350.0, 600.0, 900.0];
        let first = (kappa(b) - kappa(a)) / (b - a);
        let second = ((kappa(c) - kappa(b)) / (c - b) - first) / (c - a);
        let parabola = [kappa(a) - first * a + second * a * b, first - second * (a + b), second];
        Self { t_k, p_pa, kappa: parabola, ..Self::default() }
    }

    /// Follows the unburned gas and the knock integral over a step.
    #[inline]
    pub fn advance(&mut self, knock: Option<&KnockModel>, s: &ZoneStep) {
        let kappa = |t: f64| self.kappa[0] + t * (self.kappa[1] + t * self.kappa[2]);
        let ln = (s.p_pa / self.p_pa).ln();
        let middle = self.t_k * (1.0 + 0.5 * kappa(self.t_k) * ln);
        self.t_k *= (kappa(middle) * ln).exp();
        self.p_pa = s.p_pa;
        if let Some(model) = knock
            && model.wall_share > 0.0
        {
            // Exact for walls that stand still: never past them.
            let rate = model.wall_share * s.wall_1_s * kappa(middle);
            self.t_k = s.wall_k + (self.t_k - s.wall_k) * (-rate * s.dt_s).exp();
        }
        if let Some(model) = knock
            && s.burned < 0.9
        {
            let slower = if self.slower > 0.0 { self.slower } else { 1.0 };
            self.knock += s.dt_s / (slower * model.delay_s(s.p_pa, self.t_k));
        }
    }

    /// Nitric oxide of the burned zone over a step: fresh burned gas dilutes it, the mechanism forms or destroys it.
    #[inline]
    pub fn react(&mut self, table: &ZeldovichTable, s: &ZoneStep) {
        // A thin zone has no temperature of its own.
        if s.burned < 0.02 {
            return;
        }
        if s.burned > self.burned {
            let fresh = s.burned - self.burned;
            self.x_no = (self.x_no * self.burned + self.entrained * fresh) / s.burned;
            self.burned = s.burned;
        }
        let t_k = ((s.t_k - (1.0 - s.burned) * self.t_k) / s.burned).min(3200.0);
        self.burned_k = self.burned_k.max(t_k);
        if t_k > FROZEN_K {
            self.x_no = table.at(s.lambda, t_k, s.p_pa).advance(self.x_no, t_k, s.p_pa, s.dt_s);
        }
    }
}
