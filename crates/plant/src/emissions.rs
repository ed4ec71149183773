//! Engine-out emissions of a cycle: NO from the burned zone, CO and HC by surrogates.
//!
//! CO: rich, the oxygen deficit in water-gas equilibrium frozen at 1740 K (Heywood 4.9); to that a share of the fuel's
//! carbon that mixing leaves half burned at any lambda. HC: fuel that hides in crevices and oil, less what oxidises late,
//! and all fuel of cycles that burn in part or not at all. Trends only; no catalyst.
//!
//! What hides is the charge that peak pressure packs into the crevices, p V_c/(R T_w m) of it (Heywood 1988, 11.4.3), and
//! an oil film that takes `oil_share` of that on a wall of 440 K and 1/e more for each 60 K below. Of it the share
//! s r(lambda) exp(-(T - 1150 K)/370 K) survives late burning in cylinder and port, T the gas in the cylinder at bottom dead centre,
//! after blow-down. What is left to burn leaves the walls in the exhaust stroke and burns in that gas, in cylinder and port, before the gas
//! has lost its heat: oxidation stops below some 1100 K (Heywood 1988, 11.4.3, from memory), which no manifold has at part load. 370 K: retard
//! by 1 deg heats that gas by 5.6 K here (2000 rpm, 70 Nm) and takes 1.5 % (class -1 to -2, from memory). r is a table
//! over lambda: HC in ppm measured on a real engine at lambda 0.7 to 1.2 over its value at 1, less what carbon of the exhaust and
//! temperature do here at 2000 rpm and 70 Nm. It falls where oxygen appears.
//!
//! Gas that comes out of crevices and oil leaves the cylinder last, so that what stays as residual gas is richer in HC than
//! what has left: with `retained` times the mean concentration in a residual share x, the share 1 - `retained` x leaves and
//! the rest burns in the next cycle. Gas recirculated outside is no residual gas here: it has left, and has the mean concentration. Of
//! exhaust of which the share e goes round, e of the HC comes back and burns, so that the concentration falls by 1 - e.

use crate::dissociation::BurnedTable;
use crate::end_gas::EndGas;
use crate::equilibrium::FUEL;
use crate::gas::AIR_ALONE;
use serde::{Deserialize, Serialize};

/// Constants of the surrogates.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct EmissionsModel {
    /// Share of the fuel that survives in crevices and oil \[-\] (class 0.01 to 0.02).
    pub crevice_share: f64,
    /// Share of the fuel's carbon that leaves as CO at any lambda \[-\] (class 0.02 to 0.05 lean of stoichiometric).
    pub unmixed_share: f64,
    /// Multiplier of the rate of formation of NO \[-\]; 1 is the mechanism.
    pub no_factor: f64,
    /// Crevices, oil film and late oxidation in place of `crevice_share`.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub hydrocarbons: Option<Hydrocarbons>,
}

/// Constants of what hides and survives.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Hydrocarbons {
    /// Crevices of a cylinder V_c \[m3\].
    pub crevice_m3: f64,
    /// What the oil film holds over what the crevices hold, wall at 440 K \[-\].
    pub oil_share: f64,
    /// Share s that survives at lambda 1 and 1150 K \[-\].
    pub survival: f64,
    /// Concentration of HC in the gas that stays in the cylinder over the mean of what has left \[-\]; 0: nothing stays.
    #[serde(default)]
    pub retained: f64,
}

/// What a cycle was like for the fuel that hides.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Hidden {
    /// Peak pressure \[Pa\].
    pub peak_pa: f64,
    /// Mass of the charge \[kg\].
    pub trapped_kg: f64,
    /// Wall of the cylinder \[K\].
    pub wall_k: f64,
    /// Gas in the cylinder after blow-down, at bottom dead centre \[K\].
    pub blown_down_k: f64,
    /// Share of the charge that never left the cylinder or flowed back out of a port \[-\].
    pub residual: f64,
    /// Share of the charge that was recirculated outside \[-\].
    pub recirculated: f64,
}

/// Wall of the constants, gas constant \[J/kg/K\] of what hides; temperature after blow-down and its scale \[K\].
const WALL_K: f64 = 440.0;
const R_CHARGE: f64 = 280.0;
const BLOWN_DOWN_K: (f64, f64) = (1150.0, 370.0);
/// Least share of HC that leaves the cylinder \[-\]: the form does not hold where nearly all gas stays.
const LEAST_LEFT: f64 = 0.2;
/// Survival r over lambda, linear in between and held at the ends.
const SURVIVAL: [(f64, f64); 5] = [(0.7, 1.12), (0.9, 1.21), (1.0, 1.0), (1.1, 0.56), (1.2, 0.51)];

/// r at a lambda.
fn survival(lambda: f64) -> f64 {
    let k = SURVIVAL.partition_point(|p| p.0 <= lambda).clamp(1, SURVIVAL.len() - 1);
    let ((l0, r0), (l1, r1)) = (SURVIVAL[k - 1], SURVIVAL[k]);
    r0 + ((lambda - l0) / (l1 - l0)).clamp(0.0, 1.0) * (r1 - r0)
}

impl Hydrocarbons {
    /// Share of the fuel that leaves unburned, in the concentration of the exhaust: with recirculation less than of the fuel of the charge.
    ///
    /// ```
    /// use dynocal_plant::emissions::{Hidden, Hydrocarbons};
    /// let h = Hydrocarbons { crevice_m3: 1e-6, oil_share: 0.25, survival: 0.16, retained: 0.0 };
    /// let warm = Hidden {
    ///     peak_pa: 29e5,
    ///     trapped_kg: 3e-4,
    ///     wall_k: 440.0,
    ///     blown_down_k: 1150.0,
    ///     residual: 0.1,
    ///     recirculated: 0.0,
    /// };
    /// let [rich, one, lean] = [0.9, 1.0, 1.1].map(|lambda| h.share(&warm, lambda));
    /// assert!(one > 0.008 && one < 0.019 && rich > 1.15 * one && lean < 0.8 * one);
    /// let cold = h.share(&Hidden { wall_k: 370.0, ..warm }, 1.0) / one;
    /// assert!(cold > 1.5 && cold < 2.0);
    /// // A third of it stays where the residual gas is richer by a factor of 2.5.
    /// let kept = Hydrocarbons { retained: 2.5, ..h }.share(&Hidden { residual: 0.4 / 3.0, ..warm }, 1.0);
    /// assert!((kept / one - 2.0 / 3.0).abs() < 1e-12);
    /// // Of what is recirculated nothing stays behind in the cylinder: a ninth of the exhaust goes round.
    /// let round = h.share(&Hidden { recirculated: 0.1, ..warm }, 1.0) / one;
    /// assert!((round - 8.0 / 9.0).abs() < 1e-12);
    /// ```
    pub fn share(&self, c: &Hidden, lambda: f64) -> f64 {
        let crevices = c.peak_pa * self.crevice_m3 / (R_CHARGE * c.wall_k * c.trapped_kg.max(1e-6));
        let oil = self.oil_share * ((WALL_K - c.wall_k) / 60.0).min(4.0).exp() * c.wall_k / WALL_K;
        let mixture = survival(lambda);
        let late = (-(c.blown_down_k - BLOWN_DOWN_K.0) / BLOWN_DOWN_K.1).exp();
        let left = (1.0 - self.retained * c.residual).max(LEAST_LEFT);
        // Exhaust that leaves a cylinder is what was not residual gas in it.
        let out = 1.0 - c.recirculated / (1.0 - c.residual).max(c.recirculated).max(1e-6);
        (crevices * (1.0 + oil) * self.survival * mixture * late * left * out).clamp(0.0, 1.0)
    }
}

/// Molar mass of air \[kg/mol\].
const AIR_KG_MOL: f64 = 28.85e-3;

/// Engine-out gas of one cycle, wet.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize)]
pub struct EngineOut {
    /// Nitric oxide \[ppm\].
    pub no_ppm: f64,
    /// Carbon monoxide \[%\].
    pub co_pct: f64,
    /// Unburned fuel as carbon atoms \[ppm C1\].
    pub hc_ppm: f64,
}

impl EmissionsModel {
    /// Of a charge of `lambda` of which the share `stable` burns, whose burned zone ended as `zone`; `afr` is stoichiometric air over fuel.
    pub fn cycle(
        &self,
        table: &BurnedTable,
        zone: &EndGas,
        (lambda, afr): (f64, f64),
        stable: f64,
        hidden: &Hidden,
    ) -> EngineOut {
        let [co, _, _] = table.frozen(lambda);
        // Moles of exhaust per mole of fuel, from the mass; carbon per mole of exhaust.
        let fuel_kg = FUEL.0 * 12.011e-3 + FUEL.1 * 1.008e-3;
        let moles = fuel_kg * (1.0 + afr * lambda) / AIR_KG_MOL;
        // Without fuel lambda stands at its end.
        let carbon = if lambda < AIR_ALONE { FUEL.0 / moles } else { 0.0 };
        let survived = self.hydrocarbons.map_or(self.crevice_share, |h| h.share(hidden, lambda));
        let alive = survived * stable + (1.0 - stable);
        EngineOut {
            no_ppm: 1e6 * (zone.x_no * zone.burned + zone.entrained * (1.0 - zone.burned)),
            co_pct: 100.0 * stable * (co + self.unmixed_share * carbon),
            hc_ppm: 1e6 * alive * carbon,
        }
    }
}
