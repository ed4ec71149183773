//! Feasibility restoration: damped Gauss-Newton on the violation inside of the bounds.
//!
//! ```text
//! minimise |c(x)|^2 / 2 - nu sum log(slacks)
//! step:  min |c + J d|^2 / 2 + gradient of the barrier ' d + d'(S + zeta I) d / 2,   S = nu / slack^2
//! ```
//!
//! The step comes from the quasi-definite system `[S + zeta I, J'; J, -I]`, which has the structure of the KKT
//! matrix and never is singular. When the violation stops falling at a positive value and the projected gradient of
//! `|c|^2 / 2` is small there, the problem is locally infeasible.

use super::ipm::Ipm;
use super::iterate::{barrier, barrier_slope, fraction_to_boundary};
use crate::linalg::dot;
use crate::status::Status;

/// Most restoration steps in one call.
const MOST_STEPS: usize = 200;
/// Restoration steps of a whole search, in [`NlpOptions::max_iterations`](super::NlpOptions).
const BUDGET: usize = 5;
/// Violation, relative to that at the call, at which the filter search may go on.
const ENOUGH: f64 = 0.9;
/// Projected gradient of |c|^2 / 2 relative to |c| below which a positive violation is a stationary one.
const STATIONARY: f64 = 1e-6;

/// Decay of the barrier parameter nu per step.
const NU_DECAY: f64 = 0.3;

pub(super) enum Ended {
    /// A point with a smaller violation that the filter allows.
    Restored,
    With(Status),
}

/// Restores feasibility from the current point and moves there. All restorations of a search together take at most
/// [`BUDGET`] times [`NlpOptions::max_iterations`](super::NlpOptions) steps.
pub(super) fn restore(ipm: &mut Ipm<'_>, interrupt: &dyn Fn() -> bool) -> Ended {
    let mu = ipm.rule.mu();
    let theta_start = ipm.theta();
    let mut nu = (1e-2 * half_square(&ipm.point.c) / ipm.model.n.max(1) as f64).max(1e-20);
    let mut zeta = 1e-4;
    for _ in 0..MOST_STEPS {
        if interrupt() {
            return Ended::With(Status::Interrupted);
        }
        // A search that does little but restore has a budget, too.
        ipm.restored += 1;
        if ipm.restored > BUDGET * ipm.options.max_iterations {
            return Ended::With(Status::Limit);
        }
        if stationary(ipm) {
            return Ended::With(if ipm.theta() > ipm.options.tolerance {
                Status::Infeasible
            } else {
                Status::Stalled
            });
        }
        if !step(ipm, nu, &mut zeta) {
            if nu <= 1e-20 || zeta > 1e20 && nu < 1e-14 * half_square(&ipm.point.c) {
                return Ended::With(Status::Stalled);
            }
            (nu, zeta) = (1e-3 * nu, 1e-4);
            continue;
        }
        nu = (NU_DECAY * nu).min(1e-2 * half_square(&ipm.point.c) / ipm.model.n.max(1) as f64).max(1e-20);
        let theta = ipm.theta();
        let phi = barrier(&ipm.model, &ipm.point.x, ipm.point.f, mu);
        if theta <= ENOUGH * theta_start && ipm.filter.allows(theta, phi) {
            resume(ipm, mu);
            return Ended::Restored;
        }
        if theta <= 1e-2 * ipm.options.tolerance {
            ipm.filter.clear();
            resume(ipm, mu);
            return Ended::Restored;
        }
    }
    Ended::With(Status::Stalled)
}

/// Multipliers for the restored point.
fn resume(ipm: &mut Ipm<'_>, mu: f64) {
    let floor = mu.max(1e-12);
    for k in 0..ipm.model.n {
        let p = &mut ipm.point;
        for (z, slack) in
            [(&mut p.zl[k], p.x[k] - ipm.model.lower[k]), (&mut p.zu[k], ipm.model.upper[k] - p.x[k])]
        {
            if slack.is_finite() {
                *z = floor / slack;
            }
        }
    }
    ipm.start_multipliers();
    ipm.rule.note_progress();
}

fn half_square(c: &[f64]) -> f64 {
    0.5 * dot(c, c)
}

/// Whether the projected gradient `J'c` is small relative to |c|.
fn stationary(ipm: &mut Ipm<'_>) -> bool {
    let p = &ipm.point;
    let g = &mut ipm.work;
    g.fill(0.0);
    for (&(i, j), v) in ipm.model.jac_at.iter().zip(&p.jac) {
        g[j] += v * p.c[i];
    }
    let size = dot(&p.c, &p.c).sqrt();
    let mut largest = 0.0f64;
    for k in 0..ipm.model.n {
        // A gradient that pushes against a bound counts by the room that is left before it.
        let room = if g[k] > 0.0 { p.x[k] - ipm.model.lower[k] } else { ipm.model.upper[k] - p.x[k] };
        largest = largest.max(g[k].abs() * room.min(1.0));
    }
    largest <= STATIONARY * size
}

/// One accepted damped Gauss-Newton step; `false` when no damping gives a decrease.
fn step(ipm: &mut Ipm<'_>, nu: f64, zeta: &mut f64) -> bool {
    let n = ipm.model.n;
    let before = barrier(&ipm.model, &ipm.point.x, half_square(&ipm.point.c), nu);
    while *zeta <= 1e20 {
        for k in 0..n {
            let (low, up) = (ipm.point.x[k] - ipm.model.lower[k], ipm.model.upper[k] - ipm.point.x[k]);
            ipm.sigma[k] = *zeta + nu / (low * low) + nu / (up * up);
            ipm.rhs[k] = -barrier_slope(&ipm.model, &ipm.point.x, nu, k);
        }
        for (r, c) in ipm.rhs[n..].iter_mut().zip(&ipm.point.c) {
            *r = -c;
        }
        let solved = ipm.kkt.factor_quasidefinite(&ipm.sigma, &ipm.point.jac, 1.0)
            && ipm.kkt.solve(&ipm.rhs, &mut ipm.solution);
        if solved && try_move(ipm, nu, before) {
            *zeta = (0.2 * *zeta).max(1e-12);
            return true;
        }
        *zeta = (10.0 * *zeta).max(1e-8);
    }
    *zeta = 1e30;
    false
}

/// Moves along `solution` when the barrier value of the violation falls by a share of its model decrease.
fn try_move(ipm: &mut Ipm<'_>, nu: f64, before: f64) -> bool {
    let n = ipm.model.n;
    let dx = &ipm.solution[..n];
    let alpha = fraction_to_boundary(&ipm.model, &ipm.point.x, dx, 0.99);
    let mut slope = 0.0;
    for k in 0..n {
        slope += barrier_slope(&ipm.model, &ipm.point.x, nu, k) * dx[k];
        ipm.trial_x[k] = ipm.point.x[k] + alpha * dx[k];
    }
    for (&(i, j), v) in ipm.model.jac_at.iter().zip(&ipm.point.jac) {
        slope += ipm.point.c[i] * v * dx[j];
    }
    ipm.model.constraints(&ipm.trial_x, &mut ipm.trial_c);
    let f = ipm.model.objective(&ipm.trial_x);
    let after = barrier(&ipm.model, &ipm.trial_x, half_square(&ipm.trial_c), nu);
    if !(f.is_finite() && slope < 0.0 && after <= before + 1e-4 * alpha * slope) {
        return false;
    }
    std::mem::swap(&mut ipm.point.x, &mut ipm.trial_x);
    if !ipm.point.differentiate(&mut ipm.model) {
        std::mem::swap(&mut ipm.point.x, &mut ipm.trial_x);
        ipm.point.differentiate(&mut ipm.model);
        return false;
    }
    std::mem::swap(&mut ipm.point.c, &mut ipm.trial_c);
    ipm.point.f = f;
    true
}
