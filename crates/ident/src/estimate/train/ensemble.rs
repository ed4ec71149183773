//! Several trained networks together: the mean of their free runs.

use super::Training;
use crate::experiment::Experiment;
use crate::model::Model;
use crate::validate::{Kind, output};

/// The `count` best parameter vectors of a training by selection score, the best first; diverged starts are left out.
pub fn best(training: &Training, count: usize) -> Vec<&[f64]> {
    let mut order: Vec<usize> =
        (0..training.scores.len()).filter(|i| training.scores[*i].is_finite()).collect();
    order.sort_by(|a, b| training.scores[*a].total_cmp(&training.scores[*b]));
    order.into_iter().take(count).map(|i| training.thetas[i].as_slice()).collect()
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
