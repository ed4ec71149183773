//! The problem as the interior point sees it: fixed variables removed, the others in units of their sizes, bounds relaxed by a
//! rounding-sized margin, objective and constraints scaled by their gradients at the start (Waechter and Biegler 2006, section 3.8).

use super::SparseNlp;
use crate::linalg::norm_inf;

/// Gradients larger than this are scaled down to it.
const LARGEST_GRADIENT: f64 = 100.0;
/// An objective whose largest derivative is smaller than this is scaled up to it, by this factor at most.
const SMALLEST_GRADIENT: f64 = 1e-2;
const LARGEST_LIFT: f64 = 1e3;
/// Relative relaxation of the bounds: an interior exists even where two inequalities meet.
const BOUND_RELAXATION: f64 = 1e-9;

/// Why there is nothing to iterate on.
pub(super) enum Trivial {
    /// A lower bound lies above its upper bound, or is not a number.
    EmptyBox,
    /// The functions are not finite at the start.
    NotFinite,
}

pub(super) struct Model<'a> {
    problem: &'a mut dyn SparseNlp,
    /// Free variables and constraints.
    pub(super) n: usize,
    pub(super) m: usize,
    free: Vec<usize>,
    /// Sizes of the free variables, and the products of the sizes of each kept entry of the Hessian.
    size: Vec<f64>,
    hess_size: Vec<f64>,
    full_x: Vec<f64>,
    true_lower: Vec<f64>,
    true_upper: Vec<f64>,
    /// Relaxed bounds of the free variables.
    pub(super) lower: Vec<f64>,
    pub(super) upper: Vec<f64>,
    pub(super) objective_scale: f64,
    constraint_scale: Vec<f64>,
    /// (row, free column) of the kept Jacobian and Hessian entries, and where they stand in the full values.
    pub(super) jac_at: Vec<(usize, usize)>,
    jac_pick: Vec<usize>,
    jac_full: Vec<f64>,
    pub(super) hess_at: Vec<(usize, usize)>,
    hess_pick: Vec<usize>,
    hess_full: Vec<f64>,
    grad_full: Vec<f64>,
    multipliers: Vec<f64>,
    /// Objective evaluations.
    pub(super) evaluations: usize,
}

impl<'a> Model<'a> {
    pub(super) fn new(problem: &'a mut dyn SparseNlp) -> Result<Self, Trivial> {
        let (n_full, m) = (problem.n(), problem.m());
        let (mut lower, mut upper) = (vec![f64::NEG_INFINITY; n_full], vec![f64::INFINITY; n_full]);
        problem.bounds(&mut lower, &mut upper);
        if lower.iter().zip(&upper).any(|(l, u)| l > u || l.is_nan() || u.is_nan()) {
            return Err(Trivial::EmptyBox);
        }
        let mut full_x = vec![0.0; n_full];
        problem.start(&mut full_x);
        for k in 0..n_full {
            full_x[k] = full_x[k].max(lower[k]).min(upper[k]);
        }
        let free: Vec<usize> = (0..n_full).filter(|&k| lower[k] < upper[k]).collect();
        let mut sizes = vec![1.0; n_full];
        problem.sizes(&mut sizes);
        // A size that is none is 1.
        sizes.iter_mut().filter(|s| !(s.is_finite() && **s > 0.0)).for_each(|s| *s = 1.0);
        let mut place = vec![usize::MAX; n_full];
        free.iter().enumerate().for_each(|(k, &j)| place[j] = k);
        let (jac, hess) = (problem.jacobian_structure(), problem.hessian_structure());
        let keep = |v: &[(usize, usize)], both: bool| -> Vec<usize> {
            let kept = |e: &(usize, usize)| place[e.1] != usize::MAX && (!both || place[e.0] != usize::MAX);
            (0..v.len()).filter(|&k| kept(&v[k])).collect()
        };
        let (jac_pick, hess_pick) = (keep(&jac, false), keep(&hess, true));
        let relax = |b: f64, sign: f64| {
            if b.is_finite() { b + sign * BOUND_RELAXATION * b.abs().max(1.0) } else { b }
        };
        let mut model = Self {
            n: free.len(),
            m,
            lower: free.iter().map(|&k| relax(lower[k] / sizes[k], -1.0)).collect(),
            upper: free.iter().map(|&k| relax(upper[k] / sizes[k], 1.0)).collect(),
            size: free.iter().map(|&k| sizes[k]).collect(),
            hess_size: hess_pick.iter().map(|&k| sizes[hess[k].0] * sizes[hess[k].1]).collect(),
            free,
            full_x,
            true_lower: lower,
            true_upper: upper,
            objective_scale: 1.0,
            constraint_scale: vec![1.0; m],
            jac_at: jac_pick.iter().map(|&k| (jac[k].0, place[jac[k].1])).collect(),
            jac_pick,
            jac_full: vec![0.0; jac.len()],
            hess_at: hess_pick.iter().map(|&k| (place[hess[k].0], place[hess[k].1])).collect(),
            hess_pick,
            hess_full: vec![0.0; hess.len()],
            grad_full: vec![0.0; n_full],
            multipliers: vec![0.0; m],
            evaluations: 0,
            problem,
        };
        model.scale()?;
        Ok(model)
    }

    /// Start values of the free variables.
    pub(super) fn start(&self, x: &mut [f64]) {
        for ((v, &k), size) in x.iter_mut().zip(&self.free).zip(&self.size) {
            *v = self.full_x[k] / size;
        }
    }

    fn scale(&mut self) -> Result<(), Trivial> {
        let mut x = vec![0.0; self.n];
        self.start(&mut x);
        let (mut grad, mut jac) = (vec![0.0; self.n], vec![0.0; self.jac_at.len()]);
        self.gradient(&x, &mut grad);
        self.jacobian(&x, &mut jac);
        let mut largest = vec![0.0f64; self.m];
        for (&(i, _), v) in self.jac_at.iter().zip(&jac) {
            largest[i] = largest[i].max(v.abs());
        }
        if !grad.iter().chain(&jac).all(|v| v.is_finite()) {
            return Err(Trivial::NotFinite);
        }
        // A flat objective is scaled up as well, else the tolerance would let it stop far from the optimum.
        let unit = self.problem.objective_unit();
        let steepest = norm_inf(&grad) / unit;
        let flat = steepest > 0.0 && steepest < SMALLEST_GRADIENT;
        self.objective_scale =
            if flat { (SMALLEST_GRADIENT / steepest).min(LARGEST_LIFT) } else { scale_of(steepest) } / unit;
        self.constraint_scale = largest.into_iter().map(scale_of).collect();
        Ok(())
    }

    fn place(&mut self, x: &[f64]) {
        for ((&k, v), size) in self.free.iter().zip(x).zip(&self.size) {
            self.full_x[k] = *v * size;
        }
    }

    pub(super) fn objective(&mut self, x: &[f64]) -> f64 {
        self.place(x);
        self.evaluations += 1;
        self.objective_scale * self.problem.objective(&self.full_x)
    }

    pub(super) fn gradient(&mut self, x: &[f64], grad: &mut [f64]) {
        self.place(x);
        self.problem.gradient(&self.full_x, &mut self.grad_full);
        for ((g, &k), size) in grad.iter_mut().zip(&self.free).zip(&self.size) {
            *g = self.objective_scale * (self.grad_full[k] * size);
        }
    }

    pub(super) fn constraints(&mut self, x: &[f64], c: &mut [f64]) {
        self.place(x);
        self.problem.constraints(&self.full_x, c);
        c.iter_mut().zip(&self.constraint_scale).for_each(|(c, s)| *c *= s);
    }

    pub(super) fn jacobian(&mut self, x: &[f64], values: &mut [f64]) {
        self.place(x);
        self.problem.jacobian(&self.full_x, &mut self.jac_full);
        for ((v, &k), &(i, j)) in values.iter_mut().zip(&self.jac_pick).zip(&self.jac_at) {
            *v = self.constraint_scale[i] * (self.jac_full[k] * self.size[j]);
        }
    }

    pub(super) fn hessian(&mut self, x: &[f64], lambda: &[f64], values: &mut [f64]) {
        self.place(x);
        for i in 0..self.m {
            self.multipliers[i] = self.constraint_scale[i] * lambda[i];
        }
        self.problem.hessian(&self.full_x, self.objective_scale, &self.multipliers, &mut self.hess_full);
        for ((v, &k), size) in values.iter_mut().zip(&self.hess_pick).zip(&self.hess_size) {
            *v = self.hess_full[k] * size;
        }
    }

    /// Largest unscaled |c| of scaled constraint values.
    pub(super) fn violation(&self, c: &[f64]) -> f64 {
        c.iter().zip(&self.constraint_scale).map(|(c, s)| (c / s).abs()).fold(0.0, f64::max)
    }

    /// The point inside the true bounds with its unscaled objective, violation and multipliers.
    pub(super) fn finish(mut self, x: &[f64], lambda: &[f64]) -> (Vec<f64>, f64, f64, Vec<f64>) {
        self.place(x);
        for k in 0..self.full_x.len() {
            self.full_x[k] = self.full_x[k].max(self.true_lower[k]).min(self.true_upper[k]);
        }
        let mut c = vec![0.0; self.m];
        let objective = self.problem.objective(&self.full_x);
        self.problem.constraints(&self.full_x, &mut c);
        let multipliers =
            lambda.iter().zip(&self.constraint_scale).map(|(l, s)| l * s / self.objective_scale).collect();
        (self.full_x, objective, norm_inf(&c), multipliers)
    }
}

/// Factor that brings a largest derivative down to [`LARGEST_GRADIENT`].
fn scale_of(largest: f64) -> f64 {
    if largest > LARGEST_GRADIENT { (LARGEST_GRADIENT / largest).max(1e-8) } else { 1.0 }
}
