//! Errors of the virtual engine.

use dynocal_ident::data::UnitAfter;
use thiserror::Error;

/// What can go wrong when an engine is built, driven or asked to settle.
#[derive(Debug, Error)]
pub enum PlantError {
    /// A parameter is not finite or outside its physical range.
    #[error("engine parameter `{name}` = {found}: expected {expected}")]
    Parameter {
        /// Name as in the TOML file.
        name: &'static str,
        /// The value given.
        found: f64,
        /// What is allowed.
        expected: &'static str,
    },
    /// A parameter is not finite or outside its range.
    #[error("engine parameter `{name}` = {found}: expected {low} to {high}")]
    ParameterRange {
        /// Name as in the TOML file.
        name: &'static str,
        /// The value given.
        found: f64,
        /// Least allowed value.
        low: f64,
        /// Greatest allowed value.
        high: f64,
    },
    /// A parameter of a file is out of range.
    #[error("line {line}: {source}")]
    ParameterLine {
        /// Line of the file, from 1.
        line: usize,
        /// Which parameter and its range.
        source: Box<PlantError>,
    },
    /// A file with parameters has a fault.
    #[error("{file}: {source}")]
    ParameterFile {
        /// File.
        file: String,
        /// Line, parameter, what is allowed.
        source: Box<PlantError>,
    },
    /// No embedded parameter set has that name.
    #[error("no parameter set `{found}`: expected one of {known}, or a TOML file")]
    ParameterSet {
        /// The name given.
        found: String,
        /// The names that exist.
        known: String,
    },
    /// A key of the bed is out of range or names nothing.
    #[error("{key} = {found}: expected {expected}")]
    Bed {
        /// Key as in a spec.
        key: String,
        /// The value given.
        found: String,
        /// What is allowed.
        expected: String,
    },
    /// The parameter text is not valid TOML for [`crate::params::EngineParams`].
    #[error("engine parameters: {}", .0.to_string().trim_end())]
    Toml(#[from] Box<toml::de::Error>),
    /// An input is not finite or outside the box of the engine.
    #[error("input `{name}` = {found}{u}: expected {low}..{high}{u}", u = UnitAfter(.unit))]
    Input {
        /// Input name.
        name: &'static str,
        /// The value given.
        found: f64,
        /// Lower bound.
        low: f64,
        /// Upper bound.
        high: f64,
        /// Unit of the three numbers.
        unit: &'static str,
    },
    /// A snapshot belongs to an engine with another crank-angle grid.
    #[error("snapshot has {found} torque cells per cycle: expected {expected}")]
    Snapshot {
        /// Cells in the snapshot.
        found: usize,
        /// Cells of this engine.
        expected: usize,
    },
    /// The operating point was not reached in the time allowed.
    #[error(
        "no steady state at {speed_rpm} rpm, {torque_nm} Nm, spark {spark_deg} deg after {time_s:.1} s: \
         torque error {torque_error_nm:.3} Nm, lambda error {lambda_error:.4}"
    )]
    NotSettled {
        /// Engine speed.
        speed_rpm: f64,
        /// Torque asked for.
        torque_nm: f64,
        /// Spark advance.
        spark_deg: f64,
        /// Simulated time used.
        time_s: f64,
        /// Remaining torque error.
        torque_error_nm: f64,
        /// Remaining lambda error.
        lambda_error: f64,
    },
    /// The engine does not give the torque.
    #[error("{torque_nm} Nm at {speed_rpm} rpm is out of reach ({found_nm:.1} Nm were held): {reason}")]
    OutOfReach {
        /// Engine speed.
        speed_rpm: f64,
        /// Torque asked for.
        torque_nm: f64,
        /// Torque held.
        found_nm: f64,
        /// What stands in the way.
        reason: &'static str,
    },
    /// A number of the state is not finite: the step is too large or the inputs are unphysical.
    #[error("the gas state of volume {volume} is not finite or has negative mass at t = {time_s:.4} s")]
    Diverged {
        /// Volume number (0..3 cylinders, 4 charge pipe, 5 intake, 6 exhaust, 7 catalyst).
        volume: usize,
        /// Simulated time.
        time_s: f64,
    },
}
