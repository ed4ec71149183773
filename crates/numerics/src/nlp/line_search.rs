//! Backtracking with the filter and second-order correction (Waechter and Biegler 2006, sections 2.3 and 2.4).

use super::filter::{Accepted, Here};
use super::ipm::Ipm;
use super::iterate::{barrier, barrier_slope, fraction_to_boundary, fraction_to_zero};

/// Most second-order corrections, and the decrease of the violation each must bring.
const CORRECTIONS: usize = 4;
const KAPPA_SOC: f64 = 0.99;
/// Steps shorter than this relative to x are taken without a test: their effect is rounding.
const TINY: f64 = 10.0 * f64::EPSILON;

/// How a line search ended.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(super) enum Moved {
    Yes,
    /// By a step of rounding size.
    Tiny,
    /// No step length is acceptable.
    No,
}

impl Moved {
    fn and_tiny(self) -> Self {
        if self == Self::Yes { Self::Tiny } else { self }
    }
}

impl Ipm<'_> {
    /// Moves along the direction.
    pub(super) fn line_search(&mut self) -> Moved {
        let (mu, tau) = (self.rule.mu(), self.tau());
        let here = self.here(mu);
        let alpha_max = fraction_to_boundary(&self.model, &self.point.x, &self.direction.dx, tau);
        let tiny =
            self.direction.dx.iter().zip(&self.point.x).all(|(d, x)| d.abs() <= TINY * (1.0 + x.abs()));
        let least = self.filter.least_step(&here);
        let mut alpha = alpha_max;
        let mut first = true;
        while first || alpha > least {
            let f = self.trial(alpha, false);
            let (theta, phi) = self.measures(f, mu);
            if tiny && theta.is_finite() && phi.is_finite() {
                return self.move_to_trial(f, alpha, &here, Accepted::Descent).and_tiny();
            }
            if let Some(kind) = self.filter.test(&here, alpha, theta, phi) {
                return self.move_to_trial(f, alpha, &here, kind);
            }
            let worse = first && theta.is_finite() && theta >= here.theta && self.model.m > 0;
            if worse && let Some((f, kind)) = self.correct(alpha, mu, tau, &here, theta) {
                return self.move_to_trial(f, alpha, &here, kind);
            }
            first = false;
            alpha *= 0.5;
            if alpha < 1e-14 {
                break;
            }
        }
        // Rule out this point for the restoration that follows.
        self.filter.add(here.theta, here.phi);
        Moved::No
    }

    fn here(&self, mu: f64) -> Here {
        let slope = (0..self.model.n)
            .map(|k| {
                (self.point.grad[k] + barrier_slope(&self.model, &self.point.x, mu, k)) * self.direction.dx[k]
            })
            .sum();
        Here { theta: self.theta(), phi: barrier(&self.model, &self.point.x, self.point.f, mu), slope }
    }

    /// Trial point into `trial_x`, constraints into `trial_c`; returns the objective.
    fn trial(&mut self, alpha: f64, corrected: bool) -> f64 {
        let dx = if corrected { &self.soc_dx } else { &self.direction.dx };
        for ((t, x), d) in self.trial_x.iter_mut().zip(&self.point.x).zip(dx) {
            *t = x + alpha * d;
        }
        self.model.constraints(&self.trial_x, &mut self.trial_c);
        self.model.objective(&self.trial_x)
    }

    /// (violation, barrier value) of the trial point.
    fn measures(&self, f: f64, mu: f64) -> (f64, f64) {
        (self.trial_c.iter().map(|c| c.abs()).sum(), barrier(&self.model, &self.trial_x, f, mu))
    }

    /// Second-order corrections of a full step that made the violation worse.
    fn correct(&mut self, alpha: f64, mu: f64, tau: f64, here: &Here, theta: f64) -> Option<(f64, Accepted)> {
        let n = self.model.n;
        let mut last = theta;
        for ((s, c), t) in self.soc_c.iter_mut().zip(&self.point.c).zip(&self.trial_c) {
            *s = alpha * c + t;
        }
        self.point.lagrangian_gradient(&self.model, &mut self.work);
        for _ in 0..CORRECTIONS {
            for k in 0..n {
                self.rhs[k] = -(self.work[k] + barrier_slope(&self.model, &self.point.x, mu, k));
            }
            for (r, c) in self.rhs[n..].iter_mut().zip(&self.soc_c) {
                *r = -c;
            }
            if !self.kkt.solve(&self.rhs, &mut self.solution) {
                return None;
            }
            self.soc_dx.copy_from_slice(&self.solution[..n]);
            let length = fraction_to_boundary(&self.model, &self.point.x, &self.soc_dx, tau);
            let f = self.trial(length, true);
            let (theta, phi) = self.measures(f, mu);
            if let Some(kind) = self.filter.test(here, alpha, theta, phi) {
                return Some((f, kind));
            }
            if theta > KAPPA_SOC * last || theta.is_nan() {
                return None;
            }
            last = theta;
            for (s, t) in self.soc_c.iter_mut().zip(&self.trial_c) {
                *s = length * *s + t;
            }
        }
        None
    }

    /// Makes the trial point the current one; `No` (point unchanged) when its derivatives are not finite.
    fn move_to_trial(&mut self, f: f64, alpha: f64, here: &Here, kind: Accepted) -> Moved {
        let tau = self.tau();
        std::mem::swap(&mut self.point.x, &mut self.trial_x);
        if !self.point.differentiate(&mut self.model) {
            std::mem::swap(&mut self.point.x, &mut self.trial_x);
            self.point.differentiate(&mut self.model);
            return Moved::No;
        }
        if kind == Accepted::Either {
            self.filter.add(here.theta, here.phi);
        }
        std::mem::swap(&mut self.point.c, &mut self.trial_c);
        self.point.f = f;
        let d = &self.direction;
        let alpha_z =
            fraction_to_zero(&self.point.zl, &d.dzl, tau).min(fraction_to_zero(&self.point.zu, &d.dzu, tau));
        for (l, s) in self.point.lambda.iter_mut().zip(&d.dlambda) {
            *l += alpha * s;
        }
        for k in 0..self.model.n {
            self.point.zl[k] += alpha_z * d.dzl[k];
            self.point.zu[k] += alpha_z * d.dzu[k];
        }
        self.point.safeguard_multipliers(&self.model, self.rule.mu());
        Moved::Yes
    }
}
