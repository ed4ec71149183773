//! Step 6: the delivered map against its rivals on the plant, and the fuel of a perfect spark.

use super::context::{ChainError, Context, Event, RecordRef, load_records, save_records};
use super::excite_step::LEAD_IN_S;
use super::invert_step::InvertResult;
use super::optimise_step::{Pass, hold, mean_fuel};
use dynocal_calib::map::lagged::LaggedStaticMap;
use dynocal_calib::map::static_map::StaticMap;
use dynocal_calib::map::{FeedforwardMap, Reference};
use dynocal_calib::record::Demand;
use dynocal_calib::validate::{MapScore, Scenario, random_points, run_map, score, torque_steps};
use dynocal_ident::data::Dataset;
use dynocal_numerics::rng::Rng64;
use rayon::prelude::*;
use serde::{Deserialize, Serialize};
use std::path::Path;
use std::sync::atomic::{AtomicUsize, Ordering};

/// The perfect spark on the record of the last pass.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct BestSpark {
    /// Fuel over the record with the static map's spark and the same torque and lambda held, in kg/h.
    pub fuel_kg_h: f64,
    /// Its ratio to the start record.
    pub ratio: f64,
    /// Share of the possible saving that the optimum realised: (1 - measured) / (1 - best spark).
    /// None when the perfect spark saves nothing.
    pub share_of_saving: Option<f64>,
}

/// What step 6 leaves behind.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct ValidateResult {
    /// The static map.
    pub static_map: StaticMap,
    /// Scores of all maps in all scenarios.
    pub scores: Vec<MapScore>,
    /// The perfect spark.
    pub best_spark: BestSpark,
    /// Measured records of all runs.
    pub records: Vec<RecordRef>,
    /// Bed time of the comparison in s (the static map's stands with it).
    pub bed_s: f64,
}

/// Names of the maps that are compared, delivered map first.
pub const DYNAMIC: &str = "dynamic map";

/// Runs the step.
///
/// # Errors
/// [`ChainError`].
pub fn validate(
    ctx: &Context,
    folder: &Path,
    inverse: &InvertResult,
    last: &Pass,
    optimise_folder: &Path,
) -> Result<ValidateResult, ChainError> {
    let static_map = calibrate_static(ctx)?;
    let best_spark = best_spark(ctx, folder, &static_map, last, optimise_folder)?;
    let spec = &ctx.spec.validate;
    let lagged = LaggedStaticMap { map: &static_map, tau_at_2000_rpm_s: spec.lag_s };
    let mut maps: Vec<&dyn FeedforwardMap> = vec![&inverse.dynamic, &static_map, &lagged];
    maps.extend(inverse.published.as_ref().map(|m| m as &dyn FeedforwardMap));
    let dt = ctx.spec.sample_time_s;
    let mut rng = Rng64::stream(ctx.spec.seed, 400);
    let scenarios = [random_points(&spec.scenario, dt, &mut rng), torque_steps(&spec.scenario, dt)];
    let runs = run_all(ctx, &maps, &scenarios)?;
    let names: Vec<&str> = maps.iter().map(|m| m.name()).collect();
    let mut scores = Vec::new();
    for (scenario, records) in scenarios.iter().zip(&runs) {
        scores.extend(score(&spec.scenario, scenario, &names, &records.iter().collect::<Vec<_>>())?);
    }
    let all: Vec<Dataset> = runs.into_iter().flatten().collect();
    let bed_s = all.iter().map(|r| r.len() as f64 * dt + LEAD_IN_S).sum();
    Ok(ValidateResult { static_map, scores, best_spark, records: save_records(folder, &all)?, bed_s })
}

/// One static map, torque rows in parallel on plants of their own.
fn calibrate_static(ctx: &Context) -> Result<StaticMap, ChainError> {
    let spec = &ctx.spec.validate.static_map;
    let done = AtomicUsize::new(0);
    let rows = spec
        .torque_nm
        .par_iter()
        .map(|torque| {
            ctx.check_interrupt()?;
            // Free of sensor noise: the rival is given its best case.
            let mut plant = ctx.plant(false)?;
            plant.reset(ctx.spec.seed);
            let dt = ctx.spec.sample_time_s;
            let row = StaticMap::calibrate_row(plant.as_mut(), dt, spec, &ctx.map_limits(), *torque)?;
            let done = done.fetch_add(1, Ordering::Relaxed) + 1;
            (ctx.tell)(Event::Fraction(0.7 * done as f64 / spec.torque_nm.len() as f64));
            Ok(row)
        })
        .collect::<Vec<Result<_, ChainError>>>()
        .into_iter()
        .collect::<Result<Vec<_>, _>>()?;
    let bed_s = rows.iter().map(|(_, s)| s).sum();
    Ok(StaticMap::from_rows(spec, rows.into_iter().map(|(r, _)| r).collect(), bed_s))
}

fn best_spark(
    ctx: &Context,
    folder: &Path,
    map: &StaticMap,
    last: &Pass,
    optimise_folder: &Path,
) -> Result<BestSpark, ChainError> {
    let records = load_records(optimise_folder, &last.records, ctx.spec.sample_time_s)?;
    let optimum = &records[1];
    let (torque, lambda) = (optimum.values("torque_demand")?, optimum.values("lambda_demand")?);
    let speed = optimum.values("speed")?;
    let reference: Vec<Reference> = (0..optimum.len())
        .map(|t| Reference { torque_nm: torque[t], lambda: lambda[t], speed_rpm: speed[t] })
        .collect();
    // Fuel and throttle as optimised, spark from the map: the loops trim what the other spark needs.
    let (inj, throttle) = (optimum.values("inj")?, optimum.values("throttle")?);
    let feedforward: Vec<[f64; 4]> =
        (0..optimum.len()).map(|t| [inj[t], map.at(&reference[t])[1], throttle[t], speed[t]]).collect();
    let demand: Vec<Demand> =
        reference.iter().map(|r| Demand { torque_nm: r.torque_nm, lambda: r.lambda }).collect();
    let run = hold(ctx, folder, "best_spark", &feedforward, &demand)?;
    save_records(folder, std::slice::from_ref(&run))?;
    let fuel_kg_h = mean_fuel(&run, last.first)?;
    let ratio = fuel_kg_h / last.measured_start_fuel_kg_h;
    let share_of_saving = Some((1.0 - last.measured_ratio) / (1.0 - ratio)).filter(|v| v.is_finite());
    Ok(BestSpark { fuel_kg_h, ratio, share_of_saving })
}

fn run_all(
    ctx: &Context,
    maps: &[&dyn FeedforwardMap],
    scenarios: &[Scenario],
) -> Result<Vec<Vec<Dataset>>, ChainError> {
    let jobs: Vec<(usize, usize)> =
        (0..scenarios.len()).flat_map(|s| (0..maps.len()).map(move |m| (s, m))).collect();
    let done = AtomicUsize::new(0);
    let records = jobs
        .par_iter()
        .map(|&(s, m)| {
            ctx.check_interrupt()?;
            let mut plant = ctx.plant(false)?;
            plant.reset(ctx.spec.seed);
            let (dt, limits) = (ctx.spec.sample_time_s, ctx.actuator_limits());
            let record = run_map(plant.as_mut(), dt, maps[m], &scenarios[s], limits)?;
            let done = done.fetch_add(1, Ordering::Relaxed) + 1;
            (ctx.tell)(Event::Fraction(0.7 + 0.3 * done as f64 / jobs.len() as f64));
            Ok(record)
        })
        .collect::<Vec<Result<Dataset, ChainError>>>()
        .into_iter()
        .collect::<Result<Vec<_>, _>>()?;
    let mut records = records.into_iter();
    Ok(scenarios.iter().map(|_| records.by_ref().take(maps.len()).collect()).collect())
}
