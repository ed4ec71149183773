//! The best starts of a training as one model, whose output is the mean of their free runs.

use super::division::Weights;
use super::{Train, Training, best, mean_free_run, whole};
use crate::estimate::covariance::CovarianceKind;
use crate::estimate::initial::started;
use crate::estimate::noise::describe;
use crate::estimate::{EstimateError, Fit, LearntForm};
use crate::experiment::Experiment;
use crate::model::form::Form;
use crate::model::neural::{MeanOfNetworks, NeuralNarx};
use crate::model::response::LeftOut;
use crate::model::{Kind, Model, output};

/// The network whose mean is asked for; none where the best start is enough.
pub(super) fn network<'a>(
    train: &Train,
    form: &'a dyn Form,
) -> Result<Option<&'a NeuralNarx>, EstimateError> {
    let fault = |expected: String| EstimateError::Mean { found: train.mean, expected };
    let network: Option<&NeuralNarx> = form.is_a();
    match (train.mean, network) {
        (0, _) => Err(fault("1 (the best start alone) or more".into())),
        (1, _) => Ok(None),
        (_, None) => Err(fault(format!(
            "1: the mean of several is for networks, not for the form {}",
            form.row().name
        ))),
        (k, _) if k > train.starts => Err(fault(format!("at most the number of starts, {}", train.starts))),
        (k, _) if k > MeanOfNetworks::MOST => Err(fault(format!("at most {}", MeanOfNetworks::MOST))),
        (_, network) => Ok(network),
    }
}

/// Sums over samples with their weights: of the squared error of the mean, of each member, and of the members about the mean.
#[derive(Default)]
struct Sums {
    weight: f64,
    mean: f64,
    members: Vec<f64>,
    about: f64,
}

impl Sums {
    /// The root of a mean of squares.
    fn root(&self, sum: f64) -> f64 {
        (sum / self.weight).sqrt()
    }
}

/// One model of the best members of `found`, with the report of their mean.
pub(super) fn averaged(
    train: &Train,
    network: &NeuralNarx,
    data: &[Experiment],
    selection: &[Experiment],
    found: Training,
) -> Result<Fit, EstimateError> {
    let thetas = best(&found, train.mean);
    let form = MeanOfNetworks::new(network.clone(), thetas.len())?;
    let data = &*started("train", network, data, train.initial)?;
    let selection = &*started("train", network, selection, train.initial)?;
    let weights = if selection.is_empty() { train.divided(network, data) } else { whole(network, data) };
    let errors: Vec<Vec<f64>> = data.iter().map(|e| errors(network, &thetas, e)).collect();
    let fit_sums = sums(network, &thetas, data, &weights, |w| &w.fit);
    let mut judged = match selection {
        [] => sums(network, &thetas, data, &weights, |w| &w.selection),
        _ => sums(network, &thetas, selection, &whole(network, selection), |w| &w.fit),
    };
    if judged.weight == 0.0 {
        // Records too short to be divided are fitted whole.
        judged = sums(network, &thetas, data, &weights, |w| &w.fit);
    }
    let note = note(&judged, thetas.len());
    let (theta, names) = (thetas.concat(), form.parameter_names());
    let mut fit = Fit { names, ..found.fit.clone() };
    if thetas.len() < train.mean {
        fit.warnings.push(format!(
            "mean of {} networks instead of {}: the other starts diverged",
            thetas.len(),
            train.mean
        ));
    }
    let weighted =
        errors.iter().zip(&weights).map(|(e, w)| e.iter().zip(&w.fit).map(|(e, w)| e * w.sqrt()).collect());
    let weighted: Vec<Vec<f64>> = weighted.collect();
    // A mean moves less than its members: counting all their parameters would make its errors too small a sample.
    let left = fit.samples.saturating_sub(network.n_params()).max(1) as f64;
    fit.residuals = describe(weighted.iter().map(Vec::as_slice)).0;
    fit.mse = fit_sums.mean / fit.samples.max(1) as f64;
    fit.noise_variance = fit_sums.mean / left;
    // What the members share is not known: no covariance is better than one of independent members.
    (fit.covariance, fit.covariance_kind) = (Vec::new(), CovarianceKind::White);
    fit.std_errors = vec![f64::NAN; theta.len()];
    fit.rank = 0;
    fit.theta = theta;
    fit.notes.push(note);
    let left_out = LeftOut { residuals: Vec::new(), variance: Vec::new() };
    fit.learnt = Some(LearntForm { form: form.into(), left_out, choice: None });
    Ok(fit)
}

/// Error of the mean of the free runs (N); missing samples count nothing.
fn errors(network: &NeuralNarx, thetas: &[&[f64]], e: &Experiment) -> Vec<f64> {
    let y = mean_free_run(network, thetas, e);
    e.y.iter().zip(y).map(|(z, y)| if z.is_finite() { z - y } else { 0.0 }).collect()
}

fn sums(
    network: &NeuralNarx,
    thetas: &[&[f64]],
    data: &[Experiment],
    weights: &[Weights],
    of: impl Fn(&Weights) -> &Vec<f64>,
) -> Sums {
    let mut out = Sums { members: vec![0.0; thetas.len()], ..Sums::default() };
    for (e, w) in data.iter().zip(weights) {
        let runs: Vec<Vec<f64>> = thetas.iter().map(|t| output(network, t, e, Kind::FreeRun)).collect();
        let mean = mean_free_run(network, thetas, e);
        for (t, w) in of(w).iter().enumerate().filter(|(_, w)| **w > 0.0) {
            out.weight += w;
            out.mean += w * (e.y[t] - mean[t]).powi(2);
            for (sum, y) in out.members.iter_mut().zip(&runs) {
                *sum += w * (e.y[t] - y[t]).powi(2);
                out.about += w * (y[t] - mean[t]).powi(2) / thetas.len() as f64;
            }
        }
    }
    out
}

/// What the mean is worth, and how far its members lie apart.
fn note(s: &Sums, members: usize) -> String {
    let each: Vec<f64> = s.members.iter().map(|sum| s.root(*sum)).collect();
    let (least, most) = each.iter().fold((f64::INFINITY, 0.0_f64), |(a, b), v| (a.min(*v), b.max(*v)));
    format!(
        "mean of the {members} best networks: RMSE on the samples that select {:.4}, of its members {least:.4} to {most:.4}; the members \
         lie {:.4} (standard deviation) about their mean (in the unit of the prepared output)",
        s.root(s.mean),
        s.root(s.about),
    )
}
