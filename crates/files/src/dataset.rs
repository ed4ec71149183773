//! From a table to experiments: channel roles and units, time, trajectories, split.

mod clock;

use std::borrow::Cow;
use std::collections::BTreeMap;
use std::path::Path;

use dynocal_ident::data::{Channel, Dataset, Role};
use serde::{Deserialize, Serialize};

use clock::clock;

use crate::error::FilesError;
use crate::measurement::{self, FORMATS, ReadKeys};
use crate::measurement::{csv_io, merge, parquet_io};
use crate::split::{self, Cut};
use crate::table::{self, Column, Table, UnitSource};
use crate::units;

/// A column that becomes a channel.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct ChannelSpec {
    /// Column in the file.
    pub column: String,
    /// Name of the channel; usually that of the column.
    pub name: String,
    /// Unit that is expected; where absent the file must give it.
    pub unit: Option<String>,
    /// Whether a differing unit of the file is converted (exact conversions only) instead of refused.
    pub convert: bool,
    /// Role.
    pub role: Role,
}

/// Where time comes from.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub enum Time {
    /// There is none: rows are points in no order. The sample time of their dataset is 1 and says nothing.
    #[default]
    Steady,
    /// Rows are this many seconds apart.
    Sampled {
        /// Sample time in s.
        sample_time_s: f64,
    },
    /// A column of time stamps, checked to be uniform.
    Column {
        /// Column name.
        column: String,
        /// Unit of the stamps where the file does not say it.
        unit: Option<String>,
    },
    /// A column of time stamps that only have to increase. They become an auxiliary channel [`STAMPS`] in s, and the
    /// sample time is NaN until the record is resampled.
    Stamps {
        /// Column name.
        column: String,
        /// Unit of the stamps where the file does not say it.
        unit: Option<String>,
    },
}

/// Name of the channel that holds the stamps of [`Time::Stamps`].
pub const STAMPS: &str = "time";

/// How a table is read.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Layout {
    /// Channels.
    pub channels: Vec<ChannelSpec>,
    /// Time.
    pub time: Time,
    /// Column whose change starts a new experiment.
    pub trajectory: Option<String>,
    /// Triggers or pauses that cut the record into experiments.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub cut: Option<Cut>,
    /// Leading samples of every experiment that only initialise states.
    pub init_samples: usize,
    /// What an empty cell means.
    #[serde(default)]
    pub missing: Missing,
}

/// What an empty cell or NaN in a channel means.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Missing {
    /// A fault of the file.
    #[default]
    Refuse,
    /// A missing sample, NaN in the dataset.
    Mark,
}

/// Which rows.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub enum Select {
    /// All.
    All,
    /// Those where `column` is one of `values`.
    Values {
        /// Split column.
        column: String,
        /// Values as text (`10` matches the number 10).
        values: Vec<String>,
    },
    /// Zero-based half-open ranges of data rows.
    Rows(Vec<(usize, usize)>),
}

/// Name of a measurement format: a row of [`FORMATS`].
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(into = "String")]
pub struct Format(&'static str);

// By hand: a derived one would borrow the name from the text.
impl<'de> Deserialize<'de> for Format {
    fn deserialize<D: serde::Deserializer<'de>>(from: D) -> Result<Self, D::Error> {
        Self::try_from(String::deserialize(from)?).map_err(serde::de::Error::custom)
    }
}

impl From<Format> for String {
    fn from(f: Format) -> String {
        f.0.into()
    }
}

impl TryFrom<String> for Format {
    type Error = String;

    fn try_from(name: String) -> Result<Self, String> {
        let known = || FORMATS.iter().map(|f| f.doc.name).collect::<Vec<_>>().join(", ");
        match FORMATS.iter().find(|f| f.doc.name == name) {
            Some(f) => Ok(Self(f.doc.name)),
            None => Err(format!("unknown format `{name}`, expected one of {}", known())),
        }
    }
}

/// Reads a file as a table, told nothing about it but its format, or not even that: [`read_table_with`].
///
/// # Errors
/// [`FilesError`].
pub fn read_table(path: &Path, format: Option<Format>) -> Result<Table, FilesError> {
    read_table_with(path, format, &ReadKeys::default())
}

/// Reads a file as a table; without `format` its first bytes, then the ending of its name tell it. A file of several
/// rasters is merged on one time axis as `keys.merge` says; by default on that of the raster with most samples, other
/// channels held. What was decided and what was lost stands in the notes of the table.
///
/// # Errors
/// [`FilesError`].
///
/// # Examples
/// ```
/// use dynocal_files::dataset::read_table_with;
/// use dynocal_files::measurement::ReadKeys;
/// let tmp = tempfile::tempdir().unwrap();
/// let path = tmp.path().join("bed.csv");
/// std::fs::write(&path, "time [s],Tq_Brake [Nm]\n0,30.5\n0.02,31\n").unwrap();
/// let keys = ReadKeys { alias: [("torque".into(), vec!["trq".into(), "Tq_Brake".into()])].into(), ..Default::default() };
/// let table = read_table_with(&path, None, &keys).unwrap();
/// assert_eq!(table.numbers("torque", 0, 2).unwrap(), [30.5, 31.0]);
/// assert_eq!(table.notes, ["column `Tq_Brake` is taken as `torque`"]);
/// ```
pub fn read_table_with(path: &Path, format: Option<Format>, keys: &ReadKeys) -> Result<Table, FilesError> {
    // A name that says nothing is refused before the file is opened: the better message.
    if format.is_none() && measurement::by_ending(path).is_none() && !path.exists() {
        return Err(FilesError::Format { path: path.display().to_string(), known: measurement::endings() });
    }
    let name = match format {
        Some(Format(name)) => name,
        None => measurement::recognise(path)?.doc.name,
    };
    // Tables as they are, so that messages name lines; others have groups.
    let one_axis = keys.merge.sample_time_s.is_none();
    let mut table = match name {
        "csv" if one_axis => csv_io::read_with(path, &keys.csv)?,
        "parquet" if one_axis => parquet_io::read(path)?,
        name => {
            let source = measurement::open(path, Some(name), keys)?;
            merge::whole(source.as_ref(), &keys.merge)?
        }
    };
    let renamed = table::rename(&mut table.columns.iter_mut().collect::<Vec<_>>(), &keys.alias);
    table.notes.extend(renamed);
    Ok(table)
}

/// Reads one experiment that [`csv_io::write_dataset`] wrote, or any measurement file with a column of time (by its usual
/// names) and units. Columns that are neither input nor output become auxiliary.
///
/// # Errors
/// [`FilesError`].
///
/// # Examples
/// ```
/// use dynocal_files::{csv_io, dataset};
/// use dynocal_ident::data::{Channel, Dataset, Role};
/// let channel = |name: &str, unit: &str, role, values| Channel { name: name.into(), unit: unit.into(), role, values };
/// let data = Dataset {
///     name: "ident01".into(),
///     sample_time_s: 0.03,
///     channels: vec![
///         channel("inj", "mg", Role::Input, vec![20.0, 21.0, 22.5]),
///         channel("torque", "Nm", Role::Output, vec![30.0, 31.0 / 3.0, 33.0]),
///     ],
///     init_samples: 0,
///     origin: "doc".into(),
/// };
/// let tmp = tempfile::tempdir().unwrap();
/// let path = tmp.path().join("ident01.csv.gz");
/// csv_io::write_dataset(&path, &data).unwrap();
/// let back = dataset::read_dataset(&path, &["inj"], &["torque"]).unwrap();
/// assert_eq!(back.channels, data.channels);
/// assert_eq!(back.sample_time_s, data.sample_time_s);
/// ```
pub fn read_dataset(path: &Path, inputs: &[&str], outputs: &[&str]) -> Result<Dataset, FilesError> {
    read_dataset_told(path, inputs, outputs, &|_| ())
}

/// As [`read_dataset`]; what was decided or lost while the file was read goes to `tell`.
///
/// # Errors
/// As [`read_dataset`].
pub fn read_dataset_told(
    path: &Path,
    inputs: &[&str],
    outputs: &[&str],
    tell: &dyn Fn(&str),
) -> Result<Dataset, FilesError> {
    let table = read_table(path, None)?;
    table.notes.iter().for_each(|n| tell(n));
    let time = measurement::time_column(&table).map_or("time", |c| c.name.as_str()).to_string();
    for name in inputs.iter().chain(outputs) {
        table.column(name)?;
    }
    let role = |name: &str| {
        if inputs.contains(&name) {
            Role::Input
        } else if outputs.contains(&name) {
            Role::Output
        } else {
            Role::Auxiliary
        }
    };
    let channels = table
        .columns
        .iter()
        .filter(|c| c.name != time)
        .map(|c| ChannelSpec {
            column: c.name.clone(),
            name: c.name.clone(),
            unit: None,
            convert: false,
            role: role(&c.name),
        })
        .collect();
    let time = Time::Column { column: time, unit: None };
    let layout = Layout { channels, time, ..Layout::default() };
    let mut all = datasets(&table, &layout, &Select::All)?;
    let mut data = all.remove(0);
    let name = path.file_name().map(|n| n.to_string_lossy().into_owned()).unwrap_or_default();
    data.name = name.split('.').next().unwrap_or(&name).to_string();
    Ok(data)
}

/// The experiments of a table: every contiguous run of selected rows with one trajectory value is one.
///
/// # Errors
/// [`FilesError`]: column or unit missing or different, cell not finite, time not uniform, selection empty.
pub fn datasets(table: &Table, layout: &Layout, select: &Select) -> Result<Vec<Dataset>, FilesError> {
    let units = layout
        .channels
        .iter()
        .map(|c| unit_of(table, table.column(&c.column)?, c))
        .collect::<Result<Vec<_>, _>>()?;
    let runs = ranges(table, layout, select)?;
    let mut seen = BTreeMap::new();
    let mut out = Vec::with_capacity(runs.len());
    for (from, to) in runs {
        let mut channels = Vec::with_capacity(layout.channels.len());
        for (spec, (unit, scale, offset)) in layout.channels.iter().zip(&units) {
            let raw = match layout.missing {
                Missing::Refuse => Cow::Borrowed(table.numbers(&spec.column, from, to)?),
                Missing::Mark => table.numbers_or_missing(&spec.column, from, to)?,
            };
            let values = if *scale == 1.0 && *offset == 0.0 {
                raw.to_vec()
            } else {
                raw.iter().map(|x| x * scale + offset).collect()
            };
            channels.push(Channel { name: spec.name.clone(), unit: unit.clone(), role: spec.role, values });
        }
        let (sample_time_s, stamps) = clock(table, &layout.time, from, to)?;
        channels.extend(stamps);
        let data = Dataset {
            name: experiment_name(table, layout, from, &mut seen)?,
            sample_time_s,
            channels,
            init_samples: layout.init_samples,
            origin: format!("{}, {} to {}", table.file, table.place(from), table.place(to - 1)),
        };
        if layout.missing == Missing::Refuse && !matches!(layout.time, Time::Stamps { .. }) {
            data.check()?;
        }
        out.push(data);
    }
    Ok(out)
}

/// Unit of a channel with the scale and offset that bring the column into it.
fn unit_of(table: &Table, column: &Column, spec: &ChannelSpec) -> Result<(String, f64, f64), FilesError> {
    let wanted = spec.unit.as_deref().map(units::normalise);
    match (&column.unit, wanted) {
        (None, None) => Err(FilesError::NoUnit { path: table.file.clone(), column: column.name.clone() }),
        (None, Some(w)) => Ok((w, 1.0, 0.0)),
        (Some((found, _)), None) => Ok((found.clone(), 1.0, 0.0)),
        (Some((found, _)), Some(w)) if *found == w => Ok((w, 1.0, 0.0)),
        // `roughness_s` need not be in seconds: a spec that says "no unit" overrules the hint of a suffix.
        (Some((_, UnitSource::Suffix)), Some(w)) if w == "-" => Ok((w, 1.0, 0.0)),
        (Some((found, _)), Some(w)) => match units::conversion(found, &w) {
            Some((scale, offset)) if spec.convert => Ok((w, scale, offset)),
            exact => Err(FilesError::Unit {
                path: table.file.clone(),
                column: column.name.clone(),
                found: found.clone(),
                expected: w.clone(),
                hint: match (exact, units::dimension(found), units::dimension(&w)) {
                    (Some(_), ..) => " (`convert = true` for this channel converts it)".into(),
                    (None, Some(a), Some(b)) if a != b => format!(": {a} cannot become {b}"),
                    _ => String::new(),
                },
            }),
        },
    }
}

/// Half-open row ranges of the experiments.
fn ranges(table: &Table, layout: &Layout, select: &Select) -> Result<Vec<(usize, usize)>, FilesError> {
    let rows = table.rows();
    let mut ranges = match select {
        Select::All => vec![(0, rows)],
        Select::Rows(r) => {
            if let Some((from, to)) = r.iter().find(|(a, b)| a >= b || *b > rows) {
                return Err(FilesError::Rows { path: table.file.clone(), from: *from, to: *to, rows });
            }
            r.clone()
        }
        Select::Values { column, values } => rows_with(table, column, values)?,
    };
    if let Some(name) = &layout.trajectory {
        let cells = &table.column(name)?.cells;
        let of = |(from, to): (usize, usize)| {
            let same = |a: usize, b: usize| cells.same(from + a, from + b);
            split::runs(to - from, same)
                .into_iter()
                .map(move |(a, b)| (from + a, from + b))
                .collect::<Vec<_>>()
        };
        ranges = ranges.into_iter().flat_map(of).collect();
    }
    if let Some(cut) = &layout.cut {
        ranges = split::within(&ranges, &split::experiments(table, cut)?.ranges);
        if ranges.is_empty() {
            let cut = "so that the selected rows lie in none of the experiments".into();
            return Err(FilesError::NoExperiment { path: table.file.clone(), cut });
        }
    }
    Ok(ranges)
}

/// Contiguous ranges of rows whose `column` is one of `values`; every value must occur.
fn rows_with(table: &Table, column: &str, values: &[String]) -> Result<Vec<(usize, usize)>, FilesError> {
    let cells = &table.column(column)?.cells;
    let mut ranges: Vec<(usize, usize)> = Vec::new();
    let mut met = vec![false; values.len()];
    let mut known: Vec<String> = Vec::new();
    let mut current: Option<usize> = None;
    for row in 0..table.rows() {
        // Labels are only made where the value changes: files are long, splits are few.
        if row == 0 || !cells.same(row - 1, row) {
            let label = cells.label(row);
            current = values.iter().position(|v| *v == label);
            if known.len() < 12 && !known.contains(&label) {
                known.push(label);
            }
        }
        let Some(k) = current else { continue };
        met[k] = true;
        match ranges.last_mut() {
            Some(r) if r.1 == row => r.1 = row + 1,
            _ => ranges.push((row, row + 1)),
        }
    }
    match met.iter().position(|m| !m) {
        Some(k) => Err(FilesError::NoSuchValue {
            path: table.file.clone(),
            column: column.into(),
            found: values[k].clone(),
            known,
        }),
        None => Ok(ranges),
    }
}

fn experiment_name(
    table: &Table,
    layout: &Layout,
    row: usize,
    seen: &mut BTreeMap<String, usize>,
) -> Result<String, FilesError> {
    let base = match &layout.trajectory {
        Some(name) => format!("{name}-{}", table.column(name)?.cells.label(row)),
        None => "record".into(),
    };
    let count = seen.entry(base.clone()).or_insert(0);
    *count += 1;
    Ok(if *count == 1 { base } else { format!("{base}.{count}") })
}
