//! Model in the loop: car, driver and engine along a speed cycle, fuel by a static map, a dynamic map (air, manifold and film that
//! were identified, inverted), a production ECU or measured air, each without and with feedback of lambda; a catalyst behind the engine.
//!
//! Maps, models and what the ECU tunes are of one engine as it is (`known`), and drive engines that are like it. The sensor of lambda
//! sees the gas of a cycle after a transport that goes with one over the flow, through a lag (`sensor`). Throttle and spark are those of
//! the static map for all.

mod known;
mod sensor;
mod source;

use dynocal_calib::fuelling::Feedback;
use dynocal_plant::engine::VirtualEngine;
use dynocal_plant::params::EngineParams;
use dynocal_plant::vehicle::{Car, DriveCycle, DriveOptions, drive};
use rayon::prelude::*;
use serde::{Deserialize, Serialize};

use known::{Known, known};
use source::Source;

/// Speeds of the maps in rpm, and torques a speed.
const SPEEDS_RPM: [f64; 7] = [800.0, 1200.0, 1700.0, 2300.0, 3000.0, 3800.0, 4600.0];
const TORQUES: usize = 6;
/// Step of car, engine and controllers in s.
const STEP_S: f64 = 0.02;
/// Most fuel of an injection in mg.
const MOST_MG: f64 = 120.0;
/// Distance of lambda from 1 that counts.
const NEAR: f64 = 0.01;
/// How the drives are made, for results that are kept.
pub(crate) const METHOD: &str =
    "identified from records with corners, loops by line searches, predictors by the flow of the own fuel";

/// What gives the fuel before any feedback.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum FuelBy {
    /// The steady map of demand and speed.
    Map,
    /// The air of the last cycle.
    Air,
    /// The identified air, manifold and film, inverted.
    Dynamic,
    /// Air by the extrapolated pressure, film compensated.
    Ecu,
}

/// What holds lambda.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Hold {
    Nothing,
    /// A PI by SIMC for a usual transport.
    Pi,
    /// The same with a map that learns.
    PiTrim,
    /// A Smith predictor with transport by flow: the measured one where air is, else that of the own fuel.
    Smith,
    /// A Smith predictor with a map that learns.
    SmithTrim,
    /// The trim of the dynamic map by the predicted sensor.
    Trim,
    /// The same with a charge that is learnt over speed and pressure.
    Adapt,
    /// The learnt charge, with a Smith predictor in the place of the trim.
    AdaptSmith,
    /// The loop of an ECU, its time constant found by a line search on a record for each way of fuelling.
    Loop,
    /// The same about a lambda that holds the oxygen of the catalyst.
    LoopRear,
}

/// All that are compared, with their names.
pub(crate) const FUELLED: [(&str, FuelBy, Hold); 18] = [
    ("static map", FuelBy::Map, Hold::Nothing),
    ("static map, PI", FuelBy::Map, Hold::Pi),
    ("static map, PI, long-term trim", FuelBy::Map, Hold::PiTrim),
    ("static map, Smith predictor", FuelBy::Map, Hold::Smith),
    ("static map, Smith predictor, long-term trim", FuelBy::Map, Hold::SmithTrim),
    ("dynamic map", FuelBy::Dynamic, Hold::Nothing),
    ("dynamic map, feedback", FuelBy::Dynamic, Hold::Loop),
    ("dynamic map, feedback, rear trim", FuelBy::Dynamic, Hold::LoopRear),
    ("dynamic map, Smith predictor", FuelBy::Dynamic, Hold::Smith),
    ("production ECU", FuelBy::Ecu, Hold::Nothing),
    ("production ECU, feedback", FuelBy::Ecu, Hold::Loop),
    ("production ECU, Smith predictor", FuelBy::Ecu, Hold::Smith),
    ("production ECU, Smith predictor, long-term trim", FuelBy::Ecu, Hold::SmithTrim),
    ("dynamic map, trim by the predicted sensor", FuelBy::Dynamic, Hold::Trim),
    ("dynamic map, adapted", FuelBy::Dynamic, Hold::Adapt),
    ("dynamic map, adapted, Smith predictor", FuelBy::Dynamic, Hold::AdaptSmith),
    ("measured air, PI", FuelBy::Air, Hold::Pi),
    ("measured air, Smith predictor", FuelBy::Air, Hold::Smith),
];

/// A drive.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub(crate) struct Driven {
    pub(crate) name: String,
    pub(crate) fuel_g: f64,
    /// Share of the fuelled time with lambda within 1 %, and mean distance of lambda from 1 over it.
    pub(crate) within: f64,
    pub(crate) off: f64,
    /// Root of the mean squared distance of the torque from its demand, in Nm, where torque is asked for.
    pub(crate) torque_nm: f64,
    /// Share of the fuelled time with lambda behind the catalyst outside of 1 %, and how often it left it.
    pub(crate) broken: f64,
    pub(crate) breaks: u32,
    /// Carbon monoxide, hydrocarbons and nitric oxide behind the catalyst in g per km.
    pub(crate) tailpipe_g_km: [f64; 3],
    /// Steps outside of the tolerance of the cycle.
    pub(crate) outside: usize,
}

/// All drives of one engine along the cycle.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub(crate) struct CycleCase {
    pub(crate) cycle: String,
    pub(crate) driven_engine: String,
    pub(crate) length_s: f64,
    pub(crate) drives: Vec<Driven>,
    /// What line searches found: the ECU's extrapolation, the closed loops of the ECU and of the dynamic map, in s.
    pub(crate) found_s: [f64; 3],
}

impl CycleCase {
    /// The drive of a controller.
    pub(crate) fn drive(&self, title: &str) -> Option<&Driven> {
        self.drives.iter().find(|d| d.name == title)
    }
}

/// The engine of a parameter set after a second of running: means over a cycle are there.
fn running(set: &str) -> Result<VirtualEngine, String> {
    let params = EngineParams::named(set).map_err(|e| e.to_string())?;
    let mut engine = VirtualEngine::new(&params).map_err(|e| e.to_string())?;
    engine.advance_time(1.0);
    engine.check_state().map_err(|e| e.to_string())?;
    Ok(engine)
}

/// Controllers along the cycle on the engine `driven`, maps and models from the engine `mapped`.
pub(crate) fn contest(
    (mapped, driven): (&str, &str),
    who: &[(&'static str, FuelBy, Hold)],
    name: &str,
    cycle: &DriveCycle,
    stop: &(dyn Fn() -> bool + Sync),
) -> Result<CycleCase, String> {
    let known = known(mapped, stop)?;
    let engine = running(driven)?;
    let one = |(title, by, hold): &(&str, FuelBy, Hold)| {
        along(&engine, &known, (*by, *hold), cycle, stop)
            .map(|d| Driven { name: (*title).into(), ..d })
            .map_err(|e| format!("{title}: {e}"))
    };
    let drives = who.par_iter().map(one).collect::<Result<Vec<_>, String>>()?;
    let closed_s = |f: Option<Feedback>| f.map_or(f64::NAN, |f| f.closed_s);
    Ok(CycleCase {
        cycle: name.into(),
        driven_engine: driven.into(),
        length_s: cycle.duration_s(),
        drives,
        found_s: [known.ecu.ahead_s, closed_s(known.ecu.feedback), closed_s(Some(known.feedback))],
    })
}

fn along(
    engine: &VirtualEngine,
    known: &Known,
    fuelled: (FuelBy, Hold),
    cycle: &DriveCycle,
    stop: &dyn Fn() -> bool,
) -> Result<Driven, String> {
    let mut source = Source::new(engine, known, fuelled)?;
    let options = DriveOptions { step_s: STEP_S, ..DriveOptions::default() };
    let log = drive(&Car::thesis(), cycle, &mut source, options, stop).map_err(|e| e.to_string())?;
    if stop() {
        return Err("interrupted".into());
    }
    let t = &source.told;
    let fuelled_s = t.fuelled.max(STEP_S);
    Ok(Driven {
        name: String::new(),
        fuel_g: log.fuel_g,
        within: t.near / fuelled_s,
        off: t.off / fuelled_s,
        torque_nm: (t.torque.0 / t.torque.1.max(1.0)).sqrt(),
        broken: t.broken / fuelled_s,
        breaks: t.breaks,
        tailpipe_g_km: t.tailpipe_g.map(|g| g / (1e-3 * log.distance_m).max(1e-3)),
        outside: log.outside,
    })
}
