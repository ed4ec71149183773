//! Study `engine`: rows at the conditions of a measurement, where a class value mixes engines or states.
//!
//! - intake pressure and fuel of a 2.3 l engine near idle under its small load, in place of a pressure without a load
//! - duration of the burn at the compression and at the 50 % burned of the pressure traces that it was read from
//! - the shaft after a step of the wastegate between the shaft speeds that were recorded
//! - enrichment of the twin: the load at which its gas at lambda 1 reaches the temperature at which the measured engine begins to
//!   enrich, and the mixture that holds the temperature measured at full load

use super::air_path::{StepRecord, throttled_wastegate_step};
use super::class_rows::nm_per_bar;
use super::class_values::spark_sweep;
use dynocal_plant::engine::VirtualEngine;
use dynocal_plant::error::PlantError;
use dynocal_plant::full_load::{LoadLimits, LoadPoint, LoadRequest, hold_load};
use dynocal_plant::outputs::Outputs;
use dynocal_plant::params::EngineParams;
use serde::{Deserialize, Serialize};

/// Idle of the measured 2.3 l engine (90 x 90 mm): 1050 rpm, 8.8 Nm, 30 kPa, 1.13 kg/h; its displacement \[m3\].
pub const NEAR_IDLE: (f64, f64, f64, f64) = (1050.0, 8.8, 30.0, 1.13);
/// See [`NEAR_IDLE`].
pub const MEASURED_M3: f64 = 2.290e-3;
/// Pressure traces at 2000 rpm: indicated pressure \[bar\], compression ratio, 50 % burned \[deg\], 10 to 90 % burned \[deg\].
pub const TRACES: [(f64, f64, f64, f64); 2] = [(7.4, 12.1, 14.4, 23.0), (2.1, 8.6, 22.4, 32.0)];
/// Wastegate step: speed \[rpm\], intake pressure \[kPa\], positions \[mm\] that give some 20 600 and 25 000 rpm of the shaft.
const GATE: (f64, f64, [f64; 2]) = (1500.0, 66.0, [24.0, 19.0]);
/// Measured records of that step, closing and opening, end so long after it \[s\], before the shaft rests.
pub const GATE_RECORD_S: [f64; 2] = [5.24, 4.34];
/// Where the measured 2.0 l engine begins to enrich: speed \[rpm\], mean effective pressure \[bar\] of the last stoichiometric
/// point and of the first enriched one, gas in the manifold at the former \[deg C\].
pub const ENRICHED: [(f64, [f64; 2], f64); 3] =
    [(2000.0, [16.0, 16.7], 928.0), (3000.0, [12.0, 13.0], 879.0), (4000.0, [9.2, 10.1], 875.0)];
/// Its full load: speed \[rpm\], torque \[Nm\], gas in the manifold \[deg C\], lambda.
pub const FULL: [(f64, f64, f64, f64); 7] = [
    (1500.0, 300.0, 869.0, 0.83),
    (1750.0, 336.0, 883.0, 0.78),
    (2000.0, 332.0, 892.0, 0.77),
    (2500.0, 332.0, 926.0, 0.72),
    (3000.0, 323.0, 927.0, 0.71),
    (4000.0, 286.0, 945.0, 0.73),
    (5000.0, 224.0, 918.0, 0.79),
];
/// Richest mixture that may cool the exhaust there.
const RICHEST: f64 = 0.65;
/// Speeds \[rpm\] and mean effective pressure \[bar\] of the exponent of speed of the burn.
const EXPONENT: ([f64; 2], f64) = ([1500.0, 5000.0], 9.0);

/// Runs of `gtdi_2l` at conditions of measurements.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct AsMeasured {
    /// At [`NEAR_IDLE`], torque over displacement alike.
    pub near_idle: Outputs,
    /// At [`TRACES`].
    pub burns: Vec<Outputs>,
    /// Best spark by a sweep at 2000 rpm, 60 Nm \[deg BTDC\].
    pub best_spark_deg: f64,
    /// Exponent of speed of 10 to 90 % burned at open throttle, 50 % burned held at 8 deg.
    pub speed_exponent: f64,
    /// Step of the wastegate, closing and opening.
    pub gate: Vec<StepRecord>,
}

/// The twin where the measured engine enriches.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Enrichment {
    /// Mean effective pressure \[bar\] at which gas of lambda 1 is as hot as measured, in the order of [`ENRICHED`]; none where it
    /// is not within 8 bar.
    pub begins_bar: Vec<Option<f64>>,
    /// Torque \[Nm\], lambda and 50 % burned \[deg\] held at the temperature of [`FULL`].
    pub full: Vec<(f64, f64, f64)>,
}

fn held(
    p: &EngineParams,
    speed_rpm: f64,
    torque_nm: f64,
    limits: LoadLimits,
) -> Result<LoadPoint, PlantError> {
    hold_load(&mut VirtualEngine::new(p)?, LoadRequest { speed_rpm, torque_nm, lambda: 1.0, limits })
}

/// Without a limit of knock or peak pressure.
fn free() -> LoadLimits {
    LoadLimits { knock: 1e6, pmax_bar: 1e6, ..LoadLimits::default() }
}

/// All runs of [`AsMeasured`].
///
/// # Errors
/// As [`hold_load`].
pub fn as_measured(p: &EngineParams) -> Result<AsMeasured, PlantError> {
    let (speed_rpm, torque_nm, ..) = NEAR_IDLE;
    let near_nm = torque_nm * p.displacement_m3() / MEASURED_M3;
    let near_idle = held(p, speed_rpm, near_nm, LoadLimits::default())?.outputs;
    let burns = TRACES.iter().map(|t| trace(p, t)).collect::<Result<_, _>>()?;
    let sixty = held(p, 2000.0, 60.0, LoadLimits::default())?;
    let (speeds, bar) = EXPONENT;
    let burn = |n: f64| held(p, n, bar * nm_per_bar(p), free()).map(|x| x.outputs.burn_deg);
    let speed_exponent = (burn(speeds[1])? / burn(speeds[0])?).ln() / (speeds[1] / speeds[0]).ln();
    let (n, kpa, [open, shut]) = GATE;
    let gate = vec![
        throttled_wastegate_step(p, n, kpa, open, shut)?,
        throttled_wastegate_step(p, n, kpa, shut, open)?,
    ];
    Ok(AsMeasured {
        near_idle,
        burns,
        best_spark_deg: spark_sweep(p, &sixty)?.best_deg,
        speed_exponent,
        gate,
    })
}

/// The point of an indicated pressure at the compression and the 50 % burned of a pressure trace, 2000 rpm.
fn trace(p: &EngineParams, t: &(f64, f64, f64, f64)) -> Result<Outputs, PlantError> {
    let (imep_bar, compression, ca50_deg, _) = *t;
    let mut p = p.clone();
    p.geometry.compression_ratio = compression;
    let limits = LoadLimits { ca50_deg, ..free() };
    let unit = nm_per_bar(&p);
    let mut torque_nm = (imep_bar - 2.0) * unit;
    let mut y = held(&p, 2000.0, torque_nm, limits)?.outputs;
    for _ in 0..3 {
        torque_nm += (imep_bar - y.imep_bar) * unit;
        y = held(&p, 2000.0, torque_nm, limits)?.outputs;
    }
    Ok(y)
}

/// The twin of the measured engine where that enriches.
///
/// # Errors
/// As [`hold_load`].
pub fn enrichment(p: &EngineParams) -> Result<Enrichment, PlantError> {
    let begins_bar = ENRICHED.iter().map(|e| begins(p, e)).collect::<Result<_, _>>()?;
    let full = FULL.iter().map(|(speed_rpm, torque_nm, degc, _)| {
        let limits = LoadLimits {
            egt_k: degc + 273.15,
            least_lambda: RICHEST,
            map_kpa: 260.0,
            ..LoadLimits::default()
        };
        held(p, *speed_rpm, *torque_nm, limits).map(|x| (x.outputs.torque_nm, x.lambda, x.outputs.ca50_deg))
    });
    Ok(Enrichment { begins_bar, full: full.collect::<Result<_, _>>()? })
}

/// Load \[bar\] at which gas of lambda 1 reaches a temperature, from 4 bar below to 4 bar above the measured one.
fn begins(
    p: &EngineParams,
    (speed_rpm, [bar, _], degc): &(f64, [f64; 2], f64),
) -> Result<Option<f64>, PlantError> {
    let limits = LoadLimits { egt_k: 2000.0, map_kpa: 260.0, ..LoadLimits::default() };
    let mut before: Option<(f64, f64)> = None;
    for k in -4..=4 {
        let load = bar + f64::from(k);
        let hot = held(p, *speed_rpm, load * nm_per_bar(p), limits)?.outputs.egt_k - 273.15 - degc;
        if hot >= 0.0 {
            return Ok(before.map(|(b, h)| b + (load - b) * h / (h - hot)));
        }
        before = Some((load, hot));
    }
    Ok(None)
}
