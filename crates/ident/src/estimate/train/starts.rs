//! Where the searches start.

use dynocal_numerics::rng::Rng64;
use serde::Deserialize;

use super::Train;
use super::problem::Task;
use crate::estimate::EstimateError;
use crate::estimate::simulation::{SimulationError, least_squares_start};
use crate::estimate::{names, short_name};
use crate::experiment::Experiment;
use crate::model::Model;

/// What a search begins with.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Start {
    /// Random weights.
    #[default]
    Random,
    /// Random weights, first trained as one-step prediction (series-parallel form).
    OneStep,
    /// Random neurons that do not contribute yet, beside a linear path fitted by least squares.
    Linear,
}

/// A start of the caller's.
#[derive(Clone, Copy)]
pub(super) enum Given<'a> {
    /// In place of the first.
    First(Option<&'a [f64]>),
    /// One more.
    Beside(Option<&'a [f64]>),
}

/// Ridge of the linear start, relative to the regressors: keeps copies of slow channels from cancelling each other.
const LINEAR_RIDGE: f64 = 1e-10;

/// The starts of all searches: random ones where the model has such, else least squares and points around it.
pub(super) fn all(
    train: &Train,
    model: &dyn Model,
    data: &[Experiment],
    samples: usize,
    task: &mut Task,
    given: Given,
) -> Result<Vec<Vec<f64>>, EstimateError> {
    let (Given::First(theta) | Given::Beside(theta)) = given;
    if let Some(theta) = theta.filter(|theta| theta.len() != model.n_params()) {
        return Err(EstimateError::Start { found: theta.len(), expected: model.n_params() });
    }
    let drawn = |i: usize, task: &mut Task| -> Result<Option<Vec<f64>>, EstimateError> {
        let mut rng = Rng64::stream(train.seed, i as u64);
        if train.start != Start::Linear {
            return Ok(model.drawn().map(|d| d.random_start(&mut rng)));
        }
        linear(model, task, &mut rng).map(Some)
    };
    let first = match given {
        Given::First(Some(theta)) => theta.to_vec(),
        _ => match drawn(0, task)? {
            Some(theta) => theta,
            None => {
                let mut problem = SimulationError::new(model, data, 0.0, samples);
                least_squares_start(model, data, samples, 0.0, &mut problem, &mut Vec::new())?
            }
        },
    };
    let mut starts = vec![first.clone()];
    for i in 1..train.starts.max(1) {
        let around = || {
            let mut rng = Rng64::stream(train.seed, i as u64);
            first.iter().map(|v| v * (1.0 + train.spread * rng.normal())).collect()
        };
        starts.push(drawn(i, task)?.unwrap_or_else(around));
    }
    if let Given::Beside(Some(theta)) = given {
        starts.push(theta.to_vec());
    }
    Ok(starts)
}

/// The linear path by least squares; shrunk until its free run is finite.
fn linear(model: &dyn Model, task: &mut Task, rng: &mut Rng64) -> Result<Vec<f64>, EstimateError> {
    let missing = || EstimateError::NoLinearPath { model: short_name(&names(model)) };
    let path = model.drawn().and_then(|d| d.linear_path(rng)).ok_or_else(missing)?;
    let fitted = task.fit_linear(&path.theta, &path.places, LINEAR_RIDGE).unwrap_or(path.theta);
    for gain in [1.0, 0.98, 0.9, 0.7, 0.4] {
        let mut theta = fitted.clone();
        path.places.iter().for_each(|k| theta[*k] *= gain);
        if task.cost(&theta).is_finite() {
            return Ok(theta);
        }
    }
    let mut theta = fitted;
    path.places.iter().for_each(|k| theta[*k] = 0.0);
    Ok(theta)
}
