//! Models and objective signal of a spec.

use std::path::{Path, PathBuf};

use dynocal_design::criterion;
use dynocal_files::spec::Faults;
use dynocal_ident::signal;
use serde::Serialize;

use super::PlanChannel;
use super::literature::LITERATURE;
use super::typed::{TypedLimits, TypedModel, TypedObjective};

/// Where a model comes from.
#[derive(Clone, Debug, PartialEq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Source {
    /// A model of the literature with its printed parameters.
    Literature(String),
    /// A model file of `dynocal identify`.
    File(PathBuf),
}

/// Limits of an output.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct OutputSpec {
    /// Least value.
    pub lower: f64,
    /// Largest value.
    pub upper: f64,
    /// Margin, where it is given.
    pub margin: Option<f64>,
    /// Largest share of blocks that may pass a limit by the error of the model.
    pub rate: f64,
    /// Samples of a block, where it is given.
    pub block: Option<usize>,
}

/// A model of the design.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct ModelSpec {
    /// Where it comes from.
    pub source: Source,
    /// Standard deviation of the noise, instead of that of the model.
    pub noise_std: Option<f64>,
    /// Criterion; none for a model that only limits.
    pub criterion: Option<String>,
    /// Weight of the criterion.
    pub weight: f64,
    /// Output before the record.
    pub initial_output: Option<f64>,
    /// Records whose information counts already.
    pub prior: Vec<PathBuf>,
    /// Records that the model has not seen.
    pub held_out: Vec<PathBuf>,
    /// Limits of the output.
    pub limits: Option<OutputSpec>,
}

/// Where the predictions shall be good.
#[derive(Clone, Debug, PartialEq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Objective {
    /// Everywhere within the limits: a random record.
    Everywhere,
    /// A record with the channels as columns.
    File(PathBuf),
    /// One test signal per channel that is designed.
    Signals {
        /// Samples.
        samples: usize,
        /// Name and keys, in the order of the channels; none for a given channel.
        signals: Vec<Option<(String, toml::Table)>>,
    },
}

pub(super) fn models(typed: &[TypedModel], dt_s: f64, folder: &Path, faults: &mut Faults) -> Vec<ModelSpec> {
    if typed.is_empty() {
        faults.push("models", "nothing", "a table [[models]] with `literature` or `file`");
    } else if typed.iter().all(|t| t.criterion.is_none()) {
        faults.push(
            "models[1].criterion",
            "nothing",
            "a criterion with one model at least (d and i are the usual ones)",
        );
    }
    typed
        .iter()
        .enumerate()
        .filter_map(|(k, t)| model(t, &format!("models[{}]", k + 1), dt_s, folder, faults))
        .collect()
}

fn model(t: &TypedModel, key: &str, dt_s: f64, folder: &Path, faults: &mut Faults) -> Option<ModelSpec> {
    let source = match (&t.literature, &t.file) {
        (Some(name), None) => {
            if !LITERATURE.iter().any(|l| l.0 == name) {
                let known: Vec<String> = LITERATURE.iter().map(|l| l.0.to_string()).collect();
                faults.unknown(&format!("{key}.literature"), name, &known);
            }
            Some(Source::Literature(name.clone()))
        }
        (None, Some(file)) => Some(Source::File(folder.join(file))),
        _ => {
            faults.push(key, "neither or both of literature and file", "one of them");
            None
        }
    };
    if let Some(name) = &t.criterion {
        let known: Vec<String> = criterion::CRITERIA.iter().map(|m| m.doc.name.to_string()).collect();
        if !known.contains(name) {
            faults.unknown(&format!("{key}.criterion"), name, &known);
        }
    }
    if let Some(s) = t.noise_std {
        faults.positive(&format!("{key}.noise_std"), s, "in the unit of the output");
    }
    let weight = t.weight.unwrap_or(1.0);
    if !(weight >= 0.0 && weight.is_finite()) {
        faults.push(&format!("{key}.weight"), weight, "a number that is not negative");
    }
    if let Some(y) = t.initial_output.filter(|y| !y.is_finite()) {
        faults.push(&format!("{key}.initial_output"), y, "a finite number");
    }
    let files = |f: &Option<Vec<PathBuf>>| f.iter().flatten().map(|f| folder.join(f)).collect();
    Some(ModelSpec {
        source: source?,
        noise_std: t.noise_std,
        criterion: t.criterion.clone(),
        weight,
        initial_output: t.initial_output,
        prior: files(&t.prior),
        held_out: files(&t.held_out),
        limits: t.limits.as_ref().and_then(|l| limits(l, &format!("{key}.limits"), dt_s, faults)),
    })
}

fn limits(t: &TypedLimits, key: &str, dt_s: f64, faults: &mut Faults) -> Option<OutputSpec> {
    let lower = faults.required(&format!("{key}.lower"), &t.lower, "least output")?;
    let upper = faults.required(&format!("{key}.upper"), &t.upper, "largest output")?;
    if !(lower < upper && lower.is_finite() && upper.is_finite()) {
        faults.push(&format!("{key}.upper"), upper, format!("a finite number above lower = {lower}"));
    }
    if let Some(m) = t.margin {
        faults.range(&format!("{key}.margin"), m, 0.0, 0.5 * (upper - lower), "(half of the range)");
    }
    let rate = t.rate.unwrap_or(0.05);
    faults.range(&format!("{key}.rate"), rate, 1e-4, 0.5, "(share of the blocks)");
    let block = t.block_s.map(|b| (b / dt_s).round());
    if let Some(b) = block.filter(|b| !(1.0..=1e9).contains(b)) {
        faults.push(&format!("{key}.block_s"), format!("{b} samples"), "one sample at least");
    }
    Some(OutputSpec { lower, upper, margin: t.margin, rate, block: block.map(|b| b as usize) })
}

pub(super) fn objective(
    typed: Option<&TypedObjective>,
    channels: &[PlanChannel],
    dt_s: f64,
    folder: &Path,
    faults: &mut Faults,
) -> Option<Objective> {
    let Some(t) = typed else { return Some(Objective::Everywhere) };
    match (&t.file, &t.signals) {
        (Some(file), None) => Some(Objective::File(folder.join(file))),
        (None, Some(signals)) => {
            let length = faults.required("objective.length_s", &t.length_s, "length of the signals, s")?;
            let samples = (length / dt_s).round();
            if !(2.0..=1e6).contains(&samples) {
                faults.push("objective.length_s", length, "2 to 1e6 samples");
                return None;
            }
            let known: Vec<String> = channels.iter().map(|c| c.channel.name.clone()).collect();
            for name in signals.keys().filter(|n| !known.contains(n)) {
                faults.unknown("objective.signals", name, &known);
            }
            let mut out = Vec::new();
            for c in channels {
                let key = format!("objective.signals.{}", c.channel.name);
                match signals.get(&c.channel.name) {
                    Some(table) => out.push(Some(member(table, c, &key, faults)?)),
                    None if c.file.is_some() => out.push(None),
                    None => {
                        faults.push(&key, "nothing", "a signal for every channel, e.g. { name = \"aprbs\" }");
                        return None;
                    }
                }
            }
            Some(Objective::Signals { samples: samples as usize, signals: out })
        }
        _ => {
            faults.push("objective", "neither or both of file and signals", "one of them");
            None
        }
    }
}

/// Name and keys of a signal; the ends of the channel stand for `lo` and `hi` where these are not given.
fn member(
    table: &toml::Table,
    c: &PlanChannel,
    key: &str,
    faults: &mut Faults,
) -> Option<(String, toml::Table)> {
    let mut keys = table.clone();
    let Some(toml::Value::String(name)) = keys.remove("name") else {
        faults.push(&format!("{key}.name"), "no text", "a name (see `dynocal list signals`)");
        return None;
    };
    let doc = signal::docs().into_iter().find(|d| d.name == name);
    for (end, value) in [("lo", c.channel.lower), ("hi", c.channel.upper)] {
        if doc.is_some_and(|d| d.params.iter().any(|p| p.name == end)) && !keys.contains_key(end) {
            keys.insert(end.into(), toml::Value::Float(value));
        }
    }
    crate::identify::spec::built_with(key, "name", &keys, |keys| signal::signal(&name, keys), faults)?;
    Some((name, keys))
}
