//! What is computed sample by sample, as data: the neutral form of dynamic maps, models, networks and controllers.
//!
//! A program is a list of nodes; each reads nodes before it. Only a delay may read a node after it, which is how a
//! recursion is said:
//!
//! ```text
//! y(t) = 0.2 u(t) + 0.8 y(t-1):    0 input u;  1 delay of 2 by 1, from 0;  2 polynomial 0.2 [0] + 0.8 [1]
//! ```
//!
//! A polynomial NARX model is inputs, delays and one polynomial; a network is delays, scalings and layers; a structured
//! dynamic map adds filters, differences and clamps; a scheduled controller adds look-ups. Coefficients stay arrays with
//! a name, so that a calibrator finds them in the ECU.

use dynocal_numerics::interval::Interval;
use serde::{Deserialize, Serialize};

use crate::characteristic::{Characteristic, is_identifier};
use crate::error::ExportError;

/// Place of a node in [`Program::nodes`].
pub type NodeId = usize;

/// A channel that enters.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Input {
    /// Name, a C identifier.
    pub name: String,
    /// Unit.
    pub unit: String,
    /// One line.
    pub description: String,
    /// Value before anything is connected.
    pub start: f64,
    /// Least and greatest value in the data, where known.
    pub range: Option<Interval>,
}

/// A channel that leaves.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Output {
    /// Name, a C identifier.
    pub name: String,
    /// Unit.
    pub unit: String,
    /// One line.
    pub description: String,
    /// Node that it shows.
    pub node: NodeId,
}

/// What a delay line holds before the first sample.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Start {
    /// The first value that enters it.
    First,
    /// A number.
    Value(f64),
}

/// A power of a node.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Factor {
    /// Node.
    pub node: NodeId,
    /// Power, at least 1.
    pub power: u32,
}

/// A coefficient times a product of powers.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Term {
    /// Coefficient.
    pub coefficient: f64,
    /// Factors; none for a constant.
    pub factors: Vec<Factor>,
}

/// A function of one variable.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Shape {
    /// Identity.
    Linear,
    /// Hyperbolic tangent.
    Tanh,
    /// 1 / (1 + exp(-x)).
    Sigmoid,
    /// max(x, 0).
    Relu,
    /// log(1 + exp x) = max(x, 0) + log(1 + exp(-|x|)).
    Softplus,
    /// Absolute value.
    Abs,
    /// Square root of the positive part.
    Sqrt,
    /// Exponential.
    Exp,
    /// Inverse hyperbolic sine.
    Asinh,
    /// Sine.
    Sin,
    /// Cosine.
    Cos,
    /// Matern 3/2 over a squared distance x: (1 + a) exp(-a), a = sqrt(3 max(x, 0)).
    Matern32,
    /// Matern 5/2 over a squared distance x: (1 + a + a a/3) exp(-a), a = sqrt(5 max(x, 0)).
    Matern52,
}

/// One layer of a network: activation(W a + b).
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Layer {
    /// Weights, one row a neuron.
    pub weights: Vec<f64>,
    /// Offsets, one a neuron.
    pub offsets: Vec<f64>,
    /// Activation.
    pub activation: Shape,
}

/// Time constant of a lag.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Tau {
    /// In s.
    Fixed(f64),
    /// A node whose value is the time constant in s.
    Node(NodeId),
}

/// What a node computes.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Op {
    /// Input number k.
    Input(usize),
    /// A number.
    Constant(f64),
    /// The value of a node `samples` earlier; the only one that may read a node after itself.
    Delay {
        /// Node.
        of: NodeId,
        /// At least 1.
        samples: usize,
        /// Before the first sample.
        start: Start,
    },
    /// gain * x + offset.
    Scale {
        /// Node.
        of: NodeId,
        /// Gain.
        gain: f64,
        /// Offset.
        offset: f64,
    },
    /// a - b.
    Difference {
        /// Node.
        a: NodeId,
        /// Node.
        b: NodeId,
    },
    /// numerator / x.
    Reciprocal {
        /// Node.
        of: NodeId,
        /// Numerator.
        numerator: f64,
    },
    /// x moved into lower to upper; NaN becomes lower.
    Clamp {
        /// Node.
        of: NodeId,
        /// Lower limit.
        lower: f64,
        /// Upper limit.
        upper: f64,
    },
    /// First-order lag, exact for a held input: x+ = x + (1 - exp(-dt/tau)) (u - x), at rest at its first input.
    Lag {
        /// Node.
        of: NodeId,
        /// Time constant.
        tau: Tau,
    },
    /// Sum of terms, in their order.
    Polynomial {
        /// Terms, at least one.
        terms: Vec<Term>,
    },
    /// A function of one node.
    Function {
        /// Node.
        of: NodeId,
        /// Which.
        shape: Shape,
    },
    /// Layers one after the other; the last has one neuron.
    Network {
        /// What enters the first layer.
        inputs: Vec<NodeId>,
        /// Layers.
        layers: Vec<Layer>,
    },
    /// Linear interpolation in a characteristic, x first.
    Lookup {
        /// Name of the characteristic.
        characteristic: String,
        /// One node for each axis.
        inputs: Vec<NodeId>,
    },
}

/// A node with a name for comments and arrays of coefficients.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Node {
    /// Name, a C identifier.
    pub name: String,
    /// What it computes.
    pub op: Op,
}

/// A program in sampled time.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Program {
    /// Sample time in s.
    pub sample_time_s: f64,
    /// Inputs.
    pub inputs: Vec<Input>,
    /// Nodes.
    pub nodes: Vec<Node>,
    /// Outputs.
    pub outputs: Vec<Output>,
}

/// A delay line: which node, how long, how it starts.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Line {
    /// Node.
    pub of: NodeId,
    /// Samples kept.
    pub length: usize,
    /// Before the first sample.
    pub start: Start,
}

impl Op {
    /// Nodes that must be known before this one (a delay has none).
    pub fn reads(&self) -> Vec<NodeId> {
        match self {
            Op::Input(_) | Op::Constant(_) | Op::Delay { .. } => Vec::new(),
            Op::Scale { of, .. }
            | Op::Reciprocal { of, .. }
            | Op::Clamp { of, .. }
            | Op::Function { of, .. } => vec![*of],
            Op::Difference { a, b } => vec![*a, *b],
            Op::Lag { of, tau: Tau::Fixed(_) } => vec![*of],
            Op::Lag { of, tau: Tau::Node(t) } => vec![*of, *t],
            Op::Polynomial { terms } => terms.iter().flat_map(|t| t.factors.iter().map(|f| f.node)).collect(),
            Op::Network { inputs, .. } | Op::Lookup { inputs, .. } => inputs.clone(),
        }
    }
}

impl Program {
    /// Appends a node and gives its place.
    pub fn push(&mut self, name: &str, op: Op) -> NodeId {
        self.nodes.push(Node { name: name.into(), op });
        self.nodes.len() - 1
    }

    /// Delay lines, one for each node that is delayed, in the order of those nodes.
    pub fn lines(&self) -> Vec<Line> {
        let mut out: Vec<Line> = Vec::new();
        for node in &self.nodes {
            if let Op::Delay { of, samples, start } = node.op {
                match out.iter_mut().find(|l| l.of == of) {
                    Some(l) => l.length = l.length.max(samples),
                    None => out.push(Line { of, length: samples, start }),
                }
            }
        }
        out.sort_by_key(|l| l.of);
        out
    }

    /// Places of the lags.
    pub fn lags(&self) -> Vec<NodeId> {
        (0..self.nodes.len()).filter(|k| matches!(self.nodes[*k].op, Op::Lag { .. })).collect()
    }

    /// Whether a step depends on those before it.
    pub fn remembers(&self) -> bool {
        !self.lines().is_empty() || !self.lags().is_empty()
    }

    /// Inputs that reach output `output` within one sample, for the dependencies of an FMU.
    pub fn feedthrough(&self, output: usize) -> Vec<usize> {
        let mut open = vec![self.outputs[output].node];
        let (mut met, mut inputs) = (vec![false; self.nodes.len()], vec![false; self.inputs.len()]);
        while let Some(k) = open.pop() {
            if std::mem::replace(&mut met[k], true) {
                continue;
            }
            if let Op::Input(i) = self.nodes[k].op {
                inputs[i] = true;
            }
            // A line that starts with its first value lets that value through at the first sample.
            open.extend(self.nodes[k].op.reads());
        }
        (0..inputs.len()).filter(|i| inputs[*i]).collect()
    }

    /// Checks that every node can be computed.
    ///
    /// # Errors
    /// [`ExportError::Form`] with the node and what is wrong.
    pub fn check(&self, characteristics: &[Characteristic]) -> Result<(), ExportError> {
        if !(self.sample_time_s > 0.0 && self.sample_time_s.is_finite()) {
            let found = self.sample_time_s;
            return Err(ExportError::form(
                "program",
                format!("found a sample time of {found} s, expected a positive one"),
            ));
        }
        let names = self.inputs.iter().map(|i| &i.name).chain(self.outputs.iter().map(|o| &o.name));
        let names: Vec<&String> = names.collect();
        for (k, name) in names.iter().enumerate() {
            if !is_identifier(name) || names[..k].contains(name) {
                return Err(ExportError::form(
                    name,
                    "expected a name of letters, digits and underscores that is used once",
                ));
            }
        }
        for (k, node) in self.nodes.iter().enumerate() {
            let fault = |reason: String| Err(ExportError::form(&node.name, reason));
            if !is_identifier(&node.name) || self.nodes[..k].iter().any(|o| o.name == node.name) {
                return fault("expected a name of letters, digits and underscores that is used once".into());
            }
            if let Some(r) = node.op.reads().into_iter().find(|r| *r >= k) {
                return fault(format!("node {k} reads node {r}, expected one before it (or a delay)"));
            }
            self.check_op(k, &node.op, characteristics).or_else(fault)?;
        }
        if let Some(o) = self.outputs.iter().find(|o| o.node >= self.nodes.len()) {
            return Err(ExportError::form(
                &o.name,
                format!("found node {}, expected one of {}", o.node, self.nodes.len()),
            ));
        }
        match self.used().iter().position(|u| !u) {
            Some(k) => Err(ExportError::form(&self.nodes[k].name, "no output uses this node")),
            None => Ok(()),
        }
    }

    /// Which nodes reach an output, delays included.
    fn used(&self) -> Vec<bool> {
        let mut used = vec![false; self.nodes.len()];
        let mut open: Vec<NodeId> = self.outputs.iter().map(|o| o.node).collect();
        while let Some(k) = open.pop() {
            if !std::mem::replace(&mut used[k], true) {
                open.extend(self.nodes[k].op.reads());
                if let Op::Delay { of, .. } = self.nodes[k].op {
                    open.push(of);
                }
            }
        }
        used
    }

    fn check_op(&self, k: usize, op: &Op, characteristics: &[Characteristic]) -> Result<(), String> {
        match op {
            Op::Input(i) if *i >= self.inputs.len() => {
                Err(format!("found input {i} of {}", self.inputs.len()))
            }
            Op::Delay { of, samples, start } => {
                let twice = self.lines().iter().any(|l| l.of == *of && l.start != *start);
                match () {
                    () if *of >= self.nodes.len() => {
                        Err(format!("found node {of}, expected one of {}", self.nodes.len()))
                    }
                    () if *samples == 0 || *samples > 100_000 => {
                        Err(format!("found a delay of {samples} samples"))
                    }
                    () if *start == Start::First && *of >= k => {
                        Err("a delay of a later node needs a number to start from".into())
                    }
                    () if twice => Err("two delays of one node start differently".into()),
                    () => Ok(()),
                }
            }
            Op::Clamp { lower, upper, .. } if !(lower <= upper) => {
                Err(format!("found the limits {lower} and {upper}, expected lower <= upper"))
            }
            Op::Lag { tau: Tau::Fixed(t), .. } if !(*t >= 0.0 && t.is_finite()) => {
                Err(format!("found a time constant of {t} s"))
            }
            Op::Polynomial { terms } if terms.is_empty() => {
                Err("found no term, expected at least one".into())
            }
            Op::Polynomial { terms }
                if terms.iter().flat_map(|t| &t.factors).any(|f| f.power == 0 || f.power > 20) =>
            {
                Err("found a power outside 1 to 20".into())
            }
            Op::Network { inputs, layers } => {
                let mut width = inputs.len();
                for (l, layer) in layers.iter().enumerate() {
                    let rows = layer.offsets.len();
                    if rows == 0 || layer.weights.len() != rows * width {
                        return Err(format!(
                            "layer {} has {} weights, expected {rows} x {width}",
                            l + 1,
                            layer.weights.len()
                        ));
                    }
                    width = rows;
                }
                if width == 1 && !layers.is_empty() {
                    Ok(())
                } else {
                    Err("the last layer must have one neuron".into())
                }
            }
            Op::Lookup { characteristic, inputs } => {
                let found = characteristics.iter().find(|c| c.name == *characteristic);
                let c = found.ok_or_else(|| format!("found no characteristic `{characteristic}`"))?;
                match c.axes.len() {
                    n if n != inputs.len() => Err(format!("found {} inputs for {n} axes", inputs.len())),
                    1 | 2 => Ok(()),
                    n => Err(format!("found {n} axes, expected 1 or 2")),
                }
            }
            _ => Ok(()),
        }
    }
}
