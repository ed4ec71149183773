//! Measurement files.

use std::path::{Path, PathBuf};

use dynocal_files::FilesError;
use dynocal_files::dataset::{ChannelSpec, Format, Layout, Missing, Select, Time, datasets, read_table_with};
use dynocal_files::measurement::{ReadKeys, csv_io, looks_like_time, parquet_io, time_column};
use dynocal_files::table::{Cells, Column, Table};
use dynocal_ident::data::{Dataset, Role};
use dynocal_jobs::convert::{Conversion, convert as convert_file};
use dynocal_jobs::show;
use dynocal_numerics::watch::Watch;
use pyo3::prelude::*;
use serde::Deserialize;
use serde::de::DeserializeOwned;

use crate::errors::{Kind, Refusal};
use crate::record::Record;
use crate::values::table;
use crate::watched::watched;

/// How a file is read, as the facade says it.
#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Reading {
    format: Option<String>,
    #[serde(default)]
    keys: ReadKeys,
    /// Column and name of each channel; none: every column of numbers.
    channels: Option<Vec<(String, String)>>,
    /// Unit by the name of a channel.
    #[serde(default)]
    units: std::collections::BTreeMap<String, String>,
    /// Column of time stamps, where it does not have one of the usual names.
    time: Option<String>,
    time_unit: Option<String>,
    sample_time_s: Option<f64>,
    #[serde(default)]
    steady: bool,
    #[serde(default)]
    missing: bool,
    #[serde(default)]
    inputs: Vec<String>,
    #[serde(default)]
    outputs: Vec<String>,
}

/// A mapping as a type of ours; keys that it does not have are named.
fn parsed<T: DeserializeOwned>(what: &str, keys: &Bound<'_, PyAny>) -> PyResult<T> {
    let keys = table(keys, what)?;
    let found =
        T::deserialize(keys).map_err(|e| Refusal::new(Kind::Argument, format!("{what}: {}", e.message())));
    Ok(found?)
}

fn format(name: Option<String>) -> Result<Option<Format>, Refusal> {
    name.map(Format::try_from)
        .transpose()
        .map_err(|text| Refusal::new(Kind::Argument, format!("format: {text}")))
}

/// Reads a measurement file: its record, and what was decided or lost on the way in.
#[pyfunction]
pub(crate) fn read(py: Python<'_>, path: PathBuf, how: &Bound<'_, PyAny>) -> PyResult<(Record, Vec<String>)> {
    let how: Reading = parsed("read", how)?;
    let (data, notes) = watched(py, None, move |_| read_file(&path, how))??;
    Ok((data.into(), notes))
}

fn read_file(path: &Path, how: Reading) -> Result<(Dataset, Vec<String>), Refusal> {
    let mut keys = how.keys;
    let format = format(how.format)?;
    let mut table = read_table_with(path, format, &keys)?;
    // Points have no time: what looks like it is no channel, unless somebody asks for it.
    let stamped = how.time.clone().or_else(|| time_column(&table).map(|c| c.name.clone()));
    let stamps = stamped.clone().filter(|_| !how.steady);
    if let (Some(_), Some(dt)) = (&stamps, how.sample_time_s)
        && keys.merge.sample_time_s.is_none()
    {
        // The file has a time of its own: it is brought to the one that is wanted.
        keys.merge.sample_time_s = Some(dt);
        table = read_table_with(path, format, &keys)?;
    }
    let merged = keys.merge.sample_time_s.is_some();
    let stamps = if merged { time_column(&table).map(|c| c.name.clone()) } else { stamps };
    let time = match (stamps.clone(), how.sample_time_s) {
        _ if how.steady => Time::Steady,
        (Some(column), _) => Time::Column { column, unit: how.time_unit.filter(|_| !merged) },
        (None, Some(sample_time_s)) => Time::Sampled { sample_time_s },
        (None, None) => {
            let text = format!(
                "{}: found no column of time stamps, expected one called time (or t, timestamp, with its unit), ts_s=, or steady=True",
                path.display()
            );
            return Err(Refusal::new(Kind::File, text));
        }
    };
    let mut notes = table.notes.clone();
    let hidden = if how.steady { stamped } else { stamps };
    let wanted = how.channels.unwrap_or_else(|| numbers(&table, hidden.as_deref(), &mut notes));
    for (column, _) in wanted.iter().filter(|(_, name)| how.units.contains_key(name)) {
        // `-` is how a record without a unit was written: it does not say that this is a ratio.
        if let Some(c) = table.columns.iter_mut().find(|c| c.name == *column) {
            c.unit = c.unit.take().filter(|u| u.0 != "-");
        }
    }
    let role = |name: &String| {
        if how.outputs.contains(name) {
            Role::Output
        } else if how.inputs.contains(name) || how.inputs.is_empty() {
            Role::Input
        } else {
            Role::Auxiliary
        }
    };
    let mut channels = Vec::new();
    for (column, name) in wanted {
        let unit = match (how.units.get(&name), &table.column(&column)?.unit) {
            (Some(unit), _) => Some(unit.clone()),
            (None, Some(_)) => None,
            (None, None) => Some("-".into()),
        };
        let convert = how.units.contains_key(&name);
        channels.push(ChannelSpec { role: role(&name), column, name, unit, convert });
    }
    known("units", how.units.keys(), &channels)?;
    known("inputs", how.inputs.iter(), &channels)?;
    known("outputs", how.outputs.iter(), &channels)?;
    let missing = if how.missing { Missing::Mark } else { Missing::Refuse };
    let layout = Layout { channels, time, missing, ..Layout::default() };
    let mut all = datasets(&table, &layout, &Select::All)?;
    let Some(mut data) = (!all.is_empty()).then(|| all.remove(0)) else {
        return Err(FilesError::Empty { path: path.display().to_string(), expected: "rows" }.into());
    };
    let name = path.file_name().map(|n| n.to_string_lossy().into_owned()).unwrap_or_default();
    data.name = name.split('.').next().unwrap_or(&name).to_string();
    data.origin = name;
    Ok((data, notes))
}

/// Every column of numbers but time and one that only counts the rows; what else there is goes to the notes.
fn numbers(table: &Table, time: Option<&str>, notes: &mut Vec<String>) -> Vec<(String, String)> {
    let (numbers, words): (Vec<_>, Vec<_>) = table
        .columns
        .iter()
        .filter(|c| Some(c.name.as_str()) != time)
        .partition(|c| matches!(c.cells, Cells::Number(_)));
    notes.extend(words.iter().map(|c| format!("column `{}` is left out: it holds words", c.name)));
    let (counting, numbers): (Vec<_>, Vec<_>) = numbers.into_iter().partition(|c| counts(c));
    notes.extend(counting.iter().map(|c| format!("column `{}` is left out: it counts the rows", c.name)));
    numbers.into_iter().map(|c| (c.name.clone(), c.name.clone())).collect()
}

/// Whether a column without a name of its own counts the rows, as the index of a frame does that was written beside them.
fn counts(column: &Column) -> bool {
    let nameless = column.name.starts_with("column_") || column.name.starts_with("Unnamed: ");
    match &column.cells {
        Cells::Number(v) if nameless && v.len() > 1 => {
            let first = v[0];
            (first == 0.0 || first == 1.0) && v.iter().enumerate().all(|(k, x)| *x == first + k as f64)
        }
        _ => false,
    }
}

fn known<'a>(
    what: &str,
    mut names: impl Iterator<Item = &'a String>,
    channels: &[ChannelSpec],
) -> Result<(), Refusal> {
    let there: Vec<&str> = channels.iter().map(|c| c.name.as_str()).collect();
    match names.find(|n| !there.contains(&n.as_str())) {
        None => Ok(()),
        Some(name) => {
            let text = format!("{what}: found `{name}`, expected channels out of {}", there.join(", "));
            Err(Refusal::new(Kind::Argument, text))
        }
    }
}

/// Whether a column of that name and unit would be taken for the time of a file.
#[pyfunction]
pub(crate) fn is_time(name: &str, unit: Option<&str>) -> bool {
    looks_like_time(name, unit)
}

/// What is in a file, as JSON.
#[pyfunction]
pub(crate) fn contents(py: Python<'_>, path: PathBuf, format_name: Option<String>) -> PyResult<String> {
    let format = format(format_name)?;
    let read = move |_: dynocal_numerics::watch::Watch| show::contents(&path, format, &ReadKeys::default());
    let found = watched(py, None, read)?.map_err(Refusal::from)?;
    Ok(serde_json::to_string(&found).map_err(crate::errors::run)?)
}

#[derive(Default, Deserialize)]
#[serde(default, deny_unknown_fields)]
struct Converting {
    format: Option<String>,
    read: ReadKeys,
    merge: bool,
    channels: Vec<String>,
    units: std::collections::BTreeMap<String, String>,
}

/// Converts a measurement file; returns what was decided and lost.
#[pyfunction]
pub(crate) fn convert(
    py: Python<'_>,
    source: PathBuf,
    target: PathBuf,
    how: &Bound<'_, PyAny>,
) -> PyResult<Vec<String>> {
    let how: Converting = parsed("convert", how)?;
    let format = format(how.format)?;
    let how =
        Conversion { format, read: how.read, merge: how.merge, channels: how.channels, units: how.units };
    Ok(watched(py, None, move |_| convert_file(&source, &target, &how))?.map_err(Refusal::from)?)
}

/// Writes a record in the format that the ending of `target` names; returns what could not be kept. `steady`: rows are points without
/// time, which gets no column where a format can do without.
#[pyfunction]
pub(crate) fn write(py: Python<'_>, record: &Record, target: PathBuf, steady: bool) -> PyResult<Vec<String>> {
    let data = record.data.clone();
    Ok(watched(py, None, move |watch| write_file(&data, &target, steady, watch))??)
}

fn write_file(data: &Dataset, to: &Path, steady: bool, watch: Watch) -> Result<Vec<String>, Refusal> {
    data.check_marked()?;
    let name = to.to_string_lossy().into_owned();
    let csv = name.ends_with(".csv") || name.ends_with(".csv.gz");
    let plain = csv || name.ends_with(".parquet");
    let time: Vec<f64> = (0..data.len()).map(|t| t as f64 * data.sample_time_s).collect();
    let mut columns: Vec<(&str, &str, &[f64])> = Vec::new();
    if !(steady && plain) {
        columns.push(("time", "s", &time));
    }
    columns.extend(data.channels.iter().map(|c| (c.name.as_str(), c.unit.as_str(), c.values.as_slice())));
    if csv {
        csv_io::write_columns_until(to, &columns, watch.interrupt)?;
        return Ok(Vec::new());
    }
    if plain {
        parquet_io::write_columns(to, &columns)?;
        return Ok(Vec::new());
    }
    let between = to.with_extension("between.parquet");
    parquet_io::write_columns(&between, &columns)?;
    let done = convert_file(&between, to, &Conversion::default());
    let gone = std::fs::remove_file(&between);
    let notes = done?;
    gone.map_err(|e| Refusal::of(Kind::File, &e).about(&between.display().to_string()))?;
    Ok(notes)
}
