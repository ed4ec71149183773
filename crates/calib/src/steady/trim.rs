//! A correction over the axes of a map, learnt from what was measured along its lines.
//!
//! ```text
//! minimise over c, d   sum_i w_i ( r_i - sum_k h_k(z_i) (c_k + s_i d_k) )^2  +  sum_axes ( lambda | D c |^2 + kappa | D d |^2 )  +  mu | d |^2
//! ```
//!
//! z: place over the axes, r: what was measured less what was expected, s: 1 where it was gone up the axis and -1 where it was gone down,
//! h: hats of the knots (multilinear between them), D: second differences over the knots, w: weights of the measurements. c is the
//! correction, d the lag of the way. It is none at rest, and comes with a time constant `tau` of its own ([`Way::developed`]).
//!
//! A window at the begin of a way has not all of the lag yet, and at the ends of the axes there are no other windows of that way; a rest at the turn tells what is at rest there.
//! `lambda`, `kappa >= lambda` and `tau` are those of least generalised cross-validation, sought one after the other, so that scatter is averaged and what is
//! there stays; a parameter counts 1.4 times there, since windows that follow each other are not independent, and the plain score then follows their scatter. Knots without a
//! measurement nearby go on as the others bend, but not beyond what was found where there are some. Where one way alone was measured `mu`,
//! which is small, takes it for the correction.
//!
//! References: P. Craven, G. Wahba, Smoothing noisy data with spline functions, Numerische Mathematik 31 (1979), 377; Y.-J. Kim, C. Gu, Smoothing spline
//! Gaussian regression, J. R. Statist. Soc. B 66 (2004), 337 (the factor).

use dynocal_numerics::linalg::{cholesky, cholesky_inverse, solve_upper, solve_upper_transposed};
use serde::{Deserialize, Serialize};

use super::grid::{corners, place};
pub use super::way::{Along, Way};

/// A correction over one or two axes.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Trim {
    /// Knots of each axis.
    pub axes: Vec<Vec<f64>>,
    /// Values at the knots, the last axis fastest.
    pub values: Vec<f64>,
    /// Lag of the way at the knots: half of what is between up and down.
    pub lag: Vec<f64>,
    /// Standard deviation of a measurement of weight 1 about both.
    pub scatter: f64,
    /// Root mean square of all measurements about both, whatever their weights.
    pub rest: f64,
    /// What cross-validation chose.
    pub choice: Choice,
}

/// How stiff a trim is.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Choice {
    /// Weight of the bending of the correction.
    pub lambda: f64,
    /// Weight of the bending of the lag.
    pub kappa: f64,
    /// Time constant with which the lag comes in s.
    pub tau_s: f64,
}

/// Weights that are tried, two in a decade from the first to the last, and the one that keeps knots solvable that nothing bears on: shares of the mean diagonal.
const LAMBDAS: [f64; 17] = [
    1e-4, 3.2e-4, 1e-3, 3.2e-3, 1e-2, 3.2e-2, 0.1, 0.32, 1.0, 3.2, 10.0, 32.0, 100.0, 320.0, 1e3, 3.2e3, 1e4,
];
/// How many times as stiff as the correction the lag may be. Where it was measured one way alone a lag that bends as freely takes what is the correction's.
const STIFFER: [f64; 7] = [1.0, 3.2, 10.0, 32.0, 100.0, 320.0, 1e3];
/// Most times that all three are sought one after the other.
const TURNS: usize = 4;
const RIDGE: f64 = 1e-9;
/// mu, as a share of the mean diagonal.
const NO_LAG: f64 = 1e-3;
/// How many times a parameter counts in the cross-validation.
const COUNTS: f64 = 1.4;
/// Time constants of the lag that are tried, as multiples of the longest window, and the largest as a share of the longest way. A lag that comes over a good
/// part of a way bends as a correction may: the two cancel where lines were gone there and back, and are both wrong beyond. With a sixteenth 95 % of it have come
/// after three sixteenths of the way.
const TAUS: [f64; 7] = [0.0, 0.25, 0.5, 1.0, 2.0, 4.0, 8.0];
const OF_WAY: f64 = 1.0 / 16.0;
/// The same as a share of the longest rest, where nothing was measured under way: it has to go while it rests to be told from what stays.
const OF_REST: f64 = 0.5;

impl Trim {
    /// From what was measured along lines; none where there is nothing, or where it is not finite.
    pub fn learn(axes: &[Vec<f64>], along: &Along) -> Option<Self> {
        Self::counting(axes, along, COUNTS)
    }

    /// The same with a parameter that counts so many times.
    fn counting(axes: &[Vec<f64>], along: &Along, counts: f64) -> Option<Self> {
        let longest_s = along.way.iter().map(|w| w.window_s).fold(0.0, f64::max);
        let gone_s = |rests: bool| {
            let each = along.way.iter().filter(|w| (w.up == 0.0) == rests);
            each.map(|w| w.since_s + w.window_s).fold(0.0, f64::max)
        };
        let (way_s, rest_s) = (gone_s(false), gone_s(true));
        let most_s = if way_s > 0.0 { OF_WAY * way_s } else { OF_REST * rest_s };
        let taus = TAUS.iter().map(|share| share * longest_s).filter(|t| *t <= most_s);
        let rows: Vec<(f64, Rows)> =
            taus.map(|tau_s| Some((tau_s, Rows::new(axes, along, tau_s)?))).collect::<Option<_>>()?;
        let (choice, fit) = chosen(&rows, counts)?;
        Some(Self::of(axes, along, fit, choice))
    }

    /// The same with a given choice.
    pub fn with(axes: &[Vec<f64>], along: &Along, choice: Choice) -> Option<Self> {
        let fit = Rows::new(axes, along, choice.tau_s)?.fit([choice.lambda, choice.kappa], COUNTS)?;
        Some(Self::of(axes, along, fit, choice))
    }

    fn of(axes: &[Vec<f64>], along: &Along, fit: Fit, choice: Choice) -> Self {
        let mut values = fit.values;
        let lag = values.split_off(values.len() / 2);
        let scatter = fit.scatter;
        let mut trim = Self { axes: axes.to_vec(), values, lag, scatter, rest: 0.0, choice };
        let found = along.at.iter().map(|z| trim.at(z));
        let (low, high) = found.fold((f64::INFINITY, f64::NEG_INFINITY), |(l, h), v| (l.min(v), h.max(v)));
        trim.values.iter_mut().for_each(|v| *v = v.clamp(low, high));
        let squares = (0..along.r.len()).map(|i| {
            let (z, up) = (&along.at[i], along.way[i].developed(choice.tau_s));
            (along.r[i] - trim.at(z) - up * trim.lag_at(z)).powi(2)
        });
        trim.rest = (squares.sum::<f64>() / along.r.len().max(1) as f64).sqrt();
        trim
    }

    /// The correction at the axes `at`, held at the edges.
    pub fn at(&self, at: &[f64]) -> f64 {
        corners(&self.axes, at).iter().map(|(k, w)| w * self.values[*k]).sum()
    }

    /// Lag of the way at the axes `at`, once it has come.
    pub fn lag_at(&self, at: &[f64]) -> f64 {
        corners(&self.axes, at).iter().map(|(k, w)| w * self.lag[*k]).sum()
    }
}

/// A choice of least score among those beside it: each of its three values in turn over all that are tried, the others as they are by then, until none changes any more.
/// The whole grid is 833 fits, and this at most 124. `rows`: of each time constant.
fn chosen(rows: &[(f64, Rows)], counts: f64) -> Option<(Choice, Fit)> {
    let fit = |[l, k, t]: [usize; 3]| {
        let lambda = LAMBDAS[l];
        rows.get(t)?.1.fit([lambda, STIFFER[k] * lambda], counts)
    };
    let (mut at, sizes) =
        ([LAMBDAS.len() / 2, STIFFER.len() / 2, 0], [LAMBDAS.len(), STIFFER.len(), rows.len()]);
    let mut best: Option<Fit> = None;
    for _ in 0..TURNS {
        let before = at;
        for (axis, size) in sizes.into_iter().enumerate() {
            let from = at;
            for k in 0..size {
                let mut other = from;
                other[axis] = k;
                let better = |f: &Fit| best.as_ref().is_none_or(|b| f.score < b.score);
                if let Some(found) = fit(other).filter(better) {
                    (best, at) = (Some(found), other);
                }
            }
        }
        if at == before {
            break;
        }
    }
    let lambda = LAMBDAS[at[0]];
    let choice = Choice { lambda, kappa: STIFFER[at[1]] * lambda, tau_s: rows.get(at[2])?.0 };
    Some((choice, best?))
}

/// The normal equations without their weight of the bending.
struct Rows {
    n: usize,
    count: f64,
    /// H'H, H'r, r'r.
    gram: Vec<f64>,
    right: Vec<f64>,
    square: f64,
    bending: Vec<f64>,
    /// Mean diagonal of H'H over that of the bending.
    scale: f64,
}

struct Fit {
    values: Vec<f64>,
    scatter: f64,
    score: f64,
}

impl Rows {
    fn new(axes: &[Vec<f64>], along: &Along, tau_s: f64) -> Option<Self> {
        let Along { at, way, r, weight } = along;
        let knots: usize = axes.iter().map(Vec::len).product();
        let n = 2 * knots;
        if r.is_empty() || n == 0 || !r.iter().chain(weight).chain(at.iter().flatten()).all(|v| v.is_finite())
        {
            return None;
        }
        let (mut gram, mut right) = (vec![0.0; n * n], vec![0.0; n]);
        for (((z, way), r), weight) in at.iter().zip(way).zip(r).zip(weight) {
            let (around, up) = (corners(axes, z), way.developed(tau_s));
            let lags: Vec<(usize, f64)> = around.iter().map(|(k, w)| (knots + k, up * w)).collect();
            let around = [around, lags].concat();
            for (k, w) in &around {
                right[*k] += weight * w * r;
                around.iter().for_each(|(j, v)| gram[k * n + j] += weight * w * v);
            }
        }
        let bending = bending(axes);
        let trace = |a: &[f64]| (0..n).map(|k| a[k * n + k]).sum::<f64>();
        let stiff = trace(&bending);
        let scale = if stiff > 0.0 { trace(&gram) / stiff } else { 0.0 };
        let square = r.iter().zip(weight).map(|(r, w)| w * r * r).sum();
        Some(Self { n, count: r.len() as f64, gram, right, square, bending, scale })
    }

    /// With the weights of the bending of correction and lag, and a parameter that counts so many times.
    fn fit(&self, [lambda, kappa]: [f64; 2], counts: f64) -> Option<Fit> {
        let n = self.n;
        let mean = (0..n).map(|k| self.gram[k * n + k]).sum::<f64>() / n as f64;
        let ridge = |k: usize| if k < n / 2 { RIDGE * mean } else { NO_LAG * mean };
        let stiff = |i: usize| self.scale * if i < n * n / 2 { lambda } else { kappa };
        let each = self.gram.iter().zip(&self.bending).enumerate();
        let mut a: Vec<f64> = each.map(|(i, (g, b))| g + stiff(i) * b).collect();
        (0..n).for_each(|k| a[k * n + k] += ridge(k));
        cholesky(&mut a, n).ok()?;
        let mut values = self.right.clone();
        solve_upper_transposed(&a, n, &mut values).ok()?;
        solve_upper(&a, n, &mut values).ok()?;
        let (mut work, mut inverse) = (vec![0.0; n * n], vec![0.0; n * n]);
        cholesky_inverse(&a, n, &mut work, &mut inverse).ok()?;
        // Trace of the hat matrix; the inverse holds its upper triangle.
        let of = |i: usize, j: usize| inverse[i.min(j) * n + i.max(j)];
        let used: f64 = (0..n)
            .flat_map(|i| (0..n).map(move |j| (i, j)))
            .map(|(i, j)| of(i, j) * self.gram[i * n + j])
            .sum();
        let times = |i: usize| (0..n).map(|j| self.gram[i * n + j] * values[j]).sum::<f64>();
        let explained: f64 = (0..n).map(|i| values[i] * (2.0 * self.right[i] - times(i))).sum();
        let rest = (self.square - explained).max(0.0);
        let free = (self.count - used).max(1e-3 * self.count);
        let scatter = (rest / free).sqrt();
        let left = (self.count - counts * used).max(1e-3 * self.count);
        Some(Fit { values, scatter, score: self.count * rest / (left * left) })
    }
}

/// Sum of the squared second differences along every line of every axis, over knots in shares of the axis; of correction and lag.
fn bending(axes: &[Vec<f64>]) -> Vec<f64> {
    let knots: usize = axes.iter().map(Vec::len).product();
    let n = 2 * knots;
    let mut sum = vec![0.0; n * n];
    let mut stride = 1;
    for axis in axes.iter().rev() {
        let last = axis.len() - 1;
        let mean = (axis[last] - axis[0]) / last.max(1) as f64;
        for k in 0..knots {
            let i = (k / stride) % axis.len();
            if i == 0 || i == last {
                continue;
            }
            let (before, after) = ((axis[i] - axis[i - 1]) / mean, (axis[i + 1] - axis[i]) / mean);
            let row =
                [(k - stride, 1.0 / before), (k, -1.0 / before - 1.0 / after), (k + stride, 1.0 / after)];
            for (a, v) in row {
                for (b, w) in row {
                    sum[a * n + b] += v * w;
                    sum[(knots + a) * n + knots + b] += v * w;
                }
            }
        }
        stride *= axis.len();
    }
    sum
}

/// Knots of a map: the values of its axes with `between` more in each interval.
pub fn finer(axes: &[Vec<f64>], between: usize) -> Vec<Vec<f64>> {
    let one = |axis: &Vec<f64>| -> Vec<f64> {
        let parts = between + 1;
        let inner = axis.windows(2).flat_map(|w| {
            let (a, b) = (w[0], w[1]);
            (0..parts).map(move |k| a + (b - a) * k as f64 / parts as f64)
        });
        inner.chain(axis.last().copied()).collect()
    };
    axes.iter().map(one).collect()
}

/// Places of all knots, the last axis fastest.
pub fn places(axes: &[Vec<f64>]) -> Vec<Vec<f64>> {
    (0..axes.iter().map(Vec::len).product()).map(|k| place(axes, k)).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use dynocal_numerics::rng::Rng64;

    fn axes() -> Vec<Vec<f64>> {
        vec![vec![0.0, 1.0, 2.0, 3.0], vec![10.0, 20.0, 40.0]]
    }

    /// As stiff in its lag as in its correction, and a lag that is there at once.
    fn alike(lambda: f64) -> Choice {
        Choice { lambda, kappa: lambda, tau_s: 0.0 }
    }

    /// Measured long after the begin of the way.
    fn along(at: &[Vec<f64>], up: &[f64], r: &[f64]) -> Along {
        let way = |up: &f64| Way { up: *up, since_s: 1e6, before: [(0.0, 0.0); 2], window_s: 1.0 };
        Along {
            at: at.to_vec(),
            way: up.iter().map(way).collect(),
            r: r.to_vec(),
            weight: vec![1.0; r.len()],
        }
    }

    /// A lag that comes with a time constant, and a correction that bends at the end of the axis, where the lag of the way there is not yet
    /// there and that of the way back is: both are found. With a lag that is there at once the bend is taken for lag.
    #[test]
    fn a_lag_that_comes_is_no_bend_at_the_end() {
        let (tau_s, window_s, pass_s) = (2.0, 2.0, 40.0);
        let bent = |x: f64| 0.01 * (1.0 - x).max(0.0) + 0.002 * x;
        let axes = vec![vec![0.0, 1.0, 2.0, 3.0]];
        let mut rng = Rng64::new(2);
        let mut all = Along::default();
        for (up, before_s) in [(1.0, 0.0), (-1.0, pass_s)] {
            for k in 0..20 {
                let since_s = window_s * f64::from(k);
                let gone = 3.0 * (since_s + 0.5 * window_s) / pass_s;
                let x = if up > 0.0 { gone } else { 3.0 - gone };
                let way = Way { up, since_s, before: [(0.0, 0.0), (-up, before_s)], window_s };
                let r = bent(x) + 0.015 * way.developed(tau_s) + 1e-4 * rng.normal();
                all.push(vec![x], way, r, 1.0);
            }
        }
        let trim = Trim::learn(&axes, &all).unwrap();
        assert_eq!(trim.choice.tau_s, tau_s);
        // A lag of a good part of the way is not sought, whatever the windows say: it is not told from a bend.
        let lagging: Vec<f64> = all.way.iter().map(|w| 0.015 * w.developed(16.0)).collect();
        let found = Trim::learn(&axes, &Along { r: lagging, ..all.clone() }).unwrap();
        assert!(found.choice.tau_s <= OF_WAY * pass_s, "{:?}", found.choice);
        // Its bend is smoothed a little.
        assert!((trim.at(&[0.0]) - 0.01).abs() < 1e-3, "{:?}", trim.values);
        let at_once = Trim::with(&axes, &all, Choice { tau_s: 0.0, ..trim.choice }).unwrap();
        assert!((at_once.at(&[0.0]) - 0.01).abs() > 2e-3, "{:?}", at_once.values);
        // The law itself: nothing at rest, all of it after a while, the other way round after a turn.
        let way = |since_s, before_s| Way {
            up: 1.0,
            since_s,
            before: [(0.0, 0.0), (-1.0, before_s)],
            window_s: 0.0,
        };
        assert_eq!(way(0.0, 0.0).developed(2.0), 0.0);
        assert!((way(2.0, 0.0).developed(2.0) - (1.0 - (-1.0_f64).exp())).abs() < 1e-12);
        assert!((way(0.0, 1e3).developed(2.0) + 1.0).abs() < 1e-12);
        // And it goes while it rests.
        let rest = Way { up: 0.0, before: [(0.0, 0.0), (1.0, 1e3)], ..way(2.0, 0.0) };
        assert!((rest.developed(2.0) - (-1.0_f64).exp()).abs() < 1e-12);
        let behind = Way { up: -1.0, before: [(1.0, 1e3), (0.0, 2.0)], ..way(0.0, 0.0) };
        assert!((behind.developed(2.0) - (-1.0_f64).exp()).abs() < 1e-12);
    }

    /// What is bilinear is not bent: it is found again whatever its weight, and goes on where nothing was measured, but not beyond
    /// the greatest and the least of what was (here 1.8 and 0.6).
    #[test]
    fn a_plane_is_found_again_and_goes_on_within_its_range() {
        let plane = |z: &[f64]| (1.0 + 0.5 * z[0] - 0.02 * z[1]).clamp(0.6, 1.8);
        let at: Vec<Vec<f64>> = (0..60)
            .map(|k| vec![2.0 * f64::from(k % 10) / 9.0, [10.0, 20.0][(k / 10 % 2) as usize]])
            .collect();
        let r: Vec<f64> = at.iter().map(|z| plane(z)).collect();
        let up: Vec<f64> = (0..60).map(|k| if k < 30 { 1.0 } else { -1.0 }).collect();
        let trim = Trim::learn(&axes(), &along(&at, &up, &r)).unwrap();
        for z in places(&axes()) {
            // Where nothing was measured the small weight that makes it unique is left.
            assert!((trim.at(&z) - plane(&z)).abs() < 1e-3, "{z:?}: {} {}", trim.at(&z), plane(&z));
        }
        assert!(trim.scatter < 1e-5, "{}", trim.scatter);
    }

    /// Lags are opposite up and down: their mean is what is at rest. Scatter is known at its size.
    #[test]
    fn up_and_down_are_averaged_and_the_scatter_is_known() {
        let mut rng = Rng64::new(3);
        let bent = |x: f64| 0.1 * (1.5 * x).sin();
        let axes = finer(&[vec![0.0, 1.0, 2.0, 3.0]], 1);
        assert_eq!(axes[0], vec![0.0, 0.5, 1.0, 1.5, 2.0, 2.5, 3.0]);
        let (mut at, mut up, mut r) = (Vec::new(), Vec::new(), Vec::new());
        for k in 0..400 {
            // Up by even steps, down by others: a mean alone would not do.
            let (x, way) = match k {
                0..100 => (3.0 * f64::from(k) / 99.0, 1.0),
                _ => (3.0 * f64::from(k - 100) / 299.0, -1.0),
            };
            at.push(vec![x]);
            up.push(way);
            r.push(bent(x) + 0.03 * way + 0.01 * rng.normal());
        }
        let trim = Trim::learn(&axes, &along(&at, &up, &r)).unwrap();
        // Hats half a unit apart miss a sine by 0.1 1.5^2 0.5^2 / 8.
        let worst = (0..31).map(|k| f64::from(k) / 10.0).map(|x| (trim.at(&[x]) - bent(x)).abs());
        assert!(worst.fold(0.0, f64::max) < 0.012);
        assert!(trim.lag.iter().all(|d| (d - 0.03).abs() < 0.01), "{:?}", trim.lag);
        assert!((trim.scatter / 0.01 - 1.0).abs() < 0.15, "{}", trim.scatter);
        assert!(Trim::learn(&axes, &Along::default()).is_none());
        assert!(Trim::learn(&axes, &along(&[vec![0.5]], &[1.0], &[f64::NAN])).is_none());
    }

    /// Where one way alone was measured its lag cannot be told from the correction: it stays with it, and neither runs away.
    #[test]
    fn one_way_alone_takes_its_lag_with_it() {
        let axes = finer(&[vec![0.0, 1.0, 2.0, 3.0]], 1);
        let both = (0..90).map(|k| (1.2 * f64::from(k % 45) / 44.0, if k < 45 { 1.0 } else { -1.0 }));
        let up = (0..60).map(|k| (1.2 + 1.8 * f64::from(k) / 59.0, 1.0));
        let (mut at, mut ways, mut r) = (Vec::new(), Vec::new(), Vec::new());
        for (x, way) in both.chain(up) {
            at.push(vec![x]);
            ways.push(way);
            r.push(0.1 + 0.03 * (x - 1.2_f64).max(0.0).powi(3) + 0.02 * way);
        }
        for lambda in [1e-6, 1e-4, 1e-3] {
            let trim = Trim::with(&axes, &along(&at, &ways, &r), alike(lambda)).unwrap();
            let worst = trim.lag.iter().map(|d| d.abs()).fold(0.0, f64::max);
            assert!(worst < 0.1, "{lambda}: {:?}", trim.lag);
        }
        let trim = Trim::learn(&axes, &along(&at, &ways, &r)).unwrap();
        for x in [1.5, 2.0, 2.5, 3.0] {
            let missed = trim.at(&[x]) - 0.1 - 0.03 * (x - 1.2_f64).powi(3);
            assert!((-0.02..0.05).contains(&missed), "{x}: {missed}");
        }
    }

    /// Windows that follow each other miss in the same direction: a score that counts a parameter once follows that, and errs more in the mean of ten days.
    #[test]
    fn scatter_that_lasts_is_followed_less_where_a_parameter_counts_more() {
        let axes = finer(&[vec![0.0, 1.0, 2.0, 3.0, 4.0, 5.0], vec![0.0, 1.0, 2.0]], 1);
        let truth = |z: &[f64]| 0.05 * (0.8 * z[0]).sin() * (1.0 + 0.3 * z[1]);
        let day = |seed: u64| {
            let mut rng = Rng64::new(seed);
            let (mut at, mut up, mut r, mut lasts) = (Vec::new(), Vec::new(), Vec::new(), 0.0);
            for (line, way) in [0.0, 1.0, 2.0].into_iter().flat_map(|line| [(line, 1.0), (line, -1.0)]) {
                for k in 0..20 {
                    let gone = 5.0 * (f64::from(k) + 0.5) / 20.0;
                    // Behind the turn some do not count.
                    if way < 0.0 && (4..9).contains(&k) {
                        continue;
                    }
                    lasts = 0.7 * lasts + 0.02 * rng.normal();
                    let z = vec![if way > 0.0 { gone } else { 5.0 - gone }, line];
                    r.push(truth(&z) + 0.02 * way + lasts);
                    at.push(z);
                    up.push(way);
                }
            }
            along(&at, &up, &r)
        };
        let error = |counts: f64| -> f64 {
            let one = |seed: u64| {
                let t = Trim::counting(&axes, &day(seed), counts).unwrap();
                let each = places(&axes).into_iter().map(|z| (t.at(&z) - truth(&z)).powi(2));
                (each.sum::<f64>() / t.values.len() as f64).sqrt()
            };
            (1..=10).map(one).sum::<f64>() / 10.0
        };
        let (once, more) = (error(1.0), error(COUNTS));
        assert!(more < once && more < 0.03, "{once} {more}");
    }

    /// White noise is no bend: the weight that cross-validation takes leaves less of it than the softest one,
    /// and less than one measurement has.
    #[test]
    fn scatter_is_not_followed() {
        let mut rng = Rng64::new(5);
        let axes = finer(&[vec![0.0, 1.0, 2.0, 3.0], vec![0.0, 1.0, 2.0]], 1);
        let at: Vec<Vec<f64>> = (0..120).map(|_| vec![3.0 * rng.uniform(), 2.0 * rng.uniform()]).collect();
        let r: Vec<f64> = at.iter().map(|z| 0.2 * z[0] * z[1] + 0.1 * rng.normal()).collect();
        let error = |t: &Trim| {
            let each = places(&axes).into_iter().map(|z| (t.at(&z) - 0.2 * z[0] * z[1]).powi(2));
            (each.sum::<f64>() / t.values.len() as f64).sqrt()
        };
        let up: Vec<f64> = (0..120).map(|k| if k % 2 == 0 { 1.0 } else { -1.0 }).collect();
        let chosen = Trim::learn(&axes, &along(&at, &up, &r)).unwrap();
        let soft = Trim::with(&axes, &along(&at, &up, &r), alike(LAMBDAS[0])).unwrap();
        assert!(
            error(&chosen) < 0.1 && error(&chosen) < 0.6 * error(&soft),
            "{} {}",
            error(&chosen),
            error(&soft)
        );
    }
}
