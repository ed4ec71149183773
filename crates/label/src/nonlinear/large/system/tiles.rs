//! A large symmetric matrix in square tiles of its upper triangle, factorised and solved over all processors.
//!
//! Every tile is one piece of work and takes its parts in a fixed order, so that results do not depend on the processors.

use std::ops::Range;

use dynocal_numerics::linalg::{self, Factor, LinalgError, axpy, dot, product};
use rayon::prelude::*;

/// Rows and columns of a tile.
pub(super) const TILE: usize = 512;

/// The upper triangle of a matrix, or its factor R with `R'R = A`.
pub(super) struct Tiles {
    n: usize,
    /// Tiles of a row from the diagonal on, row by row, each row-major.
    rows: Vec<Vec<Vec<f64>>>,
}

/// Rows of tile row `k` of a matrix of `n` rows.
fn span(n: usize, k: usize) -> Range<usize> {
    k * TILE..((k + 1) * TILE).min(n)
}

impl Tiles {
    pub(super) fn zeros(n: usize) -> Self {
        let count = n.div_ceil(TILE);
        let size = |k: usize| span(n, k).len();
        let row = |i: usize| (i..count).map(|j| vec![0.0; size(i) * size(j)]).collect();
        Self { n, rows: (0..count).map(row).collect() }
    }

    /// Rows of tiles, each from the diagonal on, for what fills them.
    pub(super) fn rows_mut(&mut self) -> &mut [Vec<Vec<f64>>] {
        &mut self.rows
    }

    /// Columns of tile column `j`.
    pub(super) fn width(&self, j: usize) -> usize {
        span(self.n, j).len()
    }

    /// The entry of the upper triangle at row `i` and column `j`, in either order.
    pub(super) fn at(&mut self, i: usize, j: usize) -> &mut f64 {
        let (i, j) = (i.min(j), i.max(j));
        let (row, column) = (i / TILE, j / TILE);
        let width = self.width(column);
        &mut self.rows[row][column - row][(i % TILE) * width + j % TILE]
    }

    /// Replaces the matrix by its factor R (tile by tile, the rest brought up to date after each row of tiles).
    pub(super) fn factor(&mut self) -> Result<(), LinalgError> {
        let n = self.n;
        for k in 0..self.rows.len() {
            let (top, below) = self.rows[k..].split_at_mut(1);
            let (own, right) = top[0].split_at_mut(1);
            let (r, size) = (&mut own[0], span(n, k).len());
            linalg::cholesky(r, size)?;
            let r = &*r;
            let wide = |j: usize| span(n, k + 1 + j).len();
            right
                .par_iter_mut()
                .enumerate()
                .try_for_each(|(j, a)| linalg::solve_upper_transposed_many(r, size, a, wide(j)))?;
            let right = &*right;
            below.par_iter_mut().enumerate().try_for_each(|(i, row)| {
                let left = Factor::transposed(&right[i], size, wide(i));
                row.par_iter_mut().enumerate().try_for_each(|(j, a)| {
                    product(-1.0, left, Factor::new(&right[i + j], size, wide(i + j)), true, a)
                })
            })?;
        }
        Ok(())
    }

    /// Solves `R'R x = b` in place, of a factor.
    pub(super) fn solve(&self, x: &mut [f64]) -> Result<(), LinalgError> {
        let n = self.n;
        for (k, row) in self.rows.iter().enumerate() {
            let own = span(n, k);
            let size = own.len();
            linalg::solve_upper_transposed(&row[0], size, &mut x[own.clone()])?;
            let (done, rest) = x.split_at_mut(own.end);
            let y = &done[own];
            rest.par_chunks_mut(TILE).zip(&row[1..]).for_each(|(rest, tile)| {
                let wide = rest.len();
                y.iter().enumerate().for_each(|(i, y)| axpy(-y, &tile[i * wide..(i + 1) * wide], rest));
            });
        }
        for (k, row) in self.rows.iter().enumerate().rev() {
            let own = span(n, k);
            let size = own.len();
            let (left, known) = x.split_at_mut(own.end);
            let parts: Vec<Vec<f64>> = known
                .par_chunks(TILE)
                .zip(&row[1..])
                .map(|(x, tile)| tile.chunks(x.len()).map(|a| dot(a, x)).collect())
                .collect();
            parts.iter().for_each(|p| axpy(-1.0, p, &mut left[own.clone()]));
            linalg::solve_upper(&row[0], size, &mut left[own])?;
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use dynocal_numerics::rng::Rng64;

    /// A matrix of three tiles with a known solution, `A = B'B + n I`.
    #[test]
    fn a_matrix_of_several_tiles_is_solved() {
        let n = 2 * TILE + 37;
        let mut rng = Rng64::new(1);
        let b: Vec<f64> = (0..8 * n).map(|_| rng.normal()).collect();
        let x: Vec<f64> = (0..n).map(|_| rng.normal()).collect();
        let mut tiles = Tiles::zeros(n);
        for i in 0..n {
            for j in i..n {
                let own = if i == j { n as f64 } else { 0.0 };
                *tiles.at(j, i) = own + (0..8).map(|k| b[k * n + i] * b[k * n + j]).sum::<f64>();
            }
        }
        let bx: Vec<f64> = (0..8).map(|k| dot(&b[k * n..(k + 1) * n], &x)).collect();
        let mut found: Vec<f64> =
            (0..n).map(|i| n as f64 * x[i] + (0..8).map(|k| b[k * n + i] * bx[k]).sum::<f64>()).collect();
        tiles.factor().unwrap();
        tiles.solve(&mut found).unwrap();
        let off = found.iter().zip(&x).map(|(a, b)| (a - b).abs()).fold(0.0, f64::max);
        assert!(off < 1e-11, "{off:e}");
        // What has no factor is an error, not a number.
        let mut none = Tiles::zeros(n);
        assert!(none.factor().is_err());
    }
}
