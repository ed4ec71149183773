//! Reads CDF 2.0, from whichever tool: values checked, what no characteristic of ours holds left out by its name.
//!
//! Structures and arrays are trees of instances; their members get the names `structure.member` and `array[index]`. Words
//! (`VT`, the categories `ASCII` and `BOOLEAN`), variants, rescale and curve axes are left out by name. The schema is not
//! demanded: files of well-known tools break it.

use roxmltree::{Document, Node, ParsingOptions};

use crate::characteristic::{Axis, Characteristic};
use crate::error::ExportError;
use crate::package::Package;

/// Reads a file. Foreign elements inside an instance or a value, unknown categories, dangling axes and sizes that do not fit
/// are refused.
///
/// # Errors
/// [`ExportError::Malformed`] with the line.
pub(super) fn read(file: &str, bytes: &[u8]) -> Result<Package, ExportError> {
    let fail = |line: usize, reason: String| ExportError::Malformed { file: file.into(), line, reason };
    let encoding = dynocal_files::measurement::csv_dialect::guess_encoding(bytes);
    let text = dynocal_files::measurement::csv_dialect::decode(bytes, encoding);
    let text = text.trim_start_matches('\u{feff}');
    let options = ParsingOptions { allow_dtd: true, nodes_limit: 4_000_000, ..Default::default() };
    let doc =
        Document::parse_with_options(text, options).map_err(|e| fail(e.pos().row as usize, e.to_string()))?;
    let root = doc.root_element();
    if root.tag_name().name() != "MSRSW" {
        return Err(fail(1, format!("found <{}>, expected <MSRSW>", root.tag_name().name())));
    }
    let mut package = Package { name: child_text(root, "SHORT-NAME"), ..Default::default() };
    package.provenance.run = format!("{file} (read as {encoding:?})");
    let mut instances = Vec::new();
    for tree in root.descendants().filter(|n| n.has_tag_name("SW-INSTANCE-TREE")) {
        gather(tree, "", 0, &mut instances);
    }
    let at = |i: &Instance, reason: String| {
        fail(doc.text_pos_at(i.node.range().start).row as usize, format!("`{}`: {reason}", i.name))
    };
    let mut shared: Vec<Axis> = Vec::new();
    for i in instances.iter().filter(|i| child_text(i.node, "CATEGORY") == "COM_AXIS") {
        match common_axis(i) {
            Ok(axis) => shared.push(axis),
            Err(Why::LeftOut(why)) => package.left_out.push(format!("`{}`: {why}", i.name)),
            Err(Why::Fault(reason)) => return Err(at(i, reason)),
        }
    }
    for i in &instances {
        match characteristic(i, &shared) {
            Ok(found) => package.characteristics.extend(found),
            Err(Why::LeftOut(why)) => package.left_out.push(format!("`{}`: {why}", i.name)),
            Err(Why::Fault(reason)) => return Err(at(i, reason)),
        }
    }
    Ok(package)
}

/// Why an instance does not come in.
enum Why {
    /// It is sound, but nothing of ours holds it.
    LeftOut(&'static str),
    /// It is not.
    Fault(String),
}

impl From<String> for Why {
    fn from(reason: String) -> Self {
        Self::Fault(reason)
    }
}

const WORDS: Why = Why::LeftOut("it holds words");

/// An instance with its name in the tree.
struct Instance<'a, 'i> {
    node: Node<'a, 'i>,
    name: String,
}

/// Deepest tree of instances.
const DEPTH: usize = 64;

/// The instances below `parent`, those of structures and arrays after what holds them.
fn gather<'a, 'i>(parent: Node<'a, 'i>, prefix: &str, depth: usize, out: &mut Vec<Instance<'a, 'i>>) {
    for node in parent.children().filter(|c| c.has_tag_name("SW-INSTANCE")) {
        let (name, index) = (child_text(node, "SHORT-NAME"), child_text(node, "SW-ARRAY-INDEX"));
        let name = match (prefix.is_empty(), index.is_empty()) {
            (_, false) => format!("{prefix}[{index}]"),
            (true, true) => name,
            (false, true) => format!("{prefix}.{name}"),
        };
        out.push(Instance { node, name: name.clone() });
        if depth < DEPTH {
            gather(node, &name, depth + 1, out);
        }
    }
}

fn child<'a, 'i>(n: Node<'a, 'i>, name: &str) -> Option<Node<'a, 'i>> {
    n.children().find(|c| c.has_tag_name(name))
}

fn child_text(n: Node, name: &str) -> String {
    child(n, name).and_then(|c| c.text()).unwrap_or_default().trim().to_string()
}

const CHILDREN: [&str; 14] = [
    "SHORT-NAME",
    "SW-ARRAY-INDEX",
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
    "SW-INSTANCE",
    "SW-INSTANCE-PROPS-VARIANTS",
];

fn common_axis(i: &Instance) -> Result<Axis, Why> {
    whole(i)?;
    let (unit, points) = container(i.node)?;
    let axis = Axis {
        name: i.name.clone(),
        description: child_text(i.node, "LONG-NAME"),
        unit,
        input: String::new(),
        points: points.concat(),
        shared: true,
    };
    axis.check().map_err(|e| e.to_string())?;
    Ok(axis)
}

/// Nothing foreign in an instance, and one set of values.
fn whole(i: &Instance) -> Result<(), Why> {
    let foreign = i.node.children().find(|c| c.is_element() && !CHILDREN.contains(&c.tag_name().name()));
    if let Some(foreign) = foreign {
        let name = foreign.tag_name().name();
        return Err(Why::Fault(format!("found the element <{name}>, which an instance does not have")));
    }
    match child(i.node, "SW-INSTANCE-PROPS-VARIANTS") {
        Some(_) => Err(Why::LeftOut("it has variants, of which none is chosen")),
        None => Ok(()),
    }
}

fn characteristic(i: &Instance, shared: &[Axis]) -> Result<Option<Characteristic>, Why> {
    let n = i.node;
    let category = child_text(n, "CATEGORY");
    let axes = match category.as_str() {
        "VALUE" | "VAL_BLK" | "DEPENDENT_VALUE" | "DEPEDNDENT_VALUE" => 0,
        "CURVE" => 1,
        "MAP" => 2,
        // Taken before.
        "COM_AXIS" => return Ok(None),
        "STRUCTURE" | "STRUCTURE_ARRAY" | "UNION" | "VALUE_ARRAY" | "CURVE_ARRAY" | "MAP_ARRAY" => {
            whole(i)?;
            // What it holds stands in its members.
            return match child(n, "SW-VALUE-CONT") {
                Some(_) => {
                    Err(Why::LeftOut("it is an array or a structure whose values do not stand in members"))
                }
                None => Ok(None),
            };
        }
        "ASCII" | "BOOLEAN" => return Err(WORDS),
        "RES_AXIS" | "CURVE_AXIS" => return Err(Why::LeftOut("rescale and curve axes are not read")),
        "CUBOID" | "CUBE_4" | "CUBE_5" => return Err(Why::LeftOut("it has more than two axes")),
        "BLOB" => return Err(Why::LeftOut("it holds bytes")),
        other => return Err(Why::Fault(format!("found the category `{other}`"))),
    };
    whole(i)?;
    let (unit, rows) = container(n)?;
    let conts = child(n, "SW-AXIS-CONTS");
    let mut found = Vec::new();
    for cont in conts.iter().flat_map(|c| c.children()).filter(|d| d.has_tag_name("SW-AXIS-CONT")) {
        found.push(axis(i, cont, found.len(), shared)?);
    }
    if found.len() != axes {
        return Err(Why::Fault(format!("found {} axes, expected {axes} for {category}", found.len())));
    }
    let count: usize = rows.iter().map(Vec::len).sum();
    if category == "VAL_BLK"
        && let Some(size) = array_size(n)
        && size != count
    {
        return Err(Why::Fault(format!("found {count} values, expected {size} as SW-ARRAYSIZE says")));
    }
    // The schema does not see a map whose rows and columns are exchanged; the sizes do, unless it is square.
    if axes == 2 {
        let (nx, ny) = (found[0].points.len(), found[1].points.len());
        if rows.len() != ny || rows.iter().any(|r| r.len() != nx) {
            let first = rows.first().map_or(0, Vec::len);
            let text = format!("found {} groups of {first} values, expected {ny} of {nx}", rows.len());
            return Err(Why::Fault(text));
        }
    }
    let c = Characteristic {
        name: i.name.clone(),
        description: child_text(n, "LONG-NAME"),
        unit,
        axes: found,
        values: rows.concat(),
        limits: None,
    };
    c.check().map_err(|e| e.to_string())?;
    Ok(Some(c))
}

/// Number of values by SW-ARRAYSIZE, where it stands and can be read.
fn array_size(n: Node) -> Option<usize> {
    let size = child(child(n, "SW-VALUE-CONT")?, "SW-ARRAYSIZE")?;
    let each = size.children().filter(|c| c.has_tag_name("V"));
    each.map(|v| v.text()?.trim().parse::<usize>().ok()).try_fold(1usize, |all, v| all.checked_mul(v?))
}

/// The category of an axis may be left away: what it refers to or holds tells it.
fn axis(i: &Instance, cont: Node, k: usize, shared: &[Axis]) -> Result<Axis, Why> {
    let (category, refers) = (child_text(cont, "CATEGORY"), child_text(cont, "SW-INSTANCE-REF"));
    let category = match (category.as_str(), refers.is_empty()) {
        ("", false) => "COM_AXIS",
        ("", true) => "STD_AXIS",
        (said, _) => said,
    };
    let unit = child_text(cont, "UNIT-DISPLAY-NAME");
    match category {
        "COM_AXIS" => {
            let known = shared.iter().find(|a| a.name == refers).cloned();
            let mut axis = known.ok_or_else(|| {
                Why::Fault(format!("refers to the axis `{refers}`, which the file does not have"))
            })?;
            if axis.unit.is_empty() {
                axis.unit = unit;
            }
            Ok(axis)
        }
        "STD_AXIS" | "FIX_AXIS" => {
            let phys = child(cont, "SW-VALUES-PHYS").ok_or("an axis has no values".to_string())?;
            Ok(Axis {
                name: format!("{}_{}", i.name, ["x", "y"][k.min(1)]),
                description: String::new(),
                unit,
                input: String::new(),
                points: numbers(phys)?.concat(),
                shared: false,
            })
        }
        "RES_AXIS" | "CURVE_AXIS" => Err(Why::LeftOut("rescale and curve axes are not read")),
        other => Err(Why::Fault(format!(
            "found the axis category `{other}`, expected STD_AXIS, COM_AXIS or FIX_AXIS"
        ))),
    }
}

/// Unit and rows of values of an instance.
fn container(n: Node) -> Result<(String, Vec<Vec<f64>>), Why> {
    let cont = child(n, "SW-VALUE-CONT").ok_or("found no SW-VALUE-CONT".to_string())?;
    let phys = child(cont, "SW-VALUES-PHYS").ok_or("found no SW-VALUES-PHYS".to_string())?;
    Ok((child_text(cont, "UNIT-DISPLAY-NAME"), numbers(phys)?))
}

/// Rows of V elements; groups VG are rows, single values one row.
fn numbers(n: Node) -> Result<Vec<Vec<f64>>, Why> {
    let (mut rows, mut single) = (Vec::new(), Vec::new());
    for c in n.children().filter(Node::is_element) {
        match c.tag_name().name() {
            "V" => {
                let text = c.text().unwrap_or_default().trim();
                match text.parse::<f64>() {
                    Ok(v) if v.is_finite() => single.push(v),
                    _ => return Err(Why::Fault(format!("found `{text}` in V, expected a finite number"))),
                }
            }
            "VG" => rows.push(numbers(c)?.concat()),
            "VT" => return Err(WORDS),
            // Some writers label their groups.
            "LABEL" | "SW-AXIS-INDEX" => {}
            other => return Err(Why::Fault(format!("found <{other}> among values, expected V or VG"))),
        }
    }
    if !single.is_empty() {
        rows.push(single);
    }
    Ok(rows)
}
