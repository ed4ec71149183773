//! Inputs of the engine and their box.

use crate::error::PlantError;
use serde::{Deserialize, Serialize};

/// What the test bed sets. Sampled and held; fuel is latched at the start of injection (300 deg
/// BTDC firing) and spark, Wiebe exponent and burn duration 60 deg BTDC firing, per cylinder.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Inputs {
    /// Engine speed \[rpm\], 600..6500.
    pub speed_rpm: f64,
    /// Throttle angle \[deg\], 0..90.
    pub throttle_deg: f64,
    /// Spark advance \[deg BTDC firing\], -10..55.
    pub spark_deg: f64,
    /// Injected fuel \[mg per cylinder and cycle\], 0..120.
    pub injection_mg: f64,
    /// Maximum opening point of the intake valves \[deg BTDC firing\] (locked: 231, thesis).
    pub intake_mop_deg_btdc: f64,
    /// Maximum opening point of the exhaust valves \[deg ATDC firing\] (locked: 256, thesis).
    pub exhaust_mop_deg_atdc: f64,
    /// Wastegate orifice diameter \[mm\], 0..28 (part load fixed at 28, thesis).
    pub wastegate_mm: f64,
    /// Opening of the EGR valve as a diameter \[mm\], 0..25; 0 where the engine has no path.
    #[serde(default)]
    pub egr_mm: f64,
    /// Wiebe exponent \[-\] (2 for the maps, thesis 6.4).
    pub wiebe_m: f64,
    /// Imposed 10-90 % burn duration \[deg\]; the burn sub-model when absent.
    pub burn_duration_deg: Option<f64>,
}

/// Wastegate wide open \[mm\].
pub const WASTEGATE_MM: f64 = 28.0;

impl Default for Inputs {
    /// 2000 rpm near 70 Nm.
    fn default() -> Self {
        Self {
            speed_rpm: 2000.0,
            throttle_deg: 16.0,
            spark_deg: 19.0,
            injection_mg: 16.7,
            intake_mop_deg_btdc: 231.0,
            exhaust_mop_deg_atdc: 256.0,
            wastegate_mm: 28.0,
            egr_mm: 0.0,
            wiebe_m: 2.0,
            burn_duration_deg: None,
        }
    }
}

impl Inputs {
    /// Check every input against the box of the engine.
    ///
    /// # Errors
    /// [`PlantError::Input`] for the first input that is not finite or outside.
    pub fn check(&self) -> Result<(), PlantError> {
        for (name, found, low, high, unit) in self.box_rows() {
            if !(found >= low && found <= high) {
                return Err(PlantError::Input { name, found, low, high, unit });
            }
        }
        Ok(())
    }

    /// Every input held at the end of the box that it passes; what is not finite is left for [`Self::check`] to refuse.
    ///
    /// ```
    /// use dynocal_plant::inputs::Inputs;
    /// let u = Inputs { spark_deg: 70.0, throttle_deg: -1.0, ..Inputs::default() };
    /// assert!(u.check().is_err());
    /// let held = u.saturated();
    /// assert_eq!((held.spark_deg, held.throttle_deg), (55.0, 0.0));
    /// assert!(held.check().is_ok());
    /// ```
    #[must_use]
    pub fn saturated(&self) -> Self {
        let held =
            self.box_rows().map(|(_, v, low, high, _)| if v.is_finite() { v.clamp(low, high) } else { v });
        Self {
            speed_rpm: held[0],
            throttle_deg: held[1],
            spark_deg: held[2],
            injection_mg: held[3],
            intake_mop_deg_btdc: held[4],
            exhaust_mop_deg_atdc: held[5],
            wastegate_mm: held[6],
            egr_mm: held[7],
            wiebe_m: held[8],
            burn_duration_deg: self.burn_duration_deg.map(|_| held[9]),
        }
    }

    /// Name, value, least and greatest value, unit.
    fn box_rows(&self) -> [(&'static str, f64, f64, f64, &'static str); 10] {
        [
            ("speed", self.speed_rpm, 600.0, 6500.0, "rpm"),
            ("throttle", self.throttle_deg, 0.0, 90.0, "deg"),
            ("spark", self.spark_deg, -10.0, 55.0, "deg"),
            ("injection", self.injection_mg, 0.0, 120.0, "mg"),
            ("intake_mop", self.intake_mop_deg_btdc, 180.0, 300.0, "deg"),
            ("exhaust_mop", self.exhaust_mop_deg_atdc, 180.0, 300.0, "deg"),
            ("wastegate", self.wastegate_mm, 0.0, WASTEGATE_MM, "mm"),
            ("egr", self.egr_mm, 0.0, 25.0, "mm"),
            ("wiebe_m", self.wiebe_m, 0.5, 6.0, "-"),
            ("burn_duration", self.burn_duration_deg.unwrap_or(20.0), 10.0, 80.0, "deg"),
        ]
    }
}
