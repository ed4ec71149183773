//! Records of an engine as the thesis took them: random inputs in open loop (section 5.5) and references in closed loop
//! (section 7.4.1).

use std::path::Path;

use dynocal_files::{FilesError, csv_io};
use dynocal_ident::data::{Channel, Dataset, Role};
use dynocal_ident::plan::Plan;
use dynocal_ident::play::{Unwatched, play};
use dynocal_numerics::interval::Interval;
use dynocal_numerics::rng::Rng64;
use rayon::prelude::*;
use serde::Serialize;

use super::excite::{ExciteSpec, plan_of, references};
use super::gains::LoopGains;
use super::plans::{ActuatorLimits, engine_plan};
use super::{Chapter5Error, udrn};
use dynocal_jobs::calibrate::context::PlantFactory;

/// Least fuel in mg that the loops use: a motored cylinder has no lambda that a loop could hold.
const MIN_FUEL_MG: f64 = 1.0;
/// Throttle angle in deg above which nothing changes any more.
const OPEN_THROTTLE_DEG: f64 = 60.0;

/// Sample time of both sections in s.
pub const SAMPLE_TIME_S: f64 = 0.03;
/// Time before a record, so that it does not begin with the start of the engine, in s.
const LEAD_IN_S: f64 = 3.0;

/// Uniform random inputs in open loop at constant speed, box (5.12).
#[derive(Clone, Debug, Serialize)]
pub struct OpenLoop {
    /// Fuel in mg.
    pub inj_mg: Interval,
    /// Spark advance in deg.
    pub spark_deg: Interval,
    /// Throttle angle in deg.
    pub throttle_deg: Interval,
    /// Speed in rpm; the thesis does not say.
    pub speed_rpm: f64,
    /// Time at each value in s; the thesis does not say.
    pub hold_s: f64,
    /// Lambda above this is recorded as this; the thesis does not say what its sensor does without fuel.
    pub lambda_cap: f64,
    /// Length in s.
    pub record_s: f64,
}

impl Default for OpenLoop {
    /// Hold and cap as section 9 of the engine's specification, which matches the spread of the thesis' outputs.
    fn default() -> Self {
        Self {
            inj_mg: Interval::new(0.0, 35.0),
            spark_deg: Interval::new(5.0, 30.0),
            throttle_deg: Interval::new(5.0, 20.0),
            speed_rpm: 2000.0,
            hold_s: 0.6,
            lambda_cap: 5.0,
            record_s: 60.0,
        }
    }
}

/// Records under random inputs, streams `first..first + count` of `seed`, in parallel.
///
/// # Errors
/// [`Chapter5Error::Plant`], [`Chapter5Error::Interrupted`].
pub fn open_loop(
    plants: PlantFactory,
    spec: &OpenLoop,
    seed: u64,
    count: u64,
    interrupt: &(dyn Fn() -> bool + Sync),
) -> Result<Vec<Dataset>, Chapter5Error> {
    all(count, interrupt, |k| {
        let n = (spec.record_s / SAMPLE_TIME_S).round() as usize;
        let mut rng = Rng64::stream(seed, k);
        let mut draw = |range: Interval| udrn(range.into(), spec.hold_s, n, SAMPLE_TIME_S, &mut rng);
        let columns = [draw(spec.inj_mg)?, draw(spec.spark_deg)?, draw(spec.throttle_deg)?];
        let rows: Vec<[f64; 4]> =
            (0..n).map(|t| [columns[0][t], columns[1][t], columns[2][t], spec.speed_rpm]).collect();
        let limits = ActuatorLimits {
            inj_mg: spec.inj_mg,
            spark_deg: spec.spark_deg,
            throttle_deg: spec.throttle_deg,
        };
        let name = format!("random{k:02}");
        let plan = engine_plan(&name, SAMPLE_TIME_S, &rows, &[], LoopGains::RETUNED, limits, LEAD_IN_S);
        let mut record = measure(plants, &plan)?;
        for channel in record.channels.iter_mut().filter(|c| c.name == "lambda") {
            channel.values.iter_mut().for_each(|v| *v = v.min(spec.lambda_cap));
        }
        Ok(record)
    })
}

/// The closed loop of section 7.4.1: APRBS of torque and lambda demand and of spark within (7.6), speed swept between
/// its ends, loops with the gains of `spec`.
pub fn closed_loop_spec() -> ExciteSpec {
    ExciteSpec { torque_nm: Interval::new(0.0, 100.0), ..ExciteSpec::default() }
}

/// Records in closed loop, streams `0..count` of `seed`, each with a speed sweep of another period, in parallel.
///
/// # Errors
/// [`Chapter5Error::Plant`], [`Chapter5Error::Interrupted`].
pub fn closed_loop(
    plants: PlantFactory,
    spec: &ExciteSpec,
    gains: LoopGains,
    seed: u64,
    count: u64,
    interrupt: &(dyn Fn() -> bool + Sync),
) -> Result<Vec<Dataset>, Chapter5Error> {
    all(count, interrupt, |k| {
        // Periods differ by a number that shares no multiple with the hold time, so that no two records repeat.
        let sweep_s = spec.sweep_s + 0.37 * k as f64;
        let references = references(spec, sweep_s, SAMPLE_TIME_S, &mut Rng64::stream(seed, k))?;
        let limits = ActuatorLimits {
            inj_mg: Interval::new(MIN_FUEL_MG, 35.0),
            spark_deg: spec.spark_deg,
            throttle_deg: Interval::new(0.0, OPEN_THROTTLE_DEG),
        };
        let (name, rows) = (format!("loop{k:02}"), plan_of(&references));
        measure(
            plants,
            &engine_plan(&name, SAMPLE_TIME_S, &rows, &references.demand, gains, limits, LEAD_IN_S),
        )
    })
}

fn all(
    count: u64,
    interrupt: &(dyn Fn() -> bool + Sync),
    one: impl Fn(u64) -> Result<Dataset, Chapter5Error> + Sync,
) -> Result<Vec<Dataset>, Chapter5Error> {
    let checked = |k| if interrupt() { Err(Chapter5Error::Interrupted) } else { one(k) };
    (0..count).into_par_iter().map(checked).collect::<Vec<_>>().into_iter().collect()
}

fn measure(plants: PlantFactory, plan: &Plan) -> Result<Dataset, Chapter5Error> {
    let mut plant = plants(false)?;
    plant.reset(0);
    Ok(play(plant.as_mut(), plan, &mut Unwatched)?.whole()?.record)
}

/// An engine record of the reference data: columns `INJ_mg`, `SA_deg`, `theta_deg`, `N_rpm`, `T_Nm`, `lambda`.
///
/// # Errors
/// [`Chapter5Error::Files`] with what is wrong in the file.
pub fn read(path: &Path) -> Result<Dataset, Chapter5Error> {
    let table = csv_io::read(path)?;
    let columns = [
        ("INJ_mg", "inj", "mg", Role::Input),
        ("SA_deg", "spark", "deg", Role::Input),
        ("theta_deg", "throttle", "deg", Role::Input),
        ("N_rpm", "speed", "rpm", Role::Input),
        ("T_Nm", "torque", "Nm", Role::Output),
        ("lambda", "lambda", "-", Role::Output),
    ];
    let channels = columns
        .into_iter()
        .map(|(column, name, unit, role)| {
            let values = table.numbers(column, 0, table.rows())?.to_vec();
            Ok(Channel { name: name.into(), unit: unit.into(), role, values })
        })
        .collect::<Result<Vec<_>, FilesError>>()?;
    let name = path.file_stem().map(|n| n.to_string_lossy().into_owned()).unwrap_or_default();
    Ok(Dataset {
        name,
        sample_time_s: SAMPLE_TIME_S,
        channels,
        init_samples: 0,
        origin: "reference data".into(),
    })
}

/// Variance of a channel about its mean.
pub fn variance(values: &[f64]) -> f64 {
    let n = values.len() as f64;
    let mean = values.iter().sum::<f64>() / n;
    values.iter().map(|v| (v - mean).powi(2)).sum::<f64>() / n
}
