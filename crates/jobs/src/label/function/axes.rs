//! Axes that are fitted with the labels on them.

use dynocal_files::spec::Faults;
use dynocal_label::graph::{FittedAxis, Graph};

use super::spec::Placed;

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
