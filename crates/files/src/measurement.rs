//! Measurement files of any format: what is in them, and their values in pieces.
//!
//! A file holds groups; a group is one raster: channels that were sampled together, one of them time. Formats are the
//! rows of [`FORMATS`]; each opens a file as a [`Source`], which lists groups without reading values and then hands out
//! the values chunk by chunk, so that a file may be larger than the memory.

mod csv_cells;
pub mod csv_dialect;
pub mod csv_io;
pub mod mat;
pub mod mat5;
#[cfg(feature = "mat73")]
pub mod mat73;
#[cfg(feature = "mdf")]
pub mod mdf3;
#[cfg(feature = "mdf")]
pub mod mdf4;
#[cfg(feature = "mdf")]
mod mdf4_columns;
pub mod merge;
pub mod mlg;
pub mod mlg_write;
pub mod msl;
pub mod parquet_io;

use std::collections::BTreeMap;
use std::io::Read;
use std::path::Path;

use dynocal_numerics::registry::{MemberDoc, nearest};
use serde::{Deserialize, Serialize};

use crate::error::{FilesError, reason};
use crate::measurement::csv_dialect::CsvKeys;
use crate::table::{Cells, Column, Table, UnitSource};
use crate::units;

/// A channel before its values are read.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct ChannelInfo {
    /// Name as in the file.
    pub name: String,
    /// Unit, normalised, where the file says one.
    pub unit: Option<String>,
    /// Comment of the file.
    pub comment: String,
    /// Whether the values are states in words.
    pub text: bool,
}

/// One raster of a file.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct GroupInfo {
    /// Name or comment; may be empty.
    pub name: String,
    /// Channels, time among them.
    pub channels: Vec<ChannelInfo>,
    /// Index of the channel that holds time, where the file says which.
    pub time: Option<usize>,
    /// Number of rows.
    pub rows: u64,
}

/// What takes the chunks of a group: one [`Cells`] for each wanted channel, all of equal length.
pub type TakeChunk<'a> = dyn FnMut(&[Cells]) -> Result<(), FilesError> + 'a;

/// An opened measurement file.
pub trait Source {
    /// File for messages.
    fn file(&self) -> &str;

    /// Its groups.
    fn groups(&self) -> &[GroupInfo];

    /// What was decided or lost on the way in, in the user's words.
    fn notes(&self) -> &[String];

    /// Hands the values of `channels` of group `group` to `take`, in order, chunk by chunk. Samples that the file marks
    /// as invalid are NaN.
    ///
    /// # Errors
    /// [`FilesError`] of the file, or what `take` returned.
    fn chunks(&self, group: usize, channels: &[usize], take: &mut TakeChunk<'_>) -> Result<(), FilesError>;
}

/// What the readers may be told.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct ReadKeys {
    /// Dialect of CSV files.
    pub csv: CsvKeys,
    /// How several rasters come to one time axis.
    pub merge: merge::Keys,
    /// Names that a channel may have in files, by the name that it gets: the first that is there is taken.
    pub alias: BTreeMap<String, Vec<String>>,
}

/// Opens a file.
pub type OpenFile = fn(&Path, &ReadKeys) -> Result<Box<dyn Source>, FilesError>;
/// Writes rasters to a file.
pub type WriteFile = fn(&Path, &[Raster]) -> Result<(), FilesError>;

/// A row of [`FORMATS`].
pub struct Reader {
    /// Name and one line.
    pub doc: MemberDoc,
    /// Endings of file names, with the point.
    pub endings: &'static [&'static str],
    /// Whether the first bytes of a file (up to 512) are this format's.
    pub recognises: fn(&[u8]) -> bool,
    /// Opens a file.
    pub open: OpenFile,
    /// Writes rasters, where the format can be written.
    pub write: Option<WriteFile>,
    /// Whether a written file holds several rasters, or one.
    pub several: bool,
}

/// Measurement formats.
pub static FORMATS: &[Reader] = &[
    csv_io::FORMAT,
    parquet_io::FORMAT,
    #[cfg(feature = "mdf")]
    mdf4::FORMAT,
    #[cfg(feature = "mdf")]
    mdf3::FORMAT,
    mat5::FORMAT,
    #[cfg(feature = "mat73")]
    mat73::FORMAT,
    mlg::FORMAT,
    msl::FORMAT,
];

/// Opens `path`; without `format` its first bytes and then the ending of its name tell the format.
///
/// # Errors
/// [`FilesError`]: unreadable, format not known, or broken.
///
/// # Examples
/// ```
/// use dynocal_files::measurement::{ReadKeys, open};
/// let tmp = tempfile::tempdir().unwrap();
/// let path = tmp.path().join("bed.csv");
/// std::fs::write(&path, "time [s],torque [Nm]\n0,30.5\n0.02,31\n").unwrap();
/// let source = open(&path, None, &ReadKeys::default()).unwrap();
/// assert_eq!(source.groups()[0].channels[1].unit.as_deref(), Some("Nm"));
/// ```
pub fn open(path: &Path, format: Option<&str>, keys: &ReadKeys) -> Result<Box<dyn Source>, FilesError> {
    let row = match format {
        Some(name) => FORMATS.iter().find(|f| f.doc.name == name).ok_or_else(|| unknown(path, name))?,
        None => recognise(path)?,
    };
    (row.open)(path, keys)
}

fn unknown(path: &Path, name: &str) -> FilesError {
    let known: Vec<String> = FORMATS.iter().map(|f| f.doc.name.to_string()).collect();
    let hint = nearest(name, &known).map(|n| format!(" (did you mean `{n}`?)")).unwrap_or_default();
    FilesError::Schema {
        path: path.display().to_string(),
        found: format!("format `{name}`{hint}"),
        expected: format!("one of {}", known.join(", ")),
    }
}

/// The row of the table for a file.
///
/// # Errors
/// [`FilesError::Read`], [`FilesError::Format`].
pub fn recognise(path: &Path) -> Result<&'static Reader, FilesError> {
    let fail = |e: std::io::Error| FilesError::Read { path: path.display().to_string(), reason: reason(&e) };
    let mut head = Vec::new();
    std::fs::File::open(path).and_then(|f| f.take(512).read_to_end(&mut head)).map_err(fail)?;
    if let Some(row) = FORMATS.iter().find(|f| (f.recognises)(&head)) {
        return Ok(row);
    }
    by_ending(path).ok_or_else(|| FilesError::Format { path: path.display().to_string(), known: endings() })
}

/// The row of the table for the ending of a name.
pub fn by_ending(path: &Path) -> Option<&'static Reader> {
    let name = path.file_name().map(|n| n.to_string_lossy().to_lowercase()).unwrap_or_default();
    FORMATS.iter().find(|f| f.endings.iter().any(|e| name.ends_with(e)))
}

/// All endings, for messages.
pub fn endings() -> String {
    let mut all: Vec<&str> = FORMATS.iter().flat_map(|f| f.endings.iter().copied()).collect();
    all.dedup();
    all.join(", ")
}

/// Channels of a group as a table.
///
/// # Errors
/// As [`Source::chunks`].
pub fn table(source: &dyn Source, group: usize, channels: &[usize]) -> Result<Table, FilesError> {
    let info = &source.groups()[group];
    crate::bounds::held(source.file(), info.rows, channels.len())?;
    let mut columns: Vec<Column> = channels
        .iter()
        .map(|c| {
            let c = &info.channels[*c];
            let unit = c.unit.clone().map(|u| (u, UnitSource::Bracket));
            Column { name: c.name.clone(), unit, cells: Cells::Number(Vec::new()) }
        })
        .collect();
    source.chunks(group, channels, &mut |chunk| {
        columns.iter_mut().zip(chunk).for_each(|(c, cells)| append(&mut c.cells, cells));
        Ok(())
    })?;
    Ok(Table { file: source.file().into(), columns, lines: Vec::new(), notes: source.notes().to_vec() })
}

fn append(to: &mut Cells, from: &Cells) {
    match (to, from) {
        (Cells::Number(a), Cells::Number(b)) => a.extend_from_slice(b),
        (Cells::Text(a), Cells::Text(b)) => a.extend_from_slice(b),
        (Cells::Text(a), Cells::Number(b)) => a.extend(b.iter().map(|x| format!("{x}"))),
        (to @ Cells::Number(_), Cells::Text(b)) => {
            let mut text: Vec<String> = (0..to.len()).map(|r| to.label(r)).collect();
            text.extend_from_slice(b);
            *to = Cells::Text(text);
        }
    }
}

/// One raster in memory: time in s and its channels.
#[derive(Clone, Debug, PartialEq)]
pub struct Raster {
    /// Name.
    pub name: String,
    /// Stamps in s.
    pub time_s: Vec<f64>,
    /// Channels, each as long as `time_s`.
    pub columns: Vec<Column>,
}

/// The rasters of a file in memory.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Recording {
    /// Groups that have a time channel and rows.
    pub rasters: Vec<Raster>,
    /// Groups that were left out, channels that got another name: in the user's words.
    pub notes: Vec<String>,
}

/// All groups of a file that have a time channel, with stamps in s and repeated names made distinct
/// (`speed`, `speed@2` for the second group); what is left out stands in the notes.
///
/// # Errors
/// [`FilesError`] of the file, or a time channel that is not in a unit of time.
pub fn recording(source: &dyn Source) -> Result<Recording, FilesError> {
    recording_of(source, &|_| true)
}

/// As [`recording`], but only the channels whose name (made distinct) `keep` wants are read.
///
/// # Errors
/// As [`recording`].
pub fn recording_of(source: &dyn Source, keep: &dyn Fn(&str) -> bool) -> Result<Recording, FilesError> {
    let mut names: Vec<String> = Vec::new();
    let mut out = Recording::default();
    for (g, info) in source.groups().iter().enumerate() {
        let time = info.time.or_else(|| time_channel(info));
        let Some(time) = time.filter(|_| info.rows > 0) else {
            out.notes.push(left_out(g, info));
            continue;
        };
        let (mut wanted, mut called) = (vec![time], Vec::new());
        for (k, c) in info.channels.iter().enumerate().filter(|(k, _)| *k != time) {
            let name = distinct(&c.name, g, &names);
            if name != c.name {
                out.notes.push(format!("channel `{}` of group {} is called `{name}`", c.name, g + 1));
            }
            names.push(name.clone());
            if keep(&name) {
                wanted.push(k);
                called.push(name);
            }
        }
        if called.is_empty() && info.channels.len() > 1 {
            continue;
        }
        let mut columns = table(source, g, &wanted)?.columns;
        let time_s = seconds(source.file(), &columns.remove(0))?;
        columns.iter_mut().zip(called).for_each(|(c, name)| c.name = name);
        out.rasters.push(Raster { name: info.name.clone(), time_s, columns });
    }
    Ok(out)
}

/// `name`, or where it is taken `name@2` in the second group, `name@2.2` for the second of that group.
fn distinct(name: &str, group: usize, taken: &[String]) -> String {
    let mut out = name.to_string();
    let mut count = 0;
    while taken.contains(&out) {
        count += 1;
        let more = if count > 1 { format!(".{count}") } else { String::new() };
        out = format!("{name}@{}{more}", group + 1);
    }
    out
}

/// What is said of a group that has no place in time.
fn left_out(g: usize, info: &GroupInfo) -> String {
    let name = if info.name.is_empty() { String::new() } else { format!(" `{}`", info.name) };
    let why = if info.rows == 0 { "holds no rows" } else { "has no time channel" };
    let all: Vec<&str> = info.channels.iter().map(|c| c.name.as_str()).collect();
    let more = if all.len() > 5 { ", .." } else { "" };
    let first = all[..all.len().min(5)].join(", ");
    format!("group {}{name} {why}: its {} channels ({first}{more}) are left out", g + 1, all.len())
}

/// The channel that is time by its name, or the first with a unit of time.
pub fn time_channel(info: &GroupInfo) -> Option<usize> {
    // A unit alone says it of the first channel only: an injection may be in ms.
    let timed = |c: &ChannelInfo| c.unit.as_deref().and_then(units::dimension) == Some("time");
    let first = || info.channels.first().filter(|c| timed(c)).map(|_| 0);
    info.channels.iter().position(|c| is_time(&c.name)).or_else(first)
}

/// The column of a table that is time: `time` itself, else the first with a usual name and a unit of time. A unit alone is not
/// enough here: an injection may be in ms; neither is a name: `t` may be a torque.
pub fn time_column(table: &Table) -> Option<&Column> {
    let timed = |c: &Column| c.unit.as_ref().and_then(|u| units::dimension(&u.0)) == Some("time");
    let usual = || table.columns.iter().find(|c| is_time(&c.name) && timed(c));
    table.column("time").ok().or_else(usual)
}

/// Whether a column of this name and unit, where it has one, would be taken for the time of a file.
pub fn looks_like_time(name: &str, unit: Option<&str>) -> bool {
    is_time(name) && unit.is_none_or(|u| units::dimension(u) == Some("time"))
}

fn is_time(name: &str) -> bool {
    const NAMES: [&str; 5] = ["time", "t", "timestamp", "timestamps", "zeit"];
    let of_time = |suffix: &str| units::dimension(suffix) == Some("time");
    let stem = name.rsplit_once('_').filter(|(_, suffix)| of_time(suffix)).map_or(name, |(stem, _)| stem);
    NAMES.iter().any(|n| stem.eq_ignore_ascii_case(n))
}

/// The measurement files in `folder` that are called `stem` with any ending of the table.
pub fn called(folder: &Path, stem: &str) -> Vec<std::path::PathBuf> {
    let mut all: Vec<&str> = FORMATS.iter().flat_map(|f| f.endings.iter().copied()).collect();
    all.sort_unstable();
    all.dedup();
    all.iter().map(|e| folder.join(format!("{stem}{e}"))).filter(|p| p.is_file()).collect()
}

fn seconds(file: &str, stamps: &Column) -> Result<Vec<f64>, FilesError> {
    let unit = stamps.unit.as_ref().map_or("s", |u| u.0.as_str());
    let (scale, _) = units::conversion(unit, "s").ok_or_else(|| FilesError::Unit {
        path: file.into(),
        column: stamps.name.clone(),
        found: unit.into(),
        expected: "s".into(),
        hint: " (or another unit of time)".into(),
    })?;
    match &stamps.cells {
        Cells::Number(v) => Ok(v.iter().map(|t| t * scale).collect()),
        Cells::Text(v) => Err(FilesError::Cell {
            path: file.into(),
            place: "row 1".into(),
            column: stamps.name.clone(),
            found: v.first().cloned().unwrap_or_default(),
        }),
    }
}

/// A whole table as a source of one group: for formats that are read at once.
pub struct Whole {
    table: Table,
    groups: [GroupInfo; 1],
}

impl Whole {
    /// Wraps `table`.
    pub fn new(table: Table) -> Self {
        let channels = table
            .columns
            .iter()
            .map(|c| ChannelInfo {
                name: c.name.clone(),
                unit: c.unit.as_ref().map(|u| u.0.clone()),
                comment: String::new(),
                text: matches!(c.cells, Cells::Text(_)),
            })
            .collect();
        let mut group = GroupInfo { name: String::new(), channels, time: None, rows: table.rows() as u64 };
        group.time = time_channel(&group);
        Self { table, groups: [group] }
    }
}

impl Source for Whole {
    fn file(&self) -> &str {
        &self.table.file
    }

    fn groups(&self) -> &[GroupInfo] {
        &self.groups
    }

    fn notes(&self) -> &[String] {
        &self.table.notes
    }

    fn chunks(&self, _group: usize, channels: &[usize], take: &mut TakeChunk<'_>) -> Result<(), FilesError> {
        let cells: Vec<Cells> = channels.iter().map(|c| self.table.columns[*c].cells.clone()).collect();
        take(&cells)
    }
}

/// Most columns of a table.
pub const MOST_COLUMNS: usize = 20_000;

/// A table of so many columns is refused before anything is read of them.
fn bounded(file: &str, format: &'static str, columns: usize) -> Result<(), FilesError> {
    if columns <= MOST_COLUMNS {
        return Ok(());
    }
    let reason = format!("found {columns} columns, expected at most {MOST_COLUMNS}");
    Err(FilesError::Malformed { path: file.into(), format, reason })
}
