//! Labels of a function that is not linear in them: Levenberg-Marquardt with limits, then linear fits that judge smoothness.
//!
//! ```text
//! step     min |J p + r|^2 + mu |D p|^2 + lambda |rough(theta + p)|^2        subject to    the limits of the labels at theta + p
//! between  lambda by generalised cross-validation and the knee of Huber's loss, from the linear fit of J theta + r
//! ```
//!
//! J is exact ([`Graph::forward`]), every step a quadratic program ([`crate::qp`]), so that bounds, monotone and convex labels are kept
//! at every step, and a step is taken only where it lowers the criterion. The first minimum has the smoothness 0.01 unless one is given; then
//! a few rounds of some steps choose it, and a last minimum has what they chose. Intervals and verdicts are what [`crate::linear`] tells there.
//!
//! A function of more than [`MOST_CELLS`] cells, or whose J would fill a GiB, goes another way ([`large`]): the same criterion, without
//! J. There the weight of the smoothness is 0.01 unless it is given, whole steps are the nearest ones, gradients and curvature cannot be
//! limited, and intervals come from draws.

mod descend;
mod jacobian;
pub mod large;
mod settle;

use dynocal_numerics::linalg;
use serde::{Deserialize, Serialize};

use crate::error::LabelError;
use crate::graph::{Graph, Record};
use crate::label::Limit;
use crate::linear::{self, Fit, huber};
use crate::rows::Rows;
use descend::{Criterion, Reach};
use jacobian::Jacobian;
use large::timing::Timing;

/// What a node of the function is compared with on one record: a row of the criterion.
#[derive(Clone, Debug, PartialEq)]
pub struct Target<'a> {
    /// The record.
    pub record: Record<'a>,
    /// Number of the node; none for the last one.
    pub node: Option<usize>,
    /// What the node shall give at each sample.
    pub y: &'a [f64],
    /// Weight of each sample; 0 masks it.
    pub weights: &'a [f64],
}

impl Target<'_> {
    fn node_of(&self, graph: &Graph) -> usize {
        self.node.unwrap_or(graph.nodes.len() - 1)
    }

    /// The same with its first `n` samples only.
    fn first(&self, n: usize) -> Target<'_> {
        let channels = self.record.channels.iter().map(|c| &c[..n]).collect();
        let record = Record { time_s: &self.record.time_s[..n], channels };
        Target { record, node: self.node, y: &self.y[..n], weights: &self.weights[..n] }
    }

    fn counts(&self) -> impl Iterator<Item = usize> + '_ {
        (0..self.y.len()).filter(|k| self.weights[*k] > 0.0)
    }
}

/// Most cells of a function whose J is held.
pub const MOST_CELLS: usize = 500;
/// Most steps.
const MOST_STEPS: usize = 100;
/// Weight of the smoothness until cross-validation has chosen one.
const FIRST_SMOOTH: f64 = 0.01;

/// Rounds in which the knee of a robust loss comes down, and their steps.
const ROBUST: usize = 10;
const FEW: usize = 3;

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

/// The function at a point: residuals, weights, J.
struct Linear {
    /// Samples that count, of each target.
    used: Vec<Vec<usize>>,
    r: Vec<f64>,
    w: Vec<f64>,
    j: Jacobian,
}

/// Residuals of the samples that count, with their weights; none where one is no number.
fn residuals(graph: &Graph, theta: &[f64], targets: &[Target]) -> Option<Vec<(f64, f64)>> {
    let mut out = Vec::new();
    for t in targets {
        let y = graph.all_values(theta, &t.record).swap_remove(t.node_of(graph));
        out.extend(t.counts().map(|k| (t.y[k] - y[k], t.weights[k])));
    }
    out.iter().all(|r| r.0.is_finite()).then_some(out)
}

/// The first sample that counts and at which measurement or function are no numbers.
fn not_finite(graph: &Graph, theta: &[f64], targets: &[Target]) -> LabelError {
    let first = targets.iter().find_map(|t| {
        let y = graph.all_values(theta, &t.record).swap_remove(t.node_of(graph));
        t.counts().find(|k| !(t.y[*k] - y[*k]).is_finite())
    });
    LabelError::NotFinite {
        what: "the function with the values that the search starts from, less the target",
        index: first.unwrap_or(0),
    }
}

fn linearise(graph: &Graph, theta: &[f64], targets: &[Target]) -> Linear {
    let nodes: Vec<usize> = targets.iter().map(|t| t.node_of(graph)).collect();
    // Without a memory after a label a sample depends on the cells that it reads, and on no others.
    let j = match nodes.iter().all(|n| graph.forgets(*n)) {
        true => Jacobian::Rows(Rows::default()),
        false => Jacobian::Columns(vec![Vec::new(); theta.len()]),
    };
    let mut out = Linear { used: Vec::new(), r: Vec::new(), w: Vec::new(), j };
    for (t, node) in targets.iter().zip(nodes) {
        let used: Vec<usize> = t.counts().collect();
        let run = graph.run(theta, &t.record);
        let y = &run.values[node];
        out.r.extend(used.iter().map(|k| t.y[*k] - y[*k]));
        out.w.extend(used.iter().map(|k| t.weights[*k]));
        match &mut out.j {
            Jacobian::Rows(rows) => graph.reads(theta, &t.record, &run, node, &used, rows),
            Jacobian::Columns(columns) => {
                let mut unit = vec![0.0; theta.len()];
                for (c, column) in columns.iter_mut().enumerate() {
                    unit[c] = 1.0;
                    let d = graph.tangents(theta, &t.record, &unit, &run);
                    unit[c] = 0.0;
                    column.extend(used.iter().map(|k| d[node][*k]));
                }
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
    let start = graph.base();
    fit_from(graph, &start, targets, options, interrupt)
}

/// The same from other values than the base, which keeps its meaning: what cells without data have, and what changes are smooth against.
///
/// # Errors
/// As [`fit`].
pub fn fit_from(
    graph: &Graph,
    start: &[f64],
    targets: &[Target],
    options: &linear::Options,
    interrupt: &dyn Fn() -> bool,
) -> Result<Found, LabelError> {
    let channels = targets.first().map_or(0, |t| t.record.channels.len());
    graph.check(channels)?;
    let cells = graph.base().len();
    if let Some(t) = targets.iter().find(|t| t.node_of(graph) >= graph.nodes.len()) {
        let reason = format!("there are {} nodes", graph.nodes.len());
        return Err(LabelError::Node { node: t.node_of(graph).to_string(), reason });
    }
    if start.len() != cells {
        return Err(LabelError::TooFew { found: start.len(), expected: cells });
    }
    targets.iter().try_for_each(|t| graph.answers(start, &t.record))?;
    if large::is_large(cells, targets.iter().map(|t| t.counts().count()).sum()) {
        return large::fit(graph, start, targets, options, interrupt);
    }
    let mut theta = start.to_vec();
    // A locked cell is its base wherever the search starts.
    let locked = graph.labels.iter().flat_map(|l| l.locked.iter().copied());
    for ((t, locked), base) in theta.iter_mut().zip(locked).zip(graph.base()) {
        if locked {
            *t = base;
        }
    }
    if !targets.iter().any(|t| t.counts().next().is_some()) {
        return Err(LabelError::TooFew { found: 0, expected: cells });
    }
    residuals(graph, &theta, targets).ok_or_else(|| not_finite(graph, &theta, targets))?;
    let sample_s = large::timing::sample_s(targets);
    large::timing::begun(graph, &mut theta, sample_s);
    let timing = Timing::new(graph, &theta, sample_s);
    let reach = Reach::new(&timing, interrupt);
    // First with a smoothness that no data have chosen yet.
    let at = linearise(graph, &theta, targets);
    let locked: Vec<bool> = graph.labels.iter().flat_map(|l| l.locked.iter().copied()).collect();
    let smooth = options.smooth.unwrap_or(FIRST_SMOOTH);
    let criterion = |at: &Linear| Criterion::new(graph, at, locked.clone(), smooth, options.smooth_change);
    if options.robust {
        // What lies far outside leads time constants away, and they do not come back: the knee comes down with what is left.
        for _ in 0..ROBUST {
            let at = linearise(graph, &theta, targets);
            let few = Reach { steps: FEW, ..reach };
            let robust = criterion(&at).robust(huber::knee(&at.r, &at.w));
            descend::search(graph, &mut theta, targets, &robust, &few)?;
        }
    }
    let at = if options.robust { linearise(graph, &theta, targets) } else { at };
    let criterion = match options.robust {
        true => criterion(&at).robust(huber::knee(&at.r, &at.w)),
        false => criterion(&at),
    };
    let begun = descend::search(graph, &mut theta, targets, &criterion, &reach)?;
    settle::search(graph, theta, targets, options, begun, &reach)
}

/// Cells that a delay, lag or film is timed by, and shares of a film.
pub fn times_a_memory(graph: &Graph) -> Vec<bool> {
    large::times_a_memory(graph)
}

/// Limits of all labels, on all cells.
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

/// Size of a vector.
fn size(v: &[f64]) -> f64 {
    linalg::norm2(v)
}
