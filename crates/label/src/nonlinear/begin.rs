//! The first stage: Levenberg-Marquardt from the start, with a fixed smoothness.

use super::{
    FIRST_SMOOTH, Linear, MOST_STEPS, Target, all_limits, linearise, not_finite, residuals, size, squares,
};
use crate::error::LabelError;
use crate::graph::Graph;
use crate::label::Limit;
use crate::linear::{Options, offsets};
use crate::qp;

/// Cells with factors, what the base gives, weight.
type RoughRow = (Vec<(usize, f64)>, f64, f64);

/// Rows of the roughness with their weights: `sum_i w_i (d_i' theta - told_i)^2`.
struct Rough {
    rows: Vec<RoughRow>,
}

impl Rough {
    /// The roughness of the labels of `graph`, each in the size that the data have on its label at `at`.
    fn new(graph: &Graph, at: &Linear, smooth: f64, change: bool) -> Self {
        let (first, _) = offsets(&graph.labels);
        let (mut rows, diagonal) = (Vec::new(), at.j.squares(&at.w, graph.base().len()));
        for (l, from) in graph.labels.iter().zip(first) {
            let own: Vec<Vec<(usize, f64)>> = l.roughness();
            let square: f64 = own.iter().flatten().map(|(_, d)| d * d).sum();
            let data: f64 = diagonal[from..from + l.len()].iter().sum();
            if !(smooth > 0.0 && square > 0.0 && data > 0.0) {
                continue;
            }
            for row in own {
                let told = if change { row.iter().map(|(k, d)| d * l.base[*k]).sum() } else { 0.0 };
                let terms = row.iter().map(|(k, d)| (from + k, *d)).collect();
                rows.push((terms, told, smooth * data / square));
            }
        }
        Self { rows }
    }

    fn cost(&self, theta: &[f64]) -> f64 {
        self.rows
            .iter()
            .map(|(row, told, w)| {
                let d = row.iter().map(|(k, c)| c * theta[*k]).sum::<f64>() - told;
                w * d * d
            })
            .sum()
    }

    /// Adds what the roughness has of `h` (upper triangle) and `g = -gradient / 2`.
    fn add(&self, theta: &[f64], h: &mut [f64], g: &mut [f64]) {
        let n = g.len();
        for (row, told, w) in &self.rows {
            let d = row.iter().map(|(k, c)| c * theta[*k]).sum::<f64>() - told;
            for &(i, a) in row {
                g[i] -= w * a * d;
                row.iter().filter(|(j, _)| *j >= i).for_each(|(j, b)| h[i * n + j] += w * a * b);
            }
        }
    }
}

/// Moves `theta` to a minimum; the number of steps, and whether it has converged.
pub(super) fn search(
    graph: &Graph,
    theta: &mut Vec<f64>,
    targets: &[Target],
    options: &Options,
    interrupt: &dyn Fn() -> bool,
) -> Result<(usize, bool), LabelError> {
    let limits = all_limits(graph);
    let first = residuals(graph, theta, targets).ok_or_else(|| not_finite(graph, theta, targets))?;
    if first.is_empty() {
        return Err(LabelError::TooFew { found: 0, expected: theta.len() });
    }
    let mut at = linearise(graph, theta, targets);
    let rough = Rough::new(graph, &at, options.smooth.unwrap_or(FIRST_SMOOTH), options.smooth_change);
    let mut cost = squares(&first) + rough.cost(theta);
    let (mut mu, mut steps) = (1e-3, 0);
    while steps < MOST_STEPS && !interrupt() {
        steps += 1;
        let (mut h, mut g) = normal(&at, graph);
        rough.add(theta, &mut h, &mut g);
        let mut tried = 0;
        loop {
            let p = step(&h, &g, mu, theta, &limits)?;
            let next: Vec<f64> = theta.iter().zip(&p).map(|(a, b)| a + b).collect();
            let small = size(&p) <= 1e-10 * (1e-10 + size(theta));
            let new = residuals(graph, &next, targets).map(|r| squares(&r) + rough.cost(&next));
            if let Some(c) = new.filter(|c| *c < cost) {
                let done = cost - c <= 1e-14 * cost || small;
                (*theta, cost) = (next, c);
                if done {
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

/// `J'WJ` (upper triangle) and `J'Wr`.
fn normal(at: &Linear, graph: &Graph) -> (Vec<f64>, Vec<f64>) {
    let locked: Vec<bool> = graph.labels.iter().flat_map(|l| l.locked.iter().copied()).collect();
    at.j.normal(&at.w, &at.r, &locked)
}

/// The step of least damped cost within the limits; a cell that is locked, or that nothing depends on, stays.
fn step(h: &[f64], g: &[f64], mu: f64, theta: &[f64], limits: &[Limit]) -> Result<Vec<f64>, LabelError> {
    let n = g.len();
    let mut damped = h.to_vec();
    // Cells without any say stay: their own scale is that of the others.
    let mean = (0..n).map(|k| h[k * n + k]).sum::<f64>() / n as f64;
    for k in 0..n {
        let own = damped[k * n + k];
        damped[k * n + k] += mu * own + if own > 1e-14 * mean { 0.0 } else { mean.max(1e-300) };
    }
    let moved: Vec<Limit> = limits
        .iter()
        .map(|l| {
            let now: f64 = l.terms.iter().map(|(k, c)| c * theta[*k]).sum();
            Limit { least: l.least - now, ..l.clone() }
        })
        .collect();
    Ok(qp::solve(&damped, g, &moved)?.x)
}
