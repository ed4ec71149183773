//! The causal policy: fuel for the air that will be there.

use super::Fuelling;
use super::filling::FillingState;
use super::film::FilmState;

/// Fuel sample by sample from measured speed and pressure, the throttle command and the demanded lambda.
#[derive(Clone, Debug)]
pub struct FuelPolicy {
    fuelling: Fuelling,
    most: f64,
    filling: Option<FillingState>,
    film: Option<FilmState>,
}

impl FuelPolicy {
    /// Of what was identified, at the sample time of its record; injections stay within 0 and `most`.
    pub fn new(fuelling: Fuelling, most: f64) -> Self {
        Self { fuelling, most, filling: None, film: None }
    }

    /// The injection of this sample; the first call starts at rest. No allocation after it.
    ///
    /// `throttle_deg` is what is commanded for this sample, `map_kpa` what the channel shows at its beginning.
    pub fn step(&mut self, speed_rpm: f64, throttle_deg: f64, map_kpa: f64, lambda: f64) -> f64 {
        let f = &self.fuelling;
        let dt_s = f.sample_time_s;
        let state = self.filling.get_or_insert_with(|| FillingState::at_rest(map_kpa, throttle_deg, dt_s));
        state.step(&f.filling, &f.charge, speed_rpm, throttle_deg, map_kpa, dt_s);
        let ahead_s = f.timing.ahead_s(speed_rpm);
        let pressure = state.ahead(&f.filling, &f.charge, speed_rpm, throttle_deg, ahead_s, dt_s);
        let wanted = (f.charge.at(speed_rpm, pressure) / lambda).max(0.0);
        let film = self.film.get_or_insert_with(|| f.film.at_rest(wanted, speed_rpm));
        f.film.inverse(film, wanted, speed_rpm, dt_s, self.most)
    }
}
