//! The path of a selection: every step with the criteria after it, and which step to keep.

use serde::{Deserialize, Serialize};

use super::SelectError;
use super::basis::Basis;
use super::pool::Pool;
use crate::model::poly::PolyNarx;

/// Which step of the path is kept, and when the path ends. n samples, k terms, `mse` of the one-step prediction.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Stop {
    /// This many terms.
    Terms(usize),
    /// Least `n ln(mse) + k ln n` (thesis eq. 2.51) among the first `max_terms` terms.
    Bic {
        /// Most terms.
        max_terms: usize,
    },
    /// Least `n ln(mse) + rho k` (thesis eq. 2.50).
    Aic {
        /// Most terms.
        max_terms: usize,
        /// Weight of a term; 2 is Akaike's, 4 is the stricter common choice.
        rho: f64,
    },
    /// Least `n ln(mse) + n ln((n + k) / (n - k))` (thesis eq. 2.49).
    Fpe {
        /// Most terms.
        max_terms: usize,
    },
    /// Least mean square of the leave-one-out prediction errors.
    Press {
        /// Most terms.
        max_terms: usize,
    },
    /// Until no term reaches the F to enter (thesis eq. 2.38).
    F {
        /// Most terms.
        max_terms: usize,
        /// F to enter.
        f_to_enter: f64,
    },
}

impl Stop {
    /// Most terms of the path.
    pub fn max_terms(&self) -> usize {
        match *self {
            Stop::Terms(max_terms)
            | Stop::Bic { max_terms }
            | Stop::Aic { max_terms, .. }
            | Stop::Fpe { max_terms }
            | Stop::Press { max_terms }
            | Stop::F { max_terms, .. } => max_terms,
        }
    }

    /// Weight of a term in the AIC column of the path.
    pub(super) fn rho(&self) -> f64 {
        match self {
            Stop::Aic { rho, .. } => *rho,
            _ => AIC_RHO,
        }
    }

    /// Number of steps to keep.
    pub(super) fn steps(&self, path: &[Step]) -> usize {
        let least = |value: fn(&Step) -> f64| {
            let best = path.iter().enumerate().min_by(|a, b| value(a.1).total_cmp(&value(b.1)));
            best.map_or(0, |(i, _)| i + 1)
        };
        match self {
            Stop::Terms(_) | Stop::F { .. } => path.len(),
            Stop::Bic { .. } => least(|s| s.bic),
            Stop::Aic { .. } => least(|s| s.aic),
            Stop::Fpe { .. } => least(|s| s.fpe),
            Stop::Press { .. } => least(|s| s.press),
        }
    }
}

/// Akaike's weight of a term.
pub(super) const AIC_RHO: f64 = 2.0;

/// What a step did.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Action {
    /// The term came in.
    Entered,
    /// The term went out.
    Removed,
}

/// One step of the path, with the state after it.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Step {
    /// Whether the term entered or was removed.
    pub action: Action,
    /// Place in the pool.
    pub candidate: usize,
    /// Regressor in text form.
    pub regressor: String,
    /// Number of terms after the step.
    pub terms: usize,
    /// Error reduction ratio: share of y'y that the step explains (negative when a term was removed).
    pub err: f64,
    /// Explained share of y'y after the step.
    pub cumulative: f64,
    /// Partial F of the term in the larger of the two models (thesis eqs. 2.38, 2.41).
    #[serde(deserialize_with = "crate::nullable::number")]
    pub f: f64,
    /// One-step mean squared error after the step.
    pub mse: f64,
    /// `n ln(mse) + rho k` (thesis eq. 2.50).
    pub aic: f64,
    /// `n ln(mse) + k ln n` (thesis eq. 2.51).
    pub bic: f64,
    /// `n ln(mse) + n ln((n + k) / (n - k))` (thesis eq. 2.49).
    #[serde(deserialize_with = "crate::nullable::number")]
    pub fpe: f64,
    /// Mean square of the leave-one-out prediction errors.
    #[serde(deserialize_with = "crate::nullable::number")]
    pub press: f64,
    /// Free-run mean squared error after the step, where the method looks at it (infinite when it diverges).
    #[serde(default)]
    pub free_run: Option<f64>,
}

/// What was selected.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct Selection {
    /// Chosen structure: the first [`Selection::steps`] steps of the path, in the order of the pool.
    pub model: PolyNarx,
    /// Number of chosen terms.
    pub terms: usize,
    /// Steps of the path that are kept.
    pub steps: usize,
    /// All steps that were taken.
    pub path: Vec<Step>,
    /// Terms before the first step: none for forward methods.
    pub start: Vec<usize>,
    /// Size of the pool.
    pub pool: usize,
}

impl Selection {
    pub(super) fn new(
        pool: &Pool,
        start: Vec<usize>,
        path: Vec<Step>,
        steps: usize,
    ) -> Result<Self, SelectError> {
        let model = pool.structure(&replay(&start, &path[..steps.min(path.len())]))?;
        let terms = model.regressors().len();
        Ok(Self { model, terms, steps, path, start, pool: pool.candidates().len() })
    }

    /// The structure after the first `steps` steps instead.
    ///
    /// # Errors
    /// [`SelectError`] when no term is left then.
    pub fn first(&self, pool: &Pool, steps: usize) -> Result<PolyNarx, SelectError> {
        pool.structure(&replay(&self.start, &self.path[..steps.min(self.path.len())]))
    }
}

/// Terms after some steps.
pub(super) fn replay(start: &[usize], steps: &[Step]) -> Vec<usize> {
    let mut places = start.to_vec();
    for s in steps {
        match s.action {
            Action::Entered => places.push(s.candidate),
            Action::Removed => places.retain(|p| *p != s.candidate),
        }
    }
    places
}

/// Residual sums of squares before and after a step.
#[derive(Clone, Copy, Debug)]
pub(super) struct Change {
    pub(super) candidate: usize,
    pub(super) action: Action,
    /// Terms after it.
    pub(super) terms: usize,
    pub(super) before: f64,
    pub(super) after: f64,
    pub(super) press: f64,
}

/// The row of a step from the sums of squares: n samples, y'y in all.
pub(super) fn step(pool: &Pool, n: usize, total: f64, rho: f64, c: Change) -> Step {
    let (nf, k) = (n as f64, c.terms as f64);
    let mse = c.after / nf;
    let log = nf * mse.max(f64::MIN_POSITIVE).ln();
    let (larger, rest) = match c.action {
        Action::Entered => (c.terms, c.after),
        Action::Removed => (c.terms + 1, c.before),
    };
    let s2 = if n > larger { rest / (n - larger) as f64 } else { f64::NAN };
    Step {
        action: c.action,
        candidate: c.candidate,
        regressor: pool.text(c.candidate),
        terms: c.terms,
        err: (c.before - c.after) / total,
        cumulative: 1.0 - c.after / total,
        f: (c.before - c.after).abs() / s2,
        mse,
        aic: log + rho * k,
        bic: log + k * nf.ln(),
        fpe: if n > c.terms { log + nf * ((nf + k) / (nf - k)).ln() } else { f64::NAN },
        press: c.press,
        free_run: None,
    }
}

/// The step that has just led to `basis`.
pub(super) fn entered(pool: &Pool, basis: &Basis, candidate: usize, before: f64, rho: f64) -> Step {
    let change = Change {
        candidate,
        action: Action::Entered,
        terms: basis.chosen().count(),
        before,
        after: basis.residual_sum_squares(),
        press: basis.press(),
    };
    step(pool, basis.n(), basis.total(), rho, change)
}
