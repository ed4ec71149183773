//! The published dynamic map: the three recursive models of eq. (7.18) with delays removed by eq. (7.17).

use super::structures::{
    FitTask, FittedMap, InverseScore, MapError, MapRow, MapStructure, Pairs, StoredMap, r2,
};
use super::{FeedforwardMap, Ports, Rows};
use dynocal_files::spec::Faults;
use dynocal_ident::estimate::{Estimator, ols::Ols, sem::Sem};
use dynocal_ident::experiment::Experiment;
use dynocal_ident::model::poly::PolyNarx;
use dynocal_ident::model::{Model, Run, literature};
use dynocal_numerics::registry::{self, MemberDoc};
use dynocal_numerics::status::Status;
use serde::{Deserialize, Serialize};
use std::sync::Arc;

/// Row of the table.
pub(super) const ROW: MapRow = MapRow {
    doc: MemberDoc {
        name: "published_7_18",
        what: "the three recursive inverse models of eq. (7.18), for torque, lambda, speed and injection, spark, throttle",
        params: &[],
    },
    fits,
    build: |keys| Ok(Box::new(registry::keys::<Published>("published_7_18", keys)?)),
    read: |map| Ok(Arc::new(serde_json::from_value::<PublishedMap>(map)?)),
};

/// The structure; it has no keys.
#[derive(Debug, Default, Deserialize)]
#[serde(default, deny_unknown_fields)]
struct Published {}

/// The shift of eq. (7.17) in samples: longest delay of the engine models (5) plus that of the controller (3).
pub const PUBLISHED_SHIFT: usize = 8;

/// References that the published structures read, in the order of their inputs.
pub const REFERENCES: [&str; 3] = ["torque", "lambda", "speed"];
/// Actuators that they give.
pub const ACTUATORS: [&str; 3] = ["inj", "spark", "throttle"];

/// Three recursive inverse models with their parameters.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct PublishedMap {
    /// What it reads and gives: [`REFERENCES`] and [`ACTUATORS`].
    pub ports: Ports,
    /// Structures of INJ, SA and throttle.
    pub models: [PolyNarx; 3],
    /// Their parameters.
    pub theta: [Vec<f64>; 3],
    /// Shift of eq. (7.17) in samples.
    pub shift: usize,
}

/// Whether the published structures are for these ports.
fn fits(ports: &Ports) -> bool {
    ports.demands.len() == 2 && ports.reference_names() == REFERENCES && ports.actuator_names() == ACTUATORS
}

/// Structures of eq. (7.18) in the order INJ, SA, throttle.
pub fn structures() -> [PolyNarx; 3] {
    literature::inverse_7_18().map(|m| m.model)
}

impl MapStructure for Published {
    fn check(&self, _ports: &Ports, _key: &str, _faults: &mut Faults) {}

    fn fit(&self, task: &FitTask) -> Result<FittedMap, MapError> {
        let models = structures();
        let mut theta: [Vec<f64>; 3] = Default::default();
        let mut scores = Vec::new();
        for (c, model) in models.iter().enumerate() {
            theta[c] = fit_one(task, c, model, &mut scores);
        }
        let stable = theta.iter().all(|t| !t.is_empty());
        let ports = task.ports.clone();
        let map =
            stable.then(|| StoredMap::new(PublishedMap { ports, models, theta, shift: PUBLISHED_SHIFT }));
        Ok(FittedMap { map, scores })
    }
}

/// Parameters of actuator `c` by the simulation error; empty where no fit can be run freely.
fn fit_one(task: &FitTask, c: usize, model: &PolyNarx, scores: &mut Vec<InverseScore>) -> Vec<f64> {
    let experiments = shifted(task.pairs, c);
    // The least-squares start of these structures is often unstable: several starts are worth their time.
    let sem =
        Sem { max_evaluations: 100, restarts: 3, seed: task.seed, cost_tolerance: 1e-8, ..Sem::default() };
    let jobs: [(&str, &dyn Estimator); 2] = [("one-step error", &Ols::default()), ("simulation error", &sem)];
    let mut theta = Vec::new();
    for (estimator, job) in jobs {
        let fit = job.estimate(model, &experiments, None, task.interrupt);
        let (r2, status) = match &fit {
            Ok(fit) => (simulated_r2(model, &fit.theta, &experiments), fit.status),
            Err(_) => (None, Status::Diverged),
        };
        scores.push(InverseScore {
            map: "published inverse (7.18)".into(),
            actuator: ACTUATORS[c].into(),
            estimator: estimator.into(),
            r2,
            status,
        });
        // A fit whose free run diverges is no map.
        if let (Ok(fit), "simulation error", Some(_)) = (fit, estimator, r2) {
            theta = fit.theta;
        }
    }
    theta
}

/// Records shifted by eq. (7.17): response at t + shift explains the actuator at t.
fn shifted(data: &[Pairs], actuator: usize) -> Vec<Experiment> {
    let one = |(k, pairs): (usize, &Pairs)| {
        let (response, actuators) = (pairs.response, pairs.actuators);
        let n = response.len().saturating_sub(PUBLISHED_SHIFT);
        let from = PUBLISHED_SHIFT.min(response.len()) * response.width();
        Experiment {
            name: format!("optimal record {}", k + 1),
            u: response.values()[from..].to_vec(),
            y: (0..n).map(|t| actuators.row(t)[actuator]).collect(),
            init_samples: 4,
            weights: Vec::new(),
        }
    };
    data.iter().enumerate().map(one).collect()
}

fn simulated_r2(model: &dyn Model, theta: &[f64], data: &[Experiment]) -> Option<f64> {
    let (mut y, mut z) = (Vec::new(), Vec::new());
    for e in data {
        let mut out = vec![0.0; e.len()];
        let start = e.first(model);
        model.simulate(theta, &Run { u: &e.u, y: &e.y, start }, &mut out);
        y.extend_from_slice(&out[start..]);
        z.extend_from_slice(&e.y[start..]);
    }
    r2(&y, &z)
}

impl FeedforwardMap for PublishedMap {
    fn name(&self) -> &str {
        "published map (7.18)"
    }

    fn ports(&self) -> &Ports {
        &self.ports
    }

    fn drive(&self, reference: &Rows, _sample_time_s: f64) -> Rows {
        // The models map y(t + shift) to u(t): fed with the demand itself, the engine answers `shift` samples late.
        let n = reference.len();
        let mut out = Rows::from_values(3, vec![0.0; 3 * n]);
        for c in 0..3 {
            let start = self.models[c].max_lag().min(n);
            let rest = if n == 0 { 0.0 } else { self.rest(c, reference.row(0)) };
            let (y0, mut y) = (vec![rest; n], vec![rest; n]);
            let run = Run { u: reference.values(), y: &y0, start };
            self.models[c].simulate(&self.theta[c], &run, &mut y);
            out.set_column(c, &y);
        }
        for t in 0..n {
            self.ports.clamp(out.row_mut(t));
        }
        out
    }

    fn steady(&self, reference: &[f64]) -> Vec<f64> {
        (0..ACTUATORS.len()).map(|c| self.rest(c, reference)).collect()
    }

    fn structure(&self) -> &'static str {
        ROW.doc.name
    }

    fn stored(&self) -> Result<serde_json::Value, serde_json::Error> {
        serde_json::to_value(self)
    }

    fn latency_s(&self, sample_time_s: f64) -> f64 {
        self.shift as f64 * sample_time_s
    }
}

impl PublishedMap {
    /// Value at which model `c` rests for a reference that is held: the fixed point found by running it.
    fn rest(&self, c: usize, reference: &[f64]) -> f64 {
        let n = 400;
        let port = &self.ports.actuators[c];
        let middle = 0.5 * (port.lower + port.upper.min(30.0));
        let u = reference.repeat(n);
        let y0 = vec![middle; n];
        let mut y = y0.clone();
        let start = self.models[c].max_lag();
        self.models[c].simulate(&self.theta[c], &Run { u: &u, y: &y0, start }, &mut y);
        if y[n - 1].is_finite() { y[n - 1].clamp(port.lower, port.upper) } else { middle }
    }
}
