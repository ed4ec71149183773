//! Backward elimination on the simulation error.
//!
//! Forward regression judges terms by one-step prediction, which says little about the free run. Here a model with
//! more terms than wanted is estimated on its simulation error; then the term whose parameter is least certain
//! (smallest `|theta_k| / std_k`, from the free-run Jacobian) is removed and the rest estimated again from the last
//! parameters, until few are left. One at a time: removing several of a correlated group at once loses what each of
//! them could have carried alone. Which model of the way down to use is for data to say that no estimate has seen.

use dynocal_numerics::registry::{self, BuildError, Member, MemberDoc, ParamDoc};
use serde::{Deserialize, Serialize};

use super::basis::Basis;
use super::frols::{Frols, Stop};
use super::path::{AIC_RHO, Action, Change, Selection, Step, step};
use super::pool::Pool;
use super::{Select, SelectError};
use crate::estimate::sem::Sem;
use crate::estimate::{CovarianceChoice, EstimateError, Estimator, Fit};
use crate::experiment::Experiment;
use crate::model::poly::PolyNarx;
use crate::validate::{Kind, Seen, score};

/// Elimination on the simulation error from what forward regression took.
#[derive(Clone, Copy, Debug, PartialEq, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Prune {
    /// Terms that forward regression takes first.
    pub from: usize,
    /// Fewest terms.
    pub min_terms: usize,
    /// Share of each record, at its end, that chooses among the models on the way down; 0: the data of the fit choose.
    pub selection: f64,
    /// The smallest model is kept whose mean squared error on what chooses is at most so much above the least, as a share
    /// of it; 0: the least.
    pub slack: f64,
}

impl Default for Prune {
    fn default() -> Self {
        Self { from: 30, min_terms: 3, selection: 0.25, slack: 0.0 }
    }
}

pub(super) const MEMBER: Member<dyn Select> = Member {
    doc: MemberDoc {
        name: "prune",
        what: "forward regression to more terms than wanted, then elimination on the simulation error",
        params: &[
            ParamDoc {
                name: "from",
                unit: "-",
                default: "30",
                what: "terms that forward regression takes first",
            },
            ParamDoc { name: "min_terms", unit: "-", default: "3", what: "fewest terms" },
            super::SELECTION_SHARE,
            ParamDoc {
                name: "slack",
                unit: "-",
                default: "0",
                what: "the smallest model is kept whose mean squared error on what chooses is at most so much above the least, as a share of it",
            },
        ],
    },
    build,
};

fn build(keys: &toml::Table) -> Result<Box<dyn Select>, BuildError> {
    let s: Prune = registry::keys("prune", keys)?;
    let fault = |message: String| Err(BuildError::Keys { member: "prune".into(), message });
    if s.min_terms == 0 || s.from < s.min_terms {
        return fault(format!(
            "from is {}, min_terms is {}, expected from >= min_terms >= 1",
            s.from, s.min_terms
        ));
    }
    if !(0.0..1.0).contains(&s.selection) {
        return fault(format!("selection is {}, expected 0 to below 1", s.selection));
    }
    if !(s.slack >= 0.0 && s.slack.is_finite()) {
        return fault(format!("slack is {}, expected a number of at least 0", s.slack));
    }
    Ok(Box::new(s))
}

impl Select for Prune {
    fn select(
        &self,
        pool: &Pool,
        data: &[Experiment],
        interrupt: &dyn Fn() -> bool,
    ) -> Result<Selection, SelectError> {
        let (fitted, selecting) = super::split(data, self.selection, pool.max_lag());
        let wide = Frols { stop: Stop::Terms(self.from) }.select(pool, &fitted, interrupt)?;
        let start: Vec<usize> = wide.path.iter().map(|s| s.candidate).collect();
        // White: then (theta_k / std_k)^2 is, but for a factor, what the sum of squares grows by without the term.
        let sem = Sem { covariance: CovarianceChoice::White, ..Sem::default() };
        let models = prune(&wide.model, &fitted, &sem, self.min_terms, interrupt)?;
        super::interrupted(interrupt)?;
        let small = Pool::from(&wide.model);
        let mut basis = Basis::new(&small, &fitted, 1)?;
        let mut path: Vec<Step> = wide.path;
        let mut before = path.last().map_or(basis.total(), |s| s.mse * basis.n() as f64);
        let left = |p: &Pruned| -> Vec<usize> {
            (0..small.candidates().len())
                .filter(|&k| p.model.regressors().contains(&small.candidates()[k]))
                .collect()
        };
        let fits = one_step_fits(&mut basis, &models.iter().map(left).collect::<Vec<_>>());
        for (p, (after, press)) in models[1..].iter().zip(fits) {
            let out = p.removed.as_deref().and_then(|r| start.iter().find(|&&k| pool.text(k) == r));
            let change = Change {
                candidate: out.copied().unwrap_or_default(),
                action: Action::Removed,
                terms: p.model.regressors().len(),
                before,
                after,
                press,
            };
            before = after;
            path.push(step(pool, basis.n(), basis.total(), AIC_RHO, change));
        }
        // The last forward step and each removal are the models on the way down.
        let first = path.len() - models.len();
        for (row, p) in path[first..].iter_mut().zip(&models) {
            let mse = score(&p.model, &p.fit.theta, &selecting, Kind::FreeRun, Seen::Unseen).mse;
            row.free_run = Some(if mse.is_finite() { mse } else { f64::INFINITY });
        }
        let kept = smallest_on(&models, &selecting, self.slack).unwrap_or(models.len() - 1);
        Selection::new(pool, Vec::new(), path, first + kept + 1)
    }
}

/// Residual sum of squares and PRESS of the least-squares fits of every set of terms but the first; each set is the one before
/// it without a term. They are built up from the last: what went out comes back in, one column at a time.
fn one_step_fits(basis: &mut Basis, sets: &[Vec<usize>]) -> Vec<(f64, f64)> {
    let Some(smallest) = sets.last() else { return Vec::new() };
    basis.restart(smallest);
    let mut fits = vec![(basis.residual_sum_squares(), basis.press())];
    for pair in sets.windows(2).skip(1).rev() {
        for &k in pair[0].iter().filter(|k| !pair[1].contains(k)) {
            if let Some(column) = basis.column(k) {
                basis.take(column);
            }
        }
        fits.push((basis.residual_sum_squares(), basis.press()));
    }
    fits.reverse();
    fits
}

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

/// The smallest model of a way down (the largest first) whose free-run error on `data` is at most `slack` above the least.
fn smallest_on(path: &[Pruned], data: &[Experiment], slack: f64) -> Option<usize> {
    let error = |p: &Pruned| score(&p.model, &p.fit.theta, data, Kind::FreeRun, Seen::Unseen).mse;
    let errors: Vec<f64> = path.iter().map(error).collect();
    let best = best_on(path, data)?;
    (best..path.len()).rev().find(|&i| errors[i] <= (1.0 + slack) * errors[best])
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
