//! Gradient and average information of the likelihood, tile by tile.
//!
//! ```text
//! W = P - a a'/s^2                      2 d log L / dtheta = -sum_ik W_ik dV_ik
//! dV_ik/dlog l_j = -2 k'(r^2_ik) (x_ij - x_kj)^2 / l_j^2,   dV_ii/dlog g = g_i
//! ```
//!
//! Each tile of V^-1 = X X' is made, used for the sums and forgotten.

use std::ops::Range;

use dynocal_numerics::linalg::{Factor, product};
use rayon::prelude::*;

use super::likelihood::{Factored, Problem, Work};
use super::packed::sum_of;

/// Derivatives of a likelihood with respect to log lengths and log noise ratio.
#[derive(Clone, Debug)]
pub(super) struct Slopes {
    /// Gradient (d + 1).
    pub(super) gradient: Vec<f64>,
    /// Average information at the best s^2, (d + 1) x (d + 1).
    pub(super) information: Vec<f64>,
}

/// What a tile adds to the sums.
struct Part {
    rows: Range<usize>,
    cols: Range<usize>,
    /// `sum W_ik k'_ik (x_ij - x_kj)^2` over the pairs of the tile (d).
    sums: Vec<f64>,
    /// `sum W_ii g_i`.
    noise: f64,
    /// `sum_k k'_ik (x_ij - x_kj)^2 a_k` for the rows (d x rows), and for the columns from the rows (d x columns).
    by_row: Vec<f64>,
    by_col: Vec<f64>,
}

/// From the factor, its inverse and the slopes of the correlations in `work`.
pub(super) fn of(
    problem: &Problem<'_>,
    log_lengths: &[f64],
    noise_ratio: f64,
    at: &Factored,
    work: &Work,
) -> Option<Slopes> {
    let (n, d, q) = (problem.n(), problem.dim(), problem.q());
    let weights = &at.projection.weights;
    let scale = at.signal_variance.sqrt().recip();
    // [U, a/s]: W = V^-1 - U U' - a a'/s^2.
    let mut own = Vec::with_capacity(n * (q + 1));
    for (i, a) in weights.iter().enumerate() {
        own.extend_from_slice(&at.projection.u[i * q..(i + 1) * q]);
        own.push(a * scale);
    }
    let parts: Option<Vec<Part>> = work
        .root
        .pairs()
        .into_par_iter()
        .map_init(Vec::new, |tile, (i, j)| part(problem, noise_ratio, weights, &own, work, (i, j), tile))
        .collect();
    let mut sums = vec![0.0; d];
    let mut products = vec![0.0; (d + 1) * n];
    let mut by_noise = 0.0;
    for part in parts? {
        by_noise -= 0.5 * part.noise;
        sums.iter_mut().zip(&part.sums).for_each(|(s, p)| *s += p);
        for j in 0..d {
            let mut add = |range: &Range<usize>, of: &[f64]| {
                let of = &of[j * range.len()..(j + 1) * range.len()];
                products[j * n + range.start..j * n + range.end]
                    .iter_mut()
                    .zip(of)
                    .for_each(|(f, v)| *f += v);
            };
            add(&part.rows, &part.by_row);
            add(&part.cols, &part.by_col);
        }
    }
    // The two triangles cancel the half.
    let per: Vec<f64> = log_lengths.iter().map(|l| 2.0 * (-2.0 * l).exp()).collect();
    let mut gradient: Vec<f64> = sums.iter().zip(&per).map(|(s, p)| s * p).collect();
    gradient.push(by_noise);
    for (f, p) in products.chunks_exact_mut(n).zip(&per) {
        f.iter_mut().for_each(|f| *f *= -p);
    }
    (0..n).for_each(|i| products[d * n + i] = problem.noise(noise_ratio, i) * weights[i]);
    Some(Slopes { gradient, information: information(problem, &products, at, work)? })
}

/// The sums of tile (i, j); `tile` is its space.
fn part(
    problem: &Problem<'_>,
    noise_ratio: f64,
    weights: &[f64],
    own: &[f64],
    work: &Work,
    (i, j): (usize, usize),
    tile: &mut Vec<f64>,
) -> Option<Part> {
    let (n, d, width) = (problem.n(), problem.dim(), problem.q() + 1);
    let (rows, cols) = (work.root.rows(i), work.root.rows(j));
    tile.resize(rows.len() * cols.len(), 0.0);
    let tile = &mut tile[..rows.len() * cols.len()];
    work.root.square_tile(i, j, tile).ok()?;
    let of = |range: &Range<usize>| &own[range.start * width..range.end * width];
    let (left, right) =
        (Factor::new(of(&rows), rows.len(), width), Factor::transposed(of(&cols), cols.len(), width));
    product(-1.0, left, right, true, tile).ok()?;
    let noise = if i == j {
        rows.clone()
            .enumerate()
            .map(|(k, row)| tile[k * cols.len() + k] * problem.noise(noise_ratio, row))
            .sum()
    } else {
        0.0
    };
    let mut part = Part {
        sums: vec![0.0; d],
        noise,
        by_row: vec![0.0; d * rows.len()],
        by_col: vec![0.0; d * cols.len()],
        rows,
        cols,
    };
    pulp::Arch::new().dispatch(Contract {
        columns: problem.columns,
        n,
        tile,
        slopes: work.slope.tile(i, j),
        weights,
        part: &mut part,
    });
    Some(part)
}

/// `(f_j'P f_k - a'f_j a'f_k / ((n-q) s^2)) / (2 s^2)` for the rows f of `products` ((d + 1) x n).
fn information(problem: &Problem<'_>, products: &[f64], at: &Factored, work: &Work) -> Option<Vec<f64>> {
    let (n, q) = (problem.n(), problem.q());
    let p = products.len() / n;
    let mut rotated: Vec<f64> =
        (0..n).flat_map(|i| (0..p).map(move |j| (i, j))).map(|(i, j)| products[j * n + i]).collect();
    // u'f and a'f of each.
    let mut along = vec![0.0; p * (q + 1)];
    for i in 0..n {
        let (u, a) = (&at.projection.u[i * q..(i + 1) * q], at.projection.weights[i]);
        for j in 0..p {
            let f = rotated[i * p + j];
            let along = &mut along[j * (q + 1)..(j + 1) * (q + 1)];
            along.iter_mut().zip(u).for_each(|(s, u)| *s += u * f);
            along[q] += a * f;
        }
    }
    work.factor.solve_transposed(&mut rotated, p).ok()?;
    let s2 = at.signal_variance;
    let free = (n - q) as f64;
    let mut information = vec![0.0; p * p];
    for row in rotated.chunks_exact(p) {
        for j in 0..p {
            for k in 0..p {
                information[j * p + k] += row[j] * row[k];
            }
        }
    }
    for j in 0..p {
        for k in 0..p {
            let (a, b) = (&along[j * (q + 1)..(j + 1) * (q + 1)], &along[k * (q + 1)..(k + 1) * (q + 1)]);
            let basis: f64 = a[..q].iter().zip(&b[..q]).map(|(a, b)| a * b).sum();
            information[j * p + k] =
                (information[j * p + k] - basis - a[q] * b[q] / (free * s2)) / (2.0 * s2);
        }
    }
    Some(information)
}

/// The sums of one tile over its pairs i < k.
struct Contract<'a> {
    columns: &'a [f64],
    n: usize,
    tile: &'a [f64],
    slopes: &'a [f64],
    weights: &'a [f64],
    part: &'a mut Part,
}

impl pulp::WithSimd for Contract<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: pulp::Simd>(self, _: S) {
        let Part { rows, cols, sums, by_row, by_col, .. } = self.part;
        let (height, width) = (rows.len(), cols.len());
        let (mut by_tile, mut by_weight) = (vec![0.0; width], vec![0.0; width]);
        for (at, i) in rows.clone().enumerate() {
            let first = (i + 1).max(cols.start);
            let skip = first - cols.start;
            let (tile, slopes) = (
                &self.tile[at * width + skip..][..width - skip],
                &self.slopes[at * width + skip..][..width - skip],
            );
            let (by_tile, by_weight) = (&mut by_tile[skip..], &mut by_weight[skip..]);
            let others = &self.weights[first..cols.end];
            for k in 0..slopes.len() {
                by_tile[k] = tile[k] * slopes[k];
                by_weight[k] = others[k] * slopes[k];
            }
            let weight = self.weights[i];
            for (j, column) in self.columns.chunks_exact(self.n).enumerate() {
                let (own, other) = (column[i], &column[first..cols.end]);
                sums[j] += sum_of(by_tile, other, |w, x| w * (own - x) * (own - x));
                by_row[j * height + at] += sum_of(by_weight, other, |w, x| w * (own - x) * (own - x));
                let by_col = &mut by_col[j * width + skip..(j + 1) * width];
                for k in 0..by_col.len() {
                    by_col[k] += weight * slopes[k] * (own - other[k]) * (own - other[k]);
                }
            }
        }
    }
}
