//! The bed of chapter 6: the engine of the thesis with the loops of eq. (6.1) at one operating point after the other.

use dynocal_calib::problem::CalibrationProblem;
use dynocal_calib::steady::hold::{Held, HoldSpec, Resting, hold};
use dynocal_ident::data::Dataset;
use dynocal_ident::pi::PiGains;
use dynocal_ident::plan::{Plan, PlanChannel, PlanDemand, PlanLoop};
use dynocal_ident::plant::Plant;
use dynocal_ident::play::{Unwatched, play};
use dynocal_plant::plants::{self, PlantSpec};
use serde::{Deserialize, Serialize};

/// Interval of control and measurement in s (chapter 7).
pub(super) const SAMPLE_S: f64 = 0.03;
/// Eq. (6.1): throttle by torque in deg/(Nm s) and deg/Nm, injected fuel by lambda in mg/s and mg.
const TORQUE: PiGains = PiGains { ki: 0.15, kp: 0.007 };
const LAMBDA: PiGains = PiGains { ki: -20.0, kp: -1.5 };
/// Range of the spark sweeps in deg before top dead centre, eq. (6.2).
pub(super) const SPARKS: [f64; 2] = [5.0, 40.0];
/// Change of a demanded output that counts as none, in Nm and as lambda.
pub(super) const RESOLUTION: [f64; 2] = [0.02, 2e-4];

/// An operating point.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub(super) struct At {
    pub(super) torque_nm: f64,
    pub(super) speed_rpm: f64,
}

/// Injected fuel, spark and throttle.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub(super) struct Actuators {
    pub(super) inj_mg: f64,
    pub(super) spark_deg: f64,
    pub(super) throttle_deg: f64,
}

impl Actuators {
    pub(super) fn of(values: &[f64]) -> Self {
        Self { inj_mg: values[0], spark_deg: values[1], throttle_deg: values[2] }
    }

    pub(super) fn values(self) -> [f64; 3] {
        [self.inj_mg, self.spark_deg, self.throttle_deg]
    }
}

/// Where every row of points begins.
pub(super) const START: Actuators = Actuators { inj_mg: 8.0, spark_deg: 20.0, throttle_deg: 5.0 };

/// The problem of the thesis over the region and the sparks of eq. (6.2).
pub(super) fn problem() -> CalibrationProblem {
    let mut p = CalibrationProblem::thesis();
    p.inputs[1].lower = SPARKS[0];
    p.inputs[1].upper = SPARKS[1];
    (p.demands[0].lower, p.demands[0].upper) = (0.0, 100.0);
    p
}

/// The engine with what was used of it.
pub(super) struct Bed {
    plant: Box<dyn Plant>,
    problem: CalibrationProblem,
    /// Bed time so far in s.
    pub(super) used_s: f64,
}

impl Bed {
    pub(super) fn new() -> Result<Self, String> {
        let make = plants::find("virtual_engine").and_then(|p| p.make).ok_or("there is no virtual engine")?;
        let mut plant = make(&PlantSpec::default(), false).map_err(|e| e.to_string())?;
        plant.reset(1);
        Ok(Self { plant, problem: problem(), used_s: 0.0 })
    }

    /// A plan at `at`: actuators along `sparks` with the loops closed over the feedforward `from`.
    fn plan(&self, at: At, from: Actuators, sparks: &[f64]) -> Plan {
        let n = sparks.len();
        let values = [vec![from.inj_mg; n], sparks.to_vec(), vec![from.throttle_deg; n]];
        let mut plan = self.open(values, vec![at.speed_rpm; n]);
        let demand = |k: usize, value: f64| PlanDemand {
            output: self.problem.demands[k].output.clone(),
            unit: self.problem.demands[k].unit.clone(),
            values: vec![value; n],
        };
        let loops =
            vec![PlanLoop::closed("torque", "throttle", TORQUE), PlanLoop::closed("lambda", "inj", LAMBDA)];
        plan = plan.with_loops(vec![demand(0, at.torque_nm), demand(1, 1.0)], loops);
        plan
    }

    /// A plan without loops.
    fn open(&self, values: [Vec<f64>; 3], speed_rpm: Vec<f64>) -> Plan {
        let inputs = self.problem.inputs.iter().zip(values);
        let inputs = inputs.map(|(i, v)| PlanChannel::free(&i.name, &i.unit, v).within(i.lower, i.upper));
        let speed = PlanChannel::free("speed", "rpm", speed_rpm);
        let mut plan = Plan::open_loop("chapter 6", SAMPLE_S, inputs.chain([speed]).collect());
        plan.outputs = vec!["torque".into(), "lambda".into()];
        plan
    }

    /// Holds `at` with the loops closed, from the actuators `from`, at their spark.
    pub(super) fn hold(&mut self, at: At, from: Actuators, spec: &HoldSpec) -> Result<Held, String> {
        let n = spec.samples(SAMPLE_S);
        let plan = self.plan(at, from, &vec![from.spark_deg; n]);
        let resting: Vec<Resting> = [at.torque_nm, 1.0]
            .into_iter()
            .zip(RESOLUTION)
            .zip(&self.problem.demands)
            .map(|((demand, resolution), d)| Resting { output: d.output.clone(), demand, resolution })
            .collect();
        let held = hold(self.plant.as_mut(), spec, &plan, &resting).map_err(|e| e.to_string())?;
        self.used_s += held.used_s;
        Ok(held)
    }

    /// Moves the spark along `sparks` (deg, one a sample) with the loops closed.
    pub(super) fn sweep(&mut self, at: At, from: Actuators, sparks: &[f64]) -> Result<Dataset, String> {
        let plan = self.plan(at, from, sparks);
        self.play(&plan)
    }

    /// Plays actuators and speed without loops.
    pub(super) fn drive(&mut self, values: [Vec<f64>; 3], speed_rpm: Vec<f64>) -> Result<Dataset, String> {
        let plan = self.open(values, speed_rpm);
        self.play(&plan)
    }

    fn play(&mut self, plan: &Plan) -> Result<Dataset, String> {
        let played = play(self.plant.as_mut(), plan, &mut Unwatched).map_err(|e| e.to_string())?;
        self.used_s += played.used_s;
        Ok(played.whole().map_err(|e| e.to_string())?.record)
    }

    /// Torque and lambda with the actuators alone, after `settle_s`, mean of one second.
    pub(super) fn alone(&mut self, at: At, u: Actuators, settle_s: f64) -> Result<[f64; 2], String> {
        let second = (1.0 / SAMPLE_S).round() as usize;
        let n = (settle_s / SAMPLE_S).round() as usize + second;
        let record = self.drive(u.values().map(|v| vec![v; n]), vec![at.speed_rpm; n])?;
        let mean = |name: &str| -> Result<f64, String> {
            let values = record.values(name).map_err(|e| e.to_string())?;
            Ok(values[n - second..].iter().sum::<f64>() / second as f64)
        };
        Ok([mean("torque")?, mean("lambda")?])
    }
}
