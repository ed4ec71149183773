//! The only module that names faer.

use super::{LinalgError, check_len};
use faer::dyn_stack::{MemBuffer, MemStack};
use faer::linalg::cholesky::llt::factor::{
    LltError, LltRegularization, cholesky_in_place, cholesky_in_place_scratch,
};
use faer::linalg::matmul::matmul as general_matmul;
use faer::linalg::matmul::triangular::{BlockStructure, matmul};
use faer::linalg::qr::no_pivoting::factor::{qr_in_place, qr_in_place_scratch, recommended_block_size};
use faer::linalg::triangular_inverse::invert_lower_triangular;
use faer::linalg::triangular_solve::{solve_lower_triangular_in_place, solve_upper_triangular_in_place};
use faer::{Accum, MatMut, MatRef, Par, Side};

/// Buffers of the blocked Householder QR for one shape.
pub(super) struct BlockedQr {
    rows: usize,
    cols: usize,
    block: usize,
    coefficients: Vec<f64>,
    memory: MemBuffer,
}

impl BlockedQr {
    pub(super) fn new(rows: usize, cols: usize) -> Self {
        let block = recommended_block_size::<f64>(rows, cols);
        let scratch = qr_in_place_scratch::<f64>(rows, cols, block, Par::Seq, Default::default());
        Self { rows, cols, block, coefficients: vec![0.0; block * cols], memory: MemBuffer::new(scratch) }
    }

    /// Householder QR of the column-major `a` (rows x cols, rows >= cols); R stands in its upper triangle.
    pub(super) fn factor(&mut self, a: &mut [f64]) {
        let a = MatMut::from_column_major_slice_mut(a, self.rows, self.cols);
        let h = MatMut::from_column_major_slice_mut(&mut self.coefficients, self.block, self.cols);
        qr_in_place(a, h, Par::Seq, MemStack::new(&mut self.memory), Default::default());
        crate::vector_state::clear();
    }
}

/// Fills the upper triangle of `gram` (cols x cols, row-major) with that of `A'A`, A row-major (rows x cols).
/// No allocation of its own.
///
/// # Errors
/// [`LinalgError::Shape`] when a slice has the wrong length.
pub fn gram_upper(a: &[f64], rows: usize, cols: usize, gram: &mut [f64]) -> Result<(), LinalgError> {
    gram_into(1.0, a, rows, cols, gram, Accum::Replace)
}

/// Adds `A'A` to the upper triangle of `gram`, as [`gram_upper`].
///
/// # Errors
/// [`LinalgError::Shape`] when a slice has the wrong length.
pub fn gram_upper_add(a: &[f64], rows: usize, cols: usize, gram: &mut [f64]) -> Result<(), LinalgError> {
    gram_into(1.0, a, rows, cols, gram, Accum::Add)
}

/// Symmetric rank update of the upper triangle: `C += alpha A'A`, A row-major (rows x cols), C (cols x cols), as
/// [`gram_upper_add`].
///
/// # Errors
/// [`LinalgError::Shape`] when a slice has the wrong length.
///
/// ```
/// use dynocal_numerics::linalg::symmetric_update;
/// let mut c = [1.0, 0.0, f64::NAN, 1.0];
/// symmetric_update(-2.0, &[1.0, 3.0], 1, 2, &mut c).unwrap();
/// assert_eq!((c[0], c[1], c[3]), (-1.0, -6.0, -17.0));
/// ```
pub fn symmetric_update(
    alpha: f64,
    a: &[f64],
    rows: usize,
    cols: usize,
    c: &mut [f64],
) -> Result<(), LinalgError> {
    gram_into(alpha, a, rows, cols, c, Accum::Add)
}

fn gram_into(
    alpha: f64,
    a: &[f64],
    rows: usize,
    cols: usize,
    gram: &mut [f64],
    accumulate: Accum,
) -> Result<(), LinalgError> {
    check_len("matrix", a.len(), rows * cols)?;
    check_len("Gram matrix", gram.len(), cols * cols)?;
    if cols == 0 || rows == 0 {
        if accumulate == Accum::Replace {
            gram.fill(0.0);
        }
        return Ok(());
    }
    let a = MatRef::from_row_major_slice(a, rows, cols);
    // The upper triangle row by row is the lower triangle column by column.
    matmul(
        MatMut::from_column_major_slice_mut(gram, cols, cols),
        BlockStructure::TriangularLower,
        accumulate,
        a.transpose(),
        BlockStructure::Rectangular,
        a,
        BlockStructure::Rectangular,
        alpha,
        Par::Seq,
    );
    crate::vector_state::clear();
    Ok(())
}

/// A row-major matrix as a factor of a product, as it stands or transposed.
#[derive(Clone, Copy, Debug)]
pub struct Factor<'a> {
    data: &'a [f64],
    rows: usize,
    cols: usize,
    transposed: bool,
}

impl<'a> Factor<'a> {
    /// The matrix as it stands (rows x cols).
    pub fn new(data: &'a [f64], rows: usize, cols: usize) -> Self {
        Self { data, rows, cols, transposed: false }
    }

    /// The transpose of what stands there as rows x cols.
    pub fn transposed(data: &'a [f64], rows: usize, cols: usize) -> Self {
        Self { data, rows, cols, transposed: true }
    }

    fn shape(&self) -> (usize, usize) {
        if self.transposed { (self.cols, self.rows) } else { (self.rows, self.cols) }
    }
}

/// Blocked product `out = alpha A B`, or `out += alpha A B` with `add`; `out` row-major (rows of A x columns of B).
///
/// # Errors
/// [`LinalgError::Shape`] when a slice has the wrong length or the factors do not fit.
///
/// ```
/// use dynocal_numerics::linalg::{Factor, product};
/// let (a, b, mut c) = ([1.0, 2.0], [3.0, 4.0], [0.0; 4]);
/// // A column times a row.
/// product(2.0, Factor::transposed(&a, 1, 2), Factor::new(&b, 1, 2), false, &mut c).unwrap();
/// assert_eq!(c, [6.0, 8.0, 12.0, 16.0]);
/// ```
pub fn product(
    alpha: f64,
    a: Factor<'_>,
    b: Factor<'_>,
    add: bool,
    out: &mut [f64],
) -> Result<(), LinalgError> {
    check_len("first factor", a.data.len(), a.rows * a.cols)?;
    check_len("second factor", b.data.len(), b.rows * b.cols)?;
    let ((m, inner), (other, n)) = (a.shape(), b.shape());
    check_len("rows of the second factor", other, inner)?;
    check_len("product", out.len(), m * n)?;
    if m * n == 0 || inner == 0 {
        if !add {
            out.fill(0.0);
        }
        return Ok(());
    }
    let left = MatRef::from_row_major_slice(a.data, a.rows, a.cols);
    let right = MatRef::from_row_major_slice(b.data, b.rows, b.cols);
    let accumulate = if add { Accum::Add } else { Accum::Replace };
    let out = MatMut::from_row_major_slice_mut(out, m, n);
    match (a.transposed, b.transposed) {
        (false, false) => general_matmul(out, accumulate, left, right, alpha, Par::Seq),
        (true, false) => general_matmul(out, accumulate, left.transpose(), right, alpha, Par::Seq),
        (false, true) => general_matmul(out, accumulate, left, right.transpose(), alpha, Par::Seq),
        (true, true) => {
            general_matmul(out, accumulate, left.transpose(), right.transpose(), alpha, Par::Seq);
        }
    }
    crate::vector_state::clear();
    Ok(())
}

/// Upper triangle of the inverse of an upper triangular R (n x n) into `inverse`, by blocks; what stands below its diagonal
/// stays as it was. No allocation of its own.
///
/// # Errors
/// [`LinalgError::Shape`]; [`LinalgError::Pivot`] on a zero or non-finite diagonal entry.
pub fn inverse_upper(r: &[f64], n: usize, inverse: &mut [f64]) -> Result<(), LinalgError> {
    check_factor("inverse_upper", r, n)?;
    check_len("inverse", inverse.len(), n * n)?;
    if n == 0 {
        return Ok(());
    }
    // R row by row is L = R' column by column.
    let lower = MatRef::from_column_major_slice(r, n, n);
    invert_lower_triangular(MatMut::from_column_major_slice_mut(inverse, n, n), lower, Par::Seq);
    crate::vector_state::clear();
    Ok(())
}

/// Upper triangle of `X X'` into `out` (n x n) for an upper triangular X. No allocation of its own.
///
/// # Errors
/// [`LinalgError::Shape`] when a slice has the wrong length.
///
/// ```
/// use dynocal_numerics::linalg::upper_gram;
/// let mut out = [0.0; 4];
/// upper_gram(&[1.0, 2.0, f64::NAN, 3.0], 2, &mut out).unwrap();
/// assert_eq!((out[0], out[1], out[3]), (5.0, 6.0, 9.0));
/// ```
pub fn upper_gram(x: &[f64], n: usize, out: &mut [f64]) -> Result<(), LinalgError> {
    check_len("X", x.len(), n * n)?;
    check_len("product", out.len(), n * n)?;
    if n == 0 {
        return Ok(());
    }
    let lower = MatRef::from_column_major_slice(x, n, n);
    matmul(
        MatMut::from_column_major_slice_mut(out, n, n),
        BlockStructure::TriangularLower,
        Accum::Replace,
        lower.transpose(),
        BlockStructure::TriangularUpper,
        lower,
        BlockStructure::TriangularLower,
        1.0,
        Par::Seq,
    );
    crate::vector_state::clear();
    Ok(())
}

/// Upper triangle of `(R'R)^-1` into `inverse` (n x n) from the upper triangular factor R of [`super::cholesky`];
/// `work` (n x n) is overwritten. No allocation of its own.
///
/// # Errors
/// [`LinalgError::Shape`]; [`LinalgError::Pivot`] on a zero or non-finite diagonal entry.
pub fn cholesky_inverse(
    r: &[f64],
    n: usize,
    work: &mut [f64],
    inverse: &mut [f64],
) -> Result<(), LinalgError> {
    inverse_upper(r, n, work)?;
    upper_gram(work, n, inverse)
}

/// Solves `R X = B` in place for k right-hand sides; `b` is n x k row-major, R upper triangular (n x n).
///
/// # Errors
/// [`LinalgError::Shape`]; [`LinalgError::Pivot`] on a zero or non-finite diagonal entry.
pub fn solve_upper_many(r: &[f64], n: usize, b: &mut [f64], k: usize) -> Result<(), LinalgError> {
    check_factor("solve_upper_many", r, n)?;
    check_len("right-hand sides", b.len(), n * k)?;
    if n * k > 0 {
        let upper = MatRef::from_row_major_slice(r, n, n);
        solve_upper_triangular_in_place(upper, MatMut::from_row_major_slice_mut(b, n, k), Par::Seq);
        crate::vector_state::clear();
    }
    Ok(())
}

/// Solves `R' X = B` in place for k right-hand sides, as [`solve_upper_many`].
///
/// # Errors
/// [`LinalgError::Shape`]; [`LinalgError::Pivot`] on a zero or non-finite diagonal entry.
pub fn solve_upper_transposed_many(r: &[f64], n: usize, b: &mut [f64], k: usize) -> Result<(), LinalgError> {
    check_factor("solve_upper_transposed_many", r, n)?;
    check_len("right-hand sides", b.len(), n * k)?;
    if n * k > 0 {
        let lower = MatRef::from_column_major_slice(r, n, n);
        solve_lower_triangular_in_place(lower, MatMut::from_row_major_slice_mut(b, n, k), Par::Seq);
        crate::vector_state::clear();
    }
    Ok(())
}

fn check_factor(what: &'static str, r: &[f64], n: usize) -> Result<(), LinalgError> {
    check_len("R", r.len(), n * n)?;
    match (0..n).map(|i| r[i * n + i]).position(|d| d == 0.0 || !d.is_finite()) {
        Some(index) => Err(LinalgError::Pivot { what, index, value: r[index * n + index] }),
        None => Ok(()),
    }
}

/// Upper triangular R with R'R = a in place, as [`super::cholesky`].
pub(super) fn blocked_cholesky(a: &mut [f64], n: usize) -> Result<(), LinalgError> {
    let scratch = cholesky_in_place_scratch::<f64>(n, Par::Seq, Default::default());
    let mut memory = MemBuffer::new(scratch);
    // The upper triangle row by row is the lower triangle column by column.
    let done = cholesky_in_place(
        MatMut::from_column_major_slice_mut(a, n, n),
        LltRegularization::default(),
        Par::Seq,
        MemStack::new(&mut memory),
        Default::default(),
    );
    crate::vector_state::clear();
    match done {
        Ok(_) => Ok(()),
        Err(LltError::NonPositivePivot { index }) => {
            Err(LinalgError::Pivot { what: "cholesky", index, value: a[index * n + index] })
        }
    }
}

/// Eigenvalues of a symmetric matrix (n x n, the lower triangle is read), ascending.
///
/// # Errors
/// [`LinalgError::NotFinite`] on a non-finite entry or when the iteration does not converge.
pub fn symmetric_eigenvalues(a: &[f64], n: usize) -> Result<Vec<f64>, LinalgError> {
    check_len("matrix", a.len(), n * n)?;
    if let Some(index) = a.iter().position(|v| !v.is_finite()) {
        return Err(LinalgError::NotFinite { what: "symmetric_eigenvalues", index });
    }
    if n == 0 {
        return Ok(Vec::new());
    }
    let mut values = MatRef::from_row_major_slice(a, n, n)
        .self_adjoint_eigenvalues(Side::Lower)
        .map_err(|_| LinalgError::NotFinite { what: "symmetric_eigenvalues", index: 0 })?;
    crate::vector_state::clear();
    values.sort_by(f64::total_cmp);
    Ok(values)
}
