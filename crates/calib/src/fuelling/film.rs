//! The fuel film in mean values over the cylinders, exact for injections that are held over a sample.

use serde::{Deserialize, Serialize};

/// Share X of the injection that wets the wall, and time constant tau of its evaporation.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Film {
    /// Share X.
    pub share: f64,
    /// Time constant tau in s.
    pub tau_s: f64,
}

/// Fuel on the wall of one port, in the unit of the injection.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct FilmState {
    on_wall: f64,
}

impl Film {
    /// The film that an injection per cycle keeps.
    pub fn at_rest(&self, injection: f64, speed_rpm: f64) -> FilmState {
        FilmState { on_wall: self.share * injection * self.tau_s * speed_rpm / 120.0 }
    }

    /// What the cylinder gets per cycle of `injection`; the film moves on by `dt_s`.
    ///
    /// ```
    /// use dynocal_calib::fuelling::Film;
    /// let film = Film { share: 0.3, tau_s: 0.4 };
    /// let mut state = film.at_rest(10.0, 2000.0);
    /// assert!((film.forward(&mut state, 10.0, 2000.0, 0.01) - 10.0).abs() < 1e-12);
    /// // Of a step up the wall keeps its share at first.
    /// assert!((film.forward(&mut state, 20.0, 2000.0, 0.01) - (0.7 * 20.0 + 0.3 * 10.0)).abs() < 1e-12);
    /// // The inverse gives what is asked.
    /// let (mut on, mut back) = (state, state);
    /// let q = film.inverse(&mut back, 12.5, 2000.0, 0.01, 60.0);
    /// assert!((film.forward(&mut on, q, 2000.0, 0.01) - 12.5).abs() < 1e-12 && on == back);
    /// ```
    pub fn forward(&self, state: &mut FilmState, injection: f64, speed_rpm: f64, dt_s: f64) -> f64 {
        let taken = (1.0 - self.share) * injection + self.evaporated(state, speed_rpm);
        self.advance(state, injection, speed_rpm, dt_s);
        taken
    }

    /// The injection of which the cylinder gets `wanted` per cycle, within 0 to `most`; the film moves on by `dt_s`.
    pub fn inverse(&self, state: &mut FilmState, wanted: f64, speed_rpm: f64, dt_s: f64, most: f64) -> f64 {
        let injection = (wanted - self.evaporated(state, speed_rpm)) / (1.0 - self.share);
        let injection = injection.clamp(0.0, most);
        self.advance(state, injection, speed_rpm, dt_s);
        injection
    }

    /// The pole of [`Film::inverse`] at a sample time: how much of what is too much on the wall is still too much a sample later,
    ///
    /// ```text
    /// e - (1 - e) X / (1 - X),   e = exp(-dt / tau)
    /// ```
    ///
    /// The inverse is stable within the unit circle, and does not swing where this is not negative, which is X <= e.
    ///
    /// ```
    /// use dynocal_calib::fuelling::Film;
    /// let film = Film { share: 0.3, tau_s: 0.4 };
    /// let (mut a, mut b) = (film.at_rest(10.0, 2000.0), film.at_rest(12.0, 2000.0));
    /// let mut apart = || film.inverse(&mut b, 8.0, 2000.0, 0.01, 60.0) - film.inverse(&mut a, 8.0, 2000.0, 0.01, 60.0);
    /// let (first, second) = (apart(), apart());
    /// assert!((second / first - film.inverse_pole(0.01)).abs() < 1e-9);
    /// assert!(Film { share: 0.7, tau_s: 0.01 }.inverse_pole(0.01) < -1.0);
    /// ```
    pub fn inverse_pole(&self, dt_s: f64) -> f64 {
        let e = (-dt_s / self.tau_s).exp();
        e - (1.0 - e) * self.share / (1.0 - self.share)
    }

    /// What evaporates in a cycle.
    fn evaporated(&self, state: &FilmState, speed_rpm: f64) -> f64 {
        120.0 / speed_rpm * state.on_wall / self.tau_s
    }

    fn advance(&self, state: &mut FilmState, injection: f64, speed_rpm: f64, dt_s: f64) {
        let rest = self.at_rest(injection, speed_rpm).on_wall;
        state.on_wall = rest + (state.on_wall - rest) * (-dt_s / self.tau_s).exp();
    }
}
