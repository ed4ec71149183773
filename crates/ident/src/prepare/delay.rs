//! Channels that report late are advanced: what is now at t was recorded at t + seconds + the time of `strokes`
//! strokes (180 deg of crank angle) after t.

use dynocal_numerics::registry::{self, Member, MemberDoc, ParamDoc};
use serde::Deserialize;

use super::common::{change, chosen, fault, key_fault, uniform};
use super::crank::{Crank, Source};
use super::{Effect, Outcome, PrepareError, Step};
use crate::data::Dataset;

const NAME: &str = "delay";

pub(super) const MEMBER: Member<dyn Step> = Member {
    doc: MemberDoc {
        name: NAME,
        what: "advances channels that report late (transport, sensors)",
        params: &[
            ParamDoc { name: "channels", unit: "-", default: "", what: "channels that report late" },
            ParamDoc {
                name: "seconds",
                unit: "s",
                default: "0",
                what: "how late; a negative time delays them",
            },
            ParamDoc {
                name: "strokes",
                unit: "strokes",
                default: "0",
                what: "and how late in strokes (180 deg), which goes with the speed",
            },
            ParamDoc { name: "speed", unit: "rpm", default: "speed", what: "channel with the engine speed" },
            ParamDoc {
                name: "by",
                unit: "-",
                default: "line",
                what: "between samples: line, or cubic (through four samples)",
            },
        ],
    },
    build: |keys| {
        let step: Delay = registry::keys(NAME, keys)?;
        if step.channels.is_empty() {
            return Err(key_fault(NAME, "found no channels, expected at least one that reports late".into()));
        }
        if !(step.seconds.is_finite() && step.strokes >= 0.0 && step.strokes.is_finite()) {
            let message = format!(
                "found seconds = {}, strokes = {}, expected a finite time and zero or more strokes",
                step.seconds, step.strokes
            );
            return Err(key_fault(NAME, message));
        }
        Ok(Box::new(step))
    },
};

#[derive(Clone, Copy, Default, PartialEq, Deserialize)]
#[serde(rename_all = "snake_case")]
enum By {
    #[default]
    Line,
    Cubic,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Delay {
    channels: Vec<String>,
    #[serde(default)]
    seconds: f64,
    #[serde(default)]
    strokes: f64,
    #[serde(default = "speed")]
    speed: String,
    #[serde(default)]
    by: By,
}

fn speed() -> String {
    "speed".into()
}

impl Step for Delay {
    fn apply(&self, records: Vec<Dataset>) -> Result<Outcome, PrepareError> {
        let mut outcome = Outcome::default();
        for mut record in records {
            let dt_s = uniform(NAME, &record)?;
            let when = self.when(&record, dt_s)?;
            let end = (record.len() - 1) as f64 + 1e-9;
            let inside = |s: &f64| (-1e-9..=end).contains(s);
            let from = when.iter().position(inside).unwrap_or(record.len());
            let to = when.iter().rposition(inside).map_or(from, |t| t + 1);
            if from >= to {
                let message =
                    format!("the channels would be moved out of the record of {} samples", record.len());
                return Err(fault(NAME, &record, message));
            }
            let late = chosen(&record, Some(&self.channels), &[])?;
            for &c in &late {
                let x = &record.channels[c].values;
                let moved =
                    when.iter().map(|s| if inside(s) { self.between(x, *s) } else { f64::NAN }).collect();
                record.channels[c].values = moved;
            }
            // Rows in which a channel would be unknown at an end are no longer part of the record.
            record.channels.iter_mut().for_each(|c| c.values = c.values[from..to].to_vec());
            for &c in &late {
                let effect = Effect::Advanced {
                    seconds: self.seconds,
                    strokes: self.strokes,
                    cut_s: from as f64 * dt_s,
                };
                outcome.changes.push(change(&record, Some(c), effect));
            }
            outcome.records.push(record);
        }
        Ok(outcome)
    }
}

impl Delay {
    /// Where, in samples, the value that belongs to every sample was recorded.
    fn when(&self, record: &Dataset, dt_s: f64) -> Result<Vec<f64>, PrepareError> {
        let fixed = self.seconds / dt_s;
        if self.strokes == 0.0 {
            return Ok((0..record.len()).map(|t| t as f64 + fixed).collect());
        }
        let crank = Crank::new(NAME, record, &Source::Speed(self.speed.clone()), None)?;
        let mut i = 0;
        let one = |phi: &f64| match crank.time_of(phi + 180.0 * self.strokes, i) {
            Some((t, interval)) if crank.angle(interval, t) + 1e-6 >= phi + 180.0 * self.strokes => {
                i = interval;
                t / dt_s + fixed
            }
            _ => f64::INFINITY,
        };
        Ok(crank.phi.iter().map(one).collect())
    }

    /// The value at the fractional sample `s`.
    fn between(&self, x: &[f64], s: f64) -> f64 {
        let near = s.round();
        if (s - near).abs() < 1e-9 {
            return x[near as usize];
        }
        let i = s.floor() as usize;
        let r = s - s.floor();
        if self.by == By::Cubic && i >= 1 && i + 2 < x.len() {
            // Lagrange's polynomial through the samples at -1, 0, 1, 2.
            let cubic = -r * (r - 1.0) * (r - 2.0) / 6.0 * x[i - 1]
                + (r + 1.0) * (r - 1.0) * (r - 2.0) / 2.0 * x[i]
                - (r + 1.0) * r * (r - 2.0) / 2.0 * x[i + 1]
                + (r + 1.0) * r * (r - 1.0) / 6.0 * x[i + 2];
            if !cubic.is_nan() {
                return cubic;
            }
        }
        x[i] + r * (x[i + 1] - x[i])
    }
}
