//! What signals are wanted: read as typed, checked as meant.

use dynocal_files::run_folder::RunPlace;
use std::path::{Path, PathBuf};

use dynocal_files::spec::{Faults, LoadError, SpecError};
use dynocal_ident::signal::signal;
use dynocal_numerics::registry::BuildError;
use serde::{Deserialize, Serialize};

use crate::place::{Overrides, Place};

/// Most samples of one signal.
pub const MOST_SAMPLES: f64 = 1e7;
/// Most samples of all channels together: a run holds them all, and its file has 20 bytes a sample.
pub const MOST_VALUES: f64 = 5e7;

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Typed {
    name: Option<String>,
    out: Option<PathBuf>,
    length_s: Option<f64>,
    sample_time_s: Option<f64>,
    seed: Option<u64>,
    channels: Option<Vec<TypedChannel>>,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct TypedChannel {
    name: Option<String>,
    unit: Option<String>,
    signal: Option<toml::Table>,
}

/// The request as understood.
#[derive(Clone, Debug, Serialize)]
pub struct Job {
    /// Name of the run.
    pub name: String,
    /// Samples of every channel.
    pub samples: usize,
    /// Sample time in s.
    pub sample_time_s: f64,
    /// Seed; channel k draws from its stream k.
    pub seed: u64,
    /// Channels.
    pub channels: Vec<Wanted>,
    /// Run folder.
    #[serde(skip)]
    pub out: RunPlace,
}

/// A channel and its signal.
#[derive(Clone, Debug, Serialize)]
pub struct Wanted {
    /// Name of the column.
    pub name: String,
    /// Unit.
    pub unit: String,
    /// Member of the table of signals.
    pub signal: String,
    /// Its keys.
    pub keys: toml::Table,
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

/// Samples of a record of `length_s`, between 2 and [`MOST_SAMPLES`]; none outside.
pub fn samples(length_s: f64, sample_time_s: f64) -> Option<usize> {
    let n = (length_s / sample_time_s).round();
    (2.0..=MOST_SAMPLES).contains(&n).then_some(n as usize)
}

fn check(t: &Typed, spec: &Path, over: &Overrides, faults: &mut Faults) -> Option<Job> {
    let dt = faults.required("sample_time_s", &t.sample_time_s, "sample time, s");
    let length = faults.required("length_s", &t.length_s, "length, s");
    dt.into_iter().for_each(|v| faults.positive("sample_time_s", v, "s"));
    let n = dt.zip(length).map(|(dt, length)| samples(length, dt).ok_or(length / dt));
    if let Some(Err(n)) = n {
        faults.push("length_s", format!("{} samples", n.round()), format!("2 to {MOST_SAMPLES:e} samples"));
    }
    let n = n.and_then(Result::ok);
    let typed = t.channels.as_deref().unwrap_or(&[]);
    if typed.is_empty() {
        let expected = "a table [[channels]] with name, unit and signal for every channel";
        faults.push("channels", "nothing", expected);
    }
    if n.is_some_and(|n| n as f64 * typed.len() as f64 > MOST_VALUES) {
        let found = format!("{} channels of {} samples", typed.len(), n.unwrap_or(0));
        faults.push("channels", found, format!("at most {MOST_VALUES:e} samples in all"));
    }
    let channels = channels(typed, faults);
    let place = Place::of(spec, t.name.as_deref(), t.out.as_deref(), over.out.as_deref(), faults);
    Some(Job {
        out: place.out,
        name: place.name,
        samples: n?,
        sample_time_s: dt?,
        seed: over.seed.or(t.seed).unwrap_or(1),
        channels,
    })
}

fn channels(typed: &[TypedChannel], faults: &mut Faults) -> Vec<Wanted> {
    let mut channels: Vec<Wanted> = Vec::new();
    for (k, c) in typed.iter().enumerate() {
        let key = |name: &str| format!("channels[{}].{name}", k + 1);
        let name = faults.required(&key("name"), &c.name, "name of the column");
        let unit = faults.required(&key("unit"), &c.unit, "a unit, `-` for none");
        let expected = "a table like { name = \"aprbs\", lo = 10, hi = 90 } (see `dynocal list signals`)";
        let table = faults.required(&key("signal"), &c.signal, expected);
        let (Some(name), Some(unit), Some(mut keys)) = (name, unit, table) else { continue };
        if channels.iter().any(|c| c.name == name) || name == "time" {
            faults.push(&key("name"), format!("`{name}` again"), "a name of its own");
        }
        let Some(toml::Value::String(member)) = keys.remove("name") else {
            faults.push(&key("signal.name"), "no text", "a name (see `dynocal list signals`)");
            continue;
        };
        match signal(&member, &keys) {
            Ok(_) => channels.push(Wanted { name, unit, signal: member, keys }),
            Err(BuildError::UnknownMember { found, known, .. }) => {
                faults.unknown(&key("signal.name"), &found, &known);
            }
            Err(e) => faults.push(&key("signal"), e, "keys as `dynocal list signals` shows them"),
        }
    }
    channels
}
