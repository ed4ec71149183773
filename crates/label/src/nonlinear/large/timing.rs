//! Labels that time a memory: delays, time constants, shares of a film. Where they start, and how far they go in a step.
//!
//! What decays within a sample is none to the function: of a lag of tau the share `exp(-h/tau)` is left after h, and the derivative
//! `h/tau^2 exp(-h/tau)` is nothing for tau far below h. A search that has gone there does not come back, whatever the data say. So time
//! constants start at one sample at least, and where they are longer than a quarter of it they become half of themselves a step at most.

use std::ops::Range;

use crate::graph::{Graph, Op};
use crate::linear::offsets;
use crate::nonlinear::Target;

/// Step of what times a memory, as a share of its value, at most.
const FACTOR: f64 = 0.5;
/// Value, in s or as a share, that a start of 0 counts as.
const LEAST_START: f64 = 0.01;
/// Share of a sample up to which a time constant goes any distance down.
const SEEN: f64 = 0.25;

/// Cells that time a memory.
pub(in crate::nonlinear) struct Timing {
    /// Whether each cell does.
    pub(super) times: Vec<bool>,
    /// Value of each cell that counts where its own is smaller, for steps down and up.
    least: [Vec<f64>; 2],
}

impl Timing {
    /// Of a search from `start`.
    pub(in crate::nonlinear) fn new(graph: &Graph, start: &[f64], sample_s: f64) -> Self {
        let (times, constants) = (timing(graph), constants(graph));
        let up = |k: usize| if times[k] { start[k].abs().max(LEAST_START) } else { f64::INFINITY };
        let down = |k: usize| if constants[k] { SEEN * sample_s } else { up(k) };
        let all = 0..start.len();
        let least = [all.clone().map(down).collect(), all.map(up).collect()];
        Self { times, least }
    }

    /// Share of the step `p` from `theta` that leads no farther than a step may.
    pub(in crate::nonlinear) fn share(&self, theta: &[f64], p: &[f64]) -> f64 {
        let most = |(k, p): (usize, &f64)| {
            let side = usize::from(*p > 0.0);
            FACTOR * theta[k].abs().max(self.least[side][k]) / p.abs()
        };
        p.iter().enumerate().map(most).fold(1.0, f64::min)
    }

    /// Brings `next` back to where a step from `theta` may lead; whether it was too far.
    pub(super) fn shorten(&self, theta: &[f64], next: &mut [f64]) -> bool {
        let mut short = false;
        for (k, v) in next.iter_mut().enumerate() {
            let most = |side: usize| FACTOR * theta[k].abs().max(self.least[side][k]);
            let kept = v.clamp(theta[k] - most(0), theta[k] + most(1));
            short |= kept != *v;
            *v = kept;
        }
        short
    }
}

/// `theta` with time constants of one sample where they are shorter.
pub(super) fn seen(graph: &Graph, theta: &[f64], sample_s: f64) -> Vec<f64> {
    let all = theta.iter().zip(constants(graph));
    all.map(|(v, constant)| if constant { v.max(sample_s) } else { *v }).collect()
}

/// `theta` with times of a delay, lag or film that are shorter than a sample at one sample, as far as their bounds allow: of a delay of 0 the
/// function knows no derivative, and of a lag that is far shorter none that counts.
pub(in crate::nonlinear) fn begun(graph: &Graph, theta: &mut [f64], sample_s: f64) {
    for node in &graph.nodes {
        let (Op::Delay(_, time) | Op::Lag(_, time) | Op::Film(_, _, time)) = &node.op else { continue };
        let Op::Label(l, _) = &graph.nodes[*time].op else { continue };
        let label = &graph.labels[*l];
        let from = offsets(&graph.labels).0[*l];
        for (k, v) in theta[from..from + label.len()].iter_mut().enumerate() {
            if !label.locked[k] && *v < sample_s {
                *v = sample_s.min(label.upper);
            }
        }
    }
}

/// Median time between samples, s.
pub(in crate::nonlinear) fn sample_s(targets: &[Target]) -> f64 {
    let steps = |t: &Target| t.record.time_s.windows(2).map(|w| w[1] - w[0]).collect::<Vec<_>>();
    let mut all: Vec<f64> = targets.iter().flat_map(steps).filter(|dt| *dt > 0.0).collect();
    if all.is_empty() {
        return 0.0;
    }
    let middle = all.len() / 2;
    *all.select_nth_unstable_by(middle, f64::total_cmp).1
}

/// Cells of labels that are the time constant of a lag or a film.
fn constants(graph: &Graph) -> Vec<bool> {
    let (mut out, spans) = (vec![false; graph.base().len()], spans(graph));
    for node in &graph.nodes {
        let (Op::Lag(_, tau) | Op::Film(_, _, tau)) = &node.op else { continue };
        if let Op::Label(l, _) = &graph.nodes[*tau].op {
            out[spans[*l].clone()].fill(true);
        }
    }
    out
}

/// Cells of labels that a delay, lag or film is timed by, and of shares of a film.
pub(super) fn timing(graph: &Graph) -> Vec<bool> {
    let mut times = vec![false; graph.nodes.len()];
    let mut out = vec![false; graph.base().len()];
    let spans = spans(graph);
    for (k, node) in graph.nodes.iter().enumerate().rev() {
        let inputs = node.op.inputs();
        let from = match node.op {
            _ if times[k] => 0,
            Op::Delay(..) | Op::DelayFlow(..) | Op::Lag(..) | Op::Film(..) => 1,
            _ => inputs.len(),
        };
        inputs[from..].iter().for_each(|i| times[*i] = true);
        if let (true, Op::Label(l, _)) = (times[k], &node.op) {
            out[spans[*l].clone()].fill(true);
        }
    }
    out
}

/// Cells of each label, one after the other.
pub(super) fn spans(graph: &Graph) -> Vec<Range<usize>> {
    let (first, _) = offsets(&graph.labels);
    graph.labels.iter().zip(first).map(|(l, from)| from..from + l.len()).collect()
}
