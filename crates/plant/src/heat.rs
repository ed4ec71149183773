//! Heat transfer in the cylinder: Woschni's and Hohenberg's correlations.

use serde::{Deserialize, Serialize};

/// Which correlation.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum HeatLaw {
    /// Woschni (SAE 670931): gas velocity from piston speed and from the rise of pressure by combustion.
    #[default]
    Woschni,
    /// Hohenberg (SAE 790825): volume in place of the bore, piston speed alone.
    Hohenberg,
}

/// Constant part 3.26 B^-0.2 with p in kPa, folded to p in Pa.
pub fn woschni_constant(scale: f64, bore_m: f64) -> f64 {
    scale * 3.26 * bore_m.powf(-0.2) * 1e-3f64.powf(0.8)
}

/// Heat-transfer coefficient \[W/m2/K\] = c p^0.8 T^-0.55 w^0.8 (`c` from [`woschni_constant`]).
#[inline]
pub fn woschni(c: f64, p_pa: f64, t_k: f64, w_m_s: f64) -> f64 {
    c * (0.8 * (p_pa * w_m_s).ln() - 0.55 * t_k.ln()).exp()
}

/// Heat-transfer coefficient \[W/m2/K\] = s 130 V^-0.06 p^0.8 T^-0.4 (c_m + 1.4)^0.8, p in bar.
///
/// ```
/// use dynocal_plant::heat::hohenberg;
/// let h = hohenberg(1.0, 1e-4, 20e5, 1000.0, 6.0);
/// let expected = 130.0 * 1e-4f64.powf(-0.06) * 20f64.powf(0.8) * 1000f64.powf(-0.4) * 7.4f64.powf(0.8);
/// assert!((h / expected - 1.0).abs() < 1e-12);
/// ```
#[inline]
pub fn hohenberg(scale: f64, volume_m3: f64, p_pa: f64, t_k: f64, piston_m_s: f64) -> f64 {
    let flow = 1e-5 * p_pa * (piston_m_s + 1.4);
    scale * 130.0 * (0.8 * flow.ln() - 0.06 * volume_m3.ln() - 0.4 * t_k.ln()).exp()
}
