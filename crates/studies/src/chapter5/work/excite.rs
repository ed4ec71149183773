//! Excitation in closed loop (thesis section 7.4.1): references for the loops.

use super::plans::Demand;
use dynocal_ident::signal;
use dynocal_numerics::interval::Interval;
use dynocal_numerics::registry::BuildError;
use dynocal_numerics::rng::Rng64;
use serde::{Deserialize, Serialize};

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
    pub torque_nm: Interval,
    /// Demanded lambda.
    pub lambda: Interval,
    /// Spark advance in deg BTDC.
    pub spark_deg: Interval,
    /// Engine speed in rpm.
    pub speed_rpm: Interval,
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
            torque_nm: Interval::new(10.0, 90.0),
            lambda: Interval::new(0.9, 1.1),
            spark_deg: Interval::new(5.0, 30.0),
            speed_rpm: Interval::new(1000.0, 3000.0),
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
    let mut level = |range: Interval, third: f64| {
        aprbs(range, spec.levels, spec.hold_s, third * spec.hold_s / 3.0, n, sample_time_s, rng)
    };
    let torque = level(spec.torque_nm, 0.0)?;
    let lambda = level(spec.lambda, 1.0)?;
    let spark_deg = level(spec.spark_deg, 2.0)?;
    let speed_rpm = speed_sweep(spec, sweep_s, n, sample_time_s)?;
    let demand = torque.iter().zip(&lambda).map(|(t, l)| Demand { torque_nm: *t, lambda: *l }).collect();
    Ok(References { demand, spark_deg, speed_rpm })
}

/// `n` samples of an APRBS.
///
/// # Errors
/// [`BuildError`] when the numbers do not fit the signal.
pub fn aprbs(
    range: Interval,
    levels: usize,
    hold_s: f64,
    phase_s: f64,
    n: usize,
    sample_time_s: f64,
    rng: &mut Rng64,
) -> Result<Vec<f64>, BuildError> {
    let mut keys =
        table(&[("lo", range.lower), ("hi", range.upper), ("hold_s", hold_s), ("phase_s", phase_s)]);
    keys.insert("levels".into(), toml::Value::Integer(levels as i64));
    let mut u = vec![0.0; n];
    signal::signal("aprbs", &keys)?.fill(&mut u, sample_time_s, rng)?;
    Ok(u)
}

/// `n` samples of the triangular speed sweep, `sweep_s` from end to end.
///
/// # Errors
/// [`BuildError`] when the numbers do not fit the signal.
pub fn speed_sweep(
    spec: &ExciteSpec,
    sweep_s: f64,
    n: usize,
    sample_time_s: f64,
) -> Result<Vec<f64>, BuildError> {
    let keys = table(&[
        ("lo", spec.speed_rpm.lower),
        ("hi", spec.speed_rpm.upper),
        ("period_s", 2.0 * (sweep_s + spec.dwell_s)),
        ("dwell_s", spec.dwell_s),
    ]);
    let mut u = vec![0.0; n];
    // The sweep has nothing random in it.
    signal::signal("sweep", &keys)?.fill(&mut u, sample_time_s, &mut Rng64::new(0))?;
    Ok(u)
}

fn table(pairs: &[(&str, f64)]) -> toml::Table {
    pairs.iter().map(|(k, v)| ((*k).to_string(), toml::Value::Float(*v))).collect()
}

/// Feedforward rows for running references in closed loop: spark and speed as asked, fuel and throttle at a rough
/// start point from which the loops go on.
pub fn plan_of(references: &References) -> Vec<[f64; 4]> {
    let first = references.demand.first().map_or(50.0, |d| d.torque_nm);
    let (inj, throttle) = (4.0 + 0.18 * first, 5.0 + 0.15 * first);
    let rows = references.spark_deg.iter().zip(&references.speed_rpm);
    rows.map(|(spark, speed)| [inj, *spark, throttle, *speed]).collect()
}
