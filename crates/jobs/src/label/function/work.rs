//! The work: read records, fit on the first part of each, judge on the rest.

use std::collections::BTreeMap;

use dynocal_label::graph::{FittedAxis, Graph, Op, Record};
use dynocal_label::label::Label;
use dynocal_label::linear::{Fit, huber};
use dynocal_label::nonlinear::{self, Target};
use dynocal_label::ve::judge::Decision;
use dynocal_numerics::watch::Watch;
use serde::Serialize;

use super::axes;
use super::coarse::{self, Chosen};
use super::record::{self, Read};
use super::spec::Job;
use super::{judge, said};
use crate::label::result::LabelJobError;

/// Share of the samples beyond the ends of an axis that is said.
const OUTSIDE: f64 = 0.05;

/// A fit of a function, the body of `summary.json`.
#[derive(Clone, Debug, Serialize)]
pub struct Fitted {
    /// Always `label`.
    pub verb: &'static str,
    /// Name of the run.
    pub name: String,
    /// Whether the labels may be used: converged, no time constant on its bound, and unseen samples are not explained worse than by the
    /// base.
    pub valid: bool,
    /// What is done with the labels; none where the search failed.
    pub decision: Decision,
    /// Improvement of the squares of unseen samples over its standard error, what it must be to count, and the independent measurements
    /// that unseen samples are worth.
    pub improvement: [f64; 3],
    /// What came out, in words.
    pub verdict: Vec<String>,
    /// What the user should know.
    pub warnings: Vec<String>,
    /// Labels with their base, on the axes that they have in the end.
    pub labels: Vec<Label>,
    /// Names of the axes that labels share.
    pub shared: Vec<String>,
    /// Axes that were fitted with the labels on them: the label of their breakpoints, and where they are axes, by number.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub fitted_axes: Vec<FittedAxis>,
    /// Values, intervals, verdicts.
    pub fit: Fit,
    /// Half widths of the 95 % intervals; none where no data tell of a cell.
    pub half_width: Vec<Option<f64>>,
    /// Steps of the search.
    pub steps: usize,
    /// Whether it has converged.
    pub converged: bool,
    /// Samples that are fitted, and those that judge, of all rows of the criterion.
    pub samples: [usize; 2],
    /// Weighted root mean square of target less node on the samples that judge, with the base and with the fitted labels.
    pub unseen_rms: [f64; 2],
    /// The same of each row of the criterion: node, channel, base, fitted, without the weight.
    pub rows: Vec<(String, String, f64, f64)>,
    /// Axes that were placed.
    pub chosen: Vec<Chosen>,
    /// Root mean square on the samples that judge before breakpoints were taken away.
    pub unseen_rms_full: Option<f64>,
    /// Name of the target.
    pub target: String,
    /// Files, relative to the run folder.
    pub files: Vec<String>,
    /// For the page: stamps, target and node of the first row on the first record.
    #[serde(skip)]
    pub drawn: [Vec<f64>; 3],
    /// For the page: what is left on samples that count, with where each was: names and units of the axes, columns, residuals.
    #[serde(skip)]
    pub left: Left,
}

/// What is left of the first row of the criterion, over what enters labels.
#[derive(Clone, Debug, Default)]
pub struct Left {
    /// Name and unit of what enters.
    pub over: Vec<(String, String)>,
    /// Stamps, then one column for each of `over`.
    pub columns: Vec<Vec<f64>>,
    /// Target less function.
    pub residual: Vec<f64>,
}

/// Fits in memory.
///
/// # Errors
/// [`LabelJobError`]: files, channels, the fit, an interruption.
pub fn fit(job: &Job, watch: Watch) -> Result<Fitted, LabelJobError> {
    let (mut records, mut notes): (Vec<Read>, Vec<String>) = (Vec::new(), Vec::new());
    for path in &job.data {
        watch.note(&format!("reading {}", path.display()));
        for read in record::read(path, job, &mut notes)? {
            let same = |r: &Read| {
                r.time_s == read.time_s && r.targets == read.targets && r.channels == read.channels
            };
            match records.iter().any(same) {
                true => notes.push(format!("{}: the same record again: it counts once", path.display())),
                false => records.push(read),
            }
        }
    }
    let (train, test): (Vec<Weights>, Vec<Weights>) = records.iter().map(|r| split(r, job)).unzip();
    let fitted = targets(job, &records, &train);
    let judging = targets(job, &records, &test);
    notes.extend(outside(job, &fitted));
    let interrupt = || watch.interrupted();
    let mut start = job.graph.base();
    if job.reduce > 1 {
        watch.note(&format!("fitting the labels on one in {} breakpoints", job.reduce));
        let coarse = coarse::every(&job.graph, job.reduce);
        let found = nonlinear::fit(&coarse, &fitted, &job.fit, &interrupt)?;
        start = coarse::spread(&job.graph, &coarse, &found.fit.exact);
    }
    watch.note("fitting the labels");
    let mut graph = job.graph.clone();
    let (mut found, stays) = axes::fit(job, &mut graph, start, &fitted, watch)?;
    notes.extend(stays);
    let (mut chosen, mut full_values) = (Vec::new(), None);
    if !job.placed.is_empty() {
        watch.note("placing breakpoints");
        full_values = Some((graph.clone(), found.fit.values.clone()));
        let full = graph;
        (graph, chosen) = coarse::place(&full, &job.placed, &found.fit.exact);
        let start = coarse::spread(&graph, &full, &found.fit.exact);
        found = nonlinear::fit_from(&graph, &start, &fitted, &job.fit, &interrupt)?;
    }
    if watch.interrupted() {
        return Err(LabelJobError::Interrupted);
    }
    let knee = job.fit.robust.then(|| judge::knee(&graph, &found.fit.values, &fitted));
    // The base on all breakpoints is what there was.
    let unseen_rms =
        [rms(&job.graph, &job.graph.base(), &judging, knee), rms(&graph, &found.fit.values, &judging, knee)];
    let unseen_rms_full = full_values.map(|(graph, values)| rms(&graph, &values, &judging, knee));
    let judged = judge::of(
        &judge::Sides { before: &job.graph, after: &graph, values: &found.fit.values, knee },
        &fitted,
        &judging,
        &found.fit,
    );
    let bounds = judge::on_bound(&graph, &found.fit.values);
    let rows = job.rows.iter().enumerate().map(|(k, row)| {
        // Targets stand record by record, each with all rows.
        let own: Vec<Target> = judging.iter().skip(k).step_by(job.rows.len()).cloned().collect();
        // Without the weight: in the unit of the channel.
        let of = |graph: &Graph, theta: &[f64]| rms(graph, theta, &own, knee) / row.weight.sqrt();
        let (before, after) = (of(&job.graph, &job.graph.base()), of(&graph, &found.fit.values));
        (row.name.clone(), row.target.clone(), before, after)
    });
    let rows: Vec<(String, String, f64, f64)> = rows.collect();
    let count = |all: &[Target]| all.iter().flat_map(|t| t.weights).filter(|v| **v > 0.0).count();
    let samples = [count(&fitted), count(&judging)];
    let first = &records[0];
    let nodes = graph.all_values(&found.fit.values, &fitted[0].record);
    let function = nodes[job.rows[0].node].clone();
    Ok(Fitted {
        verb: "label",
        name: job.name.clone(),
        valid: found.converged && bounds.is_empty() && judged.decision != Decision::Refuse,
        decision: judged.decision,
        improvement: [judged.improvement, judged.needed, judged.facts],
        verdict: said::verdict(&said::Came {
            converged: found.converged,
            judged: &judged,
            bounds: &bounds,
            rows: &rows,
            unseen_rms,
            samples,
            full: unseen_rms_full,
            fit: &found.fit,
            robust: job.fit.robust,
        }),
        warnings: said::warnings(&graph, &job.fitted, &found.fit, job.fit.extrapolate, notes),
        half_width: found.fit.half_width.iter().map(|h| h.is_finite().then_some(*h)).collect(),
        left: left(&graph, &nodes, first, job),
        labels: graph.labels_on(&job.fitted, &found.fit.values),
        shared: job.shared.clone(),
        fitted_axes: job.fitted.clone(),
        fit: found.fit,
        steps: found.steps,
        converged: found.converged,
        samples,
        unseen_rms,
        rows,
        chosen,
        unseen_rms_full,
        target: job.rows[0].target.clone(),
        files: Vec::new(),
        drawn: [first.time_s.clone(), first.targets[0].clone(), function],
    })
}

/// Labels that are read beyond their breakpoints by more than a few of the samples that are fitted: there they keep their edge.
fn outside(job: &Job, fitted: &[Target]) -> Vec<String> {
    let graph = &job.graph;
    let base = graph.base();
    // Samples that count, and those beyond the ends, of each axis of each label.
    let mut counts: BTreeMap<(usize, usize), [usize; 2]> = BTreeMap::new();
    for t in fitted {
        let nodes = graph.all_values(&base, &t.record);
        for node in &graph.nodes {
            let Op::Label(l, at) = &node.op else { continue };
            for (k, (input, axis)) in at.iter().zip(&graph.labels[*l].axes).enumerate() {
                let ends = [axis.points[0], axis.points[axis.points.len() - 1]];
                let input = axes::reads(graph, &job.fitted, *input);
                let own = counts.entry((*l, k)).or_default();
                for v in (0..t.y.len()).filter(|s| t.weights[*s] > 0.0).map(|s| nodes[input][s]) {
                    own[0] += 1;
                    own[1] += usize::from(v < ends[0] || v > ends[1]);
                }
            }
        }
    }
    let beyond = counts.into_iter().filter(|(_, [all, out])| *out as f64 > OUTSIDE * *all as f64);
    let word = |((l, k), [all, out]): ((usize, usize), [usize; 2])| {
        let (label, axis) = (&graph.labels[l], &graph.labels[l].axes[k]);
        format!(
            "{:.0} % of the samples lie beyond the breakpoints of `{}` ({} to {} {}), where `{}` keeps its edge: cells there are a mean of all that is beyond",
            100.0 * out as f64 / all as f64,
            axis.name,
            axis.points[0],
            axis.points[axis.points.len() - 1],
            axis.unit,
            label.name
        )
    };
    beyond.map(word).collect()
}

/// What is left of the first record, over each quantity that enters a label.
fn left(graph: &Graph, nodes: &[Vec<f64>], record: &Read, job: &Job) -> Left {
    let counts: Vec<usize> = (0..record.counts.len()).filter(|k| record.counts[*k]).collect();
    let of = |v: &[f64]| counts.iter().map(|k| v[*k]).collect::<Vec<f64>>();
    let mut out = Left { columns: vec![of(&record.time_s)], ..Left::default() };
    for node in &graph.nodes {
        let Op::Label(l, at) = &node.op else { continue };
        for (i, a) in at.iter().zip(&graph.labels[*l].axes) {
            let i = &axes::reads(graph, &job.fitted, *i);
            if !out.over.iter().any(|(name, _)| *name == a.name) {
                out.over.push((a.name.clone(), a.unit.clone()));
                out.columns.push(of(&nodes[*i]));
            }
        }
    }
    let row = &job.rows[0];
    out.residual = counts.iter().map(|k| record.targets[0][*k] - nodes[row.node][*k]).collect();
    out
}

/// Mean of a channel over the samples that count.
///
/// # Errors
/// [`LabelJobError`]: files, a channel that is missing.
pub fn mean_of(channel: &str, job: &Job) -> Result<f64, LabelJobError> {
    let (mut sum, mut n) = (0.0, 0.0);
    for path in &job.data {
        let units = vec![None];
        let own = Job { channels: vec![channel.into()], units, ..job.clone() };
        for record in record::read(path, &own, &mut Vec::new())? {
            for k in (0..record.counts.len()).filter(|k| record.counts[*k]) {
                sum += record.channels[0][k];
                n += 1.0;
            }
        }
    }
    Ok(sum / f64::max(n, 1.0))
}

/// Weights of a record, one list for each row of the criterion.
type Weights = Vec<Vec<f64>>;

/// Weights of the samples that are fitted, and of those that judge.
fn split(record: &Read, job: &Job) -> (Weights, Weights) {
    let all = record.counts.iter().filter(|c| **c).count();
    let cut = (job.train * all as f64).round() as usize;
    let mut seen = 0;
    let first: Vec<bool> = record
        .counts
        .iter()
        .map(|c| {
            seen += usize::from(*c);
            seen <= cut
        })
        .collect();
    let weights = |weight: f64, part: bool| -> Vec<f64> {
        let of = |k: usize| if record.counts[k] && first[k] == part { weight } else { 0.0 };
        (0..record.counts.len()).map(of).collect()
    };
    job.rows.iter().map(|r| (weights(r.weight, true), weights(r.weight, false))).unzip()
}

/// Each row of the criterion on each record, record by record.
fn targets<'a>(job: &Job, records: &'a [Read], weights: &'a [Weights]) -> Vec<Target<'a>> {
    let mut out = Vec::new();
    for (r, w) in records.iter().zip(weights) {
        for (k, row) in job.rows.iter().enumerate() {
            let record =
                Record { time_s: &r.time_s, channels: r.channels.iter().map(Vec::as_slice).collect() };
            out.push(Target { record, node: Some(row.node), y: &r.targets[k], weights: &w[k] });
        }
    }
    out
}

/// Root of the mean loss over the samples with a weight: root mean square, or with residuals beyond the knee counted by Huber's loss.
pub(super) fn rms(graph: &Graph, theta: &[f64], targets: &[Target], knee: Option<f64>) -> f64 {
    let (mut sum, mut n) = (0.0, 0.0);
    for t in targets {
        let y = &graph.all_values(theta, &t.record)[t.node.unwrap_or(graph.nodes.len() - 1)];
        for k in (0..y.len()).filter(|k| t.weights[*k] > 0.0) {
            sum += huber::loss(t.y[k] - y[k], t.weights[k], knee);
            n += 1.0;
        }
    }
    (sum / f64::max(n, 1.0)).sqrt()
}
