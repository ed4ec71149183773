//! The contract of an optimiser, so that algorithms can be compared on equal terms:
//! a problem (bounds, derivatives as available) in, iterate history and a status out.

mod basin_global;
mod basin_members;
mod interior_point;
mod limited;
mod probe;
mod quasi_newton;
mod sequential_quadratic;
mod trust_region;

pub use basin_global::{Annealing, Genetic};
pub use interior_point::InteriorPoint;
pub use quasi_newton::QuasiNewton;
pub use sequential_quadratic::SequentialQuadratic;
pub use trust_region::TrustRegion;

use crate::registry::{self, BuildError, Member};
use crate::status::{Iterate, Status};

/// A smooth objective over a box.
///
/// `value_gradient` may return a non-finite value: that trial is then a bad trial, not an end.
pub trait Objective {
    /// Number of variables n.
    fn n(&self) -> usize;

    /// Objective at `x`; fills its gradient (n) when `grad` is not empty.
    fn value_gradient(&mut self, x: &[f64], grad: &mut [f64]) -> f64;
}

/// Box bounds; infinite where there is none.
#[derive(Clone, Debug)]
pub struct Bounds {
    /// Lower bounds (n).
    pub lower: Vec<f64>,
    /// Upper bounds (n).
    pub upper: Vec<f64>,
}

/// When to stop.
#[derive(Clone, Copy, Debug)]
pub struct Budget {
    /// Most evaluations of the objective.
    pub evaluations: usize,
    /// Projected-gradient norm, relative to its value at the start, at which the search has converged.
    pub gradient_tolerance: f64,
    /// Relative decrease of the objective over one iteration below which the search ends as converged.
    pub value_tolerance: f64,
}

/// What an optimiser found.
#[derive(Clone, Debug)]
pub struct Outcome {
    /// Best point (n).
    pub x: Vec<f64>,
    /// Objective there.
    pub value: f64,
    /// How it ended.
    pub status: Status,
    /// One entry per improvement of the best point; `optimality` is NaN for methods without derivatives.
    pub history: Vec<Iterate>,
}

/// An optimiser for bounded problems.
pub trait Optimiser: Send + Sync {
    /// Minimises `problem` over `bounds` from `x0` (moved into the bounds first).
    ///
    /// The result is never worse than the start, lies in the bounds, and took at most `budget.evaluations`.
    fn minimise(&self, problem: &mut dyn Objective, bounds: &Bounds, x0: &[f64], budget: &Budget) -> Outcome;
}

/// All bounded optimisers.
pub static OPTIMISERS: &[Member<dyn Optimiser>] =
    &[quasi_newton::MEMBER, basin_members::LBFGSB, basin_members::NELDER_MEAD, basin_members::PATTERN_SEARCH];

/// Builds the optimiser `name` from the keys of a spec.
///
/// # Errors
/// [`BuildError`] with the nearest known name.
///
/// ```
/// use dynocal_numerics::optim::{Bounds, Budget, Objective, optimiser};
/// struct Bowl;
/// impl Objective for Bowl {
///     fn n(&self) -> usize { 2 }
///     fn value_gradient(&mut self, x: &[f64], g: &mut [f64]) -> f64 {
///         if !g.is_empty() {
///             (g[0], g[1]) = (2.0 * (x[0] - 3.0), 2.0 * x[1]);
///         }
///         (x[0] - 3.0).powi(2) + x[1] * x[1]
///     }
/// }
/// let bounds = Bounds { lower: vec![-1.0; 2], upper: vec![1.0; 2] };
/// let budget = Budget { evaluations: 100, gradient_tolerance: 1e-8, value_tolerance: 1e-12 };
/// let method = optimiser("quasi_newton", &toml::Table::new()).unwrap();
/// let found = method.minimise(&mut Bowl, &bounds, &[0.0, 0.5], &budget);
/// assert!(found.status.is_success() && (found.value - 4.0).abs() < 1e-10);
/// ```
pub fn optimiser(name: &str, keys: &toml::Table) -> Result<Box<dyn Optimiser>, BuildError> {
    registry::build("optimiser", OPTIMISERS, name, keys)
}
