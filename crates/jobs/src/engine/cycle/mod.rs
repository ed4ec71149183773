//! The engine in a car that follows a cycle of demanded speed.

mod file;
mod page;
mod work;

use dynocal_plant::vehicle::{DriveCycle, DriveLog, LoadUnits};
use serde::Serialize;

pub use file::read;
pub use page::report;
pub use work::{csv, run};

/// Longest cycle in s.
pub const MOST_SECONDS: f64 = 20_000.0;

/// A drive.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Spec {
    /// Name on the page.
    pub name: String,
    /// Speed over time.
    pub cycle: DriveCycle,
    /// Units in which the road-load coefficients of thesis Table 3.3 are read.
    pub units: LoadUnits,
    /// Slope of the road, as a share of the way.
    pub grade: f64,
}

/// What a drive gives.
#[derive(Clone, Debug, Serialize)]
pub struct Driven {
    /// Every step.
    pub log: DriveLog,
    /// The drive in numbers.
    pub facts: Vec<Fact>,
    /// Whether the drive was stopped before the end of the cycle.
    pub interrupted: bool,
}

/// A number of the drive.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Fact {
    /// What it is.
    pub name: &'static str,
    /// Value as it is shown.
    pub text: String,
    /// Unit.
    pub unit: &'static str,
}
