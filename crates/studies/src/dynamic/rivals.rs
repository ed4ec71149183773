//! Controllers that are compared: static map, static map behind a lag, an ECU that fuels by measured pressure, and ours.

use std::collections::VecDeque;

use dynocal_calib::fuelling::{Air, Charge, CoolantLaw, Film, FilmState, FuelPolicy, Sensed, Timing};
use dynocal_calib::map::static_map::StaticMap;

use super::bed::{Command, Controller, MOST_MG, Measured, SAMPLE_S};

/// Samples over which the ECU takes the slope of the pressure: 30 ms.
const SLOPE: usize = 3;

/// The static map, injection and spark behind a lag of `lag_s` at 2000 rpm (0: none) that goes with the cycle.
#[derive(Clone)]
pub(super) struct Mapped<'a> {
    map: &'a StaticMap,
    places: [usize; 3],
    lag_s: f64,
    behind: Option<[f64; 2]>,
}

impl<'a> Mapped<'a> {
    /// None where the map does not give injection, spark and throttle.
    pub(super) fn new(map: &'a StaticMap, lag_s: f64) -> Option<Self> {
        let place = |name: &str| map.ports.actuators.iter().position(|a| a.name == name);
        Some(Self { map, places: [place("inj")?, place("spark")?, place("throttle")?], lag_s, behind: None })
    }
}

impl Controller for Mapped<'_> {
    fn step(&mut self, torque_nm: f64, y: &Measured) -> Command {
        let mut u = vec![0.0; self.map.ports.actuators.len()];
        self.map.at(&[torque_nm, 1.0, y.speed_rpm], &mut u);
        let [injection, spark, throttle_deg] = self.places.map(|k| u[k]);
        let behind = self.behind.get_or_insert([injection, spark]);
        let tau_s = self.lag_s * 2000.0 / y.speed_rpm;
        let follow = if tau_s > 0.0 { -(-SAMPLE_S / tau_s).exp_m1() } else { 1.0 };
        for (b, u) in behind.iter_mut().zip([injection, spark]) {
            *b += follow * (u - *b);
        }
        Command { injection_mg: behind[0], spark_deg: behind[1], throttle_deg }
    }
}

/// A film over the coolant.
#[derive(Clone, Copy, Debug)]
pub(super) struct Coat {
    pub(super) film: Film,
    pub(super) law: Option<CoolantLaw>,
}

impl Coat {
    fn at(&self, coolant_c: f64) -> Film {
        self.law.map_or(self.film, |law| law.film(self.film, coolant_c))
    }
}

/// A charge over the coolant.
#[derive(Clone, Debug)]
pub(super) struct Load {
    pub(super) charge: Charge,
    pub(super) law: Option<CoolantLaw>,
}

/// Lambda feedback of the ECU: proportional and integral by internal model control of a lag (that of the sensor) behind a delay, for
/// the time constant `closed_s` of the closed loop.
#[derive(Clone, Copy)]
pub(super) struct Feedback<'a> {
    pub(super) timing: &'a Timing,
    pub(super) closed_s: f64,
}

/// Most of the integral of the feedback.
const MOST_TRIM: f64 = 0.25;

/// A production ECU: fuel from the air at the measured pressure, extrapolated by its slope, with or without film compensation and
/// lambda feedback; throttle and spark by the map.
pub(super) struct Ecu<'a> {
    base: Mapped<'a>,
    load: &'a Load,
    /// Time of the extrapolation in s.
    ahead_s: f64,
    film: Option<Coat>,
    feedback: Option<Feedback<'a>>,
    past: VecDeque<f64>,
    state: Option<FilmState>,
    integral: f64,
}

impl<'a> Ecu<'a> {
    pub(super) fn new(
        base: Mapped<'a>,
        load: &'a Load,
        ahead_s: f64,
        film: Option<Coat>,
        feedback: Option<Feedback<'a>>,
    ) -> Self {
        Self { base, load, ahead_s, film, feedback, past: VecDeque::new(), state: None, integral: 0.0 }
    }

    /// What the fuel is multiplied by.
    fn trim(&mut self, y: &Measured, flow: f64) -> f64 {
        let Some(Feedback { timing, closed_s }) = self.feedback else {
            return 1.0;
        };
        let error = y.lambda - 1.0;
        let per_s = 1.0 / (closed_s + timing.delay_s(y.speed_rpm, flow));
        self.integral = (self.integral + per_s * error * SAMPLE_S).clamp(-MOST_TRIM, MOST_TRIM);
        1.0 + self.integral + per_s * timing.sensor_lag_s * error
    }
}

impl Controller for Ecu<'_> {
    fn step(&mut self, torque_nm: f64, y: &Measured) -> Command {
        let u = self.base.step(torque_nm, y);
        self.past.push_front(y.map_kpa);
        self.past.truncate(SLOPE + 1);
        let last = self.past.len() - 1;
        let slope = (self.past[0] - self.past[last]) / (last.max(1) as f64 * SAMPLE_S);
        let pressure = (y.map_kpa + self.ahead_s * slope).clamp(10.0, 100.0);
        let air = Air::new(&self.load.charge, self.load.law.as_ref(), y.coolant_c);
        let wanted =
            (air.at(y.speed_rpm, pressure) * self.trim(y, air.flow(y.speed_rpm, y.map_kpa))).max(0.0);
        let injection_mg = match self.film {
            None => wanted,
            Some(coat) => {
                let film = coat.at(y.coolant_c);
                let state = self.state.get_or_insert_with(|| film.at_rest(wanted, y.speed_rpm));
                film.inverse(state, wanted, y.speed_rpm, SAMPLE_S, MOST_MG)
            }
        };
        Command { injection_mg, ..u }
    }
}

/// Ours: fuel by the identified policy; throttle and spark by the map.
pub(super) struct Ours<'a> {
    pub(super) base: Mapped<'a>,
    pub(super) policy: FuelPolicy,
    /// Whether it is shown what the lambda sensor shows.
    pub(super) trimmed: bool,
}

impl Controller for Ours<'_> {
    fn step(&mut self, torque_nm: f64, y: &Measured) -> Command {
        let u = self.base.step(torque_nm, y);
        let sensed = Sensed {
            speed_rpm: y.speed_rpm,
            throttle_deg: u.throttle_deg,
            map_kpa: y.map_kpa,
            coolant_c: y.coolant_c,
            lambda: self.trimmed.then_some(y.lambda),
        };
        let injection_mg = self.policy.step(&sensed, 1.0);
        Command { injection_mg, ..u }
    }
}

/// Fuel that was learned on the record, sample by sample; throttle and spark by the map.
pub(super) struct Played<'a> {
    pub(super) base: Mapped<'a>,
    pub(super) injection_mg: &'a [f64],
    pub(super) at: usize,
}

impl Controller for Played<'_> {
    fn step(&mut self, torque_nm: f64, y: &Measured) -> Command {
        let u = self.base.step(torque_nm, y);
        let injection_mg = self.injection_mg[self.at.min(self.injection_mg.len() - 1)];
        self.at += 1;
        Command { injection_mg, ..u }
    }
}
