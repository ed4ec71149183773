//! The ridge of an inverse map, chosen by its own records.
//!
//! ```text
//! sum over blocks b of |y_b - X_b c_b|^2,   c_b = (X'X - X_b'X_b + r (n - n_b) I)^-1 (X'y - X_b'y_b)
//! ```
//!
//! The blocks are stretches of a record: single samples that are left out are told by their neighbours. Of the ridges of a grid
//! the one with the least sum is taken. An actuator whose optimum is flat, so that records disagree, gets a large one; one that
//! the demands determine a small one, which leaves its steady values where they were measured.

use dynocal_numerics::linalg::{self, LinalgError};

/// Stretches of each record.
const STRETCHES: usize = 5;
/// Powers of ten that are compared.
const POWERS: std::ops::RangeInclusive<i32> = -9..=-3;

/// Sums over one stretch.
struct Block {
    n: usize,
    /// X'X, upper triangle.
    gram: Vec<f64>,
    /// X'y and y'y by actuator.
    products: Vec<(Vec<f64>, f64)>,
}

impl Block {
    fn new(x: &[f64], p: usize, y: &[&[f64]]) -> Result<Self, LinalgError> {
        let n = x.len() / p.max(1);
        let mut gram = vec![0.0; p * p];
        linalg::gram_upper(x, n, p, &mut gram)?;
        let product = |y: &&[f64]| {
            let mut h = vec![0.0; p];
            for (row, y) in x.chunks_exact(p.max(1)).zip(*y) {
                linalg::axpy(*y, row, &mut h);
            }
            (h, linalg::dot(y, y))
        };
        Ok(Self { n, gram, products: y.iter().map(product).collect() })
    }

    /// |y - X c|^2.
    fn misfit(&self, actuator: usize, c: &[f64]) -> f64 {
        let (h, squares) = &self.products[actuator];
        let p = c.len();
        let mut sum = squares - 2.0 * linalg::dot(c, h);
        for i in 0..p {
            let row = &self.gram[i * p + i + 1..(i + 1) * p];
            sum += c[i] * (c[i] * self.gram[i * p + i] + 2.0 * linalg::dot(row, &c[i + 1..]));
        }
        sum
    }
}

/// Ridge per sample of every actuator: `x` (rows of p), `y` a column for each actuator, `records` the rows of each record.
///
/// # Errors
/// [`LinalgError`] of a sum that overflows.
pub(super) fn chosen(
    x: &[f64],
    p: usize,
    y: &[Vec<f64>],
    records: &[usize],
) -> Result<Vec<f64>, LinalgError> {
    let mut blocks = Vec::new();
    let mut from = 0;
    for rows in records {
        for k in 0..STRETCHES {
            let (a, b) = (from + k * rows / STRETCHES, from + (k + 1) * rows / STRETCHES);
            let part: Vec<&[f64]> = y.iter().map(|y| &y[a..b]).collect();
            blocks.push(Block::new(&x[a * p..b * p], p, &part)?);
        }
        from += rows;
    }
    let mut best = vec![(f64::INFINITY, 10f64.powi(*POWERS.end())); y.len()];
    for power in POWERS {
        let ridge = 10f64.powi(power);
        let sums = left_out(&blocks, p, y.len(), ridge);
        for (best, sum) in best.iter_mut().zip(sums) {
            if sum < best.0 {
                *best = (sum, ridge);
            }
        }
    }
    Ok(best.into_iter().map(|b| b.1).collect())
}

/// Squared errors of every actuator over all blocks, each predicted by the others; infinite where they do not determine it.
fn left_out(blocks: &[Block], p: usize, actuators: usize, ridge: f64) -> Vec<f64> {
    let mut sums = vec![0.0; actuators];
    for (k, block) in blocks.iter().enumerate() {
        let others = || blocks.iter().enumerate().filter(move |(j, _)| *j != k).map(|b| b.1);
        let n: usize = others().map(|b| b.n).sum();
        let mut gram = vec![0.0; p * p];
        others().for_each(|b| linalg::axpy(1.0, &b.gram, &mut gram));
        (0..p).for_each(|i| gram[i * p + i] += ridge * n as f64);
        let factored = linalg::cholesky(&mut gram, p).is_ok();
        for (i, sum) in sums.iter_mut().enumerate() {
            let mut c = vec![0.0; p];
            others().for_each(|b| linalg::axpy(1.0, &b.products[i].0, &mut c));
            let solved = factored
                && linalg::solve_upper_transposed(&gram, p, &mut c).is_ok()
                && linalg::solve_upper(&gram, p, &mut c).is_ok();
            *sum += if solved { block.misfit(i, &c) } else { f64::INFINITY };
        }
    }
    sums
}

#[cfg(test)]
mod tests {
    use super::*;
    use dynocal_numerics::rng::Rng64;

    /// The sums equal those of fits without each block, and noise asks for a larger ridge.
    #[test]
    fn blocks_left_out_equal_refits() {
        let (n, p) = (300, 6);
        let mut rng = Rng64::stream(1, 0);
        let x: Vec<f64> = (0..n * p).map(|_| rng.normal()).collect();
        let exact: Vec<f64> = x.chunks(p).map(|r| 2.0 * r[0] - r[3]).collect();
        let noise: Vec<f64> = (0..n).map(|_| 20.0 * rng.normal()).collect();
        let y = vec![exact, noise];
        let ridges = chosen(&x, p, &y, &[n]).unwrap();
        assert_eq!(ridges, [1e-9, 1e-3]);
        let part = |a: usize, b: usize| {
            let y: Vec<&[f64]> = y.iter().map(|y| &y[a..b]).collect();
            Block::new(&x[a * p..b * p], p, &y).unwrap()
        };
        let blocks: Vec<Block> = (0..STRETCHES).map(|k| part(60 * k, 60 * (k + 1))).collect();
        let sums = left_out(&blocks, p, 2, 1e-4);
        let mut refitted = 0.0;
        for k in 0..STRETCHES {
            let keep = |t: &usize| !(60 * k..60 * (k + 1)).contains(t);
            let rows: Vec<f64> = (0..n).filter(keep).flat_map(|t| x[t * p..(t + 1) * p].to_vec()).collect();
            let out: Vec<f64> = (0..n).filter(keep).map(|t| y[1][t]).collect();
            let fit = linalg::least_squares(&rows, out.len(), p, &out, 1e-4 * out.len() as f64).unwrap();
            for t in 60 * k..60 * (k + 1) {
                refitted += (y[1][t] - linalg::dot(&x[t * p..(t + 1) * p], &fit.x)).powi(2);
            }
        }
        assert!((sums[1] / refitted - 1.0).abs() < 1e-9, "{} {refitted}", sums[1]);
    }
}
