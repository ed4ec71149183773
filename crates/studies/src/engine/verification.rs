//! What the engine is measured by: the static map, motored and full-throttle runs, spark sweeps.
//!
//! Everything here is computed by running the engine; what the numbers are compared with (thesis chapters 3, 6, 7,
//! a reference table, class values) is the business of the caller.

use dynocal_numerics::interval::Interval;
use dynocal_numerics::rng::Rng64;
use dynocal_plant::engine::VirtualEngine;
use dynocal_plant::error::PlantError;
use dynocal_plant::inputs::Inputs;
use dynocal_plant::params::EngineParams;
use dynocal_plant::statics::{
    SettleOptions, StaticPoint, Target, best_spark, settle, spark_guess_deg, steady,
};
use rayon::prelude::*;
use serde::{Deserialize, Serialize};

/// One point of the static map with what a wrong spark costs there.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct MapPoint {
    /// What was asked for.
    pub target: Target,
    /// Least fuel at that torque and lambda.
    pub best: StaticPoint,
    /// Fuel penalty at constant torque and lambda with the spark `off_deg` before and after the best one, the mean of
    /// both \[%\].
    pub penalty_pct: f64,
    /// Spark drawn at random \[deg BTDC\].
    pub random_spark_deg: f64,
    /// Fuel at that spark \[mg\]; none where the torque cannot be reached with it.
    pub random_injection_mg: Option<f64>,
}

/// What [`map_points`] does beside finding the best spark.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct MapOptions {
    /// Distance from the best spark of the fuel penalty \[deg\] (thesis 6.6: 3 deg).
    pub off_deg: f64,
    /// Range of the random spark \[deg BTDC\] (thesis 7: 5 to 30 deg).
    pub random_spark_deg: Interval,
    /// Seed of the random sparks.
    pub seed: u64,
    /// Number of the first point: its random spark is the same whichever call computes it.
    pub first: u64,
    /// Accuracy of each point.
    pub settle: SettleOptions,
}

impl Default for MapOptions {
    fn default() -> Self {
        Self {
            off_deg: 3.0,
            random_spark_deg: Interval::new(5.0, 30.0),
            seed: 1,
            first: 0,
            settle: SettleOptions::default(),
        }
    }
}

/// The static map at `targets`, with penalties; parallel over points, the same for any number of threads.
///
/// A point that cannot be reached carries its error as text.
///
/// # Errors
/// [`PlantError::Parameter`] when the engine cannot be built.
///
/// ```
/// use dynocal_plant::{params::EngineParams, statics::Target};
/// use dynocal_studies::engine::verification::*;
/// let target = Target { speed_rpm: 2000.0, torque_nm: 70.0, lambda: 1.0 };
/// let points = map_points(&EngineParams::thesis(), &[target], MapOptions::default())?;
/// let point = points[0].as_ref().unwrap();
/// assert!((point.best.inputs.spark_deg - 19.0).abs() < 1.0);
/// assert!(point.penalty_pct > 0.0 && point.penalty_pct < 1.0);
/// # Ok::<(), dynocal_plant::error::PlantError>(())
/// ```
pub fn map_points(
    params: &EngineParams,
    targets: &[Target],
    options: MapOptions,
) -> Result<Vec<Result<MapPoint, String>>, PlantError> {
    let engine = VirtualEngine::new(params)?;
    Ok(targets
        .par_iter()
        .enumerate()
        .map(|(k, t)| {
            map_point(engine.clone(), *t, options, options.first + k as u64).map_err(|e| e.to_string())
        })
        .collect())
}

fn map_point(
    mut engine: VirtualEngine,
    target: Target,
    options: MapOptions,
    stream: u64,
) -> Result<MapPoint, PlantError> {
    let guess = spark_guess_deg(target.speed_rpm, target.torque_nm);
    let best = best_spark(&mut engine, target, guess, options.settle)?;
    let spark = best.inputs.spark_deg;
    let mut off = [0.0; 2];
    for (mg, sign) in off.iter_mut().zip([-1.0, 1.0]) {
        let point = settle(&mut engine, target, spark + sign * options.off_deg, options.settle)?;
        *mg = at_target(&point, target);
    }
    let penalty_pct = 100.0 * (0.5 * (off[0] + off[1]) / at_target(&best, target) - 1.0);
    let Interval { lower: low, upper: high } = options.random_spark_deg;
    let random_spark_deg = Rng64::stream(options.seed, stream).uniform_in(low, high);
    let random = settle(&mut engine, target, random_spark_deg, options.settle).ok();
    let random_injection_mg = random.map(|p| p.inputs.injection_mg);
    Ok(MapPoint { target, best, penalty_pct, random_spark_deg, random_injection_mg })
}

/// Fuel \[mg\] with the torque error that settling leaves taken out (0.18 mg/Nm: slope of the fuel line).
fn at_target(point: &StaticPoint, target: Target) -> f64 {
    point.inputs.injection_mg + 0.18 * (target.torque_nm - point.outputs.torque_cycle_nm)
}

/// A row of a reference table of the static map.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct ReferencePoint {
    /// Speed \[rpm\].
    pub speed_rpm: f64,
    /// Torque \[Nm\].
    #[serde(rename = "torque_Nm")]
    pub torque_nm: f64,
    /// Best spark \[deg BTDC\].
    #[serde(rename = "spark_opt_degBTDC")]
    pub spark_deg: f64,
    /// Fuel \[mg\].
    #[serde(rename = "inj_mg")]
    pub injection_mg: f64,
    /// Throttle \[deg\].
    pub throttle_deg: f64,
    /// Intake-manifold pressure \[kPa\].
    #[serde(rename = "map_kPa")]
    pub map_kpa: f64,
    /// Exhaust temperature \[deg C\].
    #[serde(rename = "egt_C")]
    pub egt_c: f64,
}

impl ReferencePoint {
    /// Largest differences allowed: fuel \[%\], throttle \[deg\], manifold pressure \[%\], exhaust temperature \[K\],
    /// spark \[deg\].
    pub const TOLERANCES: [f64; 5] = [0.5, 0.1, 0.5, 5.0, 0.7];

    /// Differences of `point` from this row, in the order of [`Self::TOLERANCES`].
    pub fn differences(&self, point: &StaticPoint) -> [f64; 5] {
        let (u, y) = (&point.inputs, &point.outputs);
        [
            100.0 * (u.injection_mg / self.injection_mg - 1.0),
            u.throttle_deg - self.throttle_deg,
            100.0 * (y.map_kpa / self.map_kpa - 1.0),
            y.egt_k - 273.15 - self.egt_c,
            u.spark_deg - self.spark_deg,
        ]
    }
}

/// A motored point.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Motored {
    /// Speed \[rpm\].
    pub speed_rpm: f64,
    /// Peak pressure \[bar\].
    pub pmax_bar: f64,
    /// Angle of the peak, the cylinder furthest from dead centre \[deg ATDC\].
    pub peak_deg: f64,
    /// Brake torque \[Nm\].
    pub torque_nm: f64,
}

/// Motored without fuel at the throttle angle of `inputs`.
///
/// # Errors
/// As [`steady`].
pub fn motored(params: &EngineParams, inputs: Inputs) -> Result<Motored, PlantError> {
    let mut engine = VirtualEngine::new(params)?;
    let y = steady(&mut engine, Inputs { injection_mg: 0.0, ..inputs }, 6.0, 0.5)?;
    let peaks = engine.cycle_log().map(|c| c.peak_deg);
    let peak_deg = peaks.into_iter().fold(0.0f64, |a, b| if b.abs() > a.abs() { b } else { a });
    let speed_rpm = inputs.speed_rpm;
    Ok(Motored { speed_rpm, pmax_bar: y.pmax_bar, peak_deg, torque_nm: y.torque_cycle_nm })
}

/// Full load without charging: throttle open, lambda as asked, spark of most torque.
///
/// Fuel follows the air of the cycle before; the spark comes from two parabolas through the torque at three sparks.
///
/// # Errors
/// As [`steady`].
pub fn open_throttle(params: &EngineParams, speed_rpm: f64, lambda: f64) -> Result<StaticPoint, PlantError> {
    let mut engine = VirtualEngine::new(params)?;
    let cycle_s = 120.0 / speed_rpm;
    let afr = params.gas.afr_stoich;
    // Whole cycles: air pulsates so much at open throttle that a part of a cycle shows in the mean.
    let whole_s = |time_s: f64| cycle_s * (time_s / cycle_s).ceil();
    let mut at = |spark_deg: f64| -> Result<StaticPoint, PlantError> {
        let mut inputs = Inputs { speed_rpm, spark_deg, throttle_deg: 90.0, ..engine.state().inputs };
        for _ in 0..8 {
            let y = steady(&mut engine, inputs, 0.3, whole_s(0.3))?;
            inputs.injection_mg = (1e3 * y.air_g_s * cycle_s / 4.0 / (afr * lambda)).clamp(0.0, 120.0);
        }
        let outputs = steady(&mut engine, inputs, 1.0, whole_s(1.0))?;
        Ok(StaticPoint { inputs, outputs, time_s: 0.0 })
    };
    let mut centre = spark_guess_deg(speed_rpm, 140.0);
    for width in [5.0, 3.0] {
        let mut torque = [0.0; 3];
        for (k, t) in torque.iter_mut().enumerate() {
            *t = at(centre + width * (k as f64 - 1.0))?.outputs.torque_nm;
        }
        let curvature = torque[0] - 2.0 * torque[1] + torque[2];
        let slope = 0.5 * (torque[2] - torque[0]);
        let offset = if curvature < 0.0 { -slope / curvature } else { slope.signum() };
        centre = (centre + width * offset.clamp(-2.0, 2.0)).clamp(-5.0, 50.0);
    }
    at(centre)
}

/// Fuel \[mg\] at constant torque and lambda for each spark: every point settled.
///
/// # Errors
/// As [`settle`].
pub fn fuel_against_spark(
    params: &EngineParams,
    target: Target,
    sparks_deg: &[f64],
) -> Result<Vec<f64>, PlantError> {
    let mut engine = VirtualEngine::new(params)?;
    sparks_deg
        .iter()
        .map(|s| Ok(settle(&mut engine, target, *s, SettleOptions::default())?.inputs.injection_mg))
        .collect()
}

/// Torque \[Nm\] at constant air and fuel for each spark.
///
/// # Errors
/// As [`steady`].
pub fn torque_against_spark(
    params: &EngineParams,
    inputs: Inputs,
    sparks_deg: &[f64],
) -> Result<Vec<f64>, PlantError> {
    let mut engine = VirtualEngine::new(params)?;
    sparks_deg
        .iter()
        .map(|s| Ok(steady(&mut engine, Inputs { spark_deg: *s, ..inputs }, 2.5, 0.5)?.torque_nm))
        .collect()
}

/// Number of inner maxima of `y`, and its largest second difference (negative: concave).
///
/// ```
/// use dynocal_studies::engine::verification::shape;
/// let (maxima, largest) = shape(&[0.0, 3.0, 4.0, 3.0, 0.0]);
/// assert_eq!(maxima, 1);
/// assert_eq!(largest, -2.0);
/// ```
pub fn shape(y: &[f64]) -> (usize, f64) {
    let maxima = y.windows(3).filter(|w| w[1] > w[0] && w[1] >= w[2]).count();
    let largest = y.windows(3).map(|w| w[0] - 2.0 * w[1] + w[2]).fold(f64::NEG_INFINITY, f64::max);
    (maxima, largest)
}

/// Largest distance of `y(x)` from its least-squares line, as share of the range of `y` \[%\].
///
/// ```
/// use dynocal_studies::engine::verification::nonlinearity_pct;
/// assert!(nonlinearity_pct(&[0.0, 1.0, 2.0], &[1.0, 3.0, 5.0]) < 1e-12);
/// // Residuals of (0, 0), (1, 1), (2, 0) about their mean line y = 1/3.
/// assert!((nonlinearity_pct(&[0.0, 1.0, 2.0], &[0.0, 1.0, 0.0]) - 200.0 / 3.0).abs() < 1e-9);
/// ```
pub fn nonlinearity_pct(x: &[f64], y: &[f64]) -> f64 {
    let n = x.len().min(y.len()) as f64;
    let (mx, my) = (x.iter().sum::<f64>() / n, y.iter().sum::<f64>() / n);
    let sxy: f64 = x.iter().zip(y).map(|(a, b)| (a - mx) * (b - my)).sum();
    let sxx: f64 = x.iter().map(|a| (a - mx) * (a - mx)).sum();
    let off = x.iter().zip(y).map(|(a, b)| (b - my - sxy / sxx * (a - mx)).abs()).fold(0.0, f64::max);
    let (low, high) = y.iter().fold((f64::MAX, f64::MIN), |(l, h), v| (l.min(*v), h.max(*v)));
    100.0 * off / (high - low)
}
