//! Heat transfer in the cylinder: Woschni's and Hohenberg's correlations.

use dynocal_numerics::lanes;
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

/// Heat-transfer coefficients \[W/m2/K\] = c p^0.8 T^-0.55 w^0.8 of several cylinders (`c` from [`woschni_constant`]).
///
/// ```
/// use dynocal_plant::heat::woschni;
/// let [h] = woschni(1.3, [20e5], [1000.0], [6.0]);
/// assert!((h / (1.3 * 12e6f64.powf(0.8) * 1000f64.powf(-0.55)) - 1.0).abs() < 1e-13);
/// ```
#[inline(always)]
pub fn woschni<const N: usize>(c: f64, p_pa: [f64; N], t_k: [f64; N], w_m_s: [f64; N]) -> [f64; N] {
    let mut flow = [0.0; N];
    for i in 0..N {
        flow[i] = p_pa[i] * w_m_s[i];
    }
    let (flow, t) = (lanes::ln(flow), lanes::ln(t_k));
    let mut power = [0.0; N];
    for i in 0..N {
        power[i] = 0.8 * flow[i] - 0.55 * t[i];
    }
    lanes::exp(power).map(|h| c * h)
}

/// Heat-transfer coefficients \[W/m2/K\] = s 130 V^-0.06 p^0.8 T^-0.4 (c_m + 1.4)^0.8 of several cylinders, p in bar.
///
/// ```
/// use dynocal_plant::heat::hohenberg;
/// let [h] = hohenberg(1.0, [1e-4], [20e5], [1000.0], 6.0);
/// let expected = 130.0 * 1e-4f64.powf(-0.06) * 20f64.powf(0.8) * 1000f64.powf(-0.4) * 7.4f64.powf(0.8);
/// assert!((h / expected - 1.0).abs() < 1e-12);
/// ```
#[inline(always)]
pub fn hohenberg<const N: usize>(
    scale: f64,
    volume_m3: [f64; N],
    p_pa: [f64; N],
    t_k: [f64; N],
    piston_m_s: f64,
) -> [f64; N] {
    let flow = p_pa.map(|p| 1e-5 * p * (piston_m_s + 1.4));
    let (flow, volume, t) = (lanes::ln(flow), lanes::ln(volume_m3), lanes::ln(t_k));
    let mut power = [0.0; N];
    for i in 0..N {
        power[i] = 0.8 * flow[i] - 0.06 * volume[i] - 0.4 * t[i];
    }
    lanes::exp(power).map(|h| scale * 130.0 * h)
}
