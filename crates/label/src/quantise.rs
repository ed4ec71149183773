//! Whole steps by a joint search.
//!
//! ```text
//! minimise (x - x*)'H(x - x*)   over   x_i = origin_i + step_i k_i, k_i whole,   C x >= d
//! ```
//!
//! Rounding each cell alone is neither best nor does it keep limits on differences. With `H = U'U` the sum is a tree: the last cell is
//! chosen first, each choice adds a square, and a branch ends where the sum passes the best that is known (C. P. Schnorr, M. Euchner,
//! Lattice basis reduction, Mathematical Programming 66 (1994), 181-199). The best that is known comes from rounding and exchanges.

use dynocal_numerics::linalg;

use crate::error::LabelError;
use crate::label::Limit;

/// Nodes of the tree after which the best so far is taken as it is.
const MOST_NODES: usize = 200_000;

/// Values that a cell can hold.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Steps {
    /// Distance between two.
    pub step: f64,
    /// One of them.
    pub origin: f64,
}

/// The best whole steps, and whether that is proven. `h` is the upper triangle (n x n), `free` its minimum without limits, `limited`
/// with them; a cell without steps stays where `limited` has it.
///
/// # Errors
/// [`LabelError::Contradiction`] where no whole steps within the budget keep the limits, [`LabelError::Singular`].
pub fn nearest(
    h: &[f64],
    free: &[f64],
    limited: &[f64],
    steps: &[Option<Steps>],
    limits: &[Limit],
) -> Result<(Vec<f64>, bool), LabelError> {
    let n = free.len();
    let mut u = h.to_vec();
    linalg::cholesky(&mut u, n).map_err(|e| LabelError::Singular(e.to_string()))?;
    let rounded = |x: &[f64]| -> Vec<f64> {
        (0..n)
            .map(|i| {
                steps[i].map_or(limited[i], |s| s.origin + s.step * ((x[i] - s.origin) / s.step).round())
            })
            .collect()
    };
    let mut tree = Tree { n, u: &u, free, limited, steps, closing: closing(n, limits), nodes: 0, best: None };
    // Rounding keeps the order of values, so that what is monotone stays monotone.
    for start in [rounded(limited), rounded(free)] {
        if let Some(x) = improved(h, n, free, start, steps, limits) {
            let cost = tree.cost(&x);
            if tree.best.as_ref().is_none_or(|(b, _)| cost < *b) {
                tree.best = Some((cost, x));
            }
        }
    }
    let mut x = limited.to_vec();
    tree.descend(n, 0.0, &mut x);
    let proven = tree.nodes < MOST_NODES;
    match tree.best {
        Some((_, x)) => Ok((x, proven)),
        None => Err(LabelError::Contradiction {
            limit: limits.first().map_or("whole steps".into(), |l| format!("{} in whole steps", l.what)),
        }),
    }
}

fn kept(limit: &Limit, x: &[f64]) -> bool {
    let sum: f64 = limit.terms.iter().map(|(k, c)| c * x[*k]).sum();
    let size = limit.terms.iter().map(|(k, c)| (c * x[*k]).abs()).fold(limit.least.abs(), f64::max);
    sum >= limit.least - 1e-9 * size.max(1e-9)
}

/// Limits by the last of their cells that is chosen, which is the first by number.
fn closing(n: usize, limits: &[Limit]) -> Vec<Vec<&Limit>> {
    let mut out = vec![Vec::new(); n];
    for l in limits {
        if let Some(first) = l.terms.iter().map(|(k, _)| *k).min() {
            out[first].push(l);
        }
    }
    out
}

struct Tree<'a> {
    n: usize,
    u: &'a [f64],
    free: &'a [f64],
    limited: &'a [f64],
    steps: &'a [Option<Steps>],
    closing: Vec<Vec<&'a Limit>>,
    nodes: usize,
    best: Option<(f64, Vec<f64>)>,
}

impl Tree<'_> {
    fn cost(&self, x: &[f64]) -> f64 {
        (0..self.n)
            .map(|i| (i..self.n).map(|j| self.u[i * self.n + j] * (x[j] - self.free[j])).sum::<f64>().powi(2))
            .sum()
    }

    /// Chooses cell `level - 1`, those above it chosen.
    fn descend(&mut self, level: usize, sum: f64, x: &mut Vec<f64>) {
        if level == 0 {
            if self.best.as_ref().is_none_or(|(b, _)| sum < *b) {
                self.best = Some((sum, x.clone()));
            }
            return;
        }
        let (i, n) = (level - 1, self.n);
        let pull: f64 = (level..n).map(|j| self.u[i * n + j] * (x[j] - self.free[j])).sum();
        let d = self.u[i * n + i];
        let centre = self.free[i] - pull / d;
        let Some(s) = self.steps[i] else {
            x[i] = self.limited[i];
            self.nodes += 1;
            if self.nodes < MOST_NODES {
                self.descend(level - 1, sum + (d * (x[i] - centre)).powi(2), x);
            }
            return;
        };
        let place = (centre - s.origin) / s.step;
        let nearest = place.round();
        let away = if place >= nearest { 1.0 } else { -1.0 };
        // Outwards from the centre: 0, 1, -1, 2, -2, ..
        for k in 0u32.. {
            let half = f64::from(k.div_ceil(2));
            let offset = if k % 2 == 1 { away * half } else { -away * half };
            x[i] = s.origin + s.step * (nearest + offset);
            let next = sum + (d * (x[i] - centre)).powi(2);
            self.nodes += 1;
            // A limit may push a cell far away, but never beyond what the best costs.
            let bound = self.best.as_ref().map_or(f64::INFINITY, |b| b.0 * (1.0 - 1e-12));
            if self.nodes >= MOST_NODES || next >= bound || k > 2000 {
                return;
            }
            if self.closing[i].iter().all(|l| kept(l, x)) {
                self.descend(level - 1, next, x);
            }
        }
    }
}

/// Exchanges of one cell or of two neighbours by one step until none helps; none where the limits cannot be kept that way.
fn improved(
    h: &[f64],
    n: usize,
    free: &[f64],
    mut x: Vec<f64>,
    steps: &[Option<Steps>],
    limits: &[Limit],
) -> Option<Vec<f64>> {
    let mut touching: Vec<Vec<&Limit>> = vec![Vec::new(); n];
    limits.iter().for_each(|l| l.terms.iter().for_each(|(k, _)| touching[*k].push(l)));
    if !limits.iter().all(|l| kept(l, &x)) {
        return None;
    }
    let at = |i: usize, j: usize| if j >= i { h[i * n + j] } else { h[j * n + i] };
    let mut gradient: Vec<f64> = (0..n).map(|i| (0..n).map(|j| at(i, j) * (x[j] - free[j])).sum()).collect();
    for _ in 0..100 {
        let mut moved = false;
        for i in 0..n {
            let Some(a) = steps[i] else { continue };
            // Cells that are coupled with this one, and the cell alone.
            let near = (i + 1..n).filter(|j| at(i, *j) != 0.0 && steps[*j].is_some()).take(8);
            let partners: Vec<Option<usize>> = std::iter::once(None).chain(near.map(Some)).collect();
            for partner in partners {
                for (sa, sb) in [(1.0, 1.0), (1.0, -1.0), (-1.0, 1.0), (-1.0, -1.0)] {
                    let da = sa * a.step;
                    let db = partner.map_or(0.0, |j| sb * steps[j].map_or(0.0, |s| s.step));
                    let j = partner.unwrap_or(i);
                    let cross =
                        if partner.is_some() { 2.0 * at(i, j) * da * db + at(j, j) * db * db } else { 0.0 };
                    let change = 2.0 * gradient[i] * da
                        + at(i, i) * da * da
                        + if partner.is_some() { 2.0 * gradient[j] * db } else { 0.0 }
                        + cross;
                    if !(change < -1e-12 * at(i, i) * a.step * a.step) {
                        continue;
                    }
                    x[i] += da;
                    if partner.is_some() {
                        x[j] += db;
                    }
                    if touching[i].iter().chain(&touching[j]).all(|l| kept(l, &x)) {
                        moved = true;
                        for k in 0..n {
                            gradient[k] +=
                                at(k, i) * da + if partner.is_some() { at(k, j) * db } else { 0.0 };
                        }
                    } else {
                        x[i] -= da;
                        if partner.is_some() {
                            x[j] -= db;
                        }
                    }
                }
            }
        }
        if !moved {
            break;
        }
    }
    Some(x)
}
