//! Levenberg-Marquardt for nonlinear least squares with exact Jacobians.
//!
//! ```text
//! minimise |r(x)|^2;   step:  min |J p + r|^2   subject to   |D p| <= delta
//!                      (J'J + mu D^2) p = -J'r,   mu >= 0 from the secular equation |D p(mu)| = delta
//! ```
//!
//! D holds the largest column norms of J met so far, which makes the method independent of the units of the
//! variables. The trust radius, not mu, is what is adapted: a good start then takes the full Gauss-Newton step at once.
//!
//! Reference: J. J. More, The Levenberg-Marquardt algorithm: implementation and theory, LNM 630 (1978), 105-116.

mod step;

use crate::linalg::{axpy, dot};
use crate::status::{Iterate, Status};
use step::{Model, StepSolver};

/// A nonlinear least-squares problem: minimise `|r(x)|^2`.
///
/// A long record need not store its Jacobian: where [`LeastSquares::by_blocks`] holds, only J'J and J'r are kept.
pub trait LeastSquares {
    /// Number of variables n.
    fn n(&self) -> usize;
    /// Number of residuals.
    fn residuals(&self) -> usize;
    /// Residuals at `x`; `false` when they are not finite (an unstable trial is a bad trial, not an end).
    fn residual(&mut self, x: &[f64], r: &mut [f64]) -> bool;
    /// Residuals and their Jacobian (row-major, residuals x n) at `x`.
    fn residual_jacobian(&mut self, x: &[f64], r: &mut [f64], jac: &mut [f64]) -> bool;
    /// Whether the Jacobian is taken by [`LeastSquares::jacobian_blocks`] and never stored whole.
    fn by_blocks(&self) -> bool {
        false
    }
    /// Gives residuals and Jacobian at `x` in blocks of some rows each, `take(r, jac)`; rows of zeros may be left out.
    /// `false` when something is not finite.
    fn jacobian_blocks(&mut self, x: &[f64], take: &mut dyn FnMut(&[f64], &[f64])) -> bool {
        let (mut r, mut jac) = (vec![0.0; self.residuals()], vec![0.0; self.residuals() * self.n()]);
        let finite = self.residual_jacobian(x, &mut r, &mut jac);
        take(&r, &jac);
        finite
    }
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
    /// First trust radius in units of |D x0| (of 1 when x0 = 0). Large values trust the first Gauss-Newton step.
    pub initial_radius: f64,
    /// Least damping mu, relative to the squared column scale. From 1e-12 on the step always comes from J'J, never from
    /// a QR factorisation: right for models with many parameters of which only the output counts.
    pub least_damping: f64,
}

impl Default for LmOptions {
    fn default() -> Self {
        Self {
            max_evaluations: 200,
            cost_tolerance: 1e-12,
            gradient_tolerance: 1e-10,
            initial_radius: 100.0,
            least_damping: 0.0,
        }
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
    /// Points at which the residuals were evaluated, the start included.
    pub evaluations: usize,
    /// Points at which the Jacobian was evaluated (each is one of the points above).
    pub jacobians: usize,
    /// One entry per accepted step, the start included.
    pub history: Vec<Iterate>,
}

/// Minimises `|r(x)|^2` from `x0`.
///
/// A trial with non-finite residuals shrinks the trust region. The search ends as
/// - `Converged`: scaled gradient or relative decrease (actual and predicted) within tolerance, or zero residual,
/// - `Stalled`: the trust region has shrunk to rounding level,
/// - `Limit`: `max_evaluations` are used up,
/// - `Diverged`: the residuals or the Jacobian are not finite at the start (then `cost` is infinite and `x` is `x0`).
///
/// ```
/// use dynocal_numerics::lm::{LeastSquares, LmOptions, levenberg_marquardt};
/// struct Rosenbrock;
/// impl LeastSquares for Rosenbrock {
///     fn n(&self) -> usize { 2 }
///     fn residuals(&self) -> usize { 2 }
///     fn residual(&mut self, x: &[f64], r: &mut [f64]) -> bool {
///         r[0] = 10.0 * (x[1] - x[0] * x[0]);
///         r[1] = 1.0 - x[0];
///         r.iter().all(|v| v.is_finite())
///     }
///     fn residual_jacobian(&mut self, x: &[f64], r: &mut [f64], jac: &mut [f64]) -> bool {
///         jac.copy_from_slice(&[-20.0 * x[0], 10.0, -1.0, 0.0]);
///         self.residual(x, r)
///     }
/// }
/// let found = levenberg_marquardt(&mut Rosenbrock, &[-1.2, 1.0], &LmOptions::default());
/// assert!(found.status.is_success() && found.cost < 1e-20);
/// ```
pub fn levenberg_marquardt(problem: &mut dyn LeastSquares, x0: &[f64], options: &LmOptions) -> LmOutcome {
    levenberg_marquardt_interruptible(problem, x0, options, &|| false)
}

/// [`levenberg_marquardt`] that asks `interrupt` once per trial and then ends as `Interrupted` with the best point.
pub fn levenberg_marquardt_interruptible(
    problem: &mut dyn LeastSquares,
    x0: &[f64],
    options: &LmOptions,
    interrupt: &dyn Fn() -> bool,
) -> LmOutcome {
    let mut search = Search::new(problem, x0, options);
    if !search.linearise() {
        return search.finish(Status::Diverged);
    }
    search.first_radius();
    loop {
        if let Some(status) = search.at_linearised_point() {
            return search.finish(status);
        }
        // Trials from one Jacobian until one is good enough to move to.
        loop {
            if interrupt() {
                return search.finish(Status::Interrupted);
            }
            match search.trial() {
                Trial::Accepted => break,
                Trial::Rejected => {}
                Trial::End(status) => return search.finish(status),
            }
        }
    }
}

/// What became of a trial step.
enum Trial {
    Accepted,
    Rejected,
    End(Status),
}

/// State of one search; all buffers are allocated here.
struct Search<'a> {
    problem: &'a mut dyn LeastSquares,
    options: LmOptions,
    x: Vec<f64>,
    r: Vec<f64>,
    /// Empty when the problem comes by blocks.
    jac: Vec<f64>,
    by_blocks: bool,
    gradient: Vec<f64>,
    column_norm: Vec<f64>,
    scale: Vec<f64>,
    step: Vec<f64>,
    trial_x: Vec<f64>,
    trial_r: Vec<f64>,
    steps: StepSolver,
    cost: f64,
    radius: f64,
    optimality: f64,
    evaluations: usize,
    jacobians: usize,
    /// The last accepted step met the decrease tolerance: end at the next test.
    decrease_met: bool,
    history: Vec<Iterate>,
}

impl<'a> Search<'a> {
    fn new(problem: &'a mut dyn LeastSquares, x0: &[f64], options: &LmOptions) -> Self {
        let (n, m, by_blocks) = (problem.n(), problem.residuals(), problem.by_blocks());
        assert_eq!(x0.len(), n, "the start point must have one entry per variable");
        Self {
            problem,
            options: *options,
            x: x0.to_vec(),
            r: vec![0.0; m],
            jac: if by_blocks { Vec::new() } else { vec![0.0; m * n] },
            by_blocks,
            gradient: vec![0.0; n],
            column_norm: vec![0.0; n],
            scale: vec![0.0; n],
            step: vec![0.0; n],
            trial_x: vec![0.0; n],
            trial_r: vec![0.0; m],
            steps: StepSolver::new(m, n, options.least_damping, by_blocks),
            cost: f64::INFINITY,
            radius: 0.0,
            optimality: f64::INFINITY,
            evaluations: 1,
            jacobians: 0,
            decrease_met: false,
            history: Vec::new(),
        }
    }

    /// Residuals and Jacobian at `x`; Gram matrix, gradient, column norms, scale and optimality from them.
    fn linearise(&mut self) -> bool {
        self.gradient.fill(0.0);
        self.jacobians += 1;
        let (ok, cost) = if self.by_blocks { self.gather_blocks() } else { self.gather_whole() };
        if !ok || !cost.is_finite() {
            return false;
        }
        let n = self.x.len();
        for (k, c) in self.column_norm.iter_mut().enumerate() {
            *c = self.steps.square_of_column(k);
        }
        let finite = |v: &[f64]| v.iter().all(|a| a.is_finite());
        if !finite(&self.gradient) || !finite(&self.column_norm) {
            return false;
        }
        self.cost = cost;
        self.column_norm.iter_mut().for_each(|c| *c = c.sqrt());
        for (d, c) in self.scale.iter_mut().zip(&self.column_norm) {
            // The scale never falls (More 1978, section 6).
            *d = d.max(*c);
        }
        let norm = self.cost.sqrt();
        self.optimality = (0..n)
            .filter(|&k| self.column_norm[k] > 0.0 && norm > 0.0)
            .map(|k| self.gradient[k].abs() / (self.column_norm[k] * norm))
            .fold(0.0, f64::max);
        self.steps.scale_gram(&self.scale);
        self.history.push(Iterate {
            evaluations: self.evaluations,
            objective: self.cost,
            violation: 0.0,
            optimality: self.optimality,
        });
        true
    }

    fn gather_whole(&mut self) -> (bool, f64) {
        let ok = self.problem.residual_jacobian(&self.x, &mut self.r, &mut self.jac);
        let cost = dot(&self.r, &self.r);
        if ok && cost.is_finite() {
            self.steps.clear_gram();
            self.steps.add_rows(&self.jac);
            add_gradient(&self.r, &self.jac, &mut self.gradient);
        }
        (ok, cost)
    }

    fn gather_blocks(&mut self) -> (bool, f64) {
        let (steps, gradient, mut cost) = (&mut self.steps, &mut self.gradient, 0.0);
        steps.clear_gram();
        let ok = self.problem.jacobian_blocks(&self.x, &mut |r, jac| {
            steps.add_rows(jac);
            add_gradient(r, jac, gradient);
            cost += dot(r, r);
        });
        (ok, cost)
    }

    fn first_radius(&mut self) {
        let size = self.scaled_norm(false);
        self.radius = self.options.initial_radius * if size > 0.0 { size } else { 1.0 };
    }

    /// |D x|, or |D p|.
    fn scaled_norm(&self, of_step: bool) -> f64 {
        let v = if of_step { &self.step } else { &self.x };
        v.iter().zip(&self.scale).map(|(a, d)| (a * effective(*d)).powi(2)).sum::<f64>().sqrt()
    }

    /// Tests at a point with a fresh Jacobian.
    fn at_linearised_point(&self) -> Option<Status> {
        if self.optimality <= self.options.gradient_tolerance || self.decrease_met {
            return Some(Status::Converged);
        }
        (self.evaluations >= self.options.max_evaluations).then_some(Status::Limit)
    }

    fn trial(&mut self) -> Trial {
        if self.evaluations >= self.options.max_evaluations {
            return Trial::End(Status::Limit);
        }
        let model = Model { jac: &self.jac, r: &self.r, gradient: &self.gradient, scale: &self.scale };
        let mu = self.steps.step(&model, self.radius, &mut self.step);
        let length = self.scaled_norm(true);
        if self.history.len() == 1 {
            // The first radius is only a guess: it must not exceed the first step.
            self.radius = self.radius.min(length);
        }
        // Predicted relative decrease and slope, both in units of the cost (More 1978, eq. 4.4).
        let (linear, damped) = self.predicted(mu);
        let predicted = linear + 2.0 * damped;
        let slope = -(linear + damped);
        for ((t, x), p) in self.trial_x.iter_mut().zip(&self.x).zip(&self.step) {
            *t = x + p;
        }
        self.evaluations += 1;
        let finite = self.problem.residual(&self.trial_x, &mut self.trial_r);
        let trial_cost = if finite { dot(&self.trial_r, &self.trial_r) } else { f64::INFINITY };
        let actual = if trial_cost < 100.0 * self.cost { 1.0 - trial_cost / self.cost } else { -1.0 };
        let ratio = if predicted > 0.0 { actual / predicted } else { 0.0 };
        self.adapt_radius(ratio, actual, slope, mu, length);
        let small = actual.abs() <= self.options.cost_tolerance
            && predicted <= self.options.cost_tolerance
            && ratio <= 2.0;
        if ratio > 1e-4 && self.accept(trial_cost) {
            self.decrease_met = small;
            return Trial::Accepted;
        }
        let size = self.scaled_norm(false);
        if small || predicted <= f64::EPSILON {
            return Trial::End(Status::Converged);
        }
        if self.radius <= f64::EPSILON * size || self.radius < f64::MIN_POSITIVE {
            return Trial::End(Status::Stalled);
        }
        Trial::Rejected
    }

    /// (|J p|^2, mu |D p|^2) relative to the cost.
    fn predicted(&mut self, mu: f64) -> (f64, f64) {
        let n = self.x.len();
        let damped = mu * self.scaled_norm(true).powi(2);
        let linear: f64 = if self.by_blocks {
            // (J'J + mu D^2) p = -J'r.
            (-dot(&self.gradient, &self.step) - damped).max(0.0)
        } else {
            self.jac.chunks_exact(n.max(1)).map(|row| dot(row, &self.step).powi(2)).sum()
        };
        (linear / self.cost, damped / self.cost)
    }

    fn adapt_radius(&mut self, ratio: f64, actual: f64, slope: f64, mu: f64, length: f64) {
        if ratio <= 0.25 {
            // Minimiser of the parabola through value, slope and trial value, kept in [0.1, 0.5].
            let factor = if actual >= 0.0 { 0.5 } else { 0.5 * slope / (slope + 0.5 * actual) };
            self.radius = factor.clamp(0.1, 0.5) * self.radius.min(10.0 * length);
        } else if mu == 0.0 || ratio >= 0.75 {
            self.radius = 2.0 * length;
        }
    }

    /// Moves to the trial point; `false` (and the old point restored) when the Jacobian is not finite there.
    fn accept(&mut self, trial_cost: f64) -> bool {
        let old_cost = self.cost;
        std::mem::swap(&mut self.x, &mut self.trial_x);
        std::mem::swap(&mut self.r, &mut self.trial_r);
        self.cost = trial_cost;
        if self.linearise() {
            return true;
        }
        std::mem::swap(&mut self.x, &mut self.trial_x);
        std::mem::swap(&mut self.r, &mut self.trial_r);
        self.cost = old_cost;
        self.radius *= 0.25;
        // The buffers were overwritten: linearise again at the old point, where all was finite.
        if self.linearise() {
            self.history.pop();
        }
        false
    }

    fn finish(self, status: Status) -> LmOutcome {
        let status = if self.cost == 0.0 { Status::Converged } else { status };
        LmOutcome {
            x: self.x,
            cost: self.cost,
            status,
            evaluations: self.evaluations,
            jacobians: self.jacobians,
            history: self.history,
        }
    }
}

/// `gradient += J' r` for some rows.
fn add_gradient(r: &[f64], jac: &[f64], gradient: &mut [f64]) {
    for (row, ri) in jac.chunks_exact(gradient.len().max(1)).zip(r) {
        axpy(*ri, row, gradient);
    }
}

/// Scale that is used for a variable: one while its column has always been zero.
fn effective(d: f64) -> f64 {
    if d > 0.0 { d } else { 1.0 }
}
