//! The primal-dual point and the quantities of the barrier problem there.

use super::model::Model;
use crate::linalg::norm_inf;

/// Multiplier size above which the KKT error is scaled down (s_max of Waechter and Biegler 2006, eq. 6).
const MULTIPLIER_REFERENCE: f64 = 100.0;
/// Bound multipliers stay within this factor of mu / slack (eq. 16).
const KAPPA_SIGMA: f64 = 1e10;
/// The start is moved into the box by this share of the bound or of the box width.
const BOUND_PUSH: f64 = 1e-2;
/// The same for a start that is nearly optimal.
const WARM_PUSH: f64 = 1e-5;

/// A point and the function values there (all in the scaled problem).
pub(super) struct Point {
    pub(super) x: Vec<f64>,
    pub(super) lambda: Vec<f64>,
    /// Multipliers of the lower and upper bounds; zero where there is none.
    pub(super) zl: Vec<f64>,
    pub(super) zu: Vec<f64>,
    pub(super) f: f64,
    pub(super) c: Vec<f64>,
    pub(super) grad: Vec<f64>,
    pub(super) jac: Vec<f64>,
}

/// Parts of the KKT error.
#[derive(Clone, Copy, Debug)]
pub(super) struct Errors {
    pub(super) dual: f64,
    pub(super) primal: f64,
    pub(super) complementarity: f64,
}

impl Errors {
    pub(super) fn largest(&self) -> f64 {
        let worst = self.dual.max(self.primal).max(self.complementarity);
        if self.dual.is_nan() || self.primal.is_nan() || self.complementarity.is_nan() {
            f64::NAN
        } else {
            worst
        }
    }
}

impl Point {
    pub(super) fn new(model: &Model<'_>, warm_barrier: Option<f64>) -> Self {
        let (n, m) = (model.n, model.m);
        let mut x = vec![0.0; n];
        model.start(&mut x);
        let push = if warm_barrier.is_some() { WARM_PUSH } else { BOUND_PUSH };
        for k in 0..n {
            x[k] = inside(x[k], model.lower[k], model.upper[k], push);
        }
        // On the central path of the barrier parameter, else 1 (section 3.6).
        let mu = warm_barrier.map(|mu| mu * model.objective_scale);
        let start = |slack: f64| if slack.is_finite() { mu.map_or(1.0, |mu| mu / slack) } else { 0.0 };
        Self {
            zl: x.iter().zip(&model.lower).map(|(x, b)| start(x - b)).collect(),
            zu: x.iter().zip(&model.upper).map(|(x, b)| start(b - x)).collect(),
            x,
            lambda: vec![0.0; m],
            f: f64::NAN,
            c: vec![0.0; m],
            grad: vec![0.0; n],
            jac: vec![0.0; model.jac_at.len()],
        }
    }

    /// Values (f, c) and derivatives at `x`; `false` when one is not finite.
    pub(super) fn evaluate(&mut self, model: &mut Model<'_>) -> bool {
        self.f = model.objective(&self.x);
        model.constraints(&self.x, &mut self.c);
        self.differentiate(model) && self.f.is_finite() && self.c.iter().all(|v| v.is_finite())
    }

    pub(super) fn differentiate(&mut self, model: &mut Model<'_>) -> bool {
        model.gradient(&self.x, &mut self.grad);
        model.jacobian(&self.x, &mut self.jac);
        self.grad.iter().chain(&self.jac).all(|v| v.is_finite())
    }

    /// `grad f + J' lambda` into `out`.
    pub(super) fn lagrangian_gradient(&self, model: &Model<'_>, out: &mut [f64]) {
        out.copy_from_slice(&self.grad);
        for (&(i, j), v) in model.jac_at.iter().zip(&self.jac) {
            out[j] += v * self.lambda[i];
        }
    }

    /// Scaled KKT error of the barrier problem `mu` (eq. 5); `work` has n entries.
    pub(super) fn errors(&self, model: &Model<'_>, mu: f64, work: &mut [f64]) -> Errors {
        self.lagrangian_gradient(model, work);
        let mut complementarity = 0.0f64;
        let (mut bounds, mut sum_z) = (0usize, 0.0);
        for k in 0..model.n {
            work[k] += self.zu[k] - self.zl[k];
            for (z, slack) in
                [(self.zl[k], self.x[k] - model.lower[k]), (self.zu[k], model.upper[k] - self.x[k])]
            {
                if slack.is_finite() {
                    complementarity = complementarity.max((slack * z - mu).abs());
                    sum_z += z;
                    bounds += 1;
                }
            }
        }
        let sum_lambda: f64 = self.lambda.iter().map(|l| l.abs()).sum();
        let scale = |sum: f64, count: usize| {
            (sum / count.max(1) as f64).max(MULTIPLIER_REFERENCE) / MULTIPLIER_REFERENCE
        };
        Errors {
            dual: norm_inf(work) / scale(sum_lambda + sum_z, model.m + bounds),
            primal: norm_inf(&self.c),
            complementarity: complementarity / scale(sum_z, bounds),
        }
    }

    /// Mean square KKT error, the progress measure of the adaptive barrier rule.
    pub(super) fn progress_measure(&self, model: &Model<'_>, work: &mut [f64]) -> f64 {
        self.lagrangian_gradient(model, work);
        let (mut dual, mut complementarity, mut bounds) = (0.0, 0.0, 0usize);
        for k in 0..model.n {
            dual += (work[k] + self.zu[k] - self.zl[k]).powi(2);
            for (z, slack) in
                [(self.zl[k], self.x[k] - model.lower[k]), (self.zu[k], model.upper[k] - self.x[k])]
            {
                if slack.is_finite() {
                    complementarity += (slack * z).powi(2);
                    bounds += 1;
                }
            }
        }
        let primal: f64 = self.c.iter().map(|c| c * c).sum();
        dual / model.n.max(1) as f64 + primal / model.m.max(1) as f64 + complementarity / bounds.max(1) as f64
    }

    /// Mean of slack times multiplier over all bounds; zero without bounds.
    pub(super) fn mean_complementarity(&self, model: &Model<'_>) -> f64 {
        let none = Steps { dx: &[], dzl: &[], dzu: &[], alpha: 0.0, alpha_z: 0.0 };
        self.mean_complementarity_after(model, &none)
    }

    /// The same after a step.
    pub(super) fn mean_complementarity_after(&self, model: &Model<'_>, s: &Steps<'_>) -> f64 {
        let (mut sum, mut count) = (0.0, 0usize);
        let at = |v: &[f64], k: usize| v.get(k).copied().unwrap_or(0.0);
        for k in 0..model.n {
            let x = self.x[k] + s.alpha * at(s.dx, k);
            if model.lower[k].is_finite() {
                sum += (x - model.lower[k]) * (self.zl[k] + s.alpha_z * at(s.dzl, k));
                count += 1;
            }
            if model.upper[k].is_finite() {
                sum += (model.upper[k] - x) * (self.zu[k] + s.alpha_z * at(s.dzu, k));
                count += 1;
            }
        }
        sum / count.max(1) as f64
    }

    /// Bound terms of the KKT matrix, `z / slack`.
    pub(super) fn sigma(&self, model: &Model<'_>, sigma: &mut [f64]) {
        for k in 0..model.n {
            // Infinite slacks give zero.
            sigma[k] = self.zl[k] / (self.x[k] - model.lower[k]) + self.zu[k] / (model.upper[k] - self.x[k]);
        }
    }

    /// Keeps the bound multipliers within reach of `mu / slack`, so that sigma stays a sensible barrier Hessian.
    pub(super) fn safeguard_multipliers(&mut self, model: &Model<'_>, mu: f64) {
        for k in 0..model.n {
            for (z, slack) in
                [(&mut self.zl[k], self.x[k] - model.lower[k]), (&mut self.zu[k], model.upper[k] - self.x[k])]
            {
                if slack.is_finite() {
                    *z = z.max(mu / (KAPPA_SIGMA * slack)).min(KAPPA_SIGMA * mu / slack);
                }
            }
        }
    }
}

/// A primal-dual step with its two lengths.
pub(super) struct Steps<'a> {
    pub(super) dx: &'a [f64],
    pub(super) dzl: &'a [f64],
    pub(super) dzu: &'a [f64],
    pub(super) alpha: f64,
    pub(super) alpha_z: f64,
}

/// Barrier function `f - mu sum log(slacks)` for a given f; infinite outside of the box.
pub(super) fn barrier(model: &Model<'_>, x: &[f64], f: f64, mu: f64) -> f64 {
    let mut sum = 0.0;
    for k in 0..model.n {
        for slack in [x[k] - model.lower[k], model.upper[k] - x[k]] {
            if slack <= 0.0 {
                return f64::INFINITY;
            }
            if slack.is_finite() {
                sum += slack.ln();
            }
        }
    }
    f - mu * sum
}

/// Derivative of the barrier terms, `-mu / (x - l) + mu / (u - x)`.
pub(super) fn barrier_slope(model: &Model<'_>, x: &[f64], mu: f64, k: usize) -> f64 {
    mu / (model.upper[k] - x[k]) - mu / (x[k] - model.lower[k])
}

/// Largest step in (0, 1] that keeps `1 - tau` of every slack.
pub(super) fn fraction_to_boundary(model: &Model<'_>, x: &[f64], dx: &[f64], tau: f64) -> f64 {
    let mut alpha = 1.0f64;
    for k in 0..model.n {
        if dx[k] < 0.0 && model.lower[k].is_finite() {
            alpha = alpha.min(tau * (x[k] - model.lower[k]) / -dx[k]);
        } else if dx[k] > 0.0 && model.upper[k].is_finite() {
            alpha = alpha.min(tau * (model.upper[k] - x[k]) / dx[k]);
        }
    }
    alpha
}

/// The same for multipliers, which stay positive.
pub(super) fn fraction_to_zero(z: &[f64], dz: &[f64], tau: f64) -> f64 {
    z.iter().zip(dz).filter(|(_, d)| **d < 0.0).map(|(z, d)| tau * z / -d).fold(1.0, f64::min)
}

/// A start strictly inside of the bounds (section 3.6).
fn inside(x: f64, lower: f64, upper: f64, push: f64) -> f64 {
    let width = upper - lower;
    let from_low = lower + (push * lower.abs().max(1.0)).min(push * width);
    let from_up = upper - (push * upper.abs().max(1.0)).min(push * width);
    let x = if lower.is_finite() { x.max(from_low) } else { x };
    if upper.is_finite() { x.min(from_up) } else { x }
}
