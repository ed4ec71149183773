//! The two products that a design spends most of its time in, in register tiles of four rows by two vectors.
//!
//! Compiled once for each width of vectors; every entry is one chain of fused multiply-adds, so that its bits do not
//! depend on the width. The last tile of a row or column overlaps the one before it, so that there are no remainders.

use super::axpy;

/// Rows of a tile.
const ROWS: usize = 4;
/// Longest row of a tile: two of the widest vectors.
const MOST: usize = 16;

/// `g += s' s` for `s` (n x p): lower triangle only; [`super::mirror`] completes it.
pub(crate) fn gram_add(s: &[f64], p: usize, g: &mut [f64]) {
    pulp::Arch::new().dispatch(Gram { s, p, g });
}

/// `out = s b` for `s` (n x p) and `b` (p x p).
pub(crate) fn multiply(s: &[f64], b: &[f64], p: usize, out: &mut [f64]) {
    pulp::Arch::new().dispatch(Product { s, b, p, out });
}

struct Gram<'a> {
    s: &'a [f64],
    p: usize,
    g: &'a mut [f64],
}

impl pulp::WithSimd for Gram<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: pulp::Simd>(self, simd: S) {
        let Self { s, p, g } = self;
        let width = 2 * S::F64_LANES;
        if p < width.max(ROWS) {
            for row in s.chunks_exact(p) {
                for i in 0..p {
                    axpy(row[i], &row[..=i], &mut g[i * p..=i * p + i]);
                }
            }
            return;
        }
        for (i, new_i) in starts(p, ROWS) {
            // Columns up to the last row of the tile.
            for (j, new_j) in starts(p, width).take_while(|(_, new)| *new < i + ROWS) {
                let mut acc = [[simd.splat_f64s(0.0); 2]; ROWS];
                for row in s.chunks_exact(p) {
                    let (a, b) = (&row[i..i + ROWS], S::as_simd_f64s(&row[j..j + width]).0);
                    accumulate(simd, a, b, &mut acc);
                }
                for r in new_i - i..ROWS {
                    let mut sums = [0.0; MOST];
                    S::as_mut_simd_f64s(&mut sums[..width]).0.copy_from_slice(&acc[r]);
                    let row = &mut g[(i + r) * p..(i + r) * p + i + r + 1];
                    for (x, v) in row.iter_mut().skip(new_j).zip(&sums[new_j - j..width]) {
                        *x += v;
                    }
                }
            }
        }
    }
}

struct Product<'a> {
    s: &'a [f64],
    b: &'a [f64],
    p: usize,
    out: &'a mut [f64],
}

impl pulp::WithSimd for Product<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: pulp::Simd>(self, simd: S) {
        let Self { s, b, p, out } = self;
        let (n, width) = (s.len() / p, 2 * S::F64_LANES);
        if p < width || n < ROWS {
            for (row, o) in s.chunks_exact(p).zip(out.chunks_exact_mut(p)) {
                o.fill(0.0);
                for k in 0..p {
                    axpy(row[k], &b[k * p..(k + 1) * p], o);
                }
            }
            return;
        }
        for (i, _) in starts(n, ROWS) {
            let rows = &s[i * p..(i + ROWS) * p];
            for (j, _) in starts(p, width) {
                let mut acc = [[simd.splat_f64s(0.0); 2]; ROWS];
                for (k, row) in b.chunks_exact(p).enumerate() {
                    let a = [rows[k], rows[p + k], rows[2 * p + k], rows[3 * p + k]];
                    accumulate(simd, &a, S::as_simd_f64s(&row[j..j + width]).0, &mut acc);
                }
                for r in 0..ROWS {
                    let o = &mut out[(i + r) * p + j..(i + r) * p + j + width];
                    S::as_mut_simd_f64s(o).0.copy_from_slice(&acc[r]);
                }
            }
        }
    }
}

/// Tiles of `size` that cover `0..n`: (start, first place that no earlier tile covers). `n` is at least `size`.
#[inline(always)]
fn starts(n: usize, size: usize) -> impl Iterator<Item = (usize, usize)> {
    (0..n).step_by(size).map(move |new| (new.min(n - size), new))
}

/// `acc += a b'`.
#[inline(always)]
fn accumulate<S: pulp::Simd>(simd: S, a: &[f64], b: &[S::f64s], acc: &mut [[S::f64s; 2]; ROWS]) {
    for r in 0..ROWS {
        let x = simd.splat_f64s(a[r]);
        acc[r] = [simd.mul_add_f64s(x, b[0], acc[r][0]), simd.mul_add_f64s(x, b[1], acc[r][1])];
    }
}
