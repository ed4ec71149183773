//! Fuel film of port injection (X-tau model, Aquino, SAE 810494).
//!
//! A share X of each injection wets the wall of the intake port, the rest stays airborne; the film m_f evaporates,
//! dm_f/dt = X m'_inj - m_f/tau, m'_cyl = (1 - X) m'_inj + m_f/tau. Injection and induction happen once in a cycle,
//! so the equation is solved exactly between them: the film keeps the share e^(-T/tau) over an interval T.

use serde::{Deserialize, Serialize};

/// Constants of the film of one cylinder.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct FilmModel {
    /// Share X of the injected fuel that wets the wall \[-\].
    pub share: f64,
    /// Time constant tau of its evaporation, warm \[s\].
    pub tau_s: f64,
}

/// Fuel in the port of one cylinder.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize)]
pub struct Film {
    /// Film on the wall \[kg\].
    pub film_kg: f64,
    /// Airborne fuel that waits for the intake valve \[kg\].
    pub airborne_kg: f64,
    /// Time of the last evaporation \[s\].
    pub time_s: f64,
}

impl Film {
    /// Injects `fuel_kg` at `time_s`.
    pub fn inject(&mut self, model: &FilmModel, factor: f64, fuel_kg: f64, time_s: f64) {
        self.evaporate(model, factor, time_s);
        self.film_kg += model.share * fuel_kg;
        self.airborne_kg += fuel_kg - model.share * fuel_kg;
    }

    /// Takes what is airborne at `time_s` into the cylinder \[kg\]; `factor` scales tau (cold walls: above one).
    ///
    /// ```
    /// use dynocal_plant::film::{Film, FilmModel};
    /// let model = FilmModel { share: 0.3, tau_s: 0.2 };
    /// let mut film = Film::default();
    /// film.inject(&model, 1.0, 10e-6, 0.0);
    /// let taken = film.induct(&model, 1.0, 0.05);
    /// let expected = 10e-6 * (0.7 + 0.3 * (1.0 - (-0.05f64 / 0.2).exp()));
    /// assert!((taken - expected).abs() < 1e-18);
    /// ```
    pub fn induct(&mut self, model: &FilmModel, factor: f64, time_s: f64) -> f64 {
        self.evaporate(model, factor, time_s);
        std::mem::take(&mut self.airborne_kg)
    }

    fn evaporate(&mut self, model: &FilmModel, factor: f64, time_s: f64) {
        let tau_s = (model.tau_s * factor).max(1e-6);
        let part = -self.film_kg * (-(time_s - self.time_s).max(0.0) / tau_s).exp_m1();
        self.film_kg -= part;
        self.airborne_kg += part;
        self.time_s = time_s;
    }
}
