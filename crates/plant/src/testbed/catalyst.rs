//! Three-way catalyst: light-off and oxygen storage.
//!
//! The brick: C T' = e m' cp (T_g - T) + eta q m'_f LHV - UA (T - T_a), conversion eta = 1/(1 + e^(-(T - T50)/w)).
//! Oxygen: of the excess w_O2 m'_a (1 - 1/lambda) of the feed gas the brick stores (or, rich, releases) the share
//! eta (1 - theta^n) (or eta (1 - (1 - theta)^n)), theta the filling; what is left reaches the sensor behind it. The
//! form with a limited filling rate follows the one-state storage models of engine control (Brandt, Wang and Grizzle,
//! IEEE TCST 8(5), 2000); the exponent makes the breakthrough as sharp as wanted.

use serde::{Deserialize, Serialize};

/// Mass fraction of oxygen in air.
const OXYGEN: f64 = 0.232;

/// Constants.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct CatalystSettings {
    /// Temperature at the start \[K\].
    pub start_k: f64,
    /// Ambient temperature \[K\].
    pub ambient_k: f64,
    /// Heat capacity of the brick \[J/K\].
    pub capacity_j_k: f64,
    /// Share of the gas heat that the brick takes up \[-\].
    pub effectiveness: f64,
    /// Share of the fuel's heating value that burns in the warm brick \[-\].
    pub exotherm: f64,
    /// Conductance to ambient \[W/K\].
    pub ambient_w_k: f64,
    /// Light-off temperature \[K\]: half of the gas is converted.
    pub light_off_k: f64,
    /// Width of the light-off \[K\].
    pub width_k: f64,
    /// Oxygen that the brick stores \[g\].
    pub oxygen_g: f64,
    /// Exponent n of the filling.
    pub sharpness: f64,
}

impl Default for CatalystSettings {
    /// A close-coupled brick of 1.2 l; warm.
    fn default() -> Self {
        Self {
            start_k: 800.0,
            ambient_k: 293.15,
            capacity_j_k: 1100.0,
            effectiveness: 0.9,
            exotherm: 0.03,
            ambient_w_k: 2.0,
            light_off_k: 543.0,
            width_k: 15.0,
            oxygen_g: 1.0,
            sharpness: 8.0,
        }
    }
}

/// What moves.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct CatalystState {
    /// Temperature of the brick \[K\].
    pub brick_k: f64,
    /// Filling of the oxygen store, 0..1.
    pub filling: f64,
    /// Lambda behind the catalyst.
    pub lambda: f64,
}

/// Gas that enters in one step.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Feed {
    /// Mass \[g\].
    pub gas_g: f64,
    /// Temperature \[K\].
    pub gas_k: f64,
    /// Lambda.
    pub lambda: f64,
    /// Stoichiometric air over fuel.
    pub afr: f64,
    /// Lower heating value of the fuel \[J/g\].
    pub lhv_j_g: f64,
}

/// Heat capacity of exhaust gas.
const CP_J_G_K: f64 = 1.15;

impl CatalystSettings {
    /// Brick at the start temperature, store half full.
    pub fn start(&self) -> CatalystState {
        CatalystState { brick_k: self.start_k, filling: 0.5, lambda: 1.0 }
    }

    /// Share that is converted at a temperature of the brick.
    pub fn conversion(&self, brick_k: f64) -> f64 {
        1.0 / (1.0 + (-(brick_k - self.light_off_k) / self.width_k).exp())
    }

    /// Oxygen above stoichiometric in a feed \[g\], negative when rich.
    pub fn excess_oxygen_g(feed: &Feed) -> f64 {
        let air_over_fuel = feed.lambda * feed.afr;
        let air_g = feed.gas_g * air_over_fuel / (1.0 + air_over_fuel);
        OXYGEN * air_g * (1.0 - 1.0 / feed.lambda)
    }

    /// One step of `h_s`.
    pub fn step(&self, s: &mut CatalystState, feed: &Feed, h_s: f64) {
        let gas_g = feed.gas_g.max(0.0);
        let feed = Feed { gas_g, lambda: feed.lambda.clamp(0.3, 9.99), ..*feed };
        let eta = self.conversion(s.brick_k);
        let fuel_g = gas_g / (1.0 + feed.lambda * feed.afr);
        let heat = self.effectiveness * gas_g * CP_J_G_K * (feed.gas_k - s.brick_k)
            + eta * self.exotherm * fuel_g * feed.lhv_j_g
            - h_s * self.ambient_w_k * (s.brick_k - self.ambient_k);
        s.brick_k += heat / self.capacity_j_k;
        let excess = Self::excess_oxygen_g(&feed);
        let room = if excess > 0.0 { s.filling } else { 1.0 - s.filling };
        let wanted = eta * (1.0 - room.powf(self.sharpness)) * excess;
        let filling = (s.filling + wanted / self.oxygen_g).clamp(0.0, 1.0);
        let stored = (filling - s.filling) * self.oxygen_g;
        s.filling = filling;
        if gas_g > 0.0 {
            let air_g = gas_g - fuel_g;
            s.lambda = (1.0 / (1.0 - (excess - stored) / (OXYGEN * air_g))).clamp(0.3, 9.99);
        }
    }
}

impl CatalystState {
    pub(crate) fn visit(&mut self, f: &mut impl FnMut(&mut f64)) {
        [&mut self.brick_k, &mut self.filling, &mut self.lambda].into_iter().for_each(f);
    }
}
