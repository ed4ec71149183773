//! The second stage: how smooth the labels are and what lies far outside, from linear fits, and a minimum with that.

use super::descend::{self, Criterion, Reach};
use super::{Found, Linear, Target, linearise, residuals, size};
use crate::error::LabelError;
use crate::graph::Graph;
use crate::linear::{self, Fit, Open, Options, Problem};
use crate::rows::Rows;

/// Rounds after which the weight of the smoothness stays: a search that changes its own target does not end.
const CHOOSES: usize = 4;
/// Steps of a round that chooses.
const FEW: usize = 5;
/// Most rounds after them, each to a minimum: sizes of the roughness and the knee of the loss follow the labels.
const FOLLOWS: usize = 5;
/// Change of the labels, as a share of their size, below which they stand.
const STANDS: f64 = 1e-6;
/// The same as a share of the half widths of their 95 % intervals, root mean square: a twentieth of a standard error.
const WITHIN: f64 = 0.025;

/// From the values of the first stage to a minimum of the criterion with the smoothness that the data choose.
pub(super) fn search(
    graph: &Graph,
    mut theta: Vec<f64>,
    targets: &[Target],
    options: &Options,
    (begun, minimum): (usize, bool),
    reach: &Reach,
) -> Result<Found, LabelError> {
    let smooths = graph.labels.iter().any(|l| !l.roughness().is_empty()) && options.smooth != Some(0.0);
    let mut options = options.clone();
    if !smooths {
        options.smooth = Some(0.0);
    }
    let mut at = linearise(graph, &theta, targets);
    let mut fit = told(graph, &theta, &at, &options, false)?;
    if !smooths && !options.robust {
        // The linear fit at a minimum is that minimum, but for corners.
        let cost = |theta: &[f64]| {
            let r = residuals(graph, theta, targets)?;
            Some(r.iter().map(|(r, w)| w * r * r).sum::<f64>())
        };
        let (there, here) = (cost(&fit.exact).unwrap_or(f64::INFINITY), cost(&theta).unwrap_or(0.0));
        if minimum && there > here * (1.0 + 1e-3 / at.r.len() as f64) {
            fit = told(graph, &theta, &at, &options, true)?;
        }
        return Ok(Found { fit, steps: begun, converged: minimum });
    }
    let (mut steps, mut converged) = (begun, false);
    for round in 1..=CHOOSES + FOLLOWS {
        if (reach.interrupt)() {
            break;
        }
        let chooses = round <= CHOOSES;
        if !chooses {
            options.smooth = Some(fit.smooth);
        }
        let before = theta.clone();
        let criterion = criterion(graph, &mut theta, &at, &fit, &options);
        let most = if chooses { FEW } else { reach.steps };
        let (n, minimum) = descend::search(graph, &mut theta, targets, &criterion, &Reach { steps: most, ..*reach })?;
        steps += n;
        at = linearise(graph, &theta, targets);
        let smooth = fit.smooth;
        fit = told(graph, &theta, &at, &options, true)?;
        let stands = near(&before, &theta, &fit);
        // What follows the labels further than this moves them less than the last round did.
        if minimum && (!chooses || fit.smooth == smooth) && (stands || round == CHOOSES + FOLLOWS) {
            converged = true;
            break;
        }
    }
    Ok(Found { fit, steps, converged })
}

/// The criterion of the linear fit around `theta`, in which cells that it does not fit are at their base.
fn criterion(graph: &Graph, theta: &mut [f64], at: &Linear, fit: &Fit, options: &Options) -> Criterion {
    let mut held = Vec::with_capacity(theta.len());
    for l in &graph.labels {
        let shaped = l.is_shaped();
        for locked in &l.locked {
            let visits = fit.visits[held.len()];
            held.push(*locked || !(options.extrapolate || shaped || visits >= options.least_visits.max(1e-9)));
        }
    }
    for ((t, base), held) in theta.iter_mut().zip(graph.base()).zip(&held) {
        if *held {
            *t = base;
        }
    }
    let criterion = Criterion::new(graph, at, held, fit.smooth, options.smooth_change);
    match options.robust {
        true => criterion.robust(linear::huber::knee(&at.r)),
        false => criterion,
    }
}

/// Whether two places are the same for all that counts.
fn near(a: &[f64], b: &[f64], fit: &Fit) -> bool {
    let change: Vec<f64> = a.iter().zip(b).map(|(a, b)| a - b).collect();
    if size(&change) <= STANDS * (STANDS + size(b)) {
        return true;
    }
    let known = change.iter().zip(&fit.half_width).filter(|(_, h)| h.is_finite() && **h > 0.0);
    let squares: Vec<f64> = known.map(|(c, h)| (c / h).powi(2)).collect();
    !squares.is_empty() && squares.iter().sum::<f64>() <= WITHIN * WITHIN * squares.len() as f64
}

/// What only smoothness holds, across labels.
fn across(graph: &Graph, at: &Linear) -> Open {
    let locked: Vec<bool> = graph.labels.iter().flat_map(|l| l.locked.iter().copied()).collect();
    let owner: Vec<usize> =
        graph.labels.iter().enumerate().flat_map(|(k, l)| std::iter::repeat_n(k, l.len())).collect();
    Open::across(&at.j.normal(&at.w, &at.r, &locked).0, &owner)
}

/// The linear fit around `theta`: intervals, verdicts, smoothness; its values, or those of `theta` where these are a `minimum`, and whole
/// steps around them.
fn told(
    graph: &Graph,
    theta: &[f64],
    at: &Linear,
    options: &Options,
    minimum: bool,
) -> Result<Fit, LabelError> {
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
    let mut fit = linear::fit_at(&problem, options, minimum.then_some(theta))?;
    if fit.open.is_empty() && graph.labels.len() > 1 {
        fit.open = across(graph, at);
        fit.mark_open();
    }
    Ok(fit)
}
