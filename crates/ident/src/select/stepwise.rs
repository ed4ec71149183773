//! Stepwise selection: after each term that enters, those that it has made superfluous go out.
//!
//! Reference: thesis section 2.6.2 (eqs. 2.38, 2.41); N. R. Draper, H. Smith, Applied Regression Analysis, 3rd ed.,
//! section 15.4. With `f_to_remove <= f_to_enter` no term that has just entered goes out, and no cycle is possible.

use dynocal_numerics::registry::{self, BuildError, Member, MemberDoc};
use serde::Deserialize;

use super::basis::Basis;
use super::forward::{constant_first, exhausted, f_of};
use super::path::{AIC_RHO, Action, Change, Selection, Step, entered, step};
use super::pool::Pool;
use super::{Select, SelectError, interrupted};
use crate::experiment::Experiment;

/// Stepwise selection by partial F; the constant, where it is a candidate, comes first and stays.
#[derive(Clone, Copy, Debug, PartialEq, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Stepwise {
    /// Most terms.
    pub max_terms: usize,
    /// F to enter.
    pub f_to_enter: f64,
    /// F to remove; at most the F to enter.
    pub f_to_remove: f64,
}

impl Default for Stepwise {
    fn default() -> Self {
        Self { max_terms: 20, f_to_enter: 4.0, f_to_remove: 3.9 }
    }
}

pub(super) const MEMBER: Member<dyn Select> = Member {
    doc: MemberDoc {
        name: "stepwise",
        what: "forward by partial F with removal of terms that later ones make superfluous; eqs. (2.38), (2.41)",
        params: &[super::MAX_TERMS, super::F_TO_ENTER, super::F_TO_REMOVE],
    },
    build,
};

fn build(keys: &toml::Table) -> Result<Box<dyn Select>, BuildError> {
    let s: Stepwise = registry::keys("stepwise", keys)?;
    let fault = |message: String| Err(BuildError::Keys { member: "stepwise".into(), message });
    if s.max_terms == 0 {
        return fault("max_terms is 0, expected at least 1".into());
    }
    if !(s.f_to_remove >= 0.0 && s.f_to_remove <= s.f_to_enter && s.f_to_enter.is_finite()) {
        let (enter, remove) = (s.f_to_enter, s.f_to_remove);
        return fault(format!(
            "f_to_remove is {remove}, expected 0 to f_to_enter ({enter}): terms would go in circles"
        ));
    }
    Ok(Box::new(s))
}

impl Select for Stepwise {
    fn select(
        &self,
        pool: &Pool,
        data: &[Experiment],
        interrupt: &dyn Fn() -> bool,
    ) -> Result<Selection, SelectError> {
        let most = self.max_terms.min(pool.candidates().len());
        let mut basis = Basis::new(pool, data, most)?;
        let mut path = Vec::new();
        constant_first(pool, &mut basis, &mut path, AIC_RHO);
        let constant = pool.constant();
        while basis.chosen().count() < most && !exhausted(&basis) {
            interrupted(interrupt)?;
            let Some(column) = basis.best(1).into_iter().next() else { break };
            if f_of(&basis, &column) <= self.f_to_enter {
                break;
            }
            let (candidate, before) = (column.candidate, basis.residual_sum_squares());
            basis.take(column);
            path.push(entered(pool, &basis, candidate, before, AIC_RHO));
            while let Some(out) = least_useful(&basis, constant, self.f_to_remove) {
                path.push(remove(pool, &mut basis, out));
            }
        }
        let steps = path.len();
        Selection::new(pool, Vec::new(), path, steps)
    }
}

/// The chosen term with the smallest partial F, when that is below `f_to_remove`; never the constant nor the last.
fn least_useful(basis: &Basis, constant: Option<usize>, f_to_remove: f64) -> Option<usize> {
    let f = basis.partial_f();
    let last = f.len().checked_sub(1)?;
    let others = basis.chosen().zip(&f).take(last).filter(|(c, _)| Some(*c) != constant);
    let least = others.min_by(|a, b| a.1.total_cmp(b.1))?;
    (*least.1 < f_to_remove).then_some(least.0)
}

fn remove(pool: &Pool, basis: &mut Basis, out: usize) -> Step {
    let before = basis.residual_sum_squares();
    let left: Vec<usize> = basis.chosen().filter(|c| *c != out).collect();
    basis.restart(&left);
    let change = Change {
        candidate: out,
        action: Action::Removed,
        terms: left.len(),
        before,
        after: basis.residual_sum_squares(),
        press: basis.press(),
    };
    step(pool, basis.n(), basis.total(), AIC_RHO, change)
}
