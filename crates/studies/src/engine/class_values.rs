//! What the physical parameter set is compared by: loss of torque off the best spark against a published model, sweeps
//! of mixture and cams, random inputs over the whole box.

use super::verification::torque_against_spark;
use dynocal_numerics::rng::Rng64;
use dynocal_plant::engine::VirtualEngine;
use dynocal_plant::error::PlantError;
use dynocal_plant::full_load::LoadPoint;
use dynocal_plant::inputs::Inputs;
use dynocal_plant::outputs::Outputs;
use dynocal_plant::params::EngineParams;
use dynocal_plant::statics::steady;
use serde::{Deserialize, Serialize};

/// Torque \[Nm\] of the regression of Crossley and Cook (IEE Control 91): `air_g` per cylinder and cycle, `speed` in
/// rad/s. Measured on a four-cylinder engine; as printed in the engine example of the Modelica Standard Library.
///
/// ```
/// use dynocal_studies::engine::class_values::crossley_cook_nm;
/// // Concave in spark: best where the derivative vanishes.
/// let t = |s: f64| crossley_cook_nm(0.3, 14.6, s, 200.0);
/// let best = (0.26 + 0.000_48 * 200.0 + 2.55 * 0.3) / (2.0 * (0.0028 + 0.05 * 0.3));
/// assert!(t(best) > t(best - 1.0) && t(best) > t(best + 1.0));
/// ```
pub fn crossley_cook_nm(air_g: f64, afr: f64, spark_deg: f64, speed: f64) -> f64 {
    -181.3 + 379.36 * air_g + 21.91 * afr - 0.85 * afr * afr + 0.26 * spark_deg
        - 0.0028 * spark_deg * spark_deg
        + 0.027 * speed
        - 0.000_107 * speed * speed
        + 0.000_48 * speed * spark_deg
        + 2.55 * spark_deg * air_g
        - 0.05 * spark_deg * spark_deg * air_g
}

/// A spark sweep at constant air and fuel.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct SparkSweep {
    /// Best spark \[deg BTDC\].
    pub best_deg: f64,
    /// Loss of torque with the spark 5.5 deg later and 5.5 deg earlier \[%\].
    pub loss_pct: [f64; 2],
    /// Distance from the best spark \[deg\].
    pub off_deg: Vec<f64>,
    /// Torque over the best one.
    pub ratio: Vec<f64>,
    /// The same by the published regression.
    pub published: Vec<f64>,
}

/// Distance at which the loss is read \[deg\].
pub const OFF_DEG: f64 = 5.5;

/// The sweep at the air and fuel of `point`, 16.5 deg later to 11 deg earlier than best.
///
/// # Errors
/// As [`steady`].
pub fn spark_sweep(params: &EngineParams, point: &LoadPoint) -> Result<SparkSweep, PlantError> {
    let u = point.inputs;
    let around: Vec<f64> = (-3..=3).map(|k| u.spark_deg - 2.0 + 2.75 * f64::from(k)).collect();
    let torque = torque_against_spark(params, u, &around)?;
    let top = (1..torque.len() - 1).max_by(|a, b| torque[*a].total_cmp(&torque[*b])).unwrap_or(1);
    // Summit of the parabola through the best three.
    let curvature = torque[top - 1] - 2.0 * torque[top] + torque[top + 1];
    let best_deg = around[top] - 2.75 * 0.5 * (torque[top + 1] - torque[top - 1]) / curvature;
    let off_deg: Vec<f64> = (-6..=4).map(|k| 0.5 * OFF_DEG * f64::from(k)).collect();
    let sparks: Vec<f64> = off_deg.iter().map(|o| best_deg + o).collect();
    let torque = torque_against_spark(params, u, &sparks)?;
    let best_nm = torque[6];
    let ratio: Vec<f64> = torque.iter().map(|t| t / best_nm).collect();
    let air_g = point.outputs.air_g_s * 120.0 / u.speed_rpm / 4.0;
    let speed = u.speed_rpm * std::f64::consts::PI / 30.0;
    let summit = (0.26 + 0.000_48 * speed + 2.55 * air_g) / (2.0 * (0.0028 + 0.05 * air_g));
    let model = |off: f64| crossley_cook_nm(air_g, 14.7, summit + off, speed);
    let published = off_deg.iter().map(|o| model(*o) / model(0.0)).collect();
    let loss_pct = [100.0 * (1.0 - ratio[4]), 100.0 * (1.0 - ratio[8])];
    Ok(SparkSweep { best_deg, loss_pct, off_deg, ratio, published })
}

/// Outputs against lambda at the air of `point` and the spark that keeps 50 % burned where it is.
///
/// # Errors
/// As [`steady`].
pub fn mixture_sweep(
    params: &EngineParams,
    point: &LoadPoint,
    lambdas: &[f64],
) -> Result<Vec<Outputs>, PlantError> {
    let mut engine = VirtualEngine::new(params)?;
    let mut u = point.inputs;
    let mut all = Vec::with_capacity(lambdas.len());
    for lambda in lambdas {
        u.injection_mg = point.inputs.injection_mg * point.lambda / lambda;
        let mut y = steady(&mut engine, u, 2.0, 0.6)?;
        for _ in 0..4 {
            u.spark_deg = (u.spark_deg + 0.8 * (y.ca50_deg - point.outputs.ca50_deg)).clamp(-10.0, 55.0);
            y = steady(&mut engine, u, 1.0, 0.6)?;
        }
        all.push(y);
    }
    Ok(all)
}

/// Outputs against the intake cam \[deg BTDC\] at the throttle and spark of `point`; fuel follows the air.
///
/// # Errors
/// As [`steady`].
pub fn cam_sweep(
    params: &EngineParams,
    point: &LoadPoint,
    intake_deg: &[f64],
) -> Result<Vec<Outputs>, PlantError> {
    let mut engine = VirtualEngine::new(params)?;
    let mut u = point.inputs;
    let mut all = Vec::with_capacity(intake_deg.len());
    for mop in intake_deg {
        u.intake_mop_deg_btdc = *mop;
        let mut y = steady(&mut engine, u, 1.5, 0.6)?;
        for _ in 0..3 {
            let air_mg = 1e3 * y.air_g_s * 120.0 / u.speed_rpm / 4.0;
            u.injection_mg = (air_mg / (params.gas.afr_stoich * point.lambda)).clamp(0.0, 120.0);
            y = steady(&mut engine, u, 1.0, 0.6)?;
        }
        all.push(y);
    }
    Ok(all)
}

/// What random inputs over the whole box did to an engine.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct BoxRun {
    /// Simulated time \[s\].
    pub time_s: f64,
    /// Error of the energy balance over the heat of combustion \[-\].
    pub energy_error: f64,
    /// Error of the mass balance over the fuel \[-\].
    pub mass_error: f64,
    /// Most negative mass of a species in a volume \[kg\].
    pub least_mass_kg: f64,
    /// Greatest peak pressure of a cylinder \[bar\].
    pub pmax_bar: f64,
    /// Greatest intake-manifold pressure, cycle mean \[kPa\].
    pub map_kpa: f64,
    /// Greatest speed of the turbocharger \[rpm\].
    pub turbo_rpm: f64,
}

/// Holds of every input at random within its box, nothing limited.
///
/// # Errors
/// [`PlantError::Diverged`] for a state that is not finite or a negative mass.
///
/// ```
/// use dynocal_plant::params::EngineParams;
/// use dynocal_studies::engine::class_values::random_box;
/// let run = random_box(&EngineParams::thesis(), 2.0, 0.1, 1)?;
/// assert!(run.energy_error < 1e-10);
/// # Ok::<(), dynocal_plant::error::PlantError>(())
/// ```
pub fn random_box(params: &EngineParams, time_s: f64, hold_s: f64, seed: u64) -> Result<BoxRun, PlantError> {
    let mut engine = VirtualEngine::new(params)?;
    let mut rng = Rng64::new(seed);
    let contents = |e: &VirtualEngine| {
        let g = &e.state().gas;
        let gas: f64 = g.mass_kg.iter().flatten().sum();
        (gas + g.liquid_kg.iter().sum::<f64>(), g.energy_j.iter().sum::<f64>())
    };
    let (m0, e0) = contents(&engine);
    let mut run = BoxRun {
        time_s,
        energy_error: 0.0,
        mass_error: 0.0,
        least_mass_kg: 0.0,
        pmax_bar: 0.0,
        map_kpa: 0.0,
        turbo_rpm: 0.0,
    };
    for _ in 0..(time_s / hold_s).round() as usize {
        engine.set_inputs(Inputs {
            speed_rpm: rng.uniform_in(600.0, 6500.0),
            throttle_deg: rng.uniform_in(0.0, 90.0),
            spark_deg: rng.uniform_in(-10.0, 55.0),
            injection_mg: rng.uniform_in(0.0, 120.0),
            intake_mop_deg_btdc: rng.uniform_in(180.0, 300.0),
            exhaust_mop_deg_atdc: rng.uniform_in(180.0, 300.0),
            wastegate_mm: rng.uniform_in(0.0, 28.0),
            egr_mm: if params.egr.is_some() { rng.uniform_in(0.0, 25.0) } else { 0.0 },
            wiebe_m: rng.uniform_in(0.5, 6.0),
            burn_duration_deg: None,
        })?;
        engine.advance_time(hold_s);
        engine.check_state()?;
        let y = engine.outputs();
        let least = engine.state().gas.mass_kg.iter().flatten().copied().fold(0.0, f64::min);
        run.least_mass_kg = run.least_mass_kg.min(least);
        run.pmax_bar = run.pmax_bar.max(y.pmax_bar);
        run.map_kpa = run.map_kpa.max(y.map_kpa);
        run.turbo_rpm = run.turbo_rpm.max(y.turbo_rpm);
    }
    let ((m1, e1), l) = (contents(&engine), engine.state().ledger);
    let burned = params.gas.lhv_j_kg * l.burned_kg;
    let balance = e1 - e0 + l.work_j + l.wall_heat_j + l.evaporation_j + l.bound_j + l.turbine_j
        - l.compressor_j
        - l.enthalpy_in_j
        - burned;
    run.energy_error = balance.abs() / burned;
    run.mass_error = (m1 - m0 - l.mass_in_kg - l.injected_kg).abs() / l.injected_kg;
    Ok(run)
}
