//! External exhaust-gas recirculation: exhaust manifold to intake manifold, through a cooler and an orifice.
//!
//! Flow as through any orifice, with the composition of the exhaust manifold; a reed valve lets nothing back. The cooler
//! takes the share `cooling` of what separates the gas from the coolant. Dilution acts through the share of burned gas
//! in the charge: the burn slows, the burned zone gets cooler, nitric oxide falls.

use serde::{Deserialize, Serialize};

/// Constants of the path.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct EgrPath {
    /// Discharge coefficient of the valve \[-\].
    pub discharge: f64,
    /// Effectiveness of the cooler \[-\].
    pub cooling: f64,
    /// Coolant temperature \[K\].
    pub coolant_k: f64,
}

impl EgrPath {
    /// Effective area \[m2\] of a valve opened to the diameter `mm`.
    pub fn area_m2(&self, mm: f64) -> f64 {
        self.discharge * 0.25 * std::f64::consts::PI * 1e-6 * mm * mm
    }
}
