//! Triangular matrices and the Cholesky factor. Upper triangular R (n x n, row-major); what stands below its
//! diagonal is never read.

use super::backend::blocked_cholesky;
use super::{LinalgError, check_len, dot};

/// Size above which the blocked backend wins over the plain loops.
const BLOCKED_FROM: usize = 48;

/// Solves `R x = b` in place (`x` holds b on entry).
///
/// # Errors
/// [`LinalgError::Pivot`] on a zero or non-finite diagonal entry.
pub fn solve_upper(r: &[f64], n: usize, x: &mut [f64]) -> Result<(), LinalgError> {
    check_len("R", r.len(), n * n)?;
    check_len("right-hand side", x.len(), n)?;
    for i in (0..n).rev() {
        let row = &r[i * n..(i + 1) * n];
        let d = pivot("solve_upper", i, row[i])?;
        x[i] = (x[i] - dot(&row[i + 1..], &x[i + 1..])) / d;
    }
    Ok(())
}

/// Solves `R' x = b` in place (`x` holds b on entry).
///
/// # Errors
/// [`LinalgError::Pivot`] on a zero or non-finite diagonal entry.
pub fn solve_upper_transposed(r: &[f64], n: usize, x: &mut [f64]) -> Result<(), LinalgError> {
    check_len("R", r.len(), n * n)?;
    check_len("right-hand side", x.len(), n)?;
    for i in 0..n {
        let row = &r[i * n..(i + 1) * n];
        let xi = x[i] / pivot("solve_upper_transposed", i, row[i])?;
        x[i] = xi;
        super::axpy(-xi, &row[i + 1..], &mut x[i + 1..]);
    }
    Ok(())
}

/// `R x` for an upper triangular R.
pub fn upper_times(r: &[f64], n: usize, x: &[f64], out: &mut [f64]) {
    for i in 0..n {
        out[i] = dot(&r[i * n + i..(i + 1) * n], &x[i..n]);
    }
}

/// Inverse of an upper triangular R into `inv` (n x n, upper triangular, zeros below).
///
/// # Errors
/// [`LinalgError::Pivot`] on a zero or non-finite diagonal entry.
pub fn invert_upper(r: &[f64], n: usize, inv: &mut [f64]) -> Result<(), LinalgError> {
    check_len("R", r.len(), n * n)?;
    check_len("inverse", inv.len(), n * n)?;
    inv.fill(0.0);
    // Row i of the inverse from the rows below it: X_i = (e_i - R_i,i+1.. X_i+1..) / R_ii.
    for i in (0..n).rev() {
        let d = pivot("invert_upper", i, r[i * n + i])?;
        let (top, below) = inv.split_at_mut((i + 1) * n);
        let row = &mut top[i * n..];
        for k in i + 1..n {
            let start = (k - i - 1) * n;
            super::axpy(-r[i * n + k] / d, &below[start + k..start + n], &mut row[k..]);
        }
        row[i] = 1.0 / d;
    }
    Ok(())
}

/// Upper triangular R with `R'R = a` for a symmetric positive definite `a` (n x n), in place. Only the upper
/// triangle of `a` is read; below the diagonal the result is left as it was.
///
/// # Errors
/// [`LinalgError::Pivot`] when `a` is not numerically positive definite.
pub fn cholesky(a: &mut [f64], n: usize) -> Result<(), LinalgError> {
    check_len("matrix", a.len(), n * n)?;
    if n >= BLOCKED_FROM {
        return blocked_cholesky(a, n);
    }
    for i in 0..n {
        let (done, rest) = a.split_at_mut((i + 1) * n);
        let row = &mut done[i * n..];
        let d = row[i];
        if !(d > 0.0 && d.is_finite()) {
            return Err(LinalgError::Pivot { what: "cholesky", index: i, value: d });
        }
        let root = d.sqrt();
        row[i..].iter_mut().for_each(|v| *v /= root);
        // Right-looking: the updates run along rows, which are contiguous.
        for k in i + 1..n {
            let start = (k - i - 1) * n;
            let factor = row[k];
            if factor != 0.0 {
                super::axpy(-factor, &row[k..], &mut rest[start + k..start + n]);
            }
        }
    }
    Ok(())
}

/// `log det(A'A) = 2 sum log |R_ii|` from the R factor of A; minus infinity for a singular R.
pub fn log_det_gram(r: &[f64], n: usize) -> f64 {
    2.0 * (0..n).map(|i| r[i * n + i].abs().ln()).sum::<f64>()
}

fn pivot(what: &'static str, index: usize, value: f64) -> Result<f64, LinalgError> {
    if value != 0.0 && value.is_finite() { Ok(value) } else { Err(LinalgError::Pivot { what, index, value }) }
}
