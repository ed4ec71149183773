//! The upper triangle of a symmetric matrix in square tiles, so that both its factor and its inverse are products of small
//! matrices which several threads do side by side.
//!
//! ```text
//! R'R = V       R_kk'R_kk = V_kk,   R_kj = R_kk^-T V_kj,   V_ij <- V_ij - R_ki'R_kj     for each row k of tiles
//! X = R^-1      X_jj = R_jj^-1,     X_ij = -R_ii^-1 sum_{i<k<=j} R_ik X_kj               for each column j of tiles
//! V^-1 = X X'   V^-1_ij = sum_{k>=j} X_ik X_jk'
//! ```
//!
//! What is added to a tile and in which order depends on the size of the matrix alone, so that results are equal for any number
//! of threads.
//!
//! Reference: A. Buttari, J. Langou, J. Kurzak, J. Dongarra, A class of parallel tiled linear algebra algorithms for multicore
//! architectures, Parallel Computing 35 (2009), 38-53.

use std::ops::Range;

use dynocal_numerics::linalg::{
    Factor, LinalgError, cholesky, inverse_upper, product, solve_upper_many, solve_upper_transposed_many,
    symmetric_update, upper_gram,
};
use rayon::prelude::*;

/// Up to so many rows are one tile.
const WHOLE: usize = 512;
/// Rows of the tiles of larger matrices.
const SIZE: usize = 192;

/// Upper triangle by tiles; of the tiles on the diagonal only the upper triangle counts.
pub(super) struct Tiles {
    n: usize,
    size: usize,
    count: usize,
    tiles: Vec<Vec<f64>>,
}

impl Tiles {
    /// Zeros for n rows.
    pub(super) fn new(n: usize) -> Self {
        let size = if n <= WHOLE { n.max(1) } else { SIZE };
        let count = n.div_ceil(size).max(1);
        let mut new = Self { n, size, count, tiles: Vec::new() };
        new.tiles =
            new.pairs().iter().map(|(i, j)| vec![0.0; new.rows(*i).len() * new.rows(*j).len()]).collect();
        new
    }

    /// Numbers that are held for n rows.
    pub(super) fn len(n: usize) -> usize {
        let size = if n <= WHOLE { n.max(1) } else { SIZE };
        let rows = |i: usize| size.min(n - i * size);
        let count = n.div_ceil(size);
        (0..count).map(|i| (i..count).map(|j| rows(i) * rows(j)).sum::<usize>()).sum()
    }

    /// Rows of tiles.
    pub(super) fn count(&self) -> usize {
        self.count
    }

    /// Rows of the matrix in row i of tiles.
    pub(super) fn rows(&self, i: usize) -> Range<usize> {
        i * self.size..((i + 1) * self.size).min(self.n)
    }

    /// Places of all tiles, row by row.
    pub(super) fn pairs(&self) -> Vec<(usize, usize)> {
        (0..self.count).flat_map(|i| (i..self.count).map(move |j| (i, j))).collect()
    }

    fn place(&self, i: usize, j: usize) -> usize {
        // Rows before i have count, count - 1, .. tiles.
        i * self.count - i * i.saturating_sub(1) / 2 + j - i
    }

    /// Tile in row i and column j >= i.
    pub(super) fn tile(&self, i: usize, j: usize) -> &[f64] {
        &self.tiles[self.place(i, j)]
    }

    /// All tiles, in the order of [`Tiles::pairs`].
    pub(super) fn all_mut(&mut self) -> &mut [Vec<f64>] {
        &mut self.tiles
    }

    /// Entry on the diagonal.
    pub(super) fn diagonal(&self, i: usize) -> f64 {
        let (tile, at) = (i / self.size, i % self.size);
        self.tile(tile, tile)[at * self.rows(tile).len() + at]
    }

    /// The factor R of V = R'R, in place.
    pub(super) fn cholesky(&mut self) -> Result<(), LinalgError> {
        for k in 0..self.count {
            let size = self.rows(k).len();
            let widths: Vec<usize> = (k..self.count).map(|j| self.rows(j).len()).collect();
            let pairs: Vec<(usize, usize)> =
                (k + 1..self.count).flat_map(|i| (i..self.count).map(move |j| (i - k, j - k))).collect();
            let (first, after) = (self.place(k, k), self.place(k, self.count - 1) + 1);
            let (row, rest) = self.tiles[first..].split_at_mut(after - first);
            let (own, others) = row.split_at_mut(1);
            cholesky(&mut own[0], size)?;
            let root = &own[0];
            others
                .par_iter_mut()
                .zip(&widths[1..])
                .try_for_each(|(tile, w)| solve_upper_transposed_many(root, size, tile, *w))?;
            let row = &*row;
            rest.par_iter_mut().zip(pairs).try_for_each(|(tile, (i, j))| {
                if i == j {
                    return symmetric_update(-1.0, &row[i], size, widths[i], tile);
                }
                let left = Factor::transposed(&row[i], size, widths[i]);
                product(-1.0, left, Factor::new(&row[j], size, widths[j]), true, tile)
            })?;
        }
        Ok(())
    }

    /// `R^-T b` in place, b n x width row-major.
    pub(super) fn solve_transposed(&self, b: &mut [f64], width: usize) -> Result<(), LinalgError> {
        for i in 0..self.count {
            let own = self.rows(i);
            let (done, rest) = b.split_at_mut(own.start * width);
            let mine = &mut rest[..own.len() * width];
            for k in 0..i {
                let other = self.rows(k);
                let known = Factor::new(&done[other.start * width..other.end * width], other.len(), width);
                let left = Factor::transposed(self.tile(k, i), other.len(), own.len());
                product(-1.0, left, known, true, mine)?;
            }
            solve_upper_transposed_many(self.tile(i, i), own.len(), mine, width)?;
        }
        Ok(())
    }

    /// `R^-1 b` in place, b n x width row-major.
    pub(super) fn solve(&self, b: &mut [f64], width: usize) -> Result<(), LinalgError> {
        for i in (0..self.count).rev() {
            let own = self.rows(i);
            let (rest, done) = b.split_at_mut(own.end * width);
            let mine = &mut rest[own.start * width..];
            for k in i + 1..self.count {
                let other = self.rows(k);
                let from = (other.start - own.end) * width;
                let known = Factor::new(&done[from..from + other.len() * width], other.len(), width);
                product(-1.0, Factor::new(self.tile(i, k), own.len(), other.len()), known, true, mine)?;
            }
            solve_upper_many(self.tile(i, i), own.len(), mine, width)?;
        }
        Ok(())
    }

    /// R^-1 into `out`, whose tiles on the diagonal have zeros below theirs.
    pub(super) fn inverse_into(&self, out: &mut Self) -> Result<(), LinalgError> {
        // The longest columns first, as they take longest.
        let mut columns: Vec<(usize, Vec<Vec<f64>>)> = (0..self.count)
            .rev()
            .map(|j| {
                let places: Vec<usize> = (0..=j).map(|i| out.place(i, j)).collect();
                (j, places.into_iter().map(|at| std::mem::take(&mut out.tiles[at])).collect())
            })
            .collect();
        let done = columns.par_iter_mut().try_for_each(|(j, column)| self.inverse_column(*j, column));
        for (j, column) in columns {
            for (i, tile) in column.into_iter().enumerate() {
                let at = out.place(i, j);
                out.tiles[at] = tile;
            }
        }
        done
    }

    fn inverse_column(&self, j: usize, column: &mut [Vec<f64>]) -> Result<(), LinalgError> {
        let width = self.rows(j).len();
        inverse_upper(self.tile(j, j), width, &mut column[j])?;
        for i in (0..j).rev() {
            let size = self.rows(i).len();
            let (before, known) = column.split_at_mut(i + 1);
            for (k, x) in (i + 1..=j).zip(&*known) {
                let inner = self.rows(k).len();
                let left = Factor::new(self.tile(i, k), size, inner);
                product(-1.0, left, Factor::new(x, inner, width), k > i + 1, &mut before[i])?;
            }
            solve_upper_many(self.tile(i, i), size, &mut before[i], width)?;
        }
        Ok(())
    }

    /// Tile (i, j) of `X X'` into `out`, X being what stands here.
    pub(super) fn square_tile(&self, i: usize, j: usize, out: &mut [f64]) -> Result<(), LinalgError> {
        let (rows, cols) = (self.rows(i).len(), self.rows(j).len());
        let mut from = j;
        if i == j {
            upper_gram(self.tile(i, i), rows, out)?;
            from += 1;
        }
        for k in from..self.count {
            let inner = self.rows(k).len();
            let right = Factor::transposed(self.tile(j, k), cols, inner);
            product(1.0, Factor::new(self.tile(i, k), rows, inner), right, i == j || k > j, out)?;
        }
        Ok(())
    }

    /// Diagonal of `X X'` (n), X being what stands here.
    pub(super) fn square_diagonal(&self) -> Vec<f64> {
        let mut sums = vec![0.0; self.n];
        for (i, j) in self.pairs() {
            let width = self.rows(j).len();
            for (at, row) in self.tile(i, j).chunks_exact(width).enumerate() {
                let from = if i == j { at } else { 0 };
                sums[i * self.size + at] += row[from..].iter().map(|v| v * v).sum::<f64>();
            }
        }
        sums
    }

    /// `X'` row by row as a packed lower triangle: row i has i + 1 entries.
    pub(super) fn packed_transposed(&self) -> Vec<f64> {
        let mut lower = Vec::with_capacity(self.n * (self.n + 1) / 2);
        for i in 0..self.n {
            let (tile, at) = (i / self.size, i % self.size);
            let width = self.rows(tile).len();
            for k in 0..=tile {
                let column = self.tile(k, tile).iter().skip(at).step_by(width);
                let count = if k == tile { at + 1 } else { self.rows(k).len() };
                lower.extend(column.take(count));
            }
        }
        lower
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use dynocal_numerics::linalg::{cholesky_inverse, dot};
    use dynocal_numerics::rng::Rng64;

    /// A well-conditioned matrix (n x n).
    fn matrix(n: usize) -> Vec<f64> {
        let mut rng = Rng64::new(n as u64);
        let a: Vec<f64> = (0..n * n).map(|_| rng.normal()).collect();
        let row = |i: usize| &a[i * n..(i + 1) * n];
        let n_f = n as f64;
        (0..n * n).map(|p| dot(row(p / n), row(p % n)) / n_f + f64::from(u8::from(p / n == p % n))).collect()
    }

    fn tiled(a: &[f64], n: usize) -> Tiles {
        let mut tiles = Tiles::new(n);
        for (at, (i, j)) in tiles.pairs().into_iter().enumerate() {
            let (rows, cols) = (tiles.rows(i), tiles.rows(j));
            tiles.tiles[at] = rows.flat_map(|r| a[r * n + cols.start..r * n + cols.end].to_vec()).collect();
        }
        tiles
    }

    /// Sizes of one tile, of several and of a short last one.
    #[test]
    fn factor_solves_and_inverse_are_those_of_the_whole_matrix() {
        for n in [1, 37, 513, 600] {
            let a = matrix(n);
            let mut factor = tiled(&a, n);
            factor.cholesky().unwrap();
            let mut whole = a.clone();
            cholesky(&mut whole, n).unwrap();
            let (mut scratch, mut inverse) = (vec![0.0; n * n], vec![0.0; n * n]);
            cholesky_inverse(&whole, n, &mut scratch, &mut inverse).unwrap();
            let mut root = Tiles::new(n);
            factor.inverse_into(&mut root).unwrap();
            let diagonal = root.square_diagonal();
            for i in 0..n {
                assert!((factor.diagonal(i) - whole[i * n + i]).abs() < 1e-12, "{n} {i}");
                assert!((diagonal[i] - inverse[i * n + i]).abs() < 1e-11, "{n} {i}");
            }
            for (i, j) in root.pairs() {
                let (rows, cols) = (root.rows(i), root.rows(j));
                let mut tile = vec![0.0; rows.len() * cols.len()];
                root.square_tile(i, j, &mut tile).unwrap();
                for r in rows.clone() {
                    for c in cols.clone().filter(|c| *c >= r) {
                        let found = tile[(r - rows.start) * cols.len() + c - cols.start];
                        assert!((found - inverse[r * n + c]).abs() < 1e-11, "{n}: {r}, {c}");
                    }
                }
            }
            let b: Vec<f64> = (0..2 * n).map(|i| (i as f64).sin()).collect();
            let mut x = b.clone();
            factor.solve_transposed(&mut x, 2).unwrap();
            factor.solve(&mut x, 2).unwrap();
            for i in 0..n {
                for k in 0..2 {
                    let back: f64 = (0..n).map(|j| a[i * n + j] * x[2 * j + k]).sum();
                    assert!((back - b[2 * i + k]).abs() < 1e-10, "{n}: {i}");
                }
            }
            let packed = root.packed_transposed();
            assert_eq!(packed.len(), n * (n + 1) / 2);
            // W V W' = 1 for W = R^-T: the last row.
            let w = &packed[n * (n - 1) / 2..];
            let quadratic: f64 = (0..n).map(|i| w[i] * dot(&a[i * n..(i + 1) * n], w)).sum();
            assert!((quadratic - 1.0).abs() < 1e-10, "{n}: {quadratic}");
        }
    }

    #[test]
    fn a_matrix_that_is_not_positive_definite_is_named() {
        let mut a = matrix(600);
        a[599 * 600 + 599] = -1.0;
        assert!(tiled(&a, 600).cholesky().is_err());
    }
}
