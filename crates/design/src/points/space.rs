//! Points that fill the unit cube: a Latin hypercube, and one whose points keep far from each other.
//!
//! ```text
//! x_ik = (p_k(i) + 1/2) / n              p_k: a random order of 0 .. n-1 for each axis        Latin hypercube
//! phi  = ( sum_(i<j) d_ij^-q )^(1/q)     d: distances, q = 15; made small by exchanges          maximin
//! ```
//!
//! Every axis of either has one point in each of its n equal intervals. A large q makes phi that of the least distance alone, and small
//! steps in phi lead there.
//!
//! Sources: M. D. McKay, R. J. Beckman, W. J. Conover, Technometrics 21 (1979), 239-245; M. D. Morris, T. J. Mitchell, J. Stat.
//! Plan. Inference 43 (1995), 381-402 (phi, exchanges of a coordinate between two points).

use dynocal_numerics::rng::Rng64;

/// Exponent of the distances, and exchanges that are tried for each point and axis.
const POWER: i32 = 15;
const TRIES: usize = 60;

/// A Latin hypercube of `n` points in `d` dimensions, each coordinate in the middle of its interval; equal seeds give equal points.
///
/// ```
/// use dynocal_design::points::space::latin_hypercube;
/// let points = latin_hypercube(5, 2, 1);
/// let mut fifths: Vec<usize> = points.iter().map(|p| (5.0 * p[1]) as usize).collect();
/// fifths.sort();
/// assert_eq!(fifths, [0, 1, 2, 3, 4]);
/// ```
pub fn latin_hypercube(n: usize, d: usize, seed: u64) -> Vec<Vec<f64>> {
    let mut rng = Rng64::new(seed);
    let mut points = vec![vec![0.5; d]; n];
    for k in 0..d {
        for (point, place) in points.iter_mut().zip(shuffled(n, &mut rng)) {
            point[k] = (place as f64 + 0.5) / n as f64;
        }
    }
    points
}

/// A Latin hypercube whose least distance between two points is made large: exchanges of one coordinate between two points that make phi
/// smaller are kept.
pub fn maximin(n: usize, d: usize, seed: u64) -> Vec<Vec<f64>> {
    let mut points = latin_hypercube(n, d, seed);
    if n < 3 || d < 2 {
        return points;
    }
    let mut rng = Rng64::stream(seed, 1);
    let of = |p: &[Vec<f64>], i: usize| -> f64 {
        let others = p.iter().enumerate().filter(|(j, _)| *j != i);
        others.map(|(_, b)| distance(&p[i], b).max(f64::MIN_POSITIVE).powi(-POWER)).sum()
    };
    for _ in 0..TRIES * n * d {
        let (i, j, k) = (rng.below(n), rng.below(n), rng.below(d));
        if i == j {
            continue;
        }
        // The pair of both stands in either sum, before as after.
        let before = of(&points, i) + of(&points, j);
        let (a, b) = (points[i][k], points[j][k]);
        (points[i][k], points[j][k]) = (b, a);
        if of(&points, i) + of(&points, j) >= before {
            (points[i][k], points[j][k]) = (a, b);
        }
    }
    points
}

/// A random order of 0 .. n-1 (Fisher and Yates).
pub fn shuffled(n: usize, rng: &mut Rng64) -> Vec<usize> {
    let mut order: Vec<usize> = (0..n).collect();
    for i in (1..n).rev() {
        order.swap(i, rng.below(i + 1));
    }
    order
}

fn distance(a: &[f64], b: &[f64]) -> f64 {
    a.iter().zip(b).map(|(a, b)| (a - b).powi(2)).sum::<f64>().sqrt()
}

/// Least distance between two of the points; infinite with fewer than two.
pub fn least_distance(points: &[Vec<f64>]) -> f64 {
    let pairs = points.iter().enumerate().flat_map(|(i, a)| points[..i].iter().map(move |b| distance(a, b)));
    pairs.fold(f64::INFINITY, f64::min)
}
