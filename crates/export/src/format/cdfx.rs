//! CDF 2.0 (`.cdfx`), ASAM's XML of calibration data, written to its schema and read back with checks of values.

use std::fmt::Write;

use dynocal_numerics::registry::MemberDoc;
use roxmltree::{Document, Node, ParsingOptions};

use crate::characteristic::{Axis, Characteristic, identifier};
use crate::error::ExportError;
use crate::format::{Export, Holds, OutFile};
use crate::package::Package;

/// Row of the table of exports.
pub const EXPORT: Export = Export {
    doc: MemberDoc {
        name: "cdfx",
        what: "ASAM CDF 2.0: scalars, blocks, curves, maps, shared axes",
        params: &[],
    },
    holds: &[Holds::Characteristics],
    write: |package, _| {
        Ok(vec![OutFile {
            name: format!("{}.cdfx", identifier(&package.name)),
            bytes: text(package)?.into_bytes(),
        }])
    },
    read: Some((".cdfx", read)),
};

/// Text of an element.
pub(crate) fn escape(text: &str) -> String {
    text.replace('&', "&amp;").replace('<', "&lt;").replace('>', "&gt;").replace('"', "&quot;")
}

fn values(v: &[f64]) -> String {
    v.iter().map(|x| format!("<V>{x:?}</V>")).collect()
}

fn text(package: &Package) -> Result<String, ExportError> {
    let name = identifier(&package.name);
    let mut s = String::from("<?xml version=\"1.0\" encoding=\"UTF-8\"?>\n");
    // Two hyphens would end the comment.
    let lines: Vec<String> = package.provenance.lines().iter().map(|l| l.replace("--", "- -")).collect();
    let _ = writeln!(s, "<!-- {} -->", lines.join("\n     "));
    let _ = writeln!(
        s,
        "<!DOCTYPE MSRSW PUBLIC \"-//ASAM//DTD CALIBRATION DATA FORMAT:V2.0.0:LAI:IAI:XML:CDF200.XSD//EN\" \"cdf_v2.0.0.sl.dtd\">"
    );
    let _ = writeln!(
        s,
        "<MSRSW><SHORT-NAME>{name}</SHORT-NAME><CATEGORY>CDF20</CATEGORY><SW-SYSTEMS><SW-SYSTEM><SHORT-NAME>{name}</SHORT-NAME>"
    );
    let _ = writeln!(
        s,
        "<SW-INSTANCE-SPEC><SW-INSTANCE-TREE><SHORT-NAME>{name}</SHORT-NAME><CATEGORY>NO_VCD</CATEGORY>"
    );
    for axis in package.shared_axes()? {
        let _ = writeln!(
            s,
            "<SW-INSTANCE><SHORT-NAME>{}</SHORT-NAME><LONG-NAME>{}</LONG-NAME><CATEGORY>COM_AXIS</CATEGORY>\
<SW-FEATURE-REF>{name}</SW-FEATURE-REF><SW-VALUE-CONT><UNIT-DISPLAY-NAME>{}</UNIT-DISPLAY-NAME>\
<SW-ARRAYSIZE><V>{}</V></SW-ARRAYSIZE><SW-VALUES-PHYS>{}</SW-VALUES-PHYS></SW-VALUE-CONT></SW-INSTANCE>",
            identifier(&axis.name),
            escape(&axis.description),
            escape(&axis.unit),
            axis.points.len(),
            values(&axis.points)
        );
    }
    for c in &package.characteristics {
        instance(&mut s, c, &name)?;
    }
    s.push_str("</SW-INSTANCE-TREE></SW-INSTANCE-SPEC></SW-SYSTEM></SW-SYSTEMS></MSRSW>\n");
    Ok(s)
}

fn instance(s: &mut String, c: &Characteristic, feature: &str) -> Result<(), ExportError> {
    let category = match c.axes.len() {
        0 if c.values.len() == 1 => "VALUE",
        0 => "VAL_BLK",
        1 => "CURVE",
        2 => "MAP",
        n => {
            let reason = format!("{n} axes, expected at most 2");
            return Err(ExportError::Unfit { format: "cdfx", what: c.name.clone(), reason });
        }
    };
    let size = if category == "VAL_BLK" {
        format!("<SW-ARRAYSIZE><V>{}</V></SW-ARRAYSIZE>", c.values.len())
    } else {
        String::new()
    };
    let body = if c.axes.len() == 2 {
        c.values.chunks(c.axes[0].points.len()).map(|row| format!("<VG>{}</VG>", values(row))).collect()
    } else {
        values(&c.values)
    };
    let _ = write!(
        s,
        "<SW-INSTANCE><SHORT-NAME>{}</SHORT-NAME><LONG-NAME>{}</LONG-NAME><CATEGORY>{category}</CATEGORY>\
<SW-FEATURE-REF>{feature}</SW-FEATURE-REF><SW-VALUE-CONT><UNIT-DISPLAY-NAME>{}</UNIT-DISPLAY-NAME>{size}\
<SW-VALUES-PHYS>{body}</SW-VALUES-PHYS></SW-VALUE-CONT>",
        c.name,
        escape(&c.description),
        escape(&c.unit)
    );
    if !c.axes.is_empty() {
        s.push_str("<SW-AXIS-CONTS>");
        for axis in &c.axes {
            let _ = if axis.shared {
                write!(
                    s,
                    "<SW-AXIS-CONT><CATEGORY>COM_AXIS</CATEGORY><SW-INSTANCE-REF>{}</SW-INSTANCE-REF></SW-AXIS-CONT>",
                    identifier(&axis.name)
                )
            } else {
                write!(
                    s,
                    "<SW-AXIS-CONT><CATEGORY>STD_AXIS</CATEGORY><UNIT-DISPLAY-NAME>{}</UNIT-DISPLAY-NAME>\
<SW-VALUES-PHYS>{}</SW-VALUES-PHYS></SW-AXIS-CONT>",
                    escape(&axis.unit),
                    values(&axis.points)
                )
            };
        }
        s.push_str("</SW-AXIS-CONTS>");
    }
    s.push_str("</SW-INSTANCE>\n");
    Ok(())
}

/// Reads a file. Foreign elements inside a value, unknown categories, dangling axes and sizes that do not fit are
/// refused; text and boolean parameters are left out.
///
/// # Errors
/// [`ExportError::Malformed`] with the line.
pub fn read(file: &str, bytes: &[u8]) -> Result<Package, ExportError> {
    let fail = |line: usize, reason: String| ExportError::Malformed { file: file.into(), line, reason };
    let text = std::str::from_utf8(bytes).map_err(|e| fail(0, format!("not UTF-8: {e}")))?;
    let text = text.trim_start_matches('\u{feff}');
    let options = ParsingOptions { allow_dtd: true, nodes_limit: 4_000_000, ..Default::default() };
    let doc =
        Document::parse_with_options(text, options).map_err(|e| fail(e.pos().row as usize, e.to_string()))?;
    let root = doc.root_element();
    if root.tag_name().name() != "MSRSW" {
        return Err(fail(1, format!("found <{}>, expected <MSRSW>", root.tag_name().name())));
    }
    let line = |n: Node| doc.text_pos_at(n.range().start).row as usize;
    let mut package = Package { name: child_text(root, "SHORT-NAME"), ..Default::default() };
    let instances: Vec<Node> = root.descendants().filter(|n| n.has_tag_name("SW-INSTANCE")).collect();
    let mut shared: Vec<(String, Axis)> = Vec::new();
    let at = |n: Node, reason: String| fail(line(n), format!("`{}`: {reason}", child_text(n, "SHORT-NAME")));
    for n in instances.iter().filter(|n| child_text(**n, "CATEGORY") == "COM_AXIS") {
        let (unit, points) = container(*n).map_err(|e| at(*n, e))?;
        let axis = Axis {
            name: child_text(*n, "SHORT-NAME"),
            description: child_text(*n, "LONG-NAME"),
            unit,
            input: String::new(),
            points: points.concat(),
            shared: true,
        };
        axis.check().map_err(|e| at(*n, e.to_string()))?;
        shared.push((axis.name.clone(), axis));
    }
    for n in &instances {
        if let Some(c) = characteristic(*n, &shared).map_err(|e| at(*n, e))? {
            c.check().map_err(|e| at(*n, e.to_string()))?;
            package.characteristics.push(c);
        }
    }
    Ok(package)
}

fn child<'a, 'i>(n: Node<'a, 'i>, name: &str) -> Option<Node<'a, 'i>> {
    n.children().find(|c| c.has_tag_name(name))
}

fn child_text(n: Node, name: &str) -> String {
    child(n, name).and_then(|c| c.text()).unwrap_or_default().trim().to_string()
}

const CHILDREN: [&str; 11] = [
    "SHORT-NAME",
    "LONG-NAME",
    "DISPLAY-NAME",
    "CATEGORY",
    "SW-FEATURE-REF",
    "SW-VALUE-CONT",
    "SW-AXIS-CONTS",
    "SW-MODEL-LINK",
    "SW-CS-HISTORY",
    "SW-CS-FLAGS",
    "ADMIN-DATA",
];

fn characteristic(n: Node, shared: &[(String, Axis)]) -> Result<Option<Characteristic>, String> {
    if let Some(foreign) = n.children().find(|c| c.is_element() && !CHILDREN.contains(&c.tag_name().name())) {
        return Err(format!(
            "found the element <{}>, which an instance does not have",
            foreign.tag_name().name()
        ));
    }
    let category = child_text(n, "CATEGORY");
    let axes = match category.as_str() {
        "VALUE" | "VAL_BLK" | "DEPENDENT_VALUE" | "DEPEDNDENT_VALUE" => 0,
        "CURVE" => 1,
        "MAP" => 2,
        "COM_AXIS" | "RES_AXIS" | "ASCII" | "BOOLEAN" | "CURVE_AXIS" => return Ok(None),
        other => return Err(format!("found the category `{other}`")),
    };
    let (unit, rows) = container(n)?;
    let mut found = Vec::new();
    for cont in n.descendants().filter(|d| d.has_tag_name("SW-AXIS-CONT")) {
        found.push(axis(n, cont, found.len(), shared)?);
    }
    if found.len() != axes {
        return Err(format!("found {} axes, expected {axes} for {category}", found.len()));
    }
    // The schema does not see a map whose rows and columns are exchanged; the sizes do, unless it is square.
    if axes == 2 {
        let (nx, ny) = (found[0].points.len(), found[1].points.len());
        if rows.len() != ny || rows.iter().any(|r| r.len() != nx) {
            let first = rows.first().map_or(0, Vec::len);
            return Err(format!("found {} groups of {first} values, expected {ny} of {nx}", rows.len()));
        }
    }
    Ok(Some(Characteristic {
        name: child_text(n, "SHORT-NAME"),
        description: child_text(n, "LONG-NAME"),
        unit,
        axes: found,
        values: rows.concat(),
        limits: None,
    }))
}

fn axis(n: Node, cont: Node, k: usize, shared: &[(String, Axis)]) -> Result<Axis, String> {
    match child_text(cont, "CATEGORY").as_str() {
        "COM_AXIS" => {
            let name = child_text(cont, "SW-INSTANCE-REF");
            let known = shared.iter().find(|s| s.0 == name).map(|s| s.1.clone());
            known.ok_or_else(|| format!("refers to the axis `{name}`, which the file does not have"))
        }
        "STD_AXIS" | "FIX_AXIS" => Ok(Axis {
            name: format!("{}_{}", child_text(n, "SHORT-NAME"), ["x", "y"][k.min(1)]),
            description: String::new(),
            unit: child_text(cont, "UNIT-DISPLAY-NAME"),
            input: String::new(),
            points: numbers(child(cont, "SW-VALUES-PHYS").ok_or("an axis has no values")?)?.concat(),
            shared: false,
        }),
        other => Err(format!("found the axis category `{other}`, expected STD_AXIS, COM_AXIS or FIX_AXIS")),
    }
}

/// Unit and rows of values of an instance.
fn container(n: Node) -> Result<(String, Vec<Vec<f64>>), String> {
    let cont = child(n, "SW-VALUE-CONT").ok_or("found no SW-VALUE-CONT")?;
    let phys = child(cont, "SW-VALUES-PHYS").ok_or("found no SW-VALUES-PHYS")?;
    Ok((child_text(cont, "UNIT-DISPLAY-NAME"), numbers(phys)?))
}

/// Rows of V elements; groups VG are rows, single values one row.
fn numbers(n: Node) -> Result<Vec<Vec<f64>>, String> {
    let (mut rows, mut single) = (Vec::new(), Vec::new());
    for c in n.children().filter(Node::is_element) {
        match c.tag_name().name() {
            "V" => {
                let text = c.text().unwrap_or_default().trim();
                match text.parse::<f64>() {
                    Ok(v) if v.is_finite() => single.push(v),
                    _ => return Err(format!("found `{text}` in V, expected a finite number")),
                }
            }
            "VG" => rows.push(numbers(c)?.concat()),
            // Some writers label their groups.
            "LABEL" | "SW-AXIS-INDEX" => {}
            other => return Err(format!("found <{other}> among values, expected V or VG")),
        }
    }
    if !single.is_empty() {
        rows.push(single);
    }
    Ok(rows)
}
