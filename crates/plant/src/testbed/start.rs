//! A bed as it is set up: engine, start point, options.

use super::bleed::equivalent_angle_deg;
use super::inputs::EXTRA;
use super::settings::BedOptions;
use crate::engine::VirtualEngine;
use crate::error::PlantError as EngineError;
use crate::full_load::{LoadLimits, LoadRequest, hold_load};
use crate::inputs::Inputs;
use crate::params::EngineParams;
use crate::sensors::NoiseLevels;
use crate::statics::{SettleOptions, Target, settle};

/// How a bed is set up.
#[derive(Debug, Clone)]
pub struct BedSettings {
    /// Name of the parameter set, for the origin of records.
    pub set_name: String,
    /// Inputs of the start state.
    pub start: Inputs,
    /// Simulated time at the start inputs before the record begins \[s\].
    pub settle_s: f64,
    /// White noise of the torque and lambda sensors.
    pub noise: NoiseLevels,
    /// Everything else about the bed.
    pub options: BedOptions,
}

impl BedSettings {
    /// The bed of a parameter set as it comes: options of the set, start at 2000 rpm and 50 Nm, lambda 1 (`thesis`: the
    /// default start).
    ///
    /// # Errors
    /// [`EngineError`] where the engine cannot run at the start point.
    pub fn of_set(name: &str, params: &EngineParams) -> Result<Self, EngineError> {
        let settings =
            Self { set_name: name.to_owned(), options: BedOptions::of_set(name), ..Self::default() };
        if name == "thesis" {
            return Ok(settings);
        }
        let mut engine = VirtualEngine::new(params)?;
        let limits = LoadLimits { time_s: 20.0, ..LoadLimits::default() };
        let request = LoadRequest { speed_rpm: 2000.0, torque_nm: 50.0, lambda: 1.0, limits };
        Ok(Self { start: hold_load(&mut engine, request)?.inputs, ..settings })
    }

    /// The bed started at the first values of a record: `first` gives that of an input by its name where there is one. With a loop of lambda
    /// fuel follows the air there to the lambda that is demanded (1 where nothing is), with one of torque, too, the throttle the
    /// torque, as far as it gives it. What lies outside its range starts at the end of it.
    ///
    /// # Errors
    /// [`EngineError`] where the engine cannot be built.
    pub fn at_first(
        mut self,
        params: &EngineParams,
        first: &dyn Fn(&str) -> Option<f64>,
    ) -> Result<Self, EngineError> {
        let u = &mut self.start;
        let four: [(&str, &mut f64); 4] = [
            ("inj", &mut u.injection_mg),
            ("spark", &mut u.spark_deg),
            ("throttle", &mut u.throttle_deg),
            ("speed", &mut u.speed_rpm),
        ];
        for (name, field) in four {
            *field = first(name).unwrap_or(*field);
        }
        for e in EXTRA.iter().filter(|e| self.options.inputs.iter().any(|n| n == e.name)) {
            let field = (e.field)(u);
            *field = first(e.name).unwrap_or(*field);
        }
        *u = u.saturated();
        if let (Some(b), Some(opening)) = (&mut self.options.air_bleed, first("air_bleed")) {
            b.start = opening.clamp(0.0, 1.0);
        }
        if self.options.loops.lambda {
            let lambda = first("lambda_demand").unwrap_or(1.0).clamp(LAMBDAS.0, LAMBDAS.1);
            let torque_nm = first("torque_demand").filter(|_| self.options.loops.torque);
            self.start = self.looped(params, lambda, torque_nm)?;
        }
        Ok(self)
    }

    /// Inputs that loops of the bed hold in the end: fuel for a lambda, and the throttle for a torque where one is asked for.
    fn looped(
        &self,
        params: &EngineParams,
        lambda: f64,
        torque_nm: Option<f64>,
    ) -> Result<Inputs, EngineError> {
        let mut u = self.start;
        let mut engine = VirtualEngine::new(params)?;
        if let Some(torque_nm) = torque_nm {
            engine.set_inputs(u)?;
            let target = Target { speed_rpm: u.speed_rpm, torque_nm, lambda };
            let cams = !self.options.inputs.iter().any(|n| n.ends_with("_cam"));
            let options = SettleOptions { cams, ..SettleOptions::default() };
            match settle(&mut engine, target, u.spark_deg, options) {
                Ok(point) => return Ok(point.inputs),
                // The loop itself will not hold it at once either: fuel for the throttle there is.
                Err(EngineError::NotSettled { .. }) => engine = VirtualEngine::new(params)?,
                Err(e) => return Err(e),
            }
        }
        let throttle_deg = self.options.air_bleed.map_or(u.throttle_deg, |b| {
            equivalent_angle_deg(&params.throttle, u.throttle_deg, 1e-6 * b.open_mm2 * b.start)
        });
        let cycle_s = 120.0 / u.speed_rpm;
        while engine.state().time_s < self.settle_s {
            engine.set_inputs(Inputs { throttle_deg, ..u })?;
            engine.advance_angle(720.0);
            let air_mg = 1e3 * engine.outputs().air_g_s * cycle_s / 4.0;
            u.injection_mg = (air_mg / (params.gas.afr_stoich * lambda)).clamp(0.0, 120.0);
        }
        engine.check_state()?;
        Ok(u)
    }
}

/// Lambdas that can be demanded.
pub(super) const LAMBDAS: (f64, f64) = (0.6, 1.6);

impl Default for BedSettings {
    /// Thesis set at 2000 rpm, 70 Nm, lambda 1, on an ideal bed.
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
            options: BedOptions::default(),
        }
    }
}
