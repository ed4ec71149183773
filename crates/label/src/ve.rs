//! The fuel table of an open ECU from logs with a lambda sensor.
//!
//! The ECU injects fuel for an air charge that its table says; what lambda comes of it tells the charge that there was. With the cells
//! theta of the table, the enrichment g that multiplied it, the lambda L that was asked for and the lambda sensor,
//!
//! ```text
//! lambda(t) = sensor( L a' theta / (VE g) )(t),     sensor: delay d0 + d1 F0 / F(t), then a first-order lag
//! ```
//!
//! which is linear in theta for a given sensor: F is the flow (speed times load), F0 a reference. The sensor is found on the same
//! samples as the table ([`sensor`]); samples that say nothing of the table are left out and counted ([`mask`]); whether the new table
//! is taken is decided on later samples that were not used ([`judge`]).

pub mod holes;
pub mod judge;
pub mod mask;
pub mod sensor;
pub mod steps;
pub mod table;

use std::ops::Range;

use serde::{Deserialize, Serialize};

use crate::error::LabelError;
use crate::label::Label;
use crate::linear::{Fit, Options};
use crate::rows::Rows;
use sensor::Sensor;

/// Samples that a table is fitted to and judged by, at least.
const LEAST_SAMPLES: usize = 100;

/// A log on its own stamps.
#[derive(Clone, Debug, PartialEq, Default)]
pub struct Log {
    /// Name.
    pub name: String,
    /// Stamps in s.
    pub time_s: Vec<f64>,
    /// Engine speed.
    pub speed_rpm: Vec<f64>,
    /// What enters the table along its second axis.
    pub load: Vec<f64>,
    /// Table value that the ECU used.
    pub ve: Vec<f64>,
    /// What multiplied it and is not air: trims and enrichments, 1 for none.
    pub enrichment: Vec<f64>,
    /// Measured lambda.
    pub lambda: Vec<f64>,
    /// Lambda that the tune asks for.
    pub target: Vec<f64>,
    /// Injection pulse width; 0 while fuel is cut.
    pub pulse_ms: Vec<f64>,
    /// Coolant temperature, where it is logged.
    pub coolant_c: Option<Vec<f64>>,
    /// Throttle rate, where it is logged.
    pub throttle_rate: Option<Vec<f64>>,
    /// Whether the ECU enriches for start, warm-up or acceleration, where it is logged.
    pub enriching: Option<Vec<bool>>,
}

/// Samples that count: the log, the sample of the measurement.
#[derive(Clone, Debug, PartialEq)]
pub struct Used {
    /// Log and sample of each.
    pub at: Vec<(usize, usize)>,
    /// Rows of the function over the cells.
    pub rows: Rows,
    /// Measured lambda.
    pub y: Vec<f64>,
}

impl Used {
    /// A part of the samples.
    fn part(&self, range: Range<usize>) -> Self {
        let mut rows = Rows::default();
        for k in range.clone() {
            rows.start();
            let (at, weight) = self.rows.row(k);
            at.iter().zip(weight).for_each(|(j, w)| rows.push(*j, *w));
        }
        Self { at: self.at[range.clone()].to_vec(), rows, y: self.y[range].to_vec() }
    }

    /// Ranges without a gap of more than a few samples in one log.
    fn segments(&self) -> Vec<Range<usize>> {
        let mut out = Vec::new();
        let mut from = 0;
        for k in 1..=self.at.len() {
            let breaks =
                k == self.at.len() || self.at[k].0 != self.at[k - 1].0 || self.at[k].1 > self.at[k - 1].1 + 3;
            if breaks {
                out.push(from..k);
                from = k;
            }
        }
        out
    }
}

/// What is done.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Keys {
    /// What says nothing of the table.
    pub mask: mask::Keys,
    /// Share of the samples, the first in time, that the judged table is fitted to.
    pub train: f64,
    /// The fit.
    pub fit: Options,
    /// The sensor, where it is known.
    pub sensor: Option<Sensor>,
}

impl Default for Keys {
    fn default() -> Self {
        Self { mask: mask::Keys::default(), train: 0.6, fit: Options::default(), sensor: None }
    }
}

/// What came out.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Found {
    /// The sensor, from the first part of the samples.
    pub sensor: Sensor,
    /// Sensors that were tried, with the criterion of each.
    pub tried: Vec<(Sensor, f64)>,
    /// Half heights of the returns of fuel, where there are some.
    pub steps: Option<steps::HalfHeight>,
    /// Samples that are left out, by reason.
    pub left_out: Vec<(String, usize)>,
    /// All samples, and those that count.
    pub samples: [usize; 2],
    /// The table from the first part: what is judged.
    pub judged: Fit,
    /// The table from all samples: what is handed over if the judgement allows it.
    pub table: Fit,
    /// Judgement on the later part.
    pub judgement: judge::Judgement,
    /// Share by which the measurement leaves the judged table, over the samples that count: log, stamp in s, share.
    #[serde(skip)]
    pub residuals: Vec<(usize, f64, f64)>,
    /// Speed in rpm and load of each of them, at the stamp of the measurement.
    #[serde(skip)]
    pub states: Vec<[f64; 2]>,
}

/// From logs to a table. `tell` is told what happens.
///
/// # Errors
/// [`LabelError`]: no samples that count, labels that contradict themselves.
pub fn run(label: &Label, logs: &[Log], keys: &Keys, tell: &dyn Fn(&str)) -> Result<Found, LabelError> {
    label.check()?;
    if label.axes.len() != 2 {
        return Err(LabelError::label(&label.name, "expected a map over speed and load"));
    }
    let label = &table::prepared(label);
    let all: usize = logs.iter().map(|l| l.time_s.len()).sum();
    let (logs, lost): (Vec<Log>, Vec<usize>) = logs.iter().map(holes::closed).unzip();
    let logs = &logs[..];
    let masks: Vec<mask::Mask> = logs.iter().map(|l| mask::of(l, &keys.mask)).collect();
    let mut left_out: Vec<(String, usize)> = vec![(holes::REASON.into(), lost.iter().sum())];
    for (reason, count) in masks.iter().flat_map(|m| m.left_out.iter().cloned()) {
        match left_out.iter_mut().find(|r| r.0 == reason) {
            Some(r) => r.1 += count,
            None => left_out.push((reason, count)),
        }
    }
    let too_few = |found: usize, left_out: &[(String, usize)]| {
        let reasons =
            left_out.iter().filter(|(_, n)| *n > 0).map(|(reason, n)| format!("{n} for `{reason}`"));
        let left_out = reasons.collect::<Vec<_>>().join(", ");
        LabelError::LeftOut { found, samples: all, expected: LEAST_SAMPLES, left_out }
    };
    let usable: usize = masks.iter().map(|m| m.use_at.iter().filter(|u| **u).count()).sum();
    if usable < LEAST_SAMPLES {
        return Err(too_few(usable, &left_out));
    }
    let steps = steps::half_height(logs, &masks);
    let split = |used: &Used| (keys.train * used.at.len() as f64).round() as usize;
    let (sensor, tried) =
        match keys.sensor {
            Some(s) => (s, Vec::new()),
            None => sensor::search(label, logs, &masks, keys, steps.map(|s| s.quartiles_s[1]), tell)
                .map_err(|e| match e {
                    LabelError::TooFew { found, .. } => too_few(found, &left_out),
                    other => other,
                })?,
        };
    let used = sensor::samples(label, logs, &masks, &sensor);
    left_out.push(("within the delay of one of these, or of the ends of a log".into(), {
        usable.saturating_sub(used.at.len())
    }));
    let cut = split(&used);
    if cut < 50 || used.at.len() - cut < 20 {
        return Err(too_few(used.at.len(), &left_out));
    }
    tell("fitting the table to the first part of the samples");
    let train = used.part(0..cut);
    let judged = table::known(label, &train, &keys.fit)?;
    let covered: Vec<bool> = judged.facts.iter().map(|f| *f >= table::KNOWN).collect();
    let rest = used.part(cut..used.at.len());
    let judgement = judge::of(label, &judged, &covered, &train, &rest, &sensor);
    tell("fitting the table to all samples");
    let mut table = table::known(label, &used, &keys.fit)?;
    // Logs that contradict each other leave so much that together they know less than the first part did.
    if !table::knows(&table) && table::knows(&judged) {
        table = judged.clone();
    }
    let residuals = (0..used.at.len())
        .map(|k| {
            let (log, sample) = used.at[k];
            (log, logs[log].time_s[sample], used.y[k] / used.rows.times(k, &judged.values) - 1.0)
        })
        .collect();
    let states = used.at.iter().map(|(l, k)| [logs[*l].speed_rpm[*k], logs[*l].load[*k]]).collect();
    let samples = [all, used.at.len()];
    Ok(Found { sensor, tried, steps, left_out, samples, judged, table, judgement, residuals, states })
}
