//! From the results of all starts to a fit.

use super::problem::Task;
use super::{Job, Search, Training};
use crate::estimate::cost::Cost;
use crate::estimate::covariance::CovarianceChoice;
use crate::estimate::fit::Found;
use crate::estimate::{EstimateError, Fit, Minimised, names, short_name};

/// Chooses the start with the best score and reports it.
pub(super) fn training(
    job: &Job,
    results: Vec<Search>,
    starts: &[Vec<f64>],
) -> Result<Training, EstimateError> {
    let names = names(job.model);
    let scores: Vec<f64> = results.iter().map(|r| r.score).collect();
    let best = (0..scores.len()).min_by(|a, b| scores[*a].total_cmp(&scores[*b]));
    let Some(best) = best.filter(|b| scores[*b].is_finite()) else { return Err(unstable(job, &starts[0])) };
    let test_scores = results.iter().map(|r| r.test).collect();
    let evaluations = results.iter().map(|r| r.outcome.evaluations).sum();
    let thetas: Vec<Vec<f64>> = results.iter().map(|r| r.outcome.x.clone()).collect();
    let outcome = &results[best].outcome;
    let fitted = job.weights.iter().flat_map(|w| &w.fit).filter(|w| **w > 0.0).count();
    let found = Found {
        estimator: "train",
        minimised: Minimised::FreeRun,
        theta: outcome.x.clone(),
        names,
        status: outcome.status,
        evaluations,
        history: outcome.history.clone(),
        warnings: Vec::new(),
    };
    // Weights of a network have no meaning one by one: the colour of the errors is not followed up for them.
    let choice =
        if job.model.is_linear_in_params() { CovarianceChoice::Auto } else { CovarianceChoice::White };
    let mut task = Task::new(job.model, job.data, job.weights);
    task.estimate.clone_from(&outcome.x);
    let mut fit = Fit::new(found, &mut task, fitted, choice, Cost::SQUARED)?;
    fit.notes.extend(spread(&scores));
    fit.starts.clone_from(&scores);
    Ok(Training { fit, thetas, scores, test_scores, best })
}

/// How far the starts of a training lie apart: one number for a result that depends on the draw is half of it.
fn spread(scores: &[f64]) -> Option<String> {
    let mut errors: Vec<f64> = scores.iter().filter(|s| s.is_finite()).map(|s| s.sqrt()).collect();
    errors.sort_by(f64::total_cmp);
    let (best, worst) = (errors.first()?, errors.last()?);
    if scores.len() < 2 {
        return None;
    }
    let median = 0.5 * (errors[(errors.len() - 1) / 2] + errors[errors.len() / 2]);
    let lost = scores.len() - errors.len();
    let diverged = if lost > 0 { format!("; {lost} diverged") } else { String::new() };
    Some(format!(
        "{} starts: RMSE on the samples that select {best:.4} for the best, {median:.4} for the median, {worst:.4} for the worst \
         (in the unit of the prepared output){diverged}; another seed gives another best",
        scores.len()
    ))
}

/// Says on which record and from which sample on the first start diverges.
fn unstable(job: &Job, theta: &[f64]) -> EstimateError {
    let model = short_name(&names(job.model));
    for e in job.data {
        let mut y = vec![0.0; e.len()];
        job.model.simulate(theta, &e.run(job.model), &mut y);
        if let Some(sample) = y.iter().position(|v| !v.is_finite()) {
            return EstimateError::Unstable { model, record: e.name.clone(), sample };
        }
    }
    // Finite values whose squares overflow.
    let record = job.data.first().map(|e| e.name.clone()).unwrap_or_default();
    EstimateError::Unstable { model, record, sample: 0 }
}
