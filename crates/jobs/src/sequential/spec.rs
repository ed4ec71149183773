//! What is moved, what is identified, how long: read as typed, checked as meant.

use dynocal_files::run_folder::RunPlace;
use std::path::{Path, PathBuf};

use dynocal_calib::loops::robust::Risk;
use dynocal_design::criterion::CRITERIA;
use dynocal_design::search::SEARCHES;
use dynocal_files::spec::{Faults, LoadError, SpecError};
use dynocal_ident::model::kinds::MODEL_KINDS;
use dynocal_plant::plants::{self, PlantSpec};
use serde::{Deserialize, Serialize};

use crate::design::channels::channels;
use crate::design::typed::TypedChannel;
use crate::place::{Overrides, Place};

/// Most samples of all records together.
const MOST_SAMPLES: f64 = 1e6;

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Typed {
    name: Option<String>,
    out: Option<PathBuf>,
    seed: Option<u64>,
    sample_time_s: Option<f64>,
    settle_s: Option<f64>,
    course: Option<Course>,
    first_s: Option<f64>,
    record_s: Option<f64>,
    rounds: Option<usize>,
    held_out_s: Option<f64>,
    stop_below: Option<f64>,
    noise_std: Option<f64>,
    criterion: Option<String>,
    plant: Option<PlantSpec>,
    channels: Option<Vec<TypedChannel>>,
    outputs: Option<Vec<TypedOutput>>,
    search: Option<TypedSearch>,
    robust: Option<TypedRobust>,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct TypedOutput {
    name: Option<String>,
    model: Option<toml::Table>,
    weight: Option<f64>,
    lower: Option<f64>,
    upper: Option<f64>,
    rate: Option<f64>,
    caution: Option<f64>,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct TypedSearch {
    name: Option<String>,
    starts: Option<usize>,
    evaluations: Option<usize>,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct TypedRobust {
    draws: Option<usize>,
    worst: Option<f64>,
}

/// How records follow each other.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Course {
    /// One long test: every record adds to the earlier ones and goes on where the last one ended (sequential design).
    Continuous,
    /// Every record starts from rest and is designed for itself (iterative design, thesis Figure 4.2).
    Separate,
}

/// A modelled output.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Output {
    /// Output of the plant.
    pub name: String,
    /// Kind of the model, a row of [`MODEL_KINDS`].
    pub kind: String,
    /// Its keys.
    pub keys: toml::Table,
    /// How much it counts.
    pub weight: f64,
    /// Limits that predictions keep with a margin from held-out errors.
    pub limits: Option<Limits>,
}

/// Limits of an output.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Limits {
    /// Least value.
    pub lower: f64,
    /// Largest value.
    pub upper: f64,
    /// Accepted share of violations among samples that are predicted to be at a limit.
    pub rate: f64,
    /// Factor on the margins of the first designed record.
    pub caution: f64,
}

/// A design that is good over draws of the estimate.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Robust {
    /// Draws.
    pub draws: usize,
    /// What counts of their losses.
    pub risk: Risk,
}

/// A campaign as understood.
#[derive(Clone, Debug, Serialize)]
pub struct Job {
    /// Name of the run.
    pub name: String,
    /// Run folder.
    #[serde(skip)]
    pub out: RunPlace,
    /// Seed.
    pub seed: u64,
    /// Sample time in s.
    pub sample_time_s: f64,
    /// Time at the first row before a record that starts from rest, in s.
    pub settle_s: f64,
    /// How records follow each other.
    pub course: Course,
    /// Samples of the first, random record.
    pub first: usize,
    /// Samples of a designed record.
    pub samples: usize,
    /// Most designed records.
    pub rounds: usize,
    /// Samples of the held-out record.
    pub held_out: usize,
    /// Expected reduction of the squared error, as a share of the present one, below which the campaign ends; 0: never.
    pub stop_below: f64,
    /// Standard deviation of the noise of the first output where it is known, else 0.
    pub noise_std: f64,
    /// Criterion.
    pub criterion: String,
    /// Plant.
    pub plant: PlantSpec,
    /// Channels that are moved.
    pub channels: Vec<dynocal_design::channel::Channel>,
    /// Their units.
    pub units: Vec<String>,
    /// Outputs; the first one decides when to stop.
    pub outputs: Vec<Output>,
    /// Search, starts, evaluations of each start.
    pub search: Search,
    /// Whether over the distribution of the estimate.
    pub robust: Option<Robust>,
}

/// How a record is searched for.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Search {
    /// A row of [`SEARCHES`].
    pub name: String,
    /// Starts.
    pub starts: usize,
    /// Evaluations of each.
    pub evaluations: usize,
}

/// Reads and checks the spec at `path`.
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
pub fn parse(file: &str, text: &str, overrides: &Overrides) -> Result<Job, SpecError> {
    dynocal_files::spec::parse(file, text, |t: &Typed, faults| check(t, Path::new(file), overrides, faults))
}

fn check(t: &Typed, spec: &Path, over: &Overrides, faults: &mut Faults) -> Option<Job> {
    let folder = spec.parent().unwrap_or(Path::new(""));
    let dt = faults.required("sample_time_s", &t.sample_time_s, "sample time, s");
    dt.into_iter().for_each(|v| faults.positive("sample_time_s", v, "s"));
    let dt_s = dt.filter(|v| *v > 0.0 && v.is_finite()).unwrap_or(1.0);
    let record_s = faults.required("record_s", &t.record_s, "length of a designed record, s");
    let mut samples = |key: &str, given: Option<f64>, default: f64| {
        let n = (given.unwrap_or(default) / dt_s).round();
        if !(2.0..=MOST_SAMPLES).contains(&n) {
            faults.push(key, format!("{n} samples"), format!("2 to {MOST_SAMPLES:e} samples"));
        }
        n as usize
    };
    let record = record_s.unwrap_or(100.0 * dt_s);
    let (first, length) = (samples("first_s", t.first_s, record), samples("record_s", Some(record), record));
    let held_out = samples("held_out_s", t.held_out_s, 2.0 * record);
    let rounds = t.rounds.unwrap_or(3);
    if !(1..=1000).contains(&rounds) {
        faults.push("rounds", rounds, "1 to 1000");
    }
    // The rival measures as many samples as the rounds.
    let all = first as f64 + held_out as f64 + 2.0 * rounds as f64 * length as f64;
    if all > MOST_SAMPLES {
        faults.push(
            "rounds",
            format!("{all} samples in all"),
            format!("at most {MOST_SAMPLES:e} in all records"),
        );
    }
    for (key, value, most, unit) in [
        ("settle_s", t.settle_s.unwrap_or(3.0), 1e4, "s"),
        ("stop_below", t.stop_below.unwrap_or(0.0), 1.0, "(share of the present squared error)"),
        ("noise_std", t.noise_std.unwrap_or(0.0), 1e9, "(unit of the first output)"),
    ] {
        faults.range(key, value, 0.0, most, unit);
    }
    let criterion = t.criterion.clone().unwrap_or_else(|| "d".into());
    if !CRITERIA.iter().any(|m| m.doc.name == criterion) {
        let known: Vec<String> = CRITERIA.iter().map(|m| m.doc.name.to_string()).collect();
        faults.unknown("criterion", &criterion, &known);
    }
    let plant = t.plant.clone().unwrap_or_default();
    plant_faults(&plant, faults);
    let typed = t.channels.as_deref().unwrap_or(&[]);
    if typed.is_empty() {
        faults.push("channels", "nothing", "a table [[channels]] for every input that is moved");
    }
    let moved = channels(typed, dt_s, folder, faults);
    if let Some(c) = moved.iter().find(|c| c.file.is_some()) {
        faults.push(
            "channels",
            format!("`{}` with a `file`", c.channel.name),
            "limits: every channel of a campaign is designed",
        );
    }
    let outputs = outputs(t.outputs.as_deref().unwrap_or(&[]), faults);
    let search = search(t.search.as_ref(), faults);
    let robust = robust(t.robust.as_ref(), outputs.len(), faults);
    let place = Place::of(spec, t.name.as_deref(), t.out.as_deref(), over.out.as_deref(), faults);
    Some(Job {
        name: place.name,
        out: place.out,
        seed: over.seed.or(t.seed).unwrap_or(1),
        sample_time_s: dt?,
        settle_s: t.settle_s.unwrap_or(3.0),
        course: t.course.unwrap_or(Course::Continuous),
        first,
        samples: length,
        rounds,
        held_out,
        stop_below: t.stop_below.unwrap_or(0.0),
        noise_std: t.noise_std.unwrap_or(0.0),
        criterion,
        plant,
        units: moved.iter().map(|c| c.unit.clone()).collect(),
        channels: moved.into_iter().map(|c| c.channel).collect(),
        search,
        robust,
        outputs,
    })
}

fn plant_faults(plant: &PlantSpec, faults: &mut Faults) {
    for f in plants::check(plant) {
        if f.known.is_empty() {
            faults.push(&f.key, f.found, f.expected);
        } else {
            faults.unknown(&f.key, &f.found, &f.known);
        }
    }
    if plants::find(&plant.name).is_some_and(|m| m.make.is_none()) {
        let expected = "a plant that answers while it is designed for; a bed whose records are files is served by `dynocal design` round by round";
        faults.push("plant.name", format!("`{}`", plant.name), expected);
    }
}

fn outputs(typed: &[TypedOutput], faults: &mut Faults) -> Vec<Output> {
    if typed.is_empty() {
        faults.push("outputs", "nothing", "a table [[outputs]] for every output that is modelled");
    }
    typed.iter().enumerate().filter_map(|(k, t)| output(t, &format!("outputs[{}]", k + 1), faults)).collect()
}

fn output(t: &TypedOutput, key: &str, faults: &mut Faults) -> Option<Output> {
    let name = faults.required(&format!("{key}.name"), &t.name, "an output of the plant");
    let model = faults.required(
        &format!("{key}.model"),
        &t.model,
        "a table { name = \"..\", .. } (see `dynocal list models`)",
    );
    let weight = t.weight.unwrap_or(1.0);
    faults.range(&format!("{key}.weight"), weight, 0.0, 1e9, "");
    let limits = match (t.lower, t.upper) {
        (Some(lower), Some(upper)) if lower < upper => {
            let (rate, caution) = (t.rate.unwrap_or(0.05), t.caution.unwrap_or(2.0));
            faults.range(&format!("{key}.rate"), rate, 1e-4, 0.5, "(share of the samples at a limit)");
            faults.range(&format!("{key}.caution"), caution, 1.0, 100.0, "(factor on the first margins)");
            Some(Limits { lower, upper, rate, caution })
        }
        (None, None) => {
            if t.rate.is_some() || t.caution.is_some() {
                faults.push(
                    &format!("{key}.rate"),
                    "a rate or a caution without limits",
                    "`lower` and `upper` beside it",
                );
            }
            None
        }
        (lower, upper) => {
            let word = |v: Option<f64>| v.map_or("nothing".into(), |v| v.to_string());
            let found = format!("lower {}, upper {}", word(lower), word(upper));
            faults.push(&format!("{key}.upper"), found, "both, the second above the first");
            None
        }
    };
    let mut keys = model?;
    let kind = match keys.remove("name") {
        Some(toml::Value::String(kind)) => kind,
        found => {
            let found = found.map_or("nothing".into(), |v| v.to_string());
            faults.push(&format!("{key}.model.name"), found, "a name (see `dynocal list models`)");
            return None;
        }
    };
    match MODEL_KINDS.iter().find(|m| m.doc.name == kind) {
        None => {
            let known: Vec<String> = MODEL_KINDS.iter().map(|m| m.doc.name.to_string()).collect();
            faults.unknown(&format!("{key}.model.name"), &kind, &known);
        }
        Some(row) => {
            if let Err(e) = (row.build)(&keys) {
                faults.push(&format!("{key}.model"), e, "keys as `dynocal list models` shows them");
            }
        }
    }
    Some(Output { name: name?, kind, keys, weight, limits })
}

fn search(t: Option<&TypedSearch>, faults: &mut Faults) -> Search {
    let default = dynocal_design::search::DesignOptions::default();
    let name = t.and_then(|t| t.name.clone()).unwrap_or(default.search);
    if !SEARCHES.iter().any(|m| m.doc.name == name) {
        let known: Vec<String> = SEARCHES.iter().map(|m| m.doc.name.to_string()).collect();
        faults.unknown("search.name", &name, &known);
    }
    let starts = t.and_then(|t| t.starts).unwrap_or(1);
    let evaluations = t.and_then(|t| t.evaluations).unwrap_or(1000);
    for (key, n, most) in [("search.starts", starts, 1000), ("search.evaluations", evaluations, 10_000_000)] {
        if !(1..=most).contains(&n) {
            faults.push(key, n, format!("1 to {most}"));
        }
    }
    Search { name, starts, evaluations }
}

fn robust(t: Option<&TypedRobust>, outputs: usize, faults: &mut Faults) -> Option<Robust> {
    let t = t?;
    let draws = t.draws.unwrap_or(8);
    if !(2..=1000).contains(&draws) {
        faults.push("robust.draws", draws, "2 to 1000");
    }
    if outputs > 1 {
        faults.push(
            "robust",
            format!("{outputs} outputs"),
            "one output: a robust design is for one structure",
        );
    }
    let risk = match t.worst {
        None => Risk::Mean,
        Some(share) => {
            faults.range("robust.worst", share, 1e-3, 1.0, "(share of the draws)");
            Risk::Cvar(share)
        }
    };
    Some(Robust { draws, risk })
}
