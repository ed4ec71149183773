//! Sequential quadratic programming on a box.
//!
//! ```text
//! minimise g'd + d'B d / 2   subject to   l - x <= d <= u - x      B: damped BFGS
//! x+ = x + t d                                                      Armijo
//! ```
//!
//! The quadratic programs are solved by projected gradients that find the face and conjugate gradients on it, so that
//! nothing is dense. References: J. Nocedal, S. J. Wright, Numerical Optimization, 2nd ed., chapter 18; J. J. More,
//! G. Toraldo, On the solution of large quadratic programming problems with bound constraints, SIAM J. Optim. 1 (1991),
//! 93-113.

use super::limited::{Limited, Update};
use super::probe::{BudgetUsed, Probe, projected_gradient_norm};
use super::{Bounds, Budget, Objective, Optimiser, Outcome};
use crate::linalg::{axpy, dot};
use crate::status::Status;

/// Sequential quadratic programming. Needs gradients.
#[derive(Clone, Copy, Debug)]
pub struct SequentialQuadratic {
    /// Number of (step, gradient change) pairs kept (at least 1 is used).
    pub memory: usize,
}

impl Default for SequentialQuadratic {
    fn default() -> Self {
        Self { memory: 25 }
    }
}

const ARMIJO: f64 = 1e-4;
const MOST_BACKTRACKS: usize = 25;
/// Faces that one quadratic program visits, and conjugate gradients on each.
const FACES: usize = 15;
const PRODUCTS: usize = 30;
/// Reduction of the projected gradient that ends a quadratic program.
const ENOUGH: f64 = 1e-3;

impl Optimiser for SequentialQuadratic {
    fn minimise(&self, problem: &mut dyn Objective, bounds: &Bounds, x0: &[f64], budget: &Budget) -> Outcome {
        let mut probe = Probe::new(problem, bounds, x0, budget);
        let status = run(&mut probe, bounds, budget, self.memory).unwrap_or(Status::Limit);
        probe.outcome(status)
    }
}

fn run(probe: &mut Probe, bounds: &Bounds, budget: &Budget, memory: usize) -> Result<Status, BudgetUsed> {
    let mut x = probe.start();
    let n = x.len();
    let (mut g, mut next_g, mut next) = (vec![0.0; n], vec![0.0; n], vec![0.0; n]);
    let mut f = probe.value(&x, &mut g)?;
    if !f.is_finite() {
        return Ok(Status::Diverged);
    }
    let first = projected_gradient_norm(&x, &g, bounds);
    // Curvature is unknown: the first step goes down the gradient, no variable by more than a tenth.
    let steepest = g.iter().fold(f64::MIN_POSITIVE, |a: f64, g| a.max(g.abs()));
    let mut model = Limited::new(Update::DampedBfgs, memory, 10.0 * steepest);
    let mut program = Program::new(n);
    loop {
        let norm = projected_gradient_norm(&x, &g, bounds);
        if norm <= budget.gradient_tolerance * first || norm == 0.0 {
            return Ok(Status::Converged);
        }
        program.solve(&model, &g, &x, bounds);
        let slope = dot(&g, &program.d);
        let (mut t, mut found) = (1.0, None);
        for _ in 0..MOST_BACKTRACKS {
            (0..n)
                .for_each(|k| next[k] = (x[k] + t * program.d[k]).max(bounds.lower[k]).min(bounds.upper[k]));
            let v = probe.value(&next, &mut next_g)?;
            if v.is_finite() && v <= f + ARMIJO * t * slope && slope < 0.0 {
                found = Some(v);
                break;
            }
            let parabola = -0.5 * t * slope / ((v - f) / t - slope);
            t = if v.is_finite() && parabola.is_finite() {
                parabola.clamp(0.1 * t, 0.5 * t)
            } else {
                0.2 * t
            };
        }
        let Some(v) = found else {
            if model.is_empty() {
                return Ok(Status::Stalled);
            }
            model.forget();
            continue;
        };
        let s: Vec<f64> = next.iter().zip(&x).map(|(a, b)| a - b).collect();
        let y: Vec<f64> = next_g.iter().zip(&g).map(|(a, b)| a - b).collect();
        let settled = f - v <= budget.value_tolerance * f.abs().max(v.abs()) && !model.is_empty();
        model.push(s, y);
        x.copy_from_slice(&next);
        g.copy_from_slice(&next_g);
        f = v;
        if settled {
            return Ok(Status::Converged);
        }
    }
}

/// A quadratic program over a box around zero and its buffers.
struct Program {
    d: Vec<f64>,
    lower: Vec<f64>,
    upper: Vec<f64>,
    /// Gradient of the model at `d`.
    r: Vec<f64>,
    free: Vec<bool>,
    w: Vec<f64>,
    p: Vec<f64>,
    bp: Vec<f64>,
    residual: Vec<f64>,
    trial: Vec<f64>,
}

impl Program {
    fn new(n: usize) -> Self {
        let v = || vec![0.0; n];
        Self {
            d: v(),
            lower: v(),
            upper: v(),
            r: v(),
            free: vec![true; n],
            w: v(),
            p: v(),
            bp: v(),
            residual: v(),
            trial: v(),
        }
    }

    fn solve(&mut self, model: &Limited, g: &[f64], x: &[f64], bounds: &Bounds) {
        let n = g.len();
        for k in 0..n {
            (self.lower[k], self.upper[k]) = (bounds.lower[k] - x[k], bounds.upper[k] - x[k]);
        }
        self.d.fill(0.0);
        self.r.copy_from_slice(g);
        let first = self.mark_free();
        for _ in 0..FACES {
            // Along the projected gradient to find the face, then on the face.
            self.w.copy_from_slice(&self.r);
            (0..n).for_each(|k| self.w[k] = if self.free[k] { -self.w[k] } else { 0.0 });
            model.apply(&self.w, &mut self.bp);
            let (ww, curvature) = (dot(&self.w, &self.w), dot(&self.w, &self.bp));
            if ww == 0.0 || curvature <= 0.0 {
                return;
            }
            let t = ww / curvature;
            self.w.iter_mut().for_each(|w| *w *= t);
            self.search(model, g);
            self.mark_free();
            self.conjugate_gradients(model);
            self.search(model, g);
            if self.mark_free() <= ENOUGH * first {
                return;
            }
        }
    }

    /// Variables that may move at `d`; the largest entry of the projected gradient.
    fn mark_free(&mut self) -> f64 {
        let mut worst = 0.0f64;
        for k in 0..self.d.len() {
            let low = self.d[k] <= self.lower[k] && self.r[k] >= 0.0;
            let up = self.d[k] >= self.upper[k] && self.r[k] <= 0.0;
            self.free[k] = !(low || up);
            if self.free[k] {
                worst = worst.max(self.r[k].abs());
            }
        }
        worst
    }

    /// Conjugate gradients for the step `w` on the free variables, from `d`.
    fn conjugate_gradients(&mut self, model: &Limited) {
        let n = self.d.len();
        self.w.fill(0.0);
        for k in 0..n {
            self.residual[k] = if self.free[k] { -self.r[k] } else { 0.0 };
        }
        self.p.copy_from_slice(&self.residual);
        let mut rr = dot(&self.residual, &self.residual);
        let enough = 1e-6 * rr;
        for _ in 0..PRODUCTS {
            if rr <= enough || rr == 0.0 {
                return;
            }
            model.apply(&self.p, &mut self.bp);
            (0..n).filter(|k| !self.free[*k]).for_each(|k| self.bp[k] = 0.0);
            let curvature = dot(&self.p, &self.bp);
            if curvature <= 0.0 {
                return;
            }
            let alpha = rr / curvature;
            axpy(alpha, &self.p, &mut self.w);
            axpy(-alpha, &self.bp, &mut self.residual);
            let next = dot(&self.residual, &self.residual);
            let beta = next / rr;
            self.p.iter_mut().zip(&self.residual).for_each(|(p, r)| *p = r + beta * *p);
            rr = next;
        }
    }

    /// `d` to the projection of `d + t w` that lowers the model, t halved from one; gradient of the model there.
    fn search(&mut self, model: &Limited, g: &[f64]) {
        let n = self.d.len();
        let mut t = 1.0;
        for _ in 0..20 {
            for k in 0..n {
                self.trial[k] = (self.d[k] + t * self.w[k]).max(self.lower[k]).min(self.upper[k]) - self.d[k];
            }
            model.apply(&self.trial, &mut self.bp);
            let change = dot(&self.r, &self.trial) + 0.5 * dot(&self.trial, &self.bp);
            if change < 0.0 {
                axpy(1.0, &self.trial, &mut self.d);
                // From scratch, so that rounding does not add up.
                model.apply(&self.d, &mut self.r);
                axpy(1.0, g, &mut self.r);
                return;
            }
            t *= 0.5;
        }
    }
}
