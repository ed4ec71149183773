//! Equilibrium of burned gas: C, H, O, N over eleven species.
//!
//! Minimum of the Gibbs energy of an ideal-gas mixture at T and p by element potentials: the mole fractions are
//! x_i = exp(-g_i/(R T) - ln(p/p0) + sum_e a_ie pi_e), and the four potentials pi and the moles n of gas per mole of
//! fuel solve n sum_i a_ie x_i = b_e, sum_i x_i = 1 by Newton's method (Reynolds 1986, STANJAN). Thermodynamic data:
//! NASA-7 polynomials of GRI-3.0, 300 to 5000 K.
//!
//! The fuel is C8.26H15.5, the fuel of the products in the gas model; air is 0.21 O2, 0.79 N2.

/// Universal gas constant \[J/mol/K\].
pub const R_J_MOL_K: f64 = 8.314_462_618;
/// Number of species.
pub const SPECIES: usize = 11;
/// Carbon and hydrogen atoms of the fuel.
pub const FUEL: (f64, f64) = (8.26, 15.5);
/// Oxygen molecules that burn one molecule of fuel.
pub const FUEL_O2: f64 = FUEL.0 + 0.25 * FUEL.1;
/// Nitrogen per oxygen in air.
const N2_O2: f64 = 0.79 / 0.21;
/// Pressure of the thermodynamic data \[Pa\].
const P0_PA: f64 = 101_325.0;

/// Places of the species in the arrays.
pub const CO2: usize = 0;
/// Water.
pub const H2O: usize = 1;
/// Nitrogen.
pub const N2: usize = 2;
/// Oxygen.
pub const O2: usize = 3;
/// Carbon monoxide.
pub const CO: usize = 4;
/// Hydrogen.
pub const H2: usize = 5;
/// Hydroxyl.
pub const OH: usize = 6;
/// Atomic oxygen.
pub const O: usize = 7;
/// Atomic hydrogen.
pub const H: usize = 8;
/// Atomic nitrogen.
pub const N: usize = 9;
/// Nitric oxide.
pub const NO: usize = 10;

struct Species {
    /// Atoms C, H, O, N.
    atoms: [f64; 4],
    /// NASA-7 coefficients below and above 1000 K.
    low: [f64; 7],
    high: [f64; 7],
}

#[rustfmt::skip]
static DATA: [Species; SPECIES] = [
    Species { atoms: [1.0, 0.0, 2.0, 0.0], low: [2.35677352, 0.00898459677, -7.12356269e-06, 2.45919022e-09, -1.43699548e-13, -48371.9697, 9.90105222], high: [3.85746029, 0.00441437026, -2.21481404e-06, 5.23490188e-10, -4.72084164e-14, -48759.166, 2.27163806] },
    Species { atoms: [0.0, 2.0, 1.0, 0.0], low: [4.19864056, -0.0020364341, 6.52040211e-06, -5.48797062e-09, 1.77197817e-12, -30293.7267, -0.849032208], high: [3.03399249, 0.00217691804, -1.64072518e-07, -9.7041987e-11, 1.68200992e-14, -30004.2971, 4.9667701] },
    Species { atoms: [0.0, 0.0, 0.0, 2.0], low: [3.298677, 0.0014082404, -3.963222e-06, 5.641515e-09, -2.444854e-12, -1020.8999, 3.950372], high: [2.92664, 0.0014879768, -5.68476e-07, 1.0097038e-10, -6.753351e-15, -922.7977, 5.980528] },
    Species { atoms: [0.0, 0.0, 2.0, 0.0], low: [3.78245636, -0.00299673416, 9.84730201e-06, -9.68129509e-09, 3.24372837e-12, -1063.94356, 3.65767573], high: [3.28253784, 0.00148308754, -7.57966669e-07, 2.09470555e-10, -2.16717794e-14, -1088.45772, 5.45323129] },
    Species { atoms: [1.0, 0.0, 1.0, 0.0], low: [3.57953347, -0.00061035368, 1.01681433e-06, 9.07005884e-10, -9.04424499e-13, -14344.086, 3.50840928], high: [2.71518561, 0.00206252743, -9.98825771e-07, 2.30053008e-10, -2.03647716e-14, -14151.8724, 7.81868772] },
    Species { atoms: [0.0, 2.0, 0.0, 0.0], low: [2.34433112, 0.00798052075, -1.9478151e-05, 2.01572094e-08, -7.37611761e-12, -917.935173, 0.683010238], high: [3.3372792, -4.94024731e-05, 4.99456778e-07, -1.79566394e-10, 2.00255376e-14, -950.158922, -3.20502331] },
    Species { atoms: [0.0, 1.0, 1.0, 0.0], low: [3.99201543, -0.00240131752, 4.61793841e-06, -3.88113333e-09, 1.3641147e-12, 3615.08056, -0.103925458], high: [3.09288767, 0.000548429716, 1.26505228e-07, -8.79461556e-11, 1.17412376e-14, 3858.657, 4.4766961] },
    Species { atoms: [0.0, 0.0, 1.0, 0.0], low: [3.1682671, -0.00327931884, 6.64306396e-06, -6.12806624e-09, 2.11265971e-12, 29122.2592, 2.05193346], high: [2.56942078, -8.59741137e-05, 4.19484589e-08, -1.00177799e-11, 1.22833691e-15, 29217.5791, 4.78433864] },
    Species { atoms: [0.0, 1.0, 0.0, 0.0], low: [2.5, 7.05332819e-13, -1.99591964e-15, 2.30081632e-18, -9.27732332e-22, 25473.6599, -0.446682853], high: [2.50000001, -2.30842973e-11, 1.61561948e-14, -4.73515235e-18, 4.98197357e-22, 25473.6599, -0.446682914] },
    Species { atoms: [0.0, 0.0, 0.0, 1.0], low: [2.5, 0.0, 0.0, 0.0, 0.0, 56104.637, 4.1939087], high: [2.4159429, 0.00017489065, -1.1902369e-07, 3.0226245e-11, -2.0360982e-15, 56133.773, 4.6496096] },
    Species { atoms: [0.0, 0.0, 1.0, 1.0], low: [4.2184763, -0.004638976, 1.1041022e-05, -9.3361354e-09, 2.803577e-12, 9844.623, 2.2808464], high: [3.2606056, 0.0011911043, -4.2917048e-07, 6.9457669e-11, -4.0336099e-15, 9920.9746, 6.3693027] },
];

/// Molar mass \[kg/mol\] of C, H, O, N.
const ATOM_KG_MOL: [f64; 4] = [12.011e-3, 1.008e-3, 15.999e-3, 14.007e-3];

fn coefficients(i: usize, t_k: f64) -> &'static [f64; 7] {
    if t_k > 1000.0 { &DATA[i].high } else { &DATA[i].low }
}

/// Enthalpy \[J/mol\] of a species with its formation, h/(R T) = a1 + a2 T/2 + ... + a6/T.
pub fn enthalpy_j_mol(species: usize, t_k: f64) -> f64 {
    let a = coefficients(species, t_k);
    let series = a[0] + t_k * (a[1] / 2.0 + t_k * (a[2] / 3.0 + t_k * (a[3] / 4.0 + t_k * a[4] / 5.0)));
    R_J_MOL_K * (series * t_k + a[5])
}

/// Gibbs energy at 1 atm over R T \[-\].
fn gibbs_rt(species: usize, t_k: f64) -> f64 {
    let a = coefficients(species, t_k);
    let s =
        a[0] * t_k.ln() + t_k * (a[1] + t_k * (a[2] / 2.0 + t_k * (a[3] / 3.0 + t_k * a[4] / 4.0))) + a[6];
    enthalpy_j_mol(species, t_k) / (R_J_MOL_K * t_k) - s
}

/// Burned gas: mole fractions and moles.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct BurnedGas {
    /// Mole fractions, in the order of the constants of this module.
    pub x: [f64; SPECIES],
    /// Moles of gas per mole of fuel.
    pub moles: f64,
}

impl BurnedGas {
    /// Internal energy with formation \[J per mole of fuel\] of this composition, frozen, at `t_k`.
    pub fn internal_energy_j(&self, t_k: f64) -> f64 {
        let h: f64 = (0..SPECIES).map(|i| self.x[i] * enthalpy_j_mol(i, t_k)).sum();
        self.moles * (h - R_J_MOL_K * t_k)
    }

    /// Mass \[kg per mole of fuel\].
    pub fn mass_kg(&self) -> f64 {
        let of = |i: usize| DATA[i].atoms.iter().zip(&ATOM_KG_MOL).map(|(a, m)| a * m).sum::<f64>();
        self.moles * (0..SPECIES).map(|i| self.x[i] * of(i)).sum::<f64>()
    }
}

/// Equilibrium of the gas burned at `lambda` \[-\] at `t_k` and `p_pa`; none where Newton's method does not converge
/// (outside about 1000 to 4000 K and lambda 0.5 to 10).
///
/// ```
/// use dynocal_plant::equilibrium::{self, CO, O2};
/// let rich = equilibrium::burned(0.9, 2500.0, 30e5).unwrap();
/// let lean = equilibrium::burned(1.1, 2500.0, 30e5).unwrap();
/// assert!(rich.x[CO] > lean.x[CO] && rich.x[O2] < lean.x[O2]);
/// ```
pub fn burned(lambda: f64, t_k: f64, p_pa: f64) -> Option<BurnedGas> {
    let o2 = lambda * FUEL_O2;
    let b = [FUEL.0, FUEL.1, 2.0 * o2, 2.0 * N2_O2 * o2];
    let g: [f64; SPECIES] = std::array::from_fn(|i| gibbs_rt(i, t_k) + (p_pa / P0_PA).ln());
    let (mut pi, mut ln_n) = guess(lambda, &g);
    for _ in 0..200 {
        let x: [f64; SPECIES] = std::array::from_fn(|i| {
            let sum: f64 = (0..4).map(|e| DATA[i].atoms[e] * pi[e]).sum();
            (sum - g[i]).clamp(-300.0, 50.0).exp()
        });
        let n = ln_n.exp();
        // Rows: elements over their amounts, and the sum of the mole fractions; columns: pi, ln n.
        let mut m = [[0.0; 6]; 5];
        for i in 0..SPECIES {
            let a = &DATA[i].atoms;
            for e in 0..4 {
                let part = n * x[i] * a[e] / b[e];
                for f in 0..4 {
                    m[e][f] += part * a[f];
                }
                m[e][4] += part;
                m[e][5] -= part;
                m[4][e] += x[i] * a[e];
            }
            m[4][5] -= x[i];
        }
        (0..5).for_each(|r| m[r][5] += 1.0);
        let step = solve(&mut m)?;
        let largest = step.iter().fold(0.0f64, |a, s| a.max(s.abs()));
        let damp = if largest > 1.5 { 1.5 / largest } else { 1.0 };
        for e in 0..4 {
            pi[e] += damp * step[e];
        }
        ln_n += damp * step[4];
        if largest < 1e-11 {
            return Some(BurnedGas { x, moles: ln_n.exp() });
        }
    }
    None
}

/// Potentials and moles from complete combustion: nitrogen, water, carbon dioxide and, lean, oxygen; rich, carbon
/// monoxide takes what oxygen is missing.
fn guess(lambda: f64, g: &[f64; SPECIES]) -> ([f64; 4], f64) {
    let spare = (lambda - 1.0) * FUEL_O2;
    let n2 = N2_O2 * lambda * FUEL_O2;
    let co = (-2.0 * spare).clamp(0.01 * FUEL.0, 0.9 * FUEL.0);
    let n = FUEL.0 + 0.5 * FUEL.1 + n2 + spare.max(0.0);
    let ln = |moles: f64| (moles / n).ln();
    let co2 = ln(FUEL.0 - co) + g[CO2];
    // Oxygen from its excess, or from CO2 = CO + O.
    let oxygen = if spare > 0.02 * FUEL_O2 { 0.5 * (ln(spare) + g[O2]) } else { co2 - ln(co) - g[CO] };
    let hydrogen = 0.5 * (ln(0.5 * FUEL.1) + g[H2O] - oxygen);
    ([co2 - 2.0 * oxygen, hydrogen, oxygen, 0.5 * (ln(n2) + g[N2])], n.ln())
}

/// Gaussian elimination with pivoting of five equations with their right-hand side.
fn solve(m: &mut [[f64; 6]; 5]) -> Option<[f64; 5]> {
    for k in 0..5 {
        let p = (k..5).max_by(|a, b| m[*a][k].abs().total_cmp(&m[*b][k].abs()))?;
        m.swap(k, p);
        if m[k][k].is_nan() || m[k][k].abs() <= 1e-280 {
            return None;
        }
        for r in k + 1..5 {
            let f = m[r][k] / m[k][k];
            for c in k..6 {
                m[r][c] -= f * m[k][c];
            }
        }
    }
    let mut x = [0.0; 5];
    for k in (0..5).rev() {
        let sum: f64 = (k + 1..5).map(|c| m[k][c] * x[c]).sum();
        x[k] = (m[k][5] - sum) / m[k][k];
    }
    Some(x)
}
