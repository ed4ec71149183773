//! A user's own design: from a spec with models, limits and a criterion to a test signal with its safety report.
//!
//! [`read`] takes what the user wrote and checks it as a whole, [`load`] reads the models and records that it names,
//! [`run`] searches and judges, [`result`] is what comes out.

pub(crate) mod channels;
pub mod error;
pub mod estimate;
mod judge;
mod literature;
pub mod load;
pub mod loaded;
pub mod margins;
mod models;
pub mod page;
mod plan;
pub mod result;
mod rivals;
mod rounds;
pub mod run;
mod stored;
pub(crate) mod typed;

use dynocal_files::run_folder::RunPlace;
use std::path::{Path, PathBuf};

use dynocal_design::channel::Channel;
use dynocal_design::problem::Convention;
use dynocal_files::measurement::ReadKeys;
use dynocal_files::spec::{Faults, LoadError, SpecError};
use dynocal_files::split::Cut;
use serde::Serialize;

pub use crate::place::Overrides;
use crate::place::Place;
pub use models::{ModelSpec, Objective, OutputSpec, Source};
use typed::{Typed, TypedRecords};

/// A channel of the plan.
#[derive(Clone, Debug, Serialize)]
pub struct PlanChannel {
    /// Limits; samples of a given channel are read later.
    pub channel: Channel,
    /// Unit.
    pub unit: String,
    /// File that gives the samples of a channel that is not designed.
    pub file: Option<PathBuf>,
}

/// How to search.
#[derive(Clone, Debug, Serialize)]
pub struct SearchSpec {
    /// Name.
    pub name: String,
    /// Its keys.
    pub keys: toml::Table,
    /// Starts.
    pub starts: usize,
    /// Evaluations per start.
    pub evaluations: usize,
}

/// How the files of earlier records (`prior`, `held_out`) are read.
#[derive(Clone, Debug, Default, Serialize)]
pub struct RecordsSpec {
    /// Dialect, merging of rasters, other names of channels.
    pub keys: ReadKeys,
    /// Triggers or pauses that cut a file into experiments.
    pub cut: Option<Cut>,
}

/// A design as understood.
#[derive(Clone, Debug, Serialize)]
pub struct Job {
    /// Name of the run.
    pub name: String,
    /// Run folder.
    #[serde(skip)]
    pub out: RunPlace,
    /// Sample time in s.
    pub sample_time_s: f64,
    /// Samples of the record.
    pub samples: usize,
    /// What stands before the record.
    pub convention: Convention,
    /// Channels in the order of the plan.
    pub channels: Vec<PlanChannel>,
    /// Models.
    pub models: Vec<ModelSpec>,
    /// Objective signal.
    pub objective: Objective,
    /// How the files of earlier records are read.
    pub records: RecordsSpec,
    /// Search.
    pub search: SearchSpec,
    /// Random signals of each rival kind.
    pub rivals: usize,
    /// Whether the upper bound of the information is computed, which takes a while; by default for `d` of one model.
    pub certificate: bool,
    /// Whether weights are those of efficiencies: each criterion over its value for a random record within the limits (`d` over its
    /// parameters), so that models in different units count alike.
    pub efficiencies: bool,
    /// Seed.
    pub seed: u64,
}

/// Reads and checks the spec at `path`. Files in it are relative to its folder.
///
/// # Errors
/// [`LoadError`] with every fault.
pub fn read(path: &Path, overrides: &Overrides) -> Result<Job, LoadError> {
    dynocal_files::spec::load(path, |t: &Typed, faults| check(t, path, overrides, faults))
}

/// The same for a spec that is there as text; `file` is its name in messages.
///
/// # Errors
/// [`SpecError`] with every fault.
///
/// ```
/// let text = r#"
/// length_s = 10.0
/// sample_time_s = 0.1
/// [[channels]]
/// name = "fpw"
/// unit = "us"
/// lower = 2000.0
/// uper = 6000.0
/// "#;
/// let faults = dynocal_jobs::design::parse("plan.toml", text, &Default::default()).unwrap_err().to_string();
/// assert!(faults.contains("did you mean `upper`?") && faults.contains("`models`"), "{faults}");
/// ```
pub fn parse(file: &str, text: &str, overrides: &Overrides) -> Result<Job, SpecError> {
    dynocal_files::spec::parse(file, text, |t: &Typed, faults| check(t, Path::new(file), overrides, faults))
}

/// Longest record, in samples.
const MOST_SAMPLES: f64 = 1e6;

fn check(t: &Typed, spec: &Path, over: &Overrides, faults: &mut Faults) -> Option<Job> {
    let folder = spec.parent().unwrap_or(Path::new(""));
    let dt = faults.required("sample_time_s", &t.sample_time_s, "sample time, s");
    let length = faults.required("length_s", &t.length_s, "length of the record, s");
    dt.into_iter().for_each(|v| faults.positive("sample_time_s", v, "s"));
    length.into_iter().for_each(|v| faults.positive("length_s", v, "s"));
    let samples = dt.zip(length).map(|(dt, length)| (length / dt).round()).filter(|n| n.is_finite());
    if let Some(n) = samples.filter(|n| !(1.0..=MOST_SAMPLES).contains(n)) {
        faults.push("length_s", format!("{n} samples"), format!("1 to {MOST_SAMPLES:e} samples"));
    }
    let dt_s = dt.filter(|v| *v > 0.0).unwrap_or(1.0);
    let typed_channels = t.channels.as_deref().unwrap_or(&[]);
    if typed_channels.is_empty() {
        faults.push("channels", "nothing", "a table [[channels]] for every input of the models");
    }
    let mut channels = channels::channels(typed_channels, dt_s, folder, faults);
    channels::regions(t.regions.as_deref().unwrap_or(&[]), &mut channels, faults);
    let models = models::models(t.models.as_deref().unwrap_or(&[]), dt_s, folder, faults);
    let objective = models::objective(t.objective.as_ref(), &channels, dt_s, folder, faults);
    let search = search(t.search.as_ref(), faults);
    let records = records(t.records.as_ref(), faults);
    bounds(t, samples, search.as_ref(), faults);
    let criteria: Vec<&str> = models.iter().filter_map(|m| m.criterion.as_deref()).collect();
    let d_of_one_model = criteria == ["d"];
    let place = Place::of(spec, t.name.as_deref(), t.out.as_deref(), over.out.as_deref(), faults);
    Some(Job {
        out: place.out,
        name: place.name,
        sample_time_s: dt?,
        samples: samples? as usize,
        convention: t.convention.unwrap_or(Convention::Hold),
        channels,
        models,
        objective: objective?,
        records: records?,
        search: search?,
        rivals: t.rivals.unwrap_or(20),
        certificate: t.certificate.unwrap_or(d_of_one_model),
        efficiencies: t.efficiencies.unwrap_or(false),
        seed: over.seed.or(t.seed).unwrap_or(1),
    })
}

fn records(typed: Option<&TypedRecords>, faults: &mut Faults) -> Option<RecordsSpec> {
    let Some(t) = typed else { return Some(RecordsSpec::default()) };
    let keys = ReadKeys {
        csv: t.csv.clone().unwrap_or_default(),
        merge: t.merge.clone().unwrap_or_default(),
        alias: t.alias.clone().unwrap_or_default(),
    };
    // A record has its stamps in the column `time`, as everywhere in a design.
    let stamps = Some(("time".to_string(), None));
    let cut = match &t.cut {
        Some(typed) => Some(crate::identify::spec::cut("records.cut", typed, stamps, faults)?),
        None => None,
    };
    Some(RecordsSpec { keys, cut })
}

/// Most random signals of each kind that a design is compared with.
const MOST_RIVALS: usize = 10_000;
/// Most evaluations of all starts, and of evaluations times samples: days of work.
const MOST_EVALUATIONS: f64 = 1e9;
const MOST_WORK: f64 = 1e12;

/// Refuses what would not end, before anything is read or computed.
fn bounds(t: &Typed, samples: Option<f64>, search: Option<&SearchSpec>, faults: &mut Faults) {
    if let Some(n) = t.rivals.filter(|n| *n > MOST_RIVALS) {
        faults.push("rivals", n, format!("{MOST_RIVALS} at most"));
    }
    let Some(s) = search else { return };
    let all = s.starts as f64 * s.evaluations as f64;
    if all > MOST_EVALUATIONS {
        faults.push(
            "search.evaluations",
            format!("{} in each of {} starts", s.evaluations, s.starts),
            format!("{MOST_EVALUATIONS:e} in all at most"),
        );
    } else if let Some(n) = samples.filter(|n| n * all > MOST_WORK) {
        faults.push(
            "search.evaluations",
            format!("{all} in all over {n} samples, {:.1e} samples to simulate", n * all),
            format!("{MOST_WORK:e} at most"),
        );
    }
}

fn search(table: Option<&toml::Table>, faults: &mut Faults) -> Option<SearchSpec> {
    let mut keys = table.cloned().unwrap_or_default();
    let default = dynocal_design::search::DesignOptions::default();
    let mut number = |key: &str, default: usize| match keys.remove(key) {
        None => Some(default),
        Some(v) => match v.as_integer().and_then(|n| usize::try_from(n).ok()).filter(|n| *n > 0) {
            Some(n) => Some(n),
            None => {
                faults.push(&format!("search.{key}"), v, "a whole number, 1 or more");
                None
            }
        },
    };
    let starts = number("starts", 4);
    let evaluations = number("evaluations", default.evaluations);
    let name = match keys.remove("name") {
        None => default.search,
        Some(toml::Value::String(name)) => name,
        Some(v) => {
            faults.push("search.name", v, "a name (see `dynocal list searches`)");
            return None;
        }
    };
    let build = |keys: &toml::Table| dynocal_design::search::search(&name, keys);
    crate::identify::spec::built_with("search", "name", &keys, build, faults)?;
    Some(SearchSpec { name, keys, starts: starts?, evaluations: evaluations? })
}
