//! Robust design: a record that is good over a distribution of parameters, not only at their estimate.
//!
//! The information of a model that is not linear in what it recurs on depends on the parameters, which are what the
//! test shall find. With draws theta_k of their distribution, e.g. of the estimate's covariance, the loss of a record
//! u at theta_k is minus the logarithm of its efficiency there,
//!
//! ```text
//! L_k(u) = (J_D(u; theta_k) - J_D*(theta_k)) / p              D
//! L_k(u) = ln J(u; theta_k) - ln J*(theta_k)                  criteria that are variances
//! ```
//!
//! A robust record minimises the mean of the losses or the mean of their worst share (conditional value at risk,
//! Rockafellar and Uryasev, J. Risk 2 (2000) 21-41), as weighted sums of the criteria of one design problem.
//!
//! ```
//! use dynocal_calib::loops::robust::{Ensemble, Risk};
//! use dynocal_design::channel::Channel;
//! use dynocal_design::criterion::criterion;
//! use dynocal_design::problem::{Convention, DesignProblem, Term};
//! use dynocal_design::search::{DesignOptions, design};
//! use dynocal_ident::model::poly::PolyNarx;
//!
//! // A lag whose pole is somewhere between 0.1 and 0.9.
//! let model = PolyNarx::parse(&["u"], "y", &["u(t-1)", "y(t-1)"])?;
//! let draws: Vec<Vec<f64>> = [0.1, 0.5, 0.9].iter().map(|a| vec![1.0, *a]).collect();
//! let d = criterion("d", &Default::default())?;
//! let problem = DesignProblem {
//!     channels: vec![Channel::free("u", -1.0, 1.0)],
//!     n_samples: 40,
//!     convention: Convention::Hold,
//!     start: 0,
//!     terms: vec![Term::new("y", &model, &draws[0], 1.0, d.as_ref())],
//! };
//! let options = DesignOptions { evaluations: 300, ..DesignOptions::default() };
//! let nominal = design(&problem, &options, &|| false, &|_| {})?.u;
//! let ensemble = Ensemble::new(&problem, &draws, &options, &|| false)?;
//! let robust = ensemble.design(Risk::Cvar(0.3), &nominal, &options, &|| false)?;
//! let worst = |losses: &[f64]| Risk::Cvar(0.3).of(losses);
//! assert!(worst(&robust.losses) < worst(&ensemble.losses(&nominal)?));
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```

use dynocal_design::problem::{DesignProblem, Evaluator, Term};
use dynocal_design::search::{DesignOptions, design};
use dynocal_ident::estimate::ParameterDistribution;
use dynocal_ident::model::{Model, Run};
use dynocal_numerics::rng::Rng64;
use dynocal_numerics::status::Status;
use rayon::prelude::*;
use serde::{Deserialize, Serialize};

use super::LoopError;

/// What a robust record makes small.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Risk {
    /// Mean loss.
    Mean,
    /// Mean of the worst share of the losses, a share between 0 and 1.
    Cvar(f64),
}

impl Risk {
    /// Of the losses.
    ///
    /// ```
    /// use dynocal_calib::loops::robust::Risk;
    /// assert_eq!(Risk::Mean.of(&[1.0, 2.0, 6.0]), 3.0);
    /// assert_eq!(Risk::Cvar(0.34).of(&[1.0, 2.0, 6.0]), 4.0);
    /// ```
    pub fn of(self, losses: &[f64]) -> f64 {
        let mut sorted = losses.to_vec();
        sorted.sort_by(|a, b| b.total_cmp(a));
        let take = match self {
            Risk::Mean => sorted.len(),
            Risk::Cvar(share) => worst(share, sorted.len()),
        };
        sorted[..take].iter().sum::<f64>() / take.max(1) as f64
    }
}

/// Number of draws in the worst share.
fn worst(share: f64, n: usize) -> usize {
    ((share * n as f64).ceil() as usize).clamp(1, n.max(1))
}

/// Draws of `N(theta, covariance)` whose free run over the inputs `u` (N x m) from `initial_output` stays within `bound`
/// in absolute value: an estimate's covariance knows nothing of stability.
///
/// # Errors
/// [`LoopError::Model`] when the covariance is not positive or hardly a draw is stable.
pub fn draws(
    model: &dyn Model,
    theta: &[f64],
    covariance: &[f64],
    count: usize,
    seed: u64,
    stable: Stable,
) -> Result<Vec<Vec<f64>>, LoopError> {
    let p = theta.len();
    let fault = |reason: String| LoopError::Model { what: "parameter distribution".into(), reason };
    if let Some(k) = (0..p).find(|k| !(covariance[k * p + k] > 0.0 && covariance[k * p + k].is_finite())) {
        return Err(fault(format!("`{}` has no variance", model.param_name(k))));
    }
    let distribution = ParameterDistribution::new(theta, covariance).map_err(|e| fault(e.to_string()))?;
    let mut rng = Rng64::stream(seed, 77);
    let mut found = Vec::with_capacity(count);
    for _ in 0..20 * count {
        let draw = distribution.draw(&mut rng);
        if stable.holds(model, &draw) {
            found.push(draw);
            if found.len() == count {
                return Ok(found);
            }
        }
    }
    Err(fault(format!("{} of {} draws are stable", found.len(), 20 * count)))
}

/// What a draw must keep.
#[derive(Clone, Copy, Debug)]
pub struct Stable<'a> {
    /// Inputs of a free run (N x m).
    pub u: &'a [f64],
    /// Output it starts from.
    pub initial_output: f64,
    /// Largest absolute output.
    pub bound: f64,
}

impl Stable<'_> {
    fn holds(&self, model: &dyn Model, theta: &[f64]) -> bool {
        let n = self.u.len() / model.n_inputs().max(1);
        let initial = vec![self.initial_output; n];
        let mut y = vec![0.0; n];
        let run = Run { u: self.u, y: &initial, start: model.max_lag().min(n) };
        model.simulate(theta, &run, &mut y) == Status::Converged && y.iter().all(|v| v.abs() <= self.bound)
    }
}

/// A design problem with one term, seen at many parameters.
pub struct Ensemble<'a> {
    problem: DesignProblem<'a>,
    draws: &'a [Vec<f64>],
    /// Best value of the criterion at each draw that a design for it found.
    best: Vec<f64>,
}

/// A robust record.
#[derive(Clone, Debug)]
pub struct Robust {
    /// Samples (N x m).
    pub u: Vec<f64>,
    /// Losses at the draws it was designed for.
    pub losses: Vec<f64>,
}

/// Rounds of reweighting towards the worst share.
const ROUNDS: usize = 6;

impl<'a> Ensemble<'a> {
    /// The first term of `problem` at the `draws`; designs for each of them alone, as what losses are measured from.
    ///
    /// # Errors
    /// [`LoopError`] of a wrong problem or a failed design.
    pub fn new(
        problem: &DesignProblem<'a>,
        draws: &'a [Vec<f64>],
        options: &DesignOptions,
        interrupt: &(dyn Fn() -> bool + Sync),
    ) -> Result<Self, LoopError> {
        if problem.terms.len() != 1 || draws.is_empty() {
            let found = if draws.is_empty() { 0 } else { problem.terms.len() };
            return Err(LoopError::Shape { what: "terms and draws of an ensemble", found, expected: 1 });
        }
        let mut ensemble = Self { problem: problem.clone(), draws, best: Vec::new() };
        let best: Result<Vec<f64>, LoopError> = (0..draws.len())
            .into_par_iter()
            .map(|k| Ok(design(&ensemble.at(k), options, interrupt, &|_| {})?.value))
            .collect();
        ensemble.best = best?;
        if interrupt() { Err(LoopError::Interrupted) } else { Ok(ensemble) }
    }

    fn term(&self, k: usize) -> Term<'a> {
        Term { theta: &self.draws[k], ..self.problem.terms[0] }
    }

    fn at(&self, k: usize) -> DesignProblem<'a> {
        DesignProblem { terms: vec![self.term(k)], ..self.problem.clone() }
    }

    /// Losses of the record `u` at all draws; infinite where it is singular.
    ///
    /// # Errors
    /// [`LoopError::Problem`] for a record that does not fit.
    pub fn losses(&self, u: &[f64]) -> Result<Vec<f64>, LoopError> {
        (0..self.draws.len())
            .map(|k| {
                let value = Evaluator::new(&self.at(k))?.value(u);
                Ok(match self.problem.terms[0].criterion {
                    Some(c) if !c.is_positive() => (value - self.best[k]) / self.draws[k].len() as f64,
                    _ => (value / self.best[k]).ln(),
                })
            })
            .collect()
    }

    /// The record of least `risk`, searched from `start`.
    ///
    /// CVaR is a saddle point: weights between the draws move step by step to the worst share while the record follows
    /// (fictitious play), and the best record on the way is kept.
    ///
    /// # Errors
    /// [`LoopError`] of a failed design.
    pub fn design(
        &self,
        risk: Risk,
        start: &[f64],
        options: &DesignOptions,
        interrupt: &(dyn Fn() -> bool + Sync),
    ) -> Result<Robust, LoopError> {
        let n = self.draws.len();
        let mut weights = vec![1.0 / n as f64; n];
        let mut best = Robust { u: start.to_vec(), losses: self.losses(start)? };
        let mut u = start.to_vec();
        let rounds = if risk == Risk::Mean { 1 } else { ROUNDS };
        for round in 0..rounds {
            let mut problem = self.problem.clone();
            problem.terms = (0..n)
                .filter(|k| weights[*k] > 0.0)
                .map(|k| Term { weight: weights[k] / self.scale(k), ..self.term(k) })
                .collect();
            let options = DesignOptions { start: Some(u.clone()), ..options.clone() };
            u = design(&problem, &options, interrupt, &|_| {})?.u;
            if interrupt() {
                return Err(LoopError::Interrupted);
            }
            let losses = self.losses(&u)?;
            if let Risk::Cvar(share) = risk {
                move_to_worst(&mut weights, &losses, share, 1.0 / (round + 2) as f64);
            }
            if risk.of(&losses) < risk.of(&best.losses) {
                best = Robust { u: u.clone(), losses };
            }
        }
        Ok(best)
    }

    /// What makes criteria of different draws count alike.
    fn scale(&self, k: usize) -> f64 {
        match self.problem.terms[0].criterion {
            Some(c) if !c.is_positive() => self.draws[k].len() as f64,
            _ => self.best[k],
        }
    }
}

fn move_to_worst(weights: &mut [f64], losses: &[f64], share: f64, step: f64) {
    let mut order: Vec<usize> = (0..losses.len()).collect();
    order.sort_by(|a, b| losses[*b].total_cmp(&losses[*a]));
    let take = worst(share, losses.len());
    weights.iter_mut().for_each(|w| *w *= 1.0 - step);
    order[..take].iter().for_each(|k| weights[*k] += step / take as f64);
}
