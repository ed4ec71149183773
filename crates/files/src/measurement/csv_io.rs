//! CSV, plain or gzip (told by the first bytes): as loggers, spreadsheets and calibration tools write it.
//!
//! Encoding, separator, preamble, header, a row of units, decimal comma and thousands are guessed by
//! [`crate::measurement::csv_dialect`], told in a note of the table where they are not the plain ones, and fixed by keys. Units
//! stand in the header, `name [unit]`, in a row below it, or as a suffix of the name, `torque_nm`. Stamps in ISO 8601 or as a
//! clock become seconds, columns of `On` and `Off` become 1 and 0; both are told in a note.

use std::collections::BTreeSet;
use std::fs::File;
use std::io::{BufReader, Read, Write};
use std::path::Path;

use csv::{ByteRecord, ReaderBuilder};
use dynocal_ident::data::Dataset;
use dynocal_numerics::registry::MemberDoc;
use flate2::{Compression, GzBuilder, read::MultiGzDecoder};

use crate::atomic;
use crate::bounds;
use crate::error::{FilesError, reason};
use crate::measurement::csv_cells;
use crate::measurement::csv_dialect::{self, CsvKeys, Dialect};
use crate::measurement::{self, Raster, Reader, Whole};
use crate::table::{Cells, Column, Table, UnitSource};
use crate::units;

/// Row of the table of formats.
pub const FORMAT: Reader = Reader {
    doc: MemberDoc { name: "csv", what: "CSV and its dialects, plain or gzip; read whole", params: &[] },
    endings: &[".csv", ".csv.gz", ".txt", ".tsv"],
    recognises: |head| head.starts_with(&[0x1f, 0x8b]),
    open: |path, keys| Ok(Box::new(Whole::new(read_with(path, &keys.csv)?))),
    write: Some(write_rasters),
    several: false,
};

/// Reads a CSV file.
///
/// # Errors
/// [`FilesError`]: unreadable, empty, ragged row, column named twice, broken gzip or text.
pub fn read(path: &Path) -> Result<Table, FilesError> {
    read_with(path, &CsvKeys::default())
}

/// Reads a CSV file in a dialect that `keys` fix in part or whole.
///
/// # Errors
/// As [`read`].
pub fn read_with(path: &Path, keys: &CsvKeys) -> Result<Table, FilesError> {
    let name = path.display().to_string();
    let fail = |e: std::io::Error| FilesError::Read { path: name.clone(), reason: reason(&e) };
    let mut bytes = Vec::new();
    File::open(path).and_then(|mut f| f.read_to_end(&mut bytes)).map_err(fail)?;
    if bytes.starts_with(&[0x1f, 0x8b]) {
        let stream = || MultiGzDecoder::new(BufReader::new(bytes.as_slice()));
        let plain = bounds::inflated(&name, &mut { bounds::MOST_INFLATED }, stream);
        let broken = |e: std::io::Error| FilesError::Malformed {
            path: name.clone(),
            format: "gzip",
            reason: e.to_string(),
        };
        bytes = plain.map_err(broken)??;
    }
    parse_with(&name, &bytes, keys)
}

/// Parses CSV text; `file` is its name for messages.
///
/// # Errors
/// As [`read`].
///
/// # Examples
/// ```
/// let table = dynocal_files::measurement::csv_io::parse("bed.csv", b"time_s,torque [Nm]\n0,30.5\n0.03,31\n").unwrap();
/// assert_eq!(table.numbers("torque", 0, 2).unwrap(), [30.5, 31.0]);
///
/// let logger = b"Logger 7\nZeit;Tq_Brake\ns;lb ft\n0,0;1.024,5\n0,1;1.025,5\n";
/// let table = dynocal_files::measurement::csv_io::parse("log.csv", logger).unwrap();
/// assert_eq!(table.numbers("Tq_Brake", 0, 2).unwrap(), [1024.5, 1025.5]);
/// assert_eq!(table.column("Tq_Brake").unwrap().unit.as_ref().unwrap().0, "lbf ft");
/// assert!(table.notes[0].contains("decimal comma, thousands by `.`, header in line 2, units in the line below"));
/// ```
pub fn parse(file: &str, bytes: &[u8]) -> Result<Table, FilesError> {
    parse_with(file, bytes, &CsvKeys::default())
}

/// As [`parse`], in a dialect that `keys` fix in part or whole.
///
/// # Errors
/// As [`read`].
pub fn parse_with(file: &str, bytes: &[u8], keys: &CsvKeys) -> Result<Table, FilesError> {
    let empty =
        || FilesError::Empty { path: file.into(), expected: "a header row and at least one row of data" };
    let encoding = keys.encoding.unwrap_or_else(|| csv_dialect::guess_encoding(bytes));
    if let Some(found) = csv_dialect::no_text(bytes, encoding) {
        return Err(FilesError::NoText { path: file.into(), found, format: "CSV" });
    }
    let text = csv_dialect::decode(bytes, encoding);
    if text.trim().is_empty() {
        return Err(empty());
    }
    let dialect = csv_dialect::guess(&text, encoding, keys);
    let delimiter = u8::try_from(dialect.separator).map_err(|_| FilesError::Malformed {
        path: file.into(),
        format: "CSV",
        reason: format!("found the separator `{}`, expected an ASCII character", dialect.separator),
    })?;
    let skip = dialect.header_line - 1;
    let body = text.split_inclusive('\n').skip(skip).map(str::len).sum::<usize>();
    let body = &text[text.len() - body..];
    let spaced = (dialect.separator == ' ').then(|| tabbed(body));
    let (body, delimiter) = spaced.as_deref().map_or((body, delimiter), |b| (b, b'\t'));
    let malformed =
        |e: csv::Error| FilesError::Malformed { path: file.into(), format: "CSV", reason: e.to_string() };
    // Flexible, because our own message names line, found and expected.
    let mut reader = ReaderBuilder::new()
        .delimiter(delimiter)
        .flexible(true)
        .has_headers(true)
        .from_reader(body.as_bytes());
    let head = reader.byte_headers().map_err(malformed)?;
    let is_number =
        |cell: &[u8]| csv_dialect::number(&String::from_utf8_lossy(cell.trim_ascii()), &dialect).is_some();
    let is_stamp = |cell: &[u8]| csv_dialect::is_stamp(&String::from_utf8_lossy(cell.trim_ascii()));
    let numbers = head.iter().any(|c| !c.trim_ascii().is_empty()) && head.iter().all(is_number);
    if numbers || head.iter().any(is_stamp) {
        let found: Vec<_> = head.iter().map(String::from_utf8_lossy).collect();
        let (path, line, found) = (file.into(), dialect.header_line, found.join(", "));
        return Err(FilesError::NoHeader { path, line, found });
    }
    let mut notes = Vec::new();
    let mut columns = header(file, head)?;
    let mut gaps: Vec<Gaps> = columns.iter().map(|_| Gaps::new()).collect();
    let mut lines = Vec::new();
    let mut record = ByteRecord::new();
    let mut units_pending = dialect.unit_row;
    while reader.read_byte_record(&mut record).map_err(malformed)? {
        let line = record.position().map_or(0, |at| line_of(body.as_bytes(), at)) + skip as u64;
        if record.len() != columns.len() {
            return Err(FilesError::Ragged {
                path: file.into(),
                line,
                found: record.len(),
                expected: columns.len(),
            });
        }
        if std::mem::take(&mut units_pending) {
            columns.iter_mut().zip(record.iter()).for_each(|(c, cell)| below(c, cell));
            continue;
        }
        for ((column, gaps), cell) in columns.iter_mut().zip(&mut gaps).zip(record.iter()) {
            push(&mut column.cells, gaps, cell, &dialect);
        }
        lines.push(line);
    }
    if lines.is_empty() {
        let columns: Vec<&str> = columns.iter().map(|c| c.name.as_str()).collect();
        let (path, line, columns) = (file.into(), dialect.header_line, columns.join(", "));
        return Err(FilesError::NoRows { path, line, columns });
    }
    if !dialect.is_plain() {
        notes.insert(0, format!("read as {}", dialect.describe()));
    }
    for (column, gaps) in columns.iter_mut().zip(&gaps) {
        notes.extend(csv_cells::interpret(column));
        if let (Cells::Number(_), Some((_, word))) = (&column.cells, gaps.first()) {
            let (n, cells) = (gaps.len(), if gaps.len() == 1 { "cell is a gap" } else { "cells are gaps" });
            notes.push(format!("column `{}`: {n} {cells} (`{word}`)", column.name));
        }
    }
    columns.retain(|c| !(c.name.is_empty() && is_blank(&c.cells)));
    name_unnamed(&mut columns, &mut notes);
    Ok(Table { file: file.into(), columns, lines, notes })
}

/// Unit of a column from the cell below its name.
fn below(column: &mut Column, cell: &[u8]) {
    let text = String::from_utf8_lossy(cell);
    let bare = text.trim().trim_matches(['[', ']', '(', ')']).trim().to_string();
    if !bare.is_empty() {
        column.unit = Some((units::normalise(&bare), UnitSource::Bracket));
    }
}

/// Line that a record begins in. Where lines end with CR LF, a record's position is before the LF of the line above.
fn line_of(body: &[u8], at: &csv::Position) -> u64 {
    let above = usize::try_from(at.byte()).is_ok_and(|k| body.get(k) == Some(&b'\n'));
    at.line() + u64::from(above)
}

/// The lines with a tab between cells, where blanks stand between them.
fn tabbed(body: &str) -> String {
    let line = |l: &str| format!("{}\n", csv_dialect::between_blanks(l).join("\t"));
    body.lines().map(line).collect()
}

fn is_blank(cells: &Cells) -> bool {
    match cells {
        Cells::Number(v) => v.iter().all(|x| x.is_nan()),
        Cells::Text(v) => v.iter().all(String::is_empty),
    }
}

/// A column without a name is called by its place, so that it can be chosen.
fn name_unnamed(columns: &mut [Column], notes: &mut Vec<String>) {
    for k in 0..columns.len() {
        let name = format!("column_{}", k + 1);
        if columns[k].name.is_empty() && columns.iter().all(|c| c.name != name) {
            notes.push(format!("column {} has no name in the header and is called `{name}`", k + 1));
            columns[k].name = name;
        }
    }
}

fn header(file: &str, cells: &ByteRecord) -> Result<Vec<Column>, FilesError> {
    measurement::bounded(file, "CSV", cells.len())?;
    let mut columns: Vec<Column> = Vec::with_capacity(cells.len());
    let mut names = BTreeSet::new();
    for cell in cells {
        let (name, unit) = units::split_header(&String::from_utf8_lossy(cell));
        let unit = match unit {
            Some(u) => Some((u, UnitSource::Bracket)),
            None => units::from_parentheses(&name)
                .or_else(|| units::from_suffix(&name).map(str::to_string))
                .map(|u| (u, UnitSource::Suffix)),
        };
        if !names.insert(name.clone()) && !name.is_empty() {
            return Err(FilesError::DuplicateColumn { path: file.into(), column: name });
        }
        columns.push(Column { name, unit, cells: Cells::Number(Vec::new()) });
    }
    Ok(columns)
}

/// Rows whose cell is a word for a missing value, and the word.
type Gaps = Vec<(usize, String)>;

/// Appends a cell; a column of numbers turns into text at the first cell that is neither a number nor a word for a gap.
fn push(cells: &mut Cells, gaps: &mut Gaps, cell: &[u8], dialect: &Dialect) {
    let text = String::from_utf8_lossy(cell.trim_ascii());
    match cells {
        Cells::Text(v) => v.push(text.into_owned()),
        Cells::Number(v) => match csv_dialect::number(&text, dialect) {
            Some(x) => v.push(x),
            None if csv_dialect::is_gap(&text) => {
                gaps.push((v.len(), text.into_owned()));
                v.push(f64::NAN);
            }
            None => {
                // An empty cell stays empty, and a word what it is.
                let word = |x: &f64| if x.is_nan() { String::new() } else { format!("{x}") };
                let mut t: Vec<String> = v.iter().map(word).collect();
                gaps.drain(..).for_each(|(row, word)| t[row] = word);
                t.push(text.into_owned());
                *cells = Cells::Text(t);
            }
        },
    }
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

/// Writes the only raster of a recording; states in words stay words.
fn write_rasters(path: &Path, rasters: &[Raster]) -> Result<(), FilesError> {
    let raster = only(path, "CSV", rasters)?;
    let mut columns = vec![("time".to_string(), "s".to_string(), Cells::Number(raster.time_s.clone()))];
    columns.extend(raster.columns.iter().map(|c| {
        let unit = c.unit.as_ref().map_or("", |u| u.0.as_str());
        (c.name.clone(), unit.to_string(), c.cells.clone())
    }));
    atomic::write_with(path, |w| {
        if path.extension().is_some_and(|e| e == "gz") {
            let mut z = GzBuilder::new().mtime(0).write(w, Compression::default());
            write_cells(&mut z, &columns)?;
            z.finish().map(|_| ())
        } else {
            write_cells(w, &columns)
        }
    })
}

/// The only raster, for formats that hold one.
pub(crate) fn only<'a>(path: &Path, format: &str, rasters: &'a [Raster]) -> Result<&'a Raster, FilesError> {
    match rasters {
        [one] => Ok(one),
        many => Err(FilesError::Write {
            path: path.display().to_string(),
            reason: format!("{} rasters, but {format} holds one: merge them first", many.len()),
        }),
    }
}

/// `name [unit]`; a channel whose unit nobody knows has none, not that of a ratio.
pub(crate) fn heading(name: &str, unit: &str) -> String {
    if unit.is_empty() { name.to_string() } else { format!("{name} [{unit}]") }
}

fn write_cells(w: &mut dyn Write, columns: &[(String, String, Cells)]) -> std::io::Result<()> {
    let head: Vec<String> = columns.iter().map(|(n, u, _)| quoted(&heading(n, u))).collect();
    writeln!(w, "{}", head.join(","))?;
    let rows = columns.iter().map(|c| c.2.len()).min().unwrap_or(0);
    let mut line = String::new();
    for t in 0..rows {
        line.clear();
        for (k, (_, _, cells)) in columns.iter().enumerate() {
            if k > 0 {
                line.push(',');
            }
            match cells {
                // A gap is an empty cell.
                Cells::Number(v) if v[t].is_nan() => {}
                Cells::Number(v) => push_number(&mut line, v[t]),
                Cells::Text(v) => line.push_str(&quoted(&v[t])),
            }
        }
        line.push('\n');
        w.write_all(line.as_bytes())?;
    }
    Ok(())
}

/// Writes columns (name, unit, values) of equal length; as [`write_dataset`], a missing sample as `NaN`.
///
/// # Errors
/// [`FilesError::Write`].
pub fn write_columns(path: &Path, columns: &[(&str, &str, &[f64])]) -> Result<(), FilesError> {
    write_columns_until(path, columns, &|| false)
}

/// The same, given up where `stop` says so: nothing is left behind then.
///
/// # Errors
/// [`FilesError::Write`].
pub fn write_columns_until(
    path: &Path,
    columns: &[(&str, &str, &[f64])],
    stop: &dyn Fn() -> bool,
) -> Result<(), FilesError> {
    let gz = path.extension().is_some_and(|e| e == "gz");
    atomic::write_with(path, |w| {
        if gz {
            // No name and no time in the gzip header: equal data, equal bytes.
            let mut z = GzBuilder::new().mtime(0).write(w, Compression::default());
            write_text(&mut z, columns, stop)?;
            z.finish().map(|_| ())
        } else {
            write_text(w, columns, stop)
        }
    })
}

fn write_text(
    w: &mut dyn Write,
    columns: &[(&str, &str, &[f64])],
    stop: &dyn Fn() -> bool,
) -> std::io::Result<()> {
    for (k, (name, unit, _)) in columns.iter().enumerate() {
        let cell = quoted(&format!("{name} [{unit}]"));
        write!(w, "{}{cell}", if k == 0 { "" } else { "," })?;
    }
    w.write_all(b"\n")?;
    let rows = columns.iter().map(|c| c.2.len()).min().unwrap_or(0);
    let mut line = String::new();
    for t in 0..rows {
        if t.is_multiple_of(4096) && stop() {
            return Err(std::io::Error::other("interrupted"));
        }
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
