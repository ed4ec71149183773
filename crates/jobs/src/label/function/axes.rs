//! Axes that are fitted with the labels on them.

use dynocal_files::spec::Faults;
use dynocal_label::graph::{FittedAxis, Graph, Op};
use dynocal_label::nonlinear::{self, Found, MOST_CELLS, Target};
use dynocal_numerics::watch::Watch;

use super::judge::knee;
use super::spec::{Job, Placed};
use super::work::rms;
use crate::label::result::LabelJobError;

/// Least length of an interval between breakpoints that are fitted, as a share of what it was.
const LEAST_INTERVAL: f64 = 0.1;

/// Placings of breakpoints beside the given one on which labels are fitted, and the best ones from which breakpoints are then fitted too.
const PLACINGS: usize = 12;
const SEARCHED: usize = 3;
/// Share by which less is left after another start, from which on it is taken.
const BETTER: f64 = 1e-3;

/// An axis of which the spec says `fit = true`: its name, the key that says so, and labels with the axis (by number, and which of their axes it is).
pub(super) struct Wanted {
    pub(super) name: String,
    pub(super) key: String,
    pub(super) of: Vec<(usize, usize)>,
}

/// The function with these axes as further labels, each by the name of what it breaks and `breakpoints`; a fault for what cannot be.
pub(super) fn fitted(
    mut graph: Graph,
    wanted: &[Wanted],
    placed: &[Placed],
    faults: &mut Faults,
) -> (Graph, Vec<FittedAxis>) {
    let mut out = Vec::new();
    for w in wanted {
        if placed.iter().any(|p| p.of.iter().any(|at| w.of.contains(at))) {
            faults.push(
                &w.key,
                "true",
                "`fit` or `place`: breakpoints are moved in the fit, or chosen after it",
            );
            continue;
        }
        let cells =
            graph.base().len() + w.of.first().map_or(0, |(l, k)| graph.labels[*l].axes[*k].points.len());
        if cells > MOST_CELLS {
            let expected = format!(
                "a function of at most {MOST_CELLS} cells, those of the breakpoints too, or no `fit`"
            );
            faults.push(&w.key, format!("{cells} cells"), expected);
            continue;
        }
        let name = format!("{} breakpoints", w.name);
        if graph.labels.iter().any(|l| l.name == name) {
            faults.push(
                &w.key,
                format!("`{}`, fitted twice", w.name),
                "a name of its own, or an axis of [[axes]] that labels share",
            );
            continue;
        }
        match graph.with_fitted_axis(&name, &w.of, LEAST_INTERVAL) {
            Ok((with, axis)) => {
                graph = with;
                out.push(axis);
            }
            Err(e) => faults.push(&w.key, "an axis that cannot be fitted", e),
        }
    }
    (graph, out)
}

/// The fit of `graph` from `start`; breakpoints of fitted axes that are not known stay where they were (and are locked), and the rest is fitted
/// again. A word on each of them.
///
/// # Errors
/// [`LabelJobError`]: those of the fit.
pub(super) fn fit(
    job: &Job,
    graph: &mut Graph,
    mut start: Vec<f64>,
    targets: &[Target],
    watch: Watch,
) -> Result<(Found, Vec<String>), LabelJobError> {
    let interrupt = || watch.interrupted();
    let (mut said, mut found) = (Vec::new(), searched(job, graph, start.clone(), targets, watch)?);
    loop {
        let unknown = unknown(graph, &job.fitted, &found);
        if unknown.is_empty() || watch.interrupted() {
            return Ok((found, said));
        }
        start.clone_from(&found.fit.exact);
        for (label, from, k) in unknown {
            let l = &mut graph.labels[label];
            l.locked[k] = true;
            // Others may have gone past it.
            start[from..from + l.len()].copy_from_slice(&l.base);
            said.push(format!(
                "the breakpoint {} {} of `{}` stays: what the data say of it is wider than the interval beside it",
                l.base[k], l.unit, l.axes[0].name
            ));
        }
        found = nonlinear::fit_from(graph, &start, targets, &job.fit, &interrupt)?;
    }
}

/// The fit from `start`; with breakpoints that are fitted the best of those from several placings of them. A breakpoint moves as far as the
/// values about it tell of it, and no further: there are as many minima as ways to share them out.
fn searched(
    job: &Job,
    graph: &Graph,
    start: Vec<f64>,
    targets: &[Target],
    watch: Watch,
) -> Result<Found, LabelJobError> {
    let interrupt = || watch.interrupted();
    let first = nonlinear::fit_from(graph, &start, targets, &job.fit, &interrupt)?;
    if job.fitted.is_empty() {
        return Ok(first);
    }
    watch.note("fitting from other placings of the breakpoints");
    let knee = job.fit.robust.then(|| knee(graph, &first.fit.exact, targets));
    let left = |theta: &[f64]| rms(graph, theta, targets, knee);
    let mut begun: Vec<(f64, Vec<f64>)> = Vec::new();
    for placing in 0..=PLACINGS {
        let (with, from) = placed(job, graph, &start, placing);
        // What cannot be fitted there is no start.
        if let Ok(found) = nonlinear::fit_from(&with, &from, targets, &job.fit, &interrupt) {
            begun.push((left(&found.fit.exact), found.fit.exact));
        }
    }
    begun.sort_by(|a, b| a.0.total_cmp(&b.0));
    let (mut best, mut least) = (left(&first.fit.exact), first);
    for (_, from) in begun.into_iter().take(SEARCHED) {
        let Ok(found) = nonlinear::fit_from(graph, &from, targets, &job.fit, &interrupt) else { continue };
        let own = left(&found.fit.exact);
        if (found.converged, -own) > (least.converged, -best * (1.0 - BETTER)) {
            (best, least) = (own, found);
        }
    }
    Ok(least)
}

/// The function with its breakpoints at a placing, held, and where a search of the labels on them starts: the first placing is the given one,
/// the others are points of a sequence that spreads evenly.
fn placed(job: &Job, graph: &Graph, start: &[f64], placing: usize) -> (Graph, Vec<f64>) {
    let (mut with, mut from) = (graph.clone(), start.to_vec());
    for axis in &job.fitted {
        let at: usize = graph.labels[..axis.label].iter().map(|l| l.len()).sum();
        let l = &mut with.labels[axis.label];
        let inner = l.len().saturating_sub(2);
        // One that the user has locked is not moved past.
        if placing > 0 && !l.locked[1..=inner].contains(&true) {
            let (low, high) = (l.base[0], l.base[inner + 1]);
            let golden =
                |j: usize| (0.5 + ((placing - 1) * inner + j + 1) as f64 * 0.618_033_988_749_894_9).fract();
            let mut places: Vec<f64> = (0..inner).map(golden).collect();
            places.sort_by(f64::total_cmp);
            let least = LEAST_INTERVAL / (inner + 1) as f64;
            let room = 1.0 - least * (inner + 1) as f64;
            for (j, u) in places.into_iter().enumerate() {
                l.base[j + 1] = low + (high - low) * (least * (j + 1) as f64 + room * u);
            }
        }
        l.locked.fill(true);
        from[at..at + l.len()].copy_from_slice(&l.base);
    }
    (with, from)
}

/// The node that says where a label is read: before the inverse of an axis that is fitted.
pub(super) fn reads(graph: &Graph, axes: &[FittedAxis], node: usize) -> usize {
    match graph.nodes[node].op {
        Op::Inverse(l, x) if axes.iter().any(|a| a.label == l) => x,
        _ => node,
    }
}

/// Breakpoints whose 95 % interval is wider than the shorter of the intervals beside them, or that have none: label, its first cell, cell.
fn unknown(graph: &Graph, axes: &[FittedAxis], found: &Found) -> Vec<(usize, usize, usize)> {
    let mut out = Vec::new();
    for axis in axes {
        let from: usize = graph.labels[..axis.label].iter().map(|l| l.len()).sum();
        let label = &graph.labels[axis.label];
        for k in (0..label.len()).filter(|k| !label.locked[*k]) {
            let beside = (label.base[k + 1] - label.base[k]).min(label.base[k] - label.base[k - 1]);
            let half = found.fit.half_width[from + k];
            if !(2.0 * half <= beside) {
                out.push((axis.label, from, k));
            }
        }
    }
    out
}
