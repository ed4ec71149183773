//! Model in the loop: car, driver and engine along a speed cycle, fuel by a static map or by measured air, each without and
//! with feedback of lambda; a catalyst behind the engine.
//!
//! Map and grid are measured on the engine as it is, and drive engines that are like it. The sensor of lambda sees the gas of a
//! cycle after a transport that goes with one over the flow, through a lag; the controllers know both only as nominal values.

use std::collections::VecDeque;

use dynocal_control::oxygen::{OxygenObserver, OxygenSettings};
use dynocal_control::predictor::{PredictedModel, Predictor};
use dynocal_control::runtime::{ActuatorLimits, Pid, PidGains};
use dynocal_control::system::Transfer;
use dynocal_control::trim::LongTrim;
use dynocal_control::tune::{Lag, simc};
use dynocal_plant::engine::VirtualEngine;
use dynocal_plant::inputs::Inputs;
use dynocal_plant::params::EngineParams;
use dynocal_plant::statics::{SettleOptions, Target, settle};
use dynocal_plant::testbed::catalyst::{CatalystSettings, CatalystState, Feed};
use dynocal_plant::vehicle::{Car, DriveCycle, DriveOptions, Power, PowerSource, SteadyGrid, drive};
use serde::{Deserialize, Serialize};

/// Speeds of the maps in rpm, and torques a speed.
const SPEEDS_RPM: [f64; 7] = [800.0, 1200.0, 1700.0, 2300.0, 3000.0, 3800.0, 4600.0];
const TORQUES: usize = 6;
/// Step of car, engine and controllers in s.
const STEP_S: f64 = 0.02;
/// Transport of the gas: volume as mass in g, and a constant part in s; lag of the sensor in s.
const TRANSPORT: (f64, f64) = (0.9, 0.05);
const SENSOR_S: f64 = 0.06;
/// What the controllers take for lag and dead time of the loop without its transport, and with a usual one, in s.
const LOOP_S: (f64, f64, f64) = (0.1, 0.08, 0.3);
/// Distance of lambda from 1 that counts.
const NEAR: f64 = 0.01;
/// Memory of the long-term trim in s.
const MEMORY_S: f64 = 20.0;

/// How fuel is given.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub(super) struct Fuelled {
    /// By the air of the last cycle, as an ECU does; else by the map of demand and speed.
    pub(super) by_air: bool,
    pub(super) feedback: Hold,
}

/// What holds lambda.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub(super) enum Hold {
    Nothing,
    Pi,
    PiTrim,
    Smith,
    SmithRear,
}

/// All that are compared, with their names.
pub(super) const FUELLED: [(&str, Fuelled); 7] = [
    ("static map", Fuelled { by_air: false, feedback: Hold::Nothing }),
    ("static map, PI", Fuelled { by_air: false, feedback: Hold::Pi }),
    ("static map, PI, long-term trim", Fuelled { by_air: false, feedback: Hold::PiTrim }),
    ("measured air", Fuelled { by_air: true, feedback: Hold::Nothing }),
    ("measured air, PI", Fuelled { by_air: true, feedback: Hold::Pi }),
    ("measured air, Smith predictor", Fuelled { by_air: true, feedback: Hold::Smith }),
    ("measured air, Smith predictor, rear trim", Fuelled { by_air: true, feedback: Hold::SmithRear }),
];

/// A drive.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub(super) struct Driven {
    pub(super) name: String,
    pub(super) fuel_g: f64,
    /// Share of the fuelled time with lambda within 1 %.
    pub(super) within: f64,
    /// Root of the mean squared distance of the torque from its demand, in Nm, where torque is asked for.
    pub(super) torque_nm: f64,
    /// Share of the fuelled time with lambda behind the catalyst outside of 1 %, and how often it left it.
    pub(super) broken: f64,
    pub(super) breaks: u32,
    /// Carbon monoxide and nitric oxide that leave the catalyst if it converts none while it is broken through that way, in g:
    /// rich for the first, lean for the second.
    pub(super) rich_lean: [f64; 2],
    /// Steps outside of the tolerance of the cycle.
    pub(super) outside: usize,
}

/// All drives of one engine along the cycle.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub(super) struct CycleCase {
    pub(super) cycle: String,
    pub(super) driven_engine: String,
    pub(super) length_s: f64,
    pub(super) drives: Vec<Driven>,
}

/// Fuel of the steady points, mg, by speed and share of the grid's torque.
struct FuelMap {
    torque_nm: Vec<Vec<f64>>,
    fuel_mg: Vec<Vec<f64>>,
}

impl FuelMap {
    fn measure(engine: &VirtualEngine, grid: &SteadyGrid) -> Result<Self, String> {
        let mut out = Self { torque_nm: Vec::new(), fuel_mg: Vec::new() };
        for speed_rpm in SPEEDS_RPM {
            let most = grid.limits_nm(speed_rpm).1;
            let (mut torques, mut fuels) = (Vec::new(), Vec::new());
            let mut own = engine.clone();
            let start = Inputs { speed_rpm, throttle_deg: 16.0, injection_mg: 16.7, ..own.state().inputs };
            own.set_inputs(start).map_err(|e| e.to_string())?;
            for k in 0..TORQUES {
                let torque_nm = most * k as f64 / (TORQUES - 1) as f64;
                let spark = grid.actuators_deg(speed_rpm, torque_nm).1;
                let options = SettleOptions { torque_nm: 0.2, lambda: 1e-3, limit_s: 12.0 };
                // Points that the engine does not hold are left out.
                if let Ok(p) = settle(&mut own, Target { speed_rpm, torque_nm, lambda: 1.0 }, spark, options)
                {
                    torques.push(torque_nm);
                    fuels.push(p.inputs.injection_mg);
                }
            }
            if torques.len() < 2 {
                return Err(format!("the engine holds fewer than two torques at {speed_rpm} rpm"));
            }
            out.torque_nm.push(torques);
            out.fuel_mg.push(fuels);
        }
        Ok(out)
    }

    fn at(&self, speed_rpm: f64, torque_nm: f64) -> f64 {
        let row = |k: usize| {
            let (x, y) = (&self.torque_nm[k], &self.fuel_mg[k]);
            let i = x.partition_point(|v| *v <= torque_nm).clamp(1, x.len() - 1);
            y[i - 1] + (torque_nm - x[i - 1]) / (x[i] - x[i - 1]) * (y[i] - y[i - 1])
        };
        let i = SPEEDS_RPM.partition_point(|v| *v <= speed_rpm).clamp(1, SPEEDS_RPM.len() - 1);
        let share = ((speed_rpm - SPEEDS_RPM[i - 1]) / (SPEEDS_RPM[i] - SPEEDS_RPM[i - 1])).clamp(0.0, 1.0);
        (row(i - 1) + share * (row(i) - row(i - 1))).clamp(1.0, 120.0)
    }
}

/// What holds lambda, running.
enum Loop {
    Nothing,
    Pi(Pid),
    Smith(Box<Predictor>),
}

/// The engine in the car.
struct Source<'a> {
    engine: VirtualEngine,
    grid: &'a SteadyGrid,
    fuel: &'a FuelMap,
    fuelled: Fuelled,
    hold: Loop,
    trim: LongTrim,
    rear: OxygenObserver,
    catalyst: (CatalystSettings, CatalystState),
    /// Lambda on its way, latest last, and what the sensor shows.
    line: VecDeque<f64>,
    shown: f64,
    trim_nm: f64,
    cut: bool,
    /// Deviation of lambda that the rear trim asks for, demand of the last step.
    asked: f64,
    last_nm: f64,
    told: Told,
}

/// Sums of a drive.
#[derive(Default)]
struct Told {
    fuelled: f64,
    near: f64,
    torque: (f64, f64),
    broken: f64,
    breaks: u32,
    out: bool,
    rich_lean: [f64; 2],
}

impl<'a> Source<'a> {
    fn new(
        engine: &VirtualEngine,
        grid: &'a SteadyGrid,
        fuel: &'a FuelMap,
        fuelled: Fuelled,
    ) -> Result<Self, String> {
        let text = |e: dynocal_control::error::ControlError| e.to_string();
        let limits = ActuatorLimits { lower: -0.25, upper: 0.25, rate_per_s: None };
        let gains = |dead_s: f64| -> PidGains { simc(&Lag { gain: -1.0, lag_s: LOOP_S.0, dead_s }, None) };
        let a = (-STEP_S / LOOP_S.0).exp();
        let known = PredictedModel {
            model: Transfer::sampled(&[0.0, -(1.0 - a)], &[1.0, -a]),
            delay_samples: 10.0,
            longest_samples: 100,
            filter_s: 0.0,
        };
        let hold = match fuelled.feedback {
            Hold::Nothing => Loop::Nothing,
            Hold::Pi | Hold::PiTrim => {
                Loop::Pi(Pid::new(gains(LOOP_S.2), limits, STEP_S, 0.0).map_err(text)?)
            }
            Hold::Smith | Hold::SmithRear => {
                let c = Predictor::new(gains(LOOP_S.1), limits, STEP_S, 0.0, &known).map_err(text)?;
                Loop::Smith(Box::new(c))
            }
        };
        let torques: Vec<f64> = (0..6).map(|k| 30.0 * k as f64).collect();
        let c = CatalystSettings::default();
        let store = OxygenSettings {
            // What a workshop would know of it: half of the store that is built in, at no flow.
            capacity_g: 0.5 * c.oxygen_g,
            half_g_s: c.oxygen_half_g_s,
            rear_band: NEAR,
            target: 0.5,
            gain: 0.02,
            most: 0.01,
            learn: 0.2,
            memory: 0.0,
        };
        Ok(Self {
            engine: engine.clone(),
            grid,
            fuel,
            fuelled,
            hold,
            trim: LongTrim::new(vec![SPEEDS_RPM.to_vec(), torques], MEMORY_S, 0.25).map_err(text)?,
            rear: OxygenObserver::new(store, 0.5).map_err(text)?,
            catalyst: (c, c.start()),
            line: VecDeque::with_capacity(128),
            shown: 1.0,
            trim_nm: 0.0,
            cut: false,
            asked: 0.0,
            last_nm: 0.0,
            told: Told::default(),
        })
    }

    /// Fuel as the sum of what is known ahead and what feedback adds.
    fn injection_mg(&mut self, demand_nm: f64, speed_rpm: f64, air_g_s: f64) -> f64 {
        let air_mg = 1e3 * air_g_s * 120.0 / speed_rpm / 4.0;
        let base = match self.fuelled.by_air {
            true => air_mg / self.engine.params().gas.afr_stoich,
            false => self.fuel.at(speed_rpm, demand_nm),
        };
        let point = [speed_rpm, demand_nm];
        let long = if self.fuelled.feedback == Hold::PiTrim { self.trim.at(&point) } else { 0.0 };
        let short = match &mut self.hold {
            Loop::Nothing => 0.0,
            Loop::Pi(c) => c.step(0.0, self.asked - (self.shown - 1.0)),
            Loop::Smith(c) => {
                let delay_s = TRANSPORT.1 + TRANSPORT.0 / air_g_s.max(1.0) + LOOP_S.1;
                c.set_delay(delay_s / STEP_S);
                c.step(0.0, self.asked, self.shown - 1.0)
            }
        };
        // Learnt where the demand stands still: elsewhere the map is not to blame.
        if self.fuelled.feedback == Hold::PiTrim && (demand_nm - self.last_nm).abs() < 20.0 * STEP_S {
            let taken = self.trim.learn(&point, short, STEP_S);
            if let Loop::Pi(c) = &mut self.hold {
                let mut s = c.state();
                s.integral -= taken;
                c.restore(s);
            }
        }
        self.last_nm = demand_nm;
        (base * (1.0 + long + short)).clamp(0.0, 120.0)
    }

    /// Sensor, catalyst and sums after a step.
    fn after(&mut self, demand_nm: f64, fuelled: bool) {
        let y = self.engine.outputs();
        let lambda = if fuelled { y.lambda_cycle.clamp(0.5, 3.0) } else { 3.0 };
        self.line.push_back(lambda);
        let delay = ((TRANSPORT.1 + TRANSPORT.0 / y.air_g_s.max(1.0)) / STEP_S) as usize;
        while self.line.len() > delay.min(100) + 1 {
            self.line.pop_front();
        }
        let seen = self.line.front().copied().unwrap_or(1.0);
        self.shown += -(-STEP_S / SENSOR_S).exp_m1() * (seen - self.shown);
        let afr = self.engine.params().gas.afr_stoich;
        let feed = Feed {
            gas_g: y.air_g_s.max(0.0) * STEP_S * (1.0 + 1.0 / (afr * lambda)),
            gas_k: y.exhaust_k,
            lambda,
            afr,
            unburned_j_g: Feed::unburned_of(y.co_pct, y.hc_ppm),
        };
        let (settings, state) = &mut self.catalyst;
        settings.step(state, &feed, STEP_S);
        let behind = state.lambda;
        if self.fuelled.feedback == Hold::SmithRear && fuelled {
            self.asked = self.rear.step(self.shown, behind, y.air_g_s, STEP_S);
        }
        if !fuelled {
            return;
        }
        let t = &mut self.told;
        t.fuelled += STEP_S;
        t.near += if (lambda - 1.0).abs() <= NEAR { STEP_S } else { 0.0 };
        if demand_nm > 0.0 {
            t.torque.0 += (y.torque_cycle_nm - demand_nm).powi(2);
            t.torque.1 += 1.0;
        }
        let out = (behind - 1.0).abs() > NEAR;
        t.broken += if out { STEP_S } else { 0.0 };
        t.breaks += u32::from(out && !t.out);
        t.out = out;
        // Volume shares by the molar masses over that of the exhaust, 28.8 g/mol.
        let share = [y.co_pct * 1e-2 * 28.0 / 28.8, y.no_ppm * 1e-6 * 30.0 / 28.8];
        if out {
            let k = usize::from(behind > 1.0);
            t.rich_lean[k] += if share[k].is_finite() { share[k] * feed.gas_g } else { 0.0 };
        }
    }
}

impl PowerSource for Source<'_> {
    fn limits_nm(&self, speed_rpm: f64) -> (f64, f64) {
        self.grid.limits_nm(speed_rpm)
    }

    fn step(
        &mut self,
        demand_nm: f64,
        speed_rpm: f64,
        dt_s: f64,
    ) -> Result<Power, dynocal_plant::error::PlantError> {
        let y = self.engine.outputs();
        // Overrun: no fuel, with some room between off and on.
        self.cut = demand_nm < -5.0 && speed_rpm > 1200.0 + if self.cut { 0.0 } else { 200.0 };
        let now = Inputs { speed_rpm, ..self.engine.state().inputs };
        let most = self.grid.limits_nm(speed_rpm).1;
        let demand = demand_nm.clamp(0.0, most);
        let inputs = if self.cut {
            self.trim_nm = 0.0;
            Inputs { throttle_deg: 1.0, injection_mg: 0.0, ..now }
        } else {
            if self.fuelled.feedback != Hold::Nothing {
                self.trim_nm = (self.trim_nm + 0.8 * dt_s * (demand - y.torque_cycle_nm)).clamp(-20.0, 20.0);
            }
            let (throttle_deg, spark_deg) =
                self.grid.actuators_deg(speed_rpm, (demand + self.trim_nm).clamp(-20.0, most.max(0.0)));
            let injection_mg = self.injection_mg(demand, speed_rpm, y.air_g_s);
            Inputs { throttle_deg, spark_deg, injection_mg, ..now }
        };
        self.engine.set_inputs(inputs)?;
        self.engine.clear_interval();
        self.engine.advance_time(dt_s);
        self.engine.check_state()?;
        self.after(if self.cut { 0.0 } else { demand }, inputs.injection_mg > 0.0);
        let y = self.engine.outputs();
        let lambda = if inputs.injection_mg > 0.0 { y.lambda_cycle } else { f64::NAN };
        Ok(Power {
            torque_nm: y.torque_cycle_nm,
            fuel_kg_h: y.fuel_kg_h,
            lambda,
            throttle_deg: inputs.throttle_deg,
            spark_deg: inputs.spark_deg,
            inj_mg: inputs.injection_mg,
        })
    }
}

/// All controllers along the cycle on an engine, maps from the engine `mapped`.
pub(super) fn contest(
    mapped: &str,
    driven: &str,
    name: &str,
    cycle: &DriveCycle,
    stop: &dyn Fn() -> bool,
) -> Result<CycleCase, String> {
    let engine = |set: &str| -> Result<VirtualEngine, String> {
        let params = EngineParams::named(set).map_err(|e| e.to_string())?;
        VirtualEngine::new(&params).map_err(|e| e.to_string())
    };
    let own = engine(mapped)?;
    let grid = SteadyGrid::measure(&own, &SPEEDS_RPM, TORQUES).map_err(|e| e.to_string())?;
    let fuel = FuelMap::measure(&own, &grid)?;
    let other = engine(driven)?;
    let mut drives = Vec::new();
    for (title, fuelled) in FUELLED {
        let mut source = Source::new(&other, &grid, &fuel, fuelled)?;
        let options = DriveOptions { step_s: STEP_S, ..DriveOptions::default() };
        let log =
            drive(&Car::thesis(), cycle, &mut source, options, stop).map_err(|e| format!("{title}: {e}"))?;
        if stop() {
            return Err("interrupted".into());
        }
        let t = &source.told;
        drives.push(Driven {
            name: title.into(),
            fuel_g: log.fuel_g,
            within: t.near / t.fuelled.max(STEP_S),
            torque_nm: (t.torque.0 / t.torque.1.max(1.0)).sqrt(),
            broken: t.broken / t.fuelled.max(STEP_S),
            breaks: t.breaks,
            rich_lean: t.rich_lean,
            outside: log.outside,
        });
    }
    Ok(CycleCase { cycle: name.into(), driven_engine: driven.into(), length_s: cycle.duration_s(), drives })
}
