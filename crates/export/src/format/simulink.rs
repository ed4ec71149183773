//! A MATLAB script that builds look-up and parameter objects for Simulink. It could not be run here: no MATLAB.

use std::fmt::Write;

use dynocal_numerics::registry::MemberDoc;

use crate::characteristic::{Characteristic, identifier};
use crate::format::{Export, Holds, OutFile};
use crate::package::{Extrapolation, Package, ascii};

/// Row of the table of exports.
pub const EXPORT: Export = Export {
    doc: MemberDoc {
        name: "simulink",
        what: "MATLAB script that builds Simulink.LookupTable and Simulink.Parameter objects",
        params: &[],
    },
    holds: &[Holds::Characteristics],
    ecu_names: false,
    write: |package, _| {
        Ok(vec![OutFile {
            name: format!("{}_tables.m", identifier(&package.name)),
            bytes: text(package).into_bytes(),
        }])
    },
    read: None,
};

fn vector(v: &[f64]) -> String {
    format!("[{}]", v.iter().map(|x| format!("{x:?}")).collect::<Vec<_>>().join(" "))
}

fn quoted(text: &str) -> String {
    format!("'{}'", ascii(text).replace('\'', "''"))
}

fn text(package: &Package) -> String {
    let mut s = String::new();
    package.provenance.lines().iter().for_each(|l| {
        let _ = writeln!(s, "% {l}");
    });
    let edge = match package.extrapolation {
        Extrapolation::Clip => "Clip",
        Extrapolation::Linear => "Linear",
    };
    let _ =
        writeln!(s, "% Set ExtrapMethod of the n-D Lookup Table blocks to {edge}: their default is Linear.");
    for c in &package.characteristics {
        object(&mut s, c);
    }
    s
}

fn object(s: &mut String, c: &Characteristic) {
    let name = &c.name;
    if c.axes.is_empty() {
        let _ = writeln!(s, "{name} = Simulink.Parameter({});", vector(&c.values));
        let _ = writeln!(
            s,
            "{name}.Unit = {};\n{name}.Description = {};",
            quoted(&c.unit),
            quoted(&c.description)
        );
        return;
    }
    let _ = writeln!(s, "{name} = Simulink.LookupTable;");
    // A table in MATLAB has the first axis along the rows; ours lies x fastest, which is MATLAB's own order.
    let value = match c.axes.as_slice() {
        [x, y] => format!("reshape({}, {}, {})", vector(&c.values), x.points.len(), y.points.len()),
        _ => vector(&c.values),
    };
    let _ = writeln!(s, "{name}.Table.Value = {value};\n{name}.Table.Unit = {};", quoted(&c.unit));
    let _ = writeln!(s, "{name}.Table.Description = {};", quoted(&c.description));
    for (k, axis) in c.axes.iter().enumerate() {
        let _ = writeln!(s, "{name}.Breakpoints({}).Value = {};", k + 1, vector(&axis.points));
        let _ = writeln!(s, "{name}.Breakpoints({}).Unit = {};", k + 1, quoted(&axis.unit));
        let _ = writeln!(s, "{name}.Breakpoints({}).FieldName = '{}';", k + 1, identifier(&axis.name));
    }
    let _ = writeln!(s, "{name}.StructTypeInfo.Name = '{name}_T';");
}
