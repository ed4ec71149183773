//! Where the data lie and how they are read: tables `data`, `channels`, `test`, `prepare`.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use dynocal_files::dataset::{ChannelSpec, Format, Layout, Time};
use dynocal_files::measurement::ReadKeys;
use dynocal_files::spec::Faults;
use dynocal_files::split::{By, Cut};
use serde::Serialize;

use super::member::member_of;
use super::typed::{TypedChannel, TypedCut, TypedData, TypedTest};

/// A data file.
#[derive(Clone, Debug, Serialize)]
pub struct Source {
    /// Path.
    pub file: PathBuf,
    /// Its format, where neither bytes nor name tell.
    pub format: Option<Format>,
    /// Dialect, merging of rasters, other names of channels.
    pub keys: ReadKeys,
}

/// Records that only test: a file of its own, named in the scores.
#[derive(Clone, Debug, Serialize)]
pub struct TestSet {
    /// Name, e.g. `arrow_full`.
    pub name: String,
    /// File.
    pub source: Source,
    /// Leading samples that only initialise, where they differ from those of the estimation.
    pub init_samples: Option<usize>,
    /// Column of a channel where it differs from that of the estimation.
    pub columns: BTreeMap<String, String>,
    /// Whether it is cut into experiments as the estimation files are.
    pub cut: bool,
}

/// A step of the preparation as the spec gives it.
#[derive(Clone, Debug, Serialize)]
pub struct StepSpec {
    /// Name.
    pub step: String,
    /// Keys.
    pub keys: toml::Table,
}

/// Environment variable that names the folder of the reference data.
const REFERENCE: &str = "DYNOCAL_REFERENCE_DIR";

/// What paths in a spec are relative to.
#[derive(Clone, Copy)]
pub(super) struct Place<'a> {
    /// Folder of the spec.
    pub(super) folder: &'a Path,
    /// Folder of the reference data, where the command line names it.
    pub(super) reference: Option<&'a Path>,
}

/// A path relative to the spec; `${NAME}/rest` for data that cannot be kept beside it.
fn path_of(key: &str, file: &str, place: &Place, faults: &mut Faults) -> Option<PathBuf> {
    let Some((name, rest)) = file.strip_prefix("${").and_then(|r| r.split_once('}')) else {
        return Some(place.folder.join(file));
    };
    let given = if name == REFERENCE { place.reference.map(PathBuf::from) } else { None };
    match given.or_else(|| std::env::var_os(name).map(PathBuf::from)) {
        Some(v) => Some(v.join(rest.trim_start_matches('/'))),
        None => {
            let expected = format!("the environment variable {name}, or --data");
            faults.push(key, format!("`{file}` with {name} not set"), expected);
            None
        }
    }
}

/// How files are read: `data.csv`, `data.merge`, `data.alias`.
pub(super) fn reading(data: Option<&TypedData>) -> ReadKeys {
    let Some(d) = data else { return ReadKeys::default() };
    ReadKeys {
        csv: d.csv.clone().unwrap_or_default(),
        merge: d.merge.clone().unwrap_or_default(),
        alias: d.alias.clone().unwrap_or_default(),
    }
}

/// The estimation files: those of the command line instead of those of the spec.
pub(super) fn sources(
    data: Option<&TypedData>,
    place: &Place,
    over: &[PathBuf],
    faults: &mut Faults,
) -> Option<Vec<Source>> {
    let keys = reading(data);
    if !over.is_empty() {
        let format = data.and_then(|d| d.format);
        return Some(over.iter().map(|f| Source { file: f.clone(), format, keys: keys.clone() }).collect());
    }
    let data = data?;
    let one = |key: &str, f: &String, faults: &mut Faults| {
        Some(Source { file: path_of(key, f, place, faults)?, format: data.format, keys: keys.clone() })
    };
    match (&data.file, &data.files) {
        (Some(f), None) => Some(vec![one("data.file", f, faults)?]),
        (None, Some(all)) if !all.is_empty() => all.iter().map(|f| one("data.files", f, faults)).collect(),
        (None, Some(_)) => {
            faults.push(
                "data.files",
                "an empty list",
                "at least one measurement file (`dynocal list formats`)",
            );
            None
        }
        (Some(_), Some(_)) => {
            faults.push("data.files", "file as well", "either file or files");
            None
        }
        (None, None) => {
            faults.push("data.file", "nothing", "a measurement file (`dynocal list formats`)");
            None
        }
    }
}

/// Test sets in files of their own.
pub(super) fn tests(
    typed: &[TypedTest],
    names: &[String],
    keys: &ReadKeys,
    place: &Place,
    faults: &mut Faults,
) -> Vec<TestSet> {
    let mut out: Vec<TestSet> = Vec::new();
    for (k, t) in typed.iter().enumerate() {
        let key = |part: &str| format!("test[{}].{part}", k + 1);
        let file = faults.required(&key("file"), &t.file, "a measurement file (`dynocal list formats`)");
        let name = faults.required(&key("name"), &t.name, "a name for the scores, e.g. \"arrow\"");
        let (Some(file), Some(name)) = (file, name) else { continue };
        if ["estimation", "selection", "test"].contains(&name.as_str()) || out.iter().any(|o| o.name == name)
        {
            faults.push(&key("name"), format!("`{name}`"), "a name of its own, not that of another part");
        }
        let columns = t.columns.clone().unwrap_or_default();
        for channel in columns.keys().filter(|c| !names.contains(c)) {
            faults.unknown(&key("columns"), channel, names);
        }
        if let Some(path) = path_of(&key("file"), &file, place, faults) {
            let source = Source { file: path, format: t.format, keys: keys.clone() };
            let cut = t.cut.unwrap_or(true);
            out.push(TestSet { name, source, init_samples: t.init_samples, columns, cut });
        }
    }
    out
}

/// The layout of the files. Stamps need not be uniform where a step of the preparation resamples.
pub(super) fn layout(
    d: &TypedData,
    channels: Vec<ChannelSpec>,
    resampled: bool,
    faults: &mut Faults,
) -> Option<Layout> {
    let time = match (d.sample_time_s, &d.time) {
        (None, None) if d.steady == Some(true) => Time::Steady,
        _ if d.steady == Some(true) => {
            let expected =
                "no sample_time_s and no time: the rows of a steady table are points without order";
            faults.push("data.steady", "a time as well", expected);
            return None;
        }
        (Some(dt), None) => {
            faults.positive("data.sample_time_s", dt, "s");
            Time::Sampled { sample_time_s: dt }
        }
        (None, Some(column)) if resampled => {
            Time::Stamps { column: column.clone(), unit: d.time_unit.clone() }
        }
        (None, Some(column)) => Time::Column { column: column.clone(), unit: d.time_unit.clone() },
        (Some(_), Some(_)) => {
            faults.push("data.time", "sample_time_s as well", "either a time column or sample_time_s, s");
            return None;
        }
        (None, None) => {
            let expected = "the sample time, s, or data.time with a time column, or steady = true for a table without time";
            faults.push("data.sample_time_s", "nothing", expected);
            return None;
        }
    };
    let stamps = d.time.as_ref().map(|column| (column.clone(), d.time_unit.clone()));
    let cut = match &d.cut {
        Some(typed) => Some(cut("data.cut", typed, stamps, faults)?),
        None => None,
    };
    Some(Layout {
        channels,
        time,
        trajectory: d.trajectory.clone(),
        cut,
        init_samples: d.init_samples.unwrap_or(0),
        missing: d.missing.unwrap_or_default(),
    })
}

/// Where a long record is cut: at a trigger, or at pauses of its stamps (column, unit).
pub(crate) fn cut(
    key: &str,
    typed: &TypedCut,
    stamps: Option<(String, Option<String>)>,
    faults: &mut Faults,
) -> Option<Cut> {
    let by = match (&typed.trigger, typed.above, typed.gap_s, stamps) {
        (Some(column), Some(above), None, _) => By::Trigger { column: column.clone(), above },
        (None, None, Some(longer_s), Some((column, unit))) => {
            faults.positive(&format!("{key}.gap_s"), longer_s, "s");
            By::Gap { column, unit, longer_s }
        }
        (None, None, Some(_), None) => {
            faults.push(
                &format!("{key}.gap_s"),
                "no time column",
                "data.time: pauses are seen in the stamps",
            );
            return None;
        }
        _ => {
            let expected = "trigger and above (rows in which a column is above a level), or gap_s (pauses)";
            faults.push(key, "another combination of keys", expected);
            return None;
        }
    };
    Some(Cut { by, shortest: typed.shortest.unwrap_or(1) })
}

/// Channels.
pub(super) fn channels(typed: &[TypedChannel], faults: &mut Faults) -> Vec<ChannelSpec> {
    if typed.is_empty() {
        faults.push("channels", "nothing", "one [[channels]] for each input and output");
    }
    let mut out: Vec<ChannelSpec> = Vec::new();
    for (k, c) in typed.iter().enumerate() {
        let key = |part: &str| format!("channels[{}].{part}", k + 1);
        let column = faults.required(&key("column"), &c.column, "the name of a column in the file");
        let role = faults.required(&key("role"), &c.role, "one of input, output, auxiliary");
        let (Some(column), Some(role)) = (column, role) else { continue };
        let name = c.name.clone().unwrap_or_else(|| column.clone());
        if out.iter().any(|o| o.name == name) {
            faults.push(&key("name"), format!("`{name}` a second time"), "a name that is used once");
        }
        out.push(ChannelSpec { column, name, unit: c.unit.clone(), convert: c.convert, role });
    }
    out
}

/// Steps of the preparation, in the order of the file.
pub(super) fn steps(typed: &[toml::Table], faults: &mut Faults) -> Vec<StepSpec> {
    let one = |(k, table): (usize, &toml::Table)| {
        let key = format!("prepare[{}]", k + 1);
        let (step, keys) = member_of(&key, "step", table, "see `dynocal list preparation`", faults)?;
        super::member::check_step(&key, &step, &keys, faults)?;
        Some(StepSpec { step, keys })
    };
    typed.iter().enumerate().filter_map(one).collect()
}
