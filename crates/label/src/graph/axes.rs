//! Breakpoints as labels: an axis that is fitted with the values on it.
//!
//! ```text
//! P(b_i) = p_i                  a curve over the breakpoints b as they are, whose values are the breakpoints p that are sought
//! y = M(P^-1(x))                every label M on the axis is read through its inverse
//! ```
//!
//! At p = b nothing has changed. Smoothness of M counts over b, as does a gradient that is limited to one sign; other limits of gradients and
//! curvature would not be those over p, and are refused. Ends of the axis stay, and so do breakpoints of locked cells. Intervals between
//! breakpoints stay longer than a share of what they were.

use super::{Graph, Node, Op};
use crate::error::LabelError;
use crate::label::{Axis, Label};
use crate::linear::offsets;

/// An axis that is fitted: the label that holds its breakpoints, and where it is an axis, as numbers of labels and of their axes.
#[derive(Clone, Debug, PartialEq, serde::Serialize)]
pub struct FittedAxis {
    /// Number of the label of the breakpoints.
    pub label: usize,
    /// Labels and which of their axes it is.
    pub of: Vec<(usize, usize)>,
}

impl Graph {
    /// The same function with the axis `of` (numbers of labels, and which of their axes; all of one quantity and with the same
    /// breakpoints) as a further label, the last one: a curve of the unit of the axis over its breakpoints. Intervals between them stay
    /// longer than the share `least` of what they were. Nodes keep their names; numbers of nodes change.
    ///
    /// # Errors
    /// [`LabelError::Label`]: no such label or axis, other breakpoints, a share outside of 0 to 1, limits of gradients (but to one sign) or
    /// curvature along the axis, a label that is read by an inverse.
    pub fn with_fitted_axis(
        &self,
        name: &str,
        of: &[(usize, usize)],
        least: f64,
    ) -> Result<(Self, FittedAxis), LabelError> {
        let axis_of = |(l, k): (usize, usize)| self.labels.get(l).and_then(|l| l.axes.get(k));
        let fail = |reason: &str| LabelError::label(name, reason);
        let first = of.first().and_then(|at| axis_of(*at)).ok_or_else(|| fail("found no axis to fit"))?;
        for at in of {
            let same = axis_of(*at).is_some_and(|a| a.points == first.points && a.unit == first.unit);
            if !same {
                return Err(fail("found labels with other breakpoints, expected one axis"));
            }
        }
        if !(least > 0.0 && least < 1.0) {
            return Err(fail("found a least share of the intervals that is not between 0 and 1"));
        }
        for (l, k) in of {
            let (label, axis) = (&self.labels[*l], &self.labels[*l].axes[*k]);
            if axis.convex != 0 || axis.gradient.iter().any(|g| g.is_finite() && *g != 0.0) {
                return Err(fail(&format!(
                    "`{}` has a limit of its curvature or gradient along it, expected none but a gradient of one sign (0): it would hold over breakpoints that are given",
                    label.name
                )));
            }
            if self.nodes.iter().any(|n| matches!(n.op, Op::Inverse(inverse, _) if inverse == *l)) {
                return Err(fail(&format!("`{}` is read by an inverse, whose axis is given", label.name)));
            }
        }
        let mut own = Axis::new(&first.name, &first.unit, &first.points);
        own.smooth = 0.0;
        own.gradient = [least, f64::INFINITY];
        let mut breakpoints = Label::new(name, &first.unit, vec![own], &first.points);
        let last = first.points.len() - 1;
        for i in 0..=last {
            breakpoints.locked[i] = i == 0 || i == last || of.iter().any(|at| self.holds(*at, i));
        }
        if breakpoints.locked.iter().all(|l| *l) {
            return Err(fail(
                "every breakpoint stays (the ends, and those of locked cells): there is none to fit",
            ));
        }
        let fitted = FittedAxis { label: self.labels.len(), of: of.to_vec() };
        let mut out = self.read_through(&fitted, name);
        out.labels.push(breakpoints);
        Ok((out, fitted))
    }

    /// Whether a locked cell of a label lies at breakpoint `i` of its axis: a value that is given by definition is given at a place.
    fn holds(&self, (l, k): (usize, usize), i: usize) -> bool {
        let label = &self.labels[l];
        let nx = label.axes[0].points.len();
        (0..label.len()).any(|c| label.locked[c] && (if k == 0 { c % nx } else { c / nx }) == i)
    }

    /// The nodes with an inverse before each place at which the axis is read.
    fn read_through(&self, fitted: &FittedAxis, name: &str) -> Self {
        let (mut nodes, mut place): (Vec<Node>, Vec<usize>) = (Vec::new(), Vec::new());
        // Inverses that there are, by the node that they read.
        let mut known: Vec<(usize, usize)> = Vec::new();
        for node in &self.nodes {
            let mut op = node.op.with_inputs(&|i| place[i]);
            if let Op::Label(l, at) = &mut op {
                for (_, k) in fitted.of.iter().filter(|(label, _)| label == l) {
                    let Some(input) = at.get_mut(*k) else { continue };
                    let through = known.iter().find(|(x, _)| x == input).map(|(_, through)| *through);
                    *input = through.unwrap_or_else(|| {
                        nodes.push(Node {
                            name: format!("inverse of {name}"),
                            op: Op::Inverse(fitted.label, *input),
                        });
                        known.push((*input, nodes.len() - 1));
                        nodes.len() - 1
                    });
                }
            }
            nodes.push(Node { name: node.name.clone(), op });
            place.push(nodes.len() - 1);
        }
        Self { nodes, labels: self.labels.clone() }
    }

    /// The labels on the breakpoints that were found, with what their base has there: `theta` has the cells of all labels.
    pub fn labels_on(&self, axes: &[FittedAxis], theta: &[f64]) -> Vec<Label> {
        let first = offsets(&self.labels).0;
        let mut out = self.labels.clone();
        for axis in axes {
            let points = &theta[first[axis.label]..first[axis.label] + self.labels[axis.label].len()];
            axis.of.iter().for_each(|(l, k)| out[*l].axes[*k].points = points.to_vec());
        }
        for (new, old) in out.iter_mut().zip(&self.labels) {
            new.base = new.sampled(old, &old.base);
        }
        out
    }
}

impl Op {
    /// The same with other numbers of what enters.
    pub(crate) fn with_inputs(&self, to: &dyn Fn(usize) -> usize) -> Self {
        let all = |v: &[usize]| v.iter().map(|i| to(*i)).collect::<Vec<_>>();
        match self {
            Op::Channel(_) | Op::Constant(_) => self.clone(),
            Op::Add(v) => Op::Add(all(v)),
            Op::Multiply(v) => Op::Multiply(all(v)),
            Op::Label(l, v) => Op::Label(*l, all(v)),
            Op::Model(m, v) => Op::Model(m.clone(), all(v)),
            Op::Inverse(l, a) => Op::Inverse(*l, to(*a)),
            Op::Subtract(a, b) => Op::Subtract(to(*a), to(*b)),
            Op::Divide(a, b) => Op::Divide(to(*a), to(*b)),
            Op::Min(a, b) => Op::Min(to(*a), to(*b)),
            Op::Max(a, b) => Op::Max(to(*a), to(*b)),
            Op::Delay(a, b) => Op::Delay(to(*a), to(*b)),
            Op::Lag(a, b) => Op::Lag(to(*a), to(*b)),
            Op::DelayFlow(a, b, c) => Op::DelayFlow(to(*a), to(*b), to(*c)),
            Op::Film(a, b, c) => Op::Film(to(*a), to(*b), to(*c)),
            Op::Switch(a, b, c) => Op::Switch(to(*a), to(*b), to(*c)),
            Op::Integrator(a, lo, hi, start) => Op::Integrator(to(*a), *lo, *hi, *start),
            Op::Hysteresis(a, lo, hi) => Op::Hysteresis(to(*a), *lo, *hi),
        }
    }
}
