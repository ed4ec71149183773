//! Woschni heat transfer.

/// Constant part 3.26 B^-0.2 with p in kPa, folded to p in Pa.
pub fn woschni_constant(scale: f64, bore_m: f64) -> f64 {
    scale * 3.26 * bore_m.powf(-0.2) * 1e-3f64.powf(0.8)
}

/// Heat-transfer coefficient \[W/m2/K\] = c p^0.8 T^-0.55 w^0.8 (`c` from [`woschni_constant`]).
#[inline]
pub fn woschni(c: f64, p_pa: f64, t_k: f64, w_m_s: f64) -> f64 {
    c * (0.8 * (p_pa * w_m_s).ln() - 0.55 * t_k.ln()).exp()
}
