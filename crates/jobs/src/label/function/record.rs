//! Records of a fit: what the function reads, what it is compared with, and which samples count.

use std::path::Path;

use dynocal_files::FilesError;
use dynocal_files::measurement::{ReadKeys, open, recording_of};
use dynocal_files::table::Cells;
use dynocal_label::ve::mask;

use super::spec::{Condition, Job};
use crate::label::result::LabelJobError;
use crate::label::{channels, stamps};

/// A record.
pub(super) struct Read {
    pub(super) time_s: Vec<f64>,
    pub(super) channels: Vec<Vec<f64>>,
    pub(super) targets: Vec<Vec<f64>>,
    pub(super) counts: Vec<bool>,
}

/// Records of a file: one, or several where its clock was set back. Samples at which the function has no number, or no stamp, are as if
/// they had not been logged; what was left out is said in `notes`.
///
/// # Errors
/// [`LabelJobError`]: files, channels, units.
pub(super) fn read(path: &Path, job: &Job, notes: &mut Vec<String>) -> Result<Vec<Read>, LabelJobError> {
    let file = path.display().to_string();
    let targets = job.rows.iter().map(|r| &r.target);
    let wanted: Vec<&String> =
        job.channels.iter().chain(targets).chain(job.conditions.iter().map(|c| &c.channel)).collect();
    let source = open(path, None, &ReadKeys::default())?;
    let recording = recording_of(source.as_ref(), &|name| wanted.iter().any(|w| *w == name))?;
    let raster = recording.rasters.into_iter().max_by_key(|r| r.columns.len());
    let known = || {
        let all = source.groups().iter().flat_map(|g| &g.channels).map(|c| c.name.as_str());
        all.collect::<Vec<_>>().join(", ")
    };
    let missing = |name: &str| LabelJobError::Channel {
        file: file.clone(),
        what: "the function",
        expected: format!("`{name}` (with numbers, in one raster with the others)"),
        known: known(),
    };
    let raster = raster.ok_or_else(|| missing(wanted.first().map_or("-", |w| w.as_str())))?;
    let column = |name: &str| -> Result<Vec<f64>, LabelJobError> {
        match raster.columns.iter().find(|c| c.name == name).map(|c| &c.cells) {
            Some(Cells::Number(v)) => Ok(v.clone()),
            _ => Err(missing(name)),
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
    let conditions = job.conditions.iter().map(|c| column(&c.channel)).collect::<Result<Vec<_>, _>>()?;
    let order = stamps::ordered(&raster.time_s);
    notes.extend(order.said.iter().map(|n| format!("{file}: {n}")));
    if let Some(name) = &job.lambda {
        is_lambda(&file, name, &column(name)?)?;
    }
    holes(&file, job, &channels, &targets, notes);
    let ends = order.starts.iter().skip(1).copied().chain([order.keep.len()]);
    let mut out = Vec::new();
    for (from, to) in order.starts.iter().copied().zip(ends) {
        let finite = |k: &&usize| channels.iter().all(|c| c[**k].is_finite());
        let keep: Vec<usize> = order.keep[from..to].iter().filter(finite).copied().collect();
        let kept = |v: &Vec<f64>| keep.iter().map(|k| v[*k]).collect::<Vec<f64>>();
        let mut read = Read {
            time_s: kept(&raster.time_s),
            channels: channels.iter().map(kept).collect(),
            targets: targets.iter().map(kept).collect(),
            counts: vec![true; keep.len()],
        };
        count(job, &mut read, &conditions.iter().map(kept).collect::<Vec<_>>());
        if !read.time_s.is_empty() {
            out.push(read);
        }
    }
    match out.is_empty() {
        true => Err(FilesError::Empty {
            path: file,
            expected: "a record with a number in every channel of the function",
        }
        .into()),
        false => Ok(out),
    }
}

/// Says which samples have no number.
fn holes(file: &str, job: &Job, channels: &[Vec<f64>], targets: &[Vec<f64>], notes: &mut Vec<String>) {
    let rows = job.rows.iter().map(|r| &r.target);
    let inputs = job.channels.iter().zip(channels).map(|c| (c, "are left out"));
    for ((name, v), what) in inputs.chain(rows.zip(targets).map(|c| (c, "do not count"))) {
        let lost = v.iter().filter(|v| !v.is_finite()).count();
        if let Some(first) = v.iter().position(|v| !v.is_finite()) {
            notes.push(format!(
                "{file}: {lost} samples without a number in `{name}` {what} (the first is sample {})",
                first + 1
            ));
        }
    }
}

/// Samples that count: where a target has a number and all conditions hold; of a lambda, where its sensor says one.
fn count(job: &Job, read: &mut Read, conditions: &[Vec<f64>]) {
    let n = read.time_s.len();
    let mut counts: Vec<bool> = (0..n).map(|k| read.targets.iter().all(|t| t[k].is_finite())).collect();
    for (c, v) in job.conditions.iter().zip(conditions) {
        let holds = holds(c, &read.time_s, v);
        counts.iter_mut().zip(holds).for_each(|(o, holds)| *o &= holds);
    }
    let lambda = job.lambda.as_ref().and_then(|name| job.rows.iter().position(|r| r.target == *name));
    if let Some(row) = lambda {
        let sensed = mask::sensed(&read.time_s, &read.targets[row]);
        counts.iter_mut().zip(sensed).for_each(|(o, sensed)| *o &= sensed);
    }
    read.counts = counts;
}

/// Whether the values are those of a lambda.
fn is_lambda(file: &str, name: &str, values: &[f64]) -> Result<(), LabelJobError> {
    match channels::median(values).filter(|m| !(0.4..=3.0).contains(m)) {
        Some(median) => Err(LabelJobError::Lambda { file: file.into(), channel: name.into(), median }),
        None => Ok(()),
    }
}

fn within(c: &Condition, v: f64) -> bool {
    v >= c.least.unwrap_or(f64::NEG_INFINITY) && v <= c.greatest.unwrap_or(f64::INFINITY)
}

/// Time in s over which a rate is measured: shorter and it is that of the noise.
const RATE_OVER_S: f64 = 0.1;

/// Whether the condition holds, and has held for as long as it asks.
fn holds(c: &Condition, time_s: &[f64], v: &[f64]) -> Vec<bool> {
    let (mut from, mut last_out) = (0, f64::NEG_INFINITY);
    (0..v.len())
        .map(|k| {
            while from + 1 < k && time_s[k] - time_s[from + 1] >= RATE_OVER_S {
                from += 1;
            }
            let (dt, change) = (time_s[k] - time_s[from], (v[k] - v[from]).abs());
            let fast = c.slower_than.is_some_and(|most| dt > 0.0 && !(change <= most * dt * v[k].abs()));
            if fast || !within(c, v[k]) {
                last_out = time_s[k];
            }
            // Without a time the sample alone counts.
            time_s[k] - last_out > c.for_s.unwrap_or(0.0)
        })
        .collect()
}
