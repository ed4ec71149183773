//! What the tasks of the study `engine` write, and how its checks and tables read it again.

use super::class_values::SparkSweep;
use super::transients::{RECORD_S, Response, settling_s};
use super::verification::MapPoint;
use super::{STATIC, TRANSIENTS};
use crate::{TaskResult, result};
use dynocal_numerics::interval::Interval;
use dynocal_plant::full_load::LoadPoint;
use dynocal_plant::outputs::Outputs;
use dynocal_plant::statics::{StaticPoint, Target};
use serde::{Deserialize, Serialize};

/// A point of the static map, or why there is none.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub(super) struct StaticRow {
    /// What was asked for.
    pub(super) target: Target,
    /// What was found.
    pub(super) point: Option<MapPoint>,
    /// Why nothing was.
    pub(super) error: Option<String>,
    /// The reference table has the point.
    pub(super) referenced: bool,
    /// Differences from it, in the order of its tolerances.
    pub(super) difference: Option<[f64; 5]>,
}

impl StaticRow {
    /// Something of the best setting.
    pub(super) fn best(&self, of: impl Fn(&StaticPoint) -> f64) -> Option<f64> {
        self.point.as_ref().map(|p| of(&p.best))
    }
}

/// The static map at one speed, or all of it.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub(super) struct StaticRows {
    /// Points.
    pub(super) points: Vec<StaticRow>,
    /// There was a reference table.
    pub(super) compared: bool,
}

/// The static map of all speeds; none when the result of one cannot be read.
pub(super) fn static_rows(results: &[TaskResult]) -> Option<StaticRows> {
    let mut all = StaticRows { points: Vec::new(), compared: false };
    for r in results.iter().filter(|r| r.name.starts_with(STATIC)) {
        let one: StaticRows = result(results, &r.name)?;
        all.points.extend(one.points);
        all.compared |= one.compared;
    }
    Some(all)
}

/// The points at 2000 rpm.
pub(super) fn rows_at_2000(results: &[TaskResult]) -> Vec<StaticRow> {
    result::<StaticRows>(results, &format!("{STATIC}2000")).map_or_else(Vec::new, |r| r.points)
}

/// Torque \[Nm\] and fuel \[mg\] at 2000 rpm.
pub(super) fn fuel_line(results: &[TaskResult]) -> (Vec<f64>, Vec<f64>) {
    let rows = rows_at_2000(results);
    rows.iter().filter_map(|r| Some((r.target.torque_nm, r.best(|p| p.inputs.injection_mg)?))).unzip()
}

/// Fuel and torque against spark at 2000 rpm, 70 Nm.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub(super) struct SparkAt70 {
    /// Spark advance \[deg BTDC\].
    pub(super) spark_deg: Vec<f64>,
    /// Fuel at constant torque \[mg\].
    pub(super) fuel_mg: Vec<f64>,
    /// Torque at constant air and fuel \[Nm\].
    pub(super) torque_nm: Vec<f64>,
    /// Maxima of that torque.
    pub(super) maxima: usize,
    /// Largest second difference of that torque \[Nm\].
    pub(super) largest_second_difference_nm: f64,
}

/// A response and its numbers; none where it never settles or rises.
#[derive(Clone, Debug, Default, Serialize, Deserialize)]
pub(super) struct Transient {
    /// Name.
    pub(super) name: String,
    /// Least and greatest lambda.
    pub(super) lambda_min: f64,
    pub(super) lambda_max: f64,
    /// Lambda at the end.
    pub(super) lambda_end: Option<f64>,
    /// From 10 to 90 % of the torque's change \[s\].
    pub(super) rise_s: Option<f64>,
    /// Until the torque stays within 1 Nm of its end \[s\].
    pub(super) torque_settling_s: Option<f64>,
    /// Until lambda stays within 0.01 of 1 \[s\].
    pub(super) lambda_settling_s: Option<f64>,
    /// Torque sensor \[Nm\].
    pub(super) torque_nm: Vec<f64>,
    /// Lambda \[-\].
    pub(super) lambda: Vec<f64>,
}

impl Transient {
    /// A response without what is particular to its kind.
    pub(super) fn new(name: &str, r: &Response) -> Self {
        let Interval { lower: lambda_min, upper: lambda_max } = r.lambda_range();
        Self {
            name: name.into(),
            lambda_min,
            lambda_max,
            lambda_end: r.lambda.last().copied(),
            torque_nm: r.torque_nm.clone(),
            lambda: r.lambda.clone(),
            ..Self::default()
        }
    }

    /// The same with its settling to a torque and to lambda 1.
    pub(super) fn settling_to(self, torque_nm: f64) -> Self {
        let finite = |v: f64| v.is_finite().then_some(v);
        let torque_settling_s = finite(settling_s(&self.torque_nm, torque_nm, 1.0, RECORD_S));
        let lambda_settling_s = finite(settling_s(&self.lambda, 1.0, 0.01, RECORD_S));
        Self { torque_settling_s, lambda_settling_s, ..self }
    }
}

/// All transients; empty when they cannot be read.
pub(super) fn transients(results: &[TaskResult]) -> Vec<Transient> {
    result(results, TRANSIENTS).unwrap_or_default()
}

/// A point of a grid of loads, or why there is none.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub(super) struct GridPoint {
    /// What was held.
    pub(super) point: Option<LoadPoint>,
    /// Why nothing was.
    pub(super) error: Option<String>,
}

/// Points over speed and torque.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub(super) struct Grid {
    /// Speeds \[rpm\].
    pub(super) speed_rpm: Vec<f64>,
    /// Torques \[Nm\].
    pub(super) torque_nm: Vec<f64>,
    /// Points, a row for each speed.
    pub(super) rows: Vec<Vec<GridPoint>>,
}

/// A spark sweep at one speed and torque.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub(super) struct SparkSweepAt {
    /// Speed \[rpm\].
    pub(super) speed_rpm: f64,
    /// Torque at best spark \[Nm\].
    pub(super) torque_nm: f64,
    /// The sweep.
    pub(super) sweep: SparkSweep,
}

/// A sweep of lambda.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub(super) struct Mixture {
    /// Lambda \[-\].
    pub(super) lambda: Vec<f64>,
    /// Outputs at each.
    pub(super) outputs: Vec<Outputs>,
}

/// A sweep of the intake cam.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub(super) struct Cams {
    /// Maximum opening point \[deg BTDC firing\].
    pub(super) intake_deg: Vec<f64>,
    /// Outputs at each.
    pub(super) outputs: Vec<Outputs>,
}
