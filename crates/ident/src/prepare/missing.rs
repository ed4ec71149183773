//! Missing samples: listed; short gaps filled, at long ones the record is split or they stay marked.

use dynocal_numerics::registry::{self, Member, MemberDoc, ParamDoc};
use serde::Deserialize;

use super::action::{LEAST, fill, least};
use super::common::{DRIVEN, change, chosen, fault, split, union};
use super::{Became, Effect, Outcome, PrepareError, Step};
use crate::data::{Dataset, Gap};

const NAME: &str = "missing";

pub(super) const MEMBER: Member<dyn Step> = Member {
    doc: MemberDoc {
        name: NAME,
        what: "lists missing samples, fills short gaps, splits at long ones or leaves them marked",
        params: &[
            ParamDoc { name: "longest", unit: "samples", default: "3", what: "longest gap that is filled" },
            ParamDoc {
                name: "by",
                unit: "-",
                default: "line",
                what: "line (between the neighbours) or hold (last value, for inputs that are held)",
            },
            ParamDoc {
                name: "longer",
                unit: "-",
                default: "split",
                what: "longer gaps, and those at an end: split, mark (stay missing), refuse",
            },
            ParamDoc {
                name: "channels",
                unit: "-",
                default: "inputs and outputs",
                what: "channels that are looked at",
            },
            LEAST,
        ],
    },
    build: |keys| {
        let step: Missing = registry::keys(NAME, keys)?;
        Ok(Box::new(step))
    },
};

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Missing {
    #[serde(default = "three")]
    longest: usize,
    #[serde(default)]
    by: By,
    #[serde(default)]
    longer: Longer,
    channels: Option<Vec<String>>,
    #[serde(default = "least")]
    least_samples: usize,
}

fn three() -> usize {
    3
}

#[derive(Clone, Copy, Default, PartialEq, Deserialize)]
#[serde(rename_all = "snake_case")]
enum By {
    #[default]
    Line,
    Hold,
}

#[derive(Clone, Copy, Default, PartialEq, Deserialize)]
#[serde(rename_all = "snake_case")]
enum Longer {
    #[default]
    Split,
    Mark,
    Refuse,
}

impl Step for Missing {
    fn apply(&self, records: Vec<Dataset>) -> Result<Outcome, PrepareError> {
        let mut outcome = Outcome::default();
        for mut record in records {
            let mut long_ones: Vec<Vec<Gap>> = Vec::new();
            for c in chosen(&record, self.channels.as_deref(), DRIVEN)? {
                let n = record.len();
                let inside = |g: &Gap| g.from > 0 && g.to < n;
                let (short, long): (Vec<Gap>, Vec<Gap>) = record.channels[c]
                    .gaps()
                    .into_iter()
                    .partition(|g| g.samples() <= self.longest && inside(g));
                let values = &mut record.channels[c].values;
                short.iter().for_each(|g| fill(values, *g, self.by == By::Line));
                let filled = if self.by == By::Line { Became::Interpolated } else { Became::Held };
                self.refuse(&record, c, &long)?;
                let left = if self.longer == Longer::Mark { Became::Missing } else { Became::CutOut };
                for (runs, became) in [(short, filled), (long.clone(), left)] {
                    if !runs.is_empty() {
                        outcome.changes.push(change(&record, Some(c), Effect::Samples { runs, became }));
                    }
                }
                long_ones.push(long);
            }
            let out = match self.longer {
                Longer::Split => {
                    union(record.len(), &long_ones.iter().map(Vec::as_slice).collect::<Vec<_>>())
                }
                _ => Vec::new(),
            };
            split(record, &out, self.least_samples, &mut outcome);
        }
        Ok(outcome)
    }
}

impl Missing {
    fn refuse(&self, record: &Dataset, c: usize, long: &[Gap]) -> Result<(), PrepareError> {
        match long.first() {
            Some(g) if self.longer == Longer::Refuse => {
                let message = format!(
                    "`{}` has {} gaps that are longer than {} samples or at an end; the first is {} to {}",
                    record.channels[c].name,
                    long.len(),
                    self.longest,
                    g.from,
                    g.to - 1
                );
                Err(fault(NAME, record, message))
            }
            _ => Ok(()),
        }
    }
}
