//! The only module that names faer.

use super::{LinalgError, check_len};
use faer::dyn_stack::{MemBuffer, MemStack};
use faer::linalg::cholesky::llt::factor::{
    LltError, LltRegularization, cholesky_in_place, cholesky_in_place_scratch,
};
use faer::linalg::matmul::triangular::{BlockStructure, matmul};
use faer::linalg::qr::no_pivoting::factor::{qr_in_place, qr_in_place_scratch, recommended_block_size};
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
    gram_into(a, rows, cols, gram, Accum::Replace)
}

/// Adds `A'A` to the upper triangle of `gram`, as [`gram_upper`].
///
/// # Errors
/// [`LinalgError::Shape`] when a slice has the wrong length.
pub fn gram_upper_add(a: &[f64], rows: usize, cols: usize, gram: &mut [f64]) -> Result<(), LinalgError> {
    gram_into(a, rows, cols, gram, Accum::Add)
}

fn gram_into(
    a: &[f64],
    rows: usize,
    cols: usize,
    gram: &mut [f64],
    accumulate: Accum,
) -> Result<(), LinalgError> {
    check_len("matrix", a.len(), rows * cols)?;
    check_len("Gram matrix", gram.len(), cols * cols)?;
    if cols == 0 {
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
        1.0,
        Par::Seq,
    );
    crate::vector_state::clear();
    Ok(())
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
