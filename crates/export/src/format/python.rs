//! One readable Python file, NumPy only: characteristics as arrays, the program as a class.

use std::fmt::Write;

use dynocal_numerics::registry::MemberDoc;

use crate::characteristic::identifier;
use crate::evaluate::fixed_gain;
use crate::format::{Export, Holds, OutFile};
use crate::package::{Extrapolation, Package, ascii};
use crate::program::{Op, Program, Shape, Start, Tau};

/// Row of the table of exports.
pub const EXPORT: Export = Export {
    doc: MemberDoc { name: "python", what: "one Python file, NumPy only", params: &[] },
    holds: &[Holds::Characteristics, Holds::Programs],
    ecu_names: false,
    write: |package, _| {
        let name = identifier(&package.name).to_lowercase();
        Ok(vec![OutFile { name: format!("{name}.py"), bytes: text(package).into_bytes() }])
    },
    read: None,
};

fn list(v: &[f64]) -> String {
    format!("[{}]", v.iter().map(|x| format!("{x:?}")).collect::<Vec<_>>().join(", "))
}

fn quoted(text: &str) -> String {
    format!("\"{}\"", ascii(text).replace('\\', "/").replace('"', "'"))
}

fn text(package: &Package) -> String {
    let mut s = format!(
        "\"\"\"{}\n\n{}\n\"\"\"\nimport numpy as np\n\n",
        ascii(&package.description).replace('"', "'"),
        package.provenance.lines().join("\n")
    );
    s.push_str(match package.extrapolation {
        Extrapolation::Clip => HELPERS_CLIP,
        Extrapolation::Linear => HELPERS_LINEAR,
    });
    s.push_str(
        "\n\n# name: unit, axes (x first: input, unit, points), values (x fastest)\nCHARACTERISTICS = {\n",
    );
    for c in &package.characteristics {
        let axes: Vec<String> = c
            .axes
            .iter()
            .map(|a| format!("({}, {}, np.array({}))", quoted(&a.input), quoted(&a.unit), list(&a.points)))
            .collect();
        let _ = writeln!(
            s,
            "    \"{}\": ({}, [{}], np.array({})),",
            c.name,
            quoted(&c.unit),
            axes.join(", "),
            list(&c.values)
        );
    }
    s.push_str("}\n");
    if let Some(p) = &package.program {
        s.push_str(&class(&identifier(&package.name), p));
    }
    s
}

const HELPERS_CLIP: &str = "
def _place(points, u):
    \"\"\"Interval and fraction of u, held at the edges.\"\"\"
    if u >= points[-1]:
        return len(points) - 2, 1.0
    if not u > points[0]:
        return 0, 0.0
    k = int(np.searchsorted(points, u, side=\"right\")) - 1
    return k, (u - points[k]) / (points[k + 1] - points[k])
";

const HELPERS_LINEAR: &str = "
def _place(points, u):
    \"\"\"Interval and fraction of u, continued linearly beyond the edges.\"\"\"
    if u != u:
        return 0, 0.0
    k = min(max(int(np.searchsorted(points, u, side=\"right\")) - 1, 0), len(points) - 2)
    return k, (u - points[k]) / (points[k + 1] - points[k])
";

const LOOKUP: &str = "

def lookup(name, *u):
    \"\"\"Linear interpolation in a curve or map; x first.\"\"\"
    _, axes, v = CHARACTERISTICS[name]
    i, f = _place(axes[0][2], u[0])
    if len(axes) == 1:
        return v[i] + f * (v[i + 1] - v[i])
    j, g = _place(axes[1][2], u[1])
    n = len(axes[0][2])
    k = j * n + i
    a = v[k] + f * (v[k + 1] - v[k])
    b = v[k + n] + f * (v[k + n + 1] - v[k + n])
    return a + g * (b - a)
";

fn class(name: &str, p: &Program) -> String {
    let names = |v: Vec<&String>| v.iter().map(|n| format!("\"{n}\"")).collect::<Vec<_>>().join(", ");
    let mut s = String::from(LOOKUP);
    let _ = write!(
        s,
        "\n\nclass {name}:\n    \"\"\"One sample at a time: outputs = {name}().step(inputs), inputs in the order of INPUTS.\"\"\"\n\n    \
SAMPLE_TIME_S = {:?}\n    INPUTS = [{}]\n    OUTPUTS = [{}]\n\n    def __init__(self):\n        self.started = False\n",
        p.sample_time_s,
        names(p.inputs.iter().map(|i| &i.name).collect()),
        names(p.outputs.iter().map(|o| &o.name).collect()),
    );
    for line in p.lines() {
        let start = if let Start::Value(v) = line.start { v } else { 0.0 };
        let _ = writeln!(s, "        self.line_{} = [{start:?}] * {}", line.of, line.length);
    }
    p.lags().iter().for_each(|k| {
        let _ = writeln!(s, "        self.lag_{k} = 0.0");
    });
    let _ = writeln!(s, "\n    def step(self, u):");
    for (k, node) in p.nodes.iter().enumerate() {
        statement(&mut s, p, k, &node.op);
    }
    for line in p.lines() {
        let _ = writeln!(s, "        self.line_{of} = [n{of}] + self.line_{of}[:-1]", of = line.of);
    }
    let outputs: Vec<String> = p.outputs.iter().map(|o| format!("n{}", o.node)).collect();
    let _ = writeln!(s, "        self.started = True\n        return [{}]", outputs.join(", "));
    s
}

fn statement(s: &mut String, p: &Program, k: usize, op: &Op) {
    let value = match op {
        Op::Input(i) => format!("u[{i}]"),
        Op::Constant(x) => format!("{x:?}"),
        Op::Delay { of, samples, start } => {
            if *start == Start::First {
                let _ = writeln!(
                    s,
                    "        if not self.started:\n            self.line_{of} = [n{of}] * len(self.line_{of})"
                );
            }
            format!("self.line_{of}[{}]", samples - 1)
        }
        Op::Scale { of, gain, offset } => format!("({gain:?} * n{of}) + {offset:?}"),
        Op::Difference { a, b } => format!("n{a} - n{b}"),
        Op::Reciprocal { of, numerator } => format!("{numerator:?} / n{of}"),
        Op::Clamp { of, lower, upper } => {
            format!("(n{of} if n{of} < {upper:?} else {upper:?}) if n{of} > {lower:?} else {lower:?}")
        }
        Op::Lag { of, tau } => {
            let gain = match tau {
                Tau::Fixed(t) => format!("{:?}", fixed_gain(p.sample_time_s, *t)),
                Tau::Node(t) => format!("(1.0 - np.exp(-self.SAMPLE_TIME_S / n{t}) if n{t} > 0.0 else 1.0)"),
            };
            let _ = writeln!(s, "        x{k} = self.lag_{k} if self.started else n{of}");
            format!("self.lag_{k} = x{k} + {gain} * (n{of} - x{k})")
        }
        Op::Polynomial { terms } => {
            let term = |t: &crate::program::Term| {
                let f = t.factors.iter().flat_map(|f| (0..f.power).map(move |_| format!(" * n{}", f.node)));
                format!("({:?}{})", t.coefficient, f.collect::<String>())
            };
            terms.iter().map(term).collect::<Vec<_>>().join("\n               + ").replacen('(', "((", 1)
                + ")"
        }
        Op::Function { of, shape } => function(*shape, &format!("n{of}")),
        Op::Network { inputs, layers } => {
            let first: Vec<String> = inputs.iter().map(|i| format!("n{i}")).collect();
            let _ = writeln!(s, "        a = np.array([{}])", first.join(", "));
            for l in layers {
                let rows = l.offsets.len();
                let _ = writeln!(
                    s,
                    "        a = np.array({}).reshape({rows}, -1) @ a + np.array({})",
                    list(&l.weights),
                    list(&l.offsets)
                );
                let _ = writeln!(s, "        a = {}", function(l.activation, "a"));
            }
            "a[0]".into()
        }
        Op::Lookup { characteristic, inputs } => {
            let u: Vec<String> = inputs.iter().map(|i| format!("n{i}")).collect();
            format!("lookup(\"{characteristic}\", {})", u.join(", "))
        }
    };
    let _ = writeln!(s, "        n{k} = {value}  # {}", p.nodes[k].name);
}

fn function(shape: Shape, x: &str) -> String {
    match shape {
        Shape::Linear => x.into(),
        Shape::Tanh => format!("np.tanh({x})"),
        Shape::Sigmoid => format!("1.0 / (1.0 + np.exp(-{x}))"),
        Shape::Relu => format!("np.maximum({x}, 0.0)"),
        Shape::Softplus => format!("np.maximum({x}, 0.0) + np.log1p(np.exp(-np.abs({x})))"),
        Shape::Abs => format!("np.abs({x})"),
        Shape::Sqrt => format!("np.sqrt(np.maximum({x}, 0.0))"),
        Shape::Exp => format!("np.exp({x})"),
        Shape::Asinh => format!("np.arcsinh({x})"),
        Shape::Sin => format!("np.sin({x})"),
        Shape::Cos => format!("np.cos({x})"),
        Shape::Matern32 => {
            let a = format!("np.sqrt(3.0 * np.maximum({x}, 0.0))");
            format!("(1.0 + {a}) * np.exp(-{a})")
        }
        Shape::Matern52 => {
            let a = format!("np.sqrt(5.0 * np.maximum({x}, 0.0))");
            format!("(1.0 + {a} + {a} * {a} / 3.0) * np.exp(-{a})")
        }
    }
}
