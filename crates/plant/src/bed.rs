//! The test bed: the engine with sensors behind the [`Plant`] contract.

use crate::engine::VirtualEngine;
use crate::error::PlantError as EngineError;
use crate::inputs::Inputs;
use crate::params::EngineParams;
use crate::sensors::{NoiseLevels, SensorNoise};
use crate::state::EngineState;
use dynocal_ident::plant::{Causality, LimitEvent, Plant, PlantError, PlantState, Variable};

/// A limit on one output of the bed; touching it is reported, nothing is changed.
#[derive(Debug, Clone, PartialEq)]
pub struct OutputLimit {
    /// Name of the output.
    pub what: String,
    /// Least allowed value.
    pub min: f64,
    /// Greatest allowed value.
    pub max: f64,
}

/// How a bed is set up.
#[derive(Debug, Clone)]
pub struct BedSettings {
    /// Name of the parameter set, for the origin of records.
    pub set_name: String,
    /// Inputs of the start state.
    pub start: Inputs,
    /// Simulated time at the start inputs before the record begins \[s\].
    pub settle_s: f64,
    /// Sensor noise.
    pub noise: NoiseLevels,
    /// Limits that are reported.
    pub limits: Vec<OutputLimit>,
}

impl Default for BedSettings {
    /// Thesis set at 2000 rpm, 70 Nm, lambda 1, no noise, no limits.
    fn default() -> Self {
        Self {
            set_name: "thesis".to_owned(),
            start: Inputs {
                throttle_deg: 15.85,
                spark_deg: 18.95,
                injection_mg: 16.754,
                ..Inputs::default()
            },
            settle_s: 4.0,
            noise: NoiseLevels::default(),
            limits: Vec::new(),
        }
    }
}

const INPUTS: usize = 4;
const OUTPUTS: usize = 5;
/// Numbers in front of a saved state: time, two halves of the seed, samples drawn.
const HEAD: usize = 4;

/// Engine on an ideal dynamometer (speed is imposed at once).
///
/// Inputs in this order: `inj` \[mg\], `spark` \[deg\], `throttle` \[deg\], `speed` \[rpm\]; outputs `torque` \[Nm\]
/// (sensor: 720 deg mean and lag), `lambda` \[-\] (mean over the step), `map` \[kPa\], `egt` \[K\], `fuel` \[kg/h\].
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
    engine: VirtualEngine,
    start: EngineState,
    settings: BedSettings,
    variables: Vec<Variable>,
    noise: SensorNoise,
    time_s: f64,
    outside: Vec<bool>,
    events: Vec<LimitEvent>,
}

impl EngineBed {
    /// Build the bed and settle the engine at the start inputs.
    ///
    /// # Errors
    /// Errors of the engine: parameters or start inputs out of range.
    pub fn new(params: &EngineParams, settings: BedSettings) -> Result<Self, EngineError> {
        let mut engine = VirtualEngine::new(params)?;
        engine.set_inputs(settings.start)?;
        engine.advance_time(settings.settle_s);
        engine.check_state()?;
        engine.clear_interval();
        let start = engine.snapshot();
        let y = engine.outputs();
        let u = &settings.start;
        let input = |name: &str, unit: &str, min, max, start| Variable {
            name: name.to_owned(),
            unit: unit.to_owned(),
            causality: Causality::Input,
            min,
            max,
            start,
        };
        let output = |name: &str, unit: &str, min, max, start| Variable {
            causality: Causality::Output,
            ..input(name, unit, min, max, start)
        };
        let variables = vec![
            input("inj", "mg", 0.0, 120.0, u.injection_mg),
            input("spark", "deg", -10.0, 55.0, u.spark_deg),
            input("throttle", "deg", 0.0, 90.0, u.throttle_deg),
            input("speed", "rpm", 600.0, 6500.0, u.speed_rpm),
            output("torque", "Nm", -100.0, 500.0, y.torque_nm),
            output("lambda", "-", 0.0, 9.99, y.lambda),
            output("map", "kPa", 0.0, 300.0, y.map_kpa),
            output("egt", "K", 200.0, 1500.0, y.egt_k),
            output("fuel", "kg/h", 0.0, 100.0, y.fuel_kg_h),
        ];
        let outside = vec![false; settings.limits.len()];
        let noise = SensorNoise::new(settings.noise, 0);
        Ok(Self { engine, start, settings, variables, noise, time_s: 0.0, outside, events: Vec::new() })
    }

    /// The engine on the bed (read only: a bed must not be peeked into by a campaign).
    pub fn engine(&self) -> &VirtualEngine {
        &self.engine
    }

    fn check(&self, inputs: &[f64], dt_s: f64, outputs: &[f64]) -> Result<(), PlantError> {
        if inputs.len() != INPUTS || outputs.len() != OUTPUTS {
            let (i, o) = (inputs.len(), outputs.len());
            return Err(PlantError::Call(format!(
                "{i} inputs and {o} outputs given: expected {INPUTS} and {OUTPUTS}"
            )));
        }
        if !(dt_s > 0.0 && dt_s <= 10.0) {
            return Err(PlantError::Call(format!("sample time {dt_s} s: expected 0..10 s")));
        }
        for (v, &found) in self.variables.iter().zip(inputs) {
            if !found.is_finite() {
                return Err(PlantError::NonFinite { name: v.name.clone(), time_s: self.time_s });
            }
            if found < v.min || found > v.max {
                return Err(PlantError::OutOfRange {
                    name: v.name.clone(),
                    found,
                    unit: v.unit.clone(),
                    min: v.min,
                    max: v.max,
                    time_s: self.time_s,
                });
            }
        }
        Ok(())
    }

    /// Report each limit once when it is crossed.
    fn watch(&mut self, outputs: &[f64]) {
        for (limit, outside) in self.settings.limits.iter().zip(&mut self.outside) {
            let index = self.variables[INPUTS..].iter().position(|v| v.name == limit.what);
            let Some(value) = index.map(|i| outputs[i]) else { continue };
            let bound = if value > limit.max { limit.max } else { limit.min };
            let now = value > limit.max || value < limit.min;
            if now && !*outside {
                let what = limit.what.clone();
                self.events.push(LimitEvent { time_s: self.time_s, what, value, limit: bound });
            }
            *outside = now;
        }
    }
}

impl Plant for EngineBed {
    fn variables(&self) -> &[Variable] {
        &self.variables
    }

    fn reset(&mut self, seed: u64) {
        // The start state was taken from this engine, so it always fits.
        let fits = self.engine.restore(&self.start);
        debug_assert!(fits.is_ok());
        self.noise.reset(seed);
        self.time_s = 0.0;
        self.outside.fill(false);
        self.events.clear();
    }

    fn step(&mut self, inputs: &[f64], dt_s: f64, outputs: &mut [f64]) -> Result<(), PlantError> {
        self.check(inputs, dt_s, outputs)?;
        let u = Inputs {
            injection_mg: inputs[0],
            spark_deg: inputs[1],
            throttle_deg: inputs[2],
            speed_rpm: inputs[3],
            ..self.engine.state().inputs
        };
        self.engine.set_inputs(u).map_err(|e| PlantError::Call(e.to_string()))?;
        self.engine.clear_interval();
        self.engine.advance_time(dt_s);
        self.time_s += dt_s;
        let y = self.engine.outputs();
        if !(y.torque_nm.is_finite() && y.lambda_interval.is_finite()) {
            return Err(PlantError::NonFinite { name: "engine state".to_owned(), time_s: self.time_s });
        }
        let (noise_torque, noise_lambda) = self.noise.next_sample();
        outputs.copy_from_slice(&[
            y.torque_nm + noise_torque,
            y.lambda_interval + noise_lambda,
            y.map_kpa,
            y.egt_k,
            y.fuel_kg_h,
        ]);
        if !self.settings.limits.is_empty() {
            self.watch(outputs);
        }
        Ok(())
    }

    fn time_s(&self) -> f64 {
        self.time_s
    }

    fn take_events(&mut self) -> Vec<LimitEvent> {
        std::mem::take(&mut self.events)
    }

    fn save(&self) -> PlantState {
        let (seed, samples) = self.noise.position();
        // The seed travels as two halves: every 32-bit number is exact in f64 and in JSON.
        let (high, low) = ((seed >> 32) as f64, (seed & 0xffff_ffff) as f64);
        let mut numbers = vec![self.time_s, high, low, samples as f64];
        numbers.extend(self.outside.iter().map(|&o| f64::from(u8::from(o))));
        self.engine.state().to_numbers(&mut numbers);
        PlantState(numbers)
    }

    fn restore(&mut self, state: &PlantState) -> Result<(), PlantError> {
        let head = HEAD + self.outside.len();
        let wrong = || PlantError::Call(format!("{} numbers are no state of this bed", state.0.len()));
        let body = state.0.get(head..).ok_or_else(wrong)?;
        let mut engine_state = self.start.clone();
        if !engine_state.load_numbers(body) {
            return Err(wrong());
        }
        self.engine.restore(&engine_state).map_err(|e| PlantError::Call(e.to_string()))?;
        self.time_s = state.0[0];
        let seed = ((state.0[1] as u64) << 32) | state.0[2] as u64;
        self.noise.set_position(seed, state.0[3] as u64);
        for (o, x) in self.outside.iter_mut().zip(&state.0[HEAD..head]) {
            *o = *x != 0.0;
        }
        Ok(())
    }

    fn describe(&self) -> String {
        let n = &self.settings.noise;
        format!(
            "virtual engine F0, parameter set `{}`, noise {} Nm / {} lambda, dynocal-plant {}",
            self.settings.set_name,
            n.torque_nm,
            n.lambda,
            env!("CARGO_PKG_VERSION")
        )
    }
}
