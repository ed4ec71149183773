//! What the coolant's temperature does to film and charge.

use super::charge::Charge;
use super::film::Film;
use serde::{Deserialize, Serialize};

/// Film and charge over the coolant temperature T:
///
/// ```text
/// ln(X / (1 - X)) and ln tau    linear in T
/// c(N, p, T) = c(N, p) exp(a (T - T0)) (1 + (T - T0) (b n + d m)),    n, m: N and p from the middle over the half width of the record
/// ```
///
/// as evaporation goes with the exponential of a temperature, and the charge with the heat that it takes from the walls. Not
/// continued beyond the temperatures of the record.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct CoolantLaw {
    /// Temperature T0 at which film and charge are what they are without this law, in degC.
    pub at_c: f64,
    /// Lowest and highest temperature of the record in degC.
    pub range_c: [f64; 2],
    /// Slope of ln(X / (1 - X)) in 1/K.
    pub share_per_k: f64,
    /// Slope of ln tau in 1/K.
    pub tau_per_k: f64,
    /// Slope a of the logarithm of the charge in 1/K.
    pub charge_per_k: f64,
    /// What is added to that at the ends of the speed and of the pressure of the record, b and d, in 1/K: gas that is slow or thin takes
    /// more heat.
    #[serde(default)]
    pub charge_ends_per_k: [f64; 2],
}

impl CoolantLaw {
    fn beyond_k(&self, coolant_c: f64) -> f64 {
        coolant_c.clamp(self.range_c[0], self.range_c[1]) - self.at_c
    }

    /// The film at a coolant temperature.
    ///
    /// ```
    /// use dynocal_calib::fuelling::{CoolantLaw, Film};
    /// let warm = Film { share: 0.3, tau_s: 0.2 };
    /// let law = CoolantLaw { at_c: 90.0, range_c: [20.0, 90.0], share_per_k: 0.0, tau_per_k: -0.02, charge_per_k: 0.0, charge_ends_per_k: [0.0; 2] };
    /// let cold = law.film(warm, 40.0);
    /// assert!((cold.tau_s - 0.2 * 1.0_f64.exp()).abs() < 1e-12 && (cold.share - 0.3).abs() < 1e-12);
    /// // Nothing is known below the record.
    /// assert_eq!(law.film(warm, -10.0), law.film(warm, 20.0));
    /// ```
    pub fn film(&self, film: Film, coolant_c: f64) -> Film {
        let by_k = self.beyond_k(coolant_c);
        let odds = film.share / (1.0 - film.share) * (self.share_per_k * by_k).exp();
        Film { share: odds / (1.0 + odds), tau_s: film.tau_s * (self.tau_per_k * by_k).exp() }
    }

    /// What the charge over that at `at_c` changes to the ends of speed and pressure.
    pub fn charge_ends(&self, coolant_c: f64) -> [f64; 2] {
        self.charge_ends_per_k.map(|v| v * self.beyond_k(coolant_c))
    }

    /// The charge over that at `at_c`, at a speed and a pressure in half widths of the record.
    pub fn charge_factor_at(&self, coolant_c: f64, at: [f64; 2]) -> f64 {
        to_the_ends(self.charge_factor(coolant_c), self.charge_ends(coolant_c), at)
    }

    /// The same in the middle of speed and pressure.
    pub fn charge_factor(&self, coolant_c: f64) -> f64 {
        (self.charge_per_k * self.beyond_k(coolant_c)).exp()
    }
}

/// A factor in the middle of speed and pressure, at a place in half widths from there.
fn to_the_ends(factor: f64, ends: [f64; 2], [n, p]: [f64; 2]) -> f64 {
    factor * (1.0 + ends[0] * n + ends[1] * p)
}

/// The charge as it is at a temperature and places of the cams.
#[derive(Clone, Copy, Debug)]
pub struct Air<'a> {
    /// Charge at the temperature of reference.
    pub charge: &'a Charge,
    /// What the coolant multiplies it by in the middle of speed and pressure.
    pub factor: f64,
    /// What that changes to the ends of speed and pressure.
    pub ends: [f64; 2],
    /// Intake and exhaust cam in deg, where they are measured.
    pub cams_deg: Option<[f64; 2]>,
}

impl<'a> Air<'a> {
    /// By a law of the coolant, if there is one, at the places of the cams, if they are measured.
    pub fn new(
        charge: &'a Charge,
        law: Option<&CoolantLaw>,
        coolant_c: f64,
        cams_deg: Option<[f64; 2]>,
    ) -> Self {
        let factor = law.map_or(1.0, |l| l.charge_factor(coolant_c));
        Self { charge, factor, ends: law.map_or([0.0; 2], |l| l.charge_ends(coolant_c)), cams_deg }
    }

    /// So many times as much.
    pub(super) fn times(self, factor: f64) -> Self {
        Self { factor: factor * self.factor, ..self }
    }

    /// Fuel per cycle that makes lambda 1, in the unit of the injection.
    pub fn at(&self, speed_rpm: f64, pressure_kpa: f64) -> f64 {
        let cams = self.charge.cam_factor(speed_rpm, pressure_kpa, self.cams_deg);
        let mut factor = self.factor;
        if self.ends != [0.0; 2] {
            factor = to_the_ends(factor, self.ends, self.charge.scaled(speed_rpm, pressure_kpa));
        }
        factor * cams * self.charge.at(speed_rpm, pressure_kpa)
    }

    /// Flow of that fuel into one cylinder per second.
    pub fn flow(&self, speed_rpm: f64, pressure_kpa: f64) -> f64 {
        self.at(speed_rpm, pressure_kpa) * speed_rpm / 120.0
    }
}
