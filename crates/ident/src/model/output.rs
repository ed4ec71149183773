//! Outputs of a NARX model on a record: one step, k steps, free run.

use serde::{Deserialize, Serialize};

use super::{Model, Run};
use crate::experiment::Experiment;

/// How outputs are computed. Never compare scores of different kinds.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Kind {
    /// From measured past outputs.
    OneStep,
    /// From outputs measured up to k samples before.
    KStep(usize),
    /// From the model's own past outputs.
    FreeRun,
}

/// Output of the model on one experiment, computed as `kind` says; samples before the first computed one are the
/// measured ones.
pub fn output(model: &dyn Model, theta: &[f64], e: &Experiment, kind: Kind) -> Vec<f64> {
    let run = e.run(model);
    let mut y = vec![0.0; e.len()];
    match kind {
        Kind::OneStep => model.predict(theta, &run, &mut y),
        Kind::FreeRun => {
            model.simulate(theta, &run, &mut y);
        }
        Kind::KStep(k) => k_step(model, theta, &run, k.max(1), &mut y),
    }
    y
}

/// Prediction k samples ahead, y(t | t-k): measured outputs up to t-k, inputs up to t. For every t a free run over the last k
/// samples from the measured outputs before.
fn k_step(model: &dyn Model, theta: &[f64], run: &Run, k: usize, y: &mut [f64]) {
    let (m, lag) = (model.n_inputs(), model.max_lag());
    let start = run.start.min(run.len());
    y[..start].copy_from_slice(&run.y[..start]);
    let mut tail = vec![0.0; lag + k];
    for t in start..run.len() {
        // Near the start fewer samples are free: nothing before it is computed.
        let free = k.min(t + 1 - start);
        let from = t + 1 - free - lag;
        let part = Run { u: &run.u[from * m..(t + 1) * m], y: &run.y[from..=t], start: lag };
        let tail = &mut tail[..lag + free];
        model.simulate(theta, &part, tail);
        y[t] = tail[lag + free - 1];
    }
}
