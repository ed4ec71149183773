//! Points of a map or of full load on the engine, speeds in parallel.

use std::sync::atomic::{AtomicUsize, Ordering};

use dynocal_numerics::watch::Watch;
use dynocal_plant::full_load::{LoadPoint, load_map};
use rayon::prelude::*;

use super::{Loaded, Spec, What};
use crate::engine::{Engine, EngineJobError};

/// Holds every point.
///
/// # Errors
/// [`EngineJobError`]: a grid that is none, a point that cannot be held at all, an interruption.
pub fn run(engine: &Engine, spec: &Spec, watch: Watch) -> Result<Loaded, EngineJobError> {
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
        let points = rows.into_iter().flatten().collect::<Result<Vec<_>, _>>()?;
        let done = finished.fetch_add(1, Ordering::Relaxed) + 1;
        watch.fraction(done as f64 / speeds_rpm.len() as f64);
        Ok(points)
    };
    let rows = speeds_rpm.par_iter().map(row).collect::<Result<Vec<_>, _>>()?;
    let moving = rows.iter().flatten().filter(|p| !p.settled).map(|p| {
        let (n, t) = (p.request.speed_rpm, p.request.torque_nm);
        format!("{n} rpm, {t} Nm did not come to rest in {:.0} s", p.time_s)
    });
    Ok(Loaded { warnings: moving.collect(), speeds_rpm, torques_nm, rows })
}
