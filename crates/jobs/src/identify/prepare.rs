//! The preparation of the spec: learnt on the estimation records, repeated on all others.

use std::path::Path;

use dynocal_files::csv_io;
use dynocal_ident::data::{DataError, Dataset};
use dynocal_ident::prepare::{Note, Planned, again, prepare, repeat, restore};
use dynocal_numerics::registry::BuildError;

use super::error::IdentifyError;
use super::load::Part;
use super::result::in_step;
use super::result::{Prepared, Stage};
use super::spec::{Job, StepSpec};

/// Most samples of the record that is kept of every stage, to be looked at.
const KEPT: usize = 4000;

/// Steps as the preparation wants them.
///
/// # Errors
/// [`BuildError`].
pub fn plan(steps: &[StepSpec]) -> Result<Vec<Planned>, BuildError> {
    steps.iter().map(|s| Planned::new(&s.step, &s.keys)).collect()
}

/// Prepares all parts in place. What a step learns (means, scales) it learns from the estimation; the first estimation
/// record is written to `dir`, where there is one, before the first step and after each.
///
/// # Errors
/// [`IdentifyError`]: a step that a record cannot take, or files.
pub fn prepare_parts(
    job: &Job,
    parts: &mut [Part],
    dir: Option<&Path>,
) -> Result<Vec<Prepared>, IdentifyError> {
    let mut steps = match job.saved.first() {
        Some(_) => stored(job, parts)?,
        None => plan(&job.prepare)?,
    };
    if steps.is_empty() {
        return Ok(Vec::new());
    }
    let names: Vec<String> = steps.iter().map(|s| s.name.clone()).collect();
    let mut out: Vec<Prepared> = Vec::new();
    for part in parts {
        let mut stages: Vec<Dataset> = Vec::new();
        let first = out.is_empty();
        let mut watch = |_: usize, records: &[Dataset]| {
            if first && let Some(d) = records.first() {
                stages.push(head(d));
            }
        };
        let (records, notes) = prepare(&steps, std::mem::take(&mut part.records), &mut watch)?;
        part.records = records;
        if first && job.saved.is_empty() {
            steps = repeat(&steps, &notes)?;
        }
        let stages = dir.map_or(Ok(Vec::new()), |dir| write(&stages, &names, dir))?;
        out.push(Prepared { part: part.name.clone(), notes, stages });
    }
    Ok(out)
}

/// The preparation that is stored with the models: what they were estimated on is what they are scored on. It takes the
/// place of that of the spec.
fn stored(job: &Job, parts: &[Part]) -> Result<Vec<Planned>, IdentifyError> {
    let Some(first) = job.saved.first() else { return Ok(Vec::new()) };
    let alike = |a: &Note, b: &Note| (&a.step, &a.keys, &a.changes) == (&b.step, &b.keys, &b.changes);
    for other in &job.saved[1..] {
        let same = first.preparation.len() == other.preparation.len()
            && first.preparation.iter().zip(&other.preparation).all(|(a, b)| alike(a, b));
        if !same {
            let (first, second) = (first.output.name.clone(), other.output.name.clone());
            return Err(IdentifyError::Preparations { first, second });
        }
    }
    let records = parts.iter().flat_map(|p| &p.records);
    let present: Vec<String> =
        records.take(1).flat_map(|d| d.channels.iter().map(|c| c.name.clone())).collect();
    Ok(again(&first.preparation, &present)?)
}

/// The start of a record.
fn head(d: &Dataset) -> Dataset {
    let mut d = d.clone();
    d.channels.iter_mut().for_each(|c| c.values.truncate(KEPT));
    d
}

fn write(stages: &[Dataset], steps: &[String], dir: &Path) -> Result<Vec<Stage>, IdentifyError> {
    let mut out = Vec::new();
    for (k, d) in stages.iter().enumerate() {
        let step = k.checked_sub(1).map_or("recorded", |k| steps[k].as_str());
        let file = format!("prepare-{k}-{step}.csv");
        let stamps = d.channels.iter().find(|c| c.name == dynocal_files::dataset::STAMPS);
        let time: Vec<f64> = match stamps {
            Some(c) => c.values.clone(),
            None => (0..d.len()).map(|t| t as f64 * d.sample_time_s).collect(),
        };
        let mut columns: Vec<(&str, &str, &[f64])> = vec![("time", "s", &time)];
        for c in d.channels.iter().filter(|c| c.name != "time") {
            columns.push((&c.name, &c.unit, &c.values));
        }
        csv_io::write_columns(&dir.join(&file), &columns)?;
        out.push(Stage { step: step.into(), record: d.name.clone(), file: in_step(&file) });
    }
    Ok(out)
}

/// `values` of a channel of a prepared record in the channel's own unit and level.
///
/// # Errors
/// [`IdentifyError`]: a trend whose time is lost.
pub fn restored(notes: &[Note], d: &Dataset, channel: &str, values: &mut [f64]) -> Result<(), IdentifyError> {
    Ok(restore(notes, &d.name, channel, d.sample_time_s, values)?)
}

/// Unit of a channel before all steps.
///
/// # Errors
/// [`DataError::NoChannel`].
pub fn own_unit(notes: &[Note], d: &Dataset, channel: &str) -> Result<String, DataError> {
    let first = notes.iter().flat_map(|n| &n.changes).find_map(|c| match &c.effect {
        dynocal_ident::prepare::Effect::Divided { unit, .. } if c.channel.as_deref() == Some(channel) => {
            Some(unit.clone())
        }
        _ => None,
    });
    first.map_or_else(|| Ok(d.channel(channel)?.unit.clone()), Ok)
}
