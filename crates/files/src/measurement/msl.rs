//! MegaSquirt text logs (`.msl`): quoted lines, a line of names, a line of units, records, all separated by tabs.

use std::path::Path;

use dynocal_numerics::registry::MemberDoc;

use crate::bounds::held;
use crate::error::FilesError;
use crate::measurement::{Reader, Whole, bounded};
use crate::table::{Cells, Column, Table, UnitSource};
use crate::units;

/// Row of the table of formats.
pub const FORMAT: Reader = Reader {
    doc: MemberDoc { name: "msl", what: "MegaSquirt text log, separated by tabs", params: &[] },
    endings: &[".msl"],
    recognises: |_| false,
    open: |path, _| Ok(Box::new(Whole::new(read(path)?))),
    write: None,
    several: false,
};

/// Reads a log. `On` and `Off` become 1 and 0; a line that is shorter than the names is a marker and left out.
fn read(path: &Path) -> Result<Table, FilesError> {
    let file = path.display().to_string();
    let bytes = std::fs::read(path).map_err(|e| FilesError::unread(path, &e))?;
    let text: String = bytes.iter().map(|b| char::from(*b)).collect();
    let bad =
        |reason: String| FilesError::Malformed { path: file.clone(), format: "MegaSquirt text log", reason };
    let mut lines = (1u64..).zip(text.lines()).skip_while(|(_, l)| {
        let l = l.trim();
        l.is_empty() || l.starts_with('"') || l.starts_with('#')
    });
    let (_, names) = lines.next().ok_or_else(|| bad("found no line of names".into()))?;
    let names: Vec<&str> = names.trim_end().split('\t').map(str::trim).collect();
    if names.len() < 2 {
        return Err(bad("found no line of names that are separated by tabs".into()));
    }
    bounded(&file, "MegaSquirt text log", names.len())?;
    let (_, units_line) = lines.next().ok_or_else(|| bad("found no line of units below the names".into()))?;
    let unit_names: Vec<&str> = units_line.split('\t').map(str::trim).collect();
    let numbers = unit_names.iter().filter(|u| u.parse::<f64>().is_ok()).count();
    if 2 * numbers > names.len() {
        return Err(bad("found values in the line below the names, expected units".into()));
    }
    let (mut rows, mut at, mut markers): (Vec<Vec<&str>>, Vec<u64>, usize) = (Vec::new(), Vec::new(), 0);
    for (line, text) in lines.filter(|(_, l)| !l.trim().is_empty()) {
        let cells: Vec<&str> = text.trim_end_matches(['\r', '\n', '\t']).split('\t').map(str::trim).collect();
        match cells.len() {
            n if n < names.len() => markers += 1,
            n if n > names.len() => {
                return Err(FilesError::Ragged { path: file, line, found: n, expected: names.len() });
            }
            _ => {
                rows.push(cells);
                at.push(line);
            }
        }
    }
    held(&file, rows.len() as u64, names.len())?;
    let columns = names.iter().enumerate().map(|(c, name)| Column {
        name: if name.is_empty() { format!("field {}", c + 1) } else { (*name).to_string() },
        unit: unit_names.get(c).filter(|u| !u.is_empty()).map(|u| (units::normalise(u), UnitSource::Bracket)),
        cells: cells(&rows, c),
    });
    let columns = columns.collect();
    let notes = (markers > 0).then(|| format!("{markers} shorter lines are markers and left out"));
    Ok(Table { file, columns, lines: at, notes: notes.into_iter().collect() })
}

fn cells(rows: &[Vec<&str>], c: usize) -> Cells {
    let number = |text: &str| match text {
        "" | "NaN" => Some(f64::NAN),
        "On" => Some(1.0),
        "Off" => Some(0.0),
        other => other.parse().ok(),
    };
    let values: Option<Vec<f64>> = rows.iter().map(|r| number(r[c])).collect();
    values.map_or_else(|| Cells::Text(rows.iter().map(|r| r[c].to_string()).collect()), Cells::Number)
}
