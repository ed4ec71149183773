//! The spec of an identification: as typed, and as understood.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use dynocal_files::dataset::{ChannelSpec, Format, Layout, Select, Time};
use dynocal_files::spec::{Faults, LoadError, load};
use dynocal_ident::data::Role;
use dynocal_ident::estimate;
use dynocal_ident::model::poly::PolyNarx;
use dynocal_ident::model::structures;
use dynocal_ident::select::frols::Stop;
use dynocal_numerics::registry::BuildError;
use serde::{Deserialize, Serialize};

/// What the command line changes in a spec.
#[derive(Clone, Debug, Default)]
pub struct Overrides {
    /// Data file instead of the one that the spec names.
    pub data: Option<PathBuf>,
    /// Seed for every part that draws random numbers.
    pub seed: Option<u64>,
    /// Run folder.
    pub out: Option<PathBuf>,
}

/// An identification as understood: nothing left to default, nothing left to fail for a typing error.
#[derive(Clone, Debug, Serialize)]
pub struct Job {
    /// Name of the run.
    pub name: String,
    /// Data file.
    pub file: PathBuf,
    /// Its format, where the name does not tell.
    pub format: Option<Format>,
    /// Channels, time, trajectories.
    pub layout: Layout,
    /// Rows to estimate from.
    pub estimation: Select,
    /// Unseen rows to score on.
    pub test: Option<Select>,
    /// Channel that is modelled.
    pub target: String,
    /// Channels that drive it.
    pub inputs: Vec<String>,
    /// Name of the model structure.
    pub structure: String,
    /// The structure with these channels.
    pub model: PolyNarx,
    /// Forward selection from the structure, which then is the pool.
    pub select: Option<Selecting>,
    /// Samples of a first, cheap estimate that the full one starts from; 0 for none.
    pub warm_start_samples: usize,
    /// Name of the estimator.
    pub estimator: String,
    /// Its keys.
    pub estimator_keys: toml::Table,
    /// Run folder.
    pub out: PathBuf,
}

/// How terms are selected.
#[derive(Clone, Copy, Debug, Serialize)]
pub struct Selecting {
    /// When to stop.
    pub stop: Stop,
    /// Most samples that are looked at (the same share of the start of every record).
    pub max_samples: usize,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Typed {
    name: Option<String>,
    out: Option<PathBuf>,
    data: Option<TypedData>,
    channels: Option<Vec<TypedChannel>>,
    split: Option<TypedSplit>,
    model: Option<TypedModel>,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct TypedData {
    file: Option<String>,
    format: Option<Format>,
    sample_time_s: Option<f64>,
    time: Option<String>,
    time_unit: Option<String>,
    trajectory: Option<String>,
    init_samples: Option<usize>,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct TypedChannel {
    column: Option<String>,
    name: Option<String>,
    unit: Option<String>,
    #[serde(default)]
    convert: bool,
    role: Option<Role>,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct TypedSplit {
    column: Option<String>,
    estimation: Option<Vec<toml::Value>>,
    test: Option<Vec<toml::Value>>,
    estimation_rows: Option<Vec<(usize, usize)>>,
    test_rows: Option<Vec<(usize, usize)>>,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct TypedModel {
    target: Option<String>,
    inputs: Option<Vec<String>>,
    structure: Option<toml::Table>,
    select: Option<TypedSelect>,
    warm_start_samples: Option<usize>,
    estimator: Option<toml::Table>,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct TypedSelect {
    terms: Option<usize>,
    bic_max_terms: Option<usize>,
    max_samples: Option<usize>,
}

/// Reads and checks the spec at `path`. Files in it are relative to its folder; `${NAME}` stands for the
/// environment variable NAME.
///
/// # Errors
/// [`LoadError`] with every fault.
pub fn read(path: &Path, overrides: &Overrides) -> Result<Job, LoadError> {
    let folder = path.parent().unwrap_or(Path::new("")).to_path_buf();
    let stem = path.file_stem().map(|s| s.to_string_lossy().into_owned()).unwrap_or_default();
    load(path, |typed: &Typed, faults| check(typed, &folder, &stem, overrides, faults))
}

fn check(t: &Typed, folder: &Path, stem: &str, over: &Overrides, faults: &mut Faults) -> Option<Job> {
    if t.data.is_none() && over.data.is_none() {
        faults.push("data", "nothing", "a table [data] with the key file");
    }
    let file = data_file(t.data.as_ref(), folder, over, faults);
    let time = t.data.as_ref().and_then(|d| time(d, faults));
    let channels = channels(t.channels.as_deref().unwrap_or(&[]), faults);
    let split = split(t.split.as_ref(), faults);
    let model = model(t.model.as_ref(), &channels, over, faults);
    let name = t.name.clone().unwrap_or_else(|| stem.to_string());
    let select = t.model.as_ref().and_then(|m| selecting(m.select.as_ref()?, faults));
    let out = over.out.clone().or_else(|| t.out.as_ref().map(|o| folder.join(o)));
    let (estimation, test) = split?;
    let (target, inputs, structure, model, estimator, estimator_keys) = model?;
    let data = t.data.as_ref();
    Some(Job {
        out: out.unwrap_or_else(|| Path::new("runs").join(&name)),
        name,
        file: file?,
        format: data.and_then(|d| d.format),
        layout: Layout {
            channels,
            time: time?,
            trajectory: data.and_then(|d| d.trajectory.clone()),
            init_samples: data.and_then(|d| d.init_samples).unwrap_or(0),
        },
        estimation,
        test,
        target,
        inputs,
        structure,
        model,
        select,
        warm_start_samples: t.model.as_ref().and_then(|m| m.warm_start_samples).unwrap_or(0),
        estimator,
        estimator_keys,
    })
}

fn data_file(
    data: Option<&TypedData>,
    folder: &Path,
    over: &Overrides,
    faults: &mut Faults,
) -> Option<PathBuf> {
    if over.data.is_some() {
        return over.data.clone();
    }
    let file = faults.required("data.file", &data?.file, "a CSV or Parquet file")?;
    // `${NAME}/rest`: data that cannot be kept beside the spec.
    if let Some((name, rest)) = file.strip_prefix("${").and_then(|r| r.split_once('}')) {
        return match std::env::var_os(name) {
            Some(v) => Some(PathBuf::from(v).join(rest.trim_start_matches('/'))),
            None => {
                faults.push(
                    "data.file",
                    format!("`{file}` with {name} not set"),
                    format!("the environment variable {name}, or --data FILE"),
                );
                None
            }
        };
    }
    Some(folder.join(file))
}

fn time(d: &TypedData, faults: &mut Faults) -> Option<Time> {
    match (d.sample_time_s, &d.time) {
        (Some(dt), None) => {
            faults.positive("data.sample_time_s", dt, "s");
            Some(Time::Sampled { sample_time_s: dt })
        }
        (None, Some(column)) => Some(Time::Column { column: column.clone(), unit: d.time_unit.clone() }),
        (Some(_), Some(_)) => {
            faults.push("data.time", "sample_time_s as well", "either a time column or sample_time_s, s");
            None
        }
        (None, None) => {
            faults.push(
                "data.sample_time_s",
                "nothing",
                "the sample time, s, or data.time with a time column",
            );
            None
        }
    }
}

fn channels(typed: &[TypedChannel], faults: &mut Faults) -> Vec<ChannelSpec> {
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

fn split(typed: Option<&TypedSplit>, faults: &mut Faults) -> Option<(Select, Option<Select>)> {
    let Some(s) = typed else { return Some((Select::All, None)) };
    let label = |v: &toml::Value| v.as_str().map_or_else(|| v.to_string(), str::to_string);
    let by_value = |column: &str, values: &[toml::Value]| Select::Values {
        column: column.into(),
        values: values.iter().map(label).collect(),
    };
    let shape = "either column with estimation (and test) values, or estimation_rows (and test_rows)";
    match (&s.column, &s.estimation, &s.estimation_rows) {
        (Some(column), Some(values), None) if s.test_rows.is_none() => {
            Some((by_value(column, values), s.test.as_ref().map(|v| by_value(column, v))))
        }
        (None, None, Some(rows)) if s.test.is_none() => {
            for (key, ranges) in
                [("split.estimation_rows", Some(rows)), ("split.test_rows", s.test_rows.as_ref())]
            {
                if let Some((a, b)) = ranges.iter().flat_map(|r| r.iter()).find(|(a, b)| a >= b) {
                    faults.push(key, format!("[{a}, {b}]"), "[first, end) with first < end, zero-based rows");
                }
            }
            let all: Vec<(usize, usize)> = rows.iter().chain(s.test_rows.iter().flatten()).copied().collect();
            let shared = |k: usize| all[..k].iter().find(|r| r.0 < all[k].1 && all[k].0 < r.1);
            if let Some((other, k)) = (1..all.len()).find_map(|k| shared(k).map(|r| (r, k))) {
                let found = format!("[{}, {}] and [{}, {}]", other.0, other.1, all[k].0, all[k].1);
                let expected = "rows that no two ranges share: what is called unseen must not have been seen";
                faults.push("split", found, expected);
            }
            Some((Select::Rows(rows.clone()), s.test_rows.clone().map(Select::Rows)))
        }
        _ => {
            faults.push("split", "another combination of keys", shape);
            None
        }
    }
}

type ModelParts = (String, Vec<String>, String, PolyNarx, String, toml::Table);

fn model(
    typed: Option<&TypedModel>,
    channels: &[ChannelSpec],
    over: &Overrides,
    faults: &mut Faults,
) -> Option<ModelParts> {
    let Some(m) = typed else {
        faults.push("model", "nothing", "a table [model] with target, structure and estimator");
        return None;
    };
    let named = |role: Role| -> Vec<String> {
        channels.iter().filter(|c| c.role == role).map(|c| c.name.clone()).collect()
    };
    let all: Vec<String> = channels.iter().map(|c| c.name.clone()).collect();
    let outputs = named(Role::Output);
    let target = match &m.target {
        Some(t) if !all.contains(t) => {
            faults.unknown("model.target", t, &all);
            None
        }
        Some(t) => Some(t.clone()),
        None if outputs.len() == 1 => outputs.first().cloned(),
        None => {
            faults.push("model.target", "nothing", format!("one of {}", outputs.join(", ")));
            None
        }
    };
    let inputs = m.inputs.clone().unwrap_or_else(|| named(Role::Input));
    for name in inputs.iter().filter(|n| !all.contains(n)) {
        faults.unknown("model.inputs", name, &all);
    }
    let estimator = member("model.estimator", &m.estimator, faults).and_then(|(name, mut keys)| {
        let doc = estimate::docs().into_iter().find(|d| d.name == name);
        if let (Some(seed), true) =
            (over.seed, doc.is_some_and(|d| d.params.iter().any(|p| p.name == "seed")))
        {
            keys.insert("seed".into(), toml::Value::Integer(i64::try_from(seed).unwrap_or(i64::MAX)));
        }
        built("model.estimator", estimate::estimator(&name, &keys), faults)?;
        Some((name, keys))
    });
    let structure = member("model.structure", &m.structure, faults).and_then(|(name, keys)| {
        Some((built("model.structure", structures::structure(&name, &keys), faults)?, name))
    });
    let (target, (structure, structure_name)) = (target?, structure?);
    if !inputs.iter().all(|n| all.contains(n)) {
        return None;
    }
    let poly = match structure.polynomial(&inputs, &target) {
        Ok(Some(p)) => p,
        Ok(None) => {
            faults.push("model.structure.name", format!("`{structure_name}`"), "a polynomial structure");
            return None;
        }
        Err(e) => {
            faults.push("model.structure", e, "a structure over the inputs and the target");
            return None;
        }
    };
    let (estimator, keys) = estimator?;
    Some((target, inputs, structure_name, poly, estimator, keys))
}

fn selecting(t: &TypedSelect, faults: &mut Faults) -> Option<Selecting> {
    let stop = match (t.terms, t.bic_max_terms) {
        (Some(n), None) if n > 0 => Stop::Terms(n),
        (None, Some(max_terms)) if max_terms > 0 => Stop::Bic { max_terms },
        _ => {
            faults.push("model.select", "another combination", "either terms or bic_max_terms, at least 1");
            return None;
        }
    };
    Some(Selecting { stop, max_samples: t.max_samples.unwrap_or(50_000) })
}

/// Name and keys of a table like `{ name = "arx", na = 2 }`.
fn member(key: &str, table: &Option<toml::Table>, faults: &mut Faults) -> Option<(String, toml::Table)> {
    let expected = "a table with name and its keys (see `dynocal list`)";
    let mut keys = faults.required(key, table, expected)?;
    match keys.remove("name") {
        Some(toml::Value::String(name)) => Some((name, keys)),
        _ => {
            faults.push(&format!("{key}.name"), "no text", expected);
            None
        }
    }
}

fn built<T>(key: &str, result: Result<T, BuildError>, faults: &mut Faults) -> Option<T> {
    match result {
        Ok(t) => Some(t),
        Err(BuildError::UnknownMember { found, known, .. }) => {
            faults.unknown(&format!("{key}.name"), &found, &known);
            None
        }
        Err(BuildError::Keys { message, .. }) => {
            let known: Vec<String> = message.split('`').skip(1).step_by(2).map(str::to_string).collect();
            match known.split_first() {
                Some((found, known)) if message.starts_with("unknown field") => {
                    faults.unknown(&format!("{key}.{found}"), found, known);
                }
                _ => faults.push(key, message, "keys as `dynocal list` shows them"),
            }
            None
        }
    }
}

impl Job {
    /// The part of the job that decides the result, for the digest of the step.
    pub fn inputs(&self) -> BTreeMap<&'static str, serde_json::Value> {
        BTreeMap::from([
            ("layout", serde_json::json!(self.layout)),
            ("estimation", serde_json::json!(self.estimation)),
            ("test", serde_json::json!(self.test)),
            ("model", serde_json::json!(self.model)),
            ("select", serde_json::json!((&self.select, self.warm_start_samples))),
            ("estimator", serde_json::json!((&self.estimator, &self.estimator_keys))),
        ])
    }
}
