//! How a bed is set up. Every default is ideal: nothing between the commands and the engine.

use super::bleed::BleedSettings;
use super::catalyst::CatalystSettings;
use super::dynamics::{ActuatorSettings, PiGains};
use super::dynamometer::{DynoMode, DynoSettings};
use super::guard::{Action, LimitSettings};
use super::idle::IdleSettings;
use super::inputs;
use super::quantity;
use super::sensor::SensorSettings;
use super::thermal::ThermalSettings;
use crate::deviations::Scatter;
use crate::error::PlantError;
use crate::params::EngineParams;
use dynocal_ident::data::UnitAfter;
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;

/// Loops of the bed; a closed loop turns its input into a demand.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct LoopSettings {
    /// Input `torque_demand` in place of `throttle`.
    pub torque: bool,
    /// Input `lambda_demand` in place of `inj`.
    pub lambda: bool,
    /// Throttle \[deg\] per torque error \[Nm\], and per second.
    pub torque_gains: PiGains,
    /// Fuel \[mg\] per lambda error, and per second.
    pub lambda_gains: PiGains,
}

impl Default for LoopSettings {
    /// Open; gains of thesis eq. (6.1).
    fn default() -> Self {
        Self {
            torque: false,
            lambda: false,
            torque_gains: PiGains { proportional: 0.007, integral: 0.15 },
            lambda_gains: PiGains { proportional: -1.5, integral: -20.0 },
        }
    }
}

/// What a real engine adds.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct RealEngine {
    /// Seed of what distinguishes the cylinders; the scatter has the seed of the run.
    pub cylinder_seed: u64,
    /// Scatter from cycle to cycle.
    pub scatter: Scatter,
    /// Standard deviation of the cylinders' fuel \[-\].
    pub fuel_imbalance: f64,
    /// Error of all injectors: they give `1 + injector_error` of what is commanded \[-\]. The quantity `fuel` is what
    /// they give.
    pub injector_error: f64,
    /// Standard deviation of the cylinders' burn delay and duration \[-\].
    pub burn_imbalance: f64,
    /// Octane number of the fuel in the tank, in place of that of the parameter set.
    pub octane: Option<f64>,
    /// Temperature of walls, coolant, oil, catalyst and the pipe before it at the start \[K\], in place of the `start_k` of
    /// `warm_up` and `catalyst`: a cold start by one key.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub start_k: Option<f64>,
    /// Warm-up of walls, coolant and oil.
    pub warm_up: Option<ThermalSettings>,
    /// Catalyst.
    pub catalyst: Option<CatalystSettings>,
    /// Fuel cut-off and idle control.
    pub idle: Option<IdleSettings>,
}

/// Everything about a bed that is not the engine.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct BedOptions {
    /// Interval in which the bed acts \[s\]. An ideal bed acts once in a sample.
    pub tick_s: f64,
    /// Inputs outside their range are set to its end and reported, in place of an error.
    pub saturate: bool,
    /// Inputs beside the standard four: `intake_cam`, `exhaust_cam`, `wastegate`, `egr`, `wiebe_m`. Cams that are no
    /// inputs follow the schedule of the parameter set, if it has one.
    pub inputs: Vec<String>,
    /// Quantities to be read beside the five standard outputs, which may stand here, too.
    pub outputs: Vec<String>,
    /// Dynamometer.
    pub dynamometer: DynoSettings,
    /// Throttle actuator.
    pub throttle: ActuatorSettings,
    /// Wastegate actuator.
    pub wastegate: ActuatorSettings,
    /// Air-bleed valve beside the throttle: one more input.
    pub air_bleed: Option<BleedSettings>,
    /// Sensors by the name of their quantity.
    pub sensors: BTreeMap<String, SensorSettings>,
    /// Loops of the bed.
    pub loops: LoopSettings,
    /// Limits.
    pub limits: Vec<LimitSettings>,
    /// What a real engine adds.
    pub engine: RealEngine,
}

impl Default for BedOptions {
    /// The ideal bed.
    fn default() -> Self {
        Self {
            tick_s: 2e-3,
            saturate: false,
            inputs: Vec::new(),
            outputs: Vec::new(),
            dynamometer: DynoSettings::default(),
            throttle: ActuatorSettings::default(),
            wastegate: ActuatorSettings::default(),
            air_bleed: None,
            sensors: BTreeMap::new(),
            loops: LoopSettings::default(),
            limits: Vec::new(),
            engine: RealEngine::default(),
        }
    }
}

impl BedOptions {
    /// The bed of a real engine: scatter, unequal cylinders, warm engine, actuators and sensors with lags, a catalyst.
    ///
    /// Lags are of the usual size: throttle 50 ms (Guzzella and Onder 2010 class), thermocouple of 1.5 mm 1 s, wide-band
    /// lambda sensor 50 ms behind 0.5 g of gas.
    pub fn real() -> Self {
        let sensor = |lag_s, transport_g, quantum| SensorSettings {
            lag_s,
            transport_g,
            quantum,
            ..SensorSettings::default()
        };
        let sensors = [
            ("lambda", sensor(0.05, 0.5, 0.001)),
            ("egt", sensor(1.0, 0.0, 0.25)),
            ("torque", sensor(0.0, 0.0, 0.05)),
            ("map", sensor(0.005, 0.0, 0.05)),
        ];
        Self {
            throttle: ActuatorSettings { lag_s: 0.05, rate_per_s: 400.0 },
            wastegate: ActuatorSettings { lag_s: 0.15, rate_per_s: 0.0 },
            sensors: sensors.into_iter().map(|(n, s)| (n.to_owned(), s)).collect(),
            engine: RealEngine {
                scatter: Scatter { heat: 0.012, burn: 0.05, dilution: 0.0 },
                cylinder_seed: 1,
                fuel_imbalance: 0.01,
                injector_error: 0.0,
                burn_imbalance: 0.02,
                octane: None,
                start_k: None,
                warm_up: Some(ThermalSettings { start_k: 363.15, ..ThermalSettings::default() }),
                catalyst: Some(CatalystSettings::default()),
                idle: Some(IdleSettings::default()),
            },
            ..Self::default()
        }
    }

    /// Options by the name of the parameter set: real for the physical engines, ideal for `thesis` and sets from files.
    pub fn of_set(name: &str) -> Self {
        Self::own_real(name).unwrap_or_default()
    }

    /// The real bed of a parameter set: its own where it has one, otherwise [`Self::real`].
    pub fn real_of_set(name: &str) -> Self {
        Self::own_real(name).unwrap_or_else(Self::real)
    }

    fn own_real(name: &str) -> Option<Self> {
        let set = crate::params::perturb::parse(name).map_or(name, |p| p.0);
        let bed = match set {
            "gtdi_2l" | "twin_2l" => Self::real(),
            "other_1_8l" => {
                let mut bed = Self::real();
                // Slower and farther sensors than those that the calibration was tuned on.
                if let Some(lambda) = bed.sensors.get_mut("lambda") {
                    (lambda.lag_s, lambda.transport_g) = (0.09, 0.8);
                }
                if let Some(egt) = bed.sensors.get_mut("egt") {
                    egt.lag_s = 2.0;
                }
                bed.engine.cylinder_seed = 2;
                bed
            }
            "pfi_1_6l" => Self { air_bleed: Some(BleedSettings::default()), ..Self::real() },
            _ => return None,
        };
        Some(bed)
    }

    /// White noise of the sensors, that of torque and lambda together with what the bed adds to them: output and standard
    /// deviation in its unit, `torque 0.5 Nm, lambda 0.01`; empty where there is none.
    pub fn noise_words(&self, torque_nm: f64, lambda: f64) -> String {
        let own = [("torque", torque_nm), ("lambda", lambda)];
        let sensor = |name: &str| self.sensors.get(name).map_or(0.0, |s| s.noise);
        let both = own.iter().map(|(name, noise)| (*name, noise.hypot(sensor(name))));
        let others = self.sensors.iter().map(|(name, s)| (name.as_str(), s.noise));
        let others = others.filter(|(name, _)| !own.iter().any(|(o, _)| o == name));
        let words = both.chain(others).filter(|(_, noise)| *noise > 0.0).map(|(name, noise)| {
            let unit = quantity::quantities().find(|q| q.0 == name).map_or("-", |q| q.1);
            format!("{name} {noise}{}", UnitAfter(unit))
        });
        words.collect::<Vec<_>>().join(", ")
    }

    /// Whether the bed acts between samples.
    pub(crate) fn acts(&self) -> bool {
        self.dynamometer.mode != DynoMode::Speed
            || !self.throttle.ideal()
            || !self.wastegate.ideal()
            || self.air_bleed.is_some()
            || self.sensors.values().any(|s| !s.is_static())
            || self.loops.torque
            || self.loops.lambda
            || self.limits.iter().any(|l| l.action != Action::Report)
            || self.engine.warm_up.is_some()
            || self.engine.catalyst.is_some()
            || self.engine.idle.is_some()
    }

    /// Refuses what no bed has.
    ///
    /// # Errors
    /// [`PlantError::Bed`] naming the first key that is out of range.
    pub fn check(&self) -> Result<(), PlantError> {
        let d = &self.dynamometer;
        range("bed.tick_s", self.tick_s, 1e-4, 0.02)?;
        range("bed.dynamometer.engine_kg_m2", d.engine_kg_m2, 1e-3, 10.0)?;
        range("bed.dynamometer.rotor_kg_m2", d.rotor_kg_m2, 0.0, 100.0)?;
        range("bed.dynamometer.gains.proportional", d.gains.proportional, 0.0, 1e4)?;
        range("bed.dynamometer.gains.integral", d.gains.integral, 0.0, 1e6)?;
        range("bed.dynamometer.torque_limit_nm", d.torque_limit_nm, 1.0, 5000.0)?;
        range("bed.dynamometer.least_rpm", d.least_rpm, 600.0, 6500.0)?;
        range("bed.dynamometer.most_rpm", d.most_rpm, d.least_rpm + 1.0, 6500.0)?;
        for (key, a) in [("bed.throttle", &self.throttle), ("bed.wastegate", &self.wastegate)] {
            range(&format!("{key}.lag_s"), a.lag_s, 0.0, 10.0)?;
            range(&format!("{key}.rate_per_s"), a.rate_per_s, 0.0, 1e6)?;
        }
        if let Some(b) = &self.air_bleed {
            range("bed.air_bleed.open_mm2", b.open_mm2, 0.0, 5e3)?;
            range("bed.air_bleed.start", b.start, 0.0, 1.0)?;
        }
        for (name, s) in &self.sensors {
            known("bed.sensors", name)?;
            let key = |k: &str| format!("bed.sensors.{name}.{k}");
            range(&key("delay_s"), s.delay_s, 0.0, 10.0)?;
            range(&key("transport_g"), s.transport_g, 0.0, 50.0)?;
            range(&key("lag_s"), s.lag_s, 0.0, 100.0)?;
            range(&key("noise"), s.noise, 0.0, 1e6)?;
            range(&key("drift"), s.drift, 0.0, 1e6)?;
            range(&key("drift_s"), s.drift_s, 1e-3, 1e9)?;
            range(&key("quantum"), s.quantum, 0.0, 1e6)?;
        }
        for name in &self.inputs {
            if inputs::find(name).is_none() {
                let names: Vec<&str> = inputs::EXTRA.iter().map(|i| i.name).collect();
                return Err(unknown("bed.inputs", name, &names));
            }
        }
        for name in &self.outputs {
            known("bed.outputs", name)?;
        }
        for (key, names) in [("bed.inputs", &self.inputs), ("bed.outputs", &self.outputs)] {
            if let Some((_, name)) = names.iter().enumerate().find(|(k, n)| names[..*k].contains(n)) {
                return Err(twice(key, name, "every name once"));
            }
        }
        for l in &self.limits {
            known("bed.limits", &l.what)?;
            range(&format!("bed.limits {}.within_s", l.what), l.within_s, 0.05, 1e3)?;
            range(&format!("bed.limits {}.recover_per_s", l.what), l.recover_per_s, 0.0, 100.0)?;
            for bound in [l.max, l.min].into_iter().flatten() {
                range(&format!("bed.limits {}", l.what), bound, -1e9, 1e9)?;
            }
            let bounds = match (l.min, l.max) {
                (None, None) => Some("neither min nor max".to_string()),
                (Some(min), Some(max)) if min > max => Some(format!("min {min} above max {max}")),
                _ => None,
            };
            if let Some(found) = bounds {
                let (key, expected) =
                    (format!("bed.limits {}", l.what), "min, max or both, min below max".into());
                return Err(PlantError::Bed { key, found, expected });
            }
        }
        self.engine.check()
    }

    /// Refuses limits and outputs of what the engine does not have: a zero that nothing computes keeps every limit.
    ///
    /// # Errors
    /// [`PlantError::Bed`] naming the first one.
    pub(super) fn check_engine(&self, set: &str, params: &EngineParams) -> Result<(), PlantError> {
        let limits = self.limits.iter().map(|l| ("bed.limits", l.what.as_str()));
        let outputs = self.outputs.iter().map(|n| ("bed.outputs", n.as_str()));
        // A wastegate that nothing drives stands open, and opening it keeps no limit.
        let opens = |l: &&LimitSettings| l.action == Action::OpenWastegate;
        let actions = self.limits.iter().filter(opens).map(|_| ("bed.limits", "wastegate"));
        let lacked = limits.chain(outputs).chain(actions).find_map(|(key, name)| {
            Some((key, name, params.lacks(name).map(|l| format!("`{set}` has no {l}"))?))
        });
        let lacked = lacked.or_else(|| {
            let limits = self.limits.iter().map(|l| ("bed.limits", l.what.as_str()));
            // A temperature that stands still can be read; a limit on it would be kept by nothing.
            let still = |n: &&String| !["coolant", "oil", "wall"].contains(&n.as_str());
            let outputs = self.outputs.iter().filter(still).map(|n| ("bed.outputs", n.as_str()));
            limits
                .chain(outputs)
                .find_map(|(key, name)| Some((key, name, self.lacks(name, params)?.to_owned())))
        });
        match lacked {
            None => Ok(()),
            Some((key, name, lacked)) => Err(PlantError::Bed {
                key: key.into(),
                found: format!("`{name}`"),
                expected: format!("what the engine has: {lacked}"),
            }),
        }
    }

    /// What a quantity needs of the bed and this one lacks; none where it is computed. Walls at one temperature are constants that the engine
    /// feels, and gas behind a catalyst that is not there is that before it: these can be read.
    fn lacks(&self, name: &str, params: &EngineParams) -> Option<&'static str> {
        match name {
            "coolant" | "oil" if self.engine.warm_up.is_none() => Some("this bed has no `engine.warm_up`"),
            "wall" if self.engine.warm_up.is_none() && params.heat.coolant.is_some() => {
                Some("this bed has no `engine.warm_up`")
            }
            "conversion" | "oxygen" if self.engine.catalyst.is_none() => {
                Some("this bed has no `engine.catalyst`")
            }
            "cov_imep" if self.engine.scatter.heat == 0.0 && self.engine.scatter.burn == 0.0 => {
                Some("this bed has no `engine.scatter`, so that all cycles are alike")
            }
            _ => None,
        }
    }
}

impl RealEngine {
    /// Warm-up and catalyst as they begin: at the one temperature of the start, where it is given.
    pub(super) fn begun(&self) -> Self {
        let mut real = *self;
        if let Some(start_k) = self.start_k {
            real.warm_up.iter_mut().for_each(|t| t.start_k = start_k);
            real.catalyst.iter_mut().for_each(|c| c.start_k = start_k);
        }
        real
    }

    fn check(&self) -> Result<(), PlantError> {
        range("bed.engine.scatter.heat", self.scatter.heat, 0.0, 0.3)?;
        range("bed.engine.scatter.burn", self.scatter.burn, 0.0, 0.3)?;
        range("bed.engine.scatter.dilution", self.scatter.dilution, 0.0, 10.0)?;
        range("bed.engine.fuel_imbalance", self.fuel_imbalance, 0.0, 0.2)?;
        range("bed.engine.injector_error", self.injector_error, -0.5, 0.5)?;
        range("bed.engine.burn_imbalance", self.burn_imbalance, 0.0, 0.2)?;
        range("bed.engine.octane", self.octane.unwrap_or(95.0), 60.0, 130.0)?;
        if let Some(start_k) = self.start_k {
            range("bed.engine.start_k", start_k, 240.0, 400.0)?;
            if self.warm_up.is_none() && self.catalyst.is_none() {
                return Err(PlantError::Bed {
                    key: "bed.engine.start_k".into(),
                    found: start_k.to_string(),
                    expected: "none without `engine.warm_up` or `engine.catalyst`: nothing would start at it"
                        .into(),
                });
            }
        }
        if let Some(t) = &self.warm_up {
            range("bed.engine.warm_up.start_k", t.start_k, 240.0, 400.0)?;
            range("bed.engine.warm_up.ambient_k", t.ambient_k, 230.0, 330.0)?;
            for c in t.capacity_j_k {
                range("bed.engine.warm_up.capacity_j_k", c, 500.0, 1e6)?;
            }
            for (key, ua) in [
                ("wall_coolant_w_k", t.wall_coolant_w_k),
                ("coolant_oil_w_k", t.coolant_oil_w_k),
                ("radiator_w_k", t.radiator_w_k),
                ("oil_ambient_w_k", t.oil_ambient_w_k),
            ] {
                range(&format!("bed.engine.warm_up.{key}"), ua, 0.0, 5e3)?;
            }
            range("bed.engine.warm_up.friction_share", t.friction_share, 0.0, 1.0)?;
            range("bed.engine.warm_up.viscosity_exponent", t.viscosity_exponent, 0.0, 1.0)?;
            let [begins, open] = t.thermostat_k;
            range("bed.engine.warm_up.thermostat_k", open - begins, 1.0, 50.0)?;
        }
        if let Some(c) = &self.catalyst {
            range("bed.engine.catalyst.start_k", c.start_k, 230.0, 1300.0)?;
            range("bed.engine.catalyst.capacity_j_k", c.capacity_j_k, 50.0, 1e5)?;
            range("bed.engine.catalyst.gas_brick_w_k", c.gas_brick_w_k, 1.0, 1e4)?;
            range("bed.engine.catalyst.pipe_j_k", c.pipe_j_k, 50.0, 1e5)?;
            range("bed.engine.catalyst.gas_pipe_w_k", c.gas_pipe_w_k, 0.0, 1e3)?;
            range("bed.engine.catalyst.pipe_ambient_w_k", c.pipe_ambient_w_k, 0.0, 1e3)?;
            range("bed.engine.catalyst.ambient_k", c.ambient_k, 230.0, 330.0)?;
            range("bed.engine.catalyst.ambient_w_k", c.ambient_w_k, 0.0, 1e3)?;
            range("bed.engine.catalyst.light_off_k", c.light_off_k, 300.0, 1300.0)?;
            range("bed.engine.catalyst.activation_k", c.activation_k, 1e3, 5e4)?;
            range("bed.engine.catalyst.reference_g_s", c.reference_g_s, 0.1, 1e3)?;
            range("bed.engine.catalyst.mass_transfer", c.mass_transfer, 1.0, 50.0)?;
            range("bed.engine.catalyst.oxygen_g", c.oxygen_g, 0.01, 50.0)?;
            range("bed.engine.catalyst.oxygen_half_g_s", c.oxygen_half_g_s, 1.0, 1e6)?;
            for rate in c.oxygen_rate {
                range("bed.engine.catalyst.oxygen_rate", rate, 0.1, 1e3)?;
            }
        }
        if let Some(i) = &self.idle {
            range("bed.engine.idle.idle_rpm", i.idle_rpm, 600.0, 2000.0)?;
            range("bed.engine.idle.return_rpm", i.return_rpm, i.idle_rpm, 6500.0)?;
            range("bed.engine.idle.cut_rpm", i.cut_rpm, i.return_rpm, 6500.0)?;
            range("bed.engine.idle.spark_reserve_deg", i.spark_reserve_deg, 0.0, 30.0)?;
            range("bed.engine.idle.range_deg", i.range_deg.width(), 0.0, 90.0)?;
        }
        Ok(())
    }
}

fn range(key: &str, found: f64, low: f64, high: f64) -> Result<(), PlantError> {
    if found >= low && found <= high {
        return Ok(());
    }
    Err(PlantError::Bed {
        key: key.to_owned(),
        found: found.to_string(),
        expected: format!("{low} to {high}"),
    })
}

fn known(key: &str, name: &str) -> Result<(), PlantError> {
    if quantity::find(name).is_some() {
        return Ok(());
    }
    let names: Vec<&str> = quantity::quantities().map(|q| q.0).collect();
    Err(unknown(key, name, &names))
}

fn twice(key: &str, name: &str, expected: &str) -> PlantError {
    PlantError::Bed { key: key.to_owned(), found: format!("`{name}`"), expected: expected.to_owned() }
}

fn unknown(key: &str, name: &str, names: &[&str]) -> PlantError {
    let expected = format!("one of {}", names.join(", "));
    PlantError::Bed { key: key.to_owned(), found: name.to_owned(), expected }
}
