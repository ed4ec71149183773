//! The step function of a program in C.

use std::fmt::Write;

use crate::evaluate::fixed_gain;
use crate::format::c::{Code, axis_name, values_name};
use crate::program::{Layer, NodeId, Op, Program, Shape, Start, Tau, Term};

/// Whether `math.h` is needed.
pub(crate) fn needs_math(code: &Code) -> bool {
    let Some(p) = &code.package.program else { return false };
    let plain = |s: &Shape| matches!(s, Shape::Linear | Shape::Relu | Shape::Abs);
    p.nodes.iter().any(|n| match &n.op {
        Op::Lag { tau: Tau::Node(_), .. } => true,
        Op::Function { shape, .. } => !plain(shape),
        Op::Network { layers, .. } => layers.iter().any(|l| !plain(&l.activation)),
        _ => false,
    })
}

/// State, step and its arrays for the header.
pub(crate) fn declarations(code: &Code) -> String {
    let Some(p) = &code.package.program else { return String::new() };
    let (prefix, real) = (&code.prefix, code.real());
    let upper = prefix.to_uppercase();
    let mut s = match p.remembers() {
        true => format!("\n#define {upper}_SAMPLE_TIME_S ({})\n", code.literal(p.sample_time_s)),
        // What knows of no past may be called at any time.
        false => "\n".into(),
    };
    for (k, i) in p.inputs.iter().enumerate() {
        let _ = writeln!(
            s,
            "#define {upper}_IN_{} ({k}U) /* [{}] {} */",
            i.name.to_uppercase(),
            i.unit,
            i.description.replace("*/", "")
        );
    }
    for (k, o) in p.outputs.iter().enumerate() {
        let _ = writeln!(
            s,
            "#define {upper}_OUT_{} ({k}U) /* [{}] {} */",
            o.name.to_uppercase(),
            o.unit,
            o.description.replace("*/", "")
        );
    }
    for node in &p.nodes {
        for (name, values) in arrays(code, &node.name, &node.op) {
            let _ = writeln!(s, "extern const {real} {name}[{}];", values.len());
        }
    }
    let _ = writeln!(
        s,
        "\n/* Delay lines and lags; set by {prefix}_init before the first step. */\ntypedef struct {{"
    );
    for line in p.lines() {
        let _ = writeln!(s, "    {real} line_{}[{}];", line.of, line.length);
    }
    for k in p.lags() {
        let _ = writeln!(s, "    {real} lag_{k};");
    }
    let _ = writeln!(s, "    uint8_t started;\n}} {prefix}_state_T;\n");
    let _ = writeln!(s, "void {prefix}_init({prefix}_state_T *s);");
    let _ = writeln!(
        s,
        "void {prefix}_step({prefix}_state_T *s, const {real} in[{}], {real} out[{}]);",
        p.inputs.len().max(1),
        p.outputs.len().max(1)
    );
    s.split('\n').map(crate::package::ascii).collect::<Vec<_>>().join("\n")
}

/// Constant arrays of a node: coefficients of a polynomial, weights and offsets of a network.
pub(crate) fn arrays(code: &Code, name: &str, op: &Op) -> Vec<(String, Vec<f64>)> {
    let prefix = &code.prefix;
    match op {
        Op::Polynomial { terms } => {
            vec![(format!("{prefix}_{name}_c"), terms.iter().map(|t| t.coefficient).collect())]
        }
        Op::Network { layers, .. } => layers
            .iter()
            .enumerate()
            .flat_map(|(l, layer)| {
                [
                    (format!("{prefix}_{name}_w{}", l + 1), layer.weights.clone()),
                    (format!("{prefix}_{name}_b{}", l + 1), layer.offsets.clone()),
                ]
            })
            .collect(),
        _ => Vec::new(),
    }
}

/// Arrays, init and step for the source.
pub(crate) fn definitions(code: &Code) -> String {
    let Some(p) = &code.package.program else { return String::new() };
    let prefix = &code.prefix;
    let mut s = String::from("\n");
    for node in &p.nodes {
        for (name, values) in arrays(code, &node.name, &node.op) {
            s.push_str(&code.array(&name, &values, ""));
        }
    }
    let zero = code.literal(0.0);
    let _ = writeln!(s, "\nvoid {prefix}_init({prefix}_state_T *s)\n{{");
    for line in p.lines() {
        let start = if let Start::Value(v) = line.start { code.literal(v) } else { zero.clone() };
        fill(&mut s, line.of, line.length, &start, "    ");
    }
    p.lags().iter().for_each(|k| {
        let _ = writeln!(s, "    s->lag_{k} = {zero};");
    });
    let _ = writeln!(s, "    s->started = 0U;\n}}\n");
    let _ = writeln!(
        s,
        "void {prefix}_step({prefix}_state_T *s, const {r} in[{}], {r} out[{}])\n{{",
        p.inputs.len().max(1),
        p.outputs.len().max(1),
        r = code.real()
    );
    if p.inputs.is_empty() {
        s.push_str("    (void)in;\n");
    }
    let mut step = Step { code, program: p, text: String::new(), filled: Vec::new(), searched: Vec::new() };
    (0..p.nodes.len()).for_each(|k| step.node(k));
    s.push_str(&step.text);
    for (k, o) in p.outputs.iter().enumerate() {
        let _ = writeln!(s, "    out[{k}] = n{};", o.node);
    }
    for line in p.lines() {
        let of = line.of;
        if line.length > 1 {
            let _ = writeln!(
                s,
                "    for (uint32_t k = {}U; k > 0U; k--) {{\n        s->line_{of}[k] = s->line_{of}[k - 1U];\n    }}",
                line.length - 1
            );
        }
        let _ = writeln!(s, "    s->line_{of}[0] = n{of};");
    }
    s.push_str("    s->started = 1U;\n}\n");
    s
}

fn fill(s: &mut String, of: NodeId, length: usize, value: &str, indent: &str) {
    let _ = writeln!(
        s,
        "{indent}for (uint32_t k = 0U; k < {length}U; k++) {{\n{indent}    s->line_{of}[k] = {value};\n{indent}}}"
    );
}

/// The body of the step while it is written.
struct Step<'a> {
    code: &'a Code<'a>,
    program: &'a Program,
    text: String,
    /// Lines that are filled with their first value already.
    filled: Vec<NodeId>,
    /// (axis array, node) pairs that are searched already.
    searched: Vec<(String, NodeId)>,
}

impl Step<'_> {
    fn node(&mut self, k: NodeId) {
        let node = &self.program.nodes[k];
        let (r, l) = (self.code.real(), |x: f64| self.code.literal(x));
        let simple = match &node.op {
            Op::Input(i) => format!("in[{i}]"),
            Op::Constant(x) => l(*x),
            Op::Delay { of, samples, start } => {
                if *start == Start::First && !self.filled.contains(of) {
                    self.filled.push(*of);
                    let length = self.program.lines().iter().find(|l| l.of == *of).map_or(1, |l| l.length);
                    self.text.push_str("    if (s->started == 0U) {\n");
                    fill(&mut self.text, *of, length, &format!("n{of}"), "        ");
                    self.text.push_str("    }\n");
                }
                format!("s->line_{of}[{}]", samples - 1)
            }
            Op::Scale { of, gain, offset } => {
                format!("({} * n{of}) + {}", signed(&l(*gain)), signed(&l(*offset)))
            }
            Op::Difference { a, b } => format!("n{a} - n{b}"),
            Op::Reciprocal { of, numerator } => format!("{} / n{of}", signed(&l(*numerator))),
            Op::Clamp { of, lower, upper } => {
                let (lower, upper) = (signed(&l(*lower)), signed(&l(*upper)));
                format!("(n{of} > {lower}) ? ((n{of} < {upper}) ? n{of} : {upper}) : {lower}")
            }
            Op::Function { of, shape } => self.shape(*shape, &format!("n{of}")),
            Op::Lag { of, tau } => return self.lag(k, *of, tau),
            Op::Polynomial { terms } => return self.polynomial(k, terms),
            Op::Network { inputs, layers } => return self.network(k, inputs, layers),
            Op::Lookup { characteristic, inputs } => self.lookup(characteristic, inputs),
        };
        let _ = writeln!(self.text, "    const {r} n{k} = {simple}; /* {} */", node.name);
    }

    fn lag(&mut self, k: NodeId, of: NodeId, tau: &Tau) {
        let (r, name) = (self.code.real(), &self.program.nodes[k].name);
        let dt = self.program.sample_time_s;
        let gain = match tau {
            Tau::Fixed(t) => self.code.literal(fixed_gain(dt, *t)),
            Tau::Node(t) => format!(
                "(n{t} > {zero}) ? ({one} - {exp}(({zero} - {dt}) / n{t})) : {one}",
                zero = self.code.literal(0.0),
                one = self.code.literal(1.0),
                exp = self.code.library("exp"),
                dt = self.code.literal(dt)
            ),
        };
        let _ = writeln!(self.text, "    const {r} g{k} = {gain};");
        let _ = writeln!(self.text, "    const {r} x{k} = (s->started == 0U) ? n{of} : s->lag_{k};");
        let _ = writeln!(self.text, "    const {r} n{k} = x{k} + (g{k} * (n{of} - x{k})); /* {name} */");
        let _ = writeln!(self.text, "    s->lag_{k} = n{k};");
    }

    fn polynomial(&mut self, k: NodeId, terms: &[Term]) {
        let name = &self.program.nodes[k].name;
        let array = format!("{}_{name}_c", self.code.prefix);
        let product = |i: usize, t: &Term| {
            let factors = t.factors.iter().flat_map(|f| (0..f.power).map(move |_| format!(" * n{}", f.node)));
            format!("{array}[{i}]{}", factors.collect::<String>())
        };
        for (i, t) in terms.iter().enumerate() {
            let _ = if i == 0 {
                writeln!(self.text, "    {} n{k} = {}; /* {name} */", self.code.real(), product(i, t))
            } else {
                writeln!(self.text, "    n{k} = n{k} + ({});", product(i, t))
            };
        }
    }

    fn network(&mut self, k: NodeId, inputs: &[NodeId], layers: &[Layer]) {
        let (r, name) = (self.code.real(), &self.program.nodes[k].name);
        let first: Vec<String> = inputs.iter().map(|i| format!("n{i}")).collect();
        let _ = writeln!(self.text, "    const {r} a{k}_0[{}] = {{ {} }};", inputs.len(), first.join(", "));
        let mut width = inputs.len();
        for (l, layer) in layers.iter().enumerate() {
            let rows = layer.offsets.len();
            let array = |kind: &str| format!("{}_{name}_{kind}{}", self.code.prefix, l + 1);
            let value = self.shape(layer.activation, "sum");
            let _ = write!(
                self.text,
                "    {r} a{k}_{}[{rows}];\n    for (uint32_t r = 0U; r < {rows}U; r++) {{\n\
        {r} sum = {b}[r];\n        for (uint32_t c = 0U; c < {width}U; c++) {{\n\
            sum = sum + ({w}[(r * {width}U) + c] * a{k}_{l}[c]);\n        }}\n        a{k}_{}[r] = {value};\n    }}\n",
                l + 1,
                l + 1,
                b = array("b"),
                w = array("w")
            );
            width = rows;
        }
        let _ = writeln!(self.text, "    const {r} n{k} = a{k}_{}[0]; /* {name} */", layers.len());
    }

    /// Searches each axis once for each node, then interpolates.
    fn lookup(&mut self, characteristic: &str, inputs: &[NodeId]) -> String {
        let Some(c) = self.code.package.characteristics.iter().find(|c| c.name == characteristic) else {
            return self.code.literal(0.0);
        };
        let mut places = Vec::new();
        for (k, (axis, input)) in c.axes.iter().zip(inputs).enumerate() {
            let key = (axis_name(c, k), *input);
            let place = self.searched.iter().position(|s| *s == key).unwrap_or_else(|| {
                let at = self.searched.len();
                let (bp, n) = (&key.0, axis.points.len());
                let _ = writeln!(self.text, "    {} f_{at};", self.code.real());
                let _ = writeln!(
                    self.text,
                    "    const uint32_t i_{at} = prelookup(n{input}, {bp}, {n}U, &f_{at});"
                );
                self.searched.push(key.clone());
                at
            });
            places.push(place);
        }
        let table = values_name(c);
        match places[..] {
            [x] => format!("interpolate1({table}, i_{x}, f_{x})"),
            [x, y] => {
                format!("interpolate2({table}, {}U, i_{x}, f_{x}, i_{y}, f_{y})", c.axes[0].points.len())
            }
            _ => values_name(c),
        }
    }

    fn shape(&self, shape: Shape, x: &str) -> String {
        let c = |name: &str| self.code.library(name);
        let (zero, one) = (self.code.literal(0.0), self.code.literal(1.0));
        let positive = format!("(({x} > {zero}) ? {x} : {zero})");
        let size = format!("(({x} < {zero}) ? ({zero} - {x}) : {x})");
        match shape {
            Shape::Linear => x.into(),
            Shape::Tanh => format!("{}({x})", c("tanh")),
            Shape::Sigmoid => format!("{one} / ({one} + {}({zero} - {x}))", c("exp")),
            Shape::Relu => positive,
            Shape::Softplus => format!("{positive} + {}({}({zero} - {size}))", c("log1p"), c("exp")),
            Shape::Abs => size,
            Shape::Sqrt => format!("{}({positive})", c("sqrt")),
            Shape::Exp => format!("{}({x})", c("exp")),
            Shape::Asinh => format!("{}({x})", c("asinh")),
            Shape::Sin => format!("{}({x})", c("sin")),
            Shape::Cos => format!("{}({x})", c("cos")),
            Shape::Matern32 | Shape::Matern52 => {
                let five = shape == Shape::Matern52;
                let square = self.code.literal(if five { 5.0 } else { 3.0 });
                let a = format!("{}({square} * {positive})", c("sqrt"));
                let third = self.code.literal(3.0);
                let tail = if five { format!(" + (({a} * {a}) / {third})") } else { String::new() };
                format!("(({one} + {a}){tail}) * {}({zero} - {a})", c("exp"))
            }
        }
    }
}

/// A literal with parentheses where it has a sign.
fn signed(literal: &str) -> String {
    if literal.starts_with('-') { format!("({literal})") } else { literal.into() }
}
