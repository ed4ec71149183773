//! DCM 2.0, the conservation format of ETAS: what calibration tools exchange as text.
//!
//! Written in ASCII with CR LF, numbers six a line. Provenance goes into comments; text parameters are left out, because
//! not every reader takes them.

use std::fmt::Write;

use dynocal_numerics::registry::MemberDoc;

use crate::characteristic::{Axis, Characteristic, identifier};
use crate::error::ExportError;
use crate::format::dcm_read;
use crate::format::{Export, Holds, OutFile};
use crate::package::{Package, ascii};

/// Row of the table of exports.
pub const EXPORT: Export = Export {
    doc: MemberDoc { name: "dcm", what: "DCM 2.0: scalars, blocks, curves, maps, shared axes", params: &[] },
    holds: &[Holds::Characteristics],
    ecu_names: true,
    write: |package, _| {
        Ok(vec![OutFile {
            name: format!("{}.dcm", identifier(&package.name)),
            bytes: text(package)?.into_bytes(),
        }])
    },
    read: Some((".dcm", dcm_read::read)),
};

fn quoted(text: &str) -> String {
    format!("\"{}\"", ascii(text).replace('"', "'"))
}

fn numbers(out: &mut String, keyword: &str, values: &[f64]) {
    for line in values.chunks(6) {
        let cells: Vec<String> = line.iter().map(|v| format!("{v:?}")).collect();
        let _ = writeln!(out, "  {keyword} {}", cells.join(" "));
    }
}

/// The whole file.
fn text(package: &Package) -> Result<String, ExportError> {
    let function = identifier(&package.name);
    let mut out = String::new();
    package.provenance.lines().iter().for_each(|l| {
        let _ = writeln!(out, "* {l}");
    });
    let _ = writeln!(out, "KONSERVIERUNG_FORMAT 2.0\n\nFUNKTIONEN");
    let _ = writeln!(out, "  FKT {function} \"\" {}\nEND", quoted(&package.description));
    for axis in package.shared_axes()? {
        let _ =
            writeln!(out, "\nSTUETZSTELLENVERTEILUNG {} {}\n*SST", identifier(&axis.name), axis.points.len());
        let _ = writeln!(out, "  LANGNAME {}\n  FUNKTION {function}", quoted(&axis.description));
        let _ = writeln!(out, "  EINHEIT_X {}", quoted(&axis.unit));
        numbers(&mut out, "ST/X", &axis.points);
        let _ = writeln!(out, "END");
    }
    for c in &package.characteristics {
        object(&mut out, c, &function)?;
    }
    Ok(out.replace('\n', "\r\n"))
}

fn object(out: &mut String, c: &Characteristic, function: &str) -> Result<(), ExportError> {
    let shared = c.axes.iter().filter(|a| a.shared).count();
    if shared != 0 && shared != c.axes.len() {
        return Err(ExportError::Unfit {
            format: "dcm",
            what: c.name.clone(),
            reason: "one axis is shared and one is its own, which the calibration tools cannot list; make both alike".into(),
        });
    }
    let size: Vec<String> = c.axes.iter().map(|a| a.points.len().to_string()).collect();
    let kind = match (c.axes.len(), shared > 0) {
        (0, _) if c.values.len() == 1 => "FESTWERT",
        (0, _) => "FESTWERTEBLOCK",
        (1, false) => "KENNLINIE",
        (1, true) => "GRUPPENKENNLINIE",
        (2, false) => "KENNFELD",
        (2, true) => "GRUPPENKENNFELD",
        (n, _) => {
            let reason = format!("{n} axes, expected at most 2");
            return Err(ExportError::Unfit { format: "dcm", what: c.name.clone(), reason });
        }
    };
    let size = if kind == "FESTWERTEBLOCK" { c.values.len().to_string() } else { size.join(" ") };
    let _ = writeln!(out, "\n{}", format!("{kind} {} {size}", c.name).trim_end());
    for (axis, letter) in c.axes.iter().zip(["X", "Y"]).filter(|(a, _)| a.shared) {
        let _ = writeln!(out, "*SST{letter} {}", identifier(&axis.name));
    }
    let _ = writeln!(out, "  LANGNAME {}\n  FUNKTION {function}", quoted(&c.description));
    for (axis, letter) in c.axes.iter().zip(["X", "Y"]) {
        let _ = writeln!(out, "  EINHEIT_{letter} {}", quoted(&axis.unit));
    }
    let _ = writeln!(out, "  EINHEIT_W {}", quoted(&c.unit));
    if let [x, rest @ ..] = c.axes.as_slice() {
        numbers(out, "ST/X", &x.points);
        rows(out, c, x, rest.first());
    } else {
        // A block stands in one line: readers take several lines for the rows of a table.
        let cells: Vec<String> = c.values.iter().map(|v| format!("{v:?}")).collect();
        let _ = writeln!(out, "  WERT {}", cells.join(" "));
    }
    let _ = writeln!(out, "END");
    Ok(())
}

fn rows(out: &mut String, c: &Characteristic, x: &Axis, y: Option<&Axis>) {
    for (k, row) in c.values.chunks(x.points.len()).enumerate() {
        if let Some(y) = y {
            numbers(out, "ST/Y", &y.points[k..=k]);
        }
        numbers(out, "WERT", row);
    }
}
