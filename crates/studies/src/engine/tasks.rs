//! Tasks of the study `engine`: each runs the engine and returns what it did as JSON.

use crate::StudyError;
use crate::engine::transients::{self, PiLoops, RECORD_S, RandomInputs, Response, rise_s, settling_s};
use crate::engine::verification::{self, MapOptions, ReferencePoint};
use dynocal_plant::engine::VirtualEngine;
use dynocal_plant::error::PlantError;
use dynocal_plant::inputs::Inputs;
use dynocal_plant::params::EngineParams;
use dynocal_plant::statics::{SettleOptions, StaticPoint, Target, settle, static_map, steady};
use serde::Serialize;
use serde_json::{Value, json};

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
    pub(super) fn run(&self) -> Result<Value, StudyError> {
        if let Some(reason) = &self.fault {
            return Err(StudyError::Task { what: "reference of the engine".into(), reason: reason.clone() });
        }
        let speed_rpm = self.speed_rpm;
        let targets: Vec<Target> =
            self.torques_nm.iter().map(|t| Target { speed_rpm, torque_nm: *t, lambda: 1.0 }).collect();
        let options = MapOptions { seed: self.seed, first: self.first, ..MapOptions::default() };
        let points = verification::map_points(&EngineParams::thesis(), &targets, options)
            .map_err(failed("static map"))?;
        let rows: Vec<Value> = points
            .iter()
            .zip(&targets)
            .map(|(point, target)| {
                let found = self.reference.iter().flatten().find(|r| r.torque_nm == target.torque_nm);
                let difference = found.zip(point.as_ref().ok()).map(|(r, p)| r.differences(&p.best));
                json!({ "target": target, "point": point.as_ref().ok(), "error": point.as_ref().err(),
                    "referenced": found.is_some(),
                    "difference": difference })
            })
            .collect();
        Ok(json!({ "points": rows, "compared": self.reference.is_some() }))
    }
}

pub(super) fn motored() -> Result<Value, StudyError> {
    let run = |speed_rpm: f64| {
        let inputs = Inputs { speed_rpm, throttle_deg: 90.0, ..Inputs::default() };
        verification::motored(&EngineParams::thesis(), inputs)
    };
    let points: Result<Vec<_>, _> = MOTORED_RPM.into_iter().map(run).collect();
    Ok(json!(points.map_err(failed("motored run"))?))
}

pub(super) fn open_throttle() -> Result<Value, StudyError> {
    let run = |speed_rpm: f64| verification::open_throttle(&EngineParams::thesis(), speed_rpm, 1.0);
    let points: Result<Vec<StaticPoint>, _> = OPEN_RPM.into_iter().map(run).collect();
    Ok(json!(points.map_err(failed("run with open throttle"))?))
}

/// The best points at 2000 rpm for each torque.
fn best(torques_nm: &[f64]) -> Result<Vec<StaticPoint>, StudyError> {
    let targets: Vec<Target> = torques_nm.iter().map(|t| at_2000(*t)).collect();
    let all = static_map(&EngineParams::thesis(), &targets, SettleOptions::default())
        .map_err(failed("static map"))?;
    all.into_iter().collect::<Result<_, _>>().map_err(failed("static map"))
}

pub(super) fn spark() -> Result<Value, StudyError> {
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
    Ok(json!({ "spark_deg": sparks, "fuel_mg": fuel, "torque_nm": torque, "maxima": maxima,
        "largest_second_difference_nm": second }))
}

pub(super) fn transients() -> Result<Value, StudyError> {
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

fn transients_inner() -> Result<Value, Inner> {
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
        out.push(described(
            name,
            &r,
            json!({ "rise_s": rise, "torque_end_nm": r.torque_nm.last(),
            "lambda_end": r.lambda.last() }),
        ));
    }
    for (name, from, to) in
        [("30->70 Nm", p30, p70), ("70->30 Nm", p70, p30), ("10->90 Nm", p10, p90), ("90->10 Nm", p90, p10)]
    {
        let mut engine = rest.clone();
        steady(&mut engine, from.inputs, 4.0, 0.1)?;
        let r = transients::step(&mut engine, to.inputs, 5.0)?;
        let end = r.torque_nm.last().copied().unwrap_or(f64::NAN);
        out.push(described(name, &r, settled_to(&r, end)));
    }
    for (name, loops) in [("PI eq. 6.1", PiLoops::THESIS_6_1), ("PI eq. 7.5", PiLoops::THESIS_7_5)] {
        let mut engine = rest.clone();
        let from = settle(&mut engine, at_2000(70.0), p70.inputs.spark_deg, SettleOptions::default())?;
        engine.advance_time(3.0);
        let r = loops.demand_step(&mut engine, &from, 50.0, 12.0)?;
        out.push(described(name, &r, settled_to(&r, 50.0)));
    }
    Ok(json!(out))
}

/// Settling to a torque within 1 Nm and to lambda 1 within 0.01 (none: never).
fn settled_to(r: &Response, torque_nm: f64) -> Value {
    json!({
        "torque_settling_s": settling_s(&r.torque_nm, torque_nm, 1.0, RECORD_S),
        "lambda_settling_s": settling_s(&r.lambda, 1.0, 0.01, RECORD_S),
        "torque_min_nm": r.torque_nm.iter().copied().fold(f64::INFINITY, f64::min),
    })
}

fn described(name: &str, r: &Response, numbers: Value) -> Value {
    let (low, high) = r.lambda_range();
    json!({ "name": name, "lambda_min": low, "lambda_max": high, "numbers": numbers, "torque_nm": r.torque_nm,
        "lambda": r.lambda })
}

/// The thesis' random record (tables 5.4, 5.6): its hold time and its lambda cap are not stated.
pub(super) fn random_inputs(seed: u64, time_s: f64) -> Result<Value, StudyError> {
    let signal = RandomInputs {
        speed_rpm: 2000.0,
        injection_mg: (0.0, 35.0),
        spark_deg: (5.0, 30.0),
        throttle_deg: (5.0, 20.0),
        hold_s: 0.6,
        sample_time_s: 0.03,
        lambda_cap: 5.0,
        time_s,
        seed,
    };
    let mut engine = VirtualEngine::new(&EngineParams::thesis()).map_err(failed("random inputs"))?;
    Ok(json!(signal.moments(&mut engine).map_err(failed("random inputs"))?))
}
