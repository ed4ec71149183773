//! The contract with a plant: whatever answers a test (engine, bed, recording, literature system).
//!
//! A campaign sees a plant only as `&mut dyn Plant`, so no result can come from peeking into it.

use crate::data::UnitAfter;
use serde::{Deserialize, Serialize};

/// Whether a variable drives the plant or answers.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Causality {
    /// Set by the caller.
    Input,
    /// Computed by the plant.
    Output,
}

/// One variable of a plant.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Variable {
    /// Name, e.g. `inj`.
    pub name: String,
    /// Unit, e.g. `mg`; `-` for none.
    pub unit: String,
    /// Direction.
    pub causality: Causality,
    /// Least allowed value.
    pub min: f64,
    /// Greatest allowed value.
    pub max: f64,
    /// Value after [`Plant::reset`].
    pub start: f64,
}

/// A limit that was touched during a step.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct LimitEvent {
    /// Plant time in s.
    pub time_s: f64,
    /// Variable or quantity.
    pub what: String,
    /// Value that was met or asked for.
    pub value: f64,
    /// The limit.
    pub limit: f64,
}

/// The plant refused a call.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum PlantError {
    /// An input outside its range.
    #[error("input `{name}` = {found}{u} at {time_s:.3} s is outside {min} to {max}{u}", u = UnitAfter(.unit))]
    OutOfRange {
        /// Variable.
        name: String,
        /// Value asked for.
        found: f64,
        /// Unit.
        unit: String,
        /// Least allowed.
        min: f64,
        /// Greatest allowed.
        max: f64,
        /// Plant time in s.
        time_s: f64,
    },
    /// A non-finite input or state.
    #[error("`{name}` is not a finite number at {time_s:.3} s")]
    NonFinite {
        /// Variable.
        name: String,
        /// Plant time in s.
        time_s: f64,
    },
    /// The call does not fit the plant (wrong number of inputs, unknown name, not supported).
    #[error("{0}")]
    Call(String),
}

/// A saved state of a plant: plain numbers, meaningful to the plant that made it.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct PlantState(pub Vec<f64>);

/// Whatever answers a test, in sampled time.
///
/// Inputs are held over a step; outputs are those that a bed would record for the interval (lambda is averaged over
/// it, torque is the sensor's value at its end).
pub trait Plant: Send {
    /// Variables: inputs first, in the order that [`Plant::step`] takes and fills them.
    fn variables(&self) -> &[Variable];

    /// Back to the start state and start inputs; sensor noise restarts from `seed`.
    fn reset(&mut self, seed: u64);

    /// Holds `inputs` for `dt_s` and fills `outputs` (one value for each output variable).
    ///
    /// # Errors
    /// [`PlantError`] when an input is outside its range or not finite; the state is then unchanged.
    fn step(&mut self, inputs: &[f64], dt_s: f64, outputs: &mut [f64]) -> Result<(), PlantError>;

    /// Fills `outputs` with what the plant shows now: what the last [`Plant::step`] gave, or after [`Plant::reset`] the start
    /// values. They are part of the state, saved and restored with it. A record that begins without a wait takes its first
    /// row from here.
    ///
    /// # Errors
    /// [`PlantError::Call`] where the number of outputs does not fit, or a foreign plant does not tell.
    fn outputs(&self, outputs: &mut [f64]) -> Result<(), PlantError>;

    /// Time in s since the last reset.
    fn time_s(&self) -> f64;

    /// Limits that were touched since the last call (drained).
    fn take_events(&mut self) -> Vec<LimitEvent>;

    /// The whole state, sensors and noise included.
    fn save(&self) -> PlantState;

    /// Continues from a saved state exactly.
    ///
    /// # Errors
    /// [`PlantError::Call`] when the state is not this plant's.
    fn restore(&mut self, state: &PlantState) -> Result<(), PlantError>;

    /// Name, parameter set and version, for the origin of records.
    fn describe(&self) -> String;
}

/// Fills `outputs` from `shown`: for plants that keep what they gave last.
///
/// # Errors
/// [`PlantError::Call`] with both numbers where they differ.
pub fn show(shown: &[f64], outputs: &mut [f64]) -> Result<(), PlantError> {
    if shown.len() != outputs.len() {
        let (found, expected) = (outputs.len(), shown.len());
        return Err(PlantError::Call(format!("{found} outputs asked for: expected {expected}")));
    }
    outputs.copy_from_slice(shown);
    Ok(())
}

/// Index of variable `name` among the plant's inputs (or outputs).
///
/// # Errors
/// [`PlantError::Call`] with the names there are.
pub fn variable_index(plant: &dyn Plant, causality: Causality, name: &str) -> Result<usize, PlantError> {
    let names: Vec<&str> =
        plant.variables().iter().filter(|v| v.causality == causality).map(|v| v.name.as_str()).collect();
    names.iter().position(|n| *n == name).ok_or_else(|| {
        PlantError::Call(format!(
            "{} has no {causality:?} `{name}`; there are: {}",
            plant.describe(),
            names.join(", ")
        ))
    })
}
