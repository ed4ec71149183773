//! The causal policy: fuel for the air that will be there.

use super::Fuelling;
use super::adapt::{Adaptation, Left};
use super::feedback::{Feedback, FeedbackState};
use super::filling::FillingState;
use super::film::FilmState;
use super::foresight::Foresight;
use super::trim::TrimState;
use std::collections::VecDeque;

/// Time that slopes of what is measured are taken over in s, and most of a value that they may change on the way to the air.
const SLOPE_S: f64 = 0.05;
const MOST_CHANGE: f64 = 0.2;

/// The slope of a measured value: over [`SLOPE_S`], or what there is of it.
#[derive(Clone, Debug)]
struct Slope {
    /// Values of the samples before, newest first.
    past: VecDeque<f64>,
    samples: usize,
}

impl Slope {
    fn new(dt_s: f64) -> Self {
        let samples = (SLOPE_S / dt_s).round().max(1.0) as usize;
        Self { past: VecDeque::with_capacity(samples + 1), samples }
    }

    /// Change per s up to a new value that goes on for `ahead_s`; held where it would lead too far.
    fn step(&mut self, value: f64, ahead_s: f64, dt_s: f64) -> f64 {
        self.past.truncate(self.samples);
        self.past.push_front(value);
        let last = self.past.len() - 1;
        let slope = (value - self.past[last]) / (last.max(1) as f64 * dt_s);
        let most = MOST_CHANGE * value.abs() / ahead_s.max(dt_s);
        slope.clamp(-most, most)
    }
}

/// What is known at the beginning of a sample.
#[derive(Clone, Copy, Debug)]
pub struct Sensed {
    /// Speed of this sample in rpm, as records have it: one that was measured a sample ago goes on as it went, or fuel is off in ramps.
    pub speed_rpm: f64,
    /// Throttle that is commanded for this sample, in deg.
    pub throttle_deg: f64,
    /// Manifold pressure that the channel shows, in kPa.
    pub map_kpa: f64,
    /// Pressure before the throttle in kPa, where it is measured.
    pub upstream_kpa: Option<f64>,
    /// Coolant temperature in degC; any number where nothing was identified of it.
    pub coolant_c: f64,
    /// Places of intake and exhaust cam in deg, where they are measured.
    pub cams_deg: Option<[f64; 2]>,
    /// Lambda that the sensor shows; none while it shows nothing: no trim then.
    pub lambda: Option<f64>,
}

/// Fuel sample by sample from measured speed and pressure, the throttle command and the demanded lambda.
#[derive(Clone, Debug)]
pub struct FuelPolicy {
    fuelling: Fuelling,
    most: f64,
    filling: Option<FillingState>,
    film: Option<FilmState>,
    trim: TrimState,
    /// Logarithm of what leaves the manifold over what throttle and charge say, where it is learnt: without it a throttle that is not
    /// quite the identified one leads the pressure astray, and the air ahead is wrong at rest.
    balance: Option<f64>,
    /// Beside the trim: what the air ahead was foreseen to be, and what it became.
    foresight: Foresight,
    /// A loop in the place of the trim.
    feedback: Option<Feedback>,
    loop_of: FeedbackState,
    speed: Slope,
    upstream: Slope,
    cams: [Slope; 2],
}

impl FuelPolicy {
    /// Of what was identified, at the sample time of its record; injections stay within 0 and `most`.
    pub fn new(fuelling: Fuelling, most: f64) -> Self {
        let dt_s = fuelling.sample_time_s;
        Self {
            fuelling,
            most,
            filling: None,
            film: None,
            trim: TrimState::at_rest(dt_s),
            balance: None,
            foresight: Foresight::new(dt_s),
            feedback: None,
            loop_of: FeedbackState::default(),
            speed: Slope::new(dt_s),
            upstream: Slope::new(dt_s),
            cams: [Slope::new(dt_s), Slope::new(dt_s)],
        }
    }

    /// The same with the lambda loop of an ECU in the place of the trim: engines that are not quite the identified one are farther off than
    /// what the model left of its records, which is what the trim goes by.
    #[must_use]
    pub fn with_feedback(self, feedback: Feedback) -> Self {
        Self { feedback: Some(feedback), ..self }
    }

    /// The same with a charge that is learnt over speed and pressure while the engine is driven ([`Adaptation`]), beside the trim and in
    /// the place of a loop. Records that do not say what was left of them are taken as independent every second.
    ///
    /// ```no_run
    /// # fn f(fuelling: dynocal_calib::fuelling::Fuelling) {
    /// use dynocal_calib::fuelling::{Adaptation, FuelPolicy};
    /// let policy = FuelPolicy::new(fuelling, 60.0).adapting(Adaptation::default());
    /// # }
    /// ```
    #[must_use]
    pub fn adapting(mut self, by: Adaptation) -> Self {
        let left = self.fuelling.left.unwrap_or(Left { scale: self.fuelling.rms.max(1e-6), apart_s: 1.0 });
        self.trim.adapt(by, left);
        Self { feedback: None, balance: Some(0.0), ..self }
    }

    /// The charge at a speed and a pressure that trim and adaptation have found over the identified one.
    pub fn trimmed(&self, speed_rpm: f64, pressure_kpa: f64) -> f64 {
        self.trim.factor(self.fuelling.charge.scaled(speed_rpm, pressure_kpa))
    }

    /// The injection of this sample at a demanded lambda; the first call starts at rest. No allocation after it.
    pub fn step(&mut self, y: &Sensed, lambda: f64) -> f64 {
        self.stepped(y, Some(lambda))
    }

    /// A sample without injection, as in overrun: manifold, film and sensor go on, so that what was left on the wall is known when fuel
    /// comes again. `y.lambda` must be none until the sensor shows fuelled gas again.
    pub fn cut(&mut self, y: &Sensed) {
        self.stepped(y, None);
    }

    fn stepped(&mut self, y: &Sensed, lambda: Option<f64>) -> f64 {
        let f = &self.fuelling;
        let (dt_s, speed_rpm, throttle_deg) = (f.sample_time_s, y.speed_rpm, y.throttle_deg);
        let air = f.air(y.coolant_c, y.cams_deg);
        let state = self.filling.get_or_insert_with(|| FillingState::at_rest(y.map_kpa, throttle_deg, dt_s));
        let upstream_kpa = y.upstream_kpa.unwrap_or(f.filling.upstream_kpa);
        if let Some(balance) = &mut self.balance {
            let error_kpa = y.map_kpa - state.shown_kpa();
            *balance =
                f.filling.balanced(*balance, error_kpa, air.flow(speed_rpm, state.pressure_kpa()), dt_s);
        }
        let leaves = self.balance.map_or(1.0, f64::exp);
        state.step(&f.filling, air.times(leaves), (speed_rpm, throttle_deg, upstream_kpa), y.map_kpa, dt_s);
        let now_kpa = state.pressure_kpa();
        let ahead_s = f.timing.ahead_s(speed_rpm);
        let speed = [speed_rpm, self.speed.step(speed_rpm, ahead_s, dt_s)];
        let upstream = [upstream_kpa, self.upstream.step(upstream_kpa, ahead_s, dt_s)];
        let cams = y.cams_deg.map(|now| {
            let [a, b] = &mut self.cams;
            [[now[0], a.step(now[0], ahead_s, dt_s)], [now[1], b.step(now[1], ahead_s, dt_s)]]
        });
        // On the way as they are in its middle.
        let later =
            |share: f64| f.air(y.coolant_c, cams.map(|c| c.map(|[at, slope]| at + slope * share * ahead_s)));
        let pressure =
            state.ahead(&f.filling, later(0.5).times(leaves), speed, throttle_deg, upstream, ahead_s, dt_s);
        let then_rpm = speed[0] + speed[1] * ahead_s;
        let demanded = lambda.unwrap_or(1.0);
        let factor = match self.feedback {
            Some(_) => {
                let flow = air.flow(speed_rpm, now_kpa);
                self.loop_of.factor(self.feedback, y, (demanded, flow), dt_s)
            }
            None => {
                if let Some(shown) = y.lambda {
                    self.trim.measured(f.trim.as_ref(), shown, dt_s);
                }
                self.trim.factor(f.charge.scaled(then_rpm, pressure))
            }
        };
        let charge = later(1.0).at(then_rpm, pressure);
        let lacked = match (&f.trim, self.feedback) {
            (Some(trim), None) => self.foresight.compared(trim, air.at(speed_rpm, now_kpa), ahead_s, dt_s),
            _ => 1.0,
        };
        self.foresight.foreseen(charge);
        let wanted = (factor * lacked * charge / demanded).max(0.0);
        let film = f.film_of(y.coolant_c, speed_rpm, now_kpa);
        let on_wall = self.film.get_or_insert_with(|| film.at_rest(wanted, speed_rpm));
        let mut before = *on_wall;
        let injection = match lambda {
            Some(_) => film.inverse(on_wall, wanted, speed_rpm, dt_s, self.most),
            None => {
                film.forward(on_wall, 0.0, speed_rpm, dt_s);
                0.0
            }
        };
        let fuel = film.forward(&mut before, injection, speed_rpm, dt_s);
        self.trim.fuelled(f, air, fuel, (speed_rpm, now_kpa), lambda.is_some());
        injection
    }
}
