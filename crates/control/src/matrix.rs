//! Small dense complex matrices, as many rows as there are loops.

use dynocal_numerics::fft::Complex;

use crate::poly;

/// A complex number.
pub type C = Complex<f64>;

/// Zero.
pub const ZERO: C = Complex::new(0.0, 0.0);
/// One.
pub const ONE: C = Complex::new(1.0, 0.0);
/// Sweeps of the Jacobi method.
const SWEEPS: usize = 40;

/// A matrix, row-major.
#[derive(Clone, Debug, PartialEq)]
pub struct Matrix {
    /// Rows.
    pub rows: usize,
    /// Columns.
    pub cols: usize,
    /// Entry (i, j) at `i * cols + j`.
    pub data: Vec<C>,
}

impl Matrix {
    /// Zeros.
    pub fn zeros(rows: usize, cols: usize) -> Self {
        Self { rows, cols, data: vec![ZERO; rows * cols] }
    }

    /// Identity.
    pub fn identity(n: usize) -> Self {
        Self::diagonal(&vec![ONE; n])
    }

    /// Diagonal matrix.
    pub fn diagonal(d: &[C]) -> Self {
        let mut out = Self::zeros(d.len(), d.len());
        d.iter().enumerate().for_each(|(k, v)| *out.at_mut(k, k) = *v);
        out
    }

    /// Entry.
    pub fn at(&self, i: usize, j: usize) -> C {
        self.data[i * self.cols + j]
    }

    /// Entry, to be changed.
    pub fn at_mut(&mut self, i: usize, j: usize) -> &mut C {
        &mut self.data[i * self.cols + j]
    }

    /// Product.
    pub fn times(&self, b: &Self) -> Self {
        let mut out = Self::zeros(self.rows, b.cols);
        for i in 0..self.rows {
            for k in 0..self.cols {
                let a = self.at(i, k);
                for j in 0..b.cols {
                    *out.at_mut(i, j) += a * b.at(k, j);
                }
            }
        }
        out
    }

    /// Product with a vector.
    pub fn apply(&self, x: &[C]) -> Vec<C> {
        self.data.chunks_exact(self.cols).map(|row| row.iter().zip(x).map(|(a, b)| a * b).sum()).collect()
    }

    /// Sum of `a` times this and `b` times another.
    pub fn sum(&self, a: C, other: &Self, b: C) -> Self {
        let data = self.data.iter().zip(&other.data).map(|(x, y)| x * a + y * b).collect();
        Self { data, ..*self }
    }

    /// Conjugate transpose.
    pub fn adjoint(&self) -> Self {
        let mut out = Self::zeros(self.cols, self.rows);
        for i in 0..self.rows {
            for j in 0..self.cols {
                *out.at_mut(j, i) = self.at(i, j).conj();
            }
        }
        out
    }

    /// Determinant and inverse of a square matrix by elimination with the largest pivot of each column; no inverse where a
    /// pivot is zero.
    pub fn solved(&self) -> (C, Option<Self>) {
        let n = self.rows;
        let (mut a, mut b) = (self.clone(), Self::identity(n));
        let mut det = ONE;
        for k in 0..n {
            let pivot = (k..n).max_by(|x, y| a.at(*x, k).norm().total_cmp(&a.at(*y, k).norm())).unwrap_or(k);
            let value = a.at(pivot, k);
            if value.norm() == 0.0 || !value.norm().is_finite() {
                return (if value.norm() == 0.0 { ZERO } else { value }, None);
            }
            if pivot != k {
                (0..n).for_each(|j| {
                    a.data.swap(pivot * n + j, k * n + j);
                    b.data.swap(pivot * n + j, k * n + j);
                });
                det = -det;
            }
            det *= value;
            for j in 0..n {
                *a.at_mut(k, j) /= value;
                *b.at_mut(k, j) /= value;
            }
            for i in (0..n).filter(|i| *i != k) {
                let share = a.at(i, k);
                for j in 0..n {
                    let (x, y) = (a.at(k, j), b.at(k, j));
                    *a.at_mut(i, j) -= share * x;
                    *b.at_mut(i, j) -= share * y;
                }
            }
        }
        (det, Some(b))
    }

    /// Determinant.
    pub fn determinant(&self) -> C {
        match self.rows {
            1 => self.data[0],
            2 => self.data[0] * self.data[3] - self.data[1] * self.data[2],
            _ => self.solved().0,
        }
    }

    /// Inverse; none where the matrix is singular.
    pub fn inverse(&self) -> Option<Self> {
        if self.rows == 1 {
            return (self.data[0].norm() > 0.0).then(|| Self { data: vec![self.data[0].inv()], ..*self });
        }
        if self.rows == 2 {
            let det = self.determinant();
            let d = &self.data;
            let data = || vec![d[3] / det, -d[1] / det, -d[2] / det, d[0] / det];
            return (det.norm() > 0.0 && det.norm().is_finite()).then(|| Self { data: data(), ..*self });
        }
        self.solved().1
    }

    /// Eigenvalues of a Hermitian matrix, not sorted (Jacobi rotations).
    pub fn hermitian_eigenvalues(&self) -> Vec<f64> {
        let n = self.rows;
        let mut a = self.clone();
        for _ in 0..SWEEPS {
            let off: f64 =
                (0..n).flat_map(|i| (0..i).map(move |j| (i, j))).map(|(i, j)| a.at(i, j).norm_sqr()).sum();
            let whole: f64 = a.data.iter().map(|v| v.norm_sqr()).sum();
            if !(off > 1e-30 * whole) {
                break;
            }
            for p in 0..n {
                for q in p + 1..n {
                    a.rotate(p, q);
                }
            }
        }
        (0..n).map(|k| a.at(k, k).re).collect()
    }

    /// One rotation that makes entry (p, q) of a Hermitian matrix zero.
    fn rotate(&mut self, p: usize, q: usize) {
        let apq = self.at(p, q);
        let size = apq.norm();
        if size < 1e-300 {
            return;
        }
        let phase = apq / size;
        let theta = (self.at(q, q).re - self.at(p, p).re) / (2.0 * size);
        let t = theta.signum() / (theta.abs() + theta.hypot(1.0));
        let t = if theta == 0.0 { 1.0 } else { t };
        let c = 1.0 / t.hypot(1.0);
        let s = t * c;
        for k in 0..self.rows {
            let (x, y) = (self.at(k, p), self.at(k, q));
            *self.at_mut(k, p) = x * c - y * phase.conj() * s;
            *self.at_mut(k, q) = x * phase * s + y * c;
        }
        for k in 0..self.rows {
            let (x, y) = (self.at(p, k), self.at(q, k));
            *self.at_mut(p, k) = x * c - y * phase * s;
            *self.at_mut(q, k) = x * phase.conj() * s + y * c;
        }
    }

    /// Largest singular value.
    pub fn norm(&self) -> f64 {
        if self.rows == 1 && self.cols == 1 {
            return self.data[0].norm();
        }
        if self.rows == 2 && self.cols == 2 {
            let squares: f64 = self.data.iter().map(|v| v.norm_sqr()).sum();
            let det = self.determinant().norm();
            return (0.5 * (squares + (squares * squares - 4.0 * det * det).max(0.0).sqrt())).sqrt();
        }
        let h = self.adjoint().times(self);
        h.hermitian_eigenvalues().into_iter().fold(0.0, f64::max).sqrt()
    }

    /// Eigenvalues of a square matrix: roots of its characteristic polynomial (method of Faddeev and LeVerrier), for
    /// the few rows that there are here.
    pub fn eigenvalues(&self) -> Option<Vec<C>> {
        let n = self.rows;
        let scale = self.data.iter().map(|v| v.norm()).fold(0.0, f64::max);
        if scale == 0.0 {
            return Some(vec![ZERO; n]);
        }
        let a = self.sum(Complex::new(1.0 / scale, 0.0), self, ZERO);
        let mut c = vec![ZERO; n + 1];
        c[n] = ONE;
        let mut m = Self::zeros(n, n);
        for k in 1..=n {
            m = a.times(&m);
            (0..n).for_each(|i| *m.at_mut(i, i) += c[n - k + 1]);
            let am = a.times(&m);
            let trace: C = (0..n).map(|i| am.at(i, i)).sum();
            c[n - k] = -trace / k as f64;
        }
        Some(poly::complex_roots(&c)?.into_iter().map(|v| v * scale).collect())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use dynocal_numerics::rng::Rng64;

    fn drawn(n: usize, rng: &mut Rng64) -> Matrix {
        let data = (0..n * n).map(|_| Complex::new(rng.normal(), rng.normal())).collect();
        Matrix { rows: n, cols: n, data }
    }

    #[test]
    fn inverse_determinant_eigenvalues_and_norm_agree_with_each_other() {
        let mut rng = Rng64::new(3);
        for n in 1..7 {
            let a = drawn(n, &mut rng);
            let (det, inverse) = a.solved();
            let unit = a.times(&inverse.unwrap()).sum(ONE, &Matrix::identity(n), -ONE);
            assert!(unit.data.iter().all(|v| v.norm() < 1e-10));
            let eigen = a.eigenvalues().unwrap();
            let product: C = eigen.iter().product();
            assert!((product - det).norm() < 1e-8 * (1.0 + det.norm()), "{product} {det}");
            let h = a.adjoint().times(&a);
            let found = h.hermitian_eigenvalues();
            let product: f64 = found.iter().product();
            assert!(
                (product - det.norm_sqr()).abs() < 1e-8 * (1.0 + product),
                "{product} {}",
                det.norm_sqr()
            );
            // The norm is reached: power iteration with A^H A.
            let mut x = vec![ONE; n];
            for _ in 0..3000 {
                x = h.apply(&x);
                let size = x.iter().map(|v| v.norm_sqr()).sum::<f64>().sqrt();
                x.iter_mut().for_each(|v| *v /= size);
            }
            let reached = a.apply(&x).iter().map(|v| v.norm_sqr()).sum::<f64>().sqrt();
            assert!((reached / a.norm() - 1.0).abs() < 1e-8, "{reached} {}", a.norm());
        }
    }
}
