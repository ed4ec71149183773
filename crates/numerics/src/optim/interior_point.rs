//! The interior point of [`crate::nlp`] on a box, with a quasi-Newton Hessian.
//!
//! ```text
//! minimise f(x) - mu sum ln(x - l) - mu sum ln(u - x),   mu -> 0
//! B+ = B - B s s' B / s'Bs + r r' / s'r,   r = theta y + (1 - theta) B s     damped BFGS
//! ```
//!
//! Reference: A. Waechter, L. T. Biegler, Math. Programming 106 (2006), 25-57; J. Nocedal, S. J. Wright, Numerical
//! Optimization, 2nd ed., procedure 18.2 (damping).

use super::probe::Probe;
use super::{Bounds, Budget, Objective, Optimiser, Outcome};
use crate::linalg::dot;
use crate::nlp::{NlpOptions, SparseNlp, solve};
use crate::status::Status;
use std::cell::{Cell, RefCell};

/// Iterations over which the objective must fall.
const WINDOW: usize = 10;

/// Interior point with a dense quasi-Newton Hessian. Needs gradients; work grows with the cube of the number of
/// variables.
#[derive(Clone, Copy, Debug, Default)]
pub struct InteriorPoint;

impl Optimiser for InteriorPoint {
    fn minimise(&self, problem: &mut dyn Objective, bounds: &Bounds, x0: &[f64], budget: &Budget) -> Outcome {
        let probe = RefCell::new(Probe::new(problem, bounds, x0, budget));
        let (start, over, settled) = (probe.borrow().start(), Cell::new(false), Cell::new(false));
        let n = start.len();
        let mut program = Program {
            probe: &probe,
            over: &over,
            settled: &settled,
            value_tolerance: budget.value_tolerance,
            recent: [f64::INFINITY; WINDOW],
            iterations: 0,
            bounds,
            model: Bfgs { b: vec![0.0; n * (n + 1) / 2], bs: vec![0.0; n], pairs: 0 },
            point: start.clone(),
            gradient: vec![f64::NAN; n],
            next: vec![0.0; n],
            start,
        };
        let options = NlpOptions {
            tolerance: budget.gradient_tolerance.clamp(1e-10, 1e-3),
            max_iterations: budget.evaluations,
            ..NlpOptions::default()
        };
        let found = solve(&mut program, &options, &|| over.get() || settled.get());
        let status = match (over.get(), settled.get()) {
            (true, _) => Status::Limit,
            (_, true) => Status::Converged,
            _ => found.status,
        };
        probe.into_inner().outcome(status)
    }
}

struct Program<'p, 'a> {
    probe: &'p RefCell<Probe<'a>>,
    /// Whether the budget is used up.
    over: &'p Cell<bool>,
    /// Whether the objective no longer changes.
    settled: &'p Cell<bool>,
    value_tolerance: f64,
    recent: [f64; WINDOW],
    iterations: usize,
    bounds: &'p Bounds,
    model: Bfgs,
    /// Where the Hessian was asked last, and the gradient there.
    point: Vec<f64>,
    gradient: Vec<f64>,
    next: Vec<f64>,
    start: Vec<f64>,
}

impl Program<'_, '_> {
    fn evaluate(&mut self, x: &[f64]) -> f64 {
        // With the gradient at once: an accepted trial needs it anyway, and value and gradient count as one evaluation.
        self.probe.borrow_mut().value(x, &mut self.next).unwrap_or_else(|_| {
            self.over.set(true);
            f64::NAN
        })
    }
}

impl SparseNlp for Program<'_, '_> {
    fn n(&self) -> usize {
        self.start.len()
    }
    fn m(&self) -> usize {
        0
    }
    fn bounds(&self, lower: &mut [f64], upper: &mut [f64]) {
        lower.copy_from_slice(&self.bounds.lower);
        upper.copy_from_slice(&self.bounds.upper);
    }
    fn start(&self, x: &mut [f64]) {
        x.copy_from_slice(&self.start);
    }
    fn objective(&mut self, x: &[f64]) -> f64 {
        self.evaluate(x)
    }
    fn gradient(&mut self, x: &[f64], grad: &mut [f64]) {
        self.evaluate(x);
        grad.copy_from_slice(&self.next);
    }
    fn constraints(&mut self, _: &[f64], _: &mut [f64]) {}
    fn jacobian_structure(&self) -> Vec<(usize, usize)> {
        Vec::new()
    }
    fn jacobian(&mut self, _: &[f64], _: &mut [f64]) {}
    fn hessian_structure(&self) -> Vec<(usize, usize)> {
        (0..self.start.len()).flat_map(|i| (0..=i).map(move |j| (i, j))).collect()
    }
    fn hessian(&mut self, x: &[f64], sigma: f64, _: &[f64], values: &mut [f64]) {
        let f = self.evaluate(x);
        // A quasi-Newton Hessian seldom meets a strict tolerance: no change over some iterations is an end as well.
        let old = std::mem::replace(&mut self.recent[self.iterations % WINDOW], f);
        self.iterations += 1;
        if (old - f).abs() <= self.value_tolerance * f.abs() {
            self.settled.set(true);
        }
        let s: Vec<f64> = x.iter().zip(&self.point).map(|(a, b)| a - b).collect();
        let y: Vec<f64> = self.next.iter().zip(&self.gradient).map(|(a, b)| a - b).collect();
        self.model.update(&s, y);
        self.point.copy_from_slice(x);
        self.gradient.copy_from_slice(&self.next);
        values.iter_mut().zip(&self.model.b).for_each(|(v, b)| *v = sigma * b);
    }
}

/// Dense BFGS matrix, lower triangle by rows.
struct Bfgs {
    b: Vec<f64>,
    bs: Vec<f64>,
    pairs: usize,
}

impl Bfgs {
    fn set_diagonal(&mut self, value: f64) {
        self.b.fill(0.0);
        for i in 0..self.bs.len() {
            self.b[i * (i + 1) / 2 + i] = value;
        }
    }

    /// Takes the step `s` with the change `y` of the gradient in, damped to keep the matrix positive definite.
    fn update(&mut self, s: &[f64], mut y: Vec<f64>) {
        let (ss, sy) = (dot(s, s), dot(s, &y));
        if !(ss > 0.0 && sy.is_finite()) {
            if self.pairs == 0 {
                self.set_diagonal(1.0);
            }
            return;
        }
        if self.pairs == 0 {
            // The size of the curvature that the first step met.
            self.set_diagonal(if sy > 0.0 { dot(&y, &y) / sy } else { dot(&y, &y).sqrt() / ss.sqrt() });
        }
        self.pairs += 1;
        let n = s.len();
        self.bs.fill(0.0);
        for i in 0..n {
            let row = &self.b[i * (i + 1) / 2..][..=i];
            self.bs[i] += dot(row, &s[..=i]);
            (0..i).for_each(|j| self.bs[j] += row[j] * s[i]);
        }
        let sbs = dot(s, &self.bs);
        let theta = if sy >= 0.2 * sbs { 1.0 } else { 0.8 * sbs / (sbs - sy) };
        y.iter_mut().zip(&self.bs).for_each(|(y, b)| *y = theta * *y + (1.0 - theta) * b);
        let sr = dot(s, &y);
        if sbs <= 0.0 || sr <= 0.0 {
            return;
        }
        for i in 0..n {
            let (yi, bi) = (y[i] / sr, self.bs[i] / sbs);
            let row = &mut self.b[i * (i + 1) / 2..][..=i];
            for j in 0..=i {
                row[j] += yi * y[j] - bi * self.bs[j];
            }
        }
    }
}
