//! Forward regression orthogonal least squares.
//!
//! ```text
//! g_i = w_i' y / w_i' w_i,    ERR_i = g_i^2 w_i' w_i / y' y,    w_i: candidate i orthogonal to those chosen
//! ```
//!
//! At each step the candidate with the largest error reduction ratio is taken, over all experiments together. The
//! columns of the candidates are never stored (`select/tree.rs` says how): ten lags of two channels at degree 4, 10 626
//! candidates over 25 000 samples, take the memory of 20 columns. The path holds every step, so that the number of
//! terms can be chosen afterwards.
//!
//! Reference: S. Chen, S. A. Billings, W. Luo, Int. J. Control 50 (1989) 1873-1896.

use dynocal_numerics::registry::{self, BuildError, Member, MemberDoc};
use serde::Deserialize;

pub use super::SelectError;
use super::basis::Basis;
use super::forward::advance;
pub use super::path::{Selection, Step, Stop};
use super::pool::Pool;
use super::{Select, StopKeys};
use crate::experiment::Experiment;

/// Selection by error reduction ratio.
#[derive(Clone, Copy, Debug)]
pub struct Frols {
    /// When to stop.
    pub stop: Stop,
}

#[derive(Deserialize)]
#[serde(default, deny_unknown_fields)]
struct Keys {
    stop: StopKeys,
    max_terms: usize,
    rho: f64,
    f_to_enter: f64,
}

impl Default for Keys {
    fn default() -> Self {
        Self { stop: StopKeys::Bic, max_terms: 20, rho: 2.0, f_to_enter: 4.0 }
    }
}

pub(super) const MEMBER: Member<dyn Select> = Member {
    doc: MemberDoc {
        name: "frols",
        what: "orthogonal forward regression by error reduction ratio",
        params: &[super::MAX_TERMS, super::STOP_BIC, super::RHO, super::F_TO_ENTER],
    },
    build,
};

fn build(keys: &toml::Table) -> Result<Box<dyn Select>, BuildError> {
    let k: Keys = registry::keys("frols", keys)?;
    Ok(Box::new(Frols { stop: k.stop.stop("frols", k.max_terms, k.rho, k.f_to_enter)? }))
}

impl Select for Frols {
    fn select(
        &self,
        pool: &Pool,
        data: &[Experiment],
        interrupt: &dyn Fn() -> bool,
    ) -> Result<Selection, SelectError> {
        let most = self.stop.max_terms().min(pool.candidates().len());
        let mut basis = Basis::new(pool, data, most)?;
        let mut path = Vec::with_capacity(most);
        let next = |basis: &Basis| basis.best(1).into_iter().next();
        advance(pool, &mut basis, &mut path, &self.stop, &next, interrupt)?;
        let steps = self.stop.steps(&path);
        Selection::new(pool, Vec::new(), path, steps)
    }
}

/// Selects terms of `pool` for the one-step prediction of `data`.
///
/// # Errors
/// [`SelectError`]: too few samples for the number of terms asked for, or no term at all.
///
/// ```
/// use dynocal_ident::experiment::Experiment;
/// use dynocal_ident::model::poly::PolyNarx;
/// use dynocal_ident::select::frols::{Stop, frols};
///
/// // y(t) = 0.5 y(t-1) + u(t-1)^2, offered among six candidates.
/// let u: Vec<f64> = (0..200).map(|t| ((t * t * 7919) % 101) as f64 / 50.0 - 1.0).collect();
/// let mut y = vec![0.0; 200];
/// for t in 1..200 {
///     y[t] = 0.5 * y[t - 1] + u[t - 1] * u[t - 1];
/// }
/// let pool = PolyNarx::parse(&["u"], "y", &["1", "u(t-1)", "u(t-2)", "u(t-1)^2", "u(t-2)^2", "y(t-1)"])?;
/// let data = Experiment { name: "demo".into(), u, y, init_samples: 0, weights: vec![] };
/// let selection = frols(&pool, &[data], Stop::Bic { max_terms: 6 })?;
/// assert_eq!(selection.model.regressor_texts(), ["u(t-1)^2", "y(t-1)"]);
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
pub fn frols(pool: impl Into<Pool>, data: &[Experiment], stop: Stop) -> Result<Selection, SelectError> {
    Frols { stop }.select(&pool.into(), data, &|| false)
}
