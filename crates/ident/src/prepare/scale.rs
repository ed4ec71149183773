//! Scaling: every channel divided by its standard deviation or by a given number.

use std::collections::BTreeMap;

use dynocal_numerics::registry::{self, Member, MemberDoc, ParamDoc};
use serde::Deserialize;

use super::common::{DRIVEN, change, chosen, fault, key_fault, positive};
use super::{Change, Effect, Outcome, PrepareError, Step};
use crate::data::Dataset;

const NAME: &str = "scale";

pub(super) const MEMBER: Member<dyn Step> = Member {
    doc: MemberDoc {
        name: NAME,
        what: "divides channels by their standard deviation over all records, or by given numbers",
        params: &[
            ParamDoc {
                name: "by",
                unit: "channel",
                default: "standard deviation",
                what: "scales: a table channel = value; only these channels are changed",
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
        let step: Scale = registry::keys(NAME, keys)?;
        if step.by.is_some() && step.channels.is_some() {
            return Err(key_fault(NAME, "`by` names its channels; `channels` does not go with it".into()));
        }
        for (name, v) in step.by.iter().flatten() {
            positive(NAME, name, *v)?;
        }
        Ok(Box::new(step))
    },
};

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Scale {
    by: Option<BTreeMap<String, f64>>,
    channels: Option<Vec<String>>,
}

impl Step for Scale {
    fn apply(&self, mut records: Vec<Dataset>) -> Result<Outcome, PrepareError> {
        let scales = records.iter().map(|r| self.scales(r, &records)).collect::<Result<Vec<_>, _>>()?;
        let mut outcome = Outcome::default();
        for (record, scales) in records.iter_mut().zip(scales) {
            for (c, by) in scales {
                let channel = &mut record.channels[c];
                channel.values.iter_mut().for_each(|v| *v /= by);
                let unit = std::mem::replace(&mut channel.unit, "-".into());
                outcome.changes.push(change(record, Some(c), Effect::Divided { by, unit }));
            }
        }
        outcome.records = records;
        Ok(outcome)
    }

    fn learnt(&self, changes: &[Change]) -> Option<Box<dyn Step>> {
        let scale = |c: &Change| match (&c.channel, &c.effect) {
            (Some(name), Effect::Divided { by, .. }) => Some((name.clone(), *by)),
            _ => None,
        };
        Some(Box::new(Self { by: Some(changes.iter().filter_map(scale).collect()), channels: None }))
    }
}

impl Scale {
    fn scales(&self, record: &Dataset, all: &[Dataset]) -> Result<Vec<(usize, f64)>, PrepareError> {
        if let Some(by) = &self.by {
            let one = |(name, v): (&String, &f64)| {
                Ok((chosen(record, Some(std::slice::from_ref(name)), &[])?[0], *v))
            };
            return by.iter().map(one).collect();
        }
        let one = |c: usize| {
            let name = &record.channels[c].name;
            let spread = standard_deviation(name, all)?;
            if spread > 0.0 {
                return Ok((c, spread));
            }
            let message =
                format!("`{name}` is constant or has no sample: it has no standard deviation to divide by");
            Err(fault(NAME, record, message))
        };
        chosen(record, self.channels.as_deref(), DRIVEN)?.into_iter().map(one).collect()
    }
}

/// Root of the mean square about the mean of the known samples of a channel in all `records`.
fn standard_deviation(channel: &str, records: &[Dataset]) -> Result<f64, PrepareError> {
    let channels = records.iter().map(|r| r.channel(channel)).collect::<Result<Vec<_>, _>>()?;
    let known = || channels.iter().flat_map(|c| &c.values).filter(|v| !v.is_nan());
    // Sums about a first sample keep constants exactly constant.
    let about = known().next().copied().unwrap_or(0.0);
    let n = known().count() as f64;
    let mean = known().map(|v| v - about).sum::<f64>() / n;
    Ok((known().map(|v| (v - about - mean).powi(2)).sum::<f64>() / n).sqrt())
}
