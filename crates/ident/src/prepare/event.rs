//! From time to crank angle and back: one sample per degree, stroke (180 deg) or cycle (720 deg).
//!
//! ```text
//! event k        phi(t_k) = k D + offset
//! point          x_k = x(t_k)
//! mean           x_k = integral x dt / (t_{k+1} - t_k) over event k      (flows, states)
//! angle_mean     x_k = integral x dphi / D over event k                  (torque: the work of a stroke)
//! ```
//!
//! with x on the line between its samples; the integrals are exact. The record that comes out has two channels more,
//! `event_start` and `event_time` (s): where event k begins, and the instant that its sample stands for (its middle
//! in time, for points its start). Its sample time is the time of an event at one nominal speed, the same for all
//! records: models of it count events, and seconds are true at that speed only. `per = "time"` is the way back, by
//! `event_time` on the line or held from `event_start` on. A record that was taken on a crank angle base has no such
//! channels; `from` says what its rows are, and the mean speed n_k of every row when they were: event k takes D / (6 n_k).

use dynocal_numerics::registry::{self, Member, MemberDoc, ParamDoc};
use serde::Deserialize;

use super::common::{change, chosen, complete, fault, key_fault, positive};
use super::crank::{Crank, Source};
use super::resample::{self, Grid};
use super::{Change, Effect, Outcome, PrepareError, Step};
use crate::data::{Channel, Dataset, Role};

const NAME: &str = "event";
const START: &str = "event_start";
const INSTANT: &str = "event_time";

pub(super) const MEMBER: Member<dyn Step> = Member {
    doc: MemberDoc {
        name: NAME,
        what: "samples per crank angle (degree, stroke, cycle) instead of per time, and back",
        params: &[
            ParamDoc {
                name: "per",
                unit: "-",
                default: "",
                what: "degree, stroke (180 deg), revolution (360 deg), cycle (720 deg), time (the way back)",
            },
            ParamDoc {
                name: "from",
                unit: "-",
                default: "time",
                what: "for per = time: what the rows were made per",
            },
            ParamDoc {
                name: "degrees",
                unit: "deg",
                default: "1",
                what: "for per = degree: degrees per sample",
            },
            ParamDoc { name: "speed", unit: "rpm", default: "", what: "channel with the engine speed" },
            ParamDoc {
                name: "angle",
                unit: "deg",
                default: "",
                what: "channel with the crank angle instead",
            },
            ParamDoc {
                name: "wrap_deg",
                unit: "deg",
                default: "720",
                what: "the angle falls back after so much",
            },
            ParamDoc { name: "offset_deg", unit: "deg", default: "0", what: "angle of an event" },
            ParamDoc {
                name: "by",
                unit: "-",
                default: "mean",
                what: "mean, angle_mean, point; back: mean or point",
            },
            ParamDoc { name: "inputs", unit: "-", default: "as `by`", what: "the same for the inputs" },
            ParamDoc {
                name: "nominal_rpm",
                unit: "rpm",
                default: "mean speed",
                what: "speed at which the new sample time is true",
            },
            ParamDoc {
                name: "time",
                unit: "-",
                default: "the sample time",
                what: "channel with irregular stamps",
            },
            ParamDoc {
                name: "sample_time_s",
                unit: "s",
                default: "",
                what: "for per = time: new sample time",
            },
        ],
    },
    build: |keys| {
        let step: Event = registry::keys(NAME, keys)?;
        for (key, value) in [
            ("degrees", step.degrees),
            ("wrap_deg", Some(step.wrap_deg)),
            ("nominal_rpm", step.nominal_rpm),
            ("sample_time_s", step.sample_time_s),
        ] {
            value.map_or(Ok(()), |v| positive(NAME, key, v))?;
        }
        let back = step.per == Per::Time;
        if back != step.sample_time_s.is_some() {
            let message = "`sample_time_s` and per = \"time\" belong together".into();
            return Err(key_fault(NAME, message));
        }
        if !back && step.speed.is_some() == step.angle.is_some() {
            return Err(key_fault(NAME, "expected either `speed` or `angle`, a channel".into()));
        }
        if step.from.is_some() && (!back || step.from == Some(Per::Time) || step.speed.is_none()) {
            let message =
                "`from` is degree, stroke, revolution or cycle, and goes with per = \"time\" and `speed`";
            return Err(key_fault(NAME, message.into()));
        }
        if step.degrees.is_some() && step.base() != Per::Degree {
            return Err(key_fault(NAME, "`degrees` goes with per or from = \"degree\"".into()));
        }
        if !step.offset_deg.is_finite() {
            return Err(key_fault(
                NAME,
                format!("found offset_deg = {}, expected a number", step.offset_deg),
            ));
        }
        Ok(Box::new(step))
    },
};

#[derive(Clone, Copy, Debug, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "snake_case")]
enum Per {
    Degree,
    Stroke,
    Revolution,
    Cycle,
    Time,
}

#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "snake_case")]
enum By {
    #[default]
    Mean,
    AngleMean,
    Point,
}

#[derive(Clone, Deserialize)]
#[serde(deny_unknown_fields)]
struct Event {
    per: Per,
    degrees: Option<f64>,
    speed: Option<String>,
    angle: Option<String>,
    #[serde(default = "cycle")]
    wrap_deg: f64,
    #[serde(default)]
    offset_deg: f64,
    #[serde(default)]
    by: By,
    inputs: Option<By>,
    nominal_rpm: Option<f64>,
    from: Option<Per>,
    time: Option<String>,
    sample_time_s: Option<f64>,
}

fn cycle() -> f64 {
    720.0
}

impl Step for Event {
    fn apply(&self, records: Vec<Dataset>) -> Result<Outcome, PrepareError> {
        match self.sample_time_s {
            Some(dt_s) => self.back(records, dt_s),
            None => self.forth(records),
        }
    }

    fn learnt(&self, changes: &[Change]) -> Option<Box<dyn Step>> {
        let rpm = changes.iter().find_map(|c| match &c.effect {
            Effect::PerEvent { nominal_rpm, .. } => Some(*nominal_rpm),
            _ => None,
        })?;
        Some(Box::new(Self { nominal_rpm: Some(rpm), ..self.clone() }))
    }
}

impl Event {
    /// What an event is, on the way there or back.
    fn base(&self) -> Per {
        self.from.unwrap_or(self.per)
    }

    fn every_deg(&self) -> f64 {
        match self.base() {
            Per::Degree | Per::Time => self.degrees.unwrap_or(1.0),
            Per::Stroke => 180.0,
            Per::Revolution => 360.0,
            Per::Cycle => 720.0,
        }
    }

    fn source(&self) -> Source {
        match (&self.speed, &self.angle) {
            (Some(name), _) => Source::Speed(name.clone()),
            (None, Some(name)) => Source::Angle(name.clone(), self.wrap_deg),
            (None, None) => Source::Speed("speed".into()),
        }
    }

    fn method(&self, role: Role) -> By {
        match role {
            Role::Input => self.inputs.unwrap_or(self.by),
            _ => self.by,
        }
    }

    fn forth(&self, records: Vec<Dataset>) -> Result<Outcome, PrepareError> {
        let source = self.source();
        let cranks = records
            .iter()
            .map(|r| Crank::new(NAME, r, &source, self.time.as_deref()))
            .collect::<Result<Vec<_>, _>>()?;
        let (turned, time) = cranks.iter().fold((0.0, 0.0), |(phi, t), c| {
            let whole = |v: &[f64]| v.last().copied().unwrap_or(0.0) - v.first().copied().unwrap_or(0.0);
            (phi + whole(&c.phi), t + whole(&c.t))
        });
        let nominal_rpm = self.nominal_rpm.unwrap_or(turned / (6.0 * time));
        let mut outcome = Outcome::default();
        for (record, crank) in records.into_iter().zip(&cranks) {
            let out = self.per_event(&record, crank, nominal_rpm)?;
            let effect = Effect::PerEvent { every_deg: self.every_deg(), nominal_rpm, events: out.len() };
            outcome.changes.push(change(&out, None, effect));
            outcome.records.push(out);
        }
        Ok(outcome)
    }

    fn per_event(&self, record: &Dataset, crank: &Crank, nominal_rpm: f64) -> Result<Dataset, PrepareError> {
        let every = self.every_deg();
        let interval = crank.phi.windows(2).map(|w| w[1] - w[0]).fold(0.0, f64::max);
        if every * 1000.0 < interval {
            let message = format!(
                "found events of {every} deg, expected at least a thousandth of the {interval:.1} deg from sample to sample"
            );
            return Err(fault(NAME, record, message));
        }
        let edges = edges(crank, every, self.offset_deg);
        if edges.len() < 2 {
            let turned = crank.phi.last().copied().unwrap_or(0.0) - crank.phi.first().copied().unwrap_or(0.0);
            let message =
                format!("the crank turns by {turned:.1} deg, one event is {every} deg: no whole event");
            return Err(fault(NAME, record, message));
        }
        let value = |x: &[f64], by: By, e: &[(f64, usize)]| match by {
            By::Point => at(&crank.t, x, e[0].0, e[0].1),
            By::Mean => integral(crank, x, e, |_, _| 1.0) / (e[1].0 - e[0].0),
            By::AngleMean => integral(crank, x, e, |i, t| crank.rate(i, t)) / every,
        };
        let mut channels: Vec<Channel> = Vec::with_capacity(record.channels.len() + 2);
        for (c, channel) in record.channels.iter().enumerate() {
            // The stamps of the old record would be a third time.
            if Some(c) == crank.time || channel.name == START || channel.name == INSTANT {
                continue;
            }
            let by = self.method(channel.role);
            channels.push(channel.with(edges.windows(2).map(|e| value(&channel.values, by, e)).collect()));
        }
        let stamp = |name: &str, values| Channel {
            name: name.into(),
            unit: "s".into(),
            role: Role::Auxiliary,
            values,
        };
        channels.push(stamp(START, edges.windows(2).map(|e| e[0].0).collect()));
        let middle = |e: &[(f64, usize)]| match self.by {
            By::Point => e[0].0,
            _ => 0.5 * (e[0].0 + e[1].0),
        };
        channels.push(stamp(INSTANT, edges.windows(2).map(middle).collect()));
        let init = crank.t.get(record.init_samples).copied().unwrap_or(f64::INFINITY);
        Ok(Dataset {
            name: record.name.clone(),
            sample_time_s: every / (6.0 * nominal_rpm),
            channels,
            init_samples: edges[..edges.len() - 1].iter().filter(|e| e.0 < init).count(),
            origin: format!("{}, per {every} deg of crank angle", record.origin),
        })
    }

    fn back(&self, records: Vec<Dataset>, dt_s: f64) -> Result<Outcome, PrepareError> {
        let mut outcome = Outcome::default();
        for record in records {
            let (starts, instants) = self.instants(&record)?;
            let is_held = |c: &Channel| self.method(c.role) == By::Point;
            let interval = (instants[instants.len() - 1] - instants[0]) / (instants.len() - 1).max(1) as f64;
            resample::fine_enough(NAME, &record, dt_s, interval)?;
            let first_s = (instants.first().copied().unwrap_or(0.0) / dt_s - 1e-6).ceil() * dt_s;
            // Held samples count from the start of their event, the others from its middle.
            let shift = |held: bool, stamps: &[f64]| {
                let t = if held { starts.clone() } else { stamps.to_vec() };
                let mut part = record.clone();
                part.channels.retain(|c| is_held(c) == held && c.name != START && c.name != INSTANT);
                (part, t)
            };
            let last_s = instants.last().copied().unwrap_or(0.0);
            let n = ((last_s - first_s) / dt_s + 1e-6).floor().max(0.0) as usize + 1;
            let mut channels = Vec::new();
            for held in [false, true] {
                let (part, t) = shift(held, &instants);
                let grid = Grid { first_s, step_s: dt_s, max_gap_s: f64::INFINITY };
                let by = if held { resample::By::Previous } else { resample::By::Line };
                let mut unused = Vec::new();
                let out = resample::sampled(&part, &t, None, &grid, |_| by, &mut unused);
                channels.extend(out.channels.into_iter().map(|mut c| {
                    // The last event holds until its end.
                    let last = c.values.last().copied().unwrap_or(f64::NAN);
                    c.values.resize(n, last);
                    c
                }));
            }
            channels.sort_by_key(|c| record.channels.iter().position(|d| d.name == c.name));
            let out = Dataset {
                name: record.name.clone(),
                sample_time_s: dt_s,
                init_samples: instants
                    .get(record.init_samples)
                    .map_or(n, |t| ((t - first_s) / dt_s - 1e-6).ceil().max(0.0) as usize),
                origin: format!("{}, back to time", record.origin),
                channels,
            };
            let effect = Effect::Resampled {
                from_s: f64::NAN,
                to_s: dt_s,
                start_s: f64::NAN,
                samples_before: record.len(),
                samples_after: n,
            };
            outcome.changes.push(change(&out, None, effect));
            outcome.records.push(out);
        }
        Ok(outcome)
    }
}

impl Event {
    /// Start of every event, and the instant that its sample stands for, in s.
    fn instants(&self, record: &Dataset) -> Result<(Vec<f64>, Vec<f64>), PrepareError> {
        let (Some(_), Some(name)) = (self.from, &self.speed) else {
            if record.channel(INSTANT).is_err() {
                let message = format!(
                    "no channel `{INSTANT}`: the record comes from no step `event`; `from` and `speed` say what its rows are"
                );
                return Err(fault(NAME, record, message));
            }
            return Ok((record.values(START)?.to_vec(), record.values(INSTANT)?.to_vec()));
        };
        let c = chosen(record, Some(std::slice::from_ref(name)), &[])?[0];
        if record.channels[c].unit != "rpm" {
            let message = format!("`{name}` is in `{}`, expected rpm", record.channels[c].unit);
            return Err(fault(NAME, record, message));
        }
        let speed = complete(NAME, record, c)?;
        if let Some(k) = speed.iter().position(|n| *n <= 0.0) {
            let message = format!("`{name}` is {} rpm at sample {k}: the crank must turn", speed[k]);
            return Err(fault(NAME, record, message));
        }
        let (mut starts, mut instants, mut t) = (Vec::new(), Vec::new(), 0.0);
        for n in speed {
            let duration = self.every_deg() / (6.0 * n);
            starts.push(t);
            instants.push(if self.by == By::Point { t } else { t + 0.5 * duration });
            t += duration;
        }
        Ok((starts, instants))
    }
}

/// Times of the events with the interval of the record that holds them.
fn edges(crank: &Crank, every: f64, offset: f64) -> Vec<(f64, usize)> {
    let (first, last) = (crank.phi.first().copied().unwrap_or(0.0), crank.phi.last().copied().unwrap_or(0.0));
    // An event that misses an end by rounding only is on it.
    let slack = 1e-9 * every;
    let start = ((first - offset - slack) / every).ceil();
    let mut out: Vec<(f64, usize)> = Vec::new();
    let mut k = 0.0;
    loop {
        let phi = (start + k) * every + offset;
        if phi > last + slack {
            return out;
        }
        let from = out.last().map_or(0, |e| e.1);
        let Some(edge) = crank.time_of(phi.clamp(first, last), from) else { return out };
        out.push(edge);
        k += 1.0;
    }
}

/// On the line between samples i and i + 1; the ends need one of them only.
fn at(t: &[f64], x: &[f64], time: f64, i: usize) -> f64 {
    let Some(next) = t.get(i + 1) else { return x[i] };
    let s = (time - t[i]) / (next - t[i]);
    match s {
        s if s <= 0.0 => x[i],
        s if s >= 1.0 => x[i + 1],
        s => x[i] + s * (x[i + 1] - x[i]),
    }
}

/// Integral of `x weight dt` from one edge to the next. On every interval both are lines in t, so Simpson's rule is
/// exact.
fn integral(crank: &Crank, x: &[f64], e: &[(f64, usize)], weight: impl Fn(usize, f64) -> f64) -> f64 {
    let ((from, first), (to, last)) = (e[0], e[1]);
    let mut sum = 0.0;
    for i in first..=last {
        let (a, b) = (from.max(crank.t[i]), to.min(crank.t[i + 1]));
        if b > a {
            let f = |t: f64| at(&crank.t, x, t, i) * weight(i, t);
            sum += (b - a) / 6.0 * (f(a) + 4.0 * f(0.5 * (a + b)) + f(b));
        }
    }
    sum
}
