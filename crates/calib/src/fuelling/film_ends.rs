//! What speed and pressure do to the film.

use super::film::Film;
use serde::{Deserialize, Serialize};

/// A film over speed N and manifold pressure p, with n and m what they are from the middle over the half width of the records:
///
/// ```text
/// ln(X / (1 - X)) = that in the middle + a n + b m,   ln tau = that in the middle + c n + d m
/// ```
///
/// not continued beyond the records. It takes up what goes with the time of a cycle and with the gas: fuel that evaporates between injection
/// and induction, mixture that valves push back.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct FilmEnds {
    /// Middle and half width of the speed in rpm.
    pub speed_rpm: [f64; 2],
    /// Middle and half width of the pressure in kPa.
    pub pressure_kpa: [f64; 2],
    /// Slopes a and b.
    pub share: [f64; 2],
    /// Slopes c and d.
    pub tau: [f64; 2],
}

impl FilmEnds {
    /// The film at a speed and a pressure, of the one in their middle.
    ///
    /// ```
    /// use dynocal_calib::fuelling::{Film, FilmEnds};
    /// let middle = Film { share: 0.3, tau_s: 0.4 };
    /// let ends = FilmEnds { speed_rpm: [2000.0, 1000.0], pressure_kpa: [50.0, 20.0], share: [-0.1, 0.0], tau: [0.0, 0.2] };
    /// assert_eq!(ends.film(middle, 2000.0, 50.0), middle);
    /// let slow = ends.film(middle, 1000.0, 70.0);
    /// assert!((slow.share / (1.0 - slow.share) / (0.3 / 0.7) - 0.1_f64.exp()).abs() < 1e-12);
    /// assert!((slow.tau_s - 0.4 * 0.2_f64.exp()).abs() < 1e-12);
    /// // Nothing is known beyond the records.
    /// assert_eq!(ends.film(middle, 500.0, 90.0), slow);
    /// ```
    pub fn film(&self, middle: Film, speed_rpm: f64, pressure_kpa: f64) -> Film {
        let scaled = |v: f64, [mid, half]: [f64; 2]| ((v - mid) / half).clamp(-1.0, 1.0);
        let (n, m) = (scaled(speed_rpm, self.speed_rpm), scaled(pressure_kpa, self.pressure_kpa));
        let by = |[speed, pressure]: [f64; 2]| (speed * n + pressure * m).exp();
        let odds = middle.share / (1.0 - middle.share) * by(self.share);
        Film { share: odds / (1.0 + odds), tau_s: middle.tau_s * by(self.tau) }
    }

    /// The corners of speed and pressure.
    pub(super) fn corners(&self) -> [[f64; 2]; 4] {
        let ends = |[mid, half]: [f64; 2]| [mid - half, mid + half];
        let ([slow, fast], [thin, dense]) = (ends(self.speed_rpm), ends(self.pressure_kpa));
        [[slow, thin], [slow, dense], [fast, thin], [fast, dense]]
    }
}
