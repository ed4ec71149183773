//! Engine-out emissions of a cycle: NO from the burned zone, CO and HC by surrogates.
//!
//! CO: rich, the oxygen deficit in water-gas equilibrium frozen at 1740 K (Heywood 4.9); to that a share of the fuel's
//! carbon that mixing leaves half burned at any lambda. HC: a share of the fuel that hides in crevices and oil, and all
//! fuel of cycles that burn in part or not at all. Trends only; no oxidation in the port, no catalyst.

use crate::dissociation::BurnedTable;
use crate::end_gas::EndGas;
use crate::equilibrium::FUEL;
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
    /// Of a charge of `lambda` of which the share `stable` burns, whose burned zone ended as `zone`.
    pub fn cycle(&self, table: &BurnedTable, zone: &EndGas, lambda: f64, stable: f64) -> EngineOut {
        let [co, _, _] = table.frozen(lambda);
        // Moles of exhaust per mole of fuel, from the mass; carbon per mole of exhaust.
        let fuel_kg = FUEL.0 * 12.011e-3 + FUEL.1 * 1.008e-3;
        let moles = fuel_kg * (1.0 + 14.7 * lambda) / AIR_KG_MOL;
        let carbon = FUEL.0 / moles;
        let alive = self.crevice_share * stable + (1.0 - stable);
        EngineOut {
            no_ppm: 1e6 * (zone.x_no * zone.burned + zone.entrained * (1.0 - zone.burned)),
            co_pct: 100.0 * stable * (co + self.unmixed_share * carbon),
            hc_ppm: 1e6 * alive * carbon,
        }
    }
}
