//! Backward elimination on the simulation error.
//!
//! Forward regression judges terms by one-step prediction, which says little about the free run. Here a model with
//! more terms than wanted is estimated on its simulation error; then the term whose parameter is least certain
//! (smallest `|theta_k| / std_k`, from the free-run Jacobian) is removed and the rest estimated again from the last
//! parameters, until few are left. One at a time: removing several of a correlated group at once loses what each of
//! them could have carried alone. Which model of the way down to use is for data to say that no estimate has seen.

use serde::{Deserialize, Serialize};

use crate::estimate::sem::Sem;
use crate::estimate::{EstimateError, Estimator, Fit};
use crate::experiment::Experiment;
use crate::model::poly::PolyNarx;
use crate::validate::{Kind, Seen, score};

/// One model on the way down.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct Pruned {
    /// Structure.
    pub model: PolyNarx,
    /// Its simulation-error estimate.
    pub fit: Fit,
    /// Term that was removed to get here from the model before; `None` for the first.
    pub removed: Option<String>,
}

/// Models from `model` down to `terms` terms, the largest first.
///
/// # Errors
/// [`EstimateError`] when the first estimate fails. A later one that fails ends the way down.
pub fn prune(
    model: &PolyNarx,
    data: &[Experiment],
    estimator: &Sem,
    terms: usize,
    interrupt: &dyn Fn() -> bool,
) -> Result<Vec<Pruned>, EstimateError> {
    let fit = estimator.estimate(model, data, None, interrupt)?;
    let mut path = vec![Pruned { model: model.clone(), fit, removed: None }];
    while let Some(last) = path.last() {
        if last.fit.theta.len() <= terms.max(1) || interrupt() {
            break;
        }
        let Some(next) = without(last, least_certain(&last.fit), data, estimator, interrupt) else { break };
        path.push(next);
    }
    Ok(path)
}

/// The place in `path` with the least free-run error on `data`, which should be unseen; `None` when all diverge.
pub fn best_on(path: &[Pruned], data: &[Experiment]) -> Option<usize> {
    let error = |p: &Pruned| score(&p.model, &p.fit.theta, data, Kind::FreeRun, Seen::Unseen).mse;
    let errors: Vec<f64> = path.iter().map(error).collect();
    (0..path.len()).filter(|&i| errors[i].is_finite()).min_by(|&a, &b| errors[a].total_cmp(&errors[b]))
}

/// The model without term k, estimated again; `None` when that fails.
fn without(
    last: &Pruned,
    k: usize,
    data: &[Experiment],
    estimator: &Sem,
    interrupt: &dyn Fn() -> bool,
) -> Option<Pruned> {
    let (mut regressors, mut start) = (last.model.regressors().to_vec(), last.fit.theta.clone());
    regressors.remove(k);
    start.remove(k);
    let model = PolyNarx::new(last.model.inputs().to_vec(), last.model.output().into(), regressors).ok()?;
    // What is left may be unstable without what was removed: then start afresh.
    let fit = estimator
        .estimate(&model, data, Some(&start), interrupt)
        .or_else(|_| estimator.estimate(&model, data, None, interrupt))
        .ok()?;
    Some(Pruned { model, fit, removed: Some(last.fit.names[k].clone()) })
}

/// The parameter with the smallest `|theta| / std`; one that the data do not determine comes first.
fn least_certain(fit: &Fit) -> usize {
    let certainty = |k: usize| {
        let ratio = (fit.theta[k] / fit.std_errors[k]).abs();
        if ratio.is_nan() { -1.0 } else { ratio }
    };
    (0..fit.theta.len()).min_by(|&a, &b| certainty(a).total_cmp(&certainty(b))).unwrap_or(0)
}
