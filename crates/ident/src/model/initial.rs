//! Where a model's memory stands before the first sample that it computes: one rule, everywhere.
//!
//! ```text
//! rest        in equilibrium: zero for a linear model, else the output that the first inputs of the record hold
//! measured    the outputs before the first computed sample are the measured ones
//! estimated   they are what makes sum_t w(t) (y(t) - yhat(t))^2 least, yhat the free run
//! ```
//!
//! Measured outputs hold noise. A model with slow poles carries it through the whole run, and what is the noise of the
//! measurement becomes an error of the model: output-error structures and their like are started from `estimated`.
//!
//! Reference: L. Ljung, System Identification (1999), section 10.1 (initial conditions).

use dynocal_numerics::linalg::least_squares;
use dynocal_numerics::status::Status;
use serde::{Deserialize, Serialize};

use super::{Model, Run};
use crate::experiment::Experiment;

/// What stands before the first computed sample.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Initial {
    /// Equilibrium.
    #[default]
    #[serde(alias = "zero")]
    Rest,
    /// Measured values.
    #[serde(alias = "data")]
    Measured,
    /// Estimated, for each record.
    #[serde(alias = "estimate")]
    Estimated,
}

impl Initial {
    /// The rule as a spec writes it.
    pub fn key(self) -> &'static str {
        match self {
            Self::Rest => "rest",
            Self::Measured => "measured",
            Self::Estimated => "estimated",
        }
    }

    /// The rule in words.
    pub fn words(self) -> &'static str {
        match self {
            Self::Rest => "from rest",
            Self::Measured => "from measured outputs",
            Self::Estimated => "from estimated initial outputs",
        }
    }
}

/// A free run with its start.
#[derive(Clone, Debug, PartialEq)]
pub struct FreeRun {
    /// Output (N).
    pub y: Vec<f64>,
    /// [`Status::Diverged`] where a value is not finite, [`Status::Infeasible`] where there is no rest to start from: the
    /// model does not settle under the first inputs.
    pub status: Status,
    /// The outputs before the first computed sample that the run started from, the oldest first.
    pub states: Vec<f64>,
}

/// Free run of `model` over a record whose samples before `first` (at least the longest lag, at most N) initialise.
///
/// From `rest` every sample is computed; else those before `first` are the measured ones.
///
/// ```
/// use dynocal_ident::experiment::Experiment;
/// use dynocal_ident::model::initial::{Initial, free_run};
/// use dynocal_ident::model::poly::PolyNarx;
/// // y(t) = 0.9 y(t-1) + u(t-1) from y(0) = 5, of which the record says 4.
/// let u: Vec<f64> = (0..60).map(|t| f64::from((t * t / 3) % 5) - 2.0).collect();
/// let mut y = vec![5.0; 60];
/// (1..60).for_each(|t| y[t] = 0.9 * y[t - 1] + u[t - 1]);
/// let truth = y.clone();
/// y[0] = 4.0;
/// let e = Experiment { name: "a".into(), u, y, init_samples: 0, weights: vec![] };
/// let model = PolyNarx::parse(&["u"], "y", &["u(t-1)", "y(t-1)"])?;
/// let error = |rule| (free_run(&model, &[1.0, 0.9], &e, 1, rule).y[2] - truth[2]).abs();
/// assert!((error(Initial::Measured) - 0.81).abs() < 1e-12);
/// assert!(error(Initial::Estimated) < 1e-12);
/// # Ok::<(), dynocal_ident::model::poly::StructureError>(())
/// ```
pub fn free_run(model: &dyn Model, theta: &[f64], e: &Experiment, first: usize, rule: Initial) -> FreeRun {
    let first = first.max(model.max_lag()).min(e.len());
    match rule {
        Initial::Rest => from_rest(model, theta, e),
        Initial::Measured => from_outputs(model, theta, e, first, &e.y),
        Initial::Estimated => estimated(model, theta, e, first),
    }
}

fn from_outputs(model: &dyn Model, theta: &[f64], e: &Experiment, first: usize, before: &[f64]) -> FreeRun {
    let mut y = vec![0.0; e.len()];
    let status = model.simulate(theta, &Run { u: &e.u, y: before, start: first }, &mut y);
    let states = before[first - model.output_lag().min(first)..first].to_vec();
    FreeRun { y, status, states }
}

/// Samples after which a run under constant inputs has settled or never will.
const SETTLING: usize = 20_000;

fn from_rest(model: &dyn Model, theta: &[f64], e: &Experiment) -> FreeRun {
    let (m, lag, n) = (model.n_inputs(), model.max_lag(), e.len());
    let Some((level, inputs)) = rest(model, theta, e) else {
        let states = vec![f64::NAN; model.output_lag()];
        return FreeRun { y: vec![f64::NAN; n], status: Status::Infeasible, states };
    };
    let mut u: Vec<f64> = inputs.iter().copied().cycle().take(lag * m).collect();
    u.extend_from_slice(&e.u);
    let before = vec![level; lag + n];
    let mut y = vec![0.0; lag + n];
    let status = model.simulate(theta, &Run { u: &u, y: &before, start: lag }, &mut y);
    FreeRun { y: y.split_off(lag), status, states: vec![level; model.output_lag()] }
}

/// Output and inputs of the rest before a record: a linear model rests at zero, as is usual for what counts from an operating
/// point; any other where the first inputs hold it, and at zero only if they do not.
fn rest(model: &dyn Model, theta: &[f64], e: &Experiment) -> Option<(f64, Vec<f64>)> {
    let (m, lag) = (model.n_inputs(), model.max_lag());
    let inputs = e.u.get(..m)?.to_vec();
    let first = e.y.first().copied().filter(|v| v.is_finite());
    let next = |share: f64| {
        let mut one = vec![0.0; lag + 1];
        let u: Vec<f64> = inputs.iter().map(|v| share * v).cycle().take((lag + 1) * m).collect();
        let y = vec![share; lag + 1];
        model.predict(theta, &Run { u: &u, y: &y, start: lag }, &mut one);
        one[lag]
    };
    let zero = (next(0.0) == 0.0).then(|| (0.0, vec![0.0; m]));
    let linear = (next(2.0) - 2.0 * next(1.0)).abs() <= 1e-9 * next(2.0).abs();
    if zero.is_some() && linear {
        return zero;
    }
    // Measured outputs do not decide where a model rests, unless it does not find there from zero.
    let starts = [0.0].into_iter().chain(first);
    let held = starts.filter_map(|start| held(model, theta, &inputs, start)).next();
    held.map(|level| (level, inputs.clone())).or(zero)
}

/// Where constant inputs hold the output, from `start`; none where it does not come to rest.
fn held(model: &dyn Model, theta: &[f64], inputs: &[f64], start: f64) -> Option<f64> {
    let (m, lag) = (model.n_inputs(), model.max_lag());
    let (mut length, mut start) = (64.max(4 * lag), start);
    while length <= SETTLING {
        let n = lag + length;
        let u: Vec<f64> = inputs.iter().copied().cycle().take(n * m).collect();
        let (before, mut y) = (vec![start; n], vec![0.0; n]);
        if model.simulate(theta, &Run { u: &u, y: &before, start: lag }, &mut y) != Status::Converged {
            return None;
        }
        let last = y[n - 1];
        // Still over as many samples as the model remembers.
        let moved = y[n - lag.max(2)..].iter().map(|v| (v - last).abs()).fold(0.0, f64::max);
        if moved <= 1e-12 * last.abs().max(1e-12) {
            return Some(last);
        }
        (start, length) = (last, 2 * length);
    }
    None
}

/// Gauss-Newton over the outputs before `first`; exact sensitivities `v(t) = sum_j df/dy(t-j) v(t-j)`.
fn estimated(model: &dyn Model, theta: &[f64], e: &Experiment, first: usize) -> FreeRun {
    let count = model.output_lag().min(first);
    let mut found = from_outputs(model, theta, e, first, &e.y);
    if count == 0 {
        return found;
    }
    let mut cost = squares(e, &found, first);
    let mut before = e.y.clone();
    for _ in 0..MOST_STEPS {
        let Some(step) = step(model, theta, e, first, &found) else { break };
        let mut gain = 1.0;
        let mut better = None;
        while better.is_none() && gain > 1e-3 {
            let mut trial = before.clone();
            trial[first - count..first].iter_mut().zip(&step).for_each(|(y, s)| *y += gain * s);
            let run = from_outputs(model, theta, e, first, &trial);
            let new = squares(e, &run, first);
            if new < cost {
                better = Some((trial, run, new));
            }
            gain *= 0.25;
        }
        let Some((trial, run, new)) = better else { break };
        let gained = cost - new;
        (before, found, cost) = (trial, run, new);
        if gained <= 1e-12 * cost {
            break;
        }
    }
    // What initialises is shown as it was measured.
    found.y[..first].copy_from_slice(&e.y[..first]);
    found
}

/// Steps of the search: one suffices where the run is linear in its start.
const MOST_STEPS: usize = 25;

fn squares(e: &Experiment, run: &FreeRun, first: usize) -> f64 {
    if run.status != Status::Converged {
        return f64::INFINITY;
    }
    let one = |t: usize| e.weight(t) * (e.y[t] - run.y[t]).powi(2);
    (first..e.len()).filter(|t| !e.y[*t].is_nan()).map(one).sum()
}

fn step(model: &dyn Model, theta: &[f64], e: &Experiment, first: usize, now: &FreeRun) -> Option<Vec<f64>> {
    let count = now.states.len();
    let lags = model.output_lag();
    if now.status != Status::Converged {
        return None;
    }
    let mut gradient = vec![0.0; lags];
    // Row by row; those of the start are the unit matrix.
    let rows = e.len() - first + count;
    let mut v = vec![0.0; rows * count];
    (0..count).for_each(|j| v[j * count + j] = 1.0);
    // The run as its own past, with the outputs that it started from.
    let mut y = now.y.clone();
    y[first - count..first].copy_from_slice(&now.states);
    let run = Run { u: &e.u, y: &y, start: first };
    let (mut kept, mut errors) = (Vec::new(), Vec::new());
    let mut largest = 1.0_f64;
    for t in first..e.len() {
        model.output_derivatives(theta, &run, t, &mut gradient);
        let place = t - first + count;
        let (past, row) = v.split_at_mut(place * count);
        let row = &mut row[..count];
        for (lag, g) in (1..=lags.min(place)).zip(&gradient) {
            let earlier = &past[(place - lag) * count..(place - lag + 1) * count];
            row.iter_mut().zip(earlier).for_each(|(r, p)| *r += g * p);
        }
        largest = row.iter().fold(largest, |a, r| a.max(r.abs()));
        if !e.y[t].is_nan() {
            let w = e.weight(t).sqrt();
            kept.extend(row.iter().map(|r| w * r));
            errors.push(w * (e.y[t] - now.y[t]));
        }
        // The start is forgotten from here on.
        let tail = &v[(place + 1).saturating_sub(lags) * count..(place + 1) * count];
        if tail.iter().all(|r| r.abs() <= FORGOTTEN * largest) {
            break;
        }
    }
    let solved = least_squares(&kept, errors.len(), count, &errors, 0.0).ok()?;
    Some(solved.x)
}

/// Share of its largest effect below which the start is forgotten.
const FORGOTTEN: f64 = 1e-12;
