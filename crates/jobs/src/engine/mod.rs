//! The virtual engine without a campaign: steady points, a map, full load, a drive cycle, a record on its bed.
//!
//! Each kind of run is arranged as every job: what is asked ([`steady::Spec`], [`load::Spec`], [`cycle::Spec`],
//! [`transient::Spec`]) is
//! checked, the work runs in memory under a watch and returns a typed result, its page draws it, and [`store`] writes the
//! files that were asked for.
//!
//! ```
//! use dynocal_jobs::engine::{Engine, steady};
//! use dynocal_numerics::watch::Watch;
//! let engine = Engine::named("thesis")?;
//! let motored = steady::Spec::Motored { speed_rpm: 2000.0, throttle_deg: 90.0 };
//! let found = steady::run(&engine, &motored, Watch::silent())?;
//! // Without fuel the engine takes torque.
//! assert!(found.points[0].outputs.torque_nm < 0.0);
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```

pub mod cycle;
pub mod fit;
pub mod load;
pub mod quantities;
pub mod steady;
pub mod store;
pub mod transient;

use dynocal_files::FilesError;
use dynocal_plant::error::PlantError;
use dynocal_plant::params::EngineParams;
use dynocal_plant::plants;
use dynocal_plant::vehicle::CycleError;

use crate::page::PageError;

/// An engine by the name of its parameters.
#[derive(Clone, Debug)]
pub struct Engine {
    /// Name of the parameter set, or the file.
    pub set: String,
    /// Parameters.
    pub params: EngineParams,
}

impl Engine {
    /// The engine of a name that `dynocal list parameters` shows, of `perturbed:SEED`, or of a file `*.toml`.
    ///
    /// # Errors
    /// [`EngineJobError::Plant`] with the names that there are.
    pub fn named(set: &str) -> Result<Self, EngineJobError> {
        Ok(Self { set: set.into(), params: plants::parameters(set)? })
    }
}

/// A run of the engine is not possible.
#[derive(Debug, thiserror::Error)]
pub enum EngineJobError {
    /// The engine refuses.
    #[error(transparent)]
    Plant(#[from] PlantError),
    /// A grid that is none.
    #[error(
        "{name} {from} {to} {count}: expected first below last and 2 to 100 values (1 where both are equal)"
    )]
    Grid {
        /// Which grid.
        name: &'static str,
        /// First value.
        from: f64,
        /// Last value.
        to: f64,
        /// Number of values.
        count: f64,
    },
    /// A number out of its range.
    #[error("{name} {found}: expected {expected}")]
    Number {
        /// Which number.
        name: String,
        /// Value.
        found: f64,
        /// What is allowed.
        expected: String,
    },
    /// An input that this engine does not have.
    #[error("{what}: this engine has no {lacked}")]
    Lacks {
        /// Input.
        what: &'static str,
        /// What it needs.
        lacked: &'static str,
    },
    /// A column in a unit that is not understood.
    #[error("{file}: column {column} is in {found}: expected {expected}")]
    Unit {
        /// File.
        file: String,
        /// Column.
        column: String,
        /// Its unit.
        found: String,
        /// Units that are.
        expected: &'static str,
    },
    /// A column that is not there.
    #[error("{file}: no column of {what} ({columns}): expected a column in {expected}")]
    Column {
        /// File.
        file: String,
        /// Quantity.
        what: &'static str,
        /// Columns that there are.
        columns: String,
        /// Units that are understood.
        expected: &'static str,
    },
    /// Times and speeds that are no cycle.
    #[error("{file}: {source}")]
    Cycle {
        /// File.
        file: String,
        /// Why.
        source: CycleError,
    },
    /// A file of inputs, or how it is to be sampled.
    #[error(transparent)]
    Drive(#[from] transient::DriveFileError),
    /// The bed fails.
    #[error(transparent)]
    Bed(#[from] dynocal_ident::plant::PlantError),
    /// A plan cannot be played.
    #[error("{file}: {source}")]
    Play {
        /// File.
        file: String,
        /// Why.
        source: dynocal_ident::play::PlayError,
    },
    /// Files.
    #[error(transparent)]
    Files(#[from] FilesError),
    /// The page.
    #[error(transparent)]
    Page(#[from] PageError),
    /// The user stopped it.
    #[error("interrupted: nothing was written, the same command begins anew")]
    Interrupted,
}
