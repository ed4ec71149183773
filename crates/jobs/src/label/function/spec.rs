//! The spec of a function: read as typed, checked as a whole.

use std::path::{Path, PathBuf};

use dynocal_files::run_folder::RunPlace;
use dynocal_files::spec::{Faults, LoadError, SpecError};
use dynocal_label::graph::{FittedAxis, Graph};
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
    pub(super) axes: Vec<SharedKeys>,
    #[serde(default)]
    pub(super) labels: Vec<LabelKeys>,
    #[serde(default)]
    pub(super) rows: Vec<RowKeys>,
    pub(super) reduce: Option<usize>,
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

/// An axis that labels share, as it is written.
#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct SharedKeys {
    pub(super) name: String,
    pub(super) unit: String,
    pub(super) points: Vec<f64>,
    /// Breakpoints that are left after the fit.
    pub(super) place: Option<usize>,
    /// Whether they then leave the breakpoints of the fit.
    #[serde(default, rename = "move")]
    pub(super) moves: bool,
    /// Whether breakpoints are fitted with the labels.
    #[serde(default)]
    pub(super) fit: bool,
}

/// A row of the criterion as it is written.
#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct RowKeys {
    pub(super) node: String,
    pub(super) target: String,
    pub(super) weight: Option<f64>,
}

/// An axis as it is written; without points it is the shared one of that name.
#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct AxisKeys {
    pub(super) name: String,
    pub(super) unit: Option<String>,
    pub(super) points: Option<Vec<f64>>,
    pub(super) place: Option<usize>,
    #[serde(default, rename = "move")]
    pub(super) moves: bool,
    #[serde(default)]
    pub(super) fit: bool,
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
    /// A stored model or an FMU, relative to the spec, and which of its outputs.
    pub(super) file: Option<PathBuf>,
    pub(super) output: Option<String>,
    /// Unit of what it gives; of a channel it is compared with that of the file.
    pub(super) unit: Option<String>,
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
    /// Change that it may have had, in shares of its value a second.
    pub slower_than: Option<f64>,
    /// Time in s for which all of it must have held before; none for the sample alone.
    pub for_s: Option<f64>,
}

/// A row of the criterion: a node, the channel that it is compared with, and the weight of its squares.
#[derive(Clone, Debug, Serialize)]
pub struct Row {
    /// Number of the node.
    pub node: usize,
    /// Name of the node.
    pub name: String,
    /// Channel.
    pub target: String,
    /// Weight.
    pub weight: f64,
}

/// An axis of a label whose breakpoints are chosen after the fit.
#[derive(Clone, Debug, Serialize, PartialEq)]
pub struct Placed {
    /// Name.
    pub name: String,
    /// Breakpoints that are left.
    pub count: usize,
    /// Whether they then leave the breakpoints of the fit.
    pub moves: bool,
    /// Labels with the axis, by number, and which of their axes it is.
    pub of: Vec<(usize, usize)>,
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
    /// Unit that each of them shall have, where the spec says one.
    pub units: Vec<Option<String>>,
    /// What is compared with what.
    pub rows: Vec<Row>,
    /// Which samples count.
    pub conditions: Vec<Condition>,
    /// Share of the samples, first in time, that are fitted; the rest judges.
    pub train: f64,
    /// The function.
    pub graph: Graph,
    /// Names of the axes that labels share.
    pub shared: Vec<String>,
    /// Axes that are placed after the fit.
    pub placed: Vec<Placed>,
    /// Axes that are fitted with the labels on them.
    pub fitted: Vec<FittedAxis>,
    /// Channel among the targets that is a lambda: it must have its size, and its sensor must say one.
    pub lambda: Option<String>,
    /// Every so many breakpoints of each axis are fitted first; 1 for all at once.
    pub reduce: usize,
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
    let train = t.train.unwrap_or(0.7);
    faults.range("train", train, 0.2, 0.95, "");
    let reduce = t.reduce.unwrap_or(1);
    faults.range("reduce", reduce as f64, 1.0, 64.0, "");
    let place = Place::of(spec, t.name.as_deref(), t.out.as_deref(), over.out.as_deref(), faults);
    conditions(&t.conditions, faults);
    if let Some(smooth) = t.fit.as_ref().and_then(|f| f.smooth) {
        faults.range("fit.smooth", smooth, 0.0, 1e6, "");
    }
    let built = build::graph(t, folder, faults)?;
    if let Err(e) = built.graph.check(built.channels.len()) {
        faults.push("nodes", "a function that cannot be evaluated", e);
    }
    let rows = rows(t, &built.graph, faults)?;
    let data = data?;
    if data.is_empty() {
        faults.push("data", "no file", "a list of data files");
    }
    Some(Job {
        name: place.name,
        out: place.out,
        data: data.iter().map(|f| folder.join(f)).collect(),
        channels: built.channels,
        units: built.units,
        rows,
        conditions: t.conditions.clone(),
        train,
        graph: built.graph,
        shared: t.axes.iter().map(|a| a.name.clone()).collect(),
        placed: built.placed,
        fitted: built.fitted,
        lambda: None,
        reduce,
        fit: t.fit.clone().unwrap_or_default(),
    })
}

fn conditions(all: &[Condition], faults: &mut Faults) {
    for (k, c) in all.iter().enumerate() {
        if !(c.least.unwrap_or(f64::NEG_INFINITY) <= c.greatest.unwrap_or(f64::INFINITY)) {
            faults.push(
                &format!("where[{k}].least"),
                c.least.unwrap_or(f64::NAN),
                "a value not above `greatest`",
            );
        }
        if let Some(rate) = c.slower_than {
            faults.positive(&format!("where[{k}].slower_than"), rate, "1/s");
        }
        if let Some(for_s) = c.for_s {
            faults.range(&format!("where[{k}].for_s"), for_s, 0.0, 1e4, "s");
            if c.slower_than.is_none() && c.least.is_none() && c.greatest.is_none() {
                let wanted = "`least`, `greatest` or `slower_than` beside it";
                faults.push(&format!("where[{k}].for_s"), for_s, wanted);
            }
        }
    }
}

/// Rows of the criterion: those that are written, or the last node and `target`.
fn rows(t: &Typed, graph: &Graph, faults: &mut Faults) -> Option<Vec<Row>> {
    let last = graph.nodes.len().checked_sub(1)?;
    if t.rows.is_empty() {
        let target = faults.required(
            "target",
            &t.target,
            "the channel that the last node is compared with, or [[rows]]",
        )?;
        return Some(vec![Row { node: last, name: graph.nodes[last].name.clone(), target, weight: 1.0 }]);
    }
    if let Some(target) = &t.target {
        faults.push("target", target, "no `target` beside [[rows]]");
    }
    let known: Vec<String> = t.nodes.iter().map(|n| n.name.clone()).collect();
    let mut out = Vec::new();
    for (k, row) in t.rows.iter().enumerate() {
        let weight = row.weight.unwrap_or(1.0);
        faults.positive(&format!("rows[{k}].weight"), weight, "");
        match graph.nodes.iter().rposition(|n| n.name == row.node) {
            Some(node) => {
                out.push(Row { node, name: row.node.clone(), target: row.target.clone(), weight });
            }
            None => faults.unknown(&format!("rows[{k}].node"), &row.node, &known),
        }
    }
    Some(out)
}
