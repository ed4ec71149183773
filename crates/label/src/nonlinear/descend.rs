//! Levenberg-Marquardt to a minimum of a criterion that stays, within the limits.
//!
//! ```text
//! sum_t w_t rho(r_t) + sum_i s_i (d_i' theta - told_i)^2 + sum_k v_k (theta_k - base_k)^2
//! ```
//!
//! rho is the square, or Huber's loss with a knee that is given. A step is taken only where it lowers the criterion, so that corners of the
//! function (breakpoints that samples cross, switches, clips) cannot send the labels to and fro.

use super::large::timing::Timing;
use super::{Linear, MOST_STEPS, Target, all_limits, linearise, not_finite, residuals, size};
use crate::error::LabelError;
use crate::graph::Graph;
use crate::label::Limit;
use crate::linear::{huber, offsets};
use crate::qp;

/// Steps in a row that together lower the criterion by less than [`LITTLE`] of the variance of a sample, after which it rests: the labels
/// move by a few hundredths of a standard error then.
const RESTS: usize = 5;
const LITTLE: f64 = 1e-3;
/// Whole steps in a row that change the function by less than this share of what is left, root mean square, after which what is measured
/// stands, and the labels move along what nothing but the roughness tells of.
const STILL: usize = 3;
const SEEN: f64 = 1e-3;
/// Damping up to which a step is whole.
const WHOLE: f64 = 1e-3;

/// Cells with factors, what the base gives, weight.
type RoughRow = (Vec<(usize, f64)>, f64, f64);

/// What is lowered.
pub(super) struct Criterion {
    /// Rows of the roughness.
    rough: Vec<RoughRow>,
    /// Weight of the base of each cell, and the base.
    base: Vec<(f64, f64)>,
    /// Cells that stay.
    held: Vec<bool>,
    limits: Vec<Limit>,
    /// Residual beyond which the loss grows as a straight line.
    knee: Option<f64>,
}

impl Criterion {
    /// With the roughness of each label in the size that the data have on it at `at`, as [`crate::linear`] has it; cells that are `held`
    /// stay where they are.
    pub(super) fn new(graph: &Graph, at: &Linear, held: Vec<bool>, smooth: f64, change: bool) -> Self {
        let (first, cells) = offsets(&graph.labels);
        let (mut rough, diagonal) = (Vec::new(), at.j.squares(&at.w, cells));
        let locked: Vec<bool> = graph.labels.iter().flat_map(|l| l.locked.iter().copied()).collect();
        for (l, from) in graph.labels.iter().zip(first) {
            // Of the value of a cell that keeps its base nothing is known.
            let unknown = |k: &usize| held[from + k] && !locked[from + k];
            let mut own = l.roughness();
            own.retain(|row| {
                row.iter().any(|(k, _)| !held[from + k]) && (change || !row.iter().any(|(k, _)| unknown(k)))
            });
            let free = |k: &usize| !held[from + k];
            let square: f64 = own.iter().flatten().filter(|(k, _)| free(k)).map(|(_, d)| d * d).sum();
            let data: f64 = (0..l.len()).filter(free).map(|k| diagonal[from + k]).sum();
            if !(smooth > 0.0 && square > 0.0 && data > 0.0) {
                continue;
            }
            for row in own {
                let told = if change { row.iter().map(|(k, d)| d * l.base[*k]).sum() } else { 0.0 };
                let terms = row.iter().map(|(k, d)| (from + k, *d)).collect();
                rough.push((terms, told, smooth * data / square));
            }
        }
        let base = graph.labels.iter().flat_map(|l| l.base.iter().map(|b| (l.base_weight, *b))).collect();
        let mut limits = all_limits(graph);
        limits.retain(|l| l.terms.iter().any(|(k, _)| !held[*k]));
        Self { rough, base, held, limits, knee: None }
    }

    /// The same with Huber's loss beyond `knee`.
    pub(super) fn robust(self, knee: f64) -> Self {
        Self { knee: (knee > 0.0).then_some(knee), ..self }
    }

    /// What the samples have of the cost.
    fn data(&self, r: &[(f64, f64)]) -> f64 {
        r.iter().map(|(r, w)| huber::loss(*r, *w, self.knee)).sum()
    }

    fn cost(&self, r: &[(f64, f64)], theta: &[f64]) -> f64 {
        let row = |(row, told, w): &RoughRow| {
            let d = row.iter().map(|(k, c)| c * theta[*k]).sum::<f64>() - told;
            w * d * d
        };
        self.data(r)
            + self.rough.iter().map(row).sum::<f64>()
            + self.base.iter().zip(theta).map(|((v, b), t)| v * (t - b) * (t - b)).sum::<f64>()
    }

    /// Upper triangle of half the Hessian without second derivatives of the function, and half of what the cost falls along each cell.
    fn normal(&self, at: &Linear, theta: &[f64]) -> (Vec<f64>, Vec<f64>) {
        let n = theta.len();
        let w: Vec<f64> = at.w.iter().zip(&at.r).map(|(w, r)| w * huber::share(*r, *w, self.knee)).collect();
        let (mut h, mut g) = at.j.normal(&w, &at.r, &self.held);
        for (row, told, w) in &self.rough {
            let d = row.iter().map(|(k, c)| c * theta[*k]).sum::<f64>() - told;
            for &(i, a) in row.iter().filter(|(i, _)| !self.held[*i]) {
                g[i] -= w * a * d;
                let right = row.iter().filter(|(j, _)| *j >= i && !self.held[*j]);
                right.for_each(|(j, b)| h[i * n + j] += w * a * b);
            }
        }
        for (k, (v, b)) in self.base.iter().enumerate().filter(|(k, _)| !self.held[*k]) {
            h[k * n + k] += v;
            g[k] += v * (b - theta[k]);
        }
        (h, g)
    }

    /// Limits of a step from `theta`.
    fn moved(&self, theta: &[f64]) -> Vec<Limit> {
        let one = |l: &Limit| {
            let now: f64 = l.terms.iter().map(|(k, c)| c * theta[*k]).sum();
            // What stays cannot make room.
            let terms = l.terms.iter().filter(|(k, _)| !self.held[*k]).copied().collect();
            Limit { terms, least: l.least - now, what: l.what.clone() }
        };
        self.limits.iter().map(one).collect()
    }

    /// The nearest place within the limits, in the size that the data have.
    fn within(&self, h: &[f64], theta: &[f64]) -> Result<Option<Vec<f64>>, LabelError> {
        let moved = self.moved(theta);
        if moved.iter().all(|l| l.least <= 0.0) {
            return Ok(None);
        }
        let n = theta.len();
        let damped = damped(h, n, 1.0);
        let diagonal: Vec<f64> = (0..n * n).map(|k| if k % (n + 1) == 0 { damped[k] } else { 0.0 }).collect();
        let p = qp::solve(&diagonal, &vec![0.0; n], &moved)?.x;
        Ok(Some(theta.iter().zip(&p).map(|(a, b)| a + b).collect()))
    }
}

/// How far a search goes, and what steps of time constants may do.
pub(super) struct Reach<'a> {
    pub(super) steps: usize,
    pub(super) timing: &'a Timing,
    pub(super) interrupt: &'a dyn Fn() -> bool,
}

impl<'a> Reach<'a> {
    pub(super) fn new(timing: &'a Timing, interrupt: &'a dyn Fn() -> bool) -> Self {
        Self { steps: MOST_STEPS, timing, interrupt }
    }
}

/// Moves `theta` to a minimum; the number of steps, and whether it is one.
pub(super) fn search(
    graph: &Graph,
    theta: &mut Vec<f64>,
    targets: &[Target],
    criterion: &Criterion,
    reach: &Reach,
) -> Result<(usize, bool), LabelError> {
    let mut at = linearise(graph, theta, targets);
    if let Some(inside) = criterion.within(&criterion.normal(&at, theta).0, theta)? {
        *theta = inside;
        at = linearise(graph, theta, targets);
    }
    let first = residuals(graph, theta, targets).ok_or_else(|| not_finite(graph, theta, targets))?;
    let mut cost = criterion.cost(&first, theta);
    let (mut costs, mut here, mut still) = (vec![cost], first, 0);
    let (mut mu, mut steps) = (WHOLE, 0);
    while steps < reach.steps && !(reach.interrupt)() {
        steps += 1;
        let (h, g) = criterion.normal(&at, theta);
        let mut tried = 0;
        loop {
            let mut p = qp::solve(&damped(&h, g.len(), mu), &g, &criterion.moved(theta))?.x;
            // Far away a film or a lag may be none, and then nothing leads back.
            let share = reach.timing.share(theta, &p);
            p.iter_mut().for_each(|p| *p *= share);
            let next: Vec<f64> = theta.iter().zip(&p).map(|(a, b)| a + b).collect();
            let small = share == 1.0 && size(&p) <= 1e-10 * (1e-10 + size(theta));
            let new = residuals(graph, &next, targets).map(|r| (criterion.cost(&r, &next), r));
            if let Some((c, there)) = new.filter(|(c, _)| *c < cost) {
                let done = (share == 1.0 && cost - c <= 1e-14 * cost) || small;
                let whole = share == 1.0 && mu <= WHOLE && !criterion.rough.is_empty();
                still = if whole && apart(&here, &there) <= SEEN * SEEN * criterion.data(&there) {
                    still + 1
                } else {
                    0
                };
                (*theta, cost, here) = (next, c, there);
                costs.push(c);
                if done || rests(&costs, at.r.len()) || still >= STILL {
                    return Ok((steps, true));
                }
                mu = (mu * 0.1).max(1e-12);
                at = linearise(graph, theta, targets);
                break;
            }
            mu *= 10.0;
            tried += 1;
            // No direction is better to rounding.
            if small || mu > 1e12 || tried > 30 {
                return Ok((steps, true));
            }
        }
    }
    Ok((steps, false))
}

/// Weighted square of the difference of two runs.
fn apart(a: &[(f64, f64)], b: &[(f64, f64)]) -> f64 {
    a.iter().zip(b).map(|((a, w), (b, _))| w * (a - b) * (a - b)).sum()
}

fn rests(costs: &[f64], samples: usize) -> bool {
    let n = costs.len();
    n > RESTS && costs[n - 1 - RESTS] - costs[n - 1] <= LITTLE * costs[n - 1] / samples as f64
}

/// The equations with `mu` of their diagonal more; a cell that is held, or that nothing depends on, stays.
fn damped(h: &[f64], n: usize, mu: f64) -> Vec<f64> {
    let mut damped = h.to_vec();
    // Cells without any say stay: their own scale is that of the others.
    let mean = (0..n).map(|k| h[k * n + k]).sum::<f64>() / n as f64;
    for k in 0..n {
        let own = damped[k * n + k];
        damped[k * n + k] += mu * own + if own > 1e-14 * mean { 0.0 } else { mean.max(1e-300) };
    }
    damped
}
