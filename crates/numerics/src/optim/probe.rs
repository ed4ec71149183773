//! Counts evaluations, keeps the best point and the history, whatever the algorithm does in between.

use super::{Bounds, Budget, Objective, Outcome};
use crate::status::{Iterate, Status};

/// The budget is used up.
#[derive(Clone, Copy, PartialEq, Eq, Debug, thiserror::Error)]
#[error("the budget of evaluations is used up")]
pub(super) struct BudgetUsed;

pub(super) struct Probe<'a> {
    problem: &'a mut dyn Objective,
    bounds: &'a Bounds,
    limit: usize,
    evaluations: usize,
    best_x: Vec<f64>,
    best: f64,
    at: Vec<f64>,
    /// The last point with its value and, when `has_gradient`, its gradient.
    last_x: Vec<f64>,
    last: f64,
    has_gradient: bool,
    gradient: Vec<f64>,
    history: Vec<Iterate>,
}

impl<'a> Probe<'a> {
    /// A probe with the start point moved into the bounds.
    pub(super) fn new(
        problem: &'a mut dyn Objective,
        bounds: &'a Bounds,
        x0: &[f64],
        budget: &Budget,
    ) -> Self {
        let n = problem.n();
        assert!(
            x0.len() == n && bounds.lower.len() == n && bounds.upper.len() == n,
            "one entry per variable"
        );
        let start: Vec<f64> = (0..n).map(|k| clamp(x0[k], bounds, k)).collect();
        Self {
            problem,
            bounds,
            limit: budget.evaluations,
            evaluations: 0,
            best_x: start,
            best: f64::INFINITY,
            at: vec![0.0; n],
            last_x: vec![f64::NAN; n],
            last: f64::NAN,
            has_gradient: false,
            gradient: vec![0.0; n],
            history: Vec::new(),
        }
    }

    pub(super) fn start(&self) -> Vec<f64> {
        self.best_x.clone()
    }

    /// Value at `x` (moved into the bounds) and its gradient into `grad` when that is not empty; infinite for a
    /// non-finite value. Another call at the same point costs nothing.
    pub(super) fn value(&mut self, x: &[f64], grad: &mut [f64]) -> Result<f64, BudgetUsed> {
        for k in 0..x.len() {
            self.at[k] = clamp(x[k], self.bounds, k);
        }
        let wants = !grad.is_empty();
        if self.at != self.last_x || (wants && !self.has_gradient) {
            if self.evaluations >= self.limit {
                return Err(BudgetUsed);
            }
            self.evaluations += 1;
            let buffer = if wants { &mut self.gradient[..] } else { &mut [] };
            let value = self.problem.value_gradient(&self.at, buffer);
            let usable = value.is_finite() && buffer.iter().all(|g| g.is_finite());
            self.last = if usable { value } else { f64::INFINITY };
            self.has_gradient = wants;
            self.last_x.copy_from_slice(&self.at);
            if self.last < self.best {
                self.improve();
            }
        }
        if wants {
            grad.copy_from_slice(&self.gradient);
        }
        Ok(self.last)
    }

    fn improve(&mut self) {
        self.best = self.last;
        self.best_x.copy_from_slice(&self.at);
        let optimality = if self.has_gradient {
            projected_gradient_norm(&self.at, &self.gradient, self.bounds)
        } else {
            f64::NAN
        };
        self.history.push(Iterate {
            evaluations: self.evaluations,
            objective: self.best,
            violation: 0.0,
            optimality,
        });
    }

    pub(super) fn outcome(self, status: Status) -> Outcome {
        let status = if self.best.is_finite() { status } else { Status::Diverged };
        Outcome { x: self.best_x, value: self.best, status, history: self.history }
    }
}

fn clamp(x: f64, bounds: &Bounds, k: usize) -> f64 {
    x.max(bounds.lower[k]).min(bounds.upper[k])
}

/// Largest entry of `P(x - g) - x`, with P the projection onto the box.
pub(super) fn projected_gradient_norm(x: &[f64], g: &[f64], bounds: &Bounds) -> f64 {
    (0..x.len()).map(|k| (clamp(x[k] - g[k], bounds, k) - x[k]).abs()).fold(0.0, f64::max)
}
