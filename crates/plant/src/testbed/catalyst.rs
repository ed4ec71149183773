//! Three-way catalyst: a monolith in axial cells, with light-off that moves inward and stores of oxygen.
//!
//! Gas flows through a pipe with a wall and then from cell to cell; in each it gives heat to brick or wall (effectiveness
//! 1 - e^-NTU), reacts, and takes or leaves oxygen. Brick of one cell: C T' = m' c_p (T_in - T_out) + q - UA (T - T_a).
//!
//! Reaction: share 1 - e^-N of what arrives, 1/N = 1/N_r + 1/N_m with N_r = a e^(E (1/T_50 - 1/T)) V/m' (kinetics) and N_m
//! (mass transfer); its heat q is bounded by the oxygen there is, by the balance of elements.
//!
//! Oxygen: each cell holds m_i <= c(m'), with the usable capacity c = C_O/(1 + m'/m_half); of the excess w_O2 m'_a (1 -
//! 1/lambda) of the gas a cell takes the share 1 - e^(-k_f eta (1 - m_i/c)), of a deficit it gives 1 - e^(-k_r eta m_i/c),
//! with k_f > k_r: a store fills faster than it empties. Form of the store after Brandt, Wang and Grizzle (IEEE TCST 8(5),
//! 2000); a monolith in cells is the usual one-dimensional model (Pontikakis, Konstantas and Stamatelos, J. Eng. Gas
//! Turbines Power 126, 2004). Neither was looked up for this code; the constants are assumptions.
//!
//! Conserved: energy of gas, brick and reaction; oxygen in, out and stored. Not modelled: single species, water that
//! condenses, the radial profile, ageing.

use crate::gas::AIR_ALONE;
use serde::{Deserialize, Serialize};

/// Mass fraction of oxygen in air.
const OXYGEN: f64 = 0.232;
/// Heat capacity of exhaust gas \[J/g/K\].
const CP_J_G_K: f64 = 1.15;
/// Heat of combustion \[kJ/mol\] and oxygen (O2) that it takes \[mol/mol\]: CO, H2, and one carbon of gasoline (CH1.87). Per gram of oxygen
/// that is 17.7, 15.1 and 12.8 kJ: which of them lack it is what rich gas can heat.
const CO: (f64, f64) = (283.0, 0.5);
const H2: (f64, f64) = (242.0, 0.5);
const HC: (f64, f64) = (600.0, 1.47);
/// Heat of combustion per mass of oxygen \[J/g\] where nothing tells one from another.
const HEAT_J_G_O2: f64 = 14e3;
/// Cells along the brick.
pub const CELLS: usize = 10;

/// Constants.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct CatalystSettings {
    /// Temperature of brick and pipe at the start \[K\].
    pub start_k: f64,
    /// Ambient temperature \[K\].
    pub ambient_k: f64,
    /// Heat capacity of the brick \[J/K\].
    pub capacity_j_k: f64,
    /// Conductance between gas and brick \[W/K\].
    pub gas_brick_w_k: f64,
    /// Conductance of the brick to ambient \[W/K\].
    pub ambient_w_k: f64,
    /// Heat capacity of the pipe before the brick \[J/K\].
    pub pipe_j_k: f64,
    /// Conductance between gas and pipe \[W/K\].
    pub gas_pipe_w_k: f64,
    /// Conductance of the pipe to ambient \[W/K\].
    pub pipe_ambient_w_k: f64,
    /// Temperature at which a brick that is equally hot converts half at `reference_g_s` \[K\].
    pub light_off_k: f64,
    /// Activation temperature E \[K\].
    pub activation_k: f64,
    /// Flow of that conversion \[g/s\].
    pub reference_g_s: f64,
    /// Number of transfer units N_m of mass transfer over the whole brick \[-\].
    pub mass_transfer: f64,
    /// Oxygen that the brick stores at no flow \[g\].
    pub oxygen_g: f64,
    /// Flow at which half of that is usable \[g/s\].
    pub oxygen_half_g_s: f64,
    /// Rates k_f of filling and k_r of emptying over the whole brick \[-\].
    pub oxygen_rate: [f64; 2],
}

impl Default for CatalystSettings {
    /// A close-coupled brick of 1.2 l, 0.45 kJ/K a litre; turbine housing and pipe of 2 kg of steel with 0.11 m2 at 36.5 W/m2/K
    /// (the coefficient of a public model of a 2.0 l turbo engine); warm.
    fn default() -> Self {
        Self {
            start_k: 800.0,
            ambient_k: 293.15,
            capacity_j_k: 540.0,
            gas_brick_w_k: 200.0,
            ambient_w_k: 2.0,
            pipe_j_k: 900.0,
            gas_pipe_w_k: 4.0,
            pipe_ambient_w_k: 1.0,
            light_off_k: 573.0,
            activation_k: 12_000.0,
            reference_g_s: 10.0,
            mass_transfer: 3.5,
            oxygen_g: 1.2,
            oxygen_half_g_s: 60.0,
            oxygen_rate: [40.0, 15.0],
        }
    }
}

/// What moves.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct CatalystState {
    /// Temperature of the cells, inlet first \[K\].
    pub brick_k: [f64; CELLS],
    /// Oxygen in the cells \[g\].
    pub oxygen_g: [f64; CELLS],
    /// Oxygen held over what there is room for at no flow \[-\].
    pub filling: f64,
    /// Wall of the pipe \[K\].
    pub pipe_k: f64,
    /// Lambda behind the catalyst.
    pub lambda: f64,
    /// Share of the unburned gas that was converted in the last step \[-\].
    pub conversion: f64,
    /// Temperature of the gas behind the catalyst \[K\].
    pub out_k: f64,
    /// Heat of reaction and heat to ambient since the start \[J\].
    pub heat_j: [f64; 2],
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
    /// Heat of combustion of the unburned gas (CO, H2, HC) over the mass of all gas \[J/g\].
    pub unburned_j_g: f64,
    /// The same over the mass of the oxygen that burning it takes \[J/g\].
    pub heat_j_g_o2: f64,
}

impl Feed {
    /// Heat of combustion of exhaust with carbon monoxide \[%\] (and a third of it hydrogen) and unburned fuel \[ppm C1\], over the mass of
    /// the gas and over that of the oxygen it takes \[J/g\].
    ///
    /// ```
    /// use dynocal_plant::testbed::catalyst::Feed;
    /// let (of_co, of_hc) = (Feed::unburned_of(1.0, 0.0).1, Feed::unburned_of(0.0, 1000.0).1);
    /// // Three CO and one H2: (3 283 + 242) kJ over 2 mol of oxygen.
    /// assert!((of_co - 1091e3 / 64.0).abs() < 1.0 && (of_hc / 12.8e3 - 1.0).abs() < 0.01);
    /// ```
    pub fn unburned_of(co_pct: f64, hc_ppm: f64) -> (f64, f64) {
        let (co, hc) = (1e-2 * co_pct, 1e-6 * hc_ppm);
        let heat_kj = co * (CO.0 + H2.0 / 3.0) + hc * HC.0;
        let oxygen_g = 32.0 * (co * (CO.1 + H2.1 / 3.0) + hc * HC.1);
        // 28.8 g/mol of exhaust.
        (1e3 * heat_kj / 28.8, if oxygen_g > 0.0 { 1e3 * heat_kj / oxygen_g } else { HEAT_J_G_O2 })
    }

    /// The same where the engine has no emissions: 3 % of what the fuel of `lhv_j_g` could give (class of a warm engine at
    /// lambda 1); without fuel nothing.
    pub fn unburned_share(lhv_j_g: f64, lambda: f64, afr: f64) -> (f64, f64) {
        let heat = if lambda < AIR_ALONE { 0.03 * lhv_j_g / (1.0 + lambda * afr) } else { 0.0 };
        (heat, HEAT_J_G_O2)
    }
}

impl CatalystSettings {
    /// Brick and pipe at the start temperature, stores half full at no flow.
    pub fn start(&self) -> CatalystState {
        CatalystState {
            brick_k: [self.start_k; CELLS],
            oxygen_g: [0.5 * self.oxygen_g / CELLS as f64; CELLS],
            filling: 0.5,
            pipe_k: self.start_k,
            lambda: 1.0,
            conversion: 0.0,
            out_k: self.start_k,
            heat_j: [0.0; 2],
        }
    }

    /// Transfer units of reaction over the whole brick at one temperature and flow \[g/s\].
    fn units(&self, brick_k: f64, flow_g_s: f64) -> f64 {
        let kinetics = (self.activation_k * (1.0 / self.light_off_k - 1.0 / brick_k)).min(60.0).exp()
            * self.reference_g_s
            / flow_g_s.max(1e-6);
        // Half is converted at the light-off temperature: ln 2 units in all.
        let half = 1.0 / (1.0 / std::f64::consts::LN_2 - 1.0 / self.mass_transfer);
        1.0 / (1.0 / (half * kinetics) + 1.0 / self.mass_transfer)
    }

    /// Share that a brick of one temperature converts at `flow_g_s`, with oxygen enough.
    pub fn conversion(&self, brick_k: f64, flow_g_s: f64) -> f64 {
        -(-self.units(brick_k, flow_g_s)).exp_m1()
    }

    /// Usable capacity of the whole brick \[g\] at a flow \[g/s\].
    pub fn capacity_g(&self, flow_g_s: f64) -> f64 {
        self.oxygen_g / (1.0 + flow_g_s / self.oxygen_half_g_s)
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
        let flow = gas_g / h_s;
        let mcp = gas_g * CP_J_G_K;
        let mut gas_k = self.pipe(s, feed.gas_k, mcp, h_s);
        let mut excess = Self::excess_oxygen_g(&feed);
        let unburned_j = gas_g * feed.unburned_j_g.max(0.0);
        // Balance of elements: at lambda 1 there is just the oxygen that the unburned gas needs, rich there is less.
        let burnable_j = (unburned_j + feed.heat_j_g_o2 * excess.min(0.0)).max(0.0);
        let mut left_j = burnable_j;
        let cells = CELLS as f64;
        let warm = if mcp > 0.0 { -(-self.gas_brick_w_k * h_s / (cells * mcp)).exp_m1() } else { 0.0 };
        let room_g = self.capacity_g(flow) / cells;
        for i in 0..CELLS {
            let brick_k = s.brick_k[i];
            let to_brick = warm * mcp * (gas_k - brick_k);
            if mcp > 0.0 {
                gas_k -= to_brick / mcp;
            }
            let units = self.units(brick_k, flow) / cells;
            let burned_j = -(-units).exp_m1() * left_j;
            left_j -= burned_j;
            let lost_j = h_s * self.ambient_w_k / cells * (brick_k - self.ambient_k);
            s.brick_k[i] += (to_brick + burned_j - lost_j) * cells / self.capacity_j_k;
            s.heat_j[0] += burned_j;
            s.heat_j[1] += lost_j;
            excess -= self.store(&mut s.oxygen_g[i], excess, room_g, brick_k, flow);
        }
        s.filling = s.oxygen_g.iter().sum::<f64>() / self.oxygen_g;
        s.out_k = gas_k;
        s.conversion = if unburned_j > 0.0 { (burnable_j - left_j) / unburned_j } else { 0.0 };
        if gas_g > 0.0 {
            let fuel_g = gas_g / (1.0 + feed.lambda * feed.afr);
            let air_g = gas_g - fuel_g;
            s.lambda = (1.0 / (1.0 - excess / (OXYGEN * air_g))).clamp(0.3, 9.99);
        }
    }

    /// Heat to the pipe; temperature of the gas behind it \[K\].
    fn pipe(&self, s: &mut CatalystState, gas_k: f64, mcp: f64, h_s: f64) -> f64 {
        let lost_j = h_s * self.pipe_ambient_w_k * (s.pipe_k - self.ambient_k);
        let share = if mcp > 0.0 { -(-self.gas_pipe_w_k * h_s / mcp).exp_m1() } else { 0.0 };
        let to_pipe = share * mcp * (gas_k - s.pipe_k);
        s.pipe_k += (to_pipe - lost_j) / self.pipe_j_k;
        s.heat_j[1] += lost_j;
        if mcp > 0.0 { gas_k - to_pipe / mcp } else { gas_k }
    }

    /// Oxygen that a cell takes out of `excess` \[g\] (negative: gives).
    fn store(&self, held_g: &mut f64, excess: f64, room_g: f64, brick_k: f64, flow: f64) -> f64 {
        let active = self.conversion(brick_k, flow) / CELLS as f64;
        let taken = if excess > 0.0 {
            let free = (1.0 - *held_g / room_g).max(0.0);
            let share = -(-self.oxygen_rate[0] * active * free).exp_m1();
            (share * excess).min((room_g - *held_g).max(0.0))
        } else {
            let full = (*held_g / room_g).min(1.0);
            let share = -(-self.oxygen_rate[1] * active * full).exp_m1();
            (share * excess).max(-*held_g)
        };
        *held_g += taken;
        taken
    }
}

impl CatalystState {
    /// Mean temperature of the brick \[K\].
    pub fn mean_k(&self) -> f64 {
        self.brick_k.iter().sum::<f64>() / CELLS as f64
    }

    pub(crate) fn visit(&mut self, f: &mut impl FnMut(&mut f64)) {
        self.brick_k.iter_mut().chain(&mut self.oxygen_g).chain(&mut self.heat_j).for_each(&mut *f);
        [&mut self.filling, &mut self.pipe_k, &mut self.lambda, &mut self.conversion, &mut self.out_k]
            .into_iter()
            .for_each(f);
    }
}
