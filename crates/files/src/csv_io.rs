//! CSV, plain or gzip (told by the first bytes): one header row, then cells.
//!
//! The separator is read off the header (`,`, `;` or tab). With `;` or tab a comma inside a number is its decimal
//! point. Quoted cells and a byte-order mark are understood. Units stand in the header, `name [unit]`, or as a
//! suffix of the name, `torque_nm`.

use std::fs::File;
use std::io::{BufReader, Read, Write};
use std::path::Path;

use csv::{ByteRecord, ReaderBuilder};
use dynocal_ident::data::Dataset;
use flate2::{Compression, GzBuilder, read::MultiGzDecoder};

use crate::atomic;
use crate::error::{FilesError, reason};
use crate::table::{Cells, Column, Table, UnitSource};
use crate::units;

/// Reads a CSV file.
///
/// # Errors
/// [`FilesError`]: unreadable, empty, ragged row, column named twice, broken gzip or text.
pub fn read(path: &Path) -> Result<Table, FilesError> {
    let name = path.display().to_string();
    let fail = |e: std::io::Error| FilesError::Read { path: name.clone(), reason: reason(&e) };
    let mut bytes = Vec::new();
    File::open(path).and_then(|mut f| f.read_to_end(&mut bytes)).map_err(fail)?;
    if bytes.starts_with(&[0x1f, 0x8b]) {
        let mut plain = Vec::new();
        MultiGzDecoder::new(BufReader::new(bytes.as_slice())).read_to_end(&mut plain).map_err(|e| {
            FilesError::Malformed { path: name.clone(), format: "gzip", reason: e.to_string() }
        })?;
        bytes = plain;
    }
    parse(&name, &bytes)
}

/// Parses CSV text; `file` is its name for messages.
///
/// # Errors
/// As [`read`].
///
/// # Examples
/// ```
/// let table = dynocal_files::csv_io::parse("bed.csv", b"time_s,torque [Nm]\n0,30.5\n0.03,31\n").unwrap();
/// assert_eq!(table.numbers("torque", 0, 2).unwrap(), [30.5, 31.0]);
/// ```
pub fn parse(file: &str, bytes: &[u8]) -> Result<Table, FilesError> {
    let empty =
        || FilesError::Empty { path: file.into(), expected: "a header row and at least one row of data" };
    let bytes = bytes.strip_prefix(b"\xef\xbb\xbf").unwrap_or(bytes);
    if bytes.iter().all(u8::is_ascii_whitespace) {
        return Err(empty());
    }
    let delimiter = delimiter(bytes);
    let malformed =
        |e: csv::Error| FilesError::Malformed { path: file.into(), format: "CSV", reason: e.to_string() };
    // Flexible, because our own message names line, found and expected.
    let mut reader =
        ReaderBuilder::new().delimiter(delimiter).flexible(true).has_headers(true).from_reader(bytes);
    let head = reader.byte_headers().map_err(malformed)?;
    let decimal_comma = delimiter != b',';
    let is_number =
        |cell: &[u8]| number(&String::from_utf8_lossy(cell.trim_ascii()), decimal_comma).is_some();
    if head.iter().any(|c| !c.trim_ascii().is_empty()) && head.iter().all(is_number) {
        return Err(FilesError::NoHeader {
            path: file.into(),
            found: String::from_utf8_lossy(head.as_slice()).into(),
        });
    }
    let mut columns = header(file, head)?;
    let mut lines = Vec::new();
    let mut record = ByteRecord::new();
    while reader.read_byte_record(&mut record).map_err(malformed)? {
        let line = record.position().map_or(0, csv::Position::line);
        if record.len() != columns.len() {
            return Err(FilesError::Ragged {
                path: file.into(),
                line,
                found: record.len(),
                expected: columns.len(),
            });
        }
        for (column, cell) in columns.iter_mut().zip(record.iter()) {
            push(&mut column.cells, cell, decimal_comma);
        }
        lines.push(line);
    }
    if lines.is_empty() {
        return Err(empty());
    }
    Ok(Table { file: file.into(), columns, lines })
}

fn delimiter(bytes: &[u8]) -> u8 {
    let head = bytes.split(|b| *b == b'\n').next().unwrap_or(bytes);
    let count = |d: u8| head.iter().filter(|b| **b == d).count();
    let (comma, semicolon, tab) = (count(b','), count(b';'), count(b'\t'));
    if semicolon > comma && semicolon >= tab {
        b';'
    } else if tab > comma {
        b'\t'
    } else {
        b','
    }
}

fn header(file: &str, cells: &ByteRecord) -> Result<Vec<Column>, FilesError> {
    let mut columns: Vec<Column> = Vec::with_capacity(cells.len());
    for cell in cells {
        let (name, unit) = units::split_header(&String::from_utf8_lossy(cell));
        let unit = match unit {
            Some(u) => Some((u, UnitSource::Bracket)),
            None => units::from_parentheses(&name)
                .or_else(|| units::from_suffix(&name).map(str::to_string))
                .map(|u| (u, UnitSource::Suffix)),
        };
        if columns.iter().any(|c| c.name == name) {
            return Err(FilesError::DuplicateColumn { path: file.into(), column: name });
        }
        columns.push(Column { name, unit, cells: Cells::Number(Vec::new()) });
    }
    Ok(columns)
}

/// Appends a cell; a column of numbers turns into text at the first cell that is no number.
fn push(cells: &mut Cells, cell: &[u8], decimal_comma: bool) {
    let text = String::from_utf8_lossy(cell.trim_ascii());
    match cells {
        Cells::Text(v) => v.push(text.into_owned()),
        Cells::Number(v) => match number(&text, decimal_comma) {
            Some(x) => v.push(x),
            None => {
                let mut t: Vec<String> = v.iter().map(|x| format!("{x}")).collect();
                t.push(text.into_owned());
                *cells = Cells::Text(t);
            }
        },
    }
}

fn number(text: &str, decimal_comma: bool) -> Option<f64> {
    if text.is_empty() {
        return Some(f64::NAN);
    }
    if decimal_comma && text.contains(',') {
        return text.replacen(',', ".", 1).parse().ok();
    }
    text.parse().ok()
}

/// Writes a dataset: time in s, then every channel as `name [unit]`. Numbers are the shortest decimals that read
/// back to the same bits (at most 17 significant digits). A name that ends in `.gz` is compressed.
///
/// # Errors
/// [`FilesError::Write`], or [`FilesError::Data`] when the dataset is not consistent.
pub fn write_dataset(path: &Path, data: &Dataset) -> Result<(), FilesError> {
    data.check()?;
    let time: Vec<f64> = (0..data.len()).map(|t| t as f64 * data.sample_time_s).collect();
    let mut columns: Vec<(&str, &str, &[f64])> = vec![("time", "s", &time)];
    columns.extend(data.channels.iter().map(|c| (c.name.as_str(), c.unit.as_str(), c.values.as_slice())));
    write_columns(path, &columns)
}

/// Writes columns (name, unit, values) of equal length; as [`write_dataset`].
///
/// # Errors
/// [`FilesError::Write`].
pub fn write_columns(path: &Path, columns: &[(&str, &str, &[f64])]) -> Result<(), FilesError> {
    let gz = path.extension().is_some_and(|e| e == "gz");
    atomic::write_with(path, |w| {
        if gz {
            // No name and no time in the gzip header: equal data, equal bytes.
            let mut z = GzBuilder::new().mtime(0).write(w, Compression::default());
            write_text(&mut z, columns)?;
            z.finish().map(|_| ())
        } else {
            write_text(w, columns)
        }
    })
}

fn write_text(w: &mut dyn Write, columns: &[(&str, &str, &[f64])]) -> std::io::Result<()> {
    for (k, (name, unit, _)) in columns.iter().enumerate() {
        let cell = quoted(&format!("{name} [{unit}]"));
        write!(w, "{}{cell}", if k == 0 { "" } else { "," })?;
    }
    w.write_all(b"\n")?;
    let rows = columns.iter().map(|c| c.2.len()).min().unwrap_or(0);
    let mut line = String::new();
    for t in 0..rows {
        line.clear();
        for (k, (_, _, values)) in columns.iter().enumerate() {
            if k > 0 {
                line.push(',');
            }
            push_number(&mut line, values[t]);
        }
        line.push('\n');
        w.write_all(line.as_bytes())?;
    }
    Ok(())
}

/// Shortest text that reads back to the same bits, in exponent form where decimals would be long.
fn push_number(line: &mut String, x: f64) {
    use std::fmt::Write as _;
    let size = x.abs();
    // Writing to a String cannot fail.
    let _ = if size != 0.0 && !(1e-5..1e16).contains(&size) {
        write!(line, "{x:e}")
    } else {
        write!(line, "{x}")
    };
}

fn quoted(cell: &str) -> String {
    if cell.contains([',', '"', '\n', '\r']) {
        format!("\"{}\"", cell.replace('"', "\"\""))
    } else {
        cell.into()
    }
}
