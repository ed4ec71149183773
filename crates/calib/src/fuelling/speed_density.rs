//! What a production ECU does with the same measurements: air by the measured pressure, which it extrapolates by its slope; the
//! inverse of a film; lambda feedback.

use super::charge::Charge;
use super::coolant::{Air, CoolantLaw};
use super::feedback::{Feedback, FeedbackState};
use super::film::{Film, FilmState};
use super::film_ends::FilmEnds;
use super::policy::Sensed;
use serde::{Deserialize, Serialize};
use std::collections::VecDeque;

/// Time that the slope of the pressure is taken over in s.
const SLOPE_S: f64 = 0.03;
/// Pressures beyond these in kPa are no extrapolation.
const LEAST_KPA: f64 = 10.0;

/// A film with what coolant, speed and pressure do to it.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Coat {
    /// Film.
    pub film: Film,
    /// What the coolant does to it, if that is known.
    pub law: Option<CoolantLaw>,
    /// What speed and pressure do to it, if that is known.
    #[serde(default)]
    pub ends: Option<FilmEnds>,
}

impl Coat {
    /// The film at a coolant temperature, a speed and a manifold pressure.
    pub fn at(&self, coolant_c: f64, speed_rpm: f64, pressure_kpa: f64) -> Film {
        let middle = self.law.map_or(self.film, |law| law.film(self.film, coolant_c));
        self.ends.map_or(middle, |ends| ends.film(middle, speed_rpm, pressure_kpa))
    }
}

/// What a speed-density ECU knows and tunes.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct SpeedDensity {
    /// Interval of control in s.
    pub sample_time_s: f64,
    /// Air charge.
    pub charge: Charge,
    /// What the coolant does to the charge, if that is known.
    pub law: Option<CoolantLaw>,
    /// Greatest pressure of the extrapolation in kPa.
    pub most_kpa: f64,
    /// Time of the extrapolation in s.
    pub ahead_s: f64,
    /// Film that is compensated.
    pub film: Option<Coat>,
    /// Lambda feedback.
    pub feedback: Option<Feedback>,
}

/// Fuel sample by sample as a speed-density ECU gives it:
///
/// ```text
/// q = inverse of the film of  c(N, p + t dp/dt) (1 + trim) / lambda demanded
/// ```
///
/// The rival of every map of transients.
///
/// ```
/// use dynocal_calib::fuelling::{Charge, Sensed, SpeedDensity, SpeedDensityState};
/// let points: Vec<[f64; 3]> =
///     (0..60).map(|k| [1000.0 + 400.0 * f64::from(k % 6), 30.0 + 6.0 * f64::from(k / 6), 0.25 * (30.0 + 6.0 * f64::from(k / 6))]).collect();
/// let ecu = SpeedDensity {
///     sample_time_s: 0.01,
///     charge: Charge::fit(&points)?,
///     law: None,
///     most_kpa: 100.0,
///     ahead_s: 0.05,
///     film: None,
///     feedback: None,
/// };
/// let mut state = SpeedDensityState::new(ecu, 60.0);
/// let mut at = |map_kpa| state.step(&Sensed { speed_rpm: 2000.0, throttle_deg: 0.0, map_kpa, upstream_kpa: None, coolant_c: 90.0, cams_deg: None, lambda: None }, 1.0);
/// assert!((at(40.0) - 10.0).abs() < 1e-4);
/// // 1 kPa in 10 ms, seen 50 ms ahead.
/// assert!((at(41.0) - 0.25 * 46.0).abs() < 1e-4);
/// # Ok::<(), dynocal_numerics::linalg::LinalgError>(())
/// ```
#[derive(Clone, Debug)]
pub struct SpeedDensityState {
    ecu: SpeedDensity,
    most: f64,
    past: VecDeque<f64>,
    film: Option<FilmState>,
    loop_of: FeedbackState,
}

impl SpeedDensityState {
    /// At rest; injections stay within 0 and `most`.
    pub fn new(ecu: SpeedDensity, most: f64) -> Self {
        let samples = slope_samples(&ecu);
        Self {
            past: VecDeque::with_capacity(samples + 2),
            ecu,
            most,
            film: None,
            loop_of: FeedbackState::default(),
        }
    }

    /// The injection of this sample at a demanded lambda; the first call starts at rest. No allocation after it.
    pub fn step(&mut self, y: &Sensed, lambda: f64) -> f64 {
        self.stepped(y, Some(lambda))
    }

    /// A sample without injection, as in overrun: pressure and film go on. `y.lambda` must be none until the sensor shows fuelled gas
    /// again.
    pub fn cut(&mut self, y: &Sensed) {
        self.stepped(y, None);
    }

    fn stepped(&mut self, y: &Sensed, lambda: Option<f64>) -> f64 {
        self.past.push_front(y.map_kpa);
        self.past.truncate(slope_samples(&self.ecu) + 1);
        let last = self.past.len() - 1;
        let dt_s = self.ecu.sample_time_s;
        let slope = (self.past[0] - self.past[last]) / (last.max(1) as f64 * dt_s);
        let pressure = (y.map_kpa + self.ecu.ahead_s * slope).clamp(LEAST_KPA, self.ecu.most_kpa);
        let air = Air::new(&self.ecu.charge, self.ecu.law.as_ref(), y.coolant_c, y.cams_deg);
        let (now, flow) = (air.at(y.speed_rpm, pressure), air.flow(y.speed_rpm, y.map_kpa));
        let demanded = lambda.unwrap_or(1.0);
        let trim = self.loop_of.factor(self.ecu.feedback, y, (demanded, flow), dt_s);
        let wanted = (now * trim / demanded).max(0.0);
        let film = self.ecu.film.map(|coat| coat.at(y.coolant_c, y.speed_rpm, y.map_kpa));
        let state = film.map(|film| self.film.get_or_insert_with(|| film.at_rest(wanted, y.speed_rpm)));
        match (film.zip(state), lambda) {
            (None, Some(_)) => wanted.min(self.most),
            (None, None) => 0.0,
            (Some((film, state)), Some(_)) => film.inverse(state, wanted, y.speed_rpm, dt_s, self.most),
            (Some((film, state)), None) => {
                film.forward(state, 0.0, y.speed_rpm, dt_s);
                0.0
            }
        }
    }
}

/// Samples that the slope of the pressure is taken over.
fn slope_samples(ecu: &SpeedDensity) -> usize {
    (SLOPE_S / ecu.sample_time_s).round().max(1.0) as usize
}
