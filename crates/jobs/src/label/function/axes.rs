//! Axes that are fitted with the labels on them.

use dynocal_files::spec::Faults;
use dynocal_label::graph::{FittedAxis, Graph, Op};
use dynocal_label::nonlinear::{self, Found, MOST_CELLS, Target};
use dynocal_numerics::watch::Watch;

use super::spec::{Job, Placed};
use crate::label::result::LabelJobError;

/// Least length of an interval between breakpoints that are fitted, as a share of what it was.
const LEAST_INTERVAL: f64 = 0.1;

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
    let mut said = Vec::new();
    loop {
        let found = nonlinear::fit_from(graph, &start, targets, &job.fit, &interrupt)?;
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
    }
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
