//! Points that are best for a quadratic polynomial: chosen among candidates, beside those that there are.
//!
//! ```text
//! f(x) = (1, x_k, x_k^2, x_k x_l)                 x: the unit cube, moved to [-1, 1]
//! M    = sum_i f(x_i) f(x_i)' + r I               points that there are and chosen ones; r = 1e-6 where they are too few for the terms
//! d    maximise log det M                         the volume of the confidence ellipsoid of the coefficients
//! i    minimise mean of f(z)' M^-1 f(z)           over places z: the mean variance of what is predicted there
//! ```
//!
//! Points are taken one by one, each the best beside the ones before (rank-one updates), then each is exchanged for the best
//! candidate as long as that helps.
//!
//! Sources: V. V. Fedorov, Theory of Optimal Experiments, Academic Press 1972 (exchange); R. D. Cook, C. J. Nachtsheim, Technometrics
//! 22 (1980), 315-324 (comparison of exchange algorithms); A. C. Atkinson, A. N. Donev, R. D. Tobias, Optimum Experimental Designs,
//! with SAS, Oxford 2007, chapters 10 to 12 (criteria, updates).

/// What makes points good.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Criterion {
    /// Determinant of the information.
    Determinant,
    /// Mean variance of the prediction over places.
    MeanVariance,
}

/// Added to the diagonal of the information, so that it can be inverted from the first point on.
const RIDGE: f64 = 1e-6;
/// Passes of exchanges, and gain of the criterion that counts as one.
const PASSES: usize = 10;
const GAIN: f64 = 1e-9;

/// Terms of the quadratic at a place of the unit cube.
pub fn terms(unit: &[f64]) -> Vec<f64> {
    let x: Vec<f64> = unit.iter().map(|u| 2.0 * u - 1.0).collect();
    let mut all = vec![1.0];
    all.extend(&x);
    for (k, a) in x.iter().enumerate() {
        all.extend(x[k..].iter().map(|b| a * b));
    }
    all
}

/// Number of terms of the quadratic in `d` dimensions.
pub fn terms_of(d: usize) -> usize {
    (d + 1) * (d + 2) / 2
}

/// The inverse of the information, with what the mean variance needs.
struct Information {
    p: usize,
    /// M^-1.
    inverse: Vec<f64>,
    /// Mean of f f' over the places.
    moments: Vec<f64>,
    criterion: Criterion,
}

impl Information {
    fn new(p: usize, places: &[Vec<f64>], criterion: Criterion) -> Self {
        let mut inverse = vec![0.0; p * p];
        (0..p).for_each(|k| inverse[k * p + k] = 1.0 / RIDGE);
        let mut moments = vec![0.0; p * p];
        for f in places {
            for (row, a) in moments.chunks_mut(p).zip(f) {
                row.iter_mut().zip(f).for_each(|(m, b)| *m += a * b / places.len() as f64);
            }
        }
        Self { p, inverse, moments, criterion }
    }

    /// M^-1 f.
    fn times(&self, f: &[f64]) -> Vec<f64> {
        self.inverse.chunks(self.p).map(|row| dot(row, f)).collect()
    }

    /// What the criterion gains by one more point (`sign` 1), or loses by one less (-1): log det M grows by log(1 + v), the trace of
    /// M^-1 W falls by g' W g / (1 + v), with v = f' M^-1 f and g = M^-1 f.
    fn change(&self, f: &[f64], sign: f64) -> f64 {
        let g = self.times(f);
        let v = 1.0 + sign * dot(f, &g);
        match self.criterion {
            Criterion::Determinant => v.max(f64::MIN_POSITIVE).ln(),
            Criterion::MeanVariance => {
                let weighted: f64 =
                    self.moments.chunks(self.p).zip(&g).map(|(row, a)| a * dot(row, &g)).sum();
                sign * weighted / v.max(f64::MIN_POSITIVE)
            }
        }
    }

    /// One point more or less (Sherman and Morrison).
    fn update(&mut self, f: &[f64], sign: f64) {
        let g = self.times(f);
        let scale = sign / (1.0 + sign * dot(f, &g));
        for (row, a) in self.inverse.chunks_mut(self.p).zip(&g) {
            row.iter_mut().zip(&g).for_each(|(m, b)| *m -= scale * a * b);
        }
    }
}

fn dot(a: &[f64], b: &[f64]) -> f64 {
    a.iter().zip(b).map(|(a, b)| a * b).sum()
}

/// Numbers of the `count` candidates that are best beside the points `there`; fewer where there are fewer candidates. All are places of the
/// unit cube; `over` are those at which the mean variance counts.
///
/// ```
/// use dynocal_design::points::optimal::{Criterion, choose};
/// // A quadratic over one axis: both ends and the middle.
/// let candidates: Vec<Vec<f64>> = (0..=20).map(|k| vec![k as f64 / 20.0]).collect();
/// let mut found = choose(&[], &candidates, &candidates, 3, Criterion::Determinant);
/// found.sort();
/// assert_eq!(found, [0, 10, 20]);
/// ```
pub fn choose(
    there: &[Vec<f64>],
    candidates: &[Vec<f64>],
    over: &[Vec<f64>],
    count: usize,
    criterion: Criterion,
) -> Vec<usize> {
    let Some(d) = candidates.first().map(Vec::len) else { return Vec::new() };
    let of = |points: &[Vec<f64>]| -> Vec<Vec<f64>> { points.iter().map(|x| terms(x)).collect() };
    let (all, places) = (of(candidates), of(over));
    let mut known = Information::new(terms_of(d), &places, criterion);
    of(there).iter().for_each(|f| known.update(f, 1.0));
    let (mut left, mut chosen): (Vec<bool>, Vec<usize>) = (vec![true; all.len()], Vec::new());
    let best = |known: &Information, left: &[bool]| -> Option<(usize, f64)> {
        let open = (0..all.len()).filter(|k| left[*k]);
        let gains = open.map(|k| (k, known.change(&all[k], 1.0)));
        gains.max_by(|a, b| a.1.total_cmp(&b.1).then(b.0.cmp(&a.0)))
    };
    while chosen.len() < count {
        let Some((k, _)) = best(&known, &left) else { break };
        known.update(&all[k], 1.0);
        left[k] = false;
        chosen.push(k);
    }
    for _ in 0..PASSES {
        let mut moved = false;
        for place in &mut chosen {
            let old = *place;
            let loss = -known.change(&all[old], -1.0);
            known.update(&all[old], -1.0);
            left[old] = true;
            let (new, gain) = best(&known, &left).unwrap_or((old, loss));
            let better = gain > loss + GAIN * loss.abs().max(1e-12);
            *place = if better { new } else { old };
            known.update(&all[*place], 1.0);
            left[*place] = false;
            moved |= better;
        }
        if !moved {
            break;
        }
    }
    chosen
}

/// Mean variance of the prediction over the places `over` after the points, for noise of variance 1; very large where the points are too
/// few for the terms.
pub fn mean_variance(points: &[Vec<f64>], over: &[Vec<f64>]) -> f64 {
    let Some(d) = over.first().map(Vec::len) else { return 0.0 };
    let places: Vec<Vec<f64>> = over.iter().map(|x| terms(x)).collect();
    let mut known = Information::new(terms_of(d), &places, Criterion::MeanVariance);
    points.iter().for_each(|x| known.update(&terms(x), 1.0));
    known.inverse.iter().zip(&known.moments).map(|(a, b)| a * b).sum()
}

/// Logarithm of the determinant of the information of the points.
pub fn log_determinant(points: &[Vec<f64>]) -> f64 {
    let Some(d) = points.first().map(Vec::len) else { return f64::NEG_INFINITY };
    let p = terms_of(d);
    let mut known = Information::new(p, &[], Criterion::Determinant);
    points.iter().fold(p as f64 * RIDGE.ln(), |sum, x| {
        let f = terms(x);
        let gain = known.change(&f, 1.0);
        known.update(&f, 1.0);
        sum + gain
    })
}
