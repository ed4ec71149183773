//! Householder QR: the R factor of a tall matrix, its column-pivoted form, least squares.

use super::backend::BlockedQr;
use super::{LinalgError, axpy, check_len, dot, norm2};

/// Above this number of entries the blocked backend wins over the plain loops (measured, see the benches).
const BLOCKED_FROM_ENTRIES: usize = 12_000;

/// R factor of tall matrices, with buffers that are reused from call to call of the same shape.
///
/// ```
/// use dynocal_numerics::linalg::QrWork;
/// // [[3, 1], [4, 2]] has R = [[5, 2.2], [0, 0.4]].
/// let mut r = [0.0; 4];
/// QrWork::new(2, 2).r_factor(&[3.0, 1.0, 4.0, 2.0], &mut r).unwrap();
/// assert!((r[0] - 5.0).abs() < 1e-14 && (r[1] - 2.2).abs() < 1e-14);
/// assert!(r[2] == 0.0 && (r[3] - 0.4).abs() < 1e-14);
/// ```
pub struct QrWork {
    rows: usize,
    cols: usize,
    /// Rows of the buffer: at least as many as columns, missing ones are zero.
    padded: usize,
    columns: Vec<f64>,
    blocked: Option<BlockedQr>,
}

impl QrWork {
    /// Buffers for matrices of `rows x cols`.
    pub fn new(rows: usize, cols: usize) -> Self {
        let padded = rows.max(cols);
        let blocked = (padded * cols >= BLOCKED_FROM_ENTRIES).then(|| BlockedQr::new(padded, cols));
        Self { rows, cols, padded, columns: vec![0.0; padded * cols], blocked }
    }

    /// Upper triangular R (cols x cols, row-major, diagonal >= 0, zeros below) with `R'R = A'A`, A row-major
    /// (rows x cols). No allocation.
    ///
    /// # Errors
    /// [`LinalgError::Shape`] when a slice does not have the shape of this work space.
    pub fn r_factor(&mut self, a: &[f64], r: &mut [f64]) -> Result<(), LinalgError> {
        check_len("matrix", a.len(), self.rows * self.cols)?;
        check_len("R", r.len(), self.cols * self.cols)?;
        self.transpose_in(a);
        match &mut self.blocked {
            Some(backend) => backend.factor(&mut self.columns),
            None => householder(&mut self.columns, self.padded, self.cols),
        }
        let (n, m) = (self.cols, self.padded);
        for i in 0..n {
            let sign = if self.columns[i * m + i] < 0.0 { -1.0 } else { 1.0 };
            r[i * n..i * n + i].fill(0.0);
            for j in i..n {
                r[i * n + j] = sign * self.columns[j * m + i];
            }
        }
        Ok(())
    }

    /// Copies a row-major matrix into the column-major buffer.
    fn transpose_in(&mut self, a: &[f64]) {
        let (m, n) = (self.padded, self.cols);
        if n == 0 {
            return;
        }
        if self.rows < m {
            self.columns.fill(0.0);
        }
        for (i, row) in a.chunks_exact(n).enumerate() {
            for (j, v) in row.iter().enumerate() {
                self.columns[j * m + i] = *v;
            }
        }
    }
}

/// Householder QR in place, column-major (m x n, m >= n); only R (upper triangle) is meaningful afterwards.
fn householder(a: &mut [f64], m: usize, n: usize) {
    for k in 0..n.min(m) {
        let (left, right) = a.split_at_mut((k + 1) * m);
        let v = &mut left[k * m + k..];
        let Some((beta, tau)) = reflector(v) else { continue };
        for column in right.chunks_exact_mut(m) {
            let c = &mut column[k..];
            let w = tau * dot(v, c);
            axpy(-w, v, c);
        }
        v[0] = beta;
    }
}

/// Turns `v` into the Householder vector with `(I - tau v v') x = beta e_1`; `None` for x = 0.
fn reflector(v: &mut [f64]) -> Option<(f64, f64)> {
    let norm = norm2(v);
    if norm == 0.0 {
        return None;
    }
    // The sign that avoids cancellation in v_0 = x_0 - beta.
    let beta = if v[0] > 0.0 { -norm } else { norm };
    // Scaled so that v_0 = 1: v'v then neither overflows nor underflows.
    let head = v[0] - beta;
    let tau = -head / beta;
    v[0] = 1.0;
    v[1..].iter_mut().for_each(|x| *x /= head);
    Some((beta, tau))
}

/// Column-pivoted QR of a matrix, in the scaling in which every column has norm one.
#[derive(Clone, Debug, PartialEq)]
pub struct PivotedR {
    /// Numerical rank.
    pub rank: usize,
    /// Column order: `order[k]` is the column taken at step k.
    pub order: Vec<usize>,
    /// Columns that depend on the others to within the tolerance, ascending.
    pub dependent: Vec<usize>,
    /// R of the permuted, unit-norm columns (n x n, row-major).
    pub r: Vec<f64>,
    /// Column norms (n) that were divided out; a zero column has scale 1.
    pub scale: Vec<f64>,
}

/// Column-pivoted QR with rank report of `a` (rows x cols, row-major).
///
/// A column is dependent when, after unit scaling of all columns, its part outside the span of the columns
/// taken before it is shorter than `tolerance` (0 means `max(rows, cols) eps`).
///
/// # Errors
/// [`LinalgError::Shape`], [`LinalgError::NotFinite`].
///
/// ```
/// use dynocal_numerics::linalg::pivoted_r;
/// // The third column is the sum of the first two.
/// let a = [1.0, 0.0, 1.0, 0.0, 1.0, 1.0, 1.0, 1.0, 2.0, 1.0, -1.0, 0.0];
/// let p = pivoted_r(&a, 4, 3, 0.0).unwrap();
/// assert_eq!((p.rank, p.dependent.len()), (2, 1));
/// ```
pub fn pivoted_r(a: &[f64], rows: usize, cols: usize, tolerance: f64) -> Result<PivotedR, LinalgError> {
    let r = finite_r(a, rows, cols)?;
    let (pivoted, _) = pivoted_from_r(&r, cols, cols, rows, tolerance);
    Ok(pivoted)
}

/// Solution of a linear least-squares problem.
#[derive(Clone, Debug, PartialEq)]
pub struct LeastSquaresFit {
    /// Coefficients (n); zero for dependent columns (basic solution).
    pub x: Vec<f64>,
    /// `|A x - b|^2` (without the ridge term).
    pub residual_sum_squares: f64,
    /// The pivoted factorisation with rank and dependent columns.
    pub factor: PivotedR,
}

/// Minimises `|A x - b|^2 + ridge |x|^2`, A row-major (rows x cols).
///
/// Householder QR of `[A b; sqrt(ridge) I 0]`, then column pivoting on its R factor in unit column scaling, so
/// that the rank decision does not depend on the units of the columns.
///
/// # Errors
/// [`LinalgError::Shape`], [`LinalgError::NotFinite`].
///
/// ```
/// use dynocal_numerics::linalg::least_squares;
/// // y = 1 + 2 t through three points.
/// let fit = least_squares(&[1.0, 0.0, 1.0, 1.0, 1.0, 2.0], 3, 2, &[1.0, 3.0, 5.0], 0.0).unwrap();
/// assert!((fit.x[0] - 1.0).abs() < 1e-14 && (fit.x[1] - 2.0).abs() < 1e-14);
/// assert!(fit.residual_sum_squares < 1e-28);
/// ```
pub fn least_squares(
    a: &[f64],
    rows: usize,
    cols: usize,
    b: &[f64],
    ridge: f64,
) -> Result<LeastSquaresFit, LinalgError> {
    check_len("matrix", a.len(), rows * cols)?;
    check_len("right-hand side", b.len(), rows)?;
    let extra = if ridge > 0.0 { cols } else { 0 };
    let width = cols + 1;
    let mut augmented = Vec::with_capacity((rows + extra) * width);
    for i in 0..rows {
        augmented.extend_from_slice(&a[i * cols..(i + 1) * cols]);
        augmented.push(b[i]);
    }
    augmented.resize((rows + extra) * width, 0.0);
    for k in 0..extra {
        augmented[(rows + k) * width + k] = ridge.sqrt();
    }
    let r = finite_r(&augmented, rows + extra, width)?;
    let (factor, rotated) = pivoted_from_r(&r, width, cols, rows, 0.0);
    let mut x = vec![0.0; cols];
    let mut z = rotated[..factor.rank].to_vec();
    for i in (0..factor.rank).rev() {
        let row = &factor.r[i * cols..(i + 1) * cols];
        z[i] = (z[i] - dot(&row[i + 1..factor.rank], &z[i + 1..])) / row[i];
        x[factor.order[i]] = z[i] / factor.scale[factor.order[i]];
    }
    let residual_sum_squares =
        (0..rows).map(|i| (dot(&a[i * cols..(i + 1) * cols], &x) - b[i]).powi(2)).sum();
    Ok(LeastSquaresFit { x, residual_sum_squares, factor })
}

/// R factor after a check that all entries are finite.
fn finite_r(a: &[f64], rows: usize, cols: usize) -> Result<Vec<f64>, LinalgError> {
    check_len("matrix", a.len(), rows * cols)?;
    if let Some(index) = a.iter().position(|v| !v.is_finite()) {
        return Err(LinalgError::NotFinite { what: "matrix", index });
    }
    let mut r = vec![0.0; cols * cols];
    QrWork::new(rows, cols).r_factor(a, &mut r)?;
    Ok(r)
}

/// Pivots the first `n` of the `width` columns of an R factor; also returns the rotated last column
/// (meaningful when `width > n`).
pub(super) fn pivoted_from_r(
    r: &[f64],
    width: usize,
    n: usize,
    rows: usize,
    tolerance: f64,
) -> (PivotedR, Vec<f64>) {
    let m = width;
    // Column-major copy with unit columns; the right-hand side (column n, if any) keeps its scale.
    let mut c = vec![0.0; m * width];
    let mut scale = vec![1.0; n];
    for j in 0..width {
        let column = &mut c[j * m..(j + 1) * m];
        for i in 0..=j {
            column[i] = r[i * width + j];
        }
        if j < n {
            let norm = norm2(column);
            if norm > 0.0 {
                scale[j] = norm;
                column.iter_mut().for_each(|v| *v /= norm);
            }
        }
    }
    let tolerance = if tolerance > 0.0 { tolerance } else { rows.max(n) as f64 * f64::EPSILON };
    let mut order: Vec<usize> = (0..n).collect();
    let mut rank = n;
    for k in 0..n {
        // Norms are recomputed, not downdated: n is small and downdating loses digits.
        let (mut best, mut best_norm) = (k, -1.0);
        for j in k..n {
            let norm = norm2(&c[j * m + k..(j + 1) * m]);
            if norm > best_norm {
                (best, best_norm) = (j, norm);
            }
        }
        if best_norm <= tolerance {
            rank = k;
            break;
        }
        order.swap(k, best);
        for i in 0..m {
            c.swap(k * m + i, best * m + i);
        }
        let (left, right) = c.split_at_mut((k + 1) * m);
        let v = &mut left[k * m + k..];
        let Some((beta, tau)) = reflector(v) else { continue };
        for column in right.chunks_exact_mut(m) {
            let w = tau * dot(v, &column[k..]);
            axpy(-w, v, &mut column[k..]);
        }
        v.fill(0.0);
        v[0] = beta;
    }
    let mut pivoted = vec![0.0; n * n];
    for i in 0..rank {
        for j in i..n {
            pivoted[i * n + j] = c[j * m + i];
        }
    }
    let mut dependent = order[rank..].to_vec();
    dependent.sort_unstable();
    let rotated = if width > n { c[n * m..].to_vec() } else { Vec::new() };
    (PivotedR { rank, order, dependent, r: pivoted, scale }, rotated)
}
