//! Sparse nonlinear programming: a primal-dual filter interior point (Waechter and Biegler 2006).
//!
//! ```text
//! minimise f(x)   subject to   c(x) = 0,   xl <= x <= xu
//! ```
//!
//! Inequalities become equalities with bounded slacks in the problem's own formulation; such slacks (one row, no
//! second derivative, a finite bound) leave the linear system again and cost next to nothing. Number the other
//! variables so that coupled ones are near each other, for example sample by sample: up to about 60 of them may be
//! alive at once for the fast factorisation along the chain; any other order or structure is solved as well, slower.
//!
//! Reference: A. Waechter, L. T. Biegler, On the implementation of an interior-point filter line-search algorithm
//! for large-scale nonlinear programming, Mathematical Programming 106 (2006), 25-57.

mod barrier;
mod filter;
mod front;
mod frontal;
mod ipm;
mod iterate;
mod kkt;
mod line_search;
mod model;
mod restoration;

use crate::status::{Iterate, Status};

/// A sparse nonlinear program with exact first and second derivatives.
///
/// Structures are fixed: `jacobian_structure` and `hessian_structure` give (row, column) pairs once, the value
/// calls fill the same positions. The Hessian holds its lower triangle. Duplicate entries are summed. Bounds are
/// infinite on entry of [`SparseNlp::bounds`].
pub trait SparseNlp {
    /// Number of variables.
    fn n(&self) -> usize;
    /// Number of equality constraints.
    fn m(&self) -> usize;
    /// Bounds of the variables, infinite where there is none.
    fn bounds(&self, lower: &mut [f64], upper: &mut [f64]);
    /// Start point.
    fn start(&self, x: &mut [f64]);
    /// How large a change of each variable is that matters, 1 on entry and by default: the search runs in `x / size`, so that a
    /// distance from a bound, a step and a curvature mean the same for all of them. Powers of two keep every bit.
    fn sizes(&self, _size: &mut [f64]) {}
    /// What the search divides the objective by before anything else, 1 by default: for an objective whose unit is arbitrary (a user's
    /// weights), so that no choice of it is too steep or too flat for the tolerances.
    fn objective_unit(&mut self) -> f64 {
        1.0
    }
    /// Objective.
    fn objective(&mut self, x: &[f64]) -> f64;
    /// Gradient of the objective (n).
    fn gradient(&mut self, x: &[f64], grad: &mut [f64]);
    /// Constraints (m).
    fn constraints(&mut self, x: &[f64], c: &mut [f64]);
    /// (row, column) of each Jacobian entry.
    fn jacobian_structure(&self) -> Vec<(usize, usize)>;
    /// Values of the Jacobian entries.
    fn jacobian(&mut self, x: &[f64], values: &mut [f64]);
    /// (row, column) of each entry of the lower triangle of the Hessian of the Lagrangian.
    fn hessian_structure(&self) -> Vec<(usize, usize)>;
    /// Values of the Hessian of `sigma f + multipliers' c`.
    fn hessian(&mut self, x: &[f64], sigma: f64, multipliers: &[f64], values: &mut [f64]);
}

/// Options of the interior point.
#[derive(Clone, Copy, Debug)]
pub struct NlpOptions {
    /// Scaled KKT error at which it has converged.
    pub tolerance: f64,
    /// Most iterations, and most steps of restorations.
    pub max_iterations: usize,
    /// For a start that is nearly optimal: the barrier parameter to begin with. The start is then hardly moved off its
    /// bounds.
    pub warm_barrier: Option<f64>,
}

impl Default for NlpOptions {
    fn default() -> Self {
        Self { tolerance: 1e-8, max_iterations: 500, warm_barrier: None }
    }
}

/// What the interior point found.
#[derive(Clone, Debug)]
pub struct NlpOutcome {
    /// Point (n).
    pub x: Vec<f64>,
    /// Multipliers of the constraints (m).
    pub multipliers: Vec<f64>,
    /// Objective.
    pub objective: f64,
    /// Largest |c(x)|.
    pub violation: f64,
    /// How it ended.
    pub status: Status,
    /// One entry per iteration.
    pub history: Vec<Iterate>,
}

/// Solves `problem`; `interrupt` is asked once per iteration.
///
/// The status is
/// - `Converged`: scaled KKT error within the tolerance,
/// - `Infeasible`: an empty box, or a stationary point of the violation with positive violation,
/// - `Stalled`: no acceptable step although the point is (nearly) feasible,
/// - `Limit`, `Interrupted`, and `Diverged` when the functions are not finite at the start.
///
/// Variables whose bounds coincide are held at them. The returned point lies inside of the bounds.
///
/// ```
/// use dynocal_numerics::nlp::{NlpOptions, SparseNlp, solve};
/// /// Nearest point to the origin on x + y = 2 with x <= 0.5.
/// struct Nearest;
/// impl SparseNlp for Nearest {
///     fn n(&self) -> usize { 2 }
///     fn m(&self) -> usize { 1 }
///     fn bounds(&self, _lower: &mut [f64], upper: &mut [f64]) { upper[0] = 0.5; }
///     fn start(&self, x: &mut [f64]) { x.fill(0.0); }
///     fn objective(&mut self, x: &[f64]) -> f64 { x[0] * x[0] + x[1] * x[1] }
///     fn gradient(&mut self, x: &[f64], g: &mut [f64]) { (g[0], g[1]) = (2.0 * x[0], 2.0 * x[1]); }
///     fn constraints(&mut self, x: &[f64], c: &mut [f64]) { c[0] = x[0] + x[1] - 2.0; }
///     fn jacobian_structure(&self) -> Vec<(usize, usize)> { vec![(0, 0), (0, 1)] }
///     fn jacobian(&mut self, _: &[f64], v: &mut [f64]) { v.fill(1.0); }
///     fn hessian_structure(&self) -> Vec<(usize, usize)> { vec![(0, 0), (1, 1)] }
///     fn hessian(&mut self, _: &[f64], sigma: f64, _: &[f64], v: &mut [f64]) { v.fill(2.0 * sigma); }
/// }
/// let found = solve(&mut Nearest, &NlpOptions::default(), &|| false);
/// assert!(found.status.is_success());
/// assert!((found.x[0] - 0.5).abs() < 1e-7 && (found.objective - 2.5).abs() < 1e-6);
/// ```
pub fn solve(problem: &mut dyn SparseNlp, options: &NlpOptions, interrupt: &dyn Fn() -> bool) -> NlpOutcome {
    let (n, m) = (problem.n(), problem.m());
    let mut start = vec![0.0; n];
    problem.start(&mut start);
    match model::Model::new(problem) {
        Ok(model) => {
            let mut ipm = ipm::Ipm::new(model, *options);
            let status = ipm.run(interrupt);
            ipm.into_outcome(status)
        }
        Err(trivial) => NlpOutcome {
            x: start,
            multipliers: vec![0.0; m],
            objective: f64::NAN,
            violation: f64::INFINITY,
            status: match trivial {
                model::Trivial::EmptyBox => Status::Infeasible,
                model::Trivial::NotFinite => Status::Diverged,
            },
            history: Vec::new(),
        },
    }
}
