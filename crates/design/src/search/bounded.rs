//! Bounded optimisers of the library as searches: one count, one budget and one history for all of them.
//!
//! An evaluation is a value with or without its gradient, so that methods with and without derivatives are compared at
//! equal numbers of simulations. Gradient methods meet rate and output limits through the chain's augmented
//! Lagrangian; methods that compare values move every trial into the rate limits and pay for passing an output limit.

use super::chain::{Candidate, Chain};
use crate::problem::Multipliers;
use dynocal_numerics::optim::{Bounds, Budget, Objective, Optimiser};
use dynocal_numerics::status::Status;

/// Orders of the p-norms for extremes, one run each.
const SHARPNESS: [f64; 3] = [8.0, 30.0, 120.0];
const FIRST_PENALTY: f64 = 1.0;
const OUTER_RUNS: usize = 40;
/// Evaluations below which a further run makes no sense.
const LEAST_RUN: usize = 12;
/// Evaluations between two corrections of the multipliers: early ones are guesses, so that runs need no precision.
const MOST_RUN: usize = 150;
/// What passing an output limit by its whole range costs a method that compares values, in search objective.
const OUTPUT_PRICE: f64 = 100.0;

fn bounds(chain: &Chain) -> Bounds {
    let (lower, upper) = chain.evaluator.layout().bounds();
    Bounds { lower: lower.to_vec(), upper: upper.to_vec() }
}

fn budget(evaluations: usize) -> Budget {
    Budget { evaluations, gradient_tolerance: 1e-6, value_tolerance: 1e-9 }
}

/// The search objective with its gradient.
struct Smooth<'c, 'w, 'a> {
    chain: &'c mut Chain<'w, 'a>,
    bounds: &'c Bounds,
    sharpness: f64,
    multipliers: Option<&'c Multipliers>,
    /// Whether values are those of designs, so that the best is kept at once.
    tells: bool,
}

impl Objective for Smooth<'_, '_, '_> {
    fn n(&self) -> usize {
        self.bounds.lower.len()
    }

    fn value_gradient(&mut self, x: &[f64], grad: &mut [f64]) -> f64 {
        if self.chain.interrupted() {
            return f64::NAN;
        }
        let f = self.chain.evaluator.objective(x, self.sharpness, self.multipliers, grad);
        if self.tells && self.chain.best.as_ref().is_none_or(|b| f < b.f) {
            let optimality = (0..grad.len())
                .map(|k| ((x[k] - grad[k]).clamp(self.bounds.lower[k], self.bounds.upper[k]) - x[k]).abs())
                .fold(if grad.is_empty() { f64::NAN } else { 0.0 }, f64::max);
            keep(self.chain, x, (f, 0.0), optimality);
        }
        f
    }
}

fn keep(chain: &mut Chain, x: &[f64], (f, violation): (f64, f64), optimality: f64) {
    chain.note(f, violation, optimality);
    chain.offer(Candidate { x: x.to_vec(), f, violation, converged: false, multipliers: None });
}

/// Runs a method that uses gradients from `x0` on all that is left of the budget.
pub(super) fn descend(chain: &mut Chain, x0: &[f64], method: &dyn Optimiser) {
    let bounds = bounds(chain);
    let first = if chain.evaluator.has_extreme() { 0 } else { SHARPNESS.len() - 1 };
    let (mut x, mut converged) = (x0.to_vec(), false);
    for (k, &sharpness) in SHARPNESS.iter().enumerate().skip(first) {
        // One evaluation is kept for the design that is returned.
        let share = chain.left().saturating_sub(1) / (SHARPNESS.len() - k);
        converged = if chain.is_constrained() {
            constrained(chain, &bounds, &mut x, sharpness, share, method)
        } else {
            let tells = k + 1 == SHARPNESS.len();
            let mut objective = Smooth { chain, bounds: &bounds, sharpness, multipliers: None, tells };
            let found = method.minimise(&mut objective, &bounds, &x, &budget(share));
            x = found.x;
            found.status == Status::Converged
        };
    }
    if chain.left() > 0 {
        chain.evaluator.layout().clone().repair(&mut x);
        let found = chain.value(&x);
        keep(chain, &x, found, f64::NAN);
    }
    if let Some(best) = &mut chain.best {
        best.converged |= converged;
    }
}

/// Augmented Lagrangian: runs on the box with multipliers for rates and outputs in between (Nocedal & Wright 2006,
/// section 17.4). The design of every run, moved into the rate limits, is offered.
fn constrained(
    chain: &mut Chain,
    bounds: &Bounds,
    x: &mut Vec<f64>,
    sharpness: f64,
    share: usize,
    method: &dyn Optimiser,
) -> bool {
    let Some(mut mu) = chain.evaluator.multipliers(FIRST_PENALTY) else { return false };
    let end = chain.evaluator.count() + share;
    let (mut before, mut value_before) = (f64::INFINITY, f64::INFINITY);
    for _ in 0..OUTER_RUNS {
        let left = end.saturating_sub(chain.evaluator.count() + 2);
        if left < LEAST_RUN || chain.interrupted() {
            return false;
        }
        let run = (left / 3).clamp(LEAST_RUN, MOST_RUN);
        let mut objective = Smooth { chain, bounds, sharpness, multipliers: Some(&mu), tells: false };
        *x = method.minimise(&mut objective, bounds, x, &budget(run)).x;
        let f = chain.evaluator.objective(x, sharpness, Some(&mu), &mut []);
        let violation = chain.violation(x);
        chain.evaluator.update(x, &mut mu);
        let mut design = x.clone();
        chain.evaluator.layout().repair(&mut design);
        let found = chain.value(&design);
        keep(chain, &design, found, f64::NAN);
        if chain.feasible(violation) && (f - value_before).abs() <= 1e-6 {
            return true;
        }
        if violation > 0.3 * before && !chain.feasible(violation) {
            mu.penalty = (3.0 * mu.penalty).min(1e7);
        }
        (before, value_before) = (violation.min(before), f);
    }
    false
}

/// The search objective without derivatives, with what passing an output limit costs.
struct Values<'c, 'w, 'a> {
    chain: &'c mut Chain<'w, 'a>,
    at: Vec<f64>,
    /// Evaluations of one line of progress (a generation, a temperature), and what such a line says beside the mean.
    block: usize,
    beside: &'c dyn Fn(usize) -> f64,
    sum: f64,
    counted: usize,
    lines: usize,
}

impl Objective for Values<'_, '_, '_> {
    fn n(&self) -> usize {
        self.at.len()
    }

    fn value_gradient(&mut self, x: &[f64], _: &mut [f64]) -> f64 {
        if self.chain.left() == 0 {
            return f64::NAN;
        }
        self.at.copy_from_slice(x);
        self.chain.evaluator.layout().repair(&mut self.at);
        let (f, violation) = self.chain.value(&self.at);
        if self.chain.best.as_ref().is_none_or(|b| self.chain.better((f, violation), (b.f, b.violation))) {
            keep(self.chain, &self.at, (f, violation), f64::NAN);
        }
        self.line(f, violation);
        if self.chain.feasible(violation) { f } else { f + OUTPUT_PRICE * violation }
    }
}

impl Values<'_, '_, '_> {
    /// Adds to the present line of progress and tells it when it is whole.
    fn line(&mut self, f: f64, violation: f64) {
        self.sum += f;
        self.counted += 1;
        if self.counted == self.block {
            self.chain.note(self.sum / self.block as f64, violation, (self.beside)(self.lines));
            (self.sum, self.counted, self.lines) = (0.0, 0, self.lines + 1);
        }
    }
}

/// Runs a method that compares values from `x0` on all that is left of the budget. Progress gets a line for every
/// `block` evaluations: their mean, and `beside(number of the line)` as its optimality.
pub(super) fn compare(
    chain: &mut Chain,
    x0: &[f64],
    method: &dyn Optimiser,
    block: usize,
    beside: &dyn Fn(usize) -> f64,
) {
    let (bounds, evaluations) = (bounds(chain), chain.left());
    let mut values =
        Values { chain, at: x0.to_vec(), block: block.max(1), beside, sum: 0.0, counted: 0, lines: 0 };
    method.minimise(&mut values, &bounds, x0, &budget(evaluations));
}
