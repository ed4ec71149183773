//! The engine on its bed, driven by inputs of a file or by a plan with its loops and limits.

mod events;
mod file;
mod page;
mod work;

use std::path::PathBuf;

use dynocal_ident::data::Channel;
use dynocal_ident::plant::LimitEvent;
use dynocal_plant::testbed::guard::Trip;
use serde::Serialize;

pub use events::{APART_S, EventGroup, grouped};
pub use file::DriveFileError;
pub use page::report;
pub use work::{csv, run};

/// Sample time in s where none is given.
pub const EVERY_S: f64 = 0.01;
/// Most values (samples times variables) that a record may have: 400 MB in memory.
pub const MOST_VALUES: f64 = 5e7;

/// When samples are taken.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub enum Every {
    /// Nothing was said: [`EVERY_S`], or the sample time of the plan.
    Default,
    /// Seconds.
    Time {
        /// Sample time in s.
        every_s: f64,
    },
    /// Degrees of the crankshaft: 1 a degree, 180 a stroke, 720 a cycle.
    Angle {
        /// Degrees.
        every_deg: f64,
    },
}

/// A record on the bed.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Spec {
    /// Inputs over time (each row holds until the next, inputs without a column stay at their start), or a plan of two files
    /// (NAME.plan.csv with NAME.plan.json beside it) that is played with its loops and limits.
    pub file: PathBuf,
    /// Bed: a TOML file with the keys of `[plant.bed]`; the set's own without it.
    pub bed: Option<PathBuf>,
    /// When samples are taken.
    pub every: Every,
    /// Seed of sensor noise and of the scatter of cycles.
    pub seed: u64,
}

/// What was recorded.
#[derive(Clone, Debug, Serialize)]
pub struct Transient {
    /// The bed in words.
    pub bed: String,
    /// Time of every sample in s.
    pub time_s: Vec<f64>,
    /// Every variable of the bed, inputs first, or the channels of the plan.
    pub channels: Vec<Channel>,
    /// Limits that were touched.
    pub events: Vec<LimitEvent>,
    /// Trips among them, with their ends.
    pub trips: Vec<Trip>,
    /// Why a plan ended early.
    pub stop: Option<String>,
    /// Whether the user stopped it.
    pub interrupted: bool,
}

impl Transient {
    /// Whether the record is whole: a part of a record is no result of it.
    pub fn whole(&self) -> bool {
        !self.interrupted && self.stop.is_none()
    }
}
