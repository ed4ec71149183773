//! A CSV file for each characteristic: a table as it is printed, with axes in the first row and column.

use std::fmt::Write;

use dynocal_numerics::registry::MemberDoc;

use crate::characteristic::{Axis, Characteristic, identifier};
use crate::error::ExportError;
use crate::format::{Export, Holds, OutFile};
use crate::package::Package;

/// Row of the table of exports.
pub const EXPORT: Export = Export {
    doc: MemberDoc {
        name: "csv",
        what: "CSV, one file a characteristic, axes in the first row and column",
        params: &[],
    },
    holds: &[Holds::Characteristics],
    ecu_names: true,
    write: |package, _| Ok(package.characteristics.iter().map(|c| file(package, c)).collect()),
    read: Some((".csv", read)),
};

fn file(package: &Package, c: &Characteristic) -> OutFile {
    let mut s = String::new();
    package.provenance.lines().iter().for_each(|l| {
        let _ = writeln!(s, "# {l}");
    });
    let mut key = |k: &str, v: &str| {
        let _ = writeln!(s, "# {k} = {}", v.replace(['\n', '\r'], " "));
    };
    key("name", &c.name);
    key("description", &c.description);
    key("unit", &c.unit);
    for (axis, letter) in c.axes.iter().zip(["x", "y"]) {
        key(letter, &axis.name);
        key(&format!("{letter}_unit"), &axis.unit);
        key(&format!("{letter}_input"), &axis.input);
        key(&format!("{letter}_shared"), if axis.shared { "yes" } else { "no" });
    }
    let row = |v: &[f64]| v.iter().map(|x| format!("{x}")).collect::<Vec<_>>().join(",");
    match c.axes.as_slice() {
        [x] => x.points.iter().zip(&c.values).for_each(|(x, v)| {
            let _ = writeln!(s, "{x},{v}");
        }),
        [x, y] => {
            let _ = writeln!(s, "y\\x,{}", row(&x.points));
            for (y, values) in y.points.iter().zip(c.values.chunks(x.points.len())) {
                let _ = writeln!(s, "{y},{}", row(values));
            }
        }
        _ => {
            let _ = writeln!(s, "{}", row(&c.values));
        }
    }
    OutFile { name: format!("{}.csv", identifier(&c.name)), bytes: s.into_bytes() }
}

/// Reads one characteristic: a map where the first cell is no number, a curve where there are two columns of several
/// rows, else a scalar or block. Comments `# key = value` give name, units and axes; separator and decimal comma are
/// guessed as for measurements.
///
/// # Errors
/// [`ExportError::Malformed`] with the line.
pub fn read(file: &str, bytes: &[u8]) -> Result<Package, ExportError> {
    use dynocal_files::measurement::csv_dialect as dialect;
    let fail = |line: usize, reason: String| ExportError::Malformed { file: file.into(), line, reason };
    let encoding = dialect::guess_encoding(bytes);
    let text = dialect::decode(bytes, encoding);
    type Lines<'a> = Vec<(usize, &'a str)>;
    let (comments, body): (Lines, Lines) = text
        .lines()
        .enumerate()
        .map(|(k, l)| (k + 1, l.trim()))
        .filter(|(_, l)| !l.is_empty())
        .partition(|(_, l)| l.starts_with('#'));
    let key = |name: &str| {
        let found =
            comments.iter().filter_map(|(_, l)| l[1..].split_once(" = ")).find(|(k, _)| k.trim() == name);
        found.map(|(_, v)| v.trim().to_string()).unwrap_or_default()
    };
    let plain: String = body.iter().map(|(_, l)| format!("{l}\n")).collect();
    let how = dialect::guess(
        &plain,
        encoding,
        &dialect::CsvKeys { header_line: Some(1), unit_row: Some(false), ..Default::default() },
    );
    let mut rows: Vec<(usize, Vec<f64>, bool)> = Vec::new();
    for (line, l) in &body {
        let mut numbers = Vec::new();
        let mut corner = false;
        for (k, cell) in l.split(how.separator).map(|c| c.trim().trim_matches('"')).enumerate() {
            match dialect::number(cell, &how) {
                Some(v) if v.is_finite() => numbers.push(v),
                _ if k == 0 && rows.is_empty() => corner = true,
                _ => return Err(fail(*line, format!("found `{cell}`, expected a finite number"))),
            }
        }
        rows.push((*line, numbers, corner));
    }
    let Some((first, rest)) = rows.split_first() else {
        return Err(fail(1, "the file has no values".into()));
    };
    let stem = file.rsplit(['/', '\\']).next().unwrap_or(file).split('.').next().unwrap_or(file);
    let name = if key("name").is_empty() { identifier(stem) } else { key("name") };
    let axis = |k: usize, points: Vec<f64>| {
        let letter = ["x", "y"][k];
        let stated = key(letter);
        Axis {
            name: if stated.is_empty() { format!("{name}_{letter}") } else { stated },
            description: String::new(),
            unit: key(&format!("{letter}_unit")),
            input: key(&format!("{letter}_input")),
            points,
            shared: key(&format!("{letter}_shared")) == "yes",
        }
    };
    let (axes, values) = if first.2 {
        if let Some((line, row, _)) = rest.iter().find(|r| r.1.len() != first.1.len() + 1) {
            return Err(fail(*line, format!("found {} numbers, expected {}", row.len(), first.1.len() + 1)));
        }
        let y = rest.iter().map(|r| r.1[0]).collect();
        (vec![axis(0, first.1.clone()), axis(1, y)], rest.iter().flat_map(|r| r.1[1..].to_vec()).collect())
    } else if rows.len() > 1 {
        if let Some((line, row, _)) = rows.iter().find(|r| r.1.len() != 2) {
            return Err(fail(*line, format!("found {} numbers, expected 2 (point and value)", row.len())));
        }
        (vec![axis(0, rows.iter().map(|r| r.1[0]).collect())], rows.iter().map(|r| r.1[1]).collect())
    } else {
        (Vec::new(), first.1.clone())
    };
    let c = Characteristic {
        name,
        description: key("description"),
        unit: key("unit"),
        axes,
        values,
        limits: None,
    };
    c.check().map_err(|e| fail(0, e.to_string()))?;
    Ok(Package { name: c.name.clone(), characteristics: vec![c], ..Default::default() })
}
