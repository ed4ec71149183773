//! Controllers that are compared: static map, static map behind a lag, an ECU that fuels by measured pressure, and ours.

use dynocal_calib::fuelling::{FuelPolicy, Sensed, SpeedDensity, SpeedDensityState};
use dynocal_calib::map::static_map::StaticMap;

use super::bed::{Command, Controller, MOST_MG, Measured, SAMPLE_S};

/// The static map, injection and spark behind a lag of `lag_s` at 2000 rpm (0: none) that goes with the cycle.
#[derive(Clone)]
pub(super) struct Mapped<'a> {
    map: &'a StaticMap,
    places: [usize; 3],
    lag_s: f64,
    behind: Option<[f64; 2]>,
    speed: SpeedNow,
}

impl<'a> Mapped<'a> {
    /// None where the map does not give injection, spark and throttle.
    pub(super) fn new(map: &'a StaticMap, lag_s: f64) -> Option<Self> {
        let place = |name: &str| map.ports.actuators.iter().position(|a| a.name == name);
        Some(Self {
            map,
            places: [place("inj")?, place("spark")?, place("throttle")?],
            lag_s,
            behind: None,
            speed: SpeedNow::default(),
        })
    }
}

impl Controller for Mapped<'_> {
    fn step(&mut self, torque_nm: f64, y: &Measured) -> Command {
        let mut u = vec![0.0; self.map.ports.actuators.len()];
        let speed_rpm = self.speed.step(y.speed_rpm);
        self.map.at(&[torque_nm, 1.0, speed_rpm], &mut u);
        let [injection, spark, throttle_deg] = self.places.map(|k| u[k]);
        let behind = self.behind.get_or_insert([injection, spark]);
        let tau_s = self.lag_s * 2000.0 / speed_rpm;
        let follow = if tau_s > 0.0 { -(-SAMPLE_S / tau_s).exp_m1() } else { 1.0 };
        for (b, u) in behind.iter_mut().zip([injection, spark]) {
            *b += follow * (u - *b);
        }
        Command { injection_mg: behind[0], spark_deg: behind[1], throttle_deg }
    }
}

/// A production ECU: fuel from the air at the measured pressure, with or without film compensation and lambda feedback; throttle and
/// spark by the map.
pub(super) struct Ecu<'a> {
    base: Mapped<'a>,
    fuel: SpeedDensityState,
}

impl<'a> Ecu<'a> {
    pub(super) fn new(base: Mapped<'a>, ecu: SpeedDensity) -> Self {
        Self { base, fuel: SpeedDensityState::new(ecu, MOST_MG) }
    }
}

impl Controller for Ecu<'_> {
    fn step(&mut self, torque_nm: f64, y: &Measured) -> Command {
        let u = self.base.step(torque_nm, y);
        let injection_mg = self.fuel.step(&sensed(y, self.base.speed.now_rpm, u.throttle_deg, true), 1.0);
        Command { injection_mg, ..u }
    }
}

/// The speed of the sample that begins, for all controllers: the one that was measured goes on as it went. Records have the speed of each
/// sample itself, and what is identified from them is off by what the speed has become in the meantime: by 0.3 % of fuel on `pfi_1_6l` at
/// 1000 rpm/s and samples of 0.01 s. The beds here show the speed without noise; with it a longer slope were needed.
#[derive(Clone, Copy, Default)]
pub(super) struct SpeedNow {
    before_rpm: Option<f64>,
    now_rpm: f64,
}

impl SpeedNow {
    pub(super) fn step(&mut self, measured_rpm: f64) -> f64 {
        let before = self.before_rpm.replace(measured_rpm).unwrap_or(measured_rpm);
        self.now_rpm = 2.0 * measured_rpm - before;
        self.now_rpm
    }
}

/// What a policy is told; with the lambda that the sensor shows, or without it.
fn sensed(y: &Measured, speed_rpm: f64, throttle_deg: f64, lambda: bool) -> Sensed {
    Sensed {
        speed_rpm,
        throttle_deg,
        map_kpa: y.map_kpa,
        upstream_kpa: None,
        coolant_c: y.coolant_c,
        cams_deg: None,
        lambda: lambda.then_some(y.lambda),
    }
}

/// Ours: fuel by the identified policy; throttle and spark by the map.
pub(super) struct Ours<'a> {
    base: Mapped<'a>,
    policy: FuelPolicy,
    /// Whether it is shown what the lambda sensor shows.
    trimmed: bool,
    /// Shares by which it moves its fuel, and the sample that is next; none: lambda stays at its demand.
    moved: Vec<f64>,
    at: usize,
}

impl<'a> Ours<'a> {
    pub(super) fn new(base: Mapped<'a>, policy: FuelPolicy, trimmed: bool) -> Self {
        Self { base, policy, trimmed, moved: Vec::new(), at: 0 }
    }

    /// The same with fuel that is moved by shares, sample by sample.
    pub(super) fn moving(self, moved: Vec<f64>) -> Self {
        Self { moved, ..self }
    }
}

impl Controller for Ours<'_> {
    fn step(&mut self, torque_nm: f64, y: &Measured) -> Command {
        let u = self.base.step(torque_nm, y);
        let lambda = 1.0 / (1.0 + self.moved.get(self.at).unwrap_or(&0.0));
        self.at += 1;
        let injection_mg =
            self.policy.step(&sensed(y, self.base.speed.now_rpm, u.throttle_deg, self.trimmed), lambda);
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

#[cfg(test)]
mod tests {
    use super::*;

    /// On a ramp the speed of the sample that begins is known; at rest it is what is measured.
    #[test]
    fn a_ramp_goes_on() {
        let mut now = SpeedNow::default();
        let known: Vec<f64> =
            [1000.0, 1000.0, 1010.0, 1020.0, 1020.0, 1020.0].iter().map(|v| now.step(*v)).collect();
        assert_eq!(known, [1000.0, 1000.0, 1020.0, 1030.0, 1020.0, 1020.0]);
    }
}
