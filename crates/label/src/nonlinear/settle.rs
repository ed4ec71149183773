//! The second stage: linear fits around the last values until they reproduce themselves.

use super::{Found, Linear, Target, linearise, residuals, size, squares};
use crate::error::LabelError;
use crate::graph::Graph;
use crate::linear::{self, Fit, Open, Options, Problem};
use crate::rows::Rows;

/// Most rounds.
const MOST_ROUNDS: usize = 40;
/// Rounds after which the weight of the smoothness stays: a search that changes its own target does not end.
const CHOOSES: usize = 4;
/// Change of the labels, as a share of their size, below which they stand.
const STANDS: f64 = 1e-6;
/// Share of what is left, root mean square, by which a change of the labels that counts changes the function.
const SEEN: f64 = 1e-3;
/// Rounds in a row in which nothing that counts changes, after which it is only what is open that moves.
const STILL: usize = 3;
/// Excess of the cost over what the linear fit says, at which a step is too long for a straight line.
const STRAIGHT: f64 = 0.1;

/// From the values of the first stage to those that the linear fit around them gives back.
pub(super) fn search(
    graph: &Graph,
    mut theta: Vec<f64>,
    targets: &[Target],
    options: &Options,
    (begun, minimum): (usize, bool),
    interrupt: &dyn Fn() -> bool,
) -> Result<Found, LabelError> {
    let smooths = graph.labels.iter().any(|l| !l.roughness().is_empty()) && options.smooth != Some(0.0);
    let mut options = options.clone();
    if !smooths {
        options.smooth = Some(0.0);
    }
    let mut fit = told(graph, &theta, &linearise(graph, &theta, targets), &options)?;
    if !smooths && !options.robust {
        // The linear fit at a minimum is that minimum.
        return Ok(Found { fit, steps: begun, converged: minimum });
    }
    let mut still = 0;
    for round in 1..=MOST_ROUNDS {
        if interrupt() {
            break;
        }
        if round > CHOOSES && options.smooth.is_none() {
            options.smooth = Some(fit.smooth);
        }
        let moved = towards(graph, &theta, &fit.exact, targets);
        let change: Vec<f64> = moved.iter().zip(&theta).map(|(a, b)| a - b).collect();
        let stands = size(&change) <= STANDS * (STANDS + size(&theta));
        theta = moved;
        let smooth = fit.smooth;
        let at = linearise(graph, &theta, targets);
        let left: f64 = at.r.iter().zip(&at.w).map(|(r, w)| w * r * r).sum();
        let seen = at.j.square_of(&change, &at.w) > SEEN * SEEN * left;
        still = if seen { 0 } else { still + 1 };
        fit = told(graph, &theta, &at, &options)?;
        if stands && (round > CHOOSES || fit.smooth == smooth) {
            return Ok(Found { fit, steps: begun + round, converged: true });
        }
        if round > CHOOSES && still >= STILL && !stands {
            // What is measured stands; the labels move along what nothing tells of.
            return Ok(Found { fit, steps: begun + round, converged: true });
        }
    }
    Ok(Found { fit, steps: begun + MOST_ROUNDS, converged: false })
}

/// What only smoothness holds, across labels.
fn across(graph: &Graph, at: &Linear) -> Open {
    let locked: Vec<bool> = graph.labels.iter().flat_map(|l| l.locked.iter().copied()).collect();
    let owner: Vec<usize> =
        graph.labels.iter().enumerate().flat_map(|(k, l)| std::iter::repeat_n(k, l.len())).collect();
    Open::across(&at.j.normal(&at.w, &at.r, &locked).0, &owner)
}

/// The point on the way to `goal` where the function is still nearly as straight as the fit takes it.
fn towards(graph: &Graph, theta: &[f64], goal: &[f64], targets: &[Target]) -> Vec<f64> {
    let here = residuals(graph, theta, targets).unwrap_or_default();
    let at = |s: f64| -> Vec<f64> { theta.iter().zip(goal).map(|(a, b)| a + s * (b - a)).collect() };
    let mut share = 1.0;
    while share > 1e-3 {
        let point = at(share);
        if let Some(r) = residuals(graph, &point, targets) {
            // Smoothness may cost residuals, and limits as well: what must not be is a rise that the straight line does not know.
            let half = residuals(graph, &at(0.5 * share), targets).unwrap_or_default();
            let bend = bend(&here, &half, &r);
            if bend <= STRAIGHT * squares(&here).max(squares(&r)) {
                return point;
            }
        }
        share *= 0.5;
    }
    at(share)
}

/// Weighted square of how far residuals half way lie from the mean of those at the ends.
fn bend(a: &[(f64, f64)], half: &[(f64, f64)], b: &[(f64, f64)]) -> f64 {
    if half.len() != a.len() {
        return f64::INFINITY;
    }
    (0..a.len()).map(|k| a[k].1 * (half[k].0 - 0.5 * (a[k].0 + b[k].0)).powi(2)).sum()
}

/// The linear fit at `theta`: values, intervals, verdicts, smoothness and whole steps.
fn told(graph: &Graph, theta: &[f64], at: &Linear, options: &Options) -> Result<Fit, LabelError> {
    let (mut rows, mut target) = (Rows::default(), Vec::with_capacity(at.r.len()));
    for k in 0..at.r.len() {
        rows.start();
        at.j.row(k, &mut |c, v| rows.push(c, v));
        target.push(at.r[k] + rows.times(k, theta));
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
    let problem = Problem {
        labels: &graph.labels,
        rows: &rows,
        target: &target,
        weights: Some(&at.w),
        segments,
        roles: Vec::new(),
        bounds: Vec::new(),
    };
    let mut fit = linear::fit(&problem, options)?;
    if fit.open.is_empty() && graph.labels.len() > 1 {
        fit.open = across(graph, at);
        fit.mark_open();
    }
    Ok(fit)
}
