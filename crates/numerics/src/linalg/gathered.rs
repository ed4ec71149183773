//! Pivoted factors of tall matrices that are never stored whole: their rows come in blocks.

use super::householder::pivoted_from_r;
use super::{LinalgError, PivotedR, QrWork, axpy, check_len, gram_upper};

/// Squared part of a unit column outside the span of the others below which J'J has lost more than half of the digits.
const GRAM_FLOOR: f64 = 1e-9;
/// Rows that are gathered before they are folded into R, in multiples of the columns.
const FOLD: usize = 8;

/// Column-pivoted factor in unit column scaling from the upper triangle of `gram` = A'A (n x n, row-major) by
/// Cholesky with diagonal pivoting; `None` when a column lies so near to the span of the others that A'A does not keep
/// enough digits, and A itself must be factored.
///
/// ```
/// use dynocal_numerics::linalg::pivoted_from_gram;
/// let f = pivoted_from_gram(&[4.0, 1.0, f64::NAN, 9.0], 2).unwrap();
/// assert_eq!((f.rank, f.scale), (2, vec![2.0, 3.0]));
/// assert!(pivoted_from_gram(&[1.0, 1.0, f64::NAN, 1.0 + 1e-14], 2).is_none());
/// ```
pub fn pivoted_from_gram(gram: &[f64], n: usize) -> Option<PivotedR> {
    let scale: Vec<f64> = (0..n).map(|k| gram[k * n + k].sqrt()).collect();
    if !scale.iter().all(|s| *s > 0.0 && s.is_finite()) {
        return None;
    }
    // Rows of the remaining symmetric matrix, both triangles: n is small.
    let mut s = vec![0.0; n * n];
    for i in 0..n {
        for j in i..n {
            let v = gram[i * n + j] / (scale[i] * scale[j]);
            (s[i * n + j], s[j * n + i]) = (v, v);
        }
    }
    let mut order: Vec<usize> = (0..n).collect();
    let mut r = vec![0.0; n * n];
    for k in 0..n {
        let best = (k..n).fold(k, |b, j| if s[j * n + j] > s[b * n + b] { j } else { b });
        let pivot = s[best * n + best];
        if pivot.is_nan() || pivot <= GRAM_FLOOR {
            return None;
        }
        swap_symmetric(&mut s, n, k, best);
        for i in 0..k {
            r.swap(i * n + k, i * n + best);
        }
        order.swap(k, best);
        let root = s[k * n + k].sqrt();
        r[k * n + k] = root;
        for j in k + 1..n {
            r[k * n + j] = s[k * n + j] / root;
        }
        for i in k + 1..n {
            let (row, factor) = (&r[k * n + k + 1..(k + 1) * n], r[k * n + i]);
            axpy(-factor, row, &mut s[i * n + k + 1..(i + 1) * n]);
        }
    }
    Some(PivotedR { rank: n, order, dependent: Vec::new(), r, scale })
}

fn swap_symmetric(s: &mut [f64], n: usize, a: usize, b: usize) {
    if a == b {
        return;
    }
    for j in 0..n {
        s.swap(a * n + j, b * n + j);
    }
    for i in 0..n {
        s.swap(i * n + a, i * n + b);
    }
}

/// A'A of rows that come in blocks.
#[derive(Clone, Debug)]
pub struct GramRows {
    n: usize,
    block: Vec<f64>,
    /// Upper triangle of A'A so far (n x n, row-major).
    pub gram: Vec<f64>,
}

impl GramRows {
    /// Of matrices with `n` columns.
    pub fn new(n: usize) -> Self {
        Self { n, block: vec![0.0; n * n], gram: vec![0.0; n * n] }
    }

    /// Adds rows (row-major).
    ///
    /// # Errors
    /// [`LinalgError::Shape`] when they are not whole rows.
    pub fn push(&mut self, rows: &[f64]) -> Result<(), LinalgError> {
        gram_upper(rows, rows.len() / self.n.max(1), self.n, &mut self.block)?;
        for i in 0..self.n {
            for j in i..self.n {
                self.gram[i * self.n + j] += self.block[i * self.n + j];
            }
        }
        Ok(())
    }
}

/// R factor of rows that come in blocks: `R <- R of [R; block]`. Memory for a few times n x n numbers.
pub struct QrRows {
    n: usize,
    rows: usize,
    filled: usize,
    stacked: Vec<f64>,
    r: Vec<f64>,
    work: QrWork,
}

impl QrRows {
    /// Of matrices with `n` columns.
    pub fn new(n: usize) -> Self {
        let room = (FOLD + 1) * n.max(1);
        Self {
            n,
            rows: 0,
            filled: n,
            stacked: vec![0.0; room * n],
            r: vec![0.0; n * n],
            work: QrWork::new(room, n),
        }
    }

    /// Adds rows (row-major).
    ///
    /// # Errors
    /// [`LinalgError::Shape`] when they are not whole rows, [`LinalgError::NotFinite`].
    pub fn push(&mut self, rows: &[f64]) -> Result<(), LinalgError> {
        let n = self.n;
        if n == 0 {
            return Ok(());
        }
        check_len("rows", rows.len() % n, 0)?;
        if let Some(index) = rows.iter().position(|v| !v.is_finite()) {
            return Err(LinalgError::NotFinite { what: "rows", index });
        }
        self.rows += rows.len() / n;
        for row in rows.chunks_exact(n) {
            self.stacked[self.filled * n..(self.filled + 1) * n].copy_from_slice(row);
            self.filled += 1;
            if self.filled * n == self.stacked.len() {
                self.fold()?;
            }
        }
        Ok(())
    }

    fn fold(&mut self) -> Result<(), LinalgError> {
        let n = self.n;
        self.stacked[self.filled * n..].fill(0.0);
        self.work.r_factor(&self.stacked, &mut self.r)?;
        self.stacked[..n * n].copy_from_slice(&self.r);
        self.filled = n;
        Ok(())
    }

    /// The pivoted factor of all rows, as [`super::pivoted_r`].
    ///
    /// # Errors
    /// As of [`QrRows::push`].
    pub fn pivoted(mut self) -> Result<PivotedR, LinalgError> {
        if self.n > 0 {
            self.fold()?;
        }
        Ok(pivoted_from_r(&self.r, self.n, self.n, self.rows, 0.0).0)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::linalg::pivoted_r;
    use crate::rng::Rng64;

    fn random(rows: usize, n: usize) -> Vec<f64> {
        let mut rng = Rng64::new(5);
        (0..rows * n).map(|i| rng.normal() * 10f64.powi((i % n) as i32)).collect()
    }

    /// All three ways give the same pivots and the same R up to signs of rows.
    #[test]
    fn blocks_give_the_factor_of_the_whole() {
        let (rows, n) = (203, 6);
        let a = random(rows, n);
        let whole = pivoted_r(&a, rows, n, 0.0).unwrap();
        let (mut gram, mut qr) = (GramRows::new(n), QrRows::new(n));
        for block in a.chunks(7 * n) {
            gram.push(block).unwrap();
            qr.push(block).unwrap();
        }
        for other in [pivoted_from_gram(&gram.gram, n).unwrap(), qr.pivoted().unwrap()] {
            assert_eq!((other.rank, &other.order), (whole.rank, &whole.order));
            for i in 0..n {
                assert!((other.scale[i] / whole.scale[i] - 1.0).abs() < 1e-13);
                for j in i..n {
                    let (x, y) = (other.r[i * n + j], whole.r[i * n + j]);
                    let sign = other.r[i * n + i].signum() * whole.r[i * n + i].signum();
                    assert!((x - sign * y).abs() < 1e-12, "{i} {j}: {x} {y}");
                }
            }
        }
    }

    #[test]
    fn a_dependent_column_is_left_to_the_orthogonal_way() {
        let (rows, n) = (90, 3);
        let mut a = random(rows, n);
        a.chunks_exact_mut(n).for_each(|row| row[2] = row[0] - 2.0 * row[1]);
        let (mut gram, mut qr) = (GramRows::new(n), QrRows::new(n));
        for block in a.chunks(5 * n) {
            gram.push(block).unwrap();
            qr.push(block).unwrap();
        }
        assert!(pivoted_from_gram(&gram.gram, n).is_none());
        let found = qr.pivoted().unwrap();
        assert_eq!((found.rank, found.dependent.len()), (2, 1));
    }

    #[test]
    fn parts_of_rows_and_bad_values_are_refused() {
        let mut qr = QrRows::new(2);
        assert!(matches!(qr.push(&[1.0, 2.0, 3.0]), Err(LinalgError::Shape { .. })));
        assert!(matches!(qr.push(&[1.0, f64::NAN]), Err(LinalgError::NotFinite { index: 1, .. })));
        assert!(matches!(GramRows::new(2).push(&[1.0, 2.0, 3.0]), Err(LinalgError::Shape { .. })));
    }
}
