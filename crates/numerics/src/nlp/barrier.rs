//! The barrier parameter: adaptive by Mehrotra's probing as long as the KKT error falls, else monotone.
//!
//! Reference: J. Nocedal, A. Waechter, R. A. Waltz, Adaptive barrier update strategies for nonlinear interior
//! methods, SIAM J. Optim. 19 (2009), 1674-1693; monotone rule: Waechter and Biegler 2006, eq. 7.

use super::iterate::Point;
use super::model::Model;

/// Sufficient progress in free mode: below this share of the worst of the last [`MEMORY`] accepted errors.
const PROGRESS: f64 = 0.9999;
const MEMORY: usize = 4;
/// Centring of the fixed mode relative to the mean complementarity.
const FIXED_SHARE: f64 = 0.8;
/// A barrier problem counts as solved at this multiple of mu; its reduction by factor and power.
const KAPPA_EPSILON: f64 = 10.0;
const KAPPA_MU: f64 = 0.2;
const THETA_MU: f64 = 1.5;
/// Least mu of the free mode relative to the KKT error; and where the Hessian had to be convexified: the affine step promises
/// too much there, and what follows is a long search along bounds that were met early.
const ERROR_SHARE: f64 = 1e-2;
const ERROR_SHARE_BENT: f64 = 1e-1;
/// Largest mu relative to the mean complementarity at the start.
const MU_MAX_FACTOR: f64 = 1e3;

#[derive(Clone, Copy, PartialEq, Eq, Debug)]
enum Mode {
    /// mu from the affine step in every iteration.
    Free,
    /// mu fixed until its barrier problem is solved.
    Fixed,
    /// No bounds: no barrier.
    None,
}

#[derive(Clone, Debug)]
pub(super) struct BarrierRule {
    mode: Mode,
    mu: f64,
    mu_min: f64,
    mu_max: f64,
    tolerance: f64,
    accepted: Vec<f64>,
    fresh: bool,
}

impl BarrierRule {
    pub(super) fn new(tolerance: f64) -> Self {
        let mu_min = (0.1 * tolerance).clamp(1e-14, 1e-9);
        Self { mode: Mode::Free, mu: 0.1, mu_min, mu_max: 1e5, tolerance, accepted: Vec::new(), fresh: true }
    }

    pub(super) fn start(&mut self, model: &Model<'_>, point: &Point) {
        let bounded = model.lower.iter().chain(&model.upper).any(|b| b.is_finite());
        if !bounded {
            (self.mode, self.mu) = (Mode::None, 0.0);
            return;
        }
        let mean = point.mean_complementarity(model);
        self.mu_max = (MU_MAX_FACTOR * mean).max(self.mu_min);
        self.mu = mean.clamp(self.mu_min, self.mu_max);
    }

    pub(super) fn mu(&self) -> f64 {
        self.mu
    }

    pub(super) fn is_free(&self) -> bool {
        self.mode == Mode::Free
    }

    /// The point moved, so that the next [`BarrierRule::update`] judges a new one.
    pub(super) fn note_progress(&mut self) {
        self.fresh = true;
    }

    /// Judges the current point; `true` when the barrier problem changed and the filter must forget.
    pub(super) fn update(&mut self, model: &Model<'_>, point: &Point, work: &mut [f64]) -> bool {
        if self.mode == Mode::None || !self.fresh {
            return false;
        }
        self.fresh = false;
        let measure = point.progress_measure(model, work);
        let worst = self.accepted.iter().fold(0.0f64, |a, b| a.max(*b));
        let progress = self.accepted.len() < MEMORY || measure <= PROGRESS * worst;
        if progress {
            self.accepted.push(measure);
            if self.accepted.len() > MEMORY {
                self.accepted.remove(0);
            }
        }
        match self.mode {
            Mode::Free if !progress => self.leave_free_mode(model, point),
            Mode::Fixed if progress => {
                self.mode = Mode::Free;
                true
            }
            Mode::Fixed => self.reduce(model, point, work),
            _ => false,
        }
    }

    /// Switches from free to fixed mode; `false` when it was not free.
    pub(super) fn leave_free_mode(&mut self, model: &Model<'_>, point: &Point) -> bool {
        if self.mode != Mode::Free {
            return false;
        }
        self.mode = Mode::Fixed;
        self.mu = (FIXED_SHARE * point.mean_complementarity(model)).clamp(self.mu_min, self.mu_max);
        true
    }

    /// Reduces mu as long as its barrier problem is already solved.
    fn reduce(&mut self, model: &Model<'_>, point: &Point, work: &mut [f64]) -> bool {
        let mut changed = false;
        while self.mu > self.mu_min
            && point.errors(model, self.mu, work).largest()
                <= KAPPA_EPSILON * self.mu.max(self.tolerance / 10.0)
        {
            self.mu = (KAPPA_MU * self.mu).min(self.mu.powf(THETA_MU)).max(self.mu_min);
            changed = true;
        }
        changed
    }

    /// Mehrotra's rule: `mu = (after / now)^3 now`, with the mean complementarity after the affine step, but not below
    /// a share of the KKT error: a barrier that falls ahead of the other conditions pins the point to its bounds. The share is
    /// larger where the Hessian was `convexified`.
    pub(super) fn probe(&mut self, now: f64, after: f64, error: f64, convexified: bool) {
        let sigma = (after / now).powi(3).clamp(0.0, 100.0);
        let share = if convexified { ERROR_SHARE_BENT } else { ERROR_SHARE };
        let least = (share * error).clamp(self.mu_min, now.max(self.mu_min));
        self.mu = (sigma * now).max(least).clamp(self.mu_min, self.mu_max);
    }
}
