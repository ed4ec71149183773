//! The spec of a job over seeds and points.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use dynocal_files::run_folder::RunPlace;
use dynocal_files::spec::{Faults, LoadError, SpecError};
use dynocal_jobs::place::{Overrides, Place};
use dynocal_jobs::runs;
use serde::{Deserialize, Serialize};
use toml::{Table, Value};

/// Most tasks of a study.
const MOST_TASKS: usize = 10_000_000;

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Typed {
    name: Option<String>,
    out: Option<PathBuf>,
    job: Option<String>,
    spec: Option<Value>,
    seeds: Option<Value>,
    values: Option<BTreeMap<String, Value>>,
    points: Option<Vec<BTreeMap<String, Value>>>,
    chunk_tasks: Option<usize>,
    keep: Option<bool>,
}

/// A job over seeds and points, as understood.
#[derive(Clone, Debug, Serialize)]
pub struct JobStudy {
    /// Name of the study.
    pub name: String,
    /// The job.
    pub job: String,
    /// Its spec, into which the values of a point are put.
    pub spec: Table,
    /// Name of the spec in messages; files in it are relative to its folder.
    #[serde(skip)]
    pub spec_name: String,
    /// Seeds of every point; none: that of the spec.
    pub seeds: Vec<u64>,
    /// Values by key, a table a point.
    pub points: Vec<BTreeMap<String, Value>>,
    /// Tasks a chunk; none: planned by measuring the first task.
    #[serde(skip)]
    pub chunk_tasks: Option<usize>,
    /// Whether the run folders of the tasks are kept.
    #[serde(skip)]
    pub keep: bool,
    /// Folder of the study.
    #[serde(skip)]
    pub out: RunPlace,
}

/// What a face puts in place of what the spec says.
#[derive(Clone, Debug, Default)]
pub struct Replaced {
    /// Seeds of every point.
    pub seeds: Option<Vec<u64>>,
    /// Folder.
    pub over: Overrides,
}

impl JobStudy {
    /// Number of tasks: every point with every seed.
    pub fn count(&self) -> usize {
        self.points.len() * self.seeds.len().max(1)
    }

    /// Point and seed of a task; the seeds of a point are neighbours.
    pub fn task(&self, task: usize) -> (&BTreeMap<String, Value>, Option<u64>) {
        let seeds = self.seeds.len().max(1);
        (&self.points[task / seeds], self.seeds.get(task % seeds).copied())
    }

    /// The spec at a point.
    ///
    /// # Errors
    /// What is wrong with a key.
    pub fn at(&self, point: &BTreeMap<String, Value>) -> Result<Table, String> {
        let mut spec = Value::Table(self.spec.clone());
        for (key, value) in point {
            *slot(&mut spec, key)? = value.clone();
        }
        match spec {
            Value::Table(t) => Ok(t),
            _ => Err("the spec is no table".into()),
        }
    }
}

/// Where the value of `key` (`channels.0.lower`) is, or is put.
fn slot<'a>(spec: &'a mut Value, key: &str) -> Result<&'a mut Value, String> {
    let mut at = spec;
    let mut gone = String::new();
    let parts: Vec<&str> = key.split('.').collect();
    for (k, part) in parts.iter().enumerate() {
        let last = k + 1 == parts.len();
        at = match at {
            Value::Table(t) => {
                if last && !t.contains_key(*part) {
                    t.insert((*part).into(), Value::Boolean(false));
                }
                t.get_mut(*part).ok_or_else(|| format!("found no table `{gone}{part}` in the spec"))?
            }
            Value::Array(a) => {
                let many = a.len();
                let place = part.parse::<usize>().ok().filter(|i| *i < many);
                let place = place.ok_or_else(|| {
                    format!("found `{part}`, expected a place from 0 in the {many} of `{gone}`")
                })?;
                &mut a[place]
            }
            _ => {
                return Err(format!(
                    "found a value at `{}`, expected a table or a list",
                    gone.trim_end_matches('.')
                ));
            }
        };
        gone = format!("{gone}{part}.");
    }
    Ok(at)
}

/// Reads and checks the spec at `path`; files in it are relative to its folder.
///
/// # Errors
/// [`LoadError`] with every fault.
pub fn read(path: &Path, replaced: &Replaced) -> Result<JobStudy, LoadError> {
    dynocal_files::spec::load(path, |t: &Typed, faults| check(t, path, replaced, faults))
}

/// The same for a spec that is there as text; `file` is its name in messages.
///
/// # Errors
/// [`SpecError`] with every fault.
pub fn parse(file: &str, text: &str, replaced: &Replaced) -> Result<JobStudy, SpecError> {
    dynocal_files::spec::parse(file, text, |t: &Typed, faults| check(t, Path::new(file), replaced, faults))
}

fn check(t: &Typed, path: &Path, replaced: &Replaced, faults: &mut Faults) -> Option<JobStudy> {
    let over = &replaced.over;
    let place = Place::of(path, t.name.as_deref(), t.out.as_deref(), over.out.as_deref(), faults);
    let known = runs::VERBS.iter().map(|v| v.name).collect::<Vec<_>>().join(", ");
    let job = faults.required("job", &t.job, &format!("a job: one of {known}"));
    if let Some(j) = job.as_ref().filter(|j| runs::find(j).is_err()) {
        faults.push("job", format!("`{j}`"), format!("one of {known}"));
    }
    let base = base(t, path, faults);
    let seeds = match (&replaced.seeds, &t.seeds) {
        (Some(s), _) => s.clone(),
        (None, Some(v)) => seeds(v, faults),
        (None, None) => Vec::new(),
    };
    let points = points(t, faults);
    if t.chunk_tasks == Some(0) {
        faults.push("chunk_tasks", 0, "a whole number, 1 or more");
    }
    let count = points.len().saturating_mul(seeds.len().max(1));
    if count > MOST_TASKS {
        faults.push(
            "values",
            format!("{count} tasks"),
            format!("at most {MOST_TASKS}: fewer seeds or values"),
        );
    }
    let (spec_name, spec) = base?;
    let study = JobStudy {
        name: place.name,
        job: job?,
        spec,
        spec_name,
        seeds,
        points,
        chunk_tasks: t.chunk_tasks,
        keep: t.keep.unwrap_or(false),
        out: place.out,
    };
    let key = if t.points.is_some() { "points" } else { "values" };
    // A key that cannot be put into the spec is wrong at every point: once is enough.
    if let Some(reason) = study.points.iter().find_map(|p| study.at(p).err()) {
        faults.push(key, reason, "keys of the job's spec, e.g. `length_s` or `channels.0.lower`");
    }
    Some(study)
}

/// Name and content of the job's spec: a file, or a table here.
fn base(t: &Typed, path: &Path, faults: &mut Faults) -> Option<(String, Table)> {
    let expected = "the job's spec: a file, or a table with its keys";
    match faults.required("spec", &t.spec, expected)? {
        Value::String(file) => {
            let file = path.parent().unwrap_or(Path::new("")).join(file);
            let name = file.display().to_string();
            let found = std::fs::read_to_string(&file).map_err(|e| e.to_string());
            match found.and_then(|text| text.parse::<Table>().map_err(|e| e.message().to_string())) {
                Ok(table) => Some((name, table)),
                Err(reason) => {
                    faults.push("spec", format!("`{name}`: {reason}"), "a file of TOML");
                    None
                }
            }
        }
        Value::Table(table) => Some((format!("{} [spec]", path.display()), table)),
        other => {
            faults.push("spec", &other, expected);
            None
        }
    }
}

fn seeds(value: &Value, faults: &mut Faults) -> Vec<u64> {
    const EXPECTED: &str = "a list of whole numbers, 0 or more, each once, or { first = 1, count = 200 }";
    let whole = |v: &Value| v.as_integer().and_then(|i| u64::try_from(i).ok());
    let found: Option<Vec<u64>> = match value {
        Value::Array(a) if !a.is_empty() => a.iter().map(whole).collect(),
        Value::Table(t) if t.len() == 2 => (|| {
            let (first, count) = (whole(t.get("first")?)?, whole(t.get("count")?)?);
            let end = first.checked_add(count)?;
            (1..=MOST_TASKS as u64).contains(&count).then(|| (first..end).collect())
        })(),
        _ => None,
    };
    let distinct = |s: &Vec<u64>| s.iter().collect::<std::collections::BTreeSet<_>>().len() == s.len();
    found.filter(distinct).unwrap_or_else(|| {
        faults.push("seeds", value, EXPECTED);
        Vec::new()
    })
}

/// The points: as given, or every combination of `values`; one without values where nothing is given.
fn points(t: &Typed, faults: &mut Faults) -> Vec<BTreeMap<String, Value>> {
    let none = || vec![BTreeMap::new()];
    match (&t.values, &t.points) {
        (Some(_), Some(_)) => {
            faults.push("points", "`values` and `points`", "one of them: combinations, or a list");
            none()
        }
        (None, Some(list)) => {
            let keys = |p: &BTreeMap<String, Value>| p.keys().cloned().collect::<Vec<_>>();
            if let Some(k) = list.iter().position(|p| p.is_empty() || keys(p) != keys(&list[0])) {
                faults.push(
                    "points",
                    format!("point {k} with other keys, or none"),
                    "the same keys in every point",
                );
            }
            if list.is_empty() {
                faults.push("points", "an empty list", "at least one point");
                return none();
            }
            list.clone()
        }
        (Some(values), None) => combinations(values, faults),
        (None, None) => none(),
    }
}

/// All combinations, the last key changing fastest.
fn combinations(values: &BTreeMap<String, Value>, faults: &mut Faults) -> Vec<BTreeMap<String, Value>> {
    let mut out = vec![BTreeMap::new()];
    for (key, list) in values {
        let Some(list) = list.as_array().filter(|l| !l.is_empty()) else {
            faults.push(&format!("values.{key}"), list, "a list of at least one value");
            continue;
        };
        if out.len().saturating_mul(list.len()) > MOST_TASKS {
            faults.push(&format!("values.{key}"), "too many combinations", format!("at most {MOST_TASKS}"));
            return out;
        }
        let with = |p: &BTreeMap<String, Value>, v: &Value| {
            let mut p = p.clone();
            p.insert(key.clone(), v.clone());
            p
        };
        out = out.iter().flat_map(|p| list.iter().map(move |v| with(p, v))).collect();
    }
    out
}
