//! Projected limited-memory quasi-Newton for a box.
//!
//! Two-metric projection (Bertsekas 1982): variables that sit at a bound and want to leave the box are held, the
//! two-loop recursion (Nocedal 1980) acts on the others with the pairs restricted to them, and the step follows the
//! projection arc under an Armijo test. Unlike a generalised Cauchy point it costs nothing beyond the two loops,
//! which matters where an evaluation takes a few tens of microseconds.

use crate::kernel::dot;

/// When a local run ends.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Stop {
    /// Most evaluations.
    pub(crate) evaluations: usize,
    /// Largest component of the projected gradient.
    pub(crate) gradient: f64,
    /// Decrease of the objective over [`WINDOW`] iterations.
    pub(crate) decrease: f64,
}

/// How a local run ended.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Ended {
    #[cfg_attr(not(test), expect(dead_code, reason = "callers evaluate the repaired point themselves"))]
    pub(crate) value: f64,
    pub(crate) converged: bool,
    /// Largest component of the projected gradient.
    pub(crate) optimality: f64,
}

const MEMORY: usize = 12;
const WINDOW: usize = 8;
const ARMIJO: f64 = 1e-4;

/// Buffers of the search over n variables.
pub(crate) struct Lbfgs {
    s: Vec<Vec<f64>>,
    y: Vec<Vec<f64>>,
    kept: usize,
    free: Vec<f64>,
    g: Vec<f64>,
    d: Vec<f64>,
    x_new: Vec<f64>,
    g_new: Vec<f64>,
    recent: [f64; WINDOW],
}

impl Lbfgs {
    pub(crate) fn new(n: usize) -> Self {
        let v = || vec![0.0; n];
        Self {
            s: vec![v(); MEMORY],
            y: vec![v(); MEMORY],
            kept: 0,
            free: v(),
            g: v(),
            d: v(),
            x_new: v(),
            g_new: v(),
            recent: [f64::INFINITY; WINDOW],
        }
    }

    /// Minimises `f` (value; fills the gradient) over `lower <= x <= upper` from `x`, which ends at the best point.
    pub(crate) fn minimise(
        &mut self,
        f: &mut dyn FnMut(&[f64], &mut [f64]) -> f64,
        lower: &[f64],
        upper: &[f64],
        x: &mut [f64],
        stop: &Stop,
    ) -> Ended {
        self.kept = 0;
        self.recent.fill(f64::INFINITY);
        let mut value = f(x, &mut self.g);
        let mut used = 1;
        let mut iteration = 0;
        loop {
            let optimality = self.hold_bounds(lower, upper, x);
            if !value.is_finite() || optimality <= stop.gradient {
                return Ended { value, converged: value.is_finite(), optimality };
            }
            let old = std::mem::replace(&mut self.recent[iteration % WINDOW], value);
            if old - value <= stop.decrease {
                return Ended { value, converged: true, optimality };
            }
            iteration += 1;
            let slope = self.direction();
            match self.step(f, lower, upper, x, value, slope, stop.evaluations.saturating_sub(used)) {
                (Some(v), n) => {
                    used += n;
                    self.store(x);
                    x.copy_from_slice(&self.x_new);
                    std::mem::swap(&mut self.g, &mut self.g_new);
                    value = v;
                }
                (None, n) => {
                    used += n;
                    if used >= stop.evaluations {
                        return Ended { value, converged: false, optimality };
                    }
                    if self.kept == 0 {
                        // Steepest descent finds nothing either: as good as the arithmetic allows.
                        return Ended { value, converged: false, optimality };
                    }
                    self.kept = 0;
                    self.recent.fill(f64::INFINITY);
                }
            }
        }
    }

    /// Marks the variables that may move; returns the largest component of the projected gradient.
    fn hold_bounds(&mut self, lower: &[f64], upper: &[f64], x: &[f64]) -> f64 {
        let mut worst = 0.0f64;
        for j in 0..x.len() {
            let held = (x[j] <= lower[j] && self.g[j] >= 0.0) || (x[j] >= upper[j] && self.g[j] <= 0.0);
            self.free[j] = if held { 0.0 } else { 1.0 };
            worst = worst.max(((x[j] - self.g[j]).clamp(lower[j], upper[j]) - x[j]).abs());
        }
        worst
    }

    /// Quasi-Newton direction on the free variables to `self.d`; returns its slope.
    fn direction(&mut self) -> f64 {
        pulp::Arch::new().dispatch(Direction(self))
    }

    #[inline(always)]
    fn two_loops(&mut self) -> f64 {
        let mut rho = [0.0; MEMORY];
        let mut alpha = [0.0; MEMORY];
        for (d, (g, m)) in self.d.iter_mut().zip(self.g.iter().zip(&self.free)) {
            *d = -g * m;
        }
        let mut gamma = 0.0;
        for k in 0..self.kept {
            let (s, y) = (&self.s[k], &self.y[k]);
            let (sy, yy) = masked(s, y, &self.free);
            // A pair may lose its curvature when bounds take variables away from it.
            if sy <= 1e-10 * yy {
                continue;
            }
            rho[k] = 1.0 / sy;
            if gamma == 0.0 {
                gamma = sy / yy;
            }
            alpha[k] = rho[k] * dot(s, &self.d);
            subtract_masked(&mut self.d, alpha[k], y, &self.free);
        }
        if gamma == 0.0 {
            self.kept = 0;
            // No curvature known: a step that moves no variable by more than a tenth of its range.
            let largest = self.d.iter().fold(0.0f64, |m, v| m.max(v.abs()));
            gamma = 0.1 / largest;
        }
        self.d.iter_mut().for_each(|v| *v *= gamma);
        for k in (0..self.kept).rev().filter(|k| rho[*k] > 0.0) {
            let beta = rho[k] * dot(&self.y[k], &self.d);
            subtract_masked(&mut self.d, beta - alpha[k], &self.s[k], &self.free);
        }
        dot(&self.d, &self.g)
    }

    /// Backtracks along the projection arc into `x_new`, `g_new`; the value there and the evaluations used.
    fn step(
        &mut self,
        f: &mut dyn FnMut(&[f64], &mut [f64]) -> f64,
        lower: &[f64],
        upper: &[f64],
        x: &[f64],
        value: f64,
        slope: f64,
        budget: usize,
    ) -> (Option<f64>, usize) {
        if slope >= 0.0 || slope.is_nan() {
            return (None, 0);
        }
        let mut t = 1.0;
        for k in 0..budget.min(25) {
            for j in 0..x.len() {
                self.x_new[j] = (x[j] + t * self.d[j]).clamp(lower[j], upper[j]);
            }
            let v = f(&self.x_new, &mut self.g_new);
            let promised: f64 = (0..x.len()).map(|j| self.g[j] * (self.x_new[j] - x[j])).sum();
            if v.is_finite() && v <= value + ARMIJO * promised && promised < 0.0 {
                return (Some(v), k + 1);
            }
            // Minimiser of the parabola through both values and the slope, kept within sensible shares.
            let parabola = -0.5 * t * slope / ((v - value) / t - slope);
            t = if v.is_finite() && parabola.is_finite() {
                parabola.clamp(0.1 * t, 0.5 * t)
            } else {
                0.2 * t
            };
        }
        (None, budget.min(25))
    }

    /// Puts the step from `x` to `x_new` in front of the memory when it has curvature.
    fn store(&mut self, x: &[f64]) {
        let last = MEMORY - 1;
        self.s[..=last].rotate_right(1);
        self.y[..=last].rotate_right(1);
        for j in 0..x.len() {
            self.s[0][j] = self.x_new[j] - x[j];
            self.y[0][j] = self.g_new[j] - self.g[j];
        }
        if dot(&self.s[0], &self.y[0]) > 1e-12 * dot(&self.y[0], &self.y[0]) {
            self.kept = (self.kept + 1).min(MEMORY);
        } else {
            self.s[..=last].rotate_left(1);
            self.y[..=last].rotate_left(1);
            // The oldest pair was overwritten by the refused one, which is last now.
            self.kept = self.kept.min(last);
        }
    }
}

/// [`Lbfgs::direction`], compiled for the widest registers there are.
struct Direction<'a>(&'a mut Lbfgs);

impl pulp::WithSimd for Direction<'_> {
    type Output = f64;

    #[inline(always)]
    fn with_simd<S: pulp::Simd>(self, _: S) -> f64 {
        self.0.two_loops()
    }
}

/// `s' y` and `y' y` over the free variables.
#[inline(always)]
fn masked(s: &[f64], y: &[f64], free: &[f64]) -> (f64, f64) {
    let (mut sy, mut yy) = ([0.0; 4], [0.0; 4]);
    let n = s.len() - s.len() % 4;
    for j in (0..n).step_by(4) {
        for k in 0..4 {
            let w = y[j + k] * free[j + k];
            sy[k] += s[j + k] * w;
            yy[k] += y[j + k] * w;
        }
    }
    for j in n..s.len() {
        sy[0] += s[j] * y[j] * free[j];
        yy[0] += y[j] * y[j] * free[j];
    }
    (sy.iter().sum(), yy.iter().sum())
}

#[inline(always)]
fn subtract_masked(d: &mut [f64], a: f64, v: &[f64], free: &[f64]) {
    for ((d, v), m) in d.iter_mut().zip(v).zip(free) {
        *d = (*d - a * v) * m;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn run(
        f: &mut dyn FnMut(&[f64], &mut [f64]) -> f64,
        lower: f64,
        upper: f64,
        x: &mut [f64],
        evaluations: usize,
    ) -> Ended {
        let n = x.len();
        let stop = Stop { evaluations, gradient: 1e-10, decrease: 0.0 };
        Lbfgs::new(n).minimise(f, &vec![lower; n], &vec![upper; n], x, &stop)
    }

    /// Separable convex quadratic: the solution is the clamped centre, exactly.
    #[test]
    fn bounded_quadratic_ends_at_the_clamped_centre() {
        let n = 31;
        let centre: Vec<f64> = (0..n).map(|j| f64::from(j) / 10.0 - 1.5).collect();
        let mut f = |x: &[f64], g: &mut [f64]| {
            let mut v = 0.0;
            for j in 0..x.len() {
                let w = 1.0 + j as f64;
                g[j] = w * (x[j] - centre[j]);
                v += 0.5 * w * (x[j] - centre[j]).powi(2);
            }
            v
        };
        let mut x = vec![0.5; n as usize];
        run(&mut f, 0.0, 1.0, &mut x, 500);
        for (x, c) in x.iter().zip(&centre) {
            assert!((x - c.clamp(0.0, 1.0)).abs() < 1e-8);
        }
    }

    /// 50-dimensional chained Rosenbrock, unbounded minimum 0 inside the box.
    #[test]
    fn rosenbrock_reaches_its_minimum_and_survives_holes() {
        let mut f = |x: &[f64], g: &mut [f64]| {
            g.fill(0.0);
            if x.iter().any(|v| *v > 1.9) {
                return f64::NAN;
            }
            let mut v = 0.0;
            for j in 0..x.len() - 1 {
                let (a, b) = (x[j + 1] - x[j] * x[j], 1.0 - x[j]);
                v += 100.0 * a * a + b * b;
                g[j] -= 400.0 * a * x[j] + 2.0 * b;
                g[j + 1] += 200.0 * a;
            }
            v
        };
        let mut x = vec![0.3; 50];
        let found = run(&mut f, 0.0, 2.0, &mut x, 3000);
        assert!(found.value < 1e-12, "{}", found.value);
    }
}
