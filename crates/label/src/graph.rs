//! A function of an ECU as a small graph: channels and labels in, one value a sample out, with exact derivatives.
//!
//! Nodes stand in an order in which each uses earlier ones only. What has a memory:
//!
//! ```text
//! delay        y(t) = x(t - d)                               between samples on a straight line; before the record its first value
//! delay_flow   y(t) = x(s),   integral of flow from s to t = V        a gas that moves through a pipe of volume V
//! lag          dy/dt = (x - y) / tau                         exact for x constant over a sample
//! integrator   dy/dt = x,     lower <= y <= upper
//! film         dm/dt = X f - m / tau,   y = (1 - X) f + m / tau       fuel on the wall; starts in balance
//! hysteresis   y = 1 above `high`, 0 below `low`, else as before
//! ```
//!
//! An inverse gives where an increasing curve has a value. Read through the inverse of a curve over its own axis, the breakpoints of other
//! labels become labels themselves: with p_i the values of the curve and b_i its axis, what lies between p_i and p_(i+1) is read as if
//! it lay between b_i and b_(i+1).
//!
//! A model (a stored one, an FMU) may be a node as well ([`outside`]): its derivative is that of central differences over the record.
//!
//! The derivatives go forward in time with the values ([`Graph::forward`]) or backward ([`Graph::gradient`]), for long records over all
//! processors ([`Graph::products`]); they are those of the
//! discrete function, and one-sided where it has an edge.

pub mod axes;
mod backward;
pub(crate) mod forward;
pub mod outside;
pub(crate) mod products;

use serde::{Deserialize, Serialize};

use crate::error::LabelError;
use crate::label::Label;
pub use axes::FittedAxis;
use outside::Outside;
pub use products::Products;

/// Most breakpoints of an axis: places on it are held in two bytes.
pub const MOST_POINTS: usize = 1 << 16;

/// What a node computes; numbers are those of earlier nodes.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Op {
    /// A channel of the record, by its number.
    Channel(usize),
    /// A number.
    Constant(f64),
    /// Sum.
    Add(Vec<usize>),
    /// First less second.
    Subtract(usize, usize),
    /// Product.
    Multiply(Vec<usize>),
    /// First over second.
    Divide(usize, usize),
    /// Least.
    Min(usize, usize),
    /// Greatest.
    Max(usize, usize),
    /// Label by its number, at the values of nodes.
    Label(usize, Vec<usize>),
    /// Where a curve that increases, by its number, has the value of the node; its ends for what is beyond.
    Inverse(usize, usize),
    /// First node, delayed by the second in s.
    Delay(usize, usize),
    /// First node through a pipe: second the flow (a function of channels only), third the volume.
    DelayFlow(usize, usize, usize),
    /// First node through a lag of the second in s.
    Lag(usize, usize),
    /// Integral of the node, its limits, its first value.
    Integrator(usize, f64, f64, f64),
    /// Node, low, high.
    Hysteresis(usize, f64, f64),
    /// Fuel, share that hits the wall, time constant in s.
    Film(usize, usize, usize),
    /// Second node where the first is above 0, else the third.
    Switch(usize, usize, usize),
    /// What is no graph, and the nodes that enter it.
    Model(Outside, Vec<usize>),
}

impl Op {
    /// Whether it knows samples before its own.
    pub(crate) fn remembers(&self) -> bool {
        matches!(
            self,
            Op::Delay(..)
                | Op::DelayFlow(..)
                | Op::Lag(..)
                | Op::Integrator(..)
                | Op::Hysteresis(..)
                | Op::Film(..)
                | Op::Model(..)
        )
    }

    /// Nodes that enter.
    pub fn inputs(&self) -> Vec<usize> {
        match self {
            Op::Channel(_) | Op::Constant(_) => Vec::new(),
            Op::Add(v) | Op::Multiply(v) | Op::Label(_, v) | Op::Model(_, v) => v.clone(),
            Op::Subtract(a, b) | Op::Divide(a, b) | Op::Min(a, b) | Op::Max(a, b) => vec![*a, *b],
            Op::Delay(a, b) | Op::Lag(a, b) => vec![*a, *b],
            Op::DelayFlow(a, b, c) | Op::Film(a, b, c) | Op::Switch(a, b, c) => vec![*a, *b, *c],
            Op::Integrator(a, ..) | Op::Hysteresis(a, ..) | Op::Inverse(_, a) => vec![*a],
        }
    }
}

/// A node with its name.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Node {
    /// Name, for messages.
    pub name: String,
    /// What it computes.
    pub op: Op,
}

/// A function.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Graph {
    /// Nodes; the last is the output.
    pub nodes: Vec<Node>,
    /// Labels.
    pub labels: Vec<Label>,
}

/// A record: channels on common stamps.
#[derive(Clone, Debug, PartialEq)]
pub struct Record<'a> {
    /// Stamps in s, increasing.
    pub time_s: &'a [f64],
    /// Channels.
    pub channels: Vec<&'a [f64]>,
}

impl Graph {
    /// Checks that nodes use earlier ones, channels and labels that there are.
    ///
    /// # Errors
    /// [`LabelError::Node`], [`LabelError::Label`].
    pub fn check(&self, channels: usize) -> Result<(), LabelError> {
        self.labels.iter().try_for_each(Label::check)?;
        for (l, a) in self.labels.iter().flat_map(|l| l.axes.iter().map(move |a| (l, a))) {
            if a.points.len() > MOST_POINTS {
                let found = a.points.len();
                let reason =
                    format!("axis `{}`: found {found} breakpoints, expected at most {MOST_POINTS}", a.name);
                return Err(LabelError::label(&l.name, reason));
            }
        }
        if self.nodes.is_empty() {
            return Err(LabelError::Node { node: "-".into(), reason: "found no node".into() });
        }
        for (k, node) in self.nodes.iter().enumerate() {
            let fail = |reason: String| Err(LabelError::Node { node: node.name.clone(), reason });
            if let Some(i) = node.op.inputs().into_iter().find(|i| *i >= k) {
                return fail(format!("uses node {i}, expected nodes that stand before it"));
            }
            match &node.op {
                Op::Channel(c) if *c >= channels => return fail(format!("there is no channel {c}")),
                Op::Label(l, at) => {
                    let Some(label) = self.labels.get(*l) else {
                        return fail(format!("there is no label {l}"));
                    };
                    if at.len() != label.axes.len() {
                        let wanted = label.axes.len();
                        return fail(format!(
                            "label `{}` has {wanted} axes, found {} inputs",
                            label.name,
                            at.len()
                        ));
                    }
                }
                Op::Inverse(l, _) => {
                    let Some(label) = self.labels.get(*l) else {
                        return fail(format!("there is no label {l}"));
                    };
                    if let Err(reason) = invertible(label) {
                        return fail(reason);
                    }
                }
                Op::DelayFlow(_, flow, _) if self.depends(*flow) => {
                    return fail("the flow of a pipe must be a function of channels only".into());
                }
                Op::Model(model, v) if v.len() != model.inputs.len() => {
                    let names: Vec<&str> = model.inputs.iter().map(|i| i.0.as_str()).collect();
                    return fail(format!("found {} inputs, expected {}", v.len(), names.join(", ")));
                }
                Op::Add(v) | Op::Multiply(v) if v.is_empty() => return fail("found no input".into()),
                Op::Integrator(_, lo, hi, _) | Op::Hysteresis(_, lo, hi) if !(lo <= hi) => {
                    return fail(format!("found the limits {lo} and {hi}, expected the lower first"));
                }
                _ => {}
            }
        }
        Ok(())
    }

    /// Whether node `k` is a function of labels.
    fn depends(&self, k: usize) -> bool {
        let op = &self.nodes[k].op;
        matches!(op, Op::Label(..) | Op::Inverse(..)) || op.inputs().into_iter().any(|i| self.depends(i))
    }

    /// The first node that is a model.
    pub(crate) fn model(&self) -> Option<&Node> {
        self.nodes.iter().find(|n| matches!(n.op, Op::Model(..)))
    }

    /// Asks every model for its answer with the cells `theta`.
    ///
    /// # Errors
    /// [`LabelError::Node`] with what a model says, where it has none.
    pub(crate) fn answers(&self, theta: &[f64], record: &Record) -> Result<(), LabelError> {
        if self.model().is_none() {
            return Ok(());
        }
        let values = self.all_values(theta, record);
        for node in &self.nodes {
            let Op::Model(model, at) = &node.op else { continue };
            let inputs: Vec<&[f64]> = at.iter().map(|i| values[*i].as_slice()).collect();
            let fail = |reason: String| LabelError::Node { node: node.name.clone(), reason };
            let found = model.response.values(record.time_s, &inputs);
            let found = found.map_err(|why| fail(format!("`{}`: {why}", model.name)))?.len();
            if found != record.time_s.len() {
                let expected = record.time_s.len();
                return Err(fail(format!("`{}`: found {found} values, expected {expected}", model.name)));
            }
        }
        Ok(())
    }

    /// Cells of all labels, as they are.
    pub fn base(&self) -> Vec<f64> {
        self.labels.iter().flat_map(|l| l.base.iter().copied()).collect()
    }

    /// First cell of each label.
    fn first(&self) -> Vec<usize> {
        crate::linear::offsets(&self.labels).0
    }
}

/// Whether a label is a curve that increases and that its gradient keeps increasing, or why not.
fn invertible(label: &Label) -> Result<(), String> {
    let name = &label.name;
    let [axis] = label.axes.as_slice() else {
        return Err(format!("`{name}` has {} axes, expected the one of a curve", label.axes.len()));
    };
    if !label.base.windows(2).all(|w| w[1] > w[0]) {
        return Err(format!("the base of `{name}` does not increase everywhere: it has no inverse"));
    }
    if !(axis.gradient[0] > 0.0) {
        let found = axis.gradient[0];
        return Err(format!(
            "the least gradient of `{name}` is {found}, expected one above 0: else it may lose its inverse"
        ));
    }
    Ok(())
}

/// Place `s` on increasing stamps: sample below and share of the way to the next; the first sample for what is before it.
fn place(time_s: &[f64], s: f64, from: usize) -> (usize, f64) {
    let mut i = from;
    while i > 0 && time_s[i] > s {
        i -= 1;
    }
    // Stamps of a log may repeat.
    if i + 1 >= time_s.len() || s <= time_s[0] || !(time_s[i + 1] > time_s[i]) {
        return (i, 0.0);
    }
    (i, ((s - time_s[i]) / (time_s[i + 1] - time_s[i])).clamp(0.0, 1.0))
}
