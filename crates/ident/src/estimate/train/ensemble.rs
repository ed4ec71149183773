//! Several trained networks together: the mean of their free runs.

use super::{Train, Training};
use crate::estimate::EstimateError;
use crate::experiment::Experiment;
use crate::model::{Kind, Model, output};

/// The `count` best parameter vectors of a training by selection score, the best first; diverged starts are left out.
pub fn best(training: &Training, count: usize) -> Vec<&[f64]> {
    let mut order: Vec<usize> =
        (0..training.scores.len()).filter(|i| training.scores[*i].is_finite()).collect();
    order.sort_by(|a, b| training.scores[*a].total_cmp(&training.scores[*b]));
    order.into_iter().take(count).map(|i| training.thetas[i].as_slice()).collect()
}

/// The best parameter vectors of `bags` trainings with the seeds from `train.seed` on: other starts and, where samples
/// are drawn for selection, another division each time, so that every sample is fitted by most members (L. Breiman,
/// Bagging predictors, Machine Learning 24 (1996)).
///
/// # Errors
/// As [`Train::train`].
pub fn bagged(
    train: &Train,
    bags: usize,
    model: &dyn Model,
    data: &[Experiment],
    interrupt: &dyn Fn() -> bool,
) -> Result<Vec<Vec<f64>>, EstimateError> {
    let seeds = (0..bags.max(1)).map(|i| train.seed + i as u64);
    seeds
        .map(|seed| Ok(Train { seed, ..train.clone() }.train(model, data, &[], None, interrupt)?.fit.theta))
        .collect()
}

/// Mean of the free runs of `model` under several parameter vectors (N):
///
/// ```text
/// yhat(t) = 1/k sum_i yhat_i(t),   each yhat_i fed back with its own output only
/// ```
///
/// Errors of single trainings partly cancel. The mean is no NARX model itself: it has one state per member.
pub fn mean_free_run(model: &dyn Model, thetas: &[&[f64]], e: &Experiment) -> Vec<f64> {
    let mut mean = vec![0.0; e.len()];
    for theta in thetas {
        for (m, y) in mean.iter_mut().zip(output(model, theta, e, Kind::FreeRun)) {
            *m += y / thetas.len() as f64;
        }
    }
    mean
}
