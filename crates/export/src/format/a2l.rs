//! A2L (ASAP2 1.71): where the tables of the generated C lie, and names and limits of an ECU's own maps.
//!
//! Addresses are zero and every object carries a `SYMBOL_LINK` to its C array: the calibration tool fills addresses in
//! from the linker's map. `COLUMN_DIR` is the order of our tables, x fastest.

use std::fmt::Write;

use dynocal_numerics::interval::Interval;
use dynocal_numerics::registry::MemberDoc;

use crate::characteristic::{Axis, Characteristic};
use crate::error::ExportError;
use crate::format::c::{Code, axis_name, values_name};
use crate::format::c_program;
use crate::format::{Export, Holds, OutFile, PRECISION, Precision};
use crate::package::{Package, ascii};

/// Row of the table of exports.
pub const EXPORT: Export = Export {
    doc: MemberDoc {
        name: "a2l",
        what: "A2L of the tables in the generated C, to be merged and linked",
        params: &[PRECISION],
    },
    holds: &[Holds::Characteristics, Holds::Programs],
    ecu_names: false,
    write: |package, keys| {
        let code = Code::new(package, keys.precision)?;
        Ok(vec![OutFile { name: format!("{}.a2l", code.prefix), bytes: text(&code).into_bytes() }])
    },
    read: None,
};

struct Writer<'a> {
    code: &'a Code<'a>,
    units: Vec<String>,
    body: String,
}

fn quoted(text: &str) -> String {
    format!("\"{}\"", ascii(text).replace('\\', "/").replace('"', "'"))
}

fn text(code: &Code) -> String {
    let mut w = Writer { code, units: Vec::new(), body: String::new() };
    let mut axes: Vec<String> = Vec::new();
    for c in &code.package.characteristics {
        for (k, axis) in c.axes.iter().enumerate() {
            let name = axis_name(c, k);
            if !axes.contains(&name) {
                w.axis(&name, axis);
                axes.push(name);
            }
        }
        w.characteristic(c);
    }
    if let Some(p) = &code.package.program {
        for node in &p.nodes {
            for (name, values) in c_program::arrays(code, &node.name, &node.op) {
                w.block(&name, "coefficients", "-", &values, None);
            }
        }
    }
    w.whole()
}

impl Writer<'_> {
    fn method(&mut self, unit: &str) -> String {
        let k = self.units.iter().position(|u| u == unit).unwrap_or_else(|| {
            self.units.push(unit.to_string());
            self.units.len() - 1
        });
        format!("{}_CM_{}", self.code.prefix, k + 1)
    }

    fn layout(&self, kind: &str) -> String {
        format!("{}_RL_{kind}", self.code.prefix)
    }

    fn axis(&mut self, name: &str, axis: &Axis) {
        let Interval { lower, upper } = span(&axis.points, None);
        let method = self.method(&axis.unit);
        let _ = writeln!(
            self.body,
            "    /begin AXIS_PTS {name} {} 0x0 NO_INPUT_QUANTITY {} 0 {method} {} {lower:?} {upper:?}\n      SYMBOL_LINK \"{name}\" 0\n    /end AXIS_PTS",
            quoted(&axis.input),
            self.layout("AXIS"),
            axis.points.len()
        );
    }

    fn characteristic(&mut self, c: &Characteristic) {
        if c.axes.is_empty() {
            return self.block(&values_name(c), &c.description, &c.unit, &c.values, c.limits);
        }
        let kind = if c.axes.len() == 1 { "CURVE" } else { "MAP" };
        let Interval { lower, upper } = span(&c.values, c.limits);
        let method = self.method(&c.unit);
        let symbol = values_name(c);
        let _ = writeln!(
            self.body,
            "    /begin CHARACTERISTIC {} {} {kind} 0x0 {} 0 {method} {lower:?} {upper:?}\n      SYMBOL_LINK \"{symbol}\" 0",
            c.name,
            quoted(&c.description),
            self.layout("VALUES")
        );
        for (k, axis) in c.axes.iter().enumerate() {
            let Interval { lower, upper } = span(&axis.points, None);
            let method = self.method(&axis.unit);
            let _ = writeln!(
                self.body,
                "      /begin AXIS_DESCR COM_AXIS NO_INPUT_QUANTITY {method} {} {lower:?} {upper:?}\n        AXIS_PTS_REF {}\n      /end AXIS_DESCR",
                axis.points.len(),
                axis_name(c, k)
            );
        }
        let _ = writeln!(self.body, "    /end CHARACTERISTIC");
    }

    /// A scalar or a block of values.
    fn block(&mut self, name: &str, what: &str, unit: &str, values: &[f64], limits: Option<Interval>) {
        let Interval { lower, upper } = span(values, limits);
        let method = self.method(unit);
        let kind = if values.len() == 1 { "VALUE" } else { "VAL_BLK" };
        let _ = writeln!(
            self.body,
            "    /begin CHARACTERISTIC {name} {} {kind} 0x0 {} 0 {method} {lower:?} {upper:?}\n      SYMBOL_LINK \"{name}\" 0",
            quoted(what),
            self.layout("VALUES")
        );
        if values.len() > 1 {
            let _ = writeln!(self.body, "      MATRIX_DIM {}", values.len());
        }
        let _ = writeln!(self.body, "    /end CHARACTERISTIC");
    }

    fn whole(self) -> String {
        let (p, package) = (&self.code.prefix, self.code.package);
        let kind = if self.code.precision == Precision::Float { "FLOAT32_IEEE" } else { "FLOAT64_IEEE" };
        let mut s = format!("/* {} */\n", package.provenance.lines().join("\n   "));
        let _ = write!(
            s,
            "ASAP2_VERSION 1 71\n/begin PROJECT {p}_project {what}\n  /begin MODULE {p}_module {what}\n    /begin MOD_COMMON \"\"\n      \
BYTE_ORDER MSB_LAST\n      ALIGNMENT_BYTE 1\n      ALIGNMENT_WORD 2\n      ALIGNMENT_LONG 4\n      ALIGNMENT_INT64 8\n      \
ALIGNMENT_FLOAT32_IEEE 4\n      ALIGNMENT_FLOAT64_IEEE 8\n    /end MOD_COMMON\n    \
/begin RECORD_LAYOUT {axis}\n      AXIS_PTS_X 1 {kind} INDEX_INCR DIRECT\n    /end RECORD_LAYOUT\n    \
/begin RECORD_LAYOUT {values}\n      FNC_VALUES 1 {kind} COLUMN_DIR DIRECT\n    /end RECORD_LAYOUT\n",
            what = quoted(&package.description),
            axis = self.layout("AXIS"),
            values = self.layout("VALUES"),
        );
        for (k, unit) in self.units.iter().enumerate() {
            let _ = writeln!(
                s,
                "    /begin COMPU_METHOD {p}_CM_{} \"\" IDENTICAL \"%12.6\" {}\n    /end COMPU_METHOD",
                k + 1,
                quoted(unit)
            );
        }
        s.push_str(&self.body);
        s.push_str("  /end MODULE\n/end PROJECT\n");
        s
    }
}

/// Limits as given, else what the values span with a tenth of it beyond.
fn span(values: &[f64], limits: Option<Interval>) -> Interval {
    limits.unwrap_or_else(|| {
        let found = Interval::spanning(values.iter().copied());
        let room = 0.1 * found.width().max(found.upper.abs()).max(1e-9);
        Interval::new(found.lower - room, found.upper + room)
    })
}

/// What an A2L file says about one characteristic.
#[derive(Clone, Debug, PartialEq)]
pub struct Entry {
    /// Name.
    pub name: String,
    /// One line.
    pub description: String,
    /// `VALUE`, `CURVE`, `MAP`, ...
    pub kind: String,
    /// Unit of the values.
    pub unit: String,
    /// Least and greatest value allowed.
    pub limits: Interval,
    /// Axes, x first.
    pub axes: Vec<EntryAxis>,
}

/// An axis in an A2L file.
#[derive(Clone, Debug, PartialEq)]
pub struct EntryAxis {
    /// Name of the shared axis, empty for one of its own.
    pub shared: String,
    /// Measurement that enters; empty where there is none.
    pub input: String,
    /// Unit.
    pub unit: String,
    /// Most points.
    pub points: usize,
    /// Least and greatest point allowed.
    pub limits: Interval,
}

/// Reads names, units, limits and axes. References that lead nowhere and axes whose length differs from their points are
/// refused: the parser underneath finds the first, not the second.
///
/// # Errors
/// [`ExportError::Malformed`].
#[cfg(feature = "a2l")]
pub fn read(file: &str, bytes: &[u8]) -> Result<Vec<Entry>, ExportError> {
    let fail = |reason: String| ExportError::Malformed { file: file.into(), line: 0, reason };
    let encoding = dynocal_files::measurement::csv_dialect::guess_encoding(bytes);
    let text = dynocal_files::measurement::csv_dialect::decode(bytes, encoding);
    let (parsed, log) = a2lfile::load_from_string(&text, None, true).map_err(|e| fail(e.to_string()))?;
    if let Some(e) = log.into_iter().chain(parsed.check()).next() {
        return Err(fail(e.to_string()));
    }
    let mut out = Vec::new();
    for module in &parsed.project.module {
        let unit = |method: &str| {
            module
                .compu_method
                .iter()
                .find(|m| a2lfile::A2lObjectName::get_name(*m) == method)
                .map_or(String::new(), |m| m.unit.clone())
        };
        for c in &module.characteristic {
            let name = a2lfile::A2lObjectName::get_name(c).to_string();
            let mut axes = Vec::new();
            for d in &c.axis_descr {
                let shared = d.axis_pts_ref.as_ref().map_or(String::new(), |r| r.axis_points.clone());
                let points = usize::from(d.max_axis_points);
                let pts = module.axis_pts.iter().find(|a| a2lfile::A2lObjectName::get_name(*a) == shared);
                if let Some(p) = pts.filter(|p| usize::from(p.max_axis_points) != points) {
                    let found = p.max_axis_points;
                    return Err(fail(format!(
                        "`{name}` asks for {points} points of `{shared}`, which has {found}"
                    )));
                }
                axes.push(EntryAxis {
                    shared,
                    input: if d.input_quantity == "NO_INPUT_QUANTITY" {
                        String::new()
                    } else {
                        d.input_quantity.clone()
                    },
                    unit: unit(&d.conversion),
                    points,
                    limits: Interval::new(d.lower_limit, d.upper_limit),
                });
            }
            out.push(Entry {
                name,
                description: c.long_identifier.clone(),
                kind: c.characteristic_type.to_string(),
                unit: unit(&c.conversion),
                limits: Interval::new(c.lower_limit, c.upper_limit),
                axes,
            });
        }
    }
    Ok(out)
}

/// Gives characteristics the limits that an ECU's A2L states for them; says what does not fit.
pub fn adopt(package: &mut Package, entries: &[Entry]) -> Vec<String> {
    let mut notes = Vec::new();
    for c in &mut package.characteristics {
        let Some(e) = entries.iter().find(|e| e.name == c.name) else {
            notes.push(format!("`{}` is not in the A2L", c.name));
            continue;
        };
        c.limits = Some(e.limits);
        let outside = c.values.iter().filter(|v| !e.limits.contains(**v)).count();
        if outside > 0 {
            notes.push(format!(
                "`{}`: {outside} values outside {} to {}",
                c.name, e.limits.lower, e.limits.upper
            ));
        }
        let sizes: Vec<usize> = c.axes.iter().map(|a| a.points.len()).collect();
        let most: Vec<usize> = e.axes.iter().map(|a| a.points).collect();
        if sizes.len() != most.len() || sizes.iter().zip(&most).any(|(s, m)| s > m) {
            notes.push(format!("`{}`: axes of {sizes:?} points, the ECU has room for {most:?}", c.name));
        }
        let unit = |u: &str| dynocal_files::units::normalise(u);
        if unit(&e.unit) != unit(&c.unit) {
            notes.push(format!("`{}`: unit {}, the ECU has {}", c.name, c.unit, e.unit));
        }
    }
    notes
}
