//! Structure selection: candidate pools, the methods and their table.
//!
//! ```
//! use dynocal_ident::experiment::Experiment;
//! use dynocal_ident::select::{self, pool::PoolKeys};
//!
//! let u: Vec<f64> = (0..300).map(|t| ((t * t * 7919) % 101) as f64 / 50.0 - 1.0).collect();
//! let mut y = vec![0.0; 300];
//! for t in 2..300 {
//!     y[t] = 0.5 * y[t - 1] + u[t - 2] * y[t - 1] + 0.3 * u[t - 1];
//! }
//! let data = [Experiment { name: "demo".into(), u, y, init_samples: 0, weights: vec![] }];
//! let pool: PoolKeys = toml::from_str("ny = 2\nnu = 3\ndegree = 2")?;
//! let pool = pool.pool(&["u".to_string()], "y")?;
//! let method = select::selection("stepwise", &toml::from_str("f_to_enter = 6.6\nf_to_remove = 6.0")?)?;
//! let found = method.select(&pool, &data, &|| false)?;
//! let terms = found.model.regressor_texts();
//! assert!(["u(t-1)", "u(t-2)*y(t-1)", "y(t-1)"].iter().all(|t| terms.contains(&t.to_string())));
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```

mod backward;
mod basis;
pub mod forward;
pub mod frols;
mod path;
pub mod pool;
pub mod prune;
mod simulation;
mod stepwise;
mod tree;

use dynocal_numerics::registry::{self, BuildError, Member, MemberDoc, ParamDoc};
use serde::Deserialize;

use crate::estimate::EstimateError;
use crate::experiment::Experiment;

pub use backward::Backward;
pub use path::{Action, Selection, Step, Stop};
pub use simulation::Simulation;
pub use stepwise::Stepwise;

use pool::Pool;

/// A method of structure selection: a pool of candidates and experiments in, a structure and the way to it out.
pub trait Select: Send + Sync {
    /// Selects from `pool` for all experiments together. `interrupt` is asked once a step.
    ///
    /// # Errors
    /// [`SelectError`]: too few samples, no term that can be taken, or interrupted.
    fn select(
        &self,
        pool: &Pool,
        data: &[Experiment],
        interrupt: &dyn Fn() -> bool,
    ) -> Result<Selection, SelectError>;
}

/// A selection could not be made.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum SelectError {
    /// The data or the structure do not fit.
    #[error(transparent)]
    Estimate(#[from] EstimateError),
    /// The pool does not fit.
    #[error("pool: {message}")]
    Pool {
        /// What was found and expected.
        message: String,
    },
    /// The options do not fit.
    #[error(transparent)]
    Build(#[from] BuildError),
    /// The user stopped it.
    #[error("structure selection interrupted")]
    Interrupted,
}

/// All methods.
pub static SELECTIONS: &[Member<dyn Select>] =
    &[frols::MEMBER, forward::MEMBER, backward::MEMBER, stepwise::MEMBER, simulation::MEMBER, prune::MEMBER];

/// Builds the method `name` from the keys of a spec.
///
/// # Errors
/// [`BuildError`] with the nearest known name.
pub fn selection(name: &str, keys: &toml::Table) -> Result<Box<dyn Select>, BuildError> {
    registry::build("selection", SELECTIONS, name, keys)
}

/// Documentation of all methods.
pub fn docs() -> Vec<MemberDoc> {
    SELECTIONS.iter().map(|m| m.doc).collect()
}

/// How a spec says which step to keep.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "snake_case")]
enum StopKeys {
    Terms,
    Bic,
    Aic,
    Fpe,
    Press,
    F,
}

impl StopKeys {
    fn stop(self, member: &str, max_terms: usize, rho: f64, f_to_enter: f64) -> Result<Stop, BuildError> {
        let fault = |message: String| Err(BuildError::Keys { member: member.into(), message });
        if max_terms == 0 {
            return fault("max_terms is 0, expected at least 1".into());
        }
        for (key, value) in [("rho", rho), ("f_to_enter", f_to_enter)] {
            if !(value > 0.0 && value.is_finite()) {
                return fault(format!("{key} is {value}, expected a positive number"));
            }
        }
        Ok(match self {
            StopKeys::Terms => Stop::Terms(max_terms),
            StopKeys::Bic => Stop::Bic { max_terms },
            StopKeys::Aic => Stop::Aic { max_terms, rho },
            StopKeys::Fpe => Stop::Fpe { max_terms },
            StopKeys::Press => Stop::Press { max_terms },
            StopKeys::F => Stop::F { max_terms, f_to_enter },
        })
    }
}

const MAX_TERMS: ParamDoc = ParamDoc {
    name: "max_terms",
    unit: "-",
    default: "20",
    what: "most terms (with stop = \"terms\": their number)",
};
const STOP: ParamDoc = ParamDoc {
    name: "stop",
    unit: "-",
    default: "f",
    what: "which step is kept: terms, bic, aic, fpe, press, f",
};
const STOP_BIC: ParamDoc = ParamDoc { default: "bic", ..STOP };
const RHO: ParamDoc =
    ParamDoc { name: "rho", unit: "-", default: "2", what: "weight of a term in the AIC, eq. (2.50)" };
const F_TO_ENTER: ParamDoc = ParamDoc {
    name: "f_to_enter",
    unit: "-",
    default: "4",
    what: "partial F that a term must exceed to come in (4: 95 %, 6.6: 99 % for long records)",
};
const F_TO_REMOVE: ParamDoc = ParamDoc {
    name: "f_to_remove",
    unit: "-",
    default: "3.9",
    what: "partial F below which a term goes out",
};

const SELECTION_SHARE: ParamDoc = ParamDoc {
    name: "selection",
    unit: "-",
    default: "0.25",
    what: "share of each record, at its end, that selects instead of being fitted; 0: the data of the fit select",
};

/// The start of every record to fit and its end to select by; with `share` 0 the whole records for both. Scores leave
/// out the first `lag` samples everywhere, so that structures with different lags are compared on the same samples.
fn split(data: &[Experiment], share: f64, lag: usize) -> (Vec<Experiment>, Vec<Experiment>) {
    let whole = data.iter().map(|e| Experiment { init_samples: e.init_samples.max(lag), ..e.clone() });
    if share <= 0.0 {
        let whole: Vec<Experiment> = whole.collect();
        return (whole.clone(), whole);
    }
    whole
        .map(|e| {
            let cut = ((1.0 - share) * e.len() as f64).round() as usize;
            // The end starts from measured values before the cut.
            (e.part(0, cut, e.init_samples), e.part(cut.saturating_sub(lag), e.len(), lag))
        })
        .unzip()
}

/// Asked once a step.
fn interrupted(interrupt: &dyn Fn() -> bool) -> Result<(), SelectError> {
    if interrupt() { Err(SelectError::Interrupted) } else { Ok(()) }
}
