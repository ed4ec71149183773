//! Warm-up: cylinder walls, coolant and oil as three lumped masses.
//!
//! C_w T_w' = Q_gas - UA_wc (T_w - T_c)
//! C_c T_c' = UA_wc (T_w - T_c) - UA_co (T_c - T_o) - open(T_c) UA_r (T_c - T_a)
//! C_o T_o' = s Q_friction + UA_co (T_c - T_o) - UA_oa (T_o - T_a)
//!
//! An engine whose exhaust ports and manifold are apart has one mass more where it starts cold (below [`COLD_START_K`]),
//!
//! C_m T_m' = Q_manifold - UA_ma (T_m - T_a),
//!
//! with constants of the engine ([`crate::exhaust_wall`]). A bed that starts warm is taken to have run long before: there the
//! wall of the manifold is at rest with the gas.
//!
//! The thermostat opens in proportion between two temperatures. Friction follows the viscosity of the oil,
//! (nu(T_o)/nu(90 degC))^0.24, with Vogel's nu = A e^(B/(T - C)) of a 5W-30 oil (62 mm2/s at 40 degC, 10.5 at 100).
//! The exponent is a textbook value for whole engines; masses and conductances are assumptions of a 2 l engine.

use crate::deviations::Deviations;
use crate::engine::VirtualEngine;
use serde::{Deserialize, Serialize};

/// Constants.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct ThermalSettings {
    /// Temperature of all masses at the start \[K\].
    pub start_k: f64,
    /// Ambient temperature \[K\].
    pub ambient_k: f64,
    /// Heat capacities of walls, coolant with block, oil \[J/K\].
    pub capacity_j_k: [f64; 3],
    /// Conductance between walls and coolant \[W/K\].
    pub wall_coolant_w_k: f64,
    /// Conductance between coolant and oil \[W/K\].
    pub coolant_oil_w_k: f64,
    /// Conductance of the radiator with open thermostat \[W/K\].
    pub radiator_w_k: f64,
    /// Conductance between oil and ambient \[W/K\].
    pub oil_ambient_w_k: f64,
    /// Temperatures at which the thermostat begins to open and is open \[K\].
    pub thermostat_k: [f64; 2],
    /// Share of the friction work that heats the oil \[-\].
    pub friction_share: f64,
    /// Exponent of the viscosity ratio in the friction \[-\].
    pub viscosity_exponent: f64,
}

impl Default for ThermalSettings {
    /// Cold start at 20 degC.
    fn default() -> Self {
        Self {
            start_k: 293.15,
            ambient_k: 293.15,
            capacity_j_k: [4.0e3, 30.0e3, 9.0e3],
            wall_coolant_w_k: 180.0,
            coolant_oil_w_k: 120.0,
            radiator_w_k: 1500.0,
            oil_ambient_w_k: 15.0,
            thermostat_k: [358.15, 368.15],
            friction_share: 0.6,
            viscosity_exponent: 0.24,
        }
    }
}

/// Start temperature below which the wall of the exhaust manifold is followed \[K\].
pub const COLD_START_K: f64 = 340.0;

/// Temperatures \[K\].
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct ThermalState {
    /// Cylinder walls.
    pub wall_k: f64,
    /// Coolant.
    pub coolant_k: f64,
    /// Oil.
    pub oil_k: f64,
    /// Wall of the exhaust manifold where it is followed.
    pub manifold_k: f64,
    /// Heat given to the surroundings since the start \[J\].
    pub lost_j: f64,
}

impl ThermalSettings {
    /// All masses at the start temperature.
    pub fn start(&self) -> ThermalState {
        let t = self.start_k;
        ThermalState { wall_k: t, coolant_k: t, oil_k: t, manifold_k: t, lost_j: 0.0 }
    }

    /// One step of `h_s` with the heat of the gas and the friction work \[J\] that fell in it.
    pub fn step(&self, s: &mut ThermalState, gas_j: f64, friction_j: f64, h_s: f64) {
        // Time constants are tens of seconds: the explicit rule is exact enough at ticks and conserves energy.
        let pieces = (h_s / 0.1).ceil().max(1.0);
        let h = h_s / pieces;
        for _ in 0..pieces as usize {
            let [cw, cc, co] = self.capacity_j_k;
            let [begins, open] = self.thermostat_k;
            let opening = ((s.coolant_k - begins) / (open - begins)).clamp(0.0, 1.0);
            let to_coolant = h * self.wall_coolant_w_k * (s.wall_k - s.coolant_k);
            let to_oil = h * self.coolant_oil_w_k * (s.coolant_k - s.oil_k);
            let radiator = h * opening * self.radiator_w_k * (s.coolant_k - self.ambient_k);
            let from_oil = h * self.oil_ambient_w_k * (s.oil_k - self.ambient_k);
            s.wall_k += (gas_j / pieces - to_coolant) / cw;
            s.coolant_k += (to_coolant - to_oil - radiator) / cc;
            s.oil_k += (self.friction_share * friction_j / pieces + to_oil - from_oil) / co;
            s.lost_j += radiator + from_oil;
        }
    }

    /// What the engine is given of these temperatures.
    pub fn applied(&self, s: &ThermalState, d: Deviations) -> Deviations {
        Deviations {
            cylinder_wall_k: Some(s.wall_k),
            coolant_k: Some(s.coolant_k),
            manifold_wall_k: self.follows_manifold().then_some(s.manifold_k),
            friction_factor: self.friction_factor(s.oil_k),
            film_factor: self.film_factor(s.coolant_k),
            ..d
        }
    }

    fn follows_manifold(&self) -> bool {
        self.start_k < COLD_START_K
    }

    /// One step of the wall of the exhaust manifold, where it is followed, with the heat `exhaust_j` \[J\] that ports and manifold took in it.
    pub fn manifold(&self, s: &mut ThermalState, engine: &VirtualEngine, exhaust_j: f64, h_s: f64) {
        let (Some(wall), Some(sinks)) = (engine.params().exhaust_wall, engine.exhaust_sinks()) else {
            return;
        };
        // Mean temperature of the gas from the heat of both, then the part of the manifold.
        let (both_w_k, rest_k) = sinks.joined();
        if !self.follows_manifold() || both_w_k <= 0.0 {
            return;
        }
        let gas_k = rest_k + exhaust_j / (h_s * both_w_k);
        let to_wall = h_s * sinks.manifold.0 * (gas_k - sinks.manifold.1);
        let lost = h_s * wall.ambient_w_k * (s.manifold_k - self.ambient_k);
        s.manifold_k += (to_wall - lost) / wall.manifold_j_k;
        s.lost_j += lost;
    }

    /// Friction over that of the engine at 90 degC oil.
    pub fn friction_factor(&self, oil_k: f64) -> f64 {
        (viscosity_mm2_s(oil_k) / viscosity_mm2_s(363.15)).powf(self.viscosity_exponent)
    }

    /// Time constant of the port film over that of the engine at 90 degC coolant: e-fold in 40 K (assumption).
    pub fn film_factor(&self, coolant_k: f64) -> f64 {
        ((363.15 - coolant_k) / 40.0).clamp(-1.0, 3.0).exp()
    }
}

/// Kinematic viscosity of a 5W-30 oil \[mm2/s\].
pub fn viscosity_mm2_s(oil_k: f64) -> f64 {
    const C_K: f64 = 170.0;
    let x = 1.0 / (oil_k.clamp(240.0, 450.0) - C_K);
    let (x40, x100) = (1.0 / (313.15 - C_K), 1.0 / (373.15 - C_K));
    let b = (62.0f64 / 10.5).ln() / (x40 - x100);
    10.5 * (b * (x - x100)).exp()
}

impl ThermalState {
    pub(crate) fn visit(&mut self, f: &mut impl FnMut(&mut f64)) {
        [&mut self.wall_k, &mut self.coolant_k, &mut self.oil_k, &mut self.manifold_k, &mut self.lost_j]
            .into_iter()
            .for_each(f);
    }
}
