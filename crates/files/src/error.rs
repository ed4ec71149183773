//! What can be wrong with a file, said with its name, place, what was found and what was expected.

use dynocal_ident::data::DataError;

/// A file cannot be read, written or understood.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum FilesError {
    /// Opening or reading failed.
    #[error("cannot read {path}: {reason}")]
    Read {
        /// File.
        path: String,
        /// What the system said.
        reason: String,
    },
    /// Writing failed; nothing half-written is left under the final name.
    #[error("cannot write {path}: {reason}")]
    Write {
        /// File.
        path: String,
        /// What the system said.
        reason: String,
    },
    /// Another run works in the folder.
    #[error("{path}: another run works in this folder: wait for its end, or give another folder")]
    Busy {
        /// Folder.
        path: String,
    },
    /// There is no data in the file.
    #[error("{path} is empty: expected {expected}")]
    Empty {
        /// File.
        path: String,
        /// What should be there.
        expected: &'static str,
    },
    /// A header without data.
    #[error(
        "{path}, line {line}: found the header ({columns}) and no row of data below it, expected at least one"
    )]
    NoRows {
        /// File.
        path: String,
        /// Line of the header.
        line: usize,
        /// Its columns.
        columns: String,
    },
    /// Bytes that are no text.
    #[error("{path}: found {found}, expected a table in text ({format})")]
    NoText {
        /// File.
        path: String,
        /// What it is.
        found: String,
        /// Format that was asked for.
        format: &'static str,
    },
    /// The ending of the name says nothing about the format.
    #[error("{path}: format not known from the name; expected {known} (or name the format)")]
    Format {
        /// File.
        path: String,
        /// Endings that are known.
        known: String,
    },
    /// The bytes do not follow the format.
    #[error("{path}: not a valid {format} file: {reason}")]
    Malformed {
        /// File.
        path: String,
        /// Format name.
        format: &'static str,
        /// What is wrong, with the place if known.
        reason: String,
    },
    /// More than may be held in memory.
    #[error(
        "{path}: found {found}, expected at most {most}: cut it, or keep fewer channels (`dynocal convert`)"
    )]
    TooLarge {
        /// File.
        path: String,
        /// Found.
        found: String,
        /// Bound.
        most: String,
    },
    /// A row has too few or too many cells.
    #[error("{path}, line {line}: found {found} cells, expected {expected} as in the header")]
    Ragged {
        /// File.
        path: String,
        /// Line in the file, from 1.
        line: u64,
        /// Cells found.
        found: usize,
        /// Cells in the header.
        expected: usize,
    },
    /// Two columns have one name.
    #[error("{path}: the header names column `{column}` twice")]
    DuplicateColumn {
        /// File.
        path: String,
        /// Column.
        column: String,
    },
    /// No column of that name.
    #[error("{path}: no column `{found}`{}; columns are: {}", did_you_mean(.nearest), .known.join(", "))]
    NoColumn {
        /// File.
        path: String,
        /// Name asked for.
        found: String,
        /// A known name that is near.
        nearest: Option<String>,
        /// Names there are.
        known: Vec<String>,
    },
    /// A cell is not a finite number.
    #[error("{path}, {place}, column `{column}`: found `{found}`, expected a finite number")]
    Cell {
        /// File.
        path: String,
        /// Line of a text file or row of a binary one, e.g. `line 17`.
        place: String,
        /// Column.
        column: String,
        /// The cell as written.
        found: String,
    },
    /// The unit in the file is not the unit that was asked for.
    #[error("{path}, column `{column}`: found unit `{found}`, expected `{expected}`{hint}")]
    Unit {
        /// File.
        path: String,
        /// Column.
        column: String,
        /// Unit in the header.
        found: String,
        /// Unit in the spec.
        expected: String,
        /// What to do about it.
        hint: String,
    },
    /// Neither file nor spec gives a unit.
    #[error(
        "{path}, column `{column}`: no unit in the header and none given; write `{column} [unit]` in the file or `unit = \"...\"` for the channel (`-` for none)"
    )]
    NoUnit {
        /// File.
        path: String,
        /// Column.
        column: String,
    },
    /// The first row holds numbers or stamps, not names.
    #[error(
        "{path}, line {line}: found values ({found:.60}), expected the names of the columns (`name [unit]`): without a header row the first sample would be lost"
    )]
    NoHeader {
        /// File.
        path: String,
        /// Line of the file, from 1.
        line: usize,
        /// The row.
        found: String,
    },
    /// A time column without a unit.
    #[error(
        "{path}, time column `{column}`: no unit in the header and none given; write `{column} [s]` in the file or `time_unit = \"s\"` in [data]"
    )]
    NoTimeUnit {
        /// File.
        path: String,
        /// Column.
        column: String,
    },
    /// Time stamps are not equally spaced.
    #[error(
        "{path}, {place}, time column `{column}`: interval {found_s} s to the row before, expected {expected_s} s: time stamps must be uniform (resample the record, or give `sample_time_s` instead of the time column)"
    )]
    NonUniformTime {
        /// File.
        path: String,
        /// First row that is off, e.g. `line 17`.
        place: String,
        /// Time column.
        column: String,
        /// Interval found, in s.
        found_s: f64,
        /// Interval expected, in s.
        expected_s: f64,
    },
    /// A time stamp occurs twice in a row.
    #[error("{path}, {place}, time column `{column}`: time stamp {time_s} s is repeated")]
    RepeatedTime {
        /// File.
        path: String,
        /// First repeated row, e.g. `line 17`.
        place: String,
        /// Time column.
        column: String,
        /// The stamp, in s.
        time_s: f64,
    },
    /// A time stamp before the one of the row above.
    #[error(
        "{path}, {place}, time column `{column}`: time stamp {time_s} s after {before_s} s, expected stamps that increase"
    )]
    BackwardTime {
        /// File.
        path: String,
        /// First row that goes back, e.g. `line 17`.
        place: String,
        /// Time column.
        column: String,
        /// The stamp, in s.
        time_s: f64,
        /// The stamp before it, in s.
        before_s: f64,
    },
    /// A selection of rows that the file does not have.
    #[error(
        "{path}: rows {from}..{to} asked for, expected a range within 0..{rows} (zero-based, end excluded)"
    )]
    Rows {
        /// File.
        path: String,
        /// First row asked for.
        from: usize,
        /// End of the range.
        to: usize,
        /// Rows in the file.
        rows: usize,
    },
    /// A selection by value that matches no row.
    #[error("{path}: no row has `{column}` = `{found}`; values are: {}", .known.join(", "))]
    NoSuchValue {
        /// File.
        path: String,
        /// Split column.
        column: String,
        /// Value asked for.
        found: String,
        /// Values there are (the first few).
        known: Vec<String>,
    },
    /// Cutting a record left nothing.
    #[error("{path}: cut {cut}: no experiment is left, expected at least one")]
    NoExperiment {
        /// File.
        path: String,
        /// Where it was cut.
        cut: String,
    },
    /// The folder holds something that is not this run.
    #[error(
        "{path} is not empty and not a run of `dynocal {expected}` ({found}): choose another --out folder or remove it"
    )]
    ForeignFolder {
        /// Folder.
        path: String,
        /// What was met there.
        found: String,
        /// The verb that wanted to write there.
        expected: String,
    },
    /// The folder has the name of this spec, and holds the run of another one of that name.
    #[error(
        "{path} holds the run of another spec of that name, {other}: choose another folder (--out) or another `name` in the spec, or remove the folder"
    )]
    OtherSpec {
        /// Folder.
        path: String,
        /// The other spec, which is still there.
        other: String,
    },
    /// A JSON file of another kind or a newer version.
    #[error("{path}: found {found}, expected {expected}")]
    Schema {
        /// File.
        path: String,
        /// What the file says it is.
        found: String,
        /// What was to be read.
        expected: String,
    },
    /// Rasters that cannot be brought onto one time axis.
    #[error("{path}: the rasters cannot be merged: {reason}")]
    Merge {
        /// File.
        path: String,
        /// Why.
        reason: String,
    },
    /// The record itself is not usable.
    #[error(transparent)]
    Data(#[from] DataError),
}

fn did_you_mean(nearest: &Option<String>) -> String {
    nearest.as_ref().map(|n| format!(" (did you mean `{n}`?)")).unwrap_or_default()
}

/// The system's reason in the user's terms.
impl FilesError {
    /// That `path` could not be read, in plain words.
    pub fn unread(path: &std::path::Path, e: &std::io::Error) -> Self {
        Self::Read { path: path.display().to_string(), reason: reason(e) }
    }
}

pub(crate) fn reason(e: &std::io::Error) -> String {
    use std::io::ErrorKind as K;
    let plain = match e.kind() {
        K::StorageFull | K::QuotaExceeded => "the disk is full",
        K::PermissionDenied => "no permission",
        K::ReadOnlyFilesystem => "the file system is read-only",
        K::NotADirectory => "a part of the path is a file, not a folder",
        K::IsADirectory => "it is a folder",
        K::NotFound => "no such file or folder",
        _ => return e.to_string(),
    };
    plain.to_string()
}
