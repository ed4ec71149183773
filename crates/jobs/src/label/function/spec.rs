//! The spec of a function: read as typed, checked as a whole.

use std::path::{Path, PathBuf};

use dynocal_files::run_folder::RunPlace;
use dynocal_files::spec::{Faults, LoadError, SpecError};
use dynocal_label::graph::Graph;
use dynocal_label::linear::Options;
use serde::{Deserialize, Serialize};

use super::build;
use crate::place::{Overrides, Place};

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct Typed {
    pub(super) name: Option<String>,
    pub(super) out: Option<PathBuf>,
    pub(super) data: Option<Vec<PathBuf>>,
    pub(super) target: Option<String>,
    pub(super) train: Option<f64>,
    #[serde(default)]
    pub(super) labels: Vec<LabelKeys>,
    #[serde(default)]
    pub(super) nodes: Vec<NodeKeys>,
    #[serde(default, rename = "where")]
    pub(super) conditions: Vec<Condition>,
    pub(super) fit: Option<Options>,
}

/// A label as it is written.
#[derive(Deserialize, Default)]
#[serde(deny_unknown_fields)]
pub(super) struct LabelKeys {
    pub(super) name: String,
    pub(super) unit: String,
    /// One for all cells, or one a cell.
    pub(super) base: Vec<f64>,
    pub(super) least: Option<f64>,
    pub(super) greatest: Option<f64>,
    pub(super) step: Option<f64>,
    #[serde(default)]
    pub(super) base_weight: f64,
    #[serde(default)]
    pub(super) locked: Vec<usize>,
    #[serde(default)]
    pub(super) axes: Vec<AxisKeys>,
}

/// An axis as it is written.
#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct AxisKeys {
    pub(super) name: String,
    pub(super) unit: String,
    pub(super) points: Vec<f64>,
    pub(super) smooth: Option<f64>,
    pub(super) least_gradient: Option<f64>,
    pub(super) greatest_gradient: Option<f64>,
    #[serde(default)]
    pub(super) convex: i8,
}

/// A node as it is written.
#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct NodeKeys {
    pub(super) name: String,
    pub(super) op: String,
    #[serde(default, rename = "in")]
    pub(super) inputs: Vec<String>,
    pub(super) channel: Option<String>,
    pub(super) label: Option<String>,
    pub(super) value: Option<f64>,
    pub(super) least: Option<f64>,
    pub(super) greatest: Option<f64>,
    pub(super) start: Option<f64>,
}

/// Samples count where a channel is within a range.
#[derive(Clone, Debug, Deserialize, Serialize)]
#[serde(deny_unknown_fields)]
pub struct Condition {
    /// Channel.
    pub channel: String,
    /// Least value.
    pub least: Option<f64>,
    /// Greatest value.
    pub greatest: Option<f64>,
}

/// A fit as understood.
#[derive(Clone, Debug, Serialize)]
pub struct Job {
    /// Name of the run.
    pub name: String,
    /// Data files, one record each.
    pub data: Vec<PathBuf>,
    /// Channels that the function reads.
    pub channels: Vec<String>,
    /// Channel that its last node is compared with.
    pub target: String,
    /// Which samples count.
    pub conditions: Vec<Condition>,
    /// Share of the samples, first in time, that are fitted; the rest judges.
    pub train: f64,
    /// The function.
    pub graph: Graph,
    /// The fit.
    pub fit: Options,
    /// Run folder.
    #[serde(skip)]
    pub out: RunPlace,
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
pub fn parse(file: &str, text: &str, overrides: &Overrides) -> Result<Job, SpecError> {
    dynocal_files::spec::parse(file, text, |t: &Typed, faults| check(t, Path::new(file), overrides, faults))
}

fn check(t: &Typed, spec: &Path, over: &Overrides, faults: &mut Faults) -> Option<Job> {
    let folder = spec.parent().unwrap_or(Path::new(""));
    let data = faults.required("data", &t.data, "a list of data files");
    let target = faults.required("target", &t.target, "the channel that the last node is compared with");
    let train = t.train.unwrap_or(0.7);
    faults.range("train", train, 0.2, 0.95, "");
    let place = Place::of(spec, t.name.as_deref(), t.out.as_deref(), over.out.as_deref(), faults);
    for (k, c) in t.conditions.iter().enumerate() {
        if !(c.least.unwrap_or(f64::NEG_INFINITY) <= c.greatest.unwrap_or(f64::INFINITY)) {
            faults.push(
                &format!("where[{k}].least"),
                c.least.unwrap_or(f64::NAN),
                "a value not above `greatest`",
            );
        }
    }
    let (graph, channels) = build::graph(t, faults)?;
    if let Err(e) = graph.check(channels.len()) {
        faults.push("nodes", "a function that cannot be evaluated", e);
    }
    let data = data?;
    if data.is_empty() {
        faults.push("data", "no file", "a list of data files");
    }
    Some(Job {
        name: place.name,
        out: place.out,
        data: data.iter().map(|f| folder.join(f)).collect(),
        channels,
        target: target?,
        conditions: t.conditions.clone(),
        train,
        graph,
        fit: t.fit.clone().unwrap_or_default(),
    })
}
