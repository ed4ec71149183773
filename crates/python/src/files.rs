//! Measurement files.

use std::path::{Path, PathBuf};

use dynocal_files::FilesError;
use dynocal_files::dataset::{ChannelSpec, Format, Layout, Missing, Select, Time, datasets, read_table_with};
use dynocal_files::measurement::{ReadKeys, csv_io, parquet_io, time_column};
use dynocal_files::table::{Cells, Table};
use dynocal_ident::data::{Dataset, Role};
use dynocal_jobs::convert::{Conversion, convert as convert_file};
use dynocal_jobs::show;
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
    let stamps =
        how.time.clone().or_else(|| time_column(&table).map(|c| c.name.clone())).filter(|_| !how.steady);
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
    let wanted = how.channels.unwrap_or_else(|| numbers(&table, stamps.as_deref(), &mut notes));
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

/// Every column of numbers but time; what else there is goes to the notes.
fn numbers(table: &Table, time: Option<&str>, notes: &mut Vec<String>) -> Vec<(String, String)> {
    let (numbers, words): (Vec<_>, Vec<_>) = table
        .columns
        .iter()
        .filter(|c| Some(c.name.as_str()) != time)
        .partition(|c| matches!(c.cells, Cells::Number(_)));
    notes.extend(words.iter().map(|c| format!("column `{}` is left out: it holds words", c.name)));
    numbers.into_iter().map(|c| (c.name.clone(), c.name.clone())).collect()
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

/// Converts a measurement file, or writes a record; returns what was decided and lost.
#[pyfunction]
pub(crate) fn convert(
    py: Python<'_>,
    source: &Bound<'_, PyAny>,
    target: PathBuf,
    how: &Bound<'_, PyAny>,
) -> PyResult<Vec<String>> {
    let how: Converting = parsed("convert", how)?;
    let format = format(how.format)?;
    if let Ok(record) = source.cast::<Record>() {
        let data = record.get().data.clone();
        return Ok(watched(py, None, move |_| write(&data, &target))??);
    }
    let source: PathBuf = source.extract()?;
    let how =
        Conversion { format, read: how.read, merge: how.merge, channels: how.channels, units: how.units };
    Ok(watched(py, None, move |_| convert_file(&source, &target, &how))?.map_err(Refusal::from)?)
}

/// Writes a record in the format that the ending of `to` names.
fn write(data: &Dataset, to: &Path) -> Result<Vec<String>, Refusal> {
    let name = to.to_string_lossy().into_owned();
    if name.ends_with(".csv") || name.ends_with(".csv.gz") {
        csv_io::write_dataset(to, data)?;
        return Ok(Vec::new());
    }
    if name.ends_with(".parquet") {
        parquet_io::write_dataset(to, data)?;
        return Ok(Vec::new());
    }
    let between = to.with_extension("between.parquet");
    parquet_io::write_dataset(&between, data)?;
    let done = convert_file(&between, to, &Conversion::default());
    let gone = std::fs::remove_file(&between);
    let notes = done?;
    gone.map_err(|e| Refusal::of(Kind::File, &e).about(&between.display().to_string()))?;
    Ok(notes)
}
