//! Controllers that are compared: static map, static map behind a lag, an ECU that fuels by measured pressure, and ours.

use std::collections::VecDeque;

use dynocal_calib::fuelling::{Charge, Film, FilmState, FuelPolicy};
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

/// A production ECU: fuel from the air at the measured pressure, extrapolated by its slope, with or without film compensation;
/// throttle and spark by the map.
pub(super) struct Ecu<'a> {
    pub(super) base: Mapped<'a>,
    pub(super) charge: &'a Charge,
    /// Time of the extrapolation in s.
    pub(super) ahead_s: f64,
    pub(super) film: Option<Film>,
    pub(super) past: VecDeque<f64>,
    pub(super) state: Option<FilmState>,
}

impl<'a> Ecu<'a> {
    pub(super) fn new(base: Mapped<'a>, charge: &'a Charge, ahead_s: f64, film: Option<Film>) -> Self {
        Self { base, charge, ahead_s, film, past: VecDeque::new(), state: None }
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
        let wanted = self.charge.at(y.speed_rpm, pressure).max(0.0);
        let injection_mg = match self.film {
            None => wanted,
            Some(film) => {
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
}

impl Controller for Ours<'_> {
    fn step(&mut self, torque_nm: f64, y: &Measured) -> Command {
        let u = self.base.step(torque_nm, y);
        let injection_mg = self.policy.step(y.speed_rpm, u.throttle_deg, y.map_kpa, 1.0);
        Command { injection_mg, ..u }
    }
}
