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
    /// Z, n x q.
    basis: Vec<f64>,
    /// W'Z, n x q.
    mixed: Vec<f64>,
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
            basis: vec![0.0; n * q],
            mixed: vec![0.0; n * q],
            rotated: vec![0.0; n],
            root: vec![0.0; q * q],
            coefficients: vec![0.0; q],
            weights: vec![0.0; n],
        };
        for i in 0..n {
            let row = &factors.lower[i * (i + 1) / 2..(i + 1) * (i + 2) / 2];
            factors.rotated[i] = dot(row, &y[..=i]);
            let z = &mut factors.basis[i * q..(i + 1) * q];
            for (w, h) in row.iter().zip(basis.chunks_exact(q.max(1))) {
                axpy(*w, h, z);
            }
            if q > 0 {
                row.iter().zip(factors.mixed.chunks_exact_mut(q)).for_each(|(w, m)| axpy(*w, z, m));
            }
        }
        factors.solve()?;
        Some(factors)
    }

    /// Numbers that are held.
    pub(super) fn len(&self) -> usize {
        self.lower.len() + 2 * self.basis.len() + 2 * self.weights.len()
    }

    /// Coefficients and weights from W, Z and r.
    fn solve(&mut self) -> Option<()> {
        let (n, q) = (self.rotated.len(), self.coefficients.len());
        self.root.fill(0.0);
        self.coefficients.fill(0.0);
        for (z, r) in self.basis.chunks_exact(q.max(1)).zip(&self.rotated) {
            for i in 0..q {
                self.coefficients[i] += z[i] * r;
                for j in i..q {
                    self.root[i * q + j] += z[i] * z[j];
                }
            }
        }
        cholesky(&mut self.root, q).ok()?;
        solve_upper_transposed(&self.root, q, &mut self.coefficients).ok()?;
        solve_upper(&self.root, q, &mut self.coefficients).ok()?;
        let mut residual = self.rotated.clone();
        for i in 0..n {
            residual[i] -= dot(&self.basis[i * q..(i + 1) * q], &self.coefficients);
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
        if q > 0 {
            p.iter_mut().zip(self.mixed.chunks_exact(q)).for_each(|(p, m)| *p += dot(m, f));
        }
        variance
    }

    /// `t = A^-T (h - Z'v)`.
    pub(super) fn rest_of_mean(&self, h: &[f64], v: &[f64], t: &mut [f64]) {
        let q = t.len();
        t.copy_from_slice(h);
        if q > 0 {
            for (z, v) in self.basis.chunks_exact(q).zip(v) {
                axpy(-v, z, t);
            }
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
        let mut z = h.to_vec();
        if !z.is_empty() {
            for (row, v) in self.basis.chunks_exact(h.len()).zip(&v) {
                axpy(-v, row, &mut z);
            }
        }
        z.iter_mut().for_each(|z| *z /= rest);
        let last = self.lower[self.lower.len() - n - 1..].iter();
        self.mixed.resize(self.mixed.len() + z.len(), 0.0);
        if !z.is_empty() {
            last.zip(self.mixed.chunks_exact_mut(z.len())).for_each(|(w, m)| axpy(*w, &z, m));
        }
        self.basis.extend(z);
        // More points never make the mean functions dependent.
        let _ = self.solve();
    }
}
