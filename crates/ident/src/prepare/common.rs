//! What the steps share: keys, choice of channels, splitting, stamps.

use dynocal_numerics::registry::BuildError;

use super::{Change, Effect, Outcome, PrepareError};
use crate::data::{Dataset, Gap, Role};

/// A fault in the keys of `step`.
pub(super) fn key_fault(step: &str, message: String) -> BuildError {
    BuildError::Keys { member: step.into(), message }
}

/// A positive finite number.
pub(super) fn positive(step: &str, key: &str, value: f64) -> Result<(), BuildError> {
    if value > 0.0 && value.is_finite() {
        return Ok(());
    }
    Err(key_fault(step, format!("found {key} = {value}, expected a positive number")))
}

/// `record` cannot take `step`.
pub(super) fn fault(step: &'static str, record: &Dataset, message: String) -> PrepareError {
    PrepareError::Step { step, record: record.name.clone(), message }
}

/// One change of a channel, or with none of the record.
pub(super) fn change(record: &Dataset, channel: Option<usize>, effect: Effect) -> Change {
    let channel = channel.map(|c| record.channels[c].name.clone());
    Change { record: record.name.clone(), channel, effect }
}

/// Indices of the named channels, or without names of all with one of `roles`.
pub(super) fn chosen(
    record: &Dataset,
    named: Option<&[String]>,
    roles: &[Role],
) -> Result<Vec<usize>, PrepareError> {
    let of_role = || {
        let all = record.channels.iter().enumerate();
        all.filter(|(_, c)| roles.contains(&c.role)).map(|(i, _)| i).collect()
    };
    let Some(names) = named else { return Ok(of_role()) };
    let index = |name: &String| {
        record.channel(name)?;
        Ok(record.channels.iter().position(|c| c.name == *name).unwrap_or(0))
    };
    names.iter().map(index).collect()
}

/// Inputs and outputs: what enters a model.
pub(super) const DRIVEN: &[Role] = &[Role::Input, Role::Output];

/// Samples of channel `c`, none of which is missing.
pub(super) fn complete<'a>(
    step: &'static str,
    record: &'a Dataset,
    c: usize,
) -> Result<&'a [f64], PrepareError> {
    let channel = &record.channels[c];
    match channel.values.iter().position(|v| v.is_nan()) {
        Some(t) => {
            let message = format!(
                "`{}` is missing at sample {t}; a step `missing` before this one fills or splits",
                channel.name
            );
            Err(fault(step, record, message))
        }
        None => Ok(&channel.values),
    }
}

/// Refuses a record whose stamps are not uniform.
pub(super) fn uniform(step: &'static str, record: &Dataset) -> Result<f64, PrepareError> {
    if record.sample_time_s.is_finite() {
        return Ok(record.sample_time_s);
    }
    let message = "the stamps are not uniform; a step `resample` before this one makes them".into();
    Err(fault(step, record, message))
}

/// Splits `record` at the rows `out`, which vanish; parts that have fewer than `least` rows after those that initialise
/// are given up, for no model could be scored on them.
pub(super) fn split(record: Dataset, out: &[Gap], least: usize, outcome: &mut Outcome) {
    if out.is_empty() {
        outcome.records.push(record);
        return;
    }
    let mut number = 0;
    let starts = std::iter::once(0).chain(out.iter().map(|g| g.to));
    let ends = out.iter().map(|g| g.from).chain([record.len()]);
    for (from, to) in starts.zip(ends).filter(|(from, to)| from < to) {
        let init = record.init_samples;
        if to - from < init + least {
            let why = match init {
                0 => format!("{} samples, at least {least} are asked for", to - from),
                _ => format!(
                    "{} samples, {init} initialise and at least {least} more are asked for",
                    to - from
                ),
            };
            outcome.changes.push(change(&record, None, Effect::Dropped { from, to, why }));
            continue;
        }
        number += 1;
        let part = record.part(from, to, format!("{}.{number}", record.name));
        let (of, sample_time_s) = (record.name.clone(), record.sample_time_s);
        outcome.changes.push(change(&part, None, Effect::Part { of, from, to, sample_time_s }));
        outcome.records.push(part);
    }
}

/// Union of the runs of several channels.
pub(super) fn union(n: usize, runs: &[&[Gap]]) -> Vec<Gap> {
    let mut out = vec![false; n];
    for g in runs.iter().flat_map(|r| r.iter()) {
        out[g.from..g.to].fill(true);
    }
    crate::data::runs(n, |t| out[t])
}

/// Times of the samples in s from the first one: of the channel `time` where it is named or the record has no
/// sample time (then `time`), else multiples of the sample time. With the index of that channel.
pub(super) fn stamps(
    step: &'static str,
    record: &Dataset,
    time: Option<&str>,
) -> Result<(Vec<f64>, Option<usize>), PrepareError> {
    if time.is_none() && record.sample_time_s.is_finite() {
        return Ok(((0..record.len()).map(|t| t as f64 * record.sample_time_s).collect(), None));
    }
    let name = time.unwrap_or("time").to_string();
    let c = chosen(record, Some(std::slice::from_ref(&name)), &[])?[0];
    let unit = match record.channels[c].unit.as_str() {
        "s" => 1.0,
        "ms" => 1e-3,
        other => {
            let message = format!("stamps `{name}` are in `{other}`, expected s or ms");
            return Err(fault(step, record, message));
        }
    };
    let raw = complete(step, record, c)?;
    if let Some(t) = (1..raw.len()).find(|t| raw[*t] <= raw[*t - 1]) {
        let message = format!(
            "stamps `{name}` do not rise at sample {t}: {} after {} {}",
            raw[t],
            raw[t - 1],
            record.channels[c].unit
        );
        return Err(fault(step, record, message));
    }
    let first = raw.first().copied().unwrap_or(0.0);
    Ok((raw.iter().map(|t| (t - first) * unit).collect(), Some(c)))
}

/// Middle value; the slice is reordered. NaN for an empty one.
pub(super) fn median(values: &mut [f64]) -> f64 {
    let n = values.len();
    if n == 0 {
        return f64::NAN;
    }
    let (below, middle, _) = values.select_nth_unstable_by(n / 2, f64::total_cmp);
    if n % 2 == 1 {
        return *middle;
    }
    0.5 * (*middle + below.iter().copied().fold(f64::NEG_INFINITY, f64::max))
}
