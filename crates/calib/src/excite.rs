//! Excitation in closed loop (thesis section 7.4.1): references for the loops, and the records they give.

use crate::control::LoopGains;
use crate::record::{ActuatorLimits, Bed, Demand, Plan, run_plan};
use dynocal_ident::data::Dataset;
use dynocal_ident::plant::PlantError;
use dynocal_ident::signal;
use dynocal_numerics::registry::BuildError;
use dynocal_numerics::rng::Rng64;
use serde::{Deserialize, Serialize};

/// A range of a reference.
pub type Range = (f64, f64);

/// The excitation of one campaign.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct ExciteSpec {
    /// Gains of the loops: `retuned`, `thesis` (eq. 7.5), `static` (eq. 6.1).
    pub gains: String,
    /// Length of one record in s.
    pub record_s: f64,
    /// Identification records.
    pub identification_records: usize,
    /// Validation records, of other seeds and speed periods.
    pub validation_records: usize,
    /// Demanded torque in Nm.
    pub torque_nm: Range,
    /// Demanded lambda.
    pub lambda: Range,
    /// Spark advance in deg BTDC.
    pub spark_deg: Range,
    /// Engine speed in rpm.
    pub speed_rpm: Range,
    /// Levels of the APRBS.
    pub levels: usize,
    /// Hold time of the APRBS in s.
    pub hold_s: f64,
    /// Duration of a speed sweep from end to end, in s.
    pub sweep_s: f64,
    /// Dwell at both ends of the speed sweep in s.
    pub dwell_s: f64,
}

impl Default for ExciteSpec {
    fn default() -> Self {
        Self {
            gains: "retuned".into(),
            record_s: 60.0,
            identification_records: 2,
            validation_records: 3,
            torque_nm: (10.0, 90.0),
            lambda: (0.9, 1.1),
            spark_deg: (5.0, 30.0),
            speed_rpm: (1000.0, 3000.0),
            levels: 5,
            hold_s: 3.0,
            sweep_s: 7.0,
            dwell_s: 1.0,
        }
    }
}

/// References of one record.
#[derive(Clone, Debug)]
pub struct References {
    /// Torque and lambda demand.
    pub demand: Vec<Demand>,
    /// Spark advance in deg.
    pub spark_deg: Vec<f64>,
    /// Speed in rpm.
    pub speed_rpm: Vec<f64>,
}

/// 5-level APRBS on torque, lambda and spark, displaced by thirds of the hold time, and a triangular speed sweep.
///
/// # Errors
/// [`BuildError`] when the spec does not fit the signals.
pub fn references(
    spec: &ExciteSpec,
    sweep_s: f64,
    sample_time_s: f64,
    rng: &mut Rng64,
) -> Result<References, BuildError> {
    let n = (spec.record_s / sample_time_s).round() as usize;
    let mut aprbs = |range: Range, third: f64| -> Result<Vec<f64>, BuildError> {
        let keys = table(&[
            ("min", range.0),
            ("max", range.1),
            ("hold_s", spec.hold_s),
            ("offset_s", third * spec.hold_s / 3.0),
        ]);
        let mut keys = keys;
        keys.insert("levels".into(), toml::Value::Integer(spec.levels as i64));
        let mut u = vec![0.0; n];
        signal::signal("aprbs", &keys)?.fill(&mut u, sample_time_s, rng)?;
        Ok(u)
    };
    let torque = aprbs(spec.torque_nm, 0.0)?;
    let lambda = aprbs(spec.lambda, 1.0)?;
    let spark_deg = aprbs(spec.spark_deg, 2.0)?;
    let keys = table(&[
        ("min", spec.speed_rpm.0),
        ("max", spec.speed_rpm.1),
        ("rise_s", sweep_s),
        ("dwell_s", spec.dwell_s),
    ]);
    let mut speed_rpm = vec![0.0; n];
    signal::signal("triangle", &keys)?.fill(&mut speed_rpm, sample_time_s, rng)?;
    let demand =
        torque.iter().zip(&lambda).map(|(t, l)| Demand { torque_nm: *t, lambda: *l }).collect();
    Ok(References { demand, spark_deg, speed_rpm })
}

fn table(pairs: &[(&str, f64)]) -> toml::Table {
    pairs.iter().map(|(k, v)| ((*k).to_string(), toml::Value::Float(*v))).collect()
}

/// Runs references in closed loop and records the experiment.
///
/// # Errors
/// [`PlantError`] of the plant.
pub fn run_references(
    bed: &mut Bed,
    name: &str,
    references: &References,
    gains: LoopGains,
    limits: ActuatorLimits,
) -> Result<Dataset, PlantError> {
    let first = references.demand.first().map_or(50.0, |d| d.torque_nm);
    // A rough start point; the loops find the rest while the record has not begun.
    let (inj, throttle) = (4.0 + 0.18 * first, 5.0 + 0.15 * first);
    let feedforward: Vec<[f64; 4]> = references
        .spark_deg
        .iter()
        .zip(&references.speed_rpm)
        .map(|(spark, speed)| [inj, *spark, throttle, *speed])
        .collect();
    let plan = Plan { feedforward: &feedforward, demand: &references.demand, gains, limits, settle_s: 3.0 };
    run_plan(bed, name, &plan)
}
