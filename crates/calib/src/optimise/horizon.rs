//! Receding horizon: at every step the next `length_s` are optimised, the first `step_s` of them applied.
//!
//! What is asked of outputs is soft (exact when its price is above that of the demand, [`super::prices`]), because a
//! horizon that is too short can lead to where no input meets the demand any more. Each step starts from the plan of the
//! one before.

use super::result::PartOutcome;
use super::setup::Setup;
use super::{EndCondition, Found, OptimiseOptions, batch_from};
use dynocal_numerics::status::Status;
use serde::{Deserialize, Serialize};

/// Least price of an output's whole range, relative to the objective at the start.
pub(super) const PRICE: f64 = 20.0;

/// A receding horizon.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Horizon {
    /// How far each step looks, in s.
    pub length_s: f64,
    /// How much of it is applied, in s; absent for one sample.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub step_s: Option<f64>,
    /// Price of an output's whole range missed for the whole horizon, in objective units; absent for twenty times the
    /// objective of the start.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub price: Option<f64>,
    /// Barrier parameter that a step begins with, in objective units: small where the plan before is nearly right already.
    #[serde(default = "warm")]
    pub warm_barrier: f64,
}

fn warm() -> f64 {
    1e-6
}

/// Goes through the record step by step.
pub(super) fn solve(
    setup: &Setup<'_>,
    options: &OptimiseOptions,
    spec: &Horizon,
    interrupt: &dyn Fn() -> bool,
) -> Found {
    let count = |s: f64| ((s / setup.sample_time_s).round().max(1.0)) as usize;
    let (length, step) = (count(spec.length_s), spec.step_s.map_or(1, count));
    let objective: f64 = setup.start_objective();
    let whole = setup.elastic(spec.price.unwrap_or(PRICE * objective.abs().max(1e-9)), 1.0);
    let width = whole.columns.len();
    let more = setup.samples - setup.to;
    let mut found = Found::start(&whole);
    let mut t = setup.from;
    while t < setup.to {
        let end = t.saturating_add(length).min(setup.to);
        let from = if t == setup.from { 0 } else { t - setup.lag };
        let apply = if end == setup.to { setup.to } else { t.saturating_add(step).min(end) };
        let mut slice = whole.slice(&found.values, from..end + more, EndCondition::Free);
        // Samples that come into view have the outputs of the record, which do not follow from the plan before them.
        let mut start = std::mem::take(&mut slice.start);
        slice.answer(&mut start);
        slice.start = start;
        let warm = (t > setup.from).then_some(spec.warm_barrier);
        let part = batch_from(&slice, options, warm, interrupt);
        // All of the plan: what is not applied is where the next step starts.
        found.values[t * width..(end + more) * width].copy_from_slice(&part.values[(t - from) * width..]);
        found.iterations += part.iterations;
        if found.status == Status::Converged {
            found.status = part.status;
        }
        let at = |t: usize| t as f64 * setup.sample_time_s;
        let (status, iterations) = (part.status, part.iterations);
        found.parts.push(PartOutcome { from_s: at(t), to_s: at(apply), status, iterations });
        if part.status == Status::Interrupted {
            break;
        }
        t = apply;
    }
    whole.narrowed(setup, &mut found);
    found
}
