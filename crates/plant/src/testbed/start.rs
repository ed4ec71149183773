//! A bed as it is set up: engine, start point, options.

use super::settings::BedOptions;
use crate::engine::VirtualEngine;
use crate::error::PlantError as EngineError;
use crate::full_load::{LoadLimits, LoadRequest, hold_load};
use crate::inputs::Inputs;
use crate::params::EngineParams;
use crate::sensors::NoiseLevels;

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
}

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
