//! ONNX, opset 17: one step of a program, and its free run as a `Scan` over the inputs.
//!
//! `NAME_step.onnx` takes `phi` (rows x regressors; the columns are named in the metadata) and gives `y`. In
//! `NAME_free_run.onnx` the delay lines are states: it takes them and `u` (samples x 1 x inputs) and gives the lines at
//! the end and `y` (samples x 1 x outputs). Numbers are 32-bit.

use dynocal_numerics::registry::MemberDoc;

use crate::characteristic::identifier;
use crate::error::ExportError;
use crate::format::protobuf::Message;
use crate::format::{Export, Holds, OutFile};
use crate::package::Package;
use crate::program::{Layer, Op, Program, Shape};

/// Row of the table of exports.
pub const EXPORT: Export = Export {
    doc: MemberDoc {
        name: "onnx",
        what: "ONNX of networks and polynomials: one step and free run",
        params: &[],
    },
    holds: &[Holds::Networks],
    ecu_names: false,
    write: |package, _| {
        let Some(p) = &package.program else {
            return Err(ExportError::form(&package.name, "found no program"));
        };
        let name = identifier(&package.name);
        let file = |kind: &str, m: Message| OutFile { name: format!("{name}_{kind}.onnx"), bytes: m.0 };
        Ok(vec![file("step", step(package, p)?), file("free_run", free_run(package, p)?)])
    },
    read: None,
};

/// A graph while it is written.
#[derive(Default)]
struct Graph {
    nodes: Vec<Message>,
    initializers: Vec<Message>,
    constants: usize,
}

fn attribute_int(name: &str, x: i64) -> Message {
    Message::default().text(1, name).int(3, x).int(20, 2)
}

fn value_info(name: &str, dims: &[Option<i64>]) -> Message {
    let dims: Vec<Message> = dims
        .iter()
        .map(|d| match d {
            Some(n) => Message::default().int(1, *n),
            None => Message::default().text(2, "n"),
        })
        .collect();
    let tensor = Message::default().int(1, 1).message(2, &Message::default().messages(1, &dims));
    Message::default().text(1, name).message(2, &Message::default().message(1, &tensor))
}

impl Graph {
    fn op(&mut self, kind: &str, inputs: &[&str], output: &str, attributes: &[Message]) {
        let node = inputs.iter().fold(Message::default(), |m, i| m.text(1, i));
        self.nodes.push(node.text(2, output).text(3, output).text(4, kind).messages(5, attributes));
    }

    /// A constant tensor of floats.
    fn floats(&mut self, dims: &[i64], values: &[f64]) -> String {
        let name = format!("c{}", self.constants);
        self.constants += 1;
        let raw: Vec<u8> = values.iter().flat_map(|v| (*v as f32).to_le_bytes()).collect();
        let tensor = dims.iter().fold(Message::default(), |m, d| m.int(1, *d));
        self.initializers.push(tensor.int(2, 1).text(8, &name).bytes(9, &raw));
        name
    }

    fn scalar(&mut self, x: f64) -> String {
        self.floats(&[1, 1], &[x])
    }

    /// Column `k` of `matrix`, as a matrix of one column.
    fn column(&mut self, matrix: &str, k: usize, output: &str) {
        let name = format!("c{}", self.constants);
        self.constants += 1;
        let raw = (k as i64).to_le_bytes();
        self.initializers.push(Message::default().int(1, 1).int(2, 7).text(8, &name).bytes(9, &raw));
        self.op("Gather", &[matrix, &name], output, &[attribute_int("axis", 1)]);
    }

    fn message(self, name: &str, inputs: &[Message], outputs: &[Message]) -> Message {
        Message::default()
            .messages(1, &self.nodes)
            .text(2, name)
            .messages(5, &self.initializers)
            .messages(11, inputs)
            .messages(12, outputs)
    }

    /// Node `k`, whose leaves are there already, as a matrix of one column called `n{k}`.
    fn node(&mut self, k: usize, name: &str, op: &Op) -> Result<(), ExportError> {
        let out = format!("n{k}");
        let n = |i: &usize| format!("n{i}");
        match op {
            Op::Input(_) | Op::Delay { .. } => {}
            Op::Constant(x) => {
                let c = self.scalar(*x);
                self.op("Identity", &[&c], &out, &[]);
            }
            Op::Scale { of, gain, offset } => {
                let (g, o, part) = (self.scalar(*gain), self.scalar(*offset), format!("n{k}_scaled"));
                self.op("Mul", &[&n(of), &g], &part, &[]);
                self.op("Add", &[&part, &o], &out, &[]);
            }
            Op::Difference { a, b } => self.op("Sub", &[&n(a), &n(b)], &out, &[]),
            Op::Reciprocal { of, numerator } => {
                let c = self.scalar(*numerator);
                self.op("Div", &[&c, &n(of)], &out, &[]);
            }
            Op::Clamp { of, lower, upper } => {
                let (l, u, part) = (self.scalar(*lower), self.scalar(*upper), format!("n{k}_low"));
                self.op("Max", &[&n(of), &l], &part, &[]);
                self.op("Min", &[&part, &u], &out, &[]);
            }
            Op::Polynomial { terms } => {
                let mut sum = String::new();
                for (t, term) in terms.iter().enumerate() {
                    let mut product = self.scalar(term.coefficient);
                    for (i, f) in
                        term.factors.iter().flat_map(|f| (0..f.power).map(move |_| f.node)).enumerate()
                    {
                        let next = format!("n{k}_t{t}_{i}");
                        self.op("Mul", &[&product, &n(&f)], &next, &[]);
                        product = next;
                    }
                    if t == 0 {
                        sum = product;
                    } else {
                        let next = format!("n{k}_s{t}");
                        self.op("Add", &[&sum, &product], &next, &[]);
                        sum = next;
                    }
                }
                self.op("Identity", &[&sum], &out, &[]);
            }
            Op::Function { of, shape } => self.shape(*shape, &n(of), &out),
            Op::Network { inputs, layers } => self.network(k, inputs, layers),
            Op::Lag { .. } | Op::Lookup { .. } => {
                let what = name.to_string();
                let reason = "lags and look-ups are not written; use c, fmu2 or python".into();
                return Err(ExportError::Unfit { format: "onnx", what, reason });
            }
        }
        Ok(())
    }

    fn shape(&mut self, shape: Shape, x: &str, out: &str) {
        let kind = match shape {
            Shape::Linear => "Identity",
            Shape::Tanh => "Tanh",
            Shape::Sigmoid => "Sigmoid",
            Shape::Relu => "Relu",
            Shape::Softplus => "Softplus",
            Shape::Abs => "Abs",
            Shape::Sqrt => {
                let part = format!("{out}_positive");
                self.op("Relu", &[x], &part, &[]);
                return self.op("Sqrt", &[&part], out, &[]);
            }
            Shape::Exp => "Exp",
            Shape::Asinh => "Asinh",
            Shape::Sin => "Sin",
            Shape::Cos => "Cos",
            Shape::Matern32 | Shape::Matern52 => return self.matern(shape == Shape::Matern52, x, out),
        };
        self.op(kind, &[x], out, &[]);
    }

    /// `(1 + a) exp(-a)`, or `(1 + a + a a/3) exp(-a)` with `second`.
    fn matern(&mut self, second: bool, x: &str, out: &str) {
        let part = |what: &str| format!("{out}_{what}");
        let (positive, scaled, a) = (part("positive"), part("scaled"), part("a"));
        let square = self.floats(&[1], &[if second { 5.0 } else { 3.0 }]);
        let one = self.floats(&[1], &[1.0]);
        self.op("Relu", &[x], &positive, &[]);
        self.op("Mul", &[&positive, &square], &scaled, &[]);
        self.op("Sqrt", &[&scaled], &a, &[]);
        let mut near = part("near");
        self.op("Add", &[&a, &one], &near, &[]);
        if second {
            let (third, own, bent, sum) =
                (self.floats(&[1], &[1.0 / 3.0]), part("square"), part("bent"), part("sum"));
            self.op("Mul", &[&a, &a], &own, &[]);
            self.op("Mul", &[&own, &third], &bent, &[]);
            self.op("Add", &[&near, &bent], &sum, &[]);
            near = sum;
        }
        let (minus, decay) = (part("minus"), part("decay"));
        self.op("Neg", &[&a], &minus, &[]);
        self.op("Exp", &[&minus], &decay, &[]);
        self.op("Mul", &[&near, &decay], out, &[]);
    }

    fn network(&mut self, k: usize, inputs: &[usize], layers: &[Layer]) {
        let names: Vec<String> = inputs.iter().map(|i| format!("n{i}")).collect();
        let names: Vec<&str> = names.iter().map(String::as_str).collect();
        let mut a = format!("n{k}_in");
        self.op("Concat", &names, &a, &[attribute_int("axis", 1)]);
        let mut width = inputs.len();
        for (l, layer) in layers.iter().enumerate() {
            let rows = layer.offsets.len();
            let w = self.floats(&[rows as i64, width as i64], &layer.weights);
            let b = self.floats(&[rows as i64], &layer.offsets);
            let (sum, next) = (format!("n{k}_sum{l}"), format!("n{k}_a{l}"));
            self.op("Gemm", &[&a, &w, &b], &sum, &[attribute_int("transB", 1)]);
            let next = if l + 1 == layers.len() { format!("n{k}") } else { next };
            self.shape(layer.activation, &sum, &next);
            (a, width) = (next, rows);
        }
    }
}

/// Names of the leaves: inputs, and delays in the form `speed(t-2)`.
fn leaves(p: &Program) -> Vec<(usize, String)> {
    let name = |k: usize| match &p.nodes[k].op {
        Op::Input(i) => p.inputs[*i].name.clone(),
        _ => p.outputs.iter().find(|o| o.node == k).map_or(p.nodes[k].name.clone(), |o| o.name.clone()),
    };
    let leaf = |(k, n): (usize, &crate::program::Node)| match &n.op {
        Op::Input(_) => Some((k, name(k))),
        Op::Delay { of, samples, .. } => Some((k, format!("{}(t-{samples})", name(*of)))),
        _ => None,
    };
    p.nodes.iter().enumerate().filter_map(leaf).collect()
}

fn model(package: &Package, p: &Program, graph: &Message, extra: &[(&str, String)]) -> Message {
    let entry = |k: &str, v: &str| Message::default().text(1, k).text(2, v);
    let outputs: Vec<&str> = p.outputs.iter().map(|o| o.name.as_str()).collect();
    let mut meta = vec![
        entry("sample_time_s", &format!("{}", p.sample_time_s)),
        entry("outputs", &outputs.join(",")),
        entry("provenance", &package.provenance.lines().join("; ")),
    ];
    meta.extend(extra.iter().map(|(k, v)| entry(k, v)));
    Message::default()
        .int(1, 8)
        .text(2, "dynocal")
        .text(3, &package.provenance.version)
        .message(7, graph)
        .message(8, &Message::default().text(1, "").int(2, 17))
        .messages(14, &meta)
}

fn step(package: &Package, p: &Program) -> Result<Message, ExportError> {
    // A leaf that only feeds a delay line is no regressor of one step.
    let read: Vec<usize> =
        p.nodes.iter().flat_map(|n| n.op.reads()).chain(p.outputs.iter().map(|o| o.node)).collect();
    let leaves: Vec<(usize, String)> = leaves(p).into_iter().filter(|(k, _)| read.contains(k)).collect();
    let mut g = Graph::default();
    for (column, (k, _)) in leaves.iter().enumerate() {
        g.column("phi", column, &format!("n{k}"));
    }
    for (k, node) in p.nodes.iter().enumerate() {
        g.node(k, &node.name, &node.op)?;
    }
    let outputs: Vec<String> = p.outputs.iter().map(|o| format!("n{}", o.node)).collect();
    let outputs: Vec<&str> = outputs.iter().map(String::as_str).collect();
    g.op("Concat", &outputs, "y", &[attribute_int("axis", 1)]);
    let graph = g.message(
        "step",
        &[value_info("phi", &[None, Some(leaves.len() as i64)])],
        &[value_info("y", &[None, Some(outputs.len() as i64)])],
    );
    let names: Vec<String> = leaves.into_iter().map(|l| l.1).collect();
    Ok(model(package, p, &graph, &[("regressors", names.join(","))]))
}

fn free_run(package: &Package, p: &Program) -> Result<Message, ExportError> {
    let lines = p.lines();
    let mut g = Graph::default();
    for (k, node) in p.nodes.iter().enumerate() {
        match &node.op {
            Op::Input(i) => g.column("u_t", *i, &format!("n{k}")),
            Op::Delay { of, samples, .. } => g.column(&format!("line_{of}_t"), samples - 1, &format!("n{k}")),
            op => g.node(k, &node.name, op)?,
        }
    }
    let outputs: Vec<String> = p.outputs.iter().map(|o| format!("n{}", o.node)).collect();
    let outputs: Vec<&str> = outputs.iter().map(String::as_str).collect();
    g.op("Concat", &outputs, "y_t", &[attribute_int("axis", 1)]);
    let (mut inner_in, mut inner_out, mut outer_in, mut outer_out) =
        (Vec::new(), Vec::new(), Vec::new(), Vec::new());
    let (mut states, mut finals) = (Vec::new(), Vec::new());
    for l in &lines {
        let (of, n) = (l.of, l.length as i64);
        let (old, new) = (format!("line_{of}_t"), format!("line_{of}_next"));
        if l.length == 1 {
            g.op("Identity", &[&format!("n{of}")], &new, &[]);
        } else {
            let both = format!("line_{of}_both");
            g.op("Concat", &[&format!("n{of}"), &old], &both, &[attribute_int("axis", 1)]);
            let index = |g: &mut Graph, x: i64| {
                let name = format!("c{}", g.constants);
                g.constants += 1;
                g.initializers
                    .push(Message::default().int(1, 1).int(2, 7).text(8, &name).bytes(9, &x.to_le_bytes()));
                name
            };
            let (from, to, axis) = (index(&mut g, 0), index(&mut g, n), index(&mut g, 1));
            g.op("Slice", &[&both, &from, &to, &axis], &new, &[]);
        }
        inner_in.push(value_info(&old, &[Some(1), Some(n)]));
        inner_out.push(value_info(&new, &[Some(1), Some(n)]));
        outer_in.push(value_info(&format!("line_{of}"), &[Some(1), Some(n)]));
        outer_out.push(value_info(&format!("line_{of}_end"), &[Some(1), Some(n)]));
        states.push(format!("line_{of}"));
        finals.push(format!("line_{of}_end"));
    }
    let (m, q) = (p.inputs.len() as i64, outputs.len() as i64);
    inner_in.push(value_info("u_t", &[Some(1), Some(m)]));
    inner_out.push(value_info("y_t", &[Some(1), Some(q)]));
    outer_in.push(value_info("u", &[None, Some(1), Some(m)]));
    outer_out.push(value_info("y", &[None, Some(1), Some(q)]));
    let body = g.message("sample", &inner_in, &inner_out);
    let scan = states.iter().fold(Message::default(), |m, s| m.text(1, s)).text(1, "u");
    let scan = finals.iter().fold(scan, |m, s| m.text(2, s)).text(2, "y").text(3, "scan").text(4, "Scan");
    let scan = scan
        .message(5, &Message::default().text(1, "body").message(6, &body).int(20, 5))
        .message(5, &attribute_int("num_scan_inputs", 1));
    let graph = Message::default()
        .message(1, &scan)
        .text(2, "free_run")
        .messages(11, &outer_in)
        .messages(12, &outer_out);
    let inputs: Vec<&str> = p.inputs.iter().map(|i| i.name.as_str()).collect();
    let told: Vec<String> = lines.iter().map(|l| format!("line_{}: {}", l.of, p.nodes[l.of].name)).collect();
    Ok(model(package, p, &graph, &[("inputs", inputs.join(",")), ("states", told.join(","))]))
}
