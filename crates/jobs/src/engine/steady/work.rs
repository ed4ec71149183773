//! Steady points on the engine.

use dynocal_numerics::watch::Watch;
use dynocal_plant::engine::VirtualEngine;
use dynocal_plant::error::PlantError;
use dynocal_plant::full_load::{Barrier, LoadLimits, LoadRequest, hold_load, hold_load_at_spark};
use dynocal_plant::inputs::Inputs;
use dynocal_plant::outputs::Outputs;
use dynocal_plant::statics::{
    SPARKS_DEG, SettleOptions, Target, best_spark, settle, spark_guess_deg, steady,
};
use dynocal_plant::trace::CylinderTrace;

use super::{At, MOST_POINTS, Spec, Steady};
use crate::engine::quantities::Point;
use crate::engine::{Engine, EngineJobError};

/// Time at constant inputs before the outputs are averaged, and the time of averaging (thesis 6.6.1) \[s\].
const SETTLE_S: f64 = 9.0;
const AVERAGE_S: f64 = 1.0;
/// Time more that a turbocharger is given, and the share of itself that its speed and the flow of air may move by in two seconds at rest.
const SPOOL_S: f64 = 60.0;
const AT_REST: f64 = 1e-4;

/// Holds every point until it is steady.
///
/// # Errors
/// [`EngineJobError`]: inputs out of range, a torque that is not reached, an interruption.
pub fn run(engine: &Engine, spec: &Spec, watch: Watch) -> Result<Steady, EngineJobError> {
    let mut engine = VirtualEngine::new(&engine.params)?;
    let mut said = Vec::new();
    let points = match *spec {
        Spec::Point(at) => {
            let (point, leave) = settled(&mut engine, at)?;
            if at.torque_nm.is_some() {
                said = warnings(&at, &point, leave);
            }
            vec![point]
        }
        Spec::Motored { speed_rpm, throttle_deg } => {
            let u = Inputs { speed_rpm, throttle_deg, injection_mg: 0.0, ..Inputs::default() };
            vec![held(&mut engine, u)?]
        }
        Spec::Sweep { input, from, to, points, at } => {
            if !(2..=MOST_POINTS).contains(&points) {
                let expected = format!("2 to {MOST_POINTS}");
                return Err(EngineJobError::Number { name: "points".into(), found: points as f64, expected });
            }
            if let Some(lacked) = engine.params().lacks(input.name()) {
                return Err(EngineJobError::Lacks { what: input.name(), lacked });
            }
            let start = settled(&mut engine, at)?.0.inputs;
            let mut all = Vec::with_capacity(points);
            for k in 0..points {
                if watch.interrupted() {
                    return Err(EngineJobError::Interrupted);
                }
                watch.fraction(k as f64 / points as f64);
                let mut u = start;
                input.set(&mut u, from + (to - from) * k as f64 / (points - 1) as f64);
                all.push(held(&mut engine, u)?);
            }
            all
        }
    };
    let points = points.iter().map(|p| p.shown(engine.params())).collect();
    Ok(Steady { points, warnings: said, trace: CylinderTrace::record(&mut engine, 0)? })
}

fn held(engine: &mut VirtualEngine, inputs: Inputs) -> Result<Point, EngineJobError> {
    let mut outputs = steady(engine, inputs, SETTLE_S, AVERAGE_S)?;
    // A shaft and the pressures about it take longer than a manifold.
    let mut left_s = if engine.params().turbocharger.is_some() { SPOOL_S } else { 0.0 };
    while left_s > 0.0 {
        let before = outputs;
        outputs = steady(engine, inputs, AVERAGE_S, AVERAGE_S)?;
        let moved =
            |of: fn(&Outputs) -> f64| (of(&outputs) - of(&before)).abs() > AT_REST * of(&before).abs();
        if !moved(|y| y.turbo_rpm) && !moved(|y| y.air_g_s) {
            break;
        }
        left_s -= 2.0 * AVERAGE_S;
    }
    Ok(Point { inputs, outputs })
}

fn asked(name: &str, found: f64, holds: bool, expected: &str) -> Result<(), EngineJobError> {
    match holds {
        true => Ok(()),
        false => Err(EngineJobError::Number { name: name.into(), found, expected: expected.into() }),
    }
}

/// A point, and which share of what a controller leaves of its limits may be left: none where no controller has held it.
fn settled(engine: &mut VirtualEngine, at: At) -> Result<(Point, f64), EngineJobError> {
    let speed_rpm = at.speed_rpm;
    let Some(torque_nm) = at.torque_nm else {
        let d = Inputs::default();
        let u = Inputs {
            speed_rpm,
            throttle_deg: at.throttle_deg.unwrap_or(d.throttle_deg),
            injection_mg: at.injection_mg.unwrap_or(d.injection_mg),
            spark_deg: at.spark_deg.unwrap_or(d.spark_deg),
            intake_mop_deg_btdc: at.intake_cam_deg.unwrap_or(d.intake_mop_deg_btdc),
            exhaust_mop_deg_atdc: at.exhaust_cam_deg.unwrap_or(d.exhaust_mop_deg_atdc),
            wastegate_mm: at.wastegate_mm.unwrap_or(d.wastegate_mm),
            egr_mm: at.egr_mm.unwrap_or(d.egr_mm),
            ..d
        };
        for (what, given) in [("wastegate", at.wastegate_mm), ("egr", at.egr_mm)] {
            if let (Some(lacked), Some(_)) = (engine.params().lacks(what), given) {
                return Err(EngineJobError::Lacks { what, lacked });
            }
        }
        return Ok((held(engine, u)?, 0.0));
    };
    asked("torque", torque_nm, torque_nm.is_finite(), "a number of Nm")?;
    asked("lambda", at.lambda, (LAMBDAS.0..=LAMBDAS.1).contains(&at.lambda), "0.5 to 2")?;
    let target = Target { speed_rpm, torque_nm, lambda: at.lambda };
    // The cams that `map` and `full-load` hold there, too.
    let options = SettleOptions { cams: true, ..SettleOptions::default() };
    let point = match at.spark_deg {
        Some(spark) => match settle(engine, target, spark, options) {
            Err(PlantError::NotSettled { .. }) => return Ok((with_boost(engine, target, Some(spark))?, 1.0)),
            found => found?,
        },
        None => match best_spark(engine, target, spark_guess_deg(speed_rpm, torque_nm), options) {
            Err(PlantError::NotSettled { .. }) => return Ok((with_boost(engine, target, None)?, 1.0)),
            // The spark of least fuel knocks: later, as far as `map` and `full-load` go.
            Ok(p) if p.outputs.knock > LoadLimits::default().knock => {
                return Ok((with_boost(engine, target, None)?, 1.0));
            }
            found => found?,
        },
    };
    Ok((Point { inputs: point.inputs, outputs: point.outputs }, 0.0))
}

/// What `map` and `full-load` would not hold at a torque that is held here, and a best spark that is the end of its range.
fn warnings(at: &At, p: &Point, leave: f64) -> Vec<String> {
    let passed = LoadLimits::default()
        .passed(&p.outputs, leave)
        .map(|l| format!("past what `engine map` holds by spark, mixture and load: {l}"));
    let early = SPARKS_DEG.1;
    let at_end = at.spark_deg.is_none() && p.inputs.spark_deg >= early;
    let end = at_end.then(|| format!("the spark of least fuel stands at the end of its range, {early} deg"));
    passed.into_iter().chain(end).collect()
}

/// Lambdas that burn at all.
const LAMBDAS: (f64, f64) = (0.5, 2.0);

/// A torque that throttle and best spark alone do not give: with wastegate, knock limit and enrichment as at full load, or
/// the reason why not.
fn with_boost(
    engine: &mut VirtualEngine,
    target: Target,
    spark_deg: Option<f64>,
) -> Result<Point, EngineJobError> {
    let Target { speed_rpm, torque_nm, lambda } = target;
    // From the start: the point that did not settle may have left the engine anywhere.
    *engine = VirtualEngine::new(engine.params())?;
    let request = LoadRequest { speed_rpm, torque_nm, lambda, limits: LoadLimits::default() };
    let found = match spark_deg {
        Some(spark_deg) => hold_load_at_spark(engine, request, spark_deg)?,
        None => hold_load(engine, request)?,
    };
    match found.barrier {
        None => Ok(Point { inputs: found.inputs, outputs: found.outputs }),
        // In reach, for all that is known.
        Some(Barrier::Time) => Err(PlantError::NotSettled {
            speed_rpm,
            torque_nm,
            spark_deg: found.inputs.spark_deg,
            time_s: found.time_s,
            torque_error_nm: torque_nm - found.outputs.torque_nm,
            lambda_error: lambda - found.outputs.lambda,
        }
        .into()),
        Some(barrier) => {
            let (found_nm, reason) = (found.outputs.torque_nm, barrier.reason());
            Err(PlantError::OutOfReach { speed_rpm, torque_nm, found_nm, reason }.into())
        }
    }
}
