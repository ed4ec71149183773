//! Points of a steady test: a low-discrepancy sequence over the unit cube; [`space`] has Latin hypercubes, [`optimal`] what is best for a
//! polynomial.
//!
//! ```text
//! v_k = m_k 2^(32-k),   m_k by the primitive polynomial of the dimension
//! x_(i+1) = x_i xor v_c,   c: place of the lowest zero bit of i               Gray code
//! u_i = (x_i xor r) / 2^32,   r drawn once for each dimension                 digital shift
//! ```
//!
//! Every 2^k points in a row from a multiple of 2^k on have one point in each of the 2^k equal intervals of every axis, also
//! after the shift: a test that ends early has filled the space as well as it could.
//!
//! Sources: I. M. Sobol', USSR Comput. Math. Math. Phys. 7 (1967), 86-112; I. A. Antonov, V. M. Saleev, ibid. 19 (1979),
//! 252-256 (order); S. Joe, F. Y. Kuo, SIAM J. Sci. Comput. 30 (2008), 2635-2654 (direction numbers).
//!
//! ```
//! use dynocal_design::points::Sobol;
//! let mut sequence = Sobol::new(2, 7).unwrap();
//! let points: Vec<Vec<f64>> = (0..8).map(|_| sequence.next_point()).collect();
//! let mut eighths: Vec<usize> = points.iter().map(|p| (8.0 * p[0]) as usize).collect();
//! eighths.sort();
//! assert_eq!(eighths, [0, 1, 2, 3, 4, 5, 6, 7]);
//! ```

use dynocal_numerics::rng::Rng64;

pub mod optimal;
pub mod space;

/// Degree, inner coefficients and first direction numbers m of the dimensions from the second on.
const DIRECTIONS: &[(u32, u32, &[u32])] = &[
    (1, 0, &[1]),
    (2, 1, &[1, 3]),
    (3, 1, &[1, 3, 1]),
    (3, 2, &[1, 1, 1]),
    (4, 1, &[1, 1, 3, 3]),
    (4, 4, &[1, 3, 5, 13]),
    (5, 2, &[1, 1, 5, 5, 17]),
    (5, 4, &[1, 1, 5, 5, 5]),
    (5, 7, &[1, 1, 7, 11, 19]),
    (5, 11, &[1, 1, 5, 1, 1]),
    (5, 13, &[1, 1, 1, 3, 11]),
    (5, 14, &[1, 3, 5, 5, 31]),
    (6, 1, &[1, 3, 3, 9, 7, 49]),
    (6, 13, &[1, 1, 1, 15, 21, 21]),
    (6, 16, &[1, 3, 1, 13, 27, 49]),
];

/// Most dimensions of [`Sobol`].
pub const MOST_DIMENSIONS: usize = 16;

const BITS: usize = 32;

/// A Sobol' sequence with a digital shift.
#[derive(Clone, Debug)]
pub struct Sobol {
    /// Direction numbers, one row for each dimension.
    directions: Vec<[u32; BITS]>,
    state: Vec<u32>,
    shift: Vec<u32>,
    index: u32,
}

impl Sobol {
    /// A sequence in `d` dimensions whose shift is drawn by `seed`; none where d is 0 or above [`MOST_DIMENSIONS`].
    pub fn new(d: usize, seed: u64) -> Option<Self> {
        if !(1..=MOST_DIMENSIONS).contains(&d) {
            return None;
        }
        let directions = (0..d).map(directions_of).collect();
        let mut rng = Rng64::new(seed);
        let shift = (0..d).map(|_| (rng.uniform() * 2f64.powi(BITS as i32)) as u32).collect();
        Some(Self { directions, state: vec![0; d], shift, index: 0 })
    }

    /// The next point (d), each coordinate in [0, 1).
    pub fn next_point(&mut self) -> Vec<f64> {
        let pairs = self.state.iter().zip(&self.shift);
        let point = pairs.map(|(x, r)| f64::from(x ^ r) / 2f64.powi(BITS as i32)).collect();
        let lowest_zero = self.index.trailing_ones() as usize;
        // After 2^32 points the sequence begins again.
        if lowest_zero < BITS {
            for (x, v) in self.state.iter_mut().zip(&self.directions) {
                *x ^= v[lowest_zero];
            }
        } else {
            self.state.fill(0);
        }
        self.index = self.index.wrapping_add(1);
        point
    }
}

fn directions_of(dimension: usize) -> [u32; BITS] {
    let mut v = [0; BITS];
    let Some((degree, inner, first)) = dimension.checked_sub(1).map(|k| DIRECTIONS[k]) else {
        (0..BITS).for_each(|k| v[k] = 1 << (BITS - 1 - k));
        return v;
    };
    let s = degree as usize;
    for k in 0..BITS {
        v[k] = if k < s {
            first[k] << (BITS - 1 - k)
        } else {
            let mut value = v[k - s] ^ (v[k - s] >> degree);
            for j in 1..s {
                if (inner >> (s - 1 - j)) & 1 == 1 {
                    value ^= v[k - j];
                }
            }
            value
        };
    }
    v
}

/// Places of `points` (each d) in an order of short ways: from `start` on always the nearest that is left, by the largest
/// difference of a coordinate.
pub fn short_ways(points: &[Vec<f64>], start: &[f64]) -> Vec<usize> {
    let distance = |a: &[f64], b: &[f64]| a.iter().zip(b).map(|(a, b)| (a - b).abs()).fold(0.0, f64::max);
    let mut left: Vec<usize> = (0..points.len()).collect();
    let (mut order, mut at) = (Vec::with_capacity(points.len()), start);
    while !left.is_empty() {
        let near = (0..left.len())
            .min_by(|a, b| distance(at, &points[left[*a]]).total_cmp(&distance(at, &points[left[*b]])));
        let next = left.remove(near.unwrap_or(0));
        at = &points[next];
        order.push(next);
    }
    order
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Every axis alone, and the first two together, are nets: one point in each elementary interval.
    #[test]
    fn intervals_hold_one_point_each_whatever_the_shift() {
        for seed in [0, 1, 99] {
            let mut s = Sobol::new(MOST_DIMENSIONS, seed).unwrap();
            let points: Vec<Vec<f64>> = (0..256).map(|_| s.next_point()).collect();
            for d in 0..MOST_DIMENSIONS {
                for block in points.chunks(64) {
                    let mut cells: Vec<usize> = block.iter().map(|p| (64.0 * p[d]) as usize).collect();
                    cells.sort_unstable();
                    assert!(cells.iter().enumerate().all(|(k, c)| k == *c), "dimension {d}: {cells:?}");
                }
            }
            for rows in [1usize, 4, 16, 64, 256] {
                let columns = 256 / rows;
                let cell =
                    |p: &Vec<f64>| (p[0] * rows as f64) as usize * columns + (p[1] * columns as f64) as usize;
                let mut cells: Vec<usize> = points.iter().map(cell).collect();
                cells.sort_unstable();
                assert!(cells.iter().enumerate().all(|(k, c)| k == *c), "{rows} x {columns}");
            }
        }
    }

    /// No two dimensions are alike: the mean of a product over a whole net is the product of the means, to what the net resolves.
    #[test]
    fn dimensions_are_not_copies_of_each_other() {
        let mut s = Sobol::new(MOST_DIMENSIONS, 3).unwrap();
        let n = 4096;
        let points: Vec<Vec<f64>> = (0..n).map(|_| s.next_point()).collect();
        for a in 0..MOST_DIMENSIONS {
            for b in 0..a {
                let mean = points.iter().map(|p| (p[a] - 0.5) * (p[b] - 0.5)).sum::<f64>() / f64::from(n);
                // Copies would give 1/12.
                assert!(mean.abs() < 0.01, "{a} {b}: {mean}");
            }
        }
    }

    #[test]
    fn sizes_that_there_are_not() {
        assert!(Sobol::new(0, 1).is_none() && Sobol::new(MOST_DIMENSIONS + 1, 1).is_none());
    }

    #[test]
    fn an_order_takes_every_point_once_and_is_no_longer_than_the_given_one() {
        let mut s = Sobol::new(3, 5).unwrap();
        let points: Vec<Vec<f64>> = (0..40).map(|_| s.next_point()).collect();
        let order = short_ways(&points, &[0.5; 3]);
        let mut all = order.clone();
        all.sort_unstable();
        assert!(all.into_iter().eq(0..40));
        let step = |a: usize, b: usize| -> f64 {
            points[a].iter().zip(&points[b]).map(|(x, y)| (x - y).abs()).fold(0.0, f64::max)
        };
        let length = |o: &[usize]| o.windows(2).map(|w| step(w[0], w[1])).sum::<f64>();
        assert!(length(&order) < length(&(0..40).collect::<Vec<_>>()));
    }
}
