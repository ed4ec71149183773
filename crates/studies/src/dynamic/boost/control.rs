//! Controllers of the boosted engine: one air path for all, in which ours has two more rules, and what gives the fuel.

use std::collections::VecDeque;

use dynocal_calib::fuelling::{Filling, FuelPolicy, Sensed, SpeedDensityState};

use super::super::bed::SAMPLE_S;
use super::bed::{Command, Controller, Shown};
use super::steady::{Of, Steady};

/// Throttle wide open in deg.
const OPEN_DEG: f64 = 90.0;
/// Manifold pressures that the throttle alone can make, in kPa, and distance from that before it below which it is opened.
const UNBOOSTED_KPA: f64 = 95.0;
const DROP_KPA: f64 = 1.5;
/// Share of the demanded torque below which the wastegate is shut.
const FAR: f64 = 0.9;
/// Wastegate per error of boost, in mm/kPa, and per second; widest.
const WASTEGATE: (f64, f64) = (0.1, 0.1);
const WIDEST_MM: f64 = 28.0;
/// Corrections of flow (by pressure) and of torque (by its sensor), per second, and their most.
const FLOW_PER_S: (f64, f64) = (1.0, 0.2);
const TORQUE_PER_S: (f64, f64) = (0.4, 0.1);
/// Boost that is missing at which the cams are wholly where they build it, in kPa.
const BUILD_KPA: f64 = 20.0;
/// Pressures, measured or asked for, between which the retard against knock comes, in kPa.
const RETARD_KPA: (f64, f64) = (90.0, 130.0);
/// Integral of the first driver's lambda loop per s, and its most.
const LOOP_PER_S: (f64, f64) = (0.7, 0.3);

/// What the searches on the bed set.
#[derive(Clone, Copy, Debug, PartialEq, serde::Serialize, serde::Deserialize)]
pub(super) struct Setting {
    /// Taken from the spark of the steady map where the engine is boosted, in deg.
    pub(super) retard_deg: f64,
    /// Wastegate while no boost is asked for, in mm; none: by its steady map.
    pub(super) rest_mm: Option<f64>,
    /// Added to the cams of the load schedule while boost is missing, in deg.
    pub(super) build_deg: [f64; 2],
}

/// As a production ECU is set, before its retard is found.
pub(super) const PRODUCTION: Setting = Setting { retard_deg: 0.0, rest_mm: None, build_deg: [0.0, 0.0] };

/// Throttle, wastegate, cams and spark by demand and measured load.
#[derive(Clone)]
pub(super) struct Path<'a> {
    steady: &'a Steady,
    /// Throttle as it was identified; none before that: by the steady map.
    filling: Option<&'a Filling>,
    setting: Setting,
    wastegate: f64,
    flow: f64,
    torque: f64,
}

impl<'a> Path<'a> {
    pub(super) fn new(steady: &'a Steady, filling: Option<&'a Filling>, setting: Setting) -> Self {
        Self { steady, filling, setting, wastegate: 0.0, flow: 0.0, torque: 0.0 }
    }

    /// Everything but the fuel.
    fn step(&mut self, demand_nm: f64, y: &Shown) -> Command {
        let (s, n) = (self.steady, y.speed_rpm);
        let error = (demand_nm - y.torque_nm) / demand_nm.max(1.0);
        if error.abs() < 1.0 - FAR {
            let step = TORQUE_PER_S.0 * error * SAMPLE_S;
            self.torque = (self.torque + step).clamp(-TORQUE_PER_S.1, TORQUE_PER_S.1);
        }
        let asked_nm = demand_nm * (1.0 + self.torque);
        let by_torque = |of: Of| s.at(of, Of::Torque, asked_nm, n);
        let load_nm = s.at(Of::Torque, Of::Map, y.map_kpa, n);
        let wanted_kpa = by_torque(Of::Map);
        let missing_kpa = by_torque(Of::Boost) - y.boost_kpa;
        let boosted = wanted_kpa > UNBOOSTED_KPA;
        let wastegate_mm =
            self.wastegate(boosted, load_nm < FAR * demand_nm, by_torque(Of::Wastegate), missing_kpa);
        let build = if boosted { (missing_kpa / BUILD_KPA).clamp(0.0, 1.0) } else { 0.0 };
        let schedule = s.cams_deg(n, y.map_kpa);
        // From the pedal on: the cycle that the spark is for has more air than the pressure that it is read at says.
        let load_kpa = y.map_kpa.max(wanted_kpa);
        let ramp = ((load_kpa - RETARD_KPA.0) / (RETARD_KPA.1 - RETARD_KPA.0)).clamp(0.0, 1.0);
        Command {
            injection_mg: 0.0,
            spark_deg: s.at(Of::Spark, Of::Map, y.map_kpa, n) - self.setting.retard_deg * ramp,
            throttle_deg: self.throttle(
                by_torque(Of::Fuel) * n / 120.0,
                wanted_kpa,
                by_torque(Of::Throttle),
                y,
            ),
            wastegate_mm,
            cams_deg: [0, 1].map(|k| schedule[k] + build * self.setting.build_deg[k]),
        }
    }

    fn wastegate(&mut self, boosted: bool, far: bool, by_map_mm: f64, missing_kpa: f64) -> f64 {
        if !boosted {
            self.wastegate = 0.0;
            return self.setting.rest_mm.unwrap_or(by_map_mm);
        }
        if far {
            return 0.0;
        }
        let step = WASTEGATE.1 * missing_kpa * SAMPLE_S;
        self.wastegate = (self.wastegate + step).clamp(-0.3 * WIDEST_MM, 0.3 * WIDEST_MM);
        (by_map_mm - self.wastegate - WASTEGATE.0 * missing_kpa).clamp(0.0, WIDEST_MM)
    }

    /// The angle that lets the flow of the demand through at its pressure, by the measured pressure before the throttle.
    fn throttle(&mut self, flow: f64, wanted_kpa: f64, by_map_deg: f64, y: &Shown) -> f64 {
        let Some(filling) = self.filling else {
            return by_map_deg;
        };
        let asked = flow * (1.0 + self.flow);
        let behind_kpa = wanted_kpa.min(y.boost_kpa - DROP_KPA);
        let open =
            wanted_kpa > y.boost_kpa - DROP_KPA || filling.inflow(OPEN_DEG, behind_kpa, y.boost_kpa) <= asked;
        if open {
            return OPEN_DEG;
        }
        let step = FLOW_PER_S.0 * (wanted_kpa - y.map_kpa) / wanted_kpa * SAMPLE_S;
        self.flow = (self.flow + step).clamp(-FLOW_PER_S.1, FLOW_PER_S.1);
        let (mut low, mut high) = (0.0, OPEN_DEG);
        for _ in 0..24 {
            let middle = 0.5 * (low + high);
            if filling.inflow(middle, behind_kpa, y.boost_kpa) < asked { low = middle } else { high = middle }
        }
        high
    }
}

/// What gives the fuel.
pub(super) enum Fuel {
    /// The steady map over the measured pressure with a slow lambda loop: what can be driven before anything is identified.
    First {
        factor: f64,
    },
    /// The steady map over the demand, behind a lag of `lag_s` at 2000 rpm (0: none) that goes with the cycle.
    Demand {
        lag_s: f64,
        behind: Option<f64>,
    },
    Ecu(Box<SpeedDensityState>),
    /// Fuel that was learned, sample by sample.
    Played {
        injection_mg: Vec<f64>,
        at: usize,
    },
    /// The identified policy; with what the lambda sensor shows, or without it.
    Policy {
        policy: Box<FuelPolicy>,
        trimmed: bool,
    },
}

/// An air path with its fuel.
pub(super) struct Driver<'a> {
    pub(super) path: Path<'a>,
    pub(super) fuel: Fuel,
    /// Commands of the throttle that wait, so that the fuel for their air is injected before it comes; as many as samples of waiting.
    pub(super) waiting: VecDeque<f64>,
}

impl Controller for Driver<'_> {
    fn step(&mut self, torque_nm: f64, y: &Shown) -> Command {
        let u = self.path.step(torque_nm, y);
        let (steady, n) = (self.path.steady, y.speed_rpm);
        let sensed = |lambda: bool| Sensed {
            speed_rpm: n,
            throttle_deg: u.throttle_deg,
            map_kpa: y.map_kpa,
            upstream_kpa: Some(y.boost_kpa),
            coolant_c: y.coolant_c,
            cams_deg: Some(y.cams_deg),
            lambda: lambda.then_some(y.lambda),
        };
        let injection_mg = match &mut self.fuel {
            Fuel::First { factor } => {
                let step = LOOP_PER_S.0 * (y.lambda - 1.0).clamp(-0.2, 0.2) * SAMPLE_S;
                *factor = (*factor + step).clamp(-LOOP_PER_S.1, LOOP_PER_S.1);
                steady.at(Of::Fuel, Of::Map, y.map_kpa, n) * (1.0 + *factor)
            }
            Fuel::Demand { lag_s, behind } => {
                let asked = steady.at(Of::Fuel, Of::Torque, torque_nm, n);
                let tau_s = *lag_s * 2000.0 / n;
                let follow = if tau_s > 0.0 { -(-SAMPLE_S / tau_s).exp_m1() } else { 1.0 };
                let behind = behind.get_or_insert(asked);
                *behind += follow * (asked - *behind);
                *behind
            }
            Fuel::Played { injection_mg, at } => {
                *at += 1;
                injection_mg[(*at - 1).min(injection_mg.len() - 1)]
            }
            Fuel::Ecu(ecu) => ecu.step(&sensed(true), 1.0),
            Fuel::Policy { policy, trimmed } => policy.step(&sensed(*trimmed), 1.0),
        };
        self.waiting.push_back(u.throttle_deg);
        let throttle_deg = self.waiting.pop_front().unwrap_or(u.throttle_deg);
        Command { injection_mg, throttle_deg, ..u }
    }
}
