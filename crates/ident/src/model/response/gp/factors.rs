//! The factored matrices behind predictions, kept so that small variances keep their digits and a point can be added.
//!
//! ```text
//! V = R'R,  W = R^-T,  Z = W H,  r = W y,  Z'Z = A'A,  b = A^-1 A^-T Z'r,  a = W'(r - Z b)
//! mean = h'b + k'a
//! v = W k,  t = A^-T (h - Z'v),  variance / s^2 = 1 - v'v + t't
//! p = W'v + (W'Z) A^-1 t,  d variance / s^2 = -2 p'dk + 2 (A^-1 t)'dh
//! ```
//!
//! Through v the error of a variance is about eps / sqrt(g), g the noise ratio; through V^-1 it would be eps / g.

use dynocal_numerics::linalg::{axpy, cholesky, dot, solve_upper, solve_upper_transposed};

use super::packed;

/// Factors for n points and q mean functions.
#[derive(Clone, Debug, PartialEq)]
pub struct Factors {
    /// W, lower triangular, row by row: row i has i + 1 entries.
    lower: Vec<f64>,
    /// Columns of Z, q of n.
    basis: Vec<Vec<f64>>,
    /// Columns of W'Z, q of n.
    mixed: Vec<Vec<f64>>,
    /// r (n).
    rotated: Vec<f64>,
    /// A, upper triangular (q x q).
    root: Vec<f64>,
    /// b (q).
    pub coefficients: Vec<f64>,
    /// a (n).
    pub weights: Vec<f64>,
}

impl Factors {
    /// From W (rows of a lower triangle), the mean functions (n x q) and the output (n). `None` where the mean functions
    /// are dependent at these points.
    pub(super) fn new(lower: Vec<f64>, basis: &[f64], y: &[f64]) -> Option<Self> {
        let n = y.len();
        let q = basis.len() / n.max(1);
        let mut factors = Self {
            lower,
            basis: (0..q).map(|j| basis.iter().skip(j).step_by(q).copied().collect()).collect(),
            mixed: vec![vec![0.0; n]; q],
            rotated: vec![0.0; n],
            root: vec![0.0; q * q],
            coefficients: vec![0.0; q],
            weights: vec![0.0; n],
        };
        packed::times(&factors.lower, y, &mut factors.rotated);
        let mut column = vec![0.0; n];
        for (z, mixed) in factors.basis.iter_mut().zip(&mut factors.mixed) {
            packed::both(&factors.lower, z, &mut column, mixed);
            std::mem::swap(z, &mut column);
        }
        factors.solve()?;
        Some(factors)
    }

    /// Numbers that are held.
    pub(super) fn len(&self) -> usize {
        self.lower.len() + 2 * (1 + self.basis.len()) * self.weights.len()
    }

    /// Coefficients and weights from W, Z and r.
    fn solve(&mut self) -> Option<()> {
        let (n, q) = (self.rotated.len(), self.coefficients.len());
        self.root.fill(0.0);
        self.coefficients.fill(0.0);
        for i in 0..q {
            self.coefficients[i] = dot(&self.basis[i], &self.rotated);
            for j in i..q {
                self.root[i * q + j] = dot(&self.basis[i], &self.basis[j]);
            }
        }
        cholesky(&mut self.root, q).ok()?;
        solve_upper_transposed(&self.root, q, &mut self.coefficients).ok()?;
        solve_upper(&self.root, q, &mut self.coefficients).ok()?;
        let mut residual = self.rotated.clone();
        for (z, b) in self.basis.iter().zip(&self.coefficients) {
            axpy(-b, z, &mut residual);
        }
        let mut weights = std::mem::take(&mut self.weights);
        weights.resize(n, 0.0);
        self.times_transposed(&residual, &mut weights);
        self.weights = weights;
        Some(())
    }

    /// `h'b + k'a`.
    pub fn mean(&self, h: &[f64], k: &[f64]) -> f64 {
        dot(h, &self.coefficients) + dot(k, &self.weights)
    }

    /// Variance over s^2; leaves v (n) and t (q).
    pub fn variance(&self, h: &[f64], k: &[f64], v: &mut [f64], t: &mut [f64]) -> f64 {
        packed::times(&self.lower, k, v);
        self.rest_of_mean(h, v, t);
        1.0 - dot(v, v) + dot(t, t)
    }

    /// Variance over s^2 with p (n); leaves v (n), and A^-1 t in `f` (q).
    pub(super) fn variance_and_slopes(
        &self,
        h: &[f64],
        k: &[f64],
        v: &mut [f64],
        f: &mut [f64],
        p: &mut [f64],
    ) -> f64 {
        packed::both(&self.lower, k, v, p);
        self.rest_of_mean(h, v, f);
        let variance = 1.0 - dot(v, v) + dot(f, f);
        let q = f.len();
        // The factor has a positive diagonal.
        let _ = solve_upper(&self.root, q, f);
        for (mixed, f) in self.mixed.iter().zip(&*f) {
            axpy(*f, mixed, p);
        }
        variance
    }

    /// `t = A^-T (h - Z'v)`.
    pub(super) fn rest_of_mean(&self, h: &[f64], v: &[f64], t: &mut [f64]) {
        let q = t.len();
        for ((t, h), z) in t.iter_mut().zip(h).zip(&self.basis) {
            *t = h - dot(z, v);
        }
        // The factor has a positive diagonal.
        let _ = solve_upper_transposed(&self.root, q, t);
    }

    /// `out = W x`.
    pub(super) fn times(&self, x: &[f64], out: &mut [f64]) {
        packed::times(&self.lower, x, out);
    }

    /// `out = W'x`.
    fn times_transposed(&self, x: &[f64], out: &mut [f64]) {
        packed::times_transposed(&self.lower, x, out);
    }

    /// One more point: its mean functions, its correlations with the others, its own diagonal entry of V, its output.
    pub(super) fn append(&mut self, h: &[f64], k: &[f64], diagonal: f64, y: f64) {
        let n = self.rotated.len();
        let mut v = vec![0.0; n];
        self.times(k, &mut v);
        // The rest of the diagonal is at least the noise; rounding may take it below where there is almost none.
        let rest = (diagonal - dot(&v, &v)).max(f64::EPSILON * diagonal).sqrt();
        let mut last = vec![0.0; n];
        self.times_transposed(&v, &mut last);
        self.lower.extend(last.iter().map(|l| -l / rest));
        self.lower.push(1.0 / rest);
        self.rotated.push((y - dot(&v, &self.rotated)) / rest);
        let last = &self.lower[self.lower.len() - n - 1..];
        for ((h, z), mixed) in h.iter().zip(&mut self.basis).zip(&mut self.mixed) {
            let own = (h - dot(&v, z)) / rest;
            z.push(own);
            mixed.push(0.0);
            axpy(own, last, mixed);
        }
        // More points never make the mean functions dependent.
        let _ = self.solve();
    }
}
