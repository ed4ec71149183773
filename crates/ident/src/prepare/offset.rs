//! Offsets and trends are subtracted: the mean, a given operating point, or a straight line in time.

use std::collections::BTreeMap;

use dynocal_numerics::registry::{self, Member, MemberDoc, ParamDoc};
use serde::Deserialize;

use super::common::{DRIVEN, change, chosen, fault, key_fault, uniform};
use super::{Change, Effect, Outcome, PrepareError, Step};
use crate::data::{Channel, Dataset};

const NAME: &str = "offset";

pub(super) const MEMBER: Member<dyn Step> = Member {
    doc: MemberDoc {
        name: NAME,
        what: "subtracts the mean, an operating point or a linear trend",
        params: &[
            ParamDoc {
                name: "remove",
                unit: "-",
                default: "mean, or point where `at` is given",
                what: "mean, point, trend (least-squares line in time, of each record)",
            },
            ParamDoc {
                name: "at",
                unit: "channel",
                default: "",
                what: "operating point: a table channel = value; only these channels are changed",
            },
            ParamDoc {
                name: "per_record",
                unit: "-",
                default: "false",
                what: "a mean of each record instead of one over all (records of one system keep one zero)",
            },
            ParamDoc {
                name: "channels",
                unit: "-",
                default: "inputs and outputs",
                what: "channels that are changed",
            },
        ],
    },
    build: |keys| {
        let step: Offset = registry::keys(NAME, keys)?;
        let point = step.remove == Some(Remove::Point) || step.remove.is_none() && step.at.is_some();
        if point != step.at.is_some() {
            let message = "`at` = { channel = value } and remove = \"point\" belong together".into();
            return Err(key_fault(NAME, message));
        }
        if point && (step.channels.is_some() || step.per_record) {
            let message = "`at` names its channels; `channels` and `per_record` do not go with it".into();
            return Err(key_fault(NAME, message));
        }
        if let Some((name, v)) = step.at.iter().flatten().find(|(_, v)| !v.is_finite()) {
            return Err(key_fault(NAME, format!("found {name} = {v}, expected a finite number")));
        }
        Ok(Box::new(step))
    },
};

#[derive(Clone, Copy, PartialEq, Deserialize)]
#[serde(rename_all = "snake_case")]
enum Remove {
    Mean,
    Point,
    Trend,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Offset {
    remove: Option<Remove>,
    at: Option<BTreeMap<String, f64>>,
    #[serde(default)]
    per_record: bool,
    channels: Option<Vec<String>>,
}

impl Step for Offset {
    fn apply(&self, mut records: Vec<Dataset>) -> Result<Outcome, PrepareError> {
        let lines = records.iter().map(|r| self.lines(r, &records)).collect::<Result<Vec<_>, _>>()?;
        let mut outcome = Outcome::default();
        for (record, lines) in records.iter_mut().zip(lines) {
            for (c, level, slope_per_s) in lines {
                let per_sample = if slope_per_s == 0.0 { 0.0 } else { slope_per_s * record.sample_time_s };
                let values = &mut record.channels[c].values;
                values.iter_mut().enumerate().for_each(|(t, v)| *v -= level + per_sample * t as f64);
                outcome.changes.push(change(record, Some(c), Effect::Subtracted { level, slope_per_s }));
            }
        }
        outcome.records = records;
        Ok(outcome)
    }

    /// The means of the estimation records, for others; a trend belongs to its record and is found anew.
    fn learnt(&self, changes: &[Change]) -> Option<Box<dyn Step>> {
        if self.per_record || self.remove == Some(Remove::Trend) {
            return None;
        }
        let level = |c: &Change| match (&c.channel, &c.effect) {
            (Some(name), Effect::Subtracted { level, .. }) => Some((name.clone(), *level)),
            _ => None,
        };
        let at = changes.iter().filter_map(level).collect();
        Some(Box::new(Self { remove: Some(Remove::Point), at: Some(at), per_record: false, channels: None }))
    }
}

impl Offset {
    /// (channel, level, slope per s) of every line to subtract from `record`.
    fn lines(&self, record: &Dataset, all: &[Dataset]) -> Result<Vec<(usize, f64, f64)>, PrepareError> {
        if let Some(at) = &self.at {
            let one = |(name, level): (&String, &f64)| {
                Ok((chosen(record, Some(std::slice::from_ref(name)), &[])?[0], *level, 0.0))
            };
            return at.iter().map(one).collect();
        }
        let channels = chosen(record, self.channels.as_deref(), DRIVEN)?;
        let one = |c: usize| {
            let channel = &record.channels[c];
            if self.remove == Some(Remove::Trend) {
                let (level, slope) = line(&channel.values);
                return Ok((c, level, slope / uniform(NAME, record)?));
            }
            let meant = if self.per_record { std::slice::from_ref(record) } else { all };
            let mean = mean(&channel.name, meant)?;
            if mean.is_nan() {
                return Err(fault(NAME, record, format!("`{}` has no sample", channel.name)));
            }
            Ok((c, mean, 0.0))
        };
        channels.into_iter().map(one).collect()
    }
}

/// Mean of the known samples of a channel in all `records`.
fn mean(channel: &str, records: &[Dataset]) -> Result<f64, PrepareError> {
    let channels = records.iter().map(|r| r.channel(channel)).collect::<Result<Vec<&Channel>, _>>()?;
    let known = || channels.iter().flat_map(|c| &c.values).filter(|v| !v.is_nan());
    let n = known().count() as f64;
    let mean = known().sum::<f64>() / n;
    // A second pass takes the rounding of the long sum away.
    Ok(mean + known().map(|v| v - mean).sum::<f64>() / n)
}

/// Least-squares line through the known samples: value at sample 0 and rise per sample.
fn line(values: &[f64]) -> (f64, f64) {
    let known = || values.iter().enumerate().filter(|(_, v)| !v.is_nan()).map(|(t, v)| (t as f64, *v));
    let n = known().count() as f64;
    let (t_mean, v_mean) = known().fold((0.0, 0.0), |(a, b), (t, v)| (a + t / n, b + v / n));
    let (tt, tv) = known()
        .fold((0.0, 0.0), |(tt, tv), (t, v)| (tt + (t - t_mean).powi(2), tv + (t - t_mean) * (v - v_mean)));
    let slope = if tt > 0.0 { tv / tt } else { 0.0 };
    (v_mean - slope * t_mean, slope)
}
