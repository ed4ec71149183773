//! Nitric oxide: extended Zeldovich mechanism in one burned zone with equilibrium O, OH, H, N.
//!
//! O + N2 = NO + N (1), N + O2 = NO + O (2), N + OH = NO + H (3); with [NO] = alpha [NO]e and steady nitrogen atoms
//!
//! d[NO]/dt = 2 R1 (1 - alpha^2)/(1 + alpha R1/(R2 + R3)) (Lavoie, Heywood, Keck 1970; Heywood, eq. 11.12),
//!
//! where R1, R2, R3 are the one-way rates at equilibrium. Rate constants in cm3/mol/s, activation in cal/mol:
//! k1 = 1.47e13 T^0.3 exp(-75286.8/RT), k2 = 6.40e9 T exp(-6285.5/RT), k3 = 3.80e13.
//!
//! Valid for lambda 0.7 to 1.4 above 1700 K. One zone that is mixed at once has no hot core: the level is right within
//! a factor of about two, the trends with lambda, dilution and spark are what it is for. No prompt NO, no NO2.

use crate::equilibrium::{self, BurnedGas, N, N2, NO, O, O2, OH, R_J_MOL_K};

/// Gas constant \[cal/mol/K\] of the rate constants.
const R_CAL: f64 = 1.987_204;
/// Temperature below which the reactions stand still \[K\].
pub const FROZEN_K: f64 = 1700.0;
/// Grids: lambda, T \[K\], ln p (p in Pa).
const LAMBDA: Axis = Axis { from: 0.65, step: 0.05, count: 20 };
const T_K: Axis = Axis { from: FROZEN_K, step: 50.0, count: 31 };
// 4, 20, 100, 500 bar.
const LN_P: Axis = Axis { from: 12.899_219_826_090_12, step: 1.609_437_912_434_1, count: 4 };

/// Rate constants of reactions 1 to 3, forward \[cm3/mol/s\].
pub fn rate_constants(t_k: f64) -> [f64; 3] {
    let e = |cal: f64| (-cal / (R_CAL * t_k)).exp();
    [1.47e13 * t_k.powf(0.3) * e(75_286.8), 6.40e9 * t_k * e(6_285.5), 3.80e13]
}

/// What the rate of NO needs at one temperature, pressure and lambda.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Zeldovich {
    /// k1 x_O x_N2 \[cm3/mol/s\]: R1 over the square of the concentration of the gas.
    pub r1: f64,
    /// R1/(R2 + R3) \[-\].
    pub ratio: f64,
    /// Mole fraction of NO at equilibrium.
    pub x_equilibrium: f64,
}

impl Zeldovich {
    /// From an equilibrium. R2 and R3 are the reverse rates of reactions 2 and 3, equal to the forward ones there.
    pub fn of(gas: &BurnedGas, t_k: f64) -> Self {
        let [k1, k2, k3] = rate_constants(t_k);
        let x = &gas.x;
        let r1 = k1 * x[O] * x[N2];
        Self { r1, ratio: r1 / (k2 * x[N] * x[O2] + k3 * x[N] * x[OH]), x_equilibrium: x[NO] }
    }

    /// d x_NO/dt \[1/s\] in gas of mole fraction `x_no` at `t_k`, `p_pa`.
    #[inline]
    pub fn rate(&self, x_no: f64, t_k: f64, p_pa: f64) -> f64 {
        let alpha = x_no / self.x_equilibrium;
        let mol_cm3 = 1e-6 * p_pa / (R_J_MOL_K * t_k);
        2.0 * self.r1 * mol_cm3 * (1.0 - alpha * alpha) / (1.0 + alpha * self.ratio)
    }

    /// x_NO after `dt_s`: exact for the rate linearised at `x_no`, so that no step can pass the equilibrium.
    #[inline]
    pub fn advance(&self, x_no: f64, t_k: f64, p_pa: f64, dt_s: f64) -> f64 {
        let rate = self.rate(x_no, t_k, p_pa);
        let gap = self.x_equilibrium - x_no;
        if gap.abs() < 1e-12 {
            return x_no;
        }
        x_no + gap * -(-dt_s * rate / gap).exp_m1()
    }
}

#[derive(Debug, Clone, Copy)]
struct Axis {
    from: f64,
    step: f64,
    count: usize,
}

impl Axis {
    /// Index and weight, held at the ends.
    fn place(self, v: f64) -> (usize, f64) {
        let s = ((v - self.from) / self.step).clamp(0.0, (self.count - 1) as f64);
        let k = (s as usize).min(self.count - 2);
        (k, s - k as f64)
    }

    fn value(self, k: usize) -> f64 {
        self.from + self.step * k as f64
    }
}

/// [`Zeldovich`] on a grid of lambda, temperature and pressure; logarithms are interpolated linearly.
#[derive(Debug, Clone)]
pub struct ZeldovichTable {
    ln: Vec<[f64; 3]>,
}

impl Default for ZeldovichTable {
    fn default() -> Self {
        let mut ln = Vec::with_capacity(LAMBDA.count * LN_P.count * T_K.count);
        for l in 0..LAMBDA.count {
            for p in 0..LN_P.count {
                for t in 0..T_K.count {
                    let t_k = T_K.value(t);
                    let gas = equilibrium::burned(LAMBDA.value(l), t_k, LN_P.value(p).exp());
                    // No point of this grid fails (test); a hole would make no NO.
                    let z = gas.map_or(Zeldovich { r1: 1e-300, ratio: 1.0, x_equilibrium: 1e-12 }, |g| {
                        Zeldovich::of(&g, t_k)
                    });
                    ln.push([z.r1.ln(), z.ratio.ln(), z.x_equilibrium.ln()]);
                }
            }
        }
        Self { ln }
    }
}

impl ZeldovichTable {
    /// Interpolated; outside the grid the nearest point of it.
    #[inline]
    pub fn at(&self, lambda: f64, t_k: f64, p_pa: f64) -> Zeldovich {
        let ((l, wl), (t, wt)) = (LAMBDA.place(lambda), T_K.place(t_k));
        let (p, wp) = LN_P.place(p_pa.ln());
        let mut sum = [0.0; 3];
        for (dl, al) in [(0, 1.0 - wl), (1, wl)] {
            for (dp, ap) in [(0, 1.0 - wp), (1, wp)] {
                let row = ((l + dl) * LN_P.count + p + dp) * T_K.count + t;
                for i in 0..3 {
                    sum[i] += al * ap * ((1.0 - wt) * self.ln[row][i] + wt * self.ln[row + 1][i]);
                }
            }
        }
        Zeldovich { r1: sum[0].exp(), ratio: sum[1].exp(), x_equilibrium: sum[2].exp() }
    }
}
