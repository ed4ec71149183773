//! Projected limited-memory BFGS: few evaluations, for smooth objectives over boxes with many active bounds.
//!
//! ```text
//! F = variables that are not held at a bound by the gradient
//! d_F = -H_F g_F            two-loop recursion with the pairs (s, y) restricted to F
//! x+ = P(x + alpha d)       Armijo along the projected path
//! ```
//!
//! Reference: D. P. Bertsekas, Projected Newton methods for optimization problems with simple constraints, SIAM J.
//! Control Optim. 20 (1982), 221-246; J. Nocedal, S. J. Wright, Numerical Optimization, 2nd ed., algorithm 7.4.

use super::probe::{BudgetUsed, Probe, projected_gradient_norm};
use super::{Bounds, Budget, Objective, Optimiser, Outcome};
use crate::linalg::{axpy, dot, norm_inf};
use crate::registry::{self, Member, MemberDoc, ParamDoc};
use crate::status::Status;
use serde::Deserialize;

/// Armijo constant.
const DECREASE: f64 = 1e-4;
/// Backtracking steps before the memory is dropped, and then before the search ends.
const MOST_BACKTRACKS: usize = 25;

pub(super) const MEMBER: Member<dyn Optimiser> = Member {
    doc: MemberDoc {
        name: "quasi_newton",
        what: "Projected limited-memory BFGS; needs gradients, few evaluations",
        params: &[ParamDoc {
            name: "memory",
            unit: "-",
            default: "12",
            what: "Number of (step, gradient change) pairs kept",
        }],
    },
    build: |keys| Ok(Box::new(registry::keys::<QuasiNewton>("quasi_newton", keys)?)),
};

/// Projected limited-memory BFGS.
#[derive(Clone, Copy, Debug, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct QuasiNewton {
    /// Number of pairs kept (at least 1 is used).
    pub memory: usize,
}

impl Default for QuasiNewton {
    fn default() -> Self {
        Self { memory: 12 }
    }
}

impl Optimiser for QuasiNewton {
    fn minimise(&self, problem: &mut dyn Objective, bounds: &Bounds, x0: &[f64], budget: &Budget) -> Outcome {
        let mut probe = Probe::new(problem, bounds, x0, budget);
        let x = probe.start();
        let status = match Search::run(&mut probe, bounds, x, budget, self.memory.max(1)) {
            Ok(status) => status,
            Err(BudgetUsed) => Status::Limit,
        };
        probe.outcome(status)
    }
}

/// One (step, gradient change) pair.
struct Pair {
    s: Vec<f64>,
    y: Vec<f64>,
    rho: f64,
    weight: f64,
}

struct Search {
    x: Vec<f64>,
    g: Vec<f64>,
    f: f64,
    trial: Vec<f64>,
    trial_g: Vec<f64>,
    d: Vec<f64>,
    free: Vec<bool>,
    pairs: Vec<Pair>,
    memory: usize,
}

impl Search {
    fn run(
        probe: &mut Probe<'_>,
        bounds: &Bounds,
        x: Vec<f64>,
        budget: &Budget,
        memory: usize,
    ) -> Result<Status, BudgetUsed> {
        let n = x.len();
        let mut s = Self {
            g: vec![0.0; n],
            f: 0.0,
            trial: vec![0.0; n],
            trial_g: vec![0.0; n],
            d: vec![0.0; n],
            free: vec![true; n],
            pairs: Vec::with_capacity(memory),
            memory,
            x,
        };
        s.f = probe.value(&s.x, &mut s.g)?;
        if !s.f.is_finite() {
            return Ok(Status::Diverged);
        }
        let first_norm = projected_gradient_norm(&s.x, &s.g, bounds);
        loop {
            let norm = projected_gradient_norm(&s.x, &s.g, bounds);
            if norm <= budget.gradient_tolerance * first_norm || norm == 0.0 {
                return Ok(Status::Converged);
            }
            s.mark_free(bounds);
            s.quasi_newton_direction();
            let before = s.f;
            if !s.line_search(probe, bounds)? {
                if s.pairs.is_empty() {
                    return Ok(Status::Stalled);
                }
                s.pairs.clear();
                continue;
            }
            if before - s.f <= budget.value_tolerance * before.abs().max(s.f.abs()) && !s.pairs.is_empty() {
                return Ok(Status::Converged);
            }
        }
    }

    /// A variable is held when it stands at a bound and the gradient pushes it out.
    fn mark_free(&mut self, bounds: &Bounds) {
        for k in 0..self.x.len() {
            let held_low = self.x[k] <= bounds.lower[k] && self.g[k] > 0.0;
            let held_up = self.x[k] >= bounds.upper[k] && self.g[k] < 0.0;
            self.free[k] = !(held_low || held_up);
        }
    }

    /// `d = -H g` on the free variables, zero elsewhere.
    fn quasi_newton_direction(&mut self) {
        let free = &self.free;
        let inner = |a: &[f64], b: &[f64]| -> f64 {
            a.iter().zip(b).zip(free).map(|((x, y), f)| if *f { x * y } else { 0.0 }).sum()
        };
        for k in 0..self.d.len() {
            self.d[k] = if free[k] { -self.g[k] } else { 0.0 };
        }
        let mut gamma = None;
        for p in self.pairs.iter_mut().rev() {
            let (sy, yy) = (inner(&p.s, &p.y), inner(&p.y, &p.y));
            // Curvature may be lost by the restriction to the free variables: the pair then rests.
            p.rho = if sy > 1e-10 * yy && yy > 0.0 { 1.0 / sy } else { 0.0 };
            if p.rho > 0.0 {
                gamma.get_or_insert(sy / yy);
                p.weight = p.rho * dot(&p.s, &self.d);
                axpy(-p.weight, &p.y, &mut self.d);
                zero_held(&mut self.d, free);
            }
        }
        if let Some(gamma) = gamma {
            self.d.iter_mut().for_each(|v| *v *= gamma);
        }
        for p in self.pairs.iter().filter(|p| p.rho > 0.0) {
            let beta = p.rho * dot(&p.y, &self.d);
            axpy(p.weight - beta, &p.s, &mut self.d);
            zero_held(&mut self.d, free);
        }
        let slope = dot(&self.d, &self.g);
        if slope >= 0.0 || slope.is_nan() || gamma.is_none() {
            self.pairs.clear();
            for k in 0..self.d.len() {
                self.d[k] = if self.free[k] { -self.g[k] } else { 0.0 };
            }
        }
    }

    /// Moves along the projected path; `false` when no step decreases the objective.
    fn line_search(&mut self, probe: &mut Probe<'_>, bounds: &Bounds) -> Result<bool, BudgetUsed> {
        // Without curvature the first step changes the largest variable by a tenth of its width or size.
        let mut alpha = if self.pairs.is_empty() { self.first_length(bounds) } else { 1.0 };
        for _ in 0..MOST_BACKTRACKS {
            let mut slope = 0.0;
            for k in 0..self.x.len() {
                self.trial[k] = (self.x[k] + alpha * self.d[k]).max(bounds.lower[k]).min(bounds.upper[k]);
                slope += self.g[k] * (self.trial[k] - self.x[k]);
            }
            let f = probe.value(&self.trial, &mut self.trial_g)?;
            if f <= self.f + DECREASE * slope && slope < 0.0 {
                self.accept(f);
                return Ok(true);
            }
            let factor = if f.is_finite() && slope < 0.0 {
                // Minimiser of the parabola through value, slope and trial value.
                (-0.5 * slope / (f - self.f - slope)).clamp(0.1, 0.5)
            } else {
                0.1
            };
            alpha *= factor;
        }
        Ok(false)
    }

    fn first_length(&self, bounds: &Bounds) -> f64 {
        let reach = (0..self.x.len())
            .filter(|&k| self.d[k] != 0.0)
            .map(|k| {
                let width = bounds.upper[k] - bounds.lower[k];
                let size = if width.is_finite() { 0.1 * width } else { 0.1 * self.x[k].abs().max(1.0) };
                size / self.d[k].abs()
            })
            .fold(f64::INFINITY, f64::min);
        if reach.is_finite() { reach } else { 1.0 / norm_inf(&self.d).max(f64::MIN_POSITIVE) }
    }

    fn accept(&mut self, f: f64) {
        let n = self.x.len();
        let mut pair = if self.pairs.len() == self.memory {
            self.pairs.remove(0)
        } else {
            Pair { s: vec![0.0; n], y: vec![0.0; n], rho: 0.0, weight: 0.0 }
        };
        for k in 0..n {
            pair.s[k] = self.trial[k] - self.x[k];
            pair.y[k] = self.trial_g[k] - self.g[k];
        }
        if dot(&pair.s, &pair.y) > 1e-12 * dot(&pair.y, &pair.y) {
            self.pairs.push(pair);
        }
        std::mem::swap(&mut self.x, &mut self.trial);
        std::mem::swap(&mut self.g, &mut self.trial_g);
        self.f = f;
    }
}

fn zero_held(d: &mut [f64], free: &[bool]) {
    d.iter_mut().zip(free).filter(|(_, f)| !**f).for_each(|(v, _)| *v = 0.0);
}
