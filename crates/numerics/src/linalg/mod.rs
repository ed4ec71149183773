//! Dense linear algebra on plain row-major slices.
//!
//! ```text
//! A = Q R          R factor of a tall matrix (QrWork), all the rest works on R (n x n)
//! min |A x - b|^2 + ridge |x|^2      least_squares, with rank report
//! log det(A'A) = 2 sum log |R_ii|    log_det_gram
//! ```
//!
//! Every matrix is a row-major slice: entry (i, j) of an `m x n` matrix is `a[i * n + j]`. The backend (faer,
//! always sequential: parallelism is one level up) is named in the private module `backend` only.
//!
//! Reference: G. H. Golub, C. F. Van Loan, Matrix Computations, 4th ed., sections 5.2 and 5.4.

mod backend;
mod gathered;
mod householder;
mod triangular;

pub use backend::{
    Factor, cholesky_inverse, gram_upper, gram_upper_add, inverse_upper, product, solve_upper_many,
    solve_upper_transposed_many, symmetric_eigenvalues, symmetric_update, upper_gram,
};
pub use gathered::{GramRows, QrRows, pivoted_from_gram};
pub use householder::{LeastSquaresFit, PivotedR, QrWork, least_squares, pivoted_r};
pub use triangular::{
    cholesky, invert_upper, log_det_gram, solve_upper, solve_upper_transposed, upper_times,
};

/// A dense computation could not be done.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum LinalgError {
    /// A slice does not hold the stated number of entries.
    #[error("{what}: found {found} entries, expected {expected}")]
    Shape {
        /// Which argument.
        what: &'static str,
        /// Entries found.
        found: usize,
        /// Entries expected.
        expected: usize,
    },
    /// A pivot is zero, negative where it must be positive, or not finite.
    #[error("{what}: pivot {index} is {value}")]
    Pivot {
        /// Which computation.
        what: &'static str,
        /// Index of the pivot.
        index: usize,
        /// Its value.
        value: f64,
    },
    /// An entry is not finite.
    #[error("{what}: entry {index} is not finite")]
    NotFinite {
        /// Which argument.
        what: &'static str,
        /// Index in the slice.
        index: usize,
    },
}

/// `found == expected`, else a [`LinalgError::Shape`].
pub(crate) fn check_len(what: &'static str, found: usize, expected: usize) -> Result<(), LinalgError> {
    if found == expected { Ok(()) } else { Err(LinalgError::Shape { what, found, expected }) }
}

/// Scalar product. Eight partial sums, so that the compiler can keep them in vector registers.
pub fn dot(a: &[f64], b: &[f64]) -> f64 {
    let n = a.len().min(b.len());
    let (a, b) = (&a[..n], &b[..n]);
    let mut s = [0.0; 8];
    let (ca, cb) = (a.chunks_exact(8), b.chunks_exact(8));
    let tail: f64 = ca.remainder().iter().zip(cb.remainder()).map(|(x, y)| x * y).sum();
    for (x, y) in ca.zip(cb) {
        for k in 0..8 {
            s[k] += x[k] * y[k];
        }
    }
    ((s[0] + s[4]) + (s[1] + s[5])) + ((s[2] + s[6]) + (s[3] + s[7])) + tail
}

/// `y += alpha x`.
pub fn axpy(alpha: f64, x: &[f64], y: &mut [f64]) {
    for (yi, xi) in y.iter_mut().zip(x) {
        *yi += alpha * xi;
    }
}

/// Euclidean norm, safe against overflow and underflow of the squares.
pub fn norm2(x: &[f64]) -> f64 {
    let s = dot(x, x);
    if s.is_finite() && s > 1e-280 {
        return s.sqrt();
    }
    let big = norm_inf(x);
    if big == 0.0 || !big.is_finite() {
        return big;
    }
    big * x.iter().map(|v| (v / big).powi(2)).sum::<f64>().sqrt()
}

/// Largest absolute entry; NaN when an entry is NaN.
pub fn norm_inf(x: &[f64]) -> f64 {
    x.iter().fold(0.0, |m: f64, v| if v.abs() > m || v.is_nan() { v.abs() } else { m })
}
