//! Sparse nonlinear programming: a primal-dual filter interior point (Waechter and Biegler 2006).
//!
//! ```text
//! minimise f(x)   subject to   c(x) = 0,   xl <= x <= xu
//! ```
//!
//! Inequalities become equalities with bounded slacks in the problem's own formulation.

use crate::status::{Iterate, Status};

/// A sparse nonlinear program with exact first and second derivatives.
///
/// Structures are fixed: `jacobian_structure` and `hessian_structure` give (row, column) pairs once, the value
/// calls fill the same positions. The Hessian holds its lower triangle.
pub trait SparseNlp {
    /// Number of variables.
    fn n(&self) -> usize;
    /// Number of equality constraints.
    fn m(&self) -> usize;
    /// Bounds of the variables, infinite where there is none.
    fn bounds(&self, lower: &mut [f64], upper: &mut [f64]);
    /// Start point.
    fn start(&self, x: &mut [f64]);
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
    /// Most iterations.
    pub max_iterations: usize,
}

impl Default for NlpOptions {
    fn default() -> Self {
        Self { tolerance: 1e-8, max_iterations: 500 }
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
