//! The design measure over a finite set of windows that makes ln det largest, and the bound at it.

use super::windows::Windows;
use crate::kernel;
use dynocal_numerics::rng::Rng64;
use rayon::prelude::*;

/// Windows whose rows are formed at once.
const BLOCK: usize = 64;
/// Parts of a pass over all windows; each offers its best window.
const PARTS: usize = 256;
/// Bounds are improved until a better measure could not lower them by more than this.
const SLACK: f64 = 0.05;
/// Passes over all windows at most.
const PASSES: usize = 5;
/// Rounds of local search between two passes at most.
const ROUNDS: usize = 25;
/// Multiplicative updates after every change of the support at most.
const UPDATES: usize = 100;
/// Weight below which a window leaves the support.
const LEAST_WEIGHT: f64 = 1e-6;

/// What was found.
pub(super) struct Found {
    /// Upper bound on ln det.
    pub(super) log_det: f64,
    /// Distance of the bound to ln det at the measure.
    pub(super) slack: f64,
}

/// A window with its scaled regressors.
struct Support {
    at: Vec<usize>,
    row: Vec<f64>,
    weight: f64,
}

/// A measure and the matrix `G = gain E[phi phi'] + prior` of it, in scaled regressors.
struct Measure<'a> {
    windows: &'a Windows,
    p: usize,
    gain: f64,
    scale: Vec<f64>,
    prior: Vec<f64>,
    support: Vec<Support>,
    inverse: Vec<f64>,
    log_det: f64,
}

/// Upper bound on `ln det(gain E[phi phi'] + prior)` over all measures on `windows`; `prior` is p x p.
pub(super) fn largest_log_det(windows: &Windows, p: usize, gain: f64, prior: &[f64]) -> Found {
    let scale = windows.scale();
    let prior: Vec<f64> = (0..p * p).map(|i| prior[i] / (scale[i / p] * scale[i % p])).collect();
    let mut m = Measure {
        windows,
        p,
        gain,
        scale,
        prior,
        support: Vec::new(),
        inverse: vec![0.0; p * p],
        log_det: 0.0,
    };
    let mut rng = Rng64::new(1);
    let random: Vec<Vec<usize>> = (0..6 * p).map(|_| windows.random(&mut rng)).collect();
    m.add(random);
    let mut best = Found { log_det: f64::INFINITY, slack: f64::INFINITY };
    for _ in 0..PASSES {
        for _ in 0..ROUNDS {
            let mean = m.settle();
            let starts: Vec<Vec<usize>> = m.support.iter().map(|s| s.at.clone()).collect();
            let random = (0..p).map(|_| windows.random(&mut rng)).collect::<Vec<_>>();
            let found: Vec<(f64, Vec<usize>)> = starts
                .into_iter()
                .chain(random)
                .collect::<Vec<_>>()
                .into_par_iter()
                .map(|at| m.climb(at))
                .collect();
            if m.add(above(found, mean)) == 0 {
                break;
            }
        }
        let mean = m.settle();
        let found = m.pass();
        let most = found.iter().map(|(d, _)| *d).fold(0.0, f64::max);
        // tr(G^-1 prior) = p - mean.
        let slack = p as f64 * ((p as f64 - mean + most) / p as f64).ln();
        let bound = m.log_det + slack + 2.0 * m.scale.iter().map(|s| s.ln()).sum::<f64>();
        if bound < best.log_det {
            best = Found { log_det: bound, slack };
        }
        if slack <= SLACK || m.add(above(found, mean)) == 0 {
            break;
        }
    }
    best
}

/// Windows whose variance is above the mean by more than the bound could notice.
fn above(found: Vec<(f64, Vec<usize>)>, mean: f64) -> Vec<Vec<usize>> {
    found.into_iter().filter(|(d, _)| *d > mean * (1.0 + 1e-3)).map(|(_, at)| at).collect()
}

/// Least and largest `theta' phi` over all windows.
pub(super) fn range(windows: &Windows, theta: &[f64]) -> (f64, f64) {
    let p = theta.len();
    let scan = scan(windows, p, |rows, values| {
        values.extend(rows.chunks_exact(p).map(|r| kernel::dot(r, theta)));
    });
    scan.iter().fold((f64::INFINITY, f64::NEG_INFINITY), |(l, h), e| (l.min(e.low), h.max(e.high)))
}

/// Extremes of one part of the windows.
struct Extremes {
    low: f64,
    high: f64,
    /// Window of the high one.
    at: usize,
}

/// Extremes over all windows, part by part, of numbers that `values` appends for a block of rows.
fn scan(windows: &Windows, p: usize, values: impl Fn(&[f64], &mut Vec<f64>) + Sync) -> Vec<Extremes> {
    let n = windows.size() as usize;
    let length = n.div_ceil(PARTS).max(1);
    (0..n.div_ceil(length))
        .into_par_iter()
        .map(|part| {
            let (from, to) = (part * length, ((part + 1) * length).min(n));
            let (mut rows, mut block) = (vec![0.0; BLOCK * p], Vec::with_capacity(BLOCK));
            let mut at = vec![0; windows.samples.len()];
            windows.decode(from, &mut at);
            let mut e = Extremes { low: f64::INFINITY, high: f64::NEG_INFINITY, at: from };
            for first in (from..to).step_by(BLOCK) {
                let count = BLOCK.min(to - first);
                for row in rows.chunks_exact_mut(p).take(count) {
                    windows.row(&at, row);
                    windows.advance(&mut at);
                }
                block.clear();
                values(&rows[..count * p], &mut block);
                for (i, v) in block.iter().enumerate() {
                    e.low = e.low.min(*v);
                    if *v > e.high {
                        (e.high, e.at) = (*v, first + i);
                    }
                }
            }
            e
        })
        .collect()
}

impl Measure<'_> {
    fn row(&self, at: &[usize]) -> Vec<f64> {
        let mut row = vec![0.0; self.p];
        self.fill(at, &mut row);
        row
    }

    /// Scaled regressors of a window.
    fn fill(&self, at: &[usize], row: &mut [f64]) {
        self.windows.row(at, row);
        row.iter_mut().zip(&self.scale).for_each(|(v, s)| *v /= s);
    }

    /// `gain phi' G^-1 phi` of a scaled row.
    fn variance(&self, row: &[f64]) -> f64 {
        let p = self.p;
        self.gain * (0..p).map(|i| row[i] * kernel::dot(&self.inverse[i * p..(i + 1) * p], row)).sum::<f64>()
    }

    /// Adds windows that are not in the support yet, with a fifth of the weight; returns how many.
    fn add(&mut self, mut found: Vec<Vec<usize>>) -> usize {
        found.sort_unstable();
        found.dedup();
        found.retain(|at| self.support.iter().all(|s| s.at != *at));
        let share = if self.support.is_empty() { 1.0 } else { 0.2 };
        if !found.is_empty() {
            self.support.iter_mut().for_each(|s| s.weight *= 1.0 - share);
        }
        let weight = share / found.len().max(1) as f64;
        for at in &found {
            let row = self.row(at);
            self.support.push(Support { at: at.clone(), row, weight });
        }
        found.len()
    }

    /// Multiplicative updates of the weights until all variances of the support agree with their mean, which is returned.
    fn settle(&mut self) -> f64 {
        for _ in 0..UPDATES {
            self.factor();
            let d: Vec<f64> = self.support.iter().map(|s| self.variance(&s.row)).collect();
            let mean = self.support.iter().zip(&d).map(|(s, d)| s.weight * d).sum::<f64>();
            if d.iter().all(|d| *d <= mean * (1.0 + 3e-4)) {
                break;
            }
            self.support.iter_mut().zip(&d).for_each(|(s, d)| s.weight *= d / mean);
        }
        self.support.retain(|s| s.weight > LEAST_WEIGHT);
        let sum: f64 = self.support.iter().map(|s| s.weight).sum();
        self.support.iter_mut().for_each(|s| s.weight /= sum);
        self.factor();
        self.support.iter().map(|s| s.weight * self.variance(&s.row)).sum()
    }

    /// G, its inverse and ln det.
    fn factor(&mut self) {
        let p = self.p;
        let mut rows = Vec::with_capacity(self.support.len() * p);
        for s in &self.support {
            let root = (self.gain * s.weight).sqrt();
            rows.extend(s.row.iter().map(|v| root * v));
        }
        let mut g = self.prior.clone();
        kernel::gram_add(&rows, p, &mut g);
        let (mut l, mut inverse) = (vec![0.0; p * p], vec![0.0; p * p]);
        if kernel::cholesky(&g, p, &mut l) <= 0.0 {
            self.log_det = f64::INFINITY;
            return;
        }
        kernel::invert_lower(&l, p, &mut inverse);
        kernel::lower_gram(&inverse, p, &mut self.inverse);
        self.log_det = 2.0 * (0..p).map(|k| l[k * p + k].ln()).sum::<f64>();
    }

    /// Local search over the points of one sample at a time.
    fn climb(&self, mut at: Vec<usize>) -> (f64, Vec<usize>) {
        let mut row = self.row(&at);
        let mut best = self.variance(&row);
        loop {
            let before = best;
            for i in 0..at.len() {
                for k in 0..self.windows.samples[i].points.len() {
                    let old = std::mem::replace(&mut at[i], k);
                    self.fill(&at, &mut row);
                    let found = self.variance(&row);
                    if found > best {
                        best = found;
                    } else {
                        at[i] = old;
                    }
                }
            }
            if best <= before {
                return (best, at);
            }
        }
    }

    /// The best window of every part and its variance.
    fn pass(&self) -> Vec<(f64, Vec<usize>)> {
        let p = self.p;
        let mut raw = vec![0.0; p * p];
        for i in 0..p * p {
            raw[i] = self.gain * self.inverse[i] / (self.scale[i / p] * self.scale[i % p]);
        }
        let scan = scan(self.windows, p, |rows, values| {
            let mut product = vec![0.0; rows.len()];
            kernel::multiply(rows, &raw, p, &mut product);
            values.extend(rows.chunks_exact(p).zip(product.chunks_exact(p)).map(|(a, b)| kernel::dot(a, b)));
        });
        let window = |e: &Extremes| {
            let mut at = vec![0; self.windows.samples.len()];
            self.windows.decode(e.at, &mut at);
            (e.high, at)
        };
        scan.iter().map(window).collect()
    }
}
