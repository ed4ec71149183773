//! Loops of test design and measurement: what a campaign does with designed records.

pub mod bed;
pub mod lambda_hold;
pub mod margin;
pub mod model;
pub mod plan;
pub mod pool;
pub mod rehearsal;
pub mod robust;
pub mod rounds;
pub mod shown;
pub mod stop;
pub mod variance;

use dynocal_design::error::DesignError;
use dynocal_design::search::Failure;
use dynocal_ident::data::DataError;
use dynocal_ident::estimate::EstimateError;
use dynocal_ident::plant::PlantError;
use dynocal_numerics::registry::BuildError;

/// A loop could not go on.
#[derive(Debug, thiserror::Error)]
pub enum LoopError {
    /// The plant refused a record.
    #[error(transparent)]
    Plant(#[from] PlantError),
    /// A record lacks something.
    #[error(transparent)]
    Data(#[from] DataError),
    /// An estimation failed.
    #[error(transparent)]
    Estimate(#[from] EstimateError),
    /// A design problem is wrong.
    #[error(transparent)]
    Problem(#[from] DesignError),
    /// A design failed.
    #[error(transparent)]
    Search(#[from] Failure),
    /// A name or a key is unknown.
    #[error(transparent)]
    Build(#[from] BuildError),
    /// A slice has the wrong length.
    #[error("{what}: found {found} values, expected {expected}")]
    Shape {
        /// What it is.
        what: &'static str,
        /// Length found.
        found: usize,
        /// Length expected, or a whole number of them.
        expected: usize,
    },
    /// A number is outside its meaning.
    #[error("{what}: found {found}, expected {expected}")]
    Number {
        /// What it is.
        what: &'static str,
        /// Value found.
        found: f64,
        /// What was expected.
        expected: &'static str,
    },
    /// A model cannot be run or its information is singular where it must not be.
    #[error("{what}: {reason}")]
    Model {
        /// Which model.
        what: String,
        /// What is wrong.
        reason: String,
    },
    /// Interrupted.
    #[error("interrupted")]
    Interrupted,
}
