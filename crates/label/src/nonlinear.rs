//! Labels of a function that is not linear in them: Levenberg-Marquardt with limits.
//!
//! ```text
//! step:  min |J p + r|^2 + mu |D p|^2 + lambda |rough(theta + p)|^2    subject to    the limits of the labels at theta + p
//! ```
//!
//! J is exact ([`Graph::forward`]), every step a quadratic program ([`crate::qp`]), so that bounds, monotone and convex labels are kept
//! at every step. What the data say of each cell comes from the linear fit at the end.

use dynocal_numerics::linalg;
use serde::{Deserialize, Serialize};

use crate::error::LabelError;
use crate::graph::{Graph, Record};
use crate::label::Limit;
use crate::linear::{self, Fit, Problem};
use crate::qp;
use crate::rows::Rows;

/// What the function is compared with on one record.
#[derive(Clone, Debug, PartialEq)]
pub struct Target<'a> {
    /// The record.
    pub record: Record<'a>,
    /// What the function shall give at each sample.
    pub y: &'a [f64],
    /// Weight of each sample; 0 masks it.
    pub weights: &'a [f64],
}

/// Most cells of a function that is fitted this way: J is held.
pub const MOST_CELLS: usize = 500;
/// Most steps.
const MOST_STEPS: usize = 100;

/// How it went.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Found {
    /// What the data say, and the values.
    pub fit: Fit,
    /// Steps.
    pub steps: usize,
    /// Whether it has converged.
    pub converged: bool,
}

struct Linear {
    /// Samples that count, of each target.
    used: Vec<Vec<usize>>,
    r: Vec<f64>,
    w: Vec<f64>,
    /// Column by column.
    j: Vec<Vec<f64>>,
}

fn residuals(graph: &Graph, theta: &[f64], targets: &[Target]) -> Option<f64> {
    let mut sum = 0.0;
    for t in targets {
        let y = graph.values(theta, &t.record);
        let of = |k: usize| if t.weights[k] > 0.0 { t.weights[k] * (t.y[k] - y[k]).powi(2) } else { 0.0 };
        sum += (0..y.len()).map(of).sum::<f64>();
    }
    sum.is_finite().then_some(sum)
}

/// The first sample that counts and at which measurement or function are no numbers.
fn not_finite(graph: &Graph, theta: &[f64], targets: &[Target]) -> LabelError {
    let first = targets.iter().find_map(|t| {
        let y = graph.values(theta, &t.record);
        (0..y.len()).find(|k| t.weights[*k] > 0.0 && !(t.y[*k] - y[*k]).is_finite())
    });
    LabelError::NotFinite {
        what: "the function with the base values, less the target",
        index: first.unwrap_or(0),
    }
}

fn linearise(graph: &Graph, theta: &[f64], targets: &[Target]) -> Linear {
    let mut out = Linear { used: Vec::new(), r: Vec::new(), w: Vec::new(), j: vec![Vec::new(); theta.len()] };
    for t in targets {
        let used: Vec<usize> = (0..t.y.len()).filter(|k| t.weights[*k] > 0.0).collect();
        let mut unit = vec![0.0; theta.len()];
        for c in 0..theta.len() {
            unit[c] = 1.0;
            let (y, d) = graph.forward(theta, &t.record, &unit);
            unit[c] = 0.0;
            out.j[c].extend(used.iter().map(|k| d[*k]));
            if c == 0 {
                out.r.extend(used.iter().map(|k| t.y[*k] - y[*k]));
                out.w.extend(used.iter().map(|k| t.weights[*k]));
            }
        }
        out.used.push(used);
    }
    out
}

/// Fits the labels of `graph`, from their base values on.
///
/// # Errors
/// [`LabelError`]: the graph, labels, or no sample that counts; numbers of the function that are not finite at the start.
pub fn fit(
    graph: &Graph,
    targets: &[Target],
    options: &linear::Options,
    interrupt: &dyn Fn() -> bool,
) -> Result<Found, LabelError> {
    let channels = targets.first().map_or(0, |t| t.record.channels.len());
    graph.check(channels)?;
    let mut theta = graph.base();
    if theta.len() > MOST_CELLS {
        return Err(LabelError::TooLarge { found: theta.len(), most: MOST_CELLS });
    }
    let limits = all_limits(graph);
    let mut cost = residuals(graph, &theta, targets).ok_or_else(|| not_finite(graph, &theta, targets))?;
    let (mut mu, mut steps, mut converged) = (1e-3, 0, false);
    let mut at = linearise(graph, &theta, targets);
    if at.r.is_empty() {
        return Err(LabelError::TooFew { found: 0, expected: theta.len() });
    }
    while steps < MOST_STEPS && !converged && !interrupt() {
        steps += 1;
        let (h, g) = normal(&at, graph);
        let mut tried = 0;
        loop {
            let p = step(&h, &g, mu, &theta, &limits)?;
            let next: Vec<f64> = theta.iter().zip(&p).map(|(a, b)| a + b).collect();
            let size = |v: &[f64]| linalg::norm2(v);
            let small = size(&p) <= 1e-10 * (1e-10 + size(&theta));
            match residuals(graph, &next, targets) {
                Some(c) if c < cost => {
                    converged = cost - c <= 1e-14 * cost || small;
                    (theta, cost) = (next, c);
                    mu = (mu * 0.1).max(1e-12);
                    at = linearise(graph, &theta, targets);
                    break;
                }
                _ => mu *= 10.0,
            }
            tried += 1;
            // No direction is better to rounding.
            if small || mu > 1e12 || tried > 30 {
                converged = true;
                break;
            }
        }
    }
    let fit = told(graph, &theta, &at, options)?;
    Ok(Found { fit, steps, converged })
}

/// `J'WJ` (upper triangle) and `J'Wr`.
fn normal(at: &Linear, graph: &Graph) -> (Vec<f64>, Vec<f64>) {
    let n = at.j.len();
    let locked: Vec<bool> = graph.labels.iter().flat_map(|l| l.locked.iter().copied()).collect();
    let (mut h, mut g) = (vec![0.0; n * n], vec![0.0; n]);
    for a in (0..n).filter(|a| !locked[*a]) {
        let weighted: Vec<f64> = at.j[a].iter().zip(&at.w).map(|(j, w)| j * w).collect();
        g[a] = linalg::dot(&weighted, &at.r);
        for b in (a..n).filter(|b| !locked[*b]) {
            h[a * n + b] = linalg::dot(&weighted, &at.j[b]);
        }
    }
    (h, g)
}

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

fn all_limits(graph: &Graph) -> Vec<Limit> {
    let (first, _) = linear::offsets(&graph.labels);
    let mut out = Vec::new();
    for (l, from) in graph.labels.iter().zip(first) {
        for limit in l.limits() {
            let terms = limit.terms.iter().map(|(k, c)| (from + k, *c)).collect();
            out.push(Limit { terms, ..limit });
        }
        for k in (0..l.len()).filter(|k| !l.locked[*k]) {
            let what = format!("`{}`: values of {} to {} {}", l.name, l.lower, l.upper, l.unit);
            if l.lower.is_finite() {
                out.push(Limit { terms: vec![(from + k, 1.0)], least: l.lower, what: what.clone() });
            }
            if l.upper.is_finite() {
                out.push(Limit { terms: vec![(from + k, -1.0)], least: -l.upper, what });
            }
        }
    }
    out
}

/// The linear fit at `theta`: the same values, with intervals, verdicts, smoothness and whole steps.
fn told(graph: &Graph, theta: &[f64], at: &Linear, options: &linear::Options) -> Result<Fit, LabelError> {
    let (mut rows, mut target) = (Rows::default(), Vec::with_capacity(at.r.len()));
    for k in 0..at.r.len() {
        rows.start();
        let mut y = at.r[k];
        for (c, column) in at.j.iter().enumerate() {
            rows.push(c, column[k]);
            y += column[k] * theta[c];
        }
        target.push(y);
    }
    // Samples that follow each other without a gap.
    let (mut segments, mut from) = (Vec::new(), 0);
    for used in &at.used {
        let mut start = from;
        for k in 1..used.len() {
            if used[k] != used[k - 1] + 1 {
                segments.push(start..from + k);
                start = from + k;
            }
        }
        from += used.len();
        segments.push(start..from);
    }
    let problem =
        Problem { labels: &graph.labels, rows: &rows, target: &target, weights: Some(&at.w), segments };
    let smooth = Some(options.smooth.unwrap_or(0.0));
    linear::fit(&problem, &linear::Options { smooth, ..options.clone() })
}
