//! Forward selection: the term that helps most comes in, until none does.
//!
//! Members: `frols` (largest error reduction ratio among all candidates, see [`super::frols`]) and `forward` (the
//! constant first, then the candidate with the largest correlation, thesis eqs. 2.34 to 2.44).

use dynocal_numerics::registry::{self, BuildError, Member, MemberDoc, ParamDoc};
use serde::Deserialize;

use super::basis::{Basis, Column};
use super::path::{Selection, Step, Stop, entered};
use super::pool::Pool;
use super::{Select, SelectError, StopKeys, interrupted};
use crate::experiment::Experiment;

/// What the next term is chosen by.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Rank {
    /// Partial correlation with the residual, all candidates made orthogonal to the chosen terms: largest F.
    #[default]
    PartialF,
    /// Correlation of the candidate as it is with the residual (thesis eq. 2.34).
    Correlation,
}

/// Forward selection with F to enter.
#[derive(Clone, Copy, Debug)]
pub struct Forward {
    /// What the next term is chosen by.
    pub rank: Rank,
    /// When to stop.
    pub stop: Stop,
}

#[derive(Deserialize)]
#[serde(default, deny_unknown_fields)]
struct Keys {
    rank: Rank,
    stop: StopKeys,
    max_terms: usize,
    rho: f64,
    f_to_enter: f64,
}

impl Default for Keys {
    fn default() -> Self {
        Self { rank: Rank::default(), stop: StopKeys::F, max_terms: 20, rho: 2.0, f_to_enter: 4.0 }
    }
}

pub(super) const MEMBER: Member<dyn Select> = Member {
    doc: MemberDoc {
        name: "forward",
        what: "forward by correlation with the residual and F to enter, the constant first; eqs. (2.34) to (2.44)",
        params: &[
            ParamDoc {
                name: "rank",
                unit: "-",
                default: "partial_f",
                what: "partial_f: candidates orthogonal to the chosen terms; correlation: candidates as they are",
            },
            super::MAX_TERMS,
            super::STOP,
            super::RHO,
            super::F_TO_ENTER,
        ],
    },
    build,
};

fn build(keys: &toml::Table) -> Result<Box<dyn Select>, BuildError> {
    let k: Keys = registry::keys("forward", keys)?;
    let stop = k.stop.stop("forward", k.max_terms, k.rho, k.f_to_enter)?;
    Ok(Box::new(Forward { rank: k.rank, stop }))
}

impl Select for Forward {
    fn select(
        &self,
        pool: &Pool,
        data: &[Experiment],
        interrupt: &dyn Fn() -> bool,
    ) -> Result<Selection, SelectError> {
        let most = self.stop.max_terms().min(pool.candidates().len());
        let mut basis = Basis::new(pool, data, most)?;
        let mut path = Vec::with_capacity(most);
        constant_first(pool, &mut basis, &mut path, self.stop.rho());
        let next = |basis: &Basis| match self.rank {
            Rank::PartialF => basis.best(1).into_iter().next(),
            Rank::Correlation => most_correlated(basis),
        };
        advance(pool, &mut basis, &mut path, &self.stop, &next, interrupt)?;
        let steps = self.stop.steps(&path);
        Selection::new(pool, Vec::new(), path, steps)
    }
}

/// Correlations are centred: the constant, where it is a candidate, comes in first and untested.
pub(super) fn constant_first(pool: &Pool, basis: &mut Basis, path: &mut Vec<Step>, rho: f64) {
    if let Some(k) = pool.constant()
        && let Some(column) = basis.column(k)
    {
        let before = basis.residual_sum_squares();
        basis.take(column);
        path.push(entered(pool, basis, k, before, rho));
    }
}

/// The candidate with the largest correlation that is not dependent on the chosen terms.
fn most_correlated(basis: &Basis) -> Option<Column> {
    let correlations = basis.squared_correlations();
    let mut order: Vec<usize> = (0..correlations.len()).filter(|&i| correlations[i] > 0.0).collect();
    order.sort_by(|&a, &b| correlations[b].total_cmp(&correlations[a]).then(a.cmp(&b)));
    order.into_iter().find_map(|i| basis.column(i))
}

/// Takes terms until `stop`, until none is left, or until only the rounding of the arithmetic is.
pub(super) fn advance(
    pool: &Pool,
    basis: &mut Basis,
    path: &mut Vec<Step>,
    stop: &Stop,
    next: &dyn Fn(&Basis) -> Option<Column>,
    interrupt: &dyn Fn() -> bool,
) -> Result<(), SelectError> {
    while path.len() < stop.max_terms() && !exhausted(basis) {
        interrupted(interrupt)?;
        let Some(column) = next(basis) else { break };
        if let Stop::F { f_to_enter, .. } = stop
            && f_of(basis, &column) <= *f_to_enter
        {
            break;
        }
        let (candidate, before) = (column.candidate, basis.residual_sum_squares());
        basis.take(column);
        path.push(entered(pool, basis, candidate, before, stop.rho()));
    }
    Ok(())
}

/// Partial F of a candidate (thesis eq. 2.38).
pub(super) fn f_of(basis: &Basis, column: &Column) -> f64 {
    let larger = basis.chosen().count() + 1;
    if basis.n() <= larger {
        return 0.0;
    }
    let after = (basis.residual_sum_squares() - column.gain()).max(0.0);
    column.gain() / (after / (basis.n() - larger) as f64)
}

/// Rounding level: further terms would fit noise of the arithmetic.
pub(super) fn exhausted(basis: &Basis) -> bool {
    basis.residual_sum_squares() <= 1e-26 * basis.total()
}
