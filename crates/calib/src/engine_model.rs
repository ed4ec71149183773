//! An identified model of one engine output, in the user's unit.
//!
//! The structure may be in a transformed output (lambda models are better in `phi = 1/lambda`, because fuel over
//! air is closer to linear) and may read the derived input `cycle = 120/speed` (duration of a four-stroke cycle
//! in s), which is what transport and filling delays scale with.

use dynocal_ident::data::{Channel, DataError, Dataset, Role};
use dynocal_ident::model::poly::PolyNarx;
use dynocal_ident::model::{Model, Run};
use dynocal_numerics::status::Status;
use serde::{Deserialize, Serialize};

/// Output that the structure is written in.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Transform {
    /// The measured output itself.
    Identity,
    /// Its reciprocal.
    Reciprocal,
}

impl Transform {
    /// Measured to model output; the transform is its own inverse.
    pub fn apply(self, y: f64) -> f64 {
        match self {
            Transform::Identity => y,
            Transform::Reciprocal => 1.0 / y,
        }
    }
}

/// Structure, parameters and the output they describe.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct EngineModel {
    /// Schema of the stored form.
    pub schema_version: u32,
    /// Measured output, e.g. `lambda`.
    pub output: String,
    /// Transform between measured and model output.
    pub transform: Transform,
    /// Sample time in s.
    pub sample_time_s: f64,
    /// How it was obtained, e.g. `selected, simulation error`.
    pub origin: String,
    /// Structure.
    pub structure: PolyNarx,
    /// Parameters.
    pub theta: Vec<f64>,
}

/// Name of the derived input.
pub const CYCLE: &str = "cycle";

/// Cycle duration in s at an engine speed in rpm.
pub fn cycle_s(speed_rpm: f64) -> f64 {
    120.0 / speed_rpm
}

/// A copy of `record` with the derived channels that structures may read: `cycle [s]` and `phi [-]`.
///
/// # Errors
/// [`DataError`] when `speed` or `lambda` is missing, or lambda has a non-positive sample.
pub fn with_derived(record: &Dataset) -> Result<Dataset, DataError> {
    let mut out = record.clone();
    let cycle = record.values("speed")?.iter().map(|s| cycle_s(*s)).collect();
    let phi: Vec<f64> = record.values("lambda")?.iter().map(|l| 1.0 / l).collect();
    out.channels.push(Channel { name: CYCLE.into(), unit: "s".into(), role: Role::Input, values: cycle });
    out.channels.push(Channel { name: "phi".into(), unit: "-".into(), role: Role::Output, values: phi });
    out.check()?;
    Ok(out)
}

impl EngineModel {
    /// Input columns of `record` for this structure, N x m row-major.
    ///
    /// # Errors
    /// [`DataError::NoChannel`].
    pub fn input_rows(&self, record: &Dataset) -> Result<Vec<f64>, DataError> {
        if record.channels.iter().any(|c| c.name == CYCLE) {
            record.matrix(self.structure.inputs())
        } else {
            with_derived(record)?.matrix(self.structure.inputs())
        }
    }

    /// Free run over `record` in the user's unit, started from its first measured samples.
    ///
    /// # Errors
    /// [`DataError`] when a channel is missing.
    pub fn simulate(&self, record: &Dataset) -> Result<(Vec<f64>, Status), DataError> {
        let u = self.input_rows(record)?;
        let measured: Vec<f64> =
            record.values(&self.output)?.iter().map(|y| self.transform.apply(*y)).collect();
        let mut y = vec![0.0; measured.len()];
        let run = Run { u: &u, y: &measured, start: self.structure.max_lag() };
        let status = self.structure.simulate(&self.theta, &run, &mut y);
        Ok((y.into_iter().map(|v| self.transform.apply(v)).collect(), status))
    }
}
