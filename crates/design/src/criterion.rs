//! Optimality criteria: the contract and its table.

use dynocal_numerics::registry::{self, BuildError, Member};

/// What a criterion sees of a design: the information through the triangular factor of the column-scaled
/// sensitivities, never through an inverse of a badly scaled matrix.
///
/// With raw sensitivities S (N x p), column scales c (p) and noise variance sigma^2:
/// `S diag(1/c) = Q R`, `M = S'S / sigma^2` (thesis eq. 4.23).
#[derive(Clone, Copy, Debug)]
pub struct Information<'a> {
    /// Upper triangular factor R (p x p row-major) of the scaled sensitivities.
    pub r: &'a [f64],
    /// Column scales c (p): raw sensitivity = scaled times c.
    pub scale: &'a [f64],
    /// Scaled sensitivities of the design (N x p row-major), rows that count only.
    pub s: &'a [f64],
    /// Noise variance sigma^2.
    pub noise_variance: f64,
    /// Scaled sensitivities of the objective signal U0 (N0 x p row-major); empty where there is none.
    pub s0: &'a [f64],
}

/// An optimality criterion: a scalar of the information that is minimised, with its exact gradient.
pub trait Criterion: Send + Sync {
    /// Whether it needs an objective signal U0 (`Information::s0`).
    fn needs_objective_signal(&self) -> bool {
        false
    }

    /// Value J in raw (unscaled) parameters, and the gradient dJ/dS of the *scaled* sensitivities (N x p) when
    /// `s_bar` is not empty.
    fn value_gradient(&self, info: &Information, s_bar: &mut [f64]) -> f64;
}

/// All criteria.
pub static CRITERIA: &[Member<dyn Criterion>] = &[];

/// Builds the criterion `name` from the keys of a spec.
///
/// # Errors
/// [`BuildError`] with the nearest known name.
pub fn criterion(name: &str, keys: &toml::Table) -> Result<Box<dyn Criterion>, BuildError> {
    registry::build("criterion", CRITERIA, name, keys)
}
