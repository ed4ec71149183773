//! Steady operating points: closed-loop settling to torque and lambda, best spark, static maps.

use crate::engine::VirtualEngine;
use crate::error::PlantError;
use crate::inputs::Inputs;
use crate::outputs::Outputs;
use crate::params::EngineParams;
use rayon::prelude::*;
use serde::{Deserialize, Serialize};

/// Range in which the spark of least fuel is sought \[deg before top dead centre\]; its early end is that of the input, its late end leaves
/// the steps of the search inside of the input's.
pub const SPARKS_DEG: (f64, f64) = (-5.0, 55.0);

/// What a steady point is asked for.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Target {
    /// Speed \[rpm\].
    pub speed_rpm: f64,
    /// Brake torque \[Nm\].
    pub torque_nm: f64,
    /// Lambda \[-\].
    pub lambda: f64,
}

/// Accuracy and patience of [`settle`].
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct SettleOptions {
    /// Largest torque error at the end \[Nm\].
    pub torque_nm: f64,
    /// Largest lambda error at the end \[-\].
    pub lambda: f64,
    /// Simulated time after which the search gives up \[s\].
    pub limit_s: f64,
    /// Cams follow the schedule of the parameter set, where it has one; otherwise they stay where they are.
    #[serde(default)]
    pub cams: bool,
}

impl Default for SettleOptions {
    fn default() -> Self {
        Self { torque_nm: 0.005, lambda: 2e-4, limit_s: 20.0, cams: false }
    }
}

/// A steady point: inputs and outputs.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct StaticPoint {
    /// Inputs that hold the point.
    pub inputs: Inputs,
    /// Outputs at the point.
    pub outputs: Outputs,
    /// Simulated time used \[s\].
    pub time_s: f64,
}

/// Outputs after settling at constant inputs, as on the thesis' bed (6.6.1: 9 s, then 1 s of averaging).
///
/// Torque, lambda, intake pressure and exhaust temperature are means over `average_s`.
///
/// # Errors
/// [`PlantError::Input`] for inputs outside the box, [`PlantError::Diverged`] for an unphysical state.
pub fn steady(
    engine: &mut VirtualEngine,
    inputs: Inputs,
    settle_s: f64,
    average_s: f64,
) -> Result<Outputs, PlantError> {
    engine.set_inputs(inputs)?;
    engine.advance_time(settle_s);
    engine.clear_interval();
    engine.advance_time(average_s);
    engine.check_state()?;
    let mut y = engine.outputs();
    let sums = engine.state().interval;
    if sums.time_s > 0.0 {
        y.torque_nm = sums.torque_nm_s / sums.time_s;
        y.lambda = sums.lambda_s / sums.time_s;
        y.map_kpa = 1e-3 * sums.map_pa_s / sums.time_s;
        y.air_g_s = 1e3 * sums.air_kg / sums.time_s;
    }
    if sums.exhaust_kg > 0.0 {
        y.egt_k = sums.exhaust_kg_k / sums.exhaust_kg;
    }
    Ok(y)
}

/// Bring the engine to a torque and a lambda with a given spark by closed-loop control per cycle.
///
/// Fuel follows the air that passes the throttle (exact in steady state); the throttle is driven by
/// a PI loop on the cycle-mean torque whose integral time is the manifold's filling time.
///
/// # Errors
/// [`PlantError::NotSettled`] when the target is not reached in `options.limit_s`; errors of the engine.
///
/// ```
/// use dynocal_plant::{engine::VirtualEngine, params::EngineParams, statics::*};
/// let mut engine = VirtualEngine::new(&EngineParams::thesis())?;
/// let target = Target { speed_rpm: 2000.0, torque_nm: 30.0, lambda: 1.0 };
/// let point = settle(&mut engine, target, 23.0, SettleOptions::default())?;
/// assert!((point.outputs.torque_cycle_nm - 30.0).abs() < 0.01);
/// # Ok::<(), dynocal_plant::error::PlantError>(())
/// ```
pub fn settle(
    engine: &mut VirtualEngine,
    target: Target,
    spark_deg: f64,
    options: SettleOptions,
) -> Result<StaticPoint, PlantError> {
    let p = engine.params().clone();
    let mut u = Inputs { speed_rpm: target.speed_rpm, spark_deg, ..engine.state().inputs };
    engine.set_inputs(u)?;
    let cycle_s = 120.0 / u.speed_rpm;
    // Filling time of the intake manifold at 75 % volumetric efficiency.
    let fill_s = p.intake_manifold.volume_m3 / (0.75 * p.displacement_m3()) * cycle_s;
    let closed_loop_s = 0.6 * fill_s + 2.0 * cycle_s;
    let start_s = engine.state().time_s;
    let mut error_before = None;
    let mut good = 0;
    loop {
        engine.advance_angle(720.0);
        let y = engine.outputs();
        let error = target.torque_nm - y.torque_cycle_nm;
        let lambda_error = y.lambda_cycle - target.lambda;
        let used_s = y.time_s - start_s;
        let inside = error.abs() < options.torque_nm && lambda_error.abs() < options.lambda;
        good = if inside { good + 1 } else { 0 };
        if good >= 12 {
            engine.check_state()?;
            return Ok(StaticPoint { inputs: u, outputs: y, time_s: used_s });
        }
        if used_s > options.limit_s {
            engine.check_state()?;
            return Err(PlantError::NotSettled {
                speed_rpm: target.speed_rpm,
                torque_nm: target.torque_nm,
                spark_deg,
                time_s: used_s,
                torque_error_nm: error,
                lambda_error,
            });
        }
        // Air goes with the square of the throttle diameter, torque is affine in air.
        let d = p.throttle.diameter0_m + p.throttle.slope_m_per_deg * u.throttle_deg;
        let load_nm = target.torque_nm.max(0.0) + 25.0;
        let slope_nm_deg = 2.0 * load_nm * p.throttle.slope_m_per_deg / d;
        let change = error - error_before.unwrap_or(error);
        error_before = Some(error);
        let move_deg = (fill_s * change + cycle_s * error) / (closed_loop_s * slope_nm_deg);
        u.throttle_deg = (u.throttle_deg + move_deg.clamp(-2.0, 2.0)).clamp(0.0, 90.0);
        let air_mg = 1e6 * 1e-3 * y.air_g_s * cycle_s / 4.0;
        u.injection_mg = (air_mg / (p.gas.afr_stoich * target.lambda)).clamp(0.0, 120.0);
        if let Some(cams) = p.cams.as_ref().filter(|_| options.cams) {
            let now = (u.intake_mop_deg_btdc, u.exhaust_mop_deg_atdc);
            (u.intake_mop_deg_btdc, u.exhaust_mop_deg_atdc) =
                cams.follow(now, u.speed_rpm, y.map_kpa, cycle_s);
        }
        engine.set_inputs(u)?;
    }
}

/// Spark of least fuel at constant torque and lambda, by two parabolas through three settled points each. Where the best spark lies at the
/// early end of [`SPARKS_DEG`], the parabola stands on points before it: no spark outside the range is tried.
///
/// # Errors
/// As [`settle`].
pub fn best_spark(
    engine: &mut VirtualEngine,
    target: Target,
    guess_deg: f64,
    options: SettleOptions,
) -> Result<StaticPoint, PlantError> {
    let mut centre = guess_deg.clamp(SPARKS_DEG.0, SPARKS_DEG.1);
    let mut width = 4.0;
    for _ in 0..6 {
        let middle = centre.min(SPARKS_DEG.1 - width);
        let mut fuel = [0.0; 3];
        for (i, f) in fuel.iter_mut().enumerate() {
            let spark = middle + width * (i as f64 - 1.0);
            let point = settle(engine, target, spark, options)?;
            // The remaining torque error, at about 0.18 mg/Nm, is larger than the fuel differences sought.
            *f = point.inputs.injection_mg + 0.18 * (target.torque_nm - point.outputs.torque_cycle_nm);
        }
        let curvature = fuel[0] - 2.0 * fuel[1] + fuel[2];
        let slope = 0.5 * (fuel[2] - fuel[0]);
        let offset = if curvature > 0.0 { -slope / curvature } else { -slope.signum() * 2.0 };
        let before = centre;
        centre = (middle + width * offset.clamp(-2.0, 2.0)).clamp(SPARKS_DEG.0, SPARKS_DEG.1);
        // At the early end the middle cannot follow: there the search ends where it no longer moves.
        let at_end = middle < before && (centre - before).abs() < 0.5 * width;
        if width < 4.0 && (offset.abs() < 0.5 || at_end) {
            break;
        }
        width = if (centre - before).abs() < 4.0 { 3.0 } else { 4.0 };
    }
    settle(engine, target, centre, options)
}

/// First guess of the best spark \[deg BTDC\]: grows with speed and falls with load.
pub fn spark_guess_deg(speed_rpm: f64, torque_nm: f64) -> f64 {
    let load = (torque_nm.max(0.0) + 25.0) / 95.0;
    19.0 * (speed_rpm / 2000.0).powf(0.45) * load.powf(-0.45)
}

/// Best-spark points for all targets, in parallel over points; the result does not depend on the number of threads.
///
/// # Errors
/// [`PlantError::Parameter`] when the engine cannot be built; each point carries its own result.
pub fn static_map(
    params: &EngineParams,
    targets: &[Target],
    options: SettleOptions,
) -> Result<Vec<Result<StaticPoint, PlantError>>, PlantError> {
    let engine = VirtualEngine::new(params)?;
    Ok(targets
        .par_iter()
        .map(|t| {
            let mut engine = engine.clone();
            best_spark(&mut engine, *t, spark_guess_deg(t.speed_rpm, t.torque_nm), options)
        })
        .collect())
}
