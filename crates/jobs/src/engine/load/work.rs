//! Points of a map or of full load on the engine, speeds in parallel.

use std::sync::atomic::{AtomicUsize, Ordering};

use dynocal_numerics::watch::Watch;
use dynocal_plant::full_load::{Barrier, LoadPoint, load_map};
use rayon::prelude::*;

use super::{Loaded, Spec, What, point};
use crate::engine::{Engine, EngineJobError};

/// Holds every point.
///
/// # Errors
/// [`EngineJobError`]: a grid that is none, a point that cannot be held at all, an interruption.
pub fn run(engine: &Engine, spec: &Spec, watch: Watch) -> Result<Loaded, EngineJobError> {
    finite(spec)?;
    let speeds_rpm = spec.speed_rpm.values("--speed-rpm")?;
    let torques_nm = match spec.what {
        What::Map { torque_nm } => torque_nm.values("--torque-nm")?,
        What::FullLoad { torque_nm } => vec![torque_nm],
    };
    let finished = AtomicUsize::new(0);
    let row = |speed: &f64| -> Result<Vec<LoadPoint>, EngineJobError> {
        if watch.interrupted() {
            return Err(EngineJobError::Interrupted);
        }
        let rows = load_map(&engine.params, &[*speed], &torques_nm, spec.limits)?;
        let mut points = rows.into_iter().flatten().collect::<Result<Vec<_>, _>>()?;
        for p in &mut points {
            let shown = point(p).shown(&engine.params);
            (p.inputs, p.outputs) = (shown.inputs, shown.outputs);
        }
        let done = finished.fetch_add(1, Ordering::Relaxed) + 1;
        watch.fraction(done as f64 / speeds_rpm.len() as f64);
        Ok(points)
    };
    let rows = speeds_rpm.par_iter().map(row).collect::<Result<Vec<_>, _>>()?;
    let full_load = matches!(spec.what, What::FullLoad { .. });
    let warnings = rows.iter().flatten().filter_map(|p| warning(p, full_load)).collect();
    Ok(Loaded { warnings, full_load, speeds_rpm, torques_nm, rows })
}

/// Limits and torque that are numbers.
fn finite(spec: &Spec) -> Result<(), EngineJobError> {
    let l = &spec.limits;
    let full_load = match spec.what {
        What::FullLoad { torque_nm } => Some(("--torque-nm", torque_nm)),
        What::Map { .. } => None,
    };
    let all = [
        ("--max-map-kpa", l.map_kpa),
        ("--max-egt-degc", l.egt_k - 273.15),
        ("--max-pmax-bar", l.pmax_bar),
        ("--max-knock", l.knock),
    ];
    if let Some((name, found)) = all.into_iter().chain(full_load).find(|(_, v)| !v.is_finite()) {
        return Err(EngineJobError::Number { name: name.into(), found, expected: "a number".into() });
    }
    match full_load.filter(|(_, v)| *v <= 0.0) {
        Some((name, found)) => {
            let expected = "more than 0 Nm: it bounds the most torque of the engine".into();
            Err(EngineJobError::Number { name: name.into(), found, expected })
        }
        None => Ok(()),
    }
}

/// What is not as asked for at a point.
fn warning(p: &LoadPoint, full_load: bool) -> Option<String> {
    let (n, t) = (p.request.speed_rpm, p.request.torque_nm);
    match p.barrier {
        Some(barrier) if !full_load => {
            let held = p.outputs.torque_nm;
            Some(format!("{n} rpm, {t} Nm is out of reach ({held:.1} Nm were held): {}", barrier.reason()))
        }
        // Most torque is asked for, and this is more.
        Some(Barrier::ThrottleClosed) => {
            let (held, why) = (p.outputs.torque_nm, Barrier::ThrottleClosed.reason());
            Some(format!("{n} rpm: {held:.1} Nm were held where {t} Nm were to bound it: {why}"))
        }
        _ if !p.settled => Some(format!("{n} rpm, {t} Nm did not come to rest in {:.0} s", p.time_s)),
        _ => p.passed().map(|limits| {
            let held = p.outputs.torque_nm;
            format!("{n} rpm, {held:.1} Nm is held past a limit, as what would keep it stands at its end: {limits}")
        }),
    }
}
