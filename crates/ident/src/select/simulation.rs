//! Forward selection on the free-run error.
//!
//! One-step prediction from finely sampled outputs is easy: y(t-1) alone explains most of it, and terms are taken that a
//! free run is worse for. Here the candidates with the largest error reduction are tried one by one, and the one with
//! the least free-run error, on the end of each record that the parameters have not seen, comes in.
//!
//! Reference: L. Piroddi, W. Spinelli, Int. J. Control 76 (2003) 1767-1781 (simulation error reduction ratio).

use dynocal_numerics::registry::{self, BuildError, Member, MemberDoc, ParamDoc};
use rayon::prelude::*;
use serde::Deserialize;

use super::basis::{Basis, Column};
use super::forward::exhausted;
use super::path::{AIC_RHO, Selection, Step, entered};
use super::pool::Pool;
use super::{Select, SelectError, interrupted};
use crate::estimate::Estimator;
use crate::estimate::sem::Sem;
use crate::experiment::Experiment;
use crate::validate::{Kind, Seen, score};

/// Forward selection among the candidates with the largest error reduction, by free-run error.
#[derive(Clone, Copy, Debug, PartialEq, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Simulation {
    /// Most terms.
    pub max_terms: usize,
    /// Candidates that are tried at each step.
    pub among: usize,
    /// Least relative decrease of the free-run mean squared error for a further term.
    pub min_improvement: f64,
    /// Share of each record, at its end, that selects instead of being fitted; 0: the data of the fit select.
    pub selection: f64,
    /// How parameters are estimated for each trial.
    pub estimator: Estimation,
}

/// Estimator of the trials.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Estimation {
    /// One-step least squares: cheap.
    #[default]
    Ols,
    /// Simulation error, from least squares on.
    Sem,
}

impl Default for Simulation {
    fn default() -> Self {
        Self { max_terms: 20, among: 10, min_improvement: 0.005, selection: 0.25, estimator: Estimation::Ols }
    }
}

/// Steps without enough improvement that end the search: one poor step may open the way for a good one.
const PATIENCE: usize = 3;

pub(super) const MEMBER: Member<dyn Select> = Member {
    doc: MemberDoc {
        name: "simulation",
        what: "forward by free-run error among the candidates with the largest error reduction",
        params: &[
            super::MAX_TERMS,
            ParamDoc { name: "among", unit: "-", default: "10", what: "candidates tried at each step" },
            ParamDoc {
                name: "min_improvement",
                unit: "-",
                default: "0.005",
                what: "least relative decrease of the free-run mean squared error for a further term",
            },
            super::SELECTION_SHARE,
            ParamDoc {
                name: "estimator",
                unit: "-",
                default: "ols",
                what: "parameters of each trial: ols (one-step least squares) or sem (simulation error)",
            },
        ],
    },
    build,
};

fn build(keys: &toml::Table) -> Result<Box<dyn Select>, BuildError> {
    let s: Simulation = registry::keys("simulation", keys)?;
    let fault = |message: String| Err(BuildError::Keys { member: "simulation".into(), message });
    if s.max_terms == 0 || s.among == 0 {
        return fault(format!("max_terms is {}, among is {}, expected at least 1", s.max_terms, s.among));
    }
    if !(0.0..1.0).contains(&s.selection) || !(0.0..1.0).contains(&s.min_improvement) {
        let (a, b) = (s.selection, s.min_improvement);
        return fault(format!("selection is {a}, min_improvement is {b}, expected 0 to below 1"));
    }
    Ok(Box::new(s))
}

impl Select for Simulation {
    fn select(
        &self,
        pool: &Pool,
        data: &[Experiment],
        interrupt: &dyn Fn() -> bool,
    ) -> Result<Selection, SelectError> {
        let most = self.max_terms.min(pool.candidates().len());
        let (fitted, selecting) = super::split(data, self.selection, pool.max_lag());
        let mut basis = Basis::new(pool, &fitted, most)?;
        let mut path: Vec<Step> = Vec::with_capacity(most);
        let (mut best, mut steps) = (f64::INFINITY, 0);
        while path.len() < most && !exhausted(&basis) && path.len() < steps + PATIENCE {
            interrupted(interrupt)?;
            let tried: Result<Vec<(f64, Column)>, SelectError> = basis
                .best(self.among)
                .into_par_iter()
                .map(|c| Ok((self.free_run(pool, &basis, &c, &fitted, &selecting)?, c)))
                .collect();
            // Where all diverge the largest error reduction, which comes first, goes on.
            let Some((error, column)) = tried?.into_iter().min_by(|a, b| a.0.total_cmp(&b.0)) else { break };
            let (candidate, before) = (column.candidate, basis.residual_sum_squares());
            basis.take(column);
            let row = entered(pool, &basis, candidate, before, AIC_RHO);
            path.push(Step { free_run: Some(error), ..row });
            if error < best * (1.0 - self.min_improvement) {
                (best, steps) = (error, path.len());
            }
        }
        // All diverged: the whole path, judged by its one-step error, is all there is.
        let steps = if steps == 0 { path.len() } else { steps };
        Selection::new(pool, Vec::new(), path, steps)
    }
}

impl Simulation {
    /// Free-run mean squared error with one more term; infinite when it diverges.
    fn free_run(
        &self,
        pool: &Pool,
        basis: &Basis,
        more: &Column,
        fitted: &[Experiment],
        selecting: &[Experiment],
    ) -> Result<f64, SelectError> {
        let mut order: Vec<(usize, f64)> =
            basis.chosen().chain([more.candidate]).zip(basis.theta(Some(more))).collect();
        order.sort_unstable_by_key(|(place, _)| *place);
        let model = pool.structure(&order.iter().map(|o| o.0).collect::<Vec<_>>())?;
        let mut theta: Vec<f64> = order.iter().map(|o| o.1).collect();
        if self.estimator == Estimation::Sem
            && let Ok(fit) = Sem::default().estimate(&model, fitted, Some(&theta), &|| false)
        {
            theta = fit.theta;
        }
        let mse = score(&model, &theta, selecting, Kind::FreeRun, Seen::Unseen).mse;
        Ok(if mse.is_finite() { mse } else { f64::INFINITY })
    }
}
