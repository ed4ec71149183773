//! Steady points as an engine controller holds them: a map over speed and torque, or full load over speed.

mod page;
mod work;

use dynocal_plant::full_load::{Barrier, LoadLimits, LoadPoint};
use serde::Serialize;

pub use page::report;
pub use work::run;

use super::EngineJobError;
use super::quantities::Point;

/// Equal steps from the first to the last value.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Grid {
    /// First value.
    pub from: f64,
    /// Last value.
    pub to: f64,
    /// Number of values: 2 to [`MOST_VALUES`], or 1 where both values are equal.
    pub count: f64,
}

/// Most values of a grid.
pub const MOST_VALUES: f64 = 100.0;

impl Grid {
    /// The values; `name` is that of the grid in messages.
    ///
    /// # Errors
    /// [`EngineJobError::Grid`].
    ///
    /// ```
    /// use dynocal_jobs::engine::load::Grid;
    /// let grid = Grid { from: 1000.0, to: 2000.0, count: 3.0 };
    /// assert_eq!(grid.values("speed")?, [1000.0, 1500.0, 2000.0]);
    /// assert!(Grid { from: 2.0, to: 1.0, count: 2.0 }.values("speed").is_err());
    /// # Ok::<(), dynocal_jobs::engine::EngineJobError>(())
    /// ```
    pub fn values(&self, name: &'static str) -> Result<Vec<f64>, EngineJobError> {
        let Self { from, to, count } = *self;
        if from == to && count == 1.0 {
            return Ok(vec![from]);
        }
        if !(from < to && (2.0..=MOST_VALUES).contains(&count) && count.fract() == 0.0) {
            return Err(EngineJobError::Grid { name, from, to, count });
        }
        Ok((0..count as usize).map(|k| from + (to - from) * k as f64 / (count - 1.0)).collect())
    }
}

/// Which points.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub enum What {
    /// Every speed with every torque.
    Map {
        /// Torques in Nm.
        torque_nm: Grid,
    },
    /// Every speed with the most torque up to this one in Nm.
    FullLoad {
        /// Torque that is not exceeded, in Nm.
        torque_nm: f64,
    },
}

/// Points and what they must not pass.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Spec {
    /// Which points.
    pub what: What,
    /// Speeds in rpm.
    pub speed_rpm: Grid,
    /// Limits.
    pub limits: LoadLimits,
}

/// What the points give.
#[derive(Clone, Debug, Serialize)]
pub struct Loaded {
    /// Speeds in rpm.
    pub speeds_rpm: Vec<f64>,
    /// Torques in Nm.
    pub torques_nm: Vec<f64>,
    /// By speed, then by torque.
    pub rows: Vec<Vec<LoadPoint>>,
    /// Whether it is full load: then the torque asked for is a bound, and none is out of reach.
    pub full_load: bool,
    /// Points that did not come to rest, and points of a map that are out of reach, with the reason.
    pub warnings: Vec<String>,
}

impl Loaded {
    /// The points, speed by speed; a map leaves out what is out of reach.
    pub fn points(&self) -> Vec<Point> {
        self.rows.iter().flatten().filter(|p| self.full_load || p.reached).map(point).collect()
    }

    /// Whether every point was reached and came to rest.
    pub fn valid(&self) -> bool {
        self.warnings.is_empty()
    }
}

/// What holds the torque of a point, in words.
pub fn held_by(p: &LoadPoint) -> &'static str {
    p.barrier.map_or("the torque asked for", Barrier::reason)
}

fn point(p: &LoadPoint) -> Point {
    Point { inputs: p.inputs, outputs: p.outputs }
}
