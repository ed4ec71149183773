//! Study `engine`, the parameter set `gtdi_2l`: tasks and checks (case 14 of the specification and class values).

use crate::StudyError;
use crate::engine::class_values::{self, BoxRun, random_box};
use crate::engine::results::{Cams, Grid, GridPoint, Mixture, SparkSweepAt};
use dynocal_plant::engine::VirtualEngine;
use dynocal_plant::error::PlantError;
use dynocal_plant::full_load::{LoadLimits, LoadPoint, LoadRequest, hold_load, load_map};
use dynocal_plant::outputs::Outputs;
use dynocal_plant::params::EngineParams;
use serde_json::json;

use super::checks::{check, range};
use super::task;
use crate::asked::Asked;
use crate::{Check, Options, Task, TaskResult, result};

/// Names of the tasks.
pub(super) const FULL_LOAD: &str = "gtdi-full-load";
pub(super) const MAP: &str = "gtdi-map";
pub(super) const SPARK: &str = "gtdi-spark";
pub(super) const MIXTURE: &str = "gtdi-mixture";
pub(super) const CAMS: &str = "gtdi-cams";
const BOX: &str = "gtdi-random-box";

const SET: &str = "gtdi_2l";
/// Rated torque \[Nm\], the speeds between which it is held \[rpm\], and the speed from which case 14 has it.
const RATED_NM: f64 = 366.0;
const RATED_RPM: (f64, f64) = (2500.0, 4500.0);
const CASE_14_RPM: f64 = 1750.0;
/// Full load of a measured 2.0 l turbo engine below that: speed \[rpm\], torque \[Nm\].
const MEASURED_NM: [(f64, f64); 4] = [(1250.0, 233.0), (1500.0, 300.0), (1750.0, 336.0), (2000.0, 332.0)];
/// Points of the spark sweeps: speed \[rpm\], torque \[Nm\].
const SPARK_POINTS: [(f64, f64); 3] = [(1500.0, 60.0), (2000.0, 70.0), (3000.0, 120.0)];
const LAMBDAS: [f64; 9] = [0.7, 0.8, 0.9, 1.0, 1.1, 1.2, 1.3, 1.4, 1.6];
const INTAKE_DEG: [f64; 7] = [221.0, 226.0, 231.0, 236.0, 241.0, 251.0, 261.0];

fn failed(what: &'static str) -> impl Fn(PlantError) -> StudyError {
    move |e| StudyError::Task { what: what.into(), reason: e.to_string() }
}

pub(super) fn tasks(o: &Options) -> Vec<Task> {
    let (reduced, seed) = (o.reduced, o.seed);
    let full: Vec<f64> = if reduced {
        vec![1750.0, 3000.0]
    } else {
        vec![1000.0, 1250.0, 1500.0, 1750.0, 2000.0, 2500.0, 3000.0, 3500.0, 4000.0, 4500.0, 5000.0, 5500.0]
    };
    let speeds = if reduced { vec![2000.0] } else { (1..=9).map(|k| 500.0 + 500.0 * f64::from(k)).collect() };
    let torques = if reduced {
        vec![40.0, 250.0]
    } else {
        vec![20.0, 40.0, 70.0, 100.0, 140.0, 180.0, 220.0, 260.0, 300.0, 340.0]
    };
    let time_s = if reduced { 20.0 } else { 3600.0 };
    let sparks = if reduced { &SPARK_POINTS[1..2] } else { &SPARK_POINTS[..] };
    let lambdas = if reduced { &LAMBDAS[..4] } else { &LAMBDAS[..] };
    vec![
        task(FULL_LOAD.into(), json!(full), move || grid(&full, &[RATED_NM])),
        task(MAP.into(), json!([speeds, torques]), move || grid(&speeds, &torques)),
        task(SPARK.into(), json!(sparks), move || spark(sparks).map_err(failed("spark sweep"))),
        task(MIXTURE.into(), json!(lambdas), move || mixture(lambdas).map_err(failed("mixture sweep"))),
        task(CAMS.into(), json!(INTAKE_DEG), || cams().map_err(failed("cam sweep"))),
        task(BOX.into(), json!([seed, time_s]), move || {
            let params = EngineParams::named(SET).map_err(failed("random box"))?;
            random_box(&params, time_s, 0.1, seed).map_err(failed("random box"))
        }),
    ]
}

/// Points over speed and torque; a point that failed carries why.
fn grid(speeds: &[f64], torques: &[f64]) -> Result<Grid, StudyError> {
    let params = EngineParams::named(SET).map_err(failed("map"))?;
    let rows = load_map(&params, speeds, torques, LoadLimits::default()).map_err(failed("map"))?;
    let point = |p: Result<LoadPoint, PlantError>| match p {
        Ok(p) => GridPoint { point: Some(p), error: None },
        Err(e) => GridPoint { point: None, error: Some(e.to_string()) },
    };
    let rows = rows.into_iter().map(|row| row.into_iter().map(point).collect()).collect();
    Ok(Grid { speed_rpm: speeds.to_vec(), torque_nm: torques.to_vec(), rows })
}

fn point(speed_rpm: f64, torque_nm: f64) -> Result<(EngineParams, LoadPoint), PlantError> {
    let params = EngineParams::named(SET)?;
    let mut engine = VirtualEngine::new(&params)?;
    let request = LoadRequest { speed_rpm, torque_nm, lambda: 1.0, limits: LoadLimits::default() };
    let point = hold_load(&mut engine, request)?;
    Ok((params, point))
}

fn spark(points: &[(f64, f64)]) -> Result<Vec<SparkSweepAt>, PlantError> {
    points
        .iter()
        .map(|&(speed_rpm, torque_nm)| {
            let (params, p) = point(speed_rpm, torque_nm)?;
            Ok(SparkSweepAt { speed_rpm, torque_nm, sweep: class_values::spark_sweep(&params, &p)? })
        })
        .collect()
}

fn mixture(lambdas: &[f64]) -> Result<Mixture, PlantError> {
    let (params, p) = point(2000.0, 70.0)?;
    let outputs = class_values::mixture_sweep(&params, &p, lambdas)?;
    Ok(Mixture { lambda: lambdas.to_vec(), outputs })
}

fn cams() -> Result<Cams, PlantError> {
    let (params, p) = point(2000.0, 40.0)?;
    let outputs = class_values::cam_sweep(&params, &p, &INTAKE_DEG)?;
    Ok(Cams { intake_deg: INTAKE_DEG.to_vec(), outputs })
}

/// The points of a grid that were asked for; empty when the grid cannot be read.
pub(super) fn points(results: &[TaskResult], name: &str) -> Vec<GridPoint> {
    result::<Grid>(results, name).map_or_else(Vec::new, |g| g.rows.into_iter().flatten().collect())
}

/// An output of every point that `keep` keeps; none where a point failed.
fn outputs(
    points: &[GridPoint],
    of: fn(&Outputs) -> f64,
    keep: fn(&LoadPoint) -> bool,
) -> impl Iterator<Item = Option<f64>> {
    points
        .iter()
        .filter(move |p| p.point.as_ref().is_none_or(keep))
        .map(move |p| p.point.as_ref().map(|p| of(&p.outputs)))
}

fn rated(p: &LoadPoint) -> bool {
    (RATED_RPM.0..=RATED_RPM.1).contains(&p.request.speed_rpm)
}

fn case_14(p: &LoadPoint) -> bool {
    (CASE_14_RPM..=RATED_RPM.1).contains(&p.request.speed_rpm)
}

fn reached(p: &LoadPoint) -> bool {
    p.reached
}

/// The checks.
pub(super) fn checks(results: &[TaskResult]) -> Vec<Check> {
    let mut out = full_load(results);
    out.extend(class(results));
    out.extend(sweeps(results));
    out.extend(random(results));
    out
}

fn full_load(results: &[TaskResult]) -> Vec<Check> {
    let all = points(results, FULL_LOAD);
    let span = |of: fn(&Outputs) -> f64| range(outputs(&all, of, case_14));
    let note = "gtdi_2l, 1750 to 4500 rpm; limits 240 kPa, 950 deg C, knock integral 1, 110 bar";
    let low = |r: Option<(f64, f64)>| r.map(|r| r.0);
    let high = |r: Option<(f64, f64)>| r.map(|r| r.1);
    let mut out: Vec<Check> = MEASURED_NM.iter().map(|(rpm, nm)| measured(&all, *rpm, *nm)).collect();
    out.extend([
        check(
            "gtdi-full-load",
            "Least torque at full load, 2500 to 4500 rpm (case 14: 366 Nm, 1 %)",
            "Nm",
            Asked::AtLeast(362.3),
            low(range(outputs(&all, |y| y.torque_nm, rated))),
            "gtdi_2l; limits 240 kPa, 950 deg C, knock integral 1, 110 bar",
        ),
        check(
            "gtdi-full-load-1750",
            "Least torque at full load, 1750 to 4500 rpm (case 14: 366 Nm)",
            "Nm",
            Asked::Reported,
            low(span(|y| y.torque_nm)),
            "case 14 has the 366 Nm from 1750 rpm on: not had there at 240 kPa; the measured engine gives 336 and 332 Nm",
        ),
        check(
            "gtdi-boost",
            "Highest intake-manifold pressure at full load",
            "kPa",
            Asked::AtMost(240.5),
            high(span(|y| y.map_kpa)),
            note,
        ),
        check(
            "gtdi-turbo",
            "Highest turbocharger speed at full load",
            "rpm",
            Asked::AtMost(200e3),
            high(span(|y| y.turbo_rpm)),
            note,
        ),
        check(
            "gtdi-knock",
            "Largest knock integral at full load",
            "",
            Asked::AtMost(1.03),
            high(span(|y| y.knock)),
            note,
        ),
        check(
            "gtdi-knock-limited",
            "Latest 50 % burned at full load: the spark is held back",
            "deg",
            Asked::AtLeast(15.0),
            high(span(|y| y.ca50_deg)),
            note,
        ),
        check(
            "gtdi-full-load-egt",
            "Highest exhaust temperature at full load",
            "deg C",
            Asked::AtMost(955.0),
            high(span(|y| y.egt_k)).map(|t| t - 273.15),
            note,
        ),
    ]);
    out
}

/// Full load at a speed against that of a measured engine, 5 % less at most.
fn measured(all: &[GridPoint], speed_rpm: f64, nm: f64) -> Check {
    let found = all.iter().filter_map(|p| p.point.as_ref()).find(|p| p.request.speed_rpm == speed_rpm);
    check(
        &format!("gtdi-{speed_rpm}"),
        &format!("Full load at {speed_rpm} rpm (measured {nm}, 5 % less at most)"),
        "Nm",
        Asked::AtLeast(0.95 * nm),
        found.map(|p| p.outputs.torque_nm),
        "measured on a 2.0 l turbo engine (306 points)",
    )
}

fn class(results: &[TaskResult]) -> Vec<Check> {
    let all = points(results, MAP);
    let span = |of: fn(&Outputs) -> f64| range(outputs(&all, of, reached));
    let full = points(results, FULL_LOAD);
    let best =
        range(outputs(&all, |y| y.bsfc_g_kwh, reached).chain(outputs(&full, |y| y.bsfc_g_kwh, reached)))
            .map(|r| r.0);
    let (residual, egt) = (span(|y| y.residual), span(|y| y.egt_k));
    let note = "gtdi_2l, map at lambda 1 and cam schedule";
    vec![
        check(
            "gtdi-bsfc-low",
            "Best specific consumption (class 235 to 245)",
            "g/kWh",
            Asked::AtLeast(235.0),
            best,
            note,
        ),
        check(
            "gtdi-bsfc-high",
            "Best specific consumption (class 235 to 245)",
            "g/kWh",
            Asked::AtMost(245.0),
            best,
            note,
        ),
        check(
            "gtdi-residual-low",
            "Least residual fraction (class from 0.03)",
            "",
            Asked::AtLeast(0.03),
            residual.map(|r| r.0),
            note,
        ),
        check(
            "gtdi-residual-high",
            "Largest residual fraction (class to 0.30)",
            "",
            Asked::AtMost(0.30),
            residual.map(|r| r.1),
            note,
        ),
        check(
            "gtdi-egt-low",
            "Lowest exhaust temperature (class from 350)",
            "deg C",
            Asked::AtLeast(350.0),
            egt.map(|r| r.0 - 273.15),
            note,
        ),
        check(
            "gtdi-egt-high",
            "Highest exhaust temperature (class to 950)",
            "deg C",
            Asked::AtMost(955.0),
            egt.map(|r| r.1 - 273.15),
            note,
        ),
    ]
}

fn sweeps(results: &[TaskResult]) -> Vec<Check> {
    let all: Vec<SparkSweepAt> = result(results, SPARK).unwrap_or_default();
    let losses = range(all.iter().flat_map(|s| s.sweep.loss_pct).map(Some));
    let off = all.iter().flat_map(|s| {
        let pairs = s.sweep.ratio.iter().zip(&s.sweep.published);
        pairs.skip(3).take(7).map(|(own, published)| Some(100.0 * (own - published).abs()))
    });
    let mixture: Option<Mixture> = result(results, MIXTURE);
    let egt = |k: usize| mixture.as_ref()?.outputs.get(k).map(|y| y.egt_k);
    let rich = (0..3).map(|k| Some(egt(k + 1)? - egt(k)?));
    let cams: Option<Cams> = result(results, CAMS);
    let residual = |k: usize| cams.as_ref()?.outputs.get(k).map(|y| y.residual);
    // From 231 deg on both valves are open together; before that residual gas does not depend on the cam.
    let overlap = (3..INTAKE_DEG.len()).map(|k| Some(residual(k)? - residual(k - 1)?));
    let note = "constant air and fuel; 1500 rpm 60 Nm, 2000 rpm 70 Nm, 3000 rpm 120 Nm";
    vec![
        check(
            "gtdi-spark-least",
            "Least loss of torque 5.5 deg off best spark, either side",
            "%",
            Asked::AtLeast(0.7),
            losses.map(|r| r.0),
            note,
        ),
        check(
            "gtdi-spark-most",
            "Largest loss of torque 5.5 deg off best spark, either side",
            "%",
            Asked::AtMost(1.5),
            losses.map(|r| r.1),
            note,
        ),
        check(
            "gtdi-spark-published",
            "Largest distance from the torque ratio of Crossley and Cook within 8.25 deg",
            "%",
            Asked::AtMost(2.0),
            range(off).map(|r| r.1),
            note,
        ),
        check(
            "gtdi-rich-egt",
            "Least fall of exhaust temperature from one richer mixture to the next, lambda 1 to 0.7",
            "K",
            Asked::Above(0.0),
            range(rich).map(|r| r.0),
            "2000 rpm, 70 Nm",
        ),
        check(
            "gtdi-overlap",
            "Least growth of residual gas with an earlier intake cam",
            "",
            Asked::Above(0.0),
            range(overlap).map(|r| r.0),
            "2000 rpm, 40 Nm, from 231 deg on, where the valves overlap",
        ),
    ]
}

fn random(results: &[TaskResult]) -> Vec<Check> {
    let run: Option<BoxRun> = result(results, BOX);
    let value = |of: fn(&BoxRun) -> f64| run.as_ref().map(of);
    let note = "every input random over its box, limits off; 1 h simulated at full length";
    vec![
        check(
            "gtdi-box-energy",
            "Error of the energy balance over the heat of combustion",
            "",
            Asked::AtMost(1e-10),
            value(|r| r.energy_error),
            note,
        ),
        check(
            "gtdi-box-mass",
            "Error of the mass balance over the fuel",
            "",
            Asked::AtMost(1e-10),
            value(|r| r.mass_error),
            note,
        ),
        check(
            "gtdi-box-negative",
            "Most negative mass of a species",
            "kg",
            Asked::AtLeast(-1e-12),
            value(|r| r.least_mass_kg),
            note,
        ),
    ]
}
