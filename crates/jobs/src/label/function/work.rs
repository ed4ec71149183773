//! The work: read records, fit on the first part of each, judge on the rest.

use std::path::Path;

use dynocal_files::FilesError;
use dynocal_files::measurement::{ReadKeys, open, recording_of};
use dynocal_files::table::Cells;
use dynocal_label::graph::{Graph, Record};
use dynocal_label::label::Label;
use dynocal_label::linear::Fit;
use dynocal_label::nonlinear::{self, Target};
use dynocal_numerics::watch::Watch;
use serde::Serialize;

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
    /// Labels with their base.
    pub labels: Vec<Label>,
    /// Values, intervals, verdicts.
    pub fit: Fit,
    /// Half widths of the 95 % intervals; none where no data tell of a cell.
    pub half_width: Vec<Option<f64>>,
    /// Steps of the search.
    pub steps: usize,
    /// Whether it has converged.
    pub converged: bool,
    /// Samples that are fitted, and those that judge.
    pub samples: [usize; 2],
    /// Root mean square of target less function on the samples that judge, with the base and with the fitted labels.
    pub unseen_rms: [f64; 2],
    /// Name of the target.
    pub target: String,
    /// Files, relative to the run folder.
    pub files: Vec<String>,
    /// For the page: stamps, target and function of the first record.
    #[serde(skip)]
    pub drawn: [Vec<f64>; 3],
}

struct Read {
    time_s: Vec<f64>,
    channels: Vec<Vec<f64>>,
    target: Vec<f64>,
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
    let (train, test): (Vec<Vec<f64>>, Vec<Vec<f64>>) =
        records.iter().map(|r| split(&r.counts, job.train)).unzip();
    watch.note("fitting the labels");
    let targets: Vec<Target> = records.iter().zip(&train).map(|(r, w)| target(r, w)).collect();
    let found = nonlinear::fit(&job.graph, &targets, &job.fit, &|| watch.interrupted())?;
    if watch.interrupted() {
        return Err(LabelJobError::Interrupted);
    }
    let unseen = |theta: &[f64]| rms(&job.graph, theta, &records, &test);
    let unseen_rms = [unseen(&job.graph.base()), unseen(&found.fit.values)];
    let count = |w: &[Vec<f64>]| w.iter().flatten().filter(|v| **v > 0.0).count();
    let samples = [count(&train), count(&test)];
    let better = unseen_rms[1] <= unseen_rms[0];
    let first = &records[0];
    let function = job.graph.values(&found.fit.values, &target(first, &train[0]).record);
    Ok(Fitted {
        verb: "label",
        name: job.name.clone(),
        valid: found.converged && better,
        verdict: verdict(job, found.converged, unseen_rms, samples),
        half_width: found.fit.half_width.iter().map(|h| h.is_finite().then_some(*h)).collect(),
        labels: job.graph.labels.clone(),
        fit: found.fit,
        steps: found.steps,
        converged: found.converged,
        samples,
        unseen_rms,
        target: job.target.clone(),
        files: Vec::new(),
        drawn: [first.time_s.clone(), first.target.clone(), function],
    })
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

fn verdict(job: &Job, converged: bool, rms: [f64; 2], samples: [usize; 2]) -> Vec<String> {
    let first = if !converged {
        "The search has not converged: the labels must not be used. No file is written."
    } else if rms[1] <= rms[0] {
        "The labels may be used: they explain the samples that they were not fitted to no worse than the base."
    } else {
        "The labels are refused: they explain the samples that they were not fitted to worse than the base. No file is written."
    };
    let numbers = format!(
        "On {} later samples `{}` is left by {:.4} (root mean square) with the base and by {:.4} with the fitted labels; {} samples were fitted.",
        samples[1], job.target, rms[0], rms[1], samples[0]
    );
    vec![first.into(), numbers]
}

fn read(path: &Path, job: &Job) -> Result<Read, LabelJobError> {
    let file = path.display().to_string();
    let wanted: Vec<&String> =
        job.channels.iter().chain([&job.target]).chain(job.conditions.iter().map(|c| &c.channel)).collect();
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
    let channels = job.channels.iter().map(|c| column(c)).collect::<Result<Vec<_>, _>>()?;
    let target = column(&job.target)?;
    let mut counts: Vec<bool> = target.iter().map(|v| v.is_finite()).collect();
    for c in &job.conditions {
        let v = column(&c.channel)?;
        counts.iter_mut().zip(v).for_each(|(o, v)| *o &= within(c, v));
    }
    Ok(Read { time_s: raster.time_s, channels, target, counts })
}

fn within(c: &Condition, v: f64) -> bool {
    v >= c.least.unwrap_or(f64::NEG_INFINITY) && v <= c.greatest.unwrap_or(f64::INFINITY)
}

/// Weights of the samples that are fitted, and of those that judge.
fn split(counts: &[bool], train: f64) -> (Vec<f64>, Vec<f64>) {
    let all = counts.iter().filter(|c| **c).count();
    let cut = (train * all as f64).round() as usize;
    let mut seen = 0;
    counts
        .iter()
        .map(|c| {
            seen += usize::from(*c);
            let first = seen <= cut;
            (f64::from(u8::from(*c && first)), f64::from(u8::from(*c && !first)))
        })
        .unzip()
}

fn target<'a>(r: &'a Read, weights: &'a [f64]) -> Target<'a> {
    let record = Record { time_s: &r.time_s, channels: r.channels.iter().map(Vec::as_slice).collect() };
    Target { record, y: &r.target, weights }
}

fn rms(graph: &Graph, theta: &[f64], records: &[Read], weights: &[Vec<f64>]) -> f64 {
    let (mut sum, mut n) = (0.0, 0.0);
    for (r, w) in records.iter().zip(weights) {
        let y = graph.values(theta, &target(r, w).record);
        for k in (0..y.len()).filter(|k| w[*k] > 0.0) {
            sum += (r.target[k] - y[k]).powi(2);
            n += 1.0;
        }
    }
    (sum / f64::max(n, 1.0)).sqrt()
}
