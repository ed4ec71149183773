//! The work: read records, fit on the first part of each, judge on the rest.

use std::path::Path;

use dynocal_files::FilesError;
use dynocal_files::measurement::{ReadKeys, open, recording_of};
use dynocal_files::table::Cells;
use dynocal_label::graph::{Graph, Op, Record};
use dynocal_label::label::Label;
use dynocal_label::linear::Fit;
use dynocal_label::nonlinear::{self, Target};
use dynocal_numerics::watch::Watch;
use serde::Serialize;

use super::coarse::{self, Chosen};
use super::spec::{Condition, Job};
use crate::label::result::LabelJobError;

/// A fit of a function, the body of `summary.json`.
#[derive(Clone, Debug, Serialize)]
pub struct Fitted {
    /// Always `label`.
    pub verb: &'static str,
    /// Name of the run.
    pub name: String,
    /// Whether the labels may be used: converged, and unseen samples are explained no worse than by the base.
    pub valid: bool,
    /// What came out, in words.
    pub verdict: Vec<String>,
    /// Labels with their base, on the axes that they have in the end.
    pub labels: Vec<Label>,
    /// Names of the axes that labels share.
    pub shared: Vec<String>,
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

struct Read {
    time_s: Vec<f64>,
    channels: Vec<Vec<f64>>,
    targets: Vec<Vec<f64>>,
    counts: Vec<bool>,
}

/// Fits in memory.
///
/// # Errors
/// [`LabelJobError`]: files, channels, the fit, an interruption.
pub fn fit(job: &Job, watch: Watch) -> Result<Fitted, LabelJobError> {
    let mut records = Vec::new();
    for path in &job.data {
        watch.note(&format!("reading {}", path.display()));
        records.push(read(path, job)?);
    }
    let (train, test): (Vec<Weights>, Vec<Weights>) = records.iter().map(|r| split(r, job)).unzip();
    let fitted = targets(job, &records, &train);
    let judging = targets(job, &records, &test);
    let interrupt = || watch.interrupted();
    let mut start = job.graph.base();
    if job.reduce > 1 {
        watch.note(&format!("fitting the labels on every {}th breakpoint", job.reduce));
        let coarse = coarse::every(&job.graph, job.reduce);
        let found = nonlinear::fit(&coarse, &fitted, &job.fit, &interrupt)?;
        start = coarse::spread(&job.graph, &coarse, &found.fit.exact);
    }
    watch.note("fitting the labels");
    let mut graph = job.graph.clone();
    let mut found = nonlinear::fit_from(&graph, &start, &fitted, &job.fit, &interrupt)?;
    let (mut chosen, mut unseen_rms_full) = (Vec::new(), None);
    if !job.placed.is_empty() {
        watch.note("placing breakpoints");
        unseen_rms_full = Some(rms(&graph, &found.fit.values, &judging));
        let full = graph;
        (graph, chosen) = coarse::place(&full, &job.placed, &found.fit.exact);
        let start = coarse::spread(&graph, &full, &found.fit.exact);
        found = nonlinear::fit_from(&graph, &start, &fitted, &job.fit, &interrupt)?;
    }
    if watch.interrupted() {
        return Err(LabelJobError::Interrupted);
    }
    // The base on all breakpoints is what there was.
    let unseen_rms = [rms(&job.graph, &job.graph.base(), &judging), rms(&graph, &found.fit.values, &judging)];
    let rows = job.rows.iter().enumerate().map(|(k, row)| {
        // Targets stand record by record, each with all rows.
        let own: Vec<Target> = judging.iter().skip(k).step_by(job.rows.len()).cloned().collect();
        // Without the weight: in the unit of the channel.
        let of = |graph: &Graph, theta: &[f64]| rms(graph, theta, &own) / row.weight.sqrt();
        let (before, after) = (of(&job.graph, &job.graph.base()), of(&graph, &found.fit.values));
        (row.name.clone(), row.target.clone(), before, after)
    });
    let rows = rows.collect();
    let count = |all: &[Target]| all.iter().flat_map(|t| t.weights).filter(|v| **v > 0.0).count();
    let samples = [count(&fitted), count(&judging)];
    let first = &records[0];
    let nodes = graph.all_values(&found.fit.values, &fitted[0].record);
    let function = nodes[job.rows[0].node].clone();
    Ok(Fitted {
        verb: "label",
        name: job.name.clone(),
        valid: found.converged && unseen_rms[1] <= unseen_rms[0],
        verdict: verdict(job, found.converged, unseen_rms, samples, unseen_rms_full),
        half_width: found.fit.half_width.iter().map(|h| h.is_finite().then_some(*h)).collect(),
        left: left(&graph, &nodes, first, job),
        labels: graph.labels,
        shared: job.shared.clone(),
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

/// What is left of the first record, over each quantity that enters a label.
fn left(graph: &Graph, nodes: &[Vec<f64>], record: &Read, job: &Job) -> Left {
    let counts: Vec<usize> = (0..record.counts.len()).filter(|k| record.counts[*k]).collect();
    let of = |v: &[f64]| counts.iter().map(|k| v[*k]).collect::<Vec<f64>>();
    let mut out = Left { columns: vec![of(&record.time_s)], ..Left::default() };
    for node in &graph.nodes {
        let Op::Label(l, at) = &node.op else { continue };
        for (i, a) in at.iter().zip(&graph.labels[*l].axes) {
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
        let record = read(path, &Job { channels: vec![channel.into()], ..job.clone() })?;
        for k in (0..record.counts.len()).filter(|k| record.counts[*k]) {
            sum += record.channels[0][k];
            n += 1.0;
        }
    }
    Ok(sum / f64::max(n, 1.0))
}

fn verdict(job: &Job, converged: bool, rms: [f64; 2], samples: [usize; 2], full: Option<f64>) -> Vec<String> {
    let first = if !converged {
        "The search has not converged: the labels must not be used. No file is written."
    } else if rms[1] <= rms[0] {
        "The labels may be used: they explain the samples that they were not fitted to no worse than the base."
    } else {
        "The labels are refused: they explain the samples that they were not fitted to worse than the base. No file is written."
    };
    let what = match job.rows.as_slice() {
        [row] => format!("`{}` is", row.target),
        _ => "the weighted sum of all rows is".into(),
    };
    let numbers = format!(
        "On {} later samples {what} left by {:.4} (root mean square) with the base and by {:.4} with the fitted labels; {} samples were fitted.",
        samples[1], rms[0], rms[1], samples[0]
    );
    let mut out = vec![first.into(), numbers];
    if let Some(full) = full {
        out.push(format!(
            "Breakpoints were taken away and placed anew: with all of them the later samples are left by {full:.4}, with those that stay by {:.4}.",
            rms[1]
        ));
    }
    out
}

fn read(path: &Path, job: &Job) -> Result<Read, LabelJobError> {
    let file = path.display().to_string();
    let targets = job.rows.iter().map(|r| &r.target);
    let wanted: Vec<&String> =
        job.channels.iter().chain(targets).chain(job.conditions.iter().map(|c| &c.channel)).collect();
    let source = open(path, None, &ReadKeys::default())?;
    let recording = recording_of(source.as_ref(), &|name| wanted.iter().any(|w| *w == name))?;
    let raster = recording.rasters.into_iter().max_by_key(|r| r.columns.len());
    let raster = raster.ok_or_else(|| FilesError::Empty { path: file.clone(), expected: "a record" })?;
    let column = |name: &str| -> Result<Vec<f64>, LabelJobError> {
        match raster.columns.iter().find(|c| c.name == name).map(|c| &c.cells) {
            Some(Cells::Number(v)) => Ok(v.clone()),
            _ => Err(LabelJobError::Channel {
                file: file.clone(),
                what: "the function",
                expected: format!("`{name}` (with numbers, in one raster with the others)"),
                known: source
                    .groups()
                    .iter()
                    .flat_map(|g| &g.channels)
                    .map(|c| c.name.as_str())
                    .collect::<Vec<_>>()
                    .join(", "),
            }),
        }
    };
    for (name, unit) in job.channels.iter().zip(&job.units) {
        let measured = raster.columns.iter().find(|c| c.name == *name).and_then(|c| c.unit.as_ref());
        if let (Some(unit), Some((measured, _))) = (unit, measured)
            && unit != measured
        {
            return Err(LabelJobError::Unit {
                file: file.clone(),
                channel: name.clone(),
                found: measured.clone(),
                expected: unit.clone(),
            });
        }
    }
    let channels = job.channels.iter().map(|c| column(c)).collect::<Result<Vec<_>, _>>()?;
    let targets = job.rows.iter().map(|r| column(&r.target)).collect::<Result<Vec<_>, _>>()?;
    let mut counts: Vec<bool> =
        (0..raster.time_s.len()).map(|k| targets.iter().all(|t| t[k].is_finite())).collect();
    for c in &job.conditions {
        let v = column(&c.channel)?;
        let slow = slow(c, &raster.time_s, &v);
        counts.iter_mut().zip(v).zip(slow).for_each(|((o, v), slow)| *o &= slow && within(c, v));
    }
    Ok(Read { time_s: raster.time_s, channels, targets, counts })
}

fn within(c: &Condition, v: f64) -> bool {
    v >= c.least.unwrap_or(f64::NEG_INFINITY) && v <= c.greatest.unwrap_or(f64::INFINITY)
}

/// Time in s over which a rate is measured: shorter and it is that of the noise.
const RATE_OVER_S: f64 = 0.1;

/// Whether the channel has been slow for as long as the condition asks.
fn slow(c: &Condition, time_s: &[f64], v: &[f64]) -> Vec<bool> {
    let Some(most) = c.slower_than else { return vec![true; v.len()] };
    let (mut from, mut last_fast) = (0, f64::NEG_INFINITY);
    (0..v.len())
        .map(|k| {
            while from + 1 < k && time_s[k] - time_s[from + 1] >= RATE_OVER_S {
                from += 1;
            }
            let (dt, change) = (time_s[k] - time_s[from], (v[k] - v[from]).abs());
            if dt > 0.0 && !(change <= most * dt * v[k].abs()) {
                last_fast = time_s[k];
            }
            time_s[k] - last_fast > c.for_s.unwrap_or(0.0)
        })
        .collect()
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

/// Root mean square over the samples with a weight, weighted.
fn rms(graph: &Graph, theta: &[f64], targets: &[Target]) -> f64 {
    let (mut sum, mut n) = (0.0, 0.0);
    for t in targets {
        let y = &graph.all_values(theta, &t.record)[t.node.unwrap_or(graph.nodes.len() - 1)];
        for k in (0..y.len()).filter(|k| t.weights[*k] > 0.0) {
            sum += t.weights[k] * (t.y[k] - y[k]).powi(2);
            n += 1.0;
        }
    }
    (sum / f64::max(n, 1.0)).sqrt()
}
