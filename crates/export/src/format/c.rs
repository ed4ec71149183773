//! C99 for ECUs: look-ups and one step of a program, in `float` or `double`.
//!
//! No allocation, no recursion, no variable-length arrays, one return a function, no comparison of floats for equality.
//! Tables and coefficients are `extern const`, so that calibration tools find them; axes that are shared are searched
//! once a step. With `-ffp-contract=off` the `double` code is bit-equal to [`crate::evaluate`] but for the functions of
//! the C library.

use std::fmt::Write;

use dynocal_numerics::registry::MemberDoc;

use crate::characteristic::{Characteristic, identifier};
use crate::error::ExportError;
use crate::format::c_program;
use crate::format::{Export, Holds, Keys, OutFile, PRECISION, Precision};
use crate::package::{Extrapolation, Package, ascii};
use crate::program::Program;

/// Row of the table of exports.
pub const EXPORT: Export = Export {
    doc: MemberDoc {
        name: "c",
        what: "C99 source: look-ups and one step of the program",
        params: &[PRECISION],
    },
    holds: &[Holds::Characteristics, Holds::Programs],
    ecu_names: false,
    write: |package, keys| {
        let code = Code::new(package, keys.precision)?;
        Ok(vec![file(&code, "h", code.header()), file(&code, "c", code.source())])
    },
    read: None,
};

fn file(code: &Code, ending: &str, text: String) -> OutFile {
    OutFile { name: format!("{}.{ending}", code.prefix), bytes: text.into_bytes() }
}

/// Text of the header and the source, for other formats that carry the code.
pub(crate) fn sources(package: &Package, keys: &Keys) -> Result<Vec<OutFile>, ExportError> {
    (EXPORT.write)(package, keys)
}

/// What the generator knows of one package.
pub(crate) struct Code<'a> {
    pub(crate) package: &'a Package,
    pub(crate) precision: Precision,
    /// Name of everything that is not a characteristic.
    pub(crate) prefix: String,
}

/// Name of the array of breakpoints of axis `k` of a characteristic.
pub(crate) fn axis_name(c: &Characteristic, k: usize) -> String {
    let axis = &c.axes[k];
    if axis.shared {
        format!("{}_points", identifier(&axis.name))
    } else {
        format!("{}_bp_{}", c.name, ["x", "y"][k.min(1)])
    }
}

impl<'a> Code<'a> {
    pub(crate) fn new(package: &'a Package, precision: Precision) -> Result<Self, ExportError> {
        if let Some(c) = package.characteristics.iter().find(|c| c.axes.len() > 2) {
            return Err(ExportError::Unfit {
                format: "c",
                what: c.name.clone(),
                reason: format!("{} axes, expected at most 2", c.axes.len()),
            });
        }
        Ok(Self { package, precision, prefix: identifier(&package.name) })
    }

    /// Name of the floating-point type.
    pub(crate) fn real(&self) -> String {
        format!("{}_real_T", self.prefix)
    }

    /// A literal that reads back to the same bits.
    pub(crate) fn literal(&self, x: f64) -> String {
        match self.precision {
            Precision::Float => format!("{:?}F", x as f32),
            Precision::Double => format!("{x:?}"),
        }
    }

    /// Name of a function of the C library.
    pub(crate) fn library(&self, name: &str) -> String {
        if self.precision == Precision::Float { format!("{name}f") } else { name.into() }
    }

    /// Comment on top: what, from where, how to compile.
    fn head(&self) -> String {
        let edge = match self.package.extrapolation {
            Extrapolation::Clip => "held at the edges",
            Extrapolation::Linear => "continued linearly beyond the edges",
        };
        let mut out =
            format!("/* {}: {}\n", self.prefix, ascii(&self.package.description).replace("*/", "* /"));
        self.package.provenance.lines().iter().for_each(|l| {
            let _ = writeln!(out, " * {l}");
        });
        if self.tables().next().is_some() {
            let _ = writeln!(
                out,
                " * Look-ups: binary search, linear interpolation, {edge}; x fastest in tables. A NaN takes the first breakpoint."
            );
        }
        if self.package.program.as_ref().is_some_and(Program::remembers) {
            let _ = writeln!(
                out,
                " * A NaN input on which the program does not hold stays in the delayed values until {}_init: check inputs before the step.",
                self.prefix
            );
        }
        out.push_str(" * C99; compile with -ffp-contract=off for equal bits. */\n");
        out
    }

    /// Characteristics with axes.
    pub(crate) fn tables(&self) -> impl Iterator<Item = &'a Characteristic> {
        self.package.characteristics.iter().filter(|c| !c.axes.is_empty())
    }

    /// Axis arrays, each once: name, points, comment.
    fn axes(&self) -> Vec<(String, &'a [f64], String)> {
        let mut out: Vec<(String, &[f64], String)> = Vec::new();
        for c in self.tables() {
            for (k, axis) in c.axes.iter().enumerate() {
                let name = axis_name(c, k);
                if !out.iter().any(|o| o.0 == name) {
                    out.push((name, &axis.points, format!("{} [{}]", ascii(&axis.input), ascii(&axis.unit))));
                }
            }
        }
        out
    }

    fn header(&self) -> String {
        let (p, real) = (&self.prefix, self.real());
        let guard = format!("{}_H", p.to_uppercase());
        let mut h = self.head();
        let _ = writeln!(h, "#ifndef {guard}\n#define {guard}\n\n#include <stdint.h>\n");
        let kind = if self.precision == Precision::Float { "float" } else { "double" };
        let _ = writeln!(h, "typedef {kind} {real};\n");
        for (name, points, what) in self.axes() {
            let _ = writeln!(h, "extern const {real} {name}[{}]; /* {what} */", points.len());
        }
        for c in &self.package.characteristics {
            let what = format!("{} [{}]", ascii(&c.description), ascii(&c.unit)).replace("*/", "* /");
            if c.axes.is_empty() && c.values.len() == 1 {
                let _ = writeln!(h, "extern const {real} {}; /* {what} */", c.name);
            } else {
                let _ =
                    writeln!(h, "extern const {real} {}[{}]; /* {what} */", values_name(c), c.values.len());
            }
        }
        for c in self.tables() {
            let _ = writeln!(h, "\n{};", self.lookup_signature(c));
        }
        h.push_str(&c_program::declarations(self));
        let _ = writeln!(h, "\n#endif");
        h
    }

    fn lookup_signature(&self, c: &Characteristic) -> String {
        let real = self.real();
        let arguments: Vec<String> =
            c.axes.iter().enumerate().map(|(k, a)| format!("{real} {}", argument(&a.input, k))).collect();
        format!("{real} {}_lookup({})", c.name, arguments.join(", "))
    }

    /// An array definition, eight numbers a line.
    pub(crate) fn array(&self, name: &str, values: &[f64], kind: &str) -> String {
        let lines: Vec<String> = values
            .chunks(8)
            .map(|c| c.iter().map(|v| self.literal(*v)).collect::<Vec<_>>().join(", "))
            .collect();
        format!(
            "{kind}const {} {name}[{}] = {{\n    {}\n}};\n",
            self.real(),
            values.len(),
            lines.join(",\n    ")
        )
    }

    fn source(&self) -> String {
        let p = &self.prefix;
        let mut s = self.head();
        let _ = writeln!(s, "#include \"{p}.h\"");
        if c_program::needs_math(self) {
            s.push_str("#include <math.h>\n");
        }
        s.push('\n');
        for (name, points, _) in self.axes() {
            s.push_str(&self.array(&name, points, ""));
        }
        for c in &self.package.characteristics {
            if c.axes.is_empty() && c.values.len() == 1 {
                let _ = writeln!(s, "const {} {} = {};", self.real(), c.name, self.literal(c.values[0]));
            } else {
                s.push_str(&self.array(&values_name(c), &c.values, ""));
            }
        }
        s.push_str(&self.helpers());
        self.tables().for_each(|c| s.push_str(&self.lookup_function(c)));
        s.push_str(&c_program::definitions(self));
        s
    }

    /// The static functions that are used.
    fn helpers(&self) -> String {
        let real = self.real();
        let (zero, one) = (self.literal(0.0), self.literal(1.0));
        let linear = self.package.extrapolation == Extrapolation::Linear;
        let mut s = String::new();
        if self.tables().next().is_some() {
            let above = if linear { "(u - bp[n - 2U]) / (bp[n - 1U] - bp[n - 2U])".to_string() } else { one };
            let below = if linear {
                "    } else if (u <= bp[0]) {\n        f = (u - bp[0]) / (bp[1] - bp[0]);\n".to_string()
            } else {
                String::new()
            };
            let _ = write!(
                s,
                "\n/* Interval and fraction of u on n breakpoints. */\n\
static uint32_t prelookup({real} u, const {real} bp[], uint32_t n, {real} *frac)\n{{\n\
    uint32_t lo = 0U;\n    {real} f = {zero};\n\
    if (u >= bp[n - 1U]) {{\n        lo = n - 2U;\n        f = {above};\n\
    }} else if (u > bp[0]) {{\n        uint32_t hi = n - 1U;\n\
        while ((hi - lo) > 1U) {{\n            const uint32_t mid = (lo + hi) >> 1U;\n\
            if (u < bp[mid]) {{\n                hi = mid;\n            }} else {{\n                lo = mid;\n            }}\n        }}\n\
        f = (u - bp[lo]) / (bp[lo + 1U] - bp[lo]);\n\
{below}    }} else {{\n        /* at or below the first breakpoint, or NaN */\n    }}\n\
    *frac = f;\n    return lo;\n}}\n"
            );
        }
        if self.tables().any(|c| c.axes.len() == 1) {
            let _ = write!(
                s,
                "\nstatic {real} interpolate1(const {real} table[], uint32_t i, {real} f)\n{{\n\
    return table[i] + (f * (table[i + 1U] - table[i]));\n}}\n"
            );
        }
        if self.tables().any(|c| c.axes.len() == 2) {
            let _ = write!(
                s,
                "\nstatic {real} interpolate2(const {real} table[], uint32_t nx, uint32_t i, {real} fx, uint32_t j, {real} fy)\n{{\n\
    const uint32_t k = (j * nx) + i;\n\
    const {real} a = table[k] + (fx * (table[k + 1U] - table[k]));\n\
    const {real} b = table[k + nx] + (fx * (table[k + nx + 1U] - table[k + nx]));\n\
    return a + (fy * (b - a));\n}}\n"
            );
        }
        s
    }

    fn lookup_function(&self, c: &Characteristic) -> String {
        let real = self.real();
        let mut s = format!("\n{}\n{{\n", self.lookup_signature(c));
        for (k, axis) in c.axes.iter().enumerate() {
            let _ = writeln!(s, "    {real} f{k};");
            let (bp, n) = (axis_name(c, k), axis.points.len());
            let _ = writeln!(
                s,
                "    const uint32_t i{k} = prelookup({}, {bp}, {n}U, &f{k});",
                argument(&axis.input, k)
            );
        }
        let table = values_name(c);
        let _ = if c.axes.len() == 1 {
            writeln!(s, "    return interpolate1({table}, i0, f0);\n}}")
        } else {
            writeln!(s, "    return interpolate2({table}, {}U, i0, f0, i1, f1);\n}}", c.axes[0].points.len())
        };
        s
    }
}

/// Name of the array of values.
pub(crate) fn values_name(c: &Characteristic) -> String {
    if c.axes.is_empty() && c.values.len() == 1 { c.name.clone() } else { format!("{}_table", c.name) }
}

fn argument(input: &str, k: usize) -> String {
    if input.is_empty() {
        format!("u{k}")
    } else {
        format!("{}_{}", identifier(input).to_lowercase(), ["x", "y"][k.min(1)])
    }
}
