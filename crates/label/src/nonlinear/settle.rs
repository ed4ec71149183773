//! The second stage: how smooth the labels are and what lies far outside, from linear fits, and a minimum with that.

use super::descend::{self, Criterion, Reach};
use super::{FIRST_SMOOTH, Found, Linear, Target, linearise, residuals, size};
use crate::error::LabelError;
use crate::graph::Graph;
use crate::linear::{self, Fit, Open, Options, Problem, huber};
use crate::rows::Rows;

/// Weights of the smoothness that are tried, each at the place that the one before has led to.
const CHOOSES: usize = 5;
/// Steps of a round that chooses.
const FEW: usize = 5;
/// Most rounds after them, each to a minimum: sizes of the roughness and the knee of the loss follow the labels.
const FOLLOWS: usize = 5;
/// Rise of the squares in variances of a sample up to which a cell may go back to its base.
const MINDS: f64 = 1e-3;
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
        // The linear fit at a minimum is that minimum, but for corners and for what nothing depends on there.
        let cost = |theta: &[f64]| squares(graph, theta, targets);
        criterion(graph, &mut theta, &at, &fit, &options, targets);
        let (there, here) = (cost(&fit.exact).unwrap_or(f64::INFINITY), cost(&theta).unwrap_or(0.0));
        if minimum && there > here * (1.0 + MINDS / at.r.len() as f64) {
            fit = told(graph, &theta, &linearise(graph, &theta, targets), &options, true)?;
        }
        return Ok(Found { fit, steps: begun, converged: minimum });
    }
    let mut steps = begun;
    if options.smooth.is_none() {
        let few = Reach { steps: FEW, ..*reach };
        let first = (FIRST_SMOOTH, score(graph, &theta, &at, &options, FIRST_SMOOTH)?, theta.clone());
        let mut tried = vec![first];
        while tried.len() <= CHOOSES && !tried.iter().any(|t| t.0 == fit.smooth) && !(reach.interrupt)() {
            let criterion = criterion(graph, &mut theta, &at, &fit, &options, targets);
            steps += descend::search(graph, &mut theta, targets, &criterion, &few)?.0;
            at = linearise(graph, &theta, targets);
            tried.push((fit.smooth, score(graph, &theta, &at, &options, fit.smooth)?, theta.clone()));
            fit = told(graph, &theta, &at, &options, true)?;
        }
        if let Some((smooth, _, place)) = tried.into_iter().min_by(|a, b| a.1.total_cmp(&b.1)) {
            (options.smooth, theta) = (Some(smooth), place);
        }
        at = linearise(graph, &theta, targets);
        fit = told(graph, &theta, &at, &options, true)?;
    }
    let mut converged = false;
    for round in 1..=FOLLOWS {
        if (reach.interrupt)() {
            break;
        }
        let before = theta.clone();
        let criterion = criterion(graph, &mut theta, &at, &fit, &options, targets);
        let (n, minimum) = descend::search(graph, &mut theta, targets, &criterion, reach)?;
        steps += n;
        at = linearise(graph, &theta, targets);
        fit = told(graph, &theta, &at, &options, true)?;
        // What follows the labels further than this moves them less than the last round did.
        if minimum && (near(&before, &theta, &fit) || round == FOLLOWS) {
            converged = true;
            break;
        }
    }
    Ok(Found { fit, steps, converged })
}

/// Score of generalised cross-validation at a place that was searched with the weight `smooth`: of what the function itself leaves there. A linear
/// fit promises more than that where a factor has the shape of what it multiplies.
fn score(
    graph: &Graph,
    theta: &[f64],
    at: &Linear,
    options: &Options,
    smooth: f64,
) -> Result<f64, LabelError> {
    let fit = told(graph, theta, at, &Options { smooth: Some(smooth), ..options.clone() }, true)?;
    let knee = options.robust.then(|| huber::knee(&at.r, &at.w));
    let loss: f64 = at.r.iter().zip(&at.w).map(|(r, w)| huber::loss(*r, *w, knee)).sum();
    let left = 1.0 - fit.correlation_samples * fit.effective_parameters / at.r.len() as f64;
    Ok(if left > 1e-3 { loss / (left * left) } else { f64::INFINITY })
}

/// The criterion of the linear fit around `theta`, in which cells that it does not fit are at their base.
fn criterion(
    graph: &Graph,
    theta: &mut Vec<f64>,
    at: &Linear,
    fit: &Fit,
    options: &Options,
    targets: &[Target],
) -> Criterion {
    let mut held = Vec::with_capacity(theta.len());
    for l in &graph.labels {
        let shaped = l.is_shaped();
        for locked in &l.locked {
            let visits = fit.visits[held.len()];
            held.push(
                *locked || !(options.extrapolate || shaped || visits >= options.least_visits.max(1e-9)),
            );
        }
    }
    back(graph, theta, &held, fit, targets);
    let new = |smooth: f64| Criterion::new(graph, at, held, smooth, options.smooth_change);
    if !options.robust {
        return new(fit.smooth);
    }
    // The weight was chosen for pseudo measurements, of which the loss has a share.
    let knee = huber::knee(&at.r, &at.w);
    new(fit.smooth * huber::within(&at.r, &at.w, knee)).robust(knee)
}

/// Cells of which too little is known go back to their base. One that nothing depends on where the search has led it may have been led there
/// by the samples (a lag to none, a floor below all of them): it goes back only where they do not mind.
fn back(graph: &Graph, theta: &mut Vec<f64>, held: &[bool], fit: &Fit, targets: &[Target]) {
    let base = graph.base();
    let told = |theta: &[f64]| squares(graph, theta, targets);
    let (mut gone, mut few) = (Vec::new(), theta.clone());
    for k in (0..theta.len()).filter(|k| held[*k] && theta[*k] != base[*k]) {
        if fit.visits[k] > 1e-9 {
            few[k] = base[k];
        } else {
            gone.push(k);
        }
    }
    *theta = few;
    if gone.is_empty() {
        return;
    }
    let (Some(here), samples) = (told(theta), targets.iter().map(|t| t.counts().count()).sum::<usize>())
    else {
        return;
    };
    let kept = |there: Option<f64>| there.is_some_and(|c| c <= here * (1.0 + MINDS / samples as f64));
    let mut all = theta.clone();
    gone.iter().for_each(|k| all[*k] = base[*k]);
    if kept(told(&all)) {
        *theta = all;
        return;
    }
    for k in gone {
        let own = std::mem::replace(&mut theta[k], base[k]);
        if !kept(told(theta)) {
            theta[k] = own;
        }
    }
}

/// Weighted squares of what is left; none where a sample is no number.
fn squares(graph: &Graph, theta: &[f64], targets: &[Target]) -> Option<f64> {
    residuals(graph, theta, targets).map(|r| r.iter().map(|(r, w)| w * r * r).sum())
}

/// Whether two places are the same for all that counts.
fn near(a: &[f64], b: &[f64], fit: &Fit) -> bool {
    let change: Vec<f64> = a.iter().zip(b).map(|(a, b)| a - b).collect();
    if size(&change) <= STANDS * (STANDS + size(b)) {
        return true;
    }
    let known = change.iter().zip(&fit.half_width).filter(|(_, h)| h.is_finite() && **h > 0.0);
    let squares: Vec<f64> = known.map(|(c, h)| (c / h).powi(2)).collect();
    squares.iter().sum::<f64>() <= WITHIN * WITHIN * squares.len() as f64
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
