//! The test bed: the engine with dynamometer, actuators, sensors and limits behind the plant contract.

use super::bleed::equivalent_angle_deg;
use super::dynamics::Lag;
use super::dynamometer::DynoMode;
use super::guard::{Commands, Found, GuardState, Trip};
use super::idle::{IdleState, Shaft};
use super::inputs::{self, EXTRA};
use super::quantity::{self, QUANTITIES, Readings, STANDARD};
use super::sensor::{SensorSettings, quantise};
use super::start::BedSettings;
use super::state::BedState;
use super::variables::variables;
use crate::deviations::Deviations;
use crate::engine::VirtualEngine;
use crate::error::PlantError as EngineError;
use crate::inputs::Inputs;
use crate::params::EngineParams;
use crate::sensors::SensorNoise;
use crate::state::{EngineState, Ledger};
use dynocal_ident::plant::{LimitEvent, PlantError, Variable};

/// Inputs that every bed has.
const INPUTS: usize = 4;
/// Keeps the streams of the sensors apart from other uses of the seed.
const SENSORS: u64 = 0x5e05_0000_0000_0000;
/// Streams of one sample.
const CHANNELS: u64 = 64;
/// Time constant of a cam phaser that follows its schedule \[s\].
const PHASER_S: f64 = 0.3;
/// Time after fuel has returned from which lambda says something about the mixture \[s\].
const MIXTURE_S: f64 = 1.0;

/// Engine on a bed.
///
/// Inputs in this order: `inj` \[mg\], `spark` \[deg\], `throttle` \[deg\], `speed` \[rpm\], then those of
/// [`super::settings::BedOptions::inputs`] and `air_bleed` \[-\] where there is such a valve. With closed loops `lambda_demand` \[-\] stands in place of `inj` and `torque_demand` \[Nm\] in
/// place of `throttle`; in load mode `load` \[Nm\] in place of `speed`. Outputs: `torque` \[Nm\] (sensor: 720 deg mean and
/// lag), `lambda` \[-\] (mean over the step), `map` \[kPa\], `egt` \[K\], `fuel` \[kg/h\], then those of
/// [`super::settings::BedOptions::outputs`].
///
/// ```
/// use dynocal_ident::plant::Plant;
/// use dynocal_plant::{bed::{BedSettings, EngineBed}, params::EngineParams};
/// let mut bed = EngineBed::new(&EngineParams::thesis(), BedSettings::default())?;
/// let mut y = [0.0; 5];
/// for _ in 0..30 {
///     bed.step(&[16.754, 18.95, 15.85, 2000.0], 0.03, &mut y)?;
/// }
/// assert!((y[0] - 70.0).abs() < 0.5 && (y[1] - 1.0).abs() < 0.005);
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
#[derive(Debug, Clone)]
pub struct EngineBed {
    pub(super) engine: VirtualEngine,
    deviations: Deviations,
    pub(super) start: (EngineState, BedState),
    pub(super) settings: BedSettings,
    pub(super) variables: Vec<Variable>,
    /// Rows of the extra inputs, and of the quantities that are read.
    extra: Vec<usize>,
    outputs: Vec<usize>,
    sensors: Vec<SensorSettings>,
    /// Rows of the quantities of the limits.
    limits: Vec<usize>,
    pub(super) state: BedState,
    /// Inputs in force.
    held: Vec<f64>,
    pub(super) events: Vec<LimitEvent>,
    /// Trips, and for each limit the row of that which lasts.
    pub(super) trips: Vec<Trip>,
    tripped: Vec<usize>,
}

/// How far a step goes.
#[derive(Clone, Copy)]
pub(super) enum Span {
    Time(f64),
    Angle(f64),
}

impl EngineBed {
    /// Build the bed and settle the engine at the start inputs.
    ///
    /// # Errors
    /// Errors of the engine and of the options: parameters or start inputs out of range.
    pub fn new(params: &EngineParams, mut settings: BedSettings) -> Result<Self, EngineError> {
        settings.options.check()?;
        settings.options.engine = settings.options.engine.begun();
        let o = &settings.options;
        o.check_engine(&settings.set_name, params)?;
        let real = &o.engine;
        let mut deviations = Deviations { scatter: real.scatter, ..Deviations::default() };
        if real.fuel_imbalance > 0.0 || real.burn_imbalance > 0.0 {
            deviations =
                deviations.with_imbalance(real.cylinder_seed, real.fuel_imbalance, real.burn_imbalance);
        }
        deviations.octane = real.octane;
        deviations.fuel_share.iter_mut().for_each(|share| *share *= 1.0 + real.injector_error);
        let extra: Vec<usize> = o.inputs.iter().filter_map(|n| inputs::find(n)).collect();
        // A standard output that is asked for once more is there already.
        let beside = o.outputs.iter().filter_map(|n| quantity::find(n)).filter(|q| *q >= STANDARD);
        let outputs: Vec<usize> = (0..STANDARD).chain(beside).collect();
        let limits: Vec<usize> = o.limits.iter().filter_map(|l| quantity::find(&l.what)).collect();
        let sensors: Vec<SensorSettings> =
            outputs.iter().map(|&q| o.sensors.get(QUANTITIES[q].name).copied().unwrap_or_default()).collect();
        let u = settings.start;
        let inputs = INPUTS + extra.len() + usize::from(o.air_bleed.is_some());
        let state = BedState {
            time_s: 0.0,
            seed: 0,
            samples: 0,
            dyno: o.dynamometer.at(u.speed_rpm, 0.0),
            throttle: Lag::new(u.throttle_deg),
            wastegate: Lag::new(u.wastegate_mm),
            bleed: Lag::new(o.air_bleed.map_or(0.0, |b| b.start)),
            cams: [Lag::new(u.intake_mop_deg_btdc), Lag::new(u.exhaust_mop_deg_atdc)],
            integrals: [u.throttle_deg, u.injection_mg],
            sensors: Vec::new(),
            shown: Vec::new(),
            guards: vec![GuardState::default(); limits.len()],
            saturated: vec![false; inputs],
            fuelled_s: MIXTURE_S,
            idle: IdleState::default(),
            thermal: real.warm_up.map(|t| t.start()),
            catalyst: real.catalyst.map(|c| c.start()),
        };
        let engine = VirtualEngine::new(params)?;
        let mut bed = Self {
            start: (engine.snapshot(), state.clone()),
            engine,
            deviations,
            variables: Vec::new(),
            held: vec![0.0; inputs],
            extra,
            outputs,
            sensors,
            tripped: vec![usize::MAX; limits.len()],
            limits,
            state,
            events: Vec::new(),
            trips: Vec::new(),
            settings,
        };
        bed.settle()?;
        Ok(bed)
    }

    /// Settles the engine at the start inputs and takes the start state.
    fn settle(&mut self) -> Result<(), EngineError> {
        let settings = &self.settings;
        let mut u = settings.start;
        if let Some(b) = &settings.options.air_bleed {
            let throttle = &self.engine.params().throttle;
            let more_m2 = 1e-6 * b.open_mm2 * b.start;
            u.throttle_deg = equivalent_angle_deg(throttle, u.throttle_deg, more_m2);
        }
        self.engine.set_inputs(u)?;
        self.apply_deviations();
        self.engine.advance_time(self.settings.settle_s);
        self.engine.check_state()?;
        self.engine.clear_interval();
        let y = self.engine.outputs();
        let o = &self.settings.options;
        self.state.dyno = o.dynamometer.at(self.settings.start.speed_rpm, y.torque_cycle_nm);
        let readings = Readings { y: &y, engine: &self.engine, bed: &self.state, lambda: y.lambda };
        let values: Vec<f64> = self.outputs.iter().map(|&q| (QUANTITIES[q].value)(&readings)).collect();
        self.variables = variables(&self.settings, &self.extra, &self.outputs, &values);
        let tick_s = o.tick_s;
        self.state.sensors = self.sensors.iter().zip(&values).map(|(s, v)| s.at(*v, tick_s)).collect();
        self.state.shown = values;
        self.start = (self.engine.snapshot(), self.state.clone());
        Ok(())
    }

    /// The engine on the bed (read only: a bed must not be peeked into by a campaign).
    pub fn engine(&self) -> &VirtualEngine {
        &self.engine
    }

    /// Whether inputs outside their range are held at its end, in place of an error.
    pub fn saturates(&self) -> bool {
        self.settings.options.saturate
    }

    /// Trips since they were last taken, or since the reset, with their lengths: an event tells only that one begins.
    pub fn take_trips(&mut self) -> Vec<Trip> {
        self.tripped.fill(usize::MAX);
        std::mem::take(&mut self.trips)
    }

    /// What moves on the bed beside the engine (read only).
    pub fn bed_state(&self) -> &BedState {
        &self.state
    }

    /// As [`dynocal_ident::plant::Plant::step`], over a crank angle \[deg\] in place of a time: data are sampled each degree, stroke or cycle
    /// (thesis 3.3).
    ///
    /// # Errors
    /// As [`dynocal_ident::plant::Plant::step`].
    pub fn step_angle(
        &mut self,
        inputs: &[f64],
        angle_deg: f64,
        outputs: &mut [f64],
    ) -> Result<(), PlantError> {
        if !(angle_deg > 0.0 && angle_deg <= 36_000.0) {
            return Err(PlantError::Call(format!("sample angle {angle_deg} deg: expected 0..36000 deg")));
        }
        self.sample(inputs, Span::Angle(angle_deg), outputs)
    }

    fn check(&mut self, inputs: &[f64], outputs: &[f64]) -> Result<(), PlantError> {
        let (n, m) = (self.held.len(), self.outputs.len());
        if inputs.len() != n || outputs.len() != m {
            let (i, o) = (inputs.len(), outputs.len());
            return Err(PlantError::Call(format!("{i} inputs and {o} outputs given: expected {n} and {m}")));
        }
        let time_s = self.state.time_s;
        for (v, &found) in self.variables.iter().zip(inputs) {
            if !found.is_finite() {
                return Err(PlantError::NonFinite { name: v.name.clone(), time_s });
            }
            if !self.settings.options.saturate && (found < v.min || found > v.max) {
                return Err(PlantError::OutOfRange {
                    name: v.name.clone(),
                    found,
                    unit: v.unit.clone(),
                    min: v.min,
                    max: v.max,
                    time_s,
                });
            }
        }
        for (i, &found) in inputs.iter().enumerate() {
            let v = &self.variables[i];
            let used = found.clamp(v.min, v.max);
            let outside = used != found;
            if outside && !self.state.saturated[i] {
                let what = format!("{} saturated", v.name);
                self.events.push(LimitEvent { time_s, what, value: found, limit: used });
            }
            self.state.saturated[i] = outside;
            self.held[i] = used;
        }
        Ok(())
    }

    /// One sample: ticks over the span, then the readings.
    pub(super) fn sample(
        &mut self,
        inputs: &[f64],
        span: Span,
        outputs: &mut [f64],
    ) -> Result<(), PlantError> {
        self.check(inputs, outputs)?;
        let begin_s = self.state.time_s;
        match span {
            Span::Time(dt_s) => {
                let acts = self.settings.options.acts();
                let n = if acts { (dt_s / self.settings.options.tick_s - 1e-9).ceil().max(1.0) } else { 1.0 };
                for _ in 0..n as usize {
                    self.tick(dt_s / n, f64::INFINITY)?;
                }
            }
            Span::Angle(angle_deg) => {
                let mut left = angle_deg;
                // Rounding of the last piece, far below any step of the engine.
                while left > 1e-9 {
                    left -= self.tick(self.settings.options.tick_s, left)?;
                }
            }
        }
        let dt_s = self.state.time_s - begin_s;
        self.read(dt_s, outputs);
        Ok(())
    }

    /// One tick of `h_s`, or less when the crank would turn by more than `most_deg`; returns the angle \[deg\].
    fn tick(&mut self, h_s: f64, most_deg: f64) -> Result<f64, PlantError> {
        let commands = self.commands(h_s);
        let o = &self.settings.options;
        let s = &mut self.state;
        let turn = o.dynamometer.begin(&mut s.dyno, self.held[3], h_s);
        let speed_rpm = turn.omega * 30.0 / std::f64::consts::PI;
        let h_s = h_s.min(most_deg / (6.0 * speed_rpm));
        let throttle_deg = o.throttle.step(&mut s.throttle, commands.throttle_deg, h_s);
        let throttle_deg = match &o.air_bleed {
            None => throttle_deg,
            Some(b) => {
                let command = self.held[INPUTS + self.extra.len()];
                b.step(&mut s.bleed, command, &self.engine.params().throttle, throttle_deg, h_s)
            }
        };
        let wastegate_mm = o.wastegate.step(&mut s.wastegate, commands.wastegate_mm, h_s);
        // The demanded speed itself in ideal mode: no detour through rad/s.
        let ideal = o.dynamometer.mode == DynoMode::Speed;
        let mut u = Inputs {
            injection_mg: commands.injection_mg,
            spark_deg: commands.spark_deg,
            throttle_deg,
            speed_rpm: if ideal { self.held[3] } else { speed_rpm },
            ..self.engine.state().inputs
        };
        if let Some(schedule) = &self.engine.params().cams {
            let [intake, exhaust] = &mut self.state.cams;
            let at = schedule.at(u.speed_rpm, self.engine.outputs().map_kpa);
            u.intake_mop_deg_btdc = intake.step(at.0, PHASER_S, h_s);
            u.exhaust_mop_deg_atdc = exhaust.step(at.1, PHASER_S, h_s);
        }
        for (row, value) in self.extra.iter().zip(&self.held[INPUTS..]) {
            *(EXTRA[*row].field)(&mut u) = *value;
        }
        u.wastegate_mm = wastegate_mm;
        self.engine.set_inputs(u).map_err(|e| PlantError::Call(e.to_string()))?;
        self.apply_deviations();
        self.engine.clear_interval();
        let before = self.engine.state().ledger;
        self.engine.advance_time(h_s);
        self.state.time_s += h_s;
        self.after(turn, h_s, &before)?;
        Ok(6.0 * u.speed_rpm * h_s)
    }

    /// Commands to the actuators: loops, idle and cut-off, back-off.
    fn commands(&mut self, h_s: f64) -> Commands {
        let o = &self.settings.options;
        let s = &mut self.state;
        let wastegate = self.extra.iter().position(|&row| EXTRA[row].name == "wastegate");
        let mut c = Commands {
            injection_mg: self.held[0],
            spark_deg: self.held[1],
            throttle_deg: self.held[2],
            wastegate_mm: wastegate.map_or(self.settings.start.wastegate_mm, |i| self.held[INPUTS + i]),
        };
        let [throttle, fuel] = &mut s.integrals;
        if o.loops.torque {
            let error = self.held[2] - s.sensors[0].value();
            c.throttle_deg = o.loops.torque_gains.step(throttle, error, (0.0, 90.0), h_s);
        }
        if o.loops.lambda {
            let error = self.held[0] - s.sensors[1].value();
            c.injection_mg = o.loops.lambda_gains.step(fuel, error, (0.0, 120.0), h_s);
        }
        if let Some(idle) = &o.engine.idle {
            let free = o.dynamometer.mode == DynoMode::Load;
            let shaft = Shaft { rpm: s.dyno.speed_rpm(), free };
            let air_mg = 1e3 * self.engine.outputs().air_g_s * 120.0 / shaft.rpm / 4.0;
            let fuel_mg = air_mg / self.engine.params().gas.afr_stoich;
            c = idle.step(&mut s.idle, c, shaft, fuel_mg, h_s);
        }
        c.backed_off(&o.limits, &s.guards)
    }

    /// What follows from a tick: rotor, temperatures, catalyst, sensors, limits.
    fn after(
        &mut self,
        turn: super::dynamometer::DynoTick,
        h_s: f64,
        before: &Ledger,
    ) -> Result<(), PlantError> {
        let y = self.engine.outputs();
        let o = &self.settings.options;
        let s = &mut self.state;
        if !(y.torque_nm.is_finite() && y.lambda_interval.is_finite()) {
            return Err(PlantError::NonFinite { name: "engine state".to_owned(), time_s: s.time_s });
        }
        let sums = self.engine.state().interval;
        let friction_j = turn.omega * sums.friction_nm_s;
        let held = o.dynamometer.end(&mut s.dyno, turn, sums.work_j - friction_j, sums.time_s);
        if held && s.dyno.held_j != 0.0 {
            let rpm = s.dyno.speed_rpm();
            let what = "engine_speed held".to_owned();
            let event = LimitEvent { time_s: s.time_s, what, value: rpm, limit: rpm };
            if self.events.last().is_none_or(|e| e.what != event.what) {
                self.events.push(event);
            }
        }
        if let (Some(settings), Some(t)) = (&o.engine.warm_up, &mut s.thermal) {
            let now = &self.engine.state().ledger;
            settings.step(t, now.cylinder_heat_j - before.cylinder_heat_j, friction_j, h_s);
            settings.manifold(t, &self.engine, now.exhaust_heat_j - before.exhaust_heat_j, h_s);
        }
        let flow_g_s = y.air_g_s + y.fuel_kg_h / 3.6;
        if let (Some(settings), Some(c)) = (&o.engine.catalyst, &mut s.catalyst) {
            let gas = &self.engine.params().gas;
            let (unburned_j_g, heat_j_g_o2) = match self.engine.params().emissions {
                Some(_) => super::catalyst::Feed::unburned_of(y.co_pct, y.hc_ppm),
                None => super::catalyst::Feed::unburned_share(
                    1e-3 * gas.lhv_j_kg,
                    y.lambda_interval,
                    gas.afr_stoich,
                ),
            };
            let feed = super::catalyst::Feed {
                gas_g: flow_g_s * h_s,
                gas_k: y.exhaust_k,
                lambda: y.lambda_interval,
                afr: gas.afr_stoich,
                unburned_j_g,
                heat_j_g_o2,
            };
            settings.step(c, &feed, h_s);
        }
        let fuelled = self.engine.state().inputs.injection_mg > 0.0;
        s.fuelled_s = if fuelled { s.fuelled_s + h_s } else { 0.0 };
        let mut sensors = std::mem::take(&mut s.sensors);
        let mut guards = std::mem::take(&mut s.guards);
        let r = Readings { y: &y, engine: &self.engine, bed: &self.state, lambda: y.lambda_interval };
        for ((sensor, settings), &q) in sensors.iter_mut().zip(&self.sensors).zip(&self.outputs) {
            sensor.tick(settings, (QUANTITIES[q].value)(&r), flow_g_s, h_s);
        }
        let limits = guards.iter_mut().zip(&o.limits).zip(&self.limits).zip(&mut self.tripped);
        for (((guard, limit), &q), tripped) in limits {
            let quantity = &QUANTITIES[q];
            let value = (quantity.value)(&r);
            let known = !quantity.needs_fuel || self.state.fuelled_s >= MIXTURE_S;
            let found = guard.tick(limit, known.then_some(value), h_s);
            if found != Found::Nothing {
                let trip = if found == Found::Tripped { " trip" } else { "" };
                let what = format!("{}{trip}", limit.what);
                let bound = limit.violated(value).unwrap_or(value);
                if found == Found::Tripped {
                    let (from_s, to_s) = (self.state.time_s, self.state.time_s);
                    *tripped = self.trips.len();
                    self.trips.push(Trip { what: what.clone(), from_s, to_s });
                }
                self.events.push(LimitEvent { time_s: self.state.time_s, what, value, limit: bound });
            }
            if let Some(trip) = self.trips.get_mut(*tripped).filter(|_| guard.trip_s > 0.0) {
                trip.to_s = self.state.time_s;
            }
        }
        self.state.sensors = sensors;
        self.state.guards = guards;
        Ok(())
    }

    /// Readings at the end of a sample.
    fn read(&mut self, dt_s: f64, outputs: &mut [f64]) {
        let s = &mut self.state;
        let mut white = SensorNoise::new(self.settings.noise, s.seed);
        white.set_position(s.seed, s.samples);
        let (torque, lambda) = white.next_sample();
        s.samples += 1;
        for (i, y) in outputs.iter_mut().enumerate() {
            let settings = &self.sensors[i];
            let stream = (s.seed ^ SENSORS, CHANNELS * s.samples + i as u64);
            let x = s.sensors[i].read(settings, QUANTITIES[self.outputs[i]].mean, stream, dt_s);
            *y = quantise(x + [torque, lambda].get(i).unwrap_or(&0.0), settings.quantum);
        }
        s.shown.copy_from_slice(outputs);
    }

    /// Gives the engine its deviations as they are now.
    pub(super) fn apply_deviations(&mut self) {
        let mut d = Deviations { seed: self.state.seed, ..self.deviations };
        if let (Some(settings), Some(t)) = (&self.settings.options.engine.warm_up, &self.state.thermal) {
            d = settings.applied(t, d);
        }
        self.engine.set_deviations(d);
    }
}
