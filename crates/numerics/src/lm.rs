//! Levenberg-Marquardt for nonlinear least squares with exact Jacobians.

use crate::status::{Iterate, Status};

/// A nonlinear least-squares problem: minimise `|r(x)|^2`.
pub trait LeastSquares {
    /// Number of variables n.
    fn n(&self) -> usize;
    /// Number of residuals.
    fn residuals(&self) -> usize;
    /// Residuals at `x`; `false` when they are not finite (an unstable trial is a bad trial, not an end).
    fn residual(&mut self, x: &[f64], r: &mut [f64]) -> bool;
    /// Residuals and their Jacobian (row-major, residuals x n) at `x`.
    fn residual_jacobian(&mut self, x: &[f64], r: &mut [f64], jac: &mut [f64]) -> bool;
}

/// Options of Levenberg-Marquardt.
#[derive(Clone, Copy, Debug)]
pub struct LmOptions {
    /// Most residual evaluations.
    pub max_evaluations: usize,
    /// Relative decrease of the cost, predicted and actual, at which it has converged.
    pub cost_tolerance: f64,
    /// Scaled gradient (largest |J_k' r| / (|J_k| |r|)) at which it has converged.
    pub gradient_tolerance: f64,
}

impl Default for LmOptions {
    fn default() -> Self {
        Self { max_evaluations: 200, cost_tolerance: 1e-12, gradient_tolerance: 1e-10 }
    }
}

/// What Levenberg-Marquardt found.
#[derive(Clone, Debug)]
pub struct LmOutcome {
    /// Best point (n).
    pub x: Vec<f64>,
    /// |r|^2 there.
    pub cost: f64,
    /// How it ended.
    pub status: Status,
    /// Residual evaluations, those with Jacobian included.
    pub evaluations: usize,
    /// Jacobian evaluations.
    pub jacobians: usize,
    /// One entry per accepted step.
    pub history: Vec<Iterate>,
}
