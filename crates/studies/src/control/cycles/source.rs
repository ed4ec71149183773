//! The engine in the car, with what gives its fuel.

use dynocal_calib::fuelling::{Adaptation, FuelPolicy, Fuelling, Sensed, SpeedDensity, SpeedDensityState};
use dynocal_control::oxygen::{OxygenObserver, OxygenSettings};
use dynocal_control::predictor::{PredictedModel, Predictor};
use dynocal_control::runtime::{ActuatorLimits, Pid, PidGains};
use dynocal_control::system::Transfer;
use dynocal_control::trim::LongTrim;
use dynocal_control::tune::{Lag, simc};
use dynocal_plant::engine::VirtualEngine;
use dynocal_plant::error::PlantError;
use dynocal_plant::inputs::Inputs;
use dynocal_plant::testbed::catalyst::{CatalystSettings, CatalystState, Feed};
use dynocal_plant::vehicle::{Power, PowerSource};

use super::known::{Known, boost_kpa};
use super::sensor::{LONGEST, LambdaSensor, transport_s};
use super::{FuelBy, Hold, MOST_MG, NEAR, SPEEDS_RPM, STEP_S};

/// What the loops take for lag and dead time without the transport, and with a usual one, in s.
const LOOP_S: (f64, f64, f64) = (0.1, 0.08, 0.3);
/// Memory of the long-term trim in s.
const MEMORY_S: f64 = 20.0;
/// Molar masses of carbon monoxide, of what hydrocarbons are counted as (per atom of carbon) and of nitric oxide over that of the
/// exhaust, 28.8 g/mol.
const MASSES: [f64; 3] = [28.0 / 28.8, 13.9 / 28.8, 30.0 / 28.8];

/// What gives the fuel, running.
enum Fuel {
    Map,
    Air,
    Dynamic(Box<FuelPolicy>),
    Ecu(Box<SpeedDensityState>),
}

/// What holds lambda beside it, running.
enum Loop {
    Nothing,
    Pi(Pid),
    Smith(Box<Predictor>),
}

/// Sums of a drive.
#[derive(Default)]
pub(super) struct Told {
    pub(super) fuelled: f64,
    pub(super) near: f64,
    pub(super) off: f64,
    pub(super) torque: (f64, f64),
    pub(super) broken: f64,
    pub(super) breaks: u32,
    out: bool,
    pub(super) tailpipe_g: [f64; 3],
}

/// The engine in the car.
pub(super) struct Source<'a> {
    engine: VirtualEngine,
    known: &'a Known,
    hold: Hold,
    fuel: Fuel,
    beside: Loop,
    trim: LongTrim,
    rear: OxygenObserver,
    catalyst: (CatalystSettings, CatalystState),
    sensor: LambdaSensor,
    trim_nm: f64,
    cut: bool,
    /// Deviation of lambda that the rear trim asks for, demand of the last step.
    asked: f64,
    last_nm: f64,
    /// Air that the fuel of the last steps burns, in g/s, through the lag of the loops: film compensation is no flow.
    carried_g_s: f64,
    pub(super) told: Told,
}

fn beside(hold: Hold) -> Result<Loop, String> {
    let text = |e: dynocal_control::error::ControlError| e.to_string();
    let limits = ActuatorLimits { lower: -0.25, upper: 0.25, rate_per_s: None };
    let gains = |dead_s: f64| -> PidGains { simc(&Lag { gain: -1.0, lag_s: LOOP_S.0, dead_s }, None) };
    let a = (-STEP_S / LOOP_S.0).exp();
    let known = PredictedModel {
        model: Transfer::sampled(&[0.0, -(1.0 - a)], &[1.0, -a]),
        delay_samples: 10.0,
        longest_samples: LONGEST,
        filter_s: 0.0,
        flow: None,
    };
    Ok(match hold {
        Hold::Pi | Hold::PiTrim => Loop::Pi(Pid::new(gains(LOOP_S.2), limits, STEP_S, 0.0).map_err(text)?),
        Hold::Smith | Hold::SmithTrim | Hold::AdaptSmith => {
            let c = Predictor::new(gains(LOOP_S.1), limits, STEP_S, 0.0, &known).map_err(text)?;
            Loop::Smith(Box::new(c))
        }
        Hold::Nothing | Hold::Trim | Hold::Adapt | Hold::Loop | Hold::LoopRear => Loop::Nothing,
    })
}

impl<'a> Source<'a> {
    pub(super) fn new(
        engine: &VirtualEngine,
        known: &'a Known,
        (by, hold): (FuelBy, Hold),
    ) -> Result<Self, String> {
        let text = |e: dynocal_control::error::ControlError| e.to_string();
        let looped = matches!(hold, Hold::Loop | Hold::LoopRear);
        let fuel = match by {
            FuelBy::Map => Fuel::Map,
            FuelBy::Air => Fuel::Air,
            FuelBy::Dynamic => {
                let policy = FuelPolicy::new(known.fuelling.clone(), MOST_MG);
                let policy = match hold {
                    Hold::Loop | Hold::LoopRear => policy.with_feedback(known.feedback),
                    Hold::Adapt => policy.adapting(Adaptation::default()),
                    Hold::AdaptSmith => {
                        let untrimmed = Fuelling { trim: None, ..known.fuelling.clone() };
                        FuelPolicy::new(untrimmed, MOST_MG).adapting(Adaptation::default())
                    }
                    _ => policy,
                };
                Fuel::Dynamic(Box::new(policy))
            }
            FuelBy::Ecu => {
                let feedback = known.ecu.feedback.filter(|_| looped);
                let ecu = SpeedDensity { feedback, ..known.ecu.clone() };
                Fuel::Ecu(Box::new(SpeedDensityState::new(ecu, MOST_MG)))
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
            known,
            hold,
            fuel,
            beside: beside(hold)?,
            trim: LongTrim::new(vec![SPEEDS_RPM.to_vec(), torques], MEMORY_S, 0.25).map_err(text)?,
            rear: OxygenObserver::new(store, 0.5).map_err(text)?,
            catalyst: (c, c.start()),
            sensor: LambdaSensor::at_rest(),
            trim_nm: 0.0,
            cut: false,
            asked: 0.0,
            last_nm: 0.0,
            carried_g_s: engine.outputs().air_g_s,
            told: Told::default(),
        })
    }

    /// Fuel of a step at what is sensed, demand in Nm.
    fn injection_mg(&mut self, y: &Sensed, demand_nm: f64, air_g_s: f64) -> f64 {
        let own =
            !matches!(self.hold, Hold::Nothing | Hold::Pi | Hold::PiTrim | Hold::Smith | Hold::SmithTrim);
        let shown = Sensed { lambda: y.lambda.filter(|_| own), ..*y };
        let point = [y.speed_rpm, demand_nm];
        let learns = matches!(self.hold, Hold::PiTrim | Hold::SmithTrim);
        let long = if learns { self.trim.at(&point) } else { 0.0 };
        let short = self.short(y.lambda, air_g_s);
        let most_mg = |mg: f64| (mg * (1.0 + long + short)).clamp(0.0, MOST_MG);
        // What a loop beside them adds goes through the film of those that know one.
        let wanted = (1.0 + self.asked) / (1.0 + long + short);
        let afr = self.engine.params().gas.afr_stoich;
        let mg = match &mut self.fuel {
            Fuel::Dynamic(policy) => policy.step(&shown, wanted),
            Fuel::Ecu(ecu) => ecu.step(&shown, wanted),
            Fuel::Air => most_mg(1e3 * air_g_s * 120.0 / y.speed_rpm / 4.0 / afr),
            Fuel::Map => most_mg(self.known.fuel.at(y.speed_rpm, demand_nm)),
        };
        let burns_g_s = 1e-3 * mg * afr * 4.0 * y.speed_rpm / 120.0;
        self.carried_g_s += (burns_g_s - self.carried_g_s) * STEP_S / LOOP_S.0;
        // Learnt where the demand stands still: elsewhere the map is not to blame.
        let still = (demand_nm - self.last_nm).abs() < 20.0 * STEP_S && y.lambda.is_some();
        if learns && still {
            let taken = self.trim.learn(&point, short, STEP_S);
            if let Loop::Pi(c) = &mut self.beside {
                let mut s = c.state();
                s.integral -= taken;
                c.restore(s);
            }
        }
        self.last_nm = demand_nm;
        mg
    }

    /// Share of fuel that a loop beside the map asks for.
    fn short(&mut self, lambda: Option<f64>, air_g_s: f64) -> f64 {
        let flow_g_s = if matches!(self.fuel, Fuel::Air) { air_g_s } else { self.carried_g_s };
        match (&mut self.beside, lambda) {
            (Loop::Nothing, _) => 0.0,
            (Loop::Pi(c), Some(lambda)) => c.step(0.0, -(lambda - 1.0)),
            // Gas of a cut tells nothing: the loop stays where it is.
            (Loop::Pi(c), None) => c.state().integral,
            (Loop::Smith(c), lambda) => {
                c.set_delay((transport_s(flow_g_s) + LOOP_S.1) / STEP_S);
                c.step(0.0, 0.0, lambda.map_or(f64::NAN, |l| l - 1.0))
            }
        }
    }

    /// Sensor, catalyst and sums after a step.
    fn after(&mut self, demand_nm: f64, fuelled: bool) {
        let y = self.engine.outputs();
        let lambda = self.sensor.pass(
            fuelled.then_some(y.lambda_cycle),
            y.air_g_s,
            self.engine.state().inputs.speed_rpm,
        );
        let afr = self.engine.params().gas.afr_stoich;
        let (unburned_j_g, heat_j_g_o2) = Feed::unburned_of(y.co_pct, y.hc_ppm);
        let feed = Feed {
            gas_g: y.air_g_s.max(0.0) * STEP_S * (1.0 + 1.0 / (afr * lambda)),
            gas_k: y.exhaust_k,
            lambda,
            afr,
            unburned_j_g,
            heat_j_g_o2,
        };
        let (settings, state) = &mut self.catalyst;
        settings.step(state, &feed, STEP_S);
        let (behind, conversion) = (state.lambda, state.conversion);
        if self.hold == Hold::LoopRear {
            // The air of a cut fills the store, and the sensors say so.
            self.asked = self.rear.step(self.sensor.shown(), behind, y.air_g_s, STEP_S);
        }
        if !fuelled {
            self.told.out = false;
            return;
        }
        let t = &mut self.told;
        t.fuelled += STEP_S;
        t.near += if (lambda - 1.0).abs() <= NEAR { STEP_S } else { 0.0 };
        t.off += (lambda - 1.0).abs() * STEP_S;
        if demand_nm > 0.0 {
            t.torque.0 += (y.torque_cycle_nm - demand_nm).powi(2);
            t.torque.1 += 1.0;
        }
        let out = (behind - 1.0).abs() > NEAR;
        t.broken += if out { STEP_S } else { 0.0 };
        t.breaks += u32::from(out && !t.out);
        t.out = out;
        // Carbon monoxide and hydrocarbons pass a store that is empty, nitric oxide one that is full.
        let shares = [y.co_pct * 1e-2, y.hc_ppm * 1e-6, y.no_ppm * 1e-6];
        let passes = [behind < 1.0 - NEAR, behind < 1.0 - NEAR, behind > 1.0 + NEAR];
        for k in 0..3 {
            let left = if passes[k] { 1.0 } else { 1.0 - conversion.clamp(0.0, 1.0) };
            let mass_g = shares[k] * MASSES[k] * feed.gas_g * left;
            t.tailpipe_g[k] += if mass_g.is_finite() { mass_g } else { 0.0 };
        }
    }
}

impl PowerSource for Source<'_> {
    fn limits_nm(&self, speed_rpm: f64) -> (f64, f64) {
        self.known.grid.limits_nm(speed_rpm)
    }

    fn step(&mut self, demand_nm: f64, speed_rpm: f64, dt_s: f64) -> Result<Power, PlantError> {
        let y = self.engine.outputs();
        // Overrun: no fuel, with some room between off and on.
        self.cut = demand_nm < -5.0 && speed_rpm > 1200.0 + if self.cut { 0.0 } else { 200.0 };
        let now = Inputs { speed_rpm, ..self.engine.state().inputs };
        let most = self.known.grid.limits_nm(speed_rpm).1;
        let demand = demand_nm.clamp(0.0, most);
        let mut sensed = Sensed {
            speed_rpm,
            throttle_deg: 1.0,
            map_kpa: y.map_kpa,
            upstream_kpa: boost_kpa(&self.engine),
            coolant_c: 0.0,
            cams_deg: None,
            lambda: self.sensor.lambda(),
        };
        let inputs = if self.cut {
            self.trim_nm = 0.0;
            sensed.lambda = None;
            match &mut self.fuel {
                Fuel::Dynamic(policy) => policy.cut(&sensed),
                Fuel::Ecu(ecu) => ecu.cut(&sensed),
                Fuel::Map | Fuel::Air => {}
            }
            Inputs { throttle_deg: 1.0, injection_mg: 0.0, ..now }
        } else {
            if self.hold != Hold::Nothing {
                self.trim_nm = (self.trim_nm + 0.8 * dt_s * (demand - y.torque_cycle_nm)).clamp(-20.0, 20.0);
            }
            let wanted = (demand + self.trim_nm).clamp(-20.0, most.max(0.0));
            let (throttle_deg, spark_deg) = self.known.grid.actuators_deg(speed_rpm, wanted);
            sensed.throttle_deg = throttle_deg;
            let injection_mg = self.injection_mg(&sensed, demand, y.air_g_s);
            Inputs { throttle_deg, spark_deg, injection_mg, ..now }
        };
        self.engine.set_inputs(inputs)?;
        self.engine.clear_interval();
        self.engine.advance_time(dt_s);
        self.engine.check_state()?;
        self.after(if self.cut { 0.0 } else { demand }, !self.cut);
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
