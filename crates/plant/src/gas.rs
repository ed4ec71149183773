//! Three-species gas: air, fuel vapour, stoichiometric products.
//!
//! Each species has a gas constant and a sensible internal energy u(T) given as a polynomial of
//! degree 6 in t = T/1000 K with u(298.15 K) = 0. The mixture is ideal and frozen; the species
//! conserve the elements exactly (lean burned gas = products + air, rich = products + left-over fuel).

use serde::{Deserialize, Serialize};

/// Number of gas volumes: four cylinders, charge pipe, intake manifold, exhaust manifold, catalyst.
pub const VOLUMES: usize = 8;

/// Lambda of air without fuel: the end of its scale.
pub const AIR_ALONE: f64 = 9.99;

/// Properties of the three species.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct GasModel {
    /// Gas constants of air, fuel vapour, products \[J/kg/K\].
    pub r_j_kg_k: [f64; 3],
    /// Coefficients of u(t) \[J/kg\], t = T/1000 K, lowest power first: air, fuel vapour, products.
    ///
    /// Degree-5 fits of cv on 230..3300 K to NASA-7 data (GRI-3.0 N2, O2, CO2, H2O) and to a
    /// gasoline-vapour cp polynomial (clipped to 300..1600 K), integrated.
    pub u_j_kg: [[f64; 7]; 3],
    /// Stoichiometric air/fuel mass ratio \[-\], thesis 3.1.
    pub afr_stoich: f64,
    /// Lower heating value \[J/kg\].
    pub lhv_j_kg: f64,
    /// Latent heat of the fuel \[J/kg\].
    pub latent_j_kg: f64,
}

impl GasModel {
    /// Real-gas-data set of the specification.
    pub fn gasoline() -> Self {
        Self {
            r_j_kg_k: [288.1962779202773, 72.40364657561302, 287.7237295485266],
            u_j_kg: [
                [
                    -210647.25677943893,
                    704033.5482727311,
                    -31493.224124215583,
                    157731.91270250533,
                    -87077.63588238013,
                    20410.519643450247,
                    -1794.6119883209394,
                ],
                [
                    -352328.3864253092,
                    739074.5091162826,
                    1487053.947950091,
                    5129.324357794069,
                    -39453.15673603072,
                    -18432.54748215701,
                    4624.789641503288,
                ],
                [
                    -219421.3499580361,
                    704555.415750545,
                    80334.28217229203,
                    101837.85672909129,
                    -65552.9946533811,
                    15645.245986579757,
                    -1368.6179867295982,
                ],
            ],
            afr_stoich: 14.7,
            lhv_j_kg: 43.0e6,
            latent_j_kg: 350.0e3,
        }
    }

    /// All species alike with constant gamma: for comparison with closed-form cycles.
    pub fn constant_gamma(gamma: f64, r_j_kg_k: f64) -> Self {
        let cv = r_j_kg_k / (gamma - 1.0);
        let u = [-cv * 298.15, cv * 1000.0, 0.0, 0.0, 0.0, 0.0, 0.0];
        Self { r_j_kg_k: [r_j_kg_k; 3], u_j_kg: [u; 3], ..Self::gasoline() }
    }

    /// Sensible internal energy \[J\] of the masses (air, fuel vapour, products) \[kg\] at `t_k`.
    pub fn energy_j(&self, mass_kg: [f64; 3], t_k: f64) -> f64 {
        let c = self.mix(mass_kg);
        horner_u(&c, 1e-3 * t_k).0
    }

    /// Heat capacity at constant volume m cv \[J/K\] of the masses at `t_k`.
    pub fn heat_capacity_j_k(&self, mass_kg: [f64; 3], t_k: f64) -> f64 {
        let c = self.mix(mass_kg);
        1e-3 * horner_u(&c, 1e-3 * t_k).1
    }

    /// Both at once: U \[J\] and m cv \[J/K\].
    #[inline]
    pub(crate) fn energy_and_capacity(&self, mass_kg: [f64; 3], t_k: f64) -> (f64, f64) {
        let (u, du) = horner_u(&self.mix(mass_kg), 1e-3 * t_k);
        (u, 1e-3 * du)
    }

    /// m R \[J/K\] of the masses.
    pub fn mass_r_j_k(&self, mass_kg: [f64; 3]) -> f64 {
        mass_kg.iter().zip(&self.r_j_kg_k).map(|(m, r)| m * r).sum()
    }

    /// Relative air/fuel ratio by oxygen balance,
    /// lambda = (m_a + m_p AFR/(AFR+1)) / (AFR (m_f + m_p/(AFR+1))), saturated at [`AIR_ALONE`].
    pub fn lambda(&self, air_kg: f64, fuel_kg: f64, products_kg: f64) -> f64 {
        let afr = self.afr_stoich;
        let burned_fuel = products_kg / (afr + 1.0);
        let air = air_kg + afr * burned_fuel;
        let fuel = afr * (fuel_kg + burned_fuel);
        if air >= AIR_ALONE * fuel { AIR_ALONE } else { air / fuel }
    }

    fn mix(&self, m: [f64; 3]) -> [f64; 7] {
        let mut c = [0.0; 7];
        for k in 0..7 {
            c[k] = m[0] * self.u_j_kg[0][k] + m[1] * self.u_j_kg[1][k] + m[2] * self.u_j_kg[2][k];
        }
        c
    }

    /// Solve U(T) = E for all volumes at once by Newton from the guesses in `t_k`.
    ///
    /// `mass` holds air, fuel, products per volume \[kg\]; on return `t_k` holds temperatures to
    /// about 1e-6 K and `mcv` the heat capacities \[J/K\]. Newton converges quadratically with
    /// constant cv'/(2 cv) < 2e-4 1/K, so a last correction below 0.05 K leaves less than 1e-6 K.
    #[inline(always)]
    pub(crate) fn temperatures(
        &self,
        mass: &[[f64; VOLUMES]; 3],
        energy_j: &[f64; VOLUMES],
        t_k: &mut [f64; VOLUMES],
        mcv: &mut [f64; VOLUMES],
    ) {
        let mut c = [[0.0; VOLUMES]; 7];
        for k in 0..7 {
            let (a, f, p) = (self.u_j_kg[0][k], self.u_j_kg[1][k], self.u_j_kg[2][k]);
            for v in 0..VOLUMES {
                c[k][v] = mass[0][v] * a + mass[1][v] * f + mass[2][v] * p;
            }
        }
        let mut step = [0.0; VOLUMES];
        for _ in 0..12 {
            for v in 0..VOLUMES {
                let t = 1e-3 * t_k[v];
                let mut u = c[6][v];
                let mut du = 6.0 * c[6][v];
                u = u * t + c[5][v];
                du = du * t + 5.0 * c[5][v];
                u = u * t + c[4][v];
                du = du * t + 4.0 * c[4][v];
                u = u * t + c[3][v];
                du = du * t + 3.0 * c[3][v];
                u = u * t + c[2][v];
                du = du * t + 2.0 * c[2][v];
                u = u * t + c[1][v];
                du = du * t + c[1][v];
                u = u * t + c[0][v];
                mcv[v] = 1e-3 * du;
                step[v] = (energy_j[v] - u) / mcv[v];
            }
            // Loops of their own: one that also looks for the largest step is not done several volumes at a time.
            for v in 0..VOLUMES {
                // Outside the fit the polynomial may bend: keep the iterate in a sane range.
                let t = t_k[v] + step[v];
                let t = if t > 4000.0 { 4000.0 } else { t };
                t_k[v] = if t < 150.0 { 150.0 } else { t };
            }
            if step.iter().all(|s| s.abs() < 0.05) {
                break;
            }
        }
    }
}

/// Value and derivative with respect to t of the degree-6 polynomial `c`.
fn horner_u(c: &[f64; 7], t: f64) -> (f64, f64) {
    let (mut u, mut du) = (c[6], 0.0);
    for k in (0..6).rev() {
        du = du * t + u;
        u = u * t + c[k];
    }
    (u, du)
}
