//! Runs behind the class values: retard against the production table, burn, idle, recirculation, exhaust temperatures.

use dynocal_plant::engine::VirtualEngine;
use dynocal_plant::error::PlantError;
use dynocal_plant::full_load::{LoadLimits, LoadPoint, LoadRequest, hold_load};
use dynocal_plant::outputs::Outputs;
use dynocal_plant::params::EngineParams;
use dynocal_plant::statics::steady;
use serde::{Deserialize, Serialize};

/// Retard from best spark \[deg\] of a production 2.0 l turbo engine of compression 10.8: speed \[rpm\], brake mean effective
/// pressure \[bar\], retard (a published table over speed and intake pressure, turned over by a measured map).
pub const PRODUCTION: [(f64, f64, f64); 25] = [
    (1500.0, 8.0, 7.0),
    (1500.0, 10.0, 11.0),
    (1500.0, 12.0, 13.0),
    (1500.0, 14.0, 15.0),
    (1500.0, 16.0, 19.0),
    (2000.0, 8.0, 3.5),
    (2000.0, 10.0, 5.0),
    (2000.0, 12.0, 9.0),
    (2000.0, 14.0, 13.0),
    (2000.0, 16.0, 16.0),
    (2500.0, 10.0, 2.0),
    (2500.0, 12.0, 6.0),
    (2500.0, 14.0, 10.0),
    (2500.0, 16.0, 13.0),
    (3000.0, 10.0, 1.0),
    (3000.0, 12.0, 4.0),
    (3000.0, 14.0, 8.0),
    (3000.0, 16.0, 10.5),
    (4000.0, 12.0, 4.0),
    (4000.0, 14.0, 8.0),
    (4000.0, 16.0, 11.0),
    (5000.0, 8.0, 1.0),
    (5000.0, 10.0, 3.0),
    (5000.0, 12.0, 5.0),
    (5000.0, 14.0, 8.5),
];

/// Retard at one point.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Retard {
    /// Speed \[rpm\].
    pub speed_rpm: f64,
    /// Brake mean effective pressure \[bar\].
    pub bmep_bar: f64,
    /// Of the production engine \[deg\].
    pub production_deg: f64,
    /// Of the twin of a measured engine (compression 10.8, 95 octane) \[deg\].
    pub like_deg: f64,
    /// Of the engine itself (9.9, 98 octane), at the same pressure \[deg\].
    pub own_deg: f64,
}

fn held(
    params: &EngineParams,
    speed_rpm: f64,
    torque_nm: f64,
    limits: LoadLimits,
) -> Result<LoadPoint, PlantError> {
    let mut e = VirtualEngine::new(params)?;
    hold_load(&mut e, LoadRequest { speed_rpm, torque_nm, lambda: 1.0, limits })
}

/// Spark that places 50 % burned at 8 deg less the spark at the knock limit \[deg\], both at the torque.
fn retard_deg(params: &EngineParams, speed_rpm: f64, torque_nm: f64) -> Result<f64, PlantError> {
    let free = LoadLimits { knock: 1e6, pmax_bar: 1e6, ..LoadLimits::default() };
    let best = held(params, speed_rpm, torque_nm, free)?;
    let limited = held(params, speed_rpm, torque_nm, LoadLimits::default())?;
    Ok(best.inputs.spark_deg - limited.inputs.spark_deg)
}

/// Retard over [`PRODUCTION`] of the twin of a measured engine and of an engine `own`.
///
/// # Errors
/// As [`hold_load`].
pub fn retards(
    twin: &EngineParams,
    own: &EngineParams,
    points: &[(f64, f64, f64)],
) -> Result<Vec<Retard>, PlantError> {
    let one = |params: &EngineParams, speed_rpm: f64, bmep_bar: f64| {
        retard_deg(params, speed_rpm, nm_per_bar(params) * bmep_bar)
    };
    points
        .iter()
        .map(|&(speed_rpm, bmep_bar, production_deg)| {
            let (like_deg, own_deg) = (one(twin, speed_rpm, bmep_bar)?, one(own, speed_rpm, bmep_bar)?);
            Ok(Retard { speed_rpm, bmep_bar, production_deg, like_deg, own_deg })
        })
        .collect()
}

/// Torque of a mean effective pressure of 1 bar \[Nm\].
pub(super) fn nm_per_bar(params: &EngineParams) -> f64 {
    1e5 * params.displacement_m3() / (4.0 * std::f64::consts::PI)
}

/// Spark of a warm engine at idle, held late for a reserve of torque \[deg BTDC\]: median of a 1.5 l car at 766 and 821 rpm.
pub const IDLE_SPARK_DEG: f64 = 1.0;

/// Points of the part load.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct PartLoad {
    /// 2000 rpm at 2, 8, 12 and 16 bar, held as a controller does.
    pub loads: Vec<Outputs>,
    /// 2000 rpm at the torque whose gross indicated pressure is 7.4 bar, and 2.1 bar.
    pub burns: Vec<Outputs>,
    /// 2000 rpm at 1 and 4 bar.
    pub light: Vec<Outputs>,
    /// 800 and 2000 rpm at zero torque, best spark.
    pub zero: Vec<Outputs>,
    /// 800 rpm at zero torque, spark at [`IDLE_SPARK_DEG`].
    pub idle: Outputs,
    /// Share of NO that is left at 15 % recirculation, 2000 rpm, 70 Nm, lambda 1, 50 % burned held.
    pub no_left: f64,
}

/// Runs of the part load.
///
/// # Errors
/// As [`hold_load`].
pub fn part_load(params: &EngineParams) -> Result<PartLoad, PlantError> {
    let nm_per_bar = nm_per_bar(params);
    let at = |speed: f64, nm: f64| held(params, speed, nm, LoadLimits::default()).map(|p| p.outputs);
    let loads =
        [2.0, 8.0, 12.0, 16.0].iter().map(|bar| at(2000.0, bar * nm_per_bar)).collect::<Result<_, _>>()?;
    let burns = [7.4, 2.1].iter().map(|imep| indicated(params, *imep)).collect::<Result<_, _>>()?;
    let light = [1.0, 4.0].iter().map(|bar| at(2000.0, bar * nm_per_bar)).collect::<Result<_, _>>()?;
    let zero = vec![at(800.0, 0.0)?, at(2000.0, 0.0)?];
    Ok(PartLoad { loads, burns, light, zero, idle: idle(params)?, no_left: no_left(params, 0.15)? })
}

/// Idle at zero torque with the spark of a real idle: 50 % burned is moved until the spark stands there.
fn idle(params: &EngineParams) -> Result<Outputs, PlantError> {
    let mut limits = LoadLimits { ca50_deg: 30.0, ..LoadLimits::default() };
    let mut p = held(params, 800.0, 0.0, limits)?;
    for _ in 0..4 {
        limits.ca50_deg += p.inputs.spark_deg - IDLE_SPARK_DEG;
        p = held(params, 800.0, 0.0, limits)?;
    }
    Ok(p.outputs)
}

/// The point of a gross indicated pressure \[bar\] at 2000 rpm: friction and pumping hardly change with load.
fn indicated(params: &EngineParams, imep_bar: f64) -> Result<Outputs, PlantError> {
    let nm_per_bar = nm_per_bar(params);
    let mut torque_nm = (imep_bar - 2.0) * nm_per_bar;
    let mut y = held(params, 2000.0, torque_nm, LoadLimits::default())?.outputs;
    for _ in 0..3 {
        torque_nm += (imep_bar - y.imep_bar) * nm_per_bar;
        y = held(params, 2000.0, torque_nm, LoadLimits::default())?.outputs;
    }
    Ok(y)
}

/// Share of NO left at a rate of recirculation: linear in its logarithm between the neighbouring openings.
fn no_left(params: &EngineParams, rate: f64) -> Result<f64, PlantError> {
    let mut e = VirtualEngine::new(params)?;
    let request =
        LoadRequest { speed_rpm: 2000.0, torque_nm: 70.0, lambda: 1.0, limits: LoadLimits::default() };
    let base = hold_load(&mut e, request)?;
    let mut u = base.inputs;
    let mut before = (0.0, 0.0);
    for k in 1..=24 {
        u.egr_mm = 0.5 * f64::from(k);
        let mut y = steady(&mut e, u, 2.0, 0.6)?;
        for _ in 0..4 {
            u.spark_deg = (u.spark_deg + 0.8 * (y.ca50_deg - base.outputs.ca50_deg)).clamp(-10.0, 55.0);
            u.throttle_deg = (u.throttle_deg + 0.08 * (70.0 - y.torque_nm)).clamp(0.0, 90.0);
            u.injection_mg = 1e3 * y.air_g_s * 0.06 / 4.0 / params.gas.afr_stoich;
            y = steady(&mut e, u, 0.8, 0.6)?;
        }
        let now = (y.egr_rate, (y.no_ppm / base.outputs.no_ppm).ln());
        if now.0 >= rate {
            let share = (rate - before.0) / (now.0 - before.0);
            return Ok((before.1 + share * (now.1 - before.1)).exp());
        }
        before = now;
    }
    Ok(f64::NAN)
}
