//! Tasks of the study `engine`: each runs the engine and returns what it did.

use crate::StudyError;
use crate::engine::results::{SparkAt70, StaticRow, StaticRows, Transient};
use crate::engine::transients::{self, Moments, PiLoops, RECORD_S, RandomInputs, rise_s};
use crate::engine::verification::{self, MapOptions, Motored, ReferencePoint};
use dynocal_numerics::interval::Interval;
use dynocal_plant::engine::VirtualEngine;
use dynocal_plant::error::PlantError;
use dynocal_plant::inputs::Inputs;
use dynocal_plant::params::EngineParams;
use dynocal_plant::statics::{SettleOptions, StaticPoint, Target, settle, static_map, steady};
use serde::Serialize;

/// Speeds of the motored runs \[rpm\].
pub(super) const MOTORED_RPM: [f64; 3] = [1000.0, 2000.0, 3000.0];
/// Speeds of the runs with open throttle \[rpm\].
pub(super) const OPEN_RPM: [f64; 5] = [1000.0, 2000.0, 3000.0, 4000.0, 5000.0];

fn failed(what: &str) -> impl Fn(PlantError) -> StudyError + '_ {
    move |e| StudyError::Task { what: what.into(), reason: e.to_string() }
}

fn at_2000(torque_nm: f64) -> Target {
    Target { speed_rpm: 2000.0, torque_nm, lambda: 1.0 }
}

/// The static map at one speed.
#[derive(Serialize)]
pub(super) struct StaticTask {
    pub(super) speed_rpm: f64,
    pub(super) torques_nm: Vec<f64>,
    pub(super) seed: u64,
    pub(super) first: u64,
    pub(super) reference: Option<Vec<ReferencePoint>>,
    /// Why the reference cannot be read.
    pub(super) fault: Option<String>,
}

impl StaticTask {
    pub(super) fn run(&self) -> Result<StaticRows, StudyError> {
        if let Some(reason) = &self.fault {
            return Err(StudyError::Task { what: "reference of the engine".into(), reason: reason.clone() });
        }
        let speed_rpm = self.speed_rpm;
        let targets: Vec<Target> =
            self.torques_nm.iter().map(|t| Target { speed_rpm, torque_nm: *t, lambda: 1.0 }).collect();
        let options = MapOptions { seed: self.seed, first: self.first, ..MapOptions::default() };
        let points = verification::map_points(&EngineParams::thesis(), &targets, options)
            .map_err(failed("static map"))?;
        let rows = points.into_iter().zip(&targets).map(|(point, target)| {
            let found = self.reference.iter().flatten().find(|r| r.torque_nm == target.torque_nm);
            let (point, error) = match point {
                Ok(p) => (Some(p), None),
                Err(e) => (None, Some(e.to_string())),
            };
            let difference = found.zip(point.as_ref()).map(|(r, p)| r.differences(&p.best));
            StaticRow { target: *target, point, error, referenced: found.is_some(), difference }
        });
        Ok(StaticRows { points: rows.collect(), compared: self.reference.is_some() })
    }
}

pub(super) fn motored() -> Result<Vec<Motored>, StudyError> {
    let run = |speed_rpm: f64| {
        let inputs = Inputs { speed_rpm, throttle_deg: 90.0, ..Inputs::default() };
        verification::motored(&EngineParams::thesis(), inputs)
    };
    MOTORED_RPM.into_iter().map(run).collect::<Result<_, _>>().map_err(failed("motored run"))
}

pub(super) fn open_throttle() -> Result<Vec<StaticPoint>, StudyError> {
    let run = |speed_rpm: f64| verification::open_throttle(&EngineParams::thesis(), speed_rpm, 1.0);
    OPEN_RPM.into_iter().map(run).collect::<Result<_, _>>().map_err(failed("run with open throttle"))
}

/// The best points at 2000 rpm for each torque.
fn best(torques_nm: &[f64]) -> Result<Vec<StaticPoint>, StudyError> {
    let targets: Vec<Target> = torques_nm.iter().map(|t| at_2000(*t)).collect();
    let all = static_map(&EngineParams::thesis(), &targets, SettleOptions::default())
        .map_err(failed("static map"))?;
    all.into_iter().collect::<Result<_, _>>().map_err(failed("static map"))
}

pub(super) fn spark() -> Result<SparkAt70, StudyError> {
    let params = EngineParams::thesis();
    let sparks: Vec<f64> = (0..=15).map(|k| 5.0 + 2.0 * f64::from(k)).collect();
    let fuel =
        verification::fuel_against_spark(&params, at_2000(70.0), &sparks).map_err(failed("spark sweep"))?;
    let mut torque = Vec::new();
    for point in best(&[70.0])? {
        torque = verification::torque_against_spark(&params, point.inputs, &sparks)
            .map_err(failed("spark sweep"))?;
    }
    let (maxima, second) = verification::shape(&torque);
    let largest_second_difference_nm = second;
    Ok(SparkAt70 {
        spark_deg: sparks,
        fuel_mg: fuel,
        torque_nm: torque,
        maxima,
        largest_second_difference_nm,
    })
}

pub(super) fn transients() -> Result<Vec<Transient>, StudyError> {
    transients_inner().map_err(|e| match e {
        Inner::Chain(e) => *e,
        Inner::Plant(e) => failed("transients")(e),
    })
}

enum Inner {
    Chain(Box<StudyError>),
    Plant(PlantError),
}
impl From<StudyError> for Inner {
    fn from(e: StudyError) -> Self {
        Inner::Chain(Box::new(e))
    }
}
impl From<PlantError> for Inner {
    fn from(e: PlantError) -> Self {
        Inner::Plant(e)
    }
}

fn transients_inner() -> Result<Vec<Transient>, Inner> {
    let rest = VirtualEngine::new(&EngineParams::thesis())?;
    let points = best(&[10.0, 30.0, 60.0, 70.0, 90.0])?;
    let [p10, p30, p60, p70, p90] = points[..] else {
        return Err(
            StudyError::Task { what: "static map".into(), reason: "five points expected".into() }.into()
        );
    };
    let mut settled = rest.clone();
    let start = settle(&mut settled, at_2000(60.0), p60.inputs.spark_deg, SettleOptions::default())?;
    settled.advance_time(3.0);
    let u = start.inputs;
    let steps = [
        ("INJ -3 mg", Inputs { injection_mg: u.injection_mg - 3.0, ..u }),
        ("SA -10 deg", Inputs { spark_deg: u.spark_deg - 10.0, ..u }),
        ("throttle +3 deg", Inputs { throttle_deg: u.throttle_deg + 3.0, ..u }),
        ("throttle -3 deg", Inputs { throttle_deg: u.throttle_deg - 3.0, ..u }),
    ];
    let mut out = Vec::new();
    for (name, inputs) in steps {
        let r = transients::step(&mut settled.clone(), inputs, 5.0)?;
        let rise = rise_s(&r.torque_nm, RECORD_S);
        out.push(Transient { rise_s: rise.is_finite().then_some(rise), ..Transient::new(name, &r) });
    }
    for (name, from, to) in
        [("30->70 Nm", p30, p70), ("70->30 Nm", p70, p30), ("10->90 Nm", p10, p90), ("90->10 Nm", p90, p10)]
    {
        let mut engine = rest.clone();
        steady(&mut engine, from.inputs, 4.0, 0.1)?;
        let r = transients::step(&mut engine, to.inputs, 5.0)?;
        let end = r.torque_nm.last().copied().unwrap_or(f64::NAN);
        out.push(Transient::new(name, &r).settling_to(end));
    }
    for (name, loops) in [("PI eq. 6.1", PiLoops::THESIS_6_1), ("PI eq. 7.5", PiLoops::THESIS_7_5)] {
        let mut engine = rest.clone();
        let from = settle(&mut engine, at_2000(70.0), p70.inputs.spark_deg, SettleOptions::default())?;
        engine.advance_time(3.0);
        let r = loops.demand_step(&mut engine, &from, 50.0, 12.0)?;
        out.push(Transient::new(name, &r).settling_to(50.0));
    }
    Ok(out)
}

/// The thesis' random record (tables 5.4, 5.6): its hold time and its lambda cap are not stated.
pub(super) fn random_inputs(seed: u64, time_s: f64) -> Result<Moments, StudyError> {
    let signal = RandomInputs {
        speed_rpm: 2000.0,
        injection_mg: Interval::new(0.0, 35.0),
        spark_deg: Interval::new(5.0, 30.0),
        throttle_deg: Interval::new(5.0, 20.0),
        hold_s: 0.6,
        sample_time_s: 0.03,
        lambda_cap: 5.0,
        time_s,
        seed,
    };
    let mut engine = VirtualEngine::new(&EngineParams::thesis()).map_err(failed("random inputs"))?;
    signal.moments(&mut engine).map_err(failed("random inputs"))
}
