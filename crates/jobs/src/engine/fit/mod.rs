//! An engine fitted to a measured map: physical constants by nonlinear least squares, judged on points it has not seen.
//!
//! Each row of the map is driven as it was measured ([`dynocal_plant::driven`]); what is compared is torque, air, exhaust
//! temperature and the pressures before and behind the turbine, each over the error that is asked for:
//!
//! ```text
//! minimise  sum_points sum_q ((y_q(x) - m_q) / asked_q)^2,   low <= x <= high
//! ```
//!
//! over two thirds of the rows; every third row judges. The ranges of [`constants::CONSTANTS`] are those of real engines.

pub mod constants;
mod page;
mod problem;
pub mod read;
pub mod store;
mod work;

use std::path::PathBuf;

use dynocal_numerics::interval::Interval;
use dynocal_numerics::status::Status;
use dynocal_plant::driven::Answer;
use dynocal_plant::params::EngineParams;
use serde::Serialize;

pub use page::report;
pub use work::{judge, run};

use self::read::Measured;

/// Every row with this remainder of its number by three judges, the others are fitted.
pub const JUDGED_OF_THREE: usize = 2;

/// What is fitted.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Spec {
    /// The measured map.
    pub map: PathBuf,
    /// Most evaluations of the residuals.
    pub evaluations: usize,
}

/// A quantity that is compared.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Compared {
    /// Brake torque.
    Torque,
    /// Air flow.
    Air,
    /// Exhaust-manifold temperature.
    ExhaustTemperature,
    /// Exhaust-manifold pressure.
    ExhaustPressure,
    /// Pressure behind the turbine.
    SystemPressure,
}

/// All of them, in the order of residuals.
pub const COMPARED: [Compared; 5] = [
    Compared::Torque,
    Compared::Air,
    Compared::ExhaustTemperature,
    Compared::ExhaustPressure,
    Compared::SystemPressure,
];

impl Compared {
    /// Name, root mean square error that is asked for, its unit.
    pub fn asked(self) -> (&'static str, f64, &'static str) {
        match self {
            Self::Torque => ("torque", 5.0, "Nm"),
            Self::Air => ("air", 3.0, "%"),
            Self::ExhaustTemperature => ("exhaust temperature", 20.0, "K"),
            Self::ExhaustPressure => ("exhaust pressure", 6.0, "%"),
            Self::SystemPressure => ("pressure behind the turbine", 6.0, "%"),
        }
    }

    /// Whether it was measured.
    pub fn measured(self, m: &Measured) -> bool {
        let value = match self {
            Self::Torque => m.torque_nm,
            Self::Air => m.air_kg_s,
            Self::ExhaustTemperature => m.exhaust_k,
            Self::ExhaustPressure => m.exhaust_pa,
            Self::SystemPressure => m.system_pa,
        };
        value.is_some()
    }

    /// Error of an answer, in the unit of what is asked; none where it was not measured.
    pub fn error(self, y: &Answer, m: &Measured) -> Option<f64> {
        let share = |y: f64, m: f64| 100.0 * (y / m - 1.0);
        match self {
            Self::Torque => m.torque_nm.map(|m| y.torque_nm - m),
            Self::Air => m.air_kg_s.map(|m| share(y.air_kg_s, m)),
            Self::ExhaustTemperature => m.exhaust_k.map(|m| y.exhaust_k - m),
            Self::ExhaustPressure => m.exhaust_pa.map(|m| share(y.exhaust_pa, m)),
            Self::SystemPressure => m.system_pa.map(|m| share(y.system_pa, m)),
        }
    }
}

/// A fitted constant.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Fitted {
    /// Key as in a parameter file.
    pub key: &'static str,
    /// What it is.
    pub what: &'static str,
    /// Physical range.
    pub range: Interval,
    /// Value before.
    pub start: f64,
    /// Value found.
    pub value: f64,
    /// Half width of the interval of 95 % for independent errors; none where the points do not determine it.
    pub half_width: Option<f64>,
    /// What is to be said of it.
    pub note: Option<&'static str>,
}

/// Errors of one quantity.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Score {
    /// Quantity.
    pub quantity: &'static str,
    /// Unit of the errors.
    pub unit: &'static str,
    /// Root mean square that is asked for on the judged points.
    pub asked: f64,
    /// Number of judged points.
    pub points: usize,
    /// On the judged points before the fit.
    pub before: f64,
    /// On the fitted points.
    pub fitted: f64,
    /// On the judged points.
    pub judged: f64,
    /// Mean error of the judged points.
    pub bias: f64,
    /// Largest error of a judged point.
    pub worst: f64,
}

/// One row of the map.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Compare {
    /// Row of the file, from 1.
    pub row: usize,
    /// Whether it judges.
    pub judged: bool,
    /// What was measured.
    pub measured: Measured,
    /// What the engine answers.
    pub answer: Answer,
}

/// What a fit gives.
#[derive(Clone, Debug, Serialize)]
pub struct FitResult {
    /// Parameter set at the start.
    pub set: String,
    /// Constants.
    pub constants: Vec<Fitted>,
    /// Errors.
    pub scores: Vec<Score>,
    /// How the search ended.
    pub status: Status,
    /// Evaluations of all fitted points.
    pub evaluations: usize,
    /// Sum of the squared weighted errors over the number of them, at the start and at the end.
    pub cost: (f64, f64),
    /// Points that were fitted: two thirds of the map.
    pub fitted_points: usize,
    /// Condition of the derivatives at the end, each constant's column of unit length; none where they do not determine all.
    pub condition: Option<f64>,
    /// What was assumed, and what cannot be found from these points.
    pub notes: Vec<String>,
    /// Points that do not stand still, judged errors beyond what is asked.
    pub warnings: Vec<String>,
    /// The rows.
    #[serde(skip)]
    pub points: Vec<Compare>,
    /// The fitted engine.
    #[serde(skip)]
    pub params: Option<EngineParams>,
}

impl FitResult {
    /// Whether the search converged and every judged error is what is asked or less.
    pub fn valid(&self) -> bool {
        self.status.is_success() && self.scores.iter().all(|s| s.judged <= s.asked)
    }
}
