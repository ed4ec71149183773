//! Energy held by dissociated burned gas, and energy bound in carbon monoxide and hydrogen on rich mixture.
//!
//! The species of the gas model are frozen. Real burned gas holds d(T, lambda) more energy than frozen gas, up to a
//! tenth of the heating value at 2700 K, which comes back as the gas cools. The energy of a cylinder becomes
//! E = sum m_i u_i(T) + m_p d(T), with d = exp(a - b/T) - exp(a - b/T_off) above T_off and a, b from equilibrium at
//! 2300 and 2700 K for the lambda of the charge. As E stays the conserved quantity, nothing is lost or gained; gas that
//! leaves the cylinder takes the rest along and is recombined in the exhaust.
//!
//! On rich mixture the frozen species are products and left-over fuel; real gas splits that fuel into CO and H2
//! (water-gas equilibrium, frozen near 1740 K: Heywood 4.9), which binds energy: the burn releases less by `bound_j_kg`
//! (1/lambda - 1) per mass of burned fuel. Vapour also has a higher heat capacity than the CO and H2 that it stands
//! for, by 2700 J/(kg K) of fuel above stoichiometric between 1000 and 2400 K (equilibrium against the gas model); above
//! T_off the held energy takes it off again. And it has a sixteenth of their moles: the gas constant of the products of a
//! rich charge is raised by what equilibrium has more than products and vapour, 8 J/(kg K) or 2.9 % at lambda 0.9, from
//! which rich mixture has its torque (Heywood 1988, 5.5).

use crate::equilibrium;
use serde::{Deserialize, Serialize};

/// Temperature below which burned gas is frozen \[K\].
pub(crate) const OFF_K: f64 = 1500.0;
/// Temperatures \[K\] and pressure \[Pa\] of the fit of d.
const FIT_K: [f64; 2] = [2300.0, 2700.0];
const FIT_PA: f64 = 30e5;
/// Temperature \[K\] and pressure \[Pa\] at which CO, H2, CO2 and H2O freeze.
pub const FREEZE_K: f64 = 1740.0;
const FREEZE_PA: f64 = 10e5;
/// Heat capacity of fuel vapour above that of the CO and H2 that it stands for, per mass of excess fuel \[J/kg/K\].
const SURPLUS_J_KG_K: f64 = 2700.0;
/// Range and spacing of lambda.
const LAMBDA: (f64, f64, f64) = (0.6, 2.0, 0.02);

/// Constants of the energy of burned gas.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct BurnedEnergy {
    /// Multiplier of d(T, lambda) \[-\]: 1 is equilibrium, 0 frozen gas.
    pub dissociation: f64,
    /// Energy bound per mass of fuel above stoichiometric \[J/kg\]: 14.5e6 at 298 K by the heating values of CO and H2;
    /// 12.7e6 counted at 1500 K, where the vapour that stands for them holds 1.8e6 more than they do.
    pub bound_j_kg: f64,
}

/// d(T) of one charge.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize)]
pub struct HeldEnergy {
    /// a \[-\], with d in J per kg of products; 0 switches off.
    pub a: f64,
    /// b \[K\].
    pub b_k: f64,
    /// exp(a - b/T_off) \[J/kg\].
    pub off_j_kg: f64,
    /// Heat capacity that the vapour has too much \[J/kg/K of products\].
    pub surplus_j_kg_k: f64,
    /// Gas constant that products and vapour have too little \[J/kg/K of products\].
    pub extra_r_j_kg_k: f64,
}

impl HeldEnergy {
    /// d \[J/kg products\] and its derivative \[J/kg/K\].
    #[inline]
    pub fn at(&self, t_k: f64) -> (f64, f64) {
        if t_k <= OFF_K || self.off_j_kg == 0.0 {
            return (0.0, 0.0);
        }
        let e = (self.a - self.b_k / t_k).exp();
        let surplus = self.surplus_j_kg_k;
        (e - self.off_j_kg - surplus * (t_k - OFF_K), e * self.b_k / (t_k * t_k) - surplus)
    }
}

/// d and the composition of frozen exhaust against lambda.
#[derive(Debug, Clone)]
pub struct BurnedTable {
    /// ln d at the two temperatures of the fit.
    ln_d: Vec<[f64; 2]>,
    /// Mole fractions of CO, H2 and O2 in the frozen exhaust of complete combustion.
    frozen: Vec<[f64; 3]>,
    /// Gas constant that products and vapour have too little \[J/kg/K of products\].
    extra_r: Vec<f64>,
}

impl Default for BurnedTable {
    fn default() -> Self {
        let n = ((LAMBDA.1 - LAMBDA.0) / LAMBDA.2).round() as usize;
        let rows = (0..=n).map(|k| row(LAMBDA.0 + LAMBDA.2 * k as f64));
        let (ln_d, frozen) = rows.unzip();
        let extra_r = (0..=n).map(|k| extra_r_j_kg_k(LAMBDA.0 + LAMBDA.2 * k as f64)).collect();
        Self { ln_d, frozen, extra_r }
    }
}

/// ln d at the temperatures of the fit and the frozen composition of one lambda.
fn row(lambda: f64) -> ([f64; 2], [f64; 3]) {
    let Some(frozen) = frozen(lambda) else { return ([f64::NEG_INFINITY; 2], [0.0; 3]) };
    let of_stoich = 14.7 * lambda.min(1.0) + lambda.min(1.0);
    let products_kg = frozen.mass_kg() * of_stoich / (1.0 + 14.7 * lambda);
    let ln_d = FIT_K.map(|t| match equilibrium::burned(lambda, t, FIT_PA) {
        Some(hot) => ((hot.internal_energy_j(t) - frozen.internal_energy_j(t)) / products_kg).max(1.0).ln(),
        None => 0.0,
    });
    (ln_d, [equilibrium::CO, equilibrium::H2, equilibrium::O2].map(|i| frozen.x[i]))
}

/// Gas constant of frozen rich exhaust above that of the products and the vapour that stand for it, per mass of products.
///
/// ```
/// use dynocal_plant::dissociation::extra_r_j_kg_k;
/// assert_eq!(extra_r_j_kg_k(1.1), 0.0);
/// assert!((extra_r_j_kg_k(0.9) / 287.7 - 0.029).abs() < 0.004);
/// ```
pub fn extra_r_j_kg_k(lambda: f64) -> f64 {
    if lambda >= 1.0 {
        return 0.0;
    }
    let r = |gas: Option<equilibrium::BurnedGas>| {
        gas.map_or(0.0, |g| equilibrium::R_J_MOL_K * g.moles / g.mass_kg())
    };
    let fuel_kg_mol = equilibrium::FUEL.0 * 12.011e-3 + equilibrium::FUEL.1 * 1.008e-3;
    let (products, vapour) = (15.7 * lambda, 1.0 - lambda);
    let real = r(frozen(lambda)) * (products + vapour);
    let counted = r(frozen(1.0)) * products + equilibrium::R_J_MOL_K / fuel_kg_mol * vapour;
    ((real - counted) / products).max(0.0)
}

/// Exhaust that froze at [`FREEZE_K`]; lean, complete combustion.
pub fn frozen(lambda: f64) -> Option<equilibrium::BurnedGas> {
    if lambda < 1.0 {
        return equilibrium::burned(lambda, FREEZE_K, FREEZE_PA);
    }
    let (c, h) = equilibrium::FUEL;
    let o2 = equilibrium::FUEL_O2;
    let parts = [
        (equilibrium::CO2, c),
        (equilibrium::H2O, 0.5 * h),
        (equilibrium::O2, (lambda - 1.0) * o2),
        (equilibrium::N2, lambda * o2 * 0.79 / 0.21),
    ];
    let moles: f64 = parts.iter().map(|p| p.1).sum();
    let mut x = [0.0; equilibrium::SPECIES];
    parts.iter().for_each(|(i, n)| x[*i] = n / moles);
    Some(equilibrium::BurnedGas { x, moles })
}

impl BurnedTable {
    /// Index and weight of a lambda, held at the ends of the table.
    fn place(&self, lambda: f64) -> (usize, f64) {
        let s = ((lambda - LAMBDA.0) / LAMBDA.2).clamp(0.0, (self.ln_d.len() - 1) as f64);
        let k = (s as usize).min(self.ln_d.len() - 2);
        (k, s - k as f64)
    }

    /// d(T) of a charge of `lambda`, times `scale`.
    pub fn held(&self, lambda: f64, scale: f64) -> HeldEnergy {
        if scale <= 0.0 {
            return HeldEnergy::default();
        }
        let (k, w) = self.place(lambda);
        let [cool, hot] = [0, 1].map(|j| (1.0 - w) * self.ln_d[k][j] + w * self.ln_d[k + 1][j]);
        let b_k = (hot - cool) / (1.0 / FIT_K[0] - 1.0 / FIT_K[1]);
        let a = hot + b_k / FIT_K[1] + scale.ln();
        let excess = (1.0 / lambda - 1.0).clamp(0.0, 2.0) / 15.7;
        HeldEnergy {
            a,
            b_k,
            off_j_kg: (a - b_k / OFF_K).exp(),
            surplus_j_kg_k: scale * SURPLUS_J_KG_K * excess,
            extra_r_j_kg_k: (1.0 - w) * self.extra_r[k] + w * self.extra_r[k + 1],
        }
    }

    /// Mole fractions of CO, H2 and O2 in exhaust of `lambda` that froze at [`FREEZE_K`].
    pub fn frozen(&self, lambda: f64) -> [f64; 3] {
        let (k, w) = self.place(lambda);
        [0, 1, 2].map(|j| (1.0 - w) * self.frozen[k][j] + w * self.frozen[k + 1][j])
    }
}
