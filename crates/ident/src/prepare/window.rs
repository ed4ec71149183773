//! Takes a stretch of every record, or cuts one out.

use dynocal_numerics::registry::{self, Member, MemberDoc, ParamDoc};
use serde::Deserialize;

use super::action::{LEAST, least};
use super::common::{fault, key_fault, split, uniform};
use super::{Outcome, PrepareError, Step};
use crate::data::{Dataset, Gap};

const NAME: &str = "window";

pub(super) const MEMBER: Member<dyn Step> = Member {
    doc: MemberDoc {
        name: NAME,
        what: "keeps a stretch of the records, or cuts it out and splits there",
        params: &[
            ParamDoc { name: "from_s", unit: "s", default: "0", what: "start, from the first sample" },
            ParamDoc { name: "to_s", unit: "s", default: "end", what: "end, itself not included" },
            ParamDoc { name: "cut", unit: "-", default: "false", what: "cut the stretch out instead" },
            ParamDoc {
                name: "records",
                unit: "-",
                default: "all",
                what: "names of the records that are meant",
            },
            LEAST,
        ],
    },
    build: |keys| {
        let step: Window = registry::keys(NAME, keys)?;
        let to_s = step.to_s.unwrap_or(f64::INFINITY);
        if !(step.from_s >= 0.0 && step.from_s < to_s) {
            let found = step.to_s.map_or("the end".into(), |t| format!("{t}"));
            let message =
                format!("found from_s = {}, to_s = {found}, expected 0 <= from_s < to_s", step.from_s);
            return Err(key_fault(NAME, message));
        }
        Ok(Box::new(step))
    },
};

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Window {
    #[serde(default)]
    from_s: f64,
    to_s: Option<f64>,
    #[serde(default)]
    cut: bool,
    records: Option<Vec<String>>,
    #[serde(default = "least")]
    least_samples: usize,
}

impl Window {
    /// The rows that vanish.
    fn out(&self, record: &Dataset) -> Result<Vec<Gap>, PrepareError> {
        let dt = uniform(NAME, record)?;
        let n = record.len();
        // A sample that lies on the edge up to rounding is on it.
        let row = |t_s: f64| ((t_s / dt - 1e-6).ceil().max(0.0) as usize).min(n);
        let (from, to) = (row(self.from_s), self.to_s.map_or(n, row));
        if from >= to {
            let message = format!(
                "no sample between {} s and {} s, the record is {:.6} s long",
                self.from_s,
                self.to_s.unwrap_or(f64::INFINITY),
                n as f64 * dt
            );
            return Err(fault(NAME, record, message));
        }
        let out = if self.cut { vec![(from, to)] } else { vec![(0, from), (to, n)] };
        Ok(out.into_iter().filter(|(a, b)| a < b).map(|(from, to)| Gap { from, to }).collect())
    }
}

impl Step for Window {
    fn apply(&self, records: Vec<Dataset>) -> Result<Outcome, PrepareError> {
        if let Some(unknown) = self.records.iter().flatten().find(|n| !records.iter().any(|r| r.name == **n))
        {
            let known = records.iter().map(|r| r.name.as_str()).collect::<Vec<_>>().join(", ");
            let message = format!("no such record; records are: {known}");
            return Err(PrepareError::Step { step: NAME, record: unknown.clone(), message });
        }
        let mut outcome = Outcome::default();
        for record in records {
            let meant = self.records.as_ref().is_none_or(|names| names.contains(&record.name));
            let out = if meant { self.out(&record)? } else { Vec::new() };
            split(record, &out, self.least_samples, &mut outcome);
        }
        Ok(outcome)
    }
}
