//! Compressible flow through an orifice.
//!
//! m' = A_eff p_u / sqrt(R T_u) * Psi(p_d/p_u, gamma) with
//! Psi = sqrt(g) (2/(g+1))^((g+1)/(2(g-1))) when choked, else
//! Psi = sqrt(2 g/(g-1) (pr^(2/g) - pr^((g+1)/g))); above pr = 0.985 a straight line to zero removes
//! the infinite slope at pr = 1, which no explicit step could follow.

/// Pressure ratio above which Psi is replaced by a straight line to zero.
pub const LINEAR_ABOVE: f64 = 0.985;

/// Range of gamma covered by the fitted functions of [`PsiTable`].
pub const GAMMA_RANGE: (f64, f64) = (1.12, 1.45);

/// Critical pressure ratio (2/(g+1))^(g/(g-1)).
pub fn critical_ratio(gamma: f64) -> f64 {
    (2.0 / (gamma + 1.0)).powf(gamma / (gamma - 1.0))
}

/// Psi of choked flow, sqrt(g) (2/(g+1))^((g+1)/(2(g-1))).
pub fn psi_choked(gamma: f64) -> f64 {
    gamma.sqrt() * (2.0 / (gamma + 1.0)).powf((gamma + 1.0) / (2.0 * (gamma - 1.0)))
}

fn psi_subcritical(pr: f64, gamma: f64) -> f64 {
    let root = pr.powf(1.0 / gamma);
    // pr^(2/g) - pr^((g+1)/g) = root (root - pr): one power instead of two.
    (2.0 * gamma / (gamma - 1.0) * root * (root - pr)).sqrt()
}

/// Psi by the formulas above (reference path).
pub fn psi(pr: f64, gamma: f64) -> f64 {
    if pr > LINEAR_ABOVE {
        psi_subcritical(LINEAR_ABOVE, gamma) * (1.0 - pr) / (1.0 - LINEAR_ABOVE)
    } else if pr <= critical_ratio(gamma) {
        psi_choked(gamma)
    } else {
        psi_subcritical(pr, gamma)
    }
}

/// Mass flow \[kg/s\] from `p1_pa`, `t1_k` to `p2_pa`, `t2_k`; negative when 2 is the upstream side.
///
/// Gas constants in J/kg/K, effective area in m2.
///
/// ```
/// let m = dynocal_plant::orifice::mass_flow_kg_s(1e-4, [2e5, 300.0, 287.0, 1.4], [1e5, 300.0, 287.0, 1.4]);
/// assert!((m - 4.667e-2).abs() < 1e-5);
/// ```
pub fn mass_flow_kg_s(area_m2: f64, side1: [f64; 4], side2: [f64; 4]) -> f64 {
    let one_way = |u: [f64; 4], p_down: f64| area_m2 * u[0] / (u[2] * u[1]).sqrt() * psi(p_down / u[0], u[3]);
    if side1[0] >= side2[0] { one_way(side1, side2[0]) } else { -one_way(side2, side1[0]) }
}

/// Psi for the stepping loop: the functions of gamma alone are polynomials, and only the
/// sub-critical branch needs one logarithm and one exponential. Agrees with [`psi`] to 1e-10.
#[derive(Debug, Clone)]
pub struct PsiTable {
    critical: [f64; N_FIT],
    choked: [f64; N_FIT],
    slope: [f64; N_FIT],
}

const N_FIT: usize = 9;

impl Default for PsiTable {
    fn default() -> Self {
        Self {
            critical: fit(critical_ratio),
            choked: fit(psi_choked),
            slope: fit(|g| psi_subcritical(LINEAR_ABOVE, g) / (1.0 - LINEAR_ABOVE)),
        }
    }
}

impl PsiTable {
    /// Psi(pr, gamma); outside [`GAMMA_RANGE`] the exact formula is used.
    #[inline(always)]
    pub fn psi(&self, pr: f64, gamma: f64) -> f64 {
        let s = (gamma - MID) * (1.0 / HALF);
        if s.abs() > 1.0 {
            return psi(pr, gamma);
        }
        if pr > LINEAR_ABOVE {
            return horner(&self.slope, s) * (1.0 - pr);
        }
        if pr <= horner(&self.critical, s) {
            return horner(&self.choked, s);
        }
        let root = (pr.ln() / gamma).exp();
        (2.0 * gamma / (gamma - 1.0) * root * (root - pr)).max(0.0).sqrt()
    }
}

const MID: f64 = 0.5 * (GAMMA_RANGE.0 + GAMMA_RANGE.1);
const HALF: f64 = 0.5 * (GAMMA_RANGE.1 - GAMMA_RANGE.0);

#[inline(always)]
fn horner(c: &[f64; N_FIT], s: f64) -> f64 {
    let mut y = c[N_FIT - 1];
    for k in (0..N_FIT - 1).rev() {
        y = y * s + c[k];
    }
    y
}

/// Chebyshev interpolation on [`GAMMA_RANGE`], converted to powers of s in -1..1.
fn fit(f: impl Fn(f64) -> f64) -> [f64; N_FIT] {
    let n = N_FIT as f64;
    let mut power = [0.0; N_FIT];
    // t_prev, t_this: Chebyshev polynomials T_(k-1), T_k as powers of s.
    let (mut t_prev, mut t_this) = ([0.0; N_FIT], [0.0; N_FIT]);
    t_this[0] = 1.0;
    for k in 0..N_FIT {
        let mut coefficient = 0.0;
        for j in 0..N_FIT {
            let theta = std::f64::consts::PI * (j as f64 + 0.5) / n;
            coefficient += f(MID + HALF * theta.cos()) * (k as f64 * theta).cos();
        }
        coefficient *= if k == 0 { 1.0 / n } else { 2.0 / n };
        for (p, t) in power.iter_mut().zip(&t_this) {
            *p += coefficient * t;
        }
        let mut t_next = [0.0; N_FIT];
        let factor = if k == 0 { 1.0 } else { 2.0 };
        for i in 0..N_FIT - 1 {
            t_next[i + 1] = factor * t_this[i];
        }
        for i in 0..N_FIT {
            t_next[i] -= t_prev[i];
        }
        (t_prev, t_this) = (t_this, t_next);
    }
    power
}
