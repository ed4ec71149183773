//! The iteration: KKT step, barrier parameter, line search, restoration.

use super::barrier::BarrierRule;
use super::filter::Filter;
use super::iterate::{Point, Steps, barrier_slope, fraction_to_boundary, fraction_to_zero};
use super::kkt::Kkt;
use super::line_search::Moved;
use super::model::Model;
use super::{NlpOptions, restoration};
use crate::linalg::norm_inf;
use crate::status::{Iterate, Status};

/// Least share of a slack that a step may use.
const TAU_MIN: f64 = 0.99;
/// Least-squares start multipliers larger than this are worse than none.
const LAMBDA_START_MAX: f64 = 1e3;
/// Constraint regularisation of a rank-deficient Jacobian: `DC mu^(1/4)`.
const DC: f64 = 1e-8;
/// Failed line searches near a feasible point that are answered by stronger regularisation before giving up.
const STIFFENINGS: usize = 6;
/// Successive steps of rounding size without progress of the multipliers after which the search ends.
const TINY_STEPS: usize = 4;
/// Share to which such a step must bring the error to be progress: where equations alone fix the point, the multipliers of
/// the bounds are all that still moves.
const PROGRESS: f64 = 0.5;

/// A search direction in all variables.
pub(super) struct Direction {
    pub(super) dx: Vec<f64>,
    pub(super) dlambda: Vec<f64>,
    pub(super) dzl: Vec<f64>,
    pub(super) dzu: Vec<f64>,
}

pub(super) struct Ipm<'a> {
    pub(super) model: Model<'a>,
    pub(super) options: NlpOptions,
    pub(super) point: Point,
    pub(super) kkt: Kkt,
    pub(super) filter: Filter,
    pub(super) rule: BarrierRule,
    pub(super) direction: Direction,
    affine: Direction,
    hess: Vec<f64>,
    pub(super) sigma: Vec<f64>,
    pub(super) rhs: Vec<f64>,
    pub(super) solution: Vec<f64>,
    pub(super) work: Vec<f64>,
    pub(super) trial_x: Vec<f64>,
    pub(super) trial_c: Vec<f64>,
    pub(super) soc_c: Vec<f64>,
    pub(super) soc_dx: Vec<f64>,
    history: Vec<Iterate>,
    /// Steps of restorations so far.
    pub(super) restored: usize,
}

impl<'a> Ipm<'a> {
    pub(super) fn new(model: Model<'a>, options: NlpOptions) -> Self {
        let (n, m) = (model.n, model.m);
        let bounded: Vec<bool> =
            model.lower.iter().zip(&model.upper).map(|(l, u)| l.is_finite() || u.is_finite()).collect();
        let direction =
            || Direction { dx: vec![0.0; n], dlambda: vec![0.0; m], dzl: vec![0.0; n], dzu: vec![0.0; n] };
        Self {
            point: Point::new(&model, options.warm_barrier),
            kkt: Kkt::new(m, &model.hess_at, &model.jac_at, &bounded),
            filter: Filter::new(1.0),
            rule: BarrierRule::new(options.tolerance),
            direction: direction(),
            affine: direction(),
            hess: vec![0.0; model.hess_at.len()],
            sigma: vec![0.0; n],
            rhs: vec![0.0; n + m],
            solution: vec![0.0; n + m],
            work: vec![0.0; n],
            trial_x: vec![0.0; n],
            trial_c: vec![0.0; m],
            soc_c: vec![0.0; m],
            soc_dx: vec![0.0; n],
            history: Vec::new(),
            restored: 0,
            model,
            options,
        }
    }

    /// Runs to the end; returns the status, with the point left in `self`.
    pub(super) fn run(&mut self, interrupt: &dyn Fn() -> bool) -> Status {
        if !self.point.evaluate(&mut self.model) {
            return Status::Diverged;
        }
        self.start_multipliers();
        self.filter = Filter::new(self.theta());
        self.rule.start(&self.model, &self.point);
        let (mut stiffness, mut failures, mut tiny_steps) = (0.0, 0usize, 0usize);
        let mut last_error = f64::INFINITY;
        for _ in 0..self.options.max_iterations {
            let error = self.record();
            if error <= self.options.tolerance && self.unscaled_violation() <= self.violation_tolerance() {
                return Status::Converged;
            }
            if error.is_nan() {
                return Status::Diverged;
            }
            if interrupt() {
                return Status::Interrupted;
            }
            if self.rule.update(&self.model, &self.point, &mut self.work) {
                self.filter.clear();
            }
            if !self.factor(stiffness) || !self.choose_direction() {
                return self.dead_end(interrupt);
            }
            let moved = self.line_search();
            if moved != Moved::No {
                (stiffness, failures) = (0.0, 0);
                self.rule.note_progress();
                let idle = moved == Moved::Tiny && error > PROGRESS * last_error;
                tiny_steps = if idle { tiny_steps + 1 } else { 0 };
                last_error = error;
                if tiny_steps > TINY_STEPS {
                    return self.dead_end(interrupt);
                }
                continue;
            }
            if self.rule.leave_free_mode(&self.model, &self.point) {
                self.filter.clear();
                continue;
            }
            if norm_inf(&self.point.c) > 0.01 * self.options.tolerance {
                match restoration::restore(self, interrupt) {
                    restoration::Ended::Restored => continue,
                    restoration::Ended::With(Status::Stalled) => {}
                    restoration::Ended::With(status) => return status,
                }
            }
            failures += 1;
            if failures > STIFFENINGS {
                return self.dead_end(interrupt);
            }
            self.filter.clear();
            stiffness = if stiffness == 0.0 { 1e-6 } else { 100.0 * stiffness };
        }
        self.record();
        Status::Limit
    }

    /// Nothing more can be done from here: infeasible only where the violation itself cannot fall any more.
    fn dead_end(&mut self, interrupt: &dyn Fn() -> bool) -> Status {
        if self.unscaled_violation() <= 1e-4 {
            return Status::Stalled;
        }
        match restoration::restore(self, interrupt) {
            restoration::Ended::Restored => Status::Stalled,
            restoration::Ended::With(status) => status,
        }
    }

    pub(super) fn theta(&self) -> f64 {
        self.point.c.iter().map(|c| c.abs()).sum()
    }

    fn unscaled_violation(&self) -> f64 {
        self.model.violation(&self.point.c)
    }

    /// Unscaled violation that a converged point may have.
    fn violation_tolerance(&self) -> f64 {
        (100.0 * self.options.tolerance).min(1e-6).max(self.options.tolerance)
    }

    fn record(&mut self) -> f64 {
        let error = self.point.errors(&self.model, 0.0, &mut self.work).largest();
        self.history.push(Iterate {
            evaluations: self.model.evaluations,
            objective: self.point.f / self.model.objective_scale,
            violation: self.unscaled_violation(),
            optimality: error,
        });
        error
    }

    /// Multipliers that fit the dual equations best: `[I J'; J 0] [w; l] = -[grad - zl + zu; 0]`.
    pub(super) fn start_multipliers(&mut self) {
        let n = self.model.n;
        self.sigma.fill(1.0);
        for k in 0..n {
            self.rhs[k] = -(self.point.grad[k] - self.point.zl[k] + self.point.zu[k]);
        }
        self.rhs[n..].fill(0.0);
        let solved = self.kkt.factor_quasidefinite(&self.sigma, &self.point.jac, 1e-10)
            && self.kkt.solve(&self.rhs, &mut self.solution);
        if solved && norm_inf(&self.solution[n..]) <= LAMBDA_START_MAX {
            self.point.lambda.copy_from_slice(&self.solution[n..]);
        } else {
            self.point.lambda.fill(0.0);
        }
    }

    fn factor(&mut self, stiffness: f64) -> bool {
        self.model.hessian(&self.point.x, &self.point.lambda, &mut self.hess);
        self.point.sigma(&self.model, &mut self.sigma);
        let dc = DC * self.rule.mu().max(1e-12).powf(0.25);
        self.kkt.factor_regularised(&self.hess, &self.sigma, &self.point.jac, stiffness, dc)
    }

    /// The direction for the barrier parameter that the rule picks; in free mode from the affine step.
    fn choose_direction(&mut self) -> bool {
        if self.rule.is_free() {
            if !self.solve_direction(0.0, true) {
                return false;
            }
            let a = &self.affine;
            let steps = Steps {
                dx: &a.dx,
                dzl: &a.dzl,
                dzu: &a.dzu,
                alpha: fraction_to_boundary(&self.model, &self.point.x, &a.dx, 1.0),
                alpha_z: fraction_to_zero(&self.point.zl, &a.dzl, 1.0).min(fraction_to_zero(
                    &self.point.zu,
                    &a.dzu,
                    1.0,
                )),
            };
            let now = self.point.mean_complementarity(&self.model);
            let after = self.point.mean_complementarity_after(&self.model, &steps);
            let error = self.history.last().map_or(0.0, |h| h.optimality);
            self.rule.probe(now, after, error, self.kkt.convexified);
            self.filter.clear();
        }
        self.solve_direction(self.rule.mu(), false)
    }

    /// Solves the primal-dual system for `mu`.
    fn solve_direction(&mut self, mu: f64, affine: bool) -> bool {
        let n = self.model.n;
        self.point.lagrangian_gradient(&self.model, &mut self.work);
        for k in 0..n {
            self.rhs[k] = -(self.work[k] + barrier_slope(&self.model, &self.point.x, mu, k));
        }
        for (r, c) in self.rhs[n..].iter_mut().zip(&self.point.c) {
            *r = -c;
        }
        if !self.kkt.solve(&self.rhs, &mut self.solution) {
            return false;
        }
        let d = if affine { &mut self.affine } else { &mut self.direction };
        d.dx.copy_from_slice(&self.solution[..n]);
        d.dlambda.copy_from_slice(&self.solution[n..]);
        let (p, model) = (&self.point, &self.model);
        for k in 0..n {
            let (low, up) = (p.x[k] - model.lower[k], model.upper[k] - p.x[k]);
            // Infinite slacks with zero multipliers give zero.
            d.dzl[k] = mu / low - p.zl[k] - p.zl[k] / low * d.dx[k];
            d.dzu[k] = mu / up - p.zu[k] + p.zu[k] / up * d.dx[k];
        }
        true
    }

    pub(super) fn tau(&self) -> f64 {
        TAU_MIN.max(1.0 - self.rule.mu())
    }

    /// Ends the run.
    pub(super) fn into_outcome(self, status: Status) -> super::NlpOutcome {
        let (x, objective, violation, multipliers) = self.model.finish(&self.point.x, &self.point.lambda);
        super::NlpOutcome { x, multipliers, objective, violation, status, history: self.history }
    }
}
