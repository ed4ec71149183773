//! Sampling anew at a uniform rate: from irregular stamps, or from another sample time.
//!
//! ```text
//! line       x(t) on the line between the stamps around t
//! previous   x(t) = x of the last stamp at or before t: what an input does that is set and held
//! mean       mean of the line over t - T/2 .. t + T/2: keeps the integral, and is a low pass where T is long
//! ```

use dynocal_numerics::registry::{self, Member, MemberDoc, ParamDoc};
use serde::Deserialize;

use super::common::{change, fault, key_fault, median, positive, stamps};
use super::{Became, Effect, Outcome, PrepareError, Step};
use crate::data::{Dataset, Gap, Role, runs};

const NAME: &str = "resample";

pub(super) const MEMBER: Member<dyn Step> = Member {
    doc: MemberDoc {
        name: NAME,
        what: "irregular stamps, or another sample time, to uniform samples",
        params: &[
            ParamDoc { name: "sample_time_s", unit: "s", default: "", what: "new sample time" },
            ParamDoc {
                name: "time",
                unit: "-",
                default: "the sample time, else channel time",
                what: "channel with the stamps, in s or ms",
            },
            ParamDoc {
                name: "by",
                unit: "-",
                default: "line",
                what: "line, previous (held), mean (keeps the integral)",
            },
            ParamDoc { name: "inputs", unit: "-", default: "as `by`", what: "the same for the inputs" },
            ParamDoc {
                name: "max_gap_s",
                unit: "s",
                default: "10 median intervals",
                what: "between stamps further apart the new samples are missing",
            },
        ],
    },
    build: |keys| {
        let step: Resample = registry::keys(NAME, keys)?;
        positive(NAME, "sample_time_s", step.sample_time_s)?;
        if let Some(gap) = step.max_gap_s.filter(|g| g.is_nan() || *g <= 0.0) {
            return Err(key_fault(NAME, format!("found max_gap_s = {gap}, expected a positive number")));
        }
        Ok(Box::new(step))
    },
};

/// How a value between stamps is found.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "snake_case")]
pub(super) enum By {
    #[default]
    Line,
    Previous,
    Mean,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Resample {
    sample_time_s: f64,
    time: Option<String>,
    #[serde(default)]
    by: By,
    inputs: Option<By>,
    max_gap_s: Option<f64>,
}

impl Step for Resample {
    fn apply(&self, records: Vec<Dataset>) -> Result<Outcome, PrepareError> {
        let mut outcome = Outcome::default();
        for record in records {
            let (t, time) = stamps(NAME, &record, self.time.as_deref())?;
            let interval = median(&mut t.windows(2).map(|w| w[1] - w[0]).collect::<Vec<_>>());
            fine_enough(NAME, &record, self.sample_time_s, interval)?;
            let grid = Grid {
                first_s: 0.0,
                step_s: self.sample_time_s,
                max_gap_s: self.max_gap_s.unwrap_or(10.0 * interval),
            };
            let method = |role: Role| match role {
                Role::Input => self.inputs.unwrap_or(self.by),
                // A counter or a stamp keeps its meaning on the line only.
                Role::Auxiliary => By::Line,
                Role::Output => self.by,
            };
            let folds = |r: Role| method(r) != By::Mean && self.sample_time_s > 1.5 * interval;
            if folds(Role::Input) || folds(Role::Output) {
                outcome.remarks.push(format!(
                    "{}: {} s is longer than the interval of the record ({interval:.6} s): faster parts are folded \
                     back; `mean`, or a finer sample time and then `decimate`, keeps them out",
                    record.name, self.sample_time_s
                ));
            }
            let out = sampled(&record, &t, time, &grid, method, &mut outcome.changes);
            outcome.remarks.extend(lost(&record, &out, time, grid.max_gap_s));
            outcome.records.push(out);
        }
        Ok(outcome)
    }
}

/// Refuses a sample time that is a typing error: the record would grow a thousand times and more.
pub(super) fn fine_enough(
    step: &'static str,
    record: &Dataset,
    sample_time_s: f64,
    interval_s: f64,
) -> Result<(), PrepareError> {
    if sample_time_s * 1000.0 >= interval_s || interval_s.is_nan() {
        return Ok(());
    }
    let message = format!(
        "found a sample time of {sample_time_s} s, expected at least a thousandth of the record's interval \
         ({interval_s:.6} s)"
    );
    Err(fault(step, record, message))
}

/// The new instants.
pub(super) struct Grid {
    pub(super) first_s: f64,
    pub(super) step_s: f64,
    /// Between known samples further apart than this, nothing is known.
    pub(super) max_gap_s: f64,
}

impl Grid {
    fn instants(&self, last_s: f64) -> impl Iterator<Item = f64> + use<> {
        let (first, step) = (self.first_s, self.step_s);
        // A last instant that misses the last stamp by rounding only is on it.
        let n = ((last_s - first) / step + 1e-6).floor() as usize + 1;
        (0..n).map(move |k| (first + k as f64 * step).min(last_s))
    }
}

/// The record with samples at the instants of `grid`; `t` are its stamps in s, `time` the channel that holds them.
pub(super) fn sampled(
    record: &Dataset,
    t: &[f64],
    time: Option<usize>,
    grid: &Grid,
    method: impl Fn(Role) -> By,
    changes: &mut Vec<super::Change>,
) -> Dataset {
    let last = t.last().copied().unwrap_or(0.0);
    let channels = record.channels.iter().enumerate().map(|(c, channel)| {
        // The stamps themselves are a line between any two of them.
        let (by, gap) = match Some(c) == time {
            true => (By::Line, f64::INFINITY),
            false => (method(channel.role), grid.max_gap_s),
        };
        if Some(c) != time {
            gaps(record, c, t, by, gap, changes);
        }
        let mut known = Known::new(t, &channel.values, 1e-6 * grid.step_s);
        let one = |x| match by {
            By::Line => known.line(x, gap),
            By::Previous => known.previous(x, gap),
            By::Mean => known.mean(x, grid.step_s, gap),
        };
        channel.with(grid.instants(last).map(one).collect())
    });
    let out = Dataset {
        name: record.name.clone(),
        sample_time_s: grid.step_s,
        channels: channels.collect(),
        init_samples: grid
            .instants(last)
            .take_while(|x| t.get(record.init_samples).is_some_and(|i| x < i))
            .count(),
        origin: record.origin.clone(),
    };
    let effect = Effect::Resampled {
        from_s: record.sample_time_s,
        to_s: grid.step_s,
        start_s: grid.first_s,
        samples_before: record.len(),
        samples_after: out.len(),
    };
    changes.push(change(&out, None, effect));
    out
}

/// What becomes of the empty cells of a channel: bridged where the known neighbours are near enough, else missing.
fn gaps(
    record: &Dataset,
    channel: usize,
    t: &[f64],
    by: By,
    longest_s: f64,
    changes: &mut Vec<super::Change>,
) {
    let values = &record.channels[channel].values;
    let empty = runs(values.len(), |k| values[k].is_nan());
    let near = |g: &Gap| g.from > 0 && g.to < values.len() && t[g.to] - t[g.from - 1] <= longest_s;
    let (bridged, missing): (Vec<Gap>, Vec<Gap>) = empty.into_iter().partition(near);
    let became = if by == By::Previous { Became::Held } else { Became::Interpolated };
    for (runs, became) in [(bridged, became), (missing, Became::Missing)] {
        if !runs.is_empty() {
            changes.push(change(record, Some(channel), Effect::Samples { runs, became }));
        }
    }
}

/// New samples that nothing is known of although the record has no empty cell there: its stamps lie too far apart.
fn lost(record: &Dataset, out: &Dataset, time: Option<usize>, longest_s: f64) -> Vec<String> {
    let one = |(c, channel): (usize, &crate::data::Channel)| {
        let missing = channel.values.iter().filter(|v| v.is_nan()).count();
        let wanted = Some(c) != time && missing > 0;
        wanted.then(|| {
            format!(
                "{}, {}: {missing} of {} new samples are missing: they lie in gaps longer than {longest_s} s (`max_gap_s`) or \
                 beyond the known samples",
                record.name,
                channel.name,
                out.len()
            )
        })
    };
    out.channels.iter().enumerate().filter_map(one).collect()
}

/// The known samples of a channel and where in them the last question was; questions come in rising order. A question
/// within `slack` of a stamp is at that stamp: the same instant written in two ways is one instant.
struct Known {
    t: Vec<f64>,
    x: Vec<f64>,
    at: usize,
    slack: f64,
}

impl Known {
    fn new(t: &[f64], x: &[f64], slack: f64) -> Self {
        let known = t.iter().zip(x).filter(|(_, x)| !x.is_nan()).map(|(t, x)| (*t, *x));
        let (t, x) = known.unzip();
        Self { t, x, at: 0, slack }
    }

    /// Moves to the last known sample at or before `t`; none where there is no such.
    fn seek(&mut self, t: f64) -> Option<usize> {
        while self.t.get(self.at + 1).is_some_and(|next| *next <= t) {
            self.at += 1;
        }
        self.t.get(self.at).is_some_and(|now| *now <= t).then_some(self.at)
    }

    fn line(&mut self, t: f64, gap: f64) -> f64 {
        let Some(i) = self.seek(t + self.slack) else { return f64::NAN };
        if (t - self.t[i]).abs() <= self.slack {
            return self.x[i];
        }
        self.between(i, t, gap)
    }

    /// On the line from sample i to the next.
    fn between(&self, i: usize, t: f64, gap: f64) -> f64 {
        if t == self.t[i] {
            return self.x[i];
        }
        match self.t.get(i + 1) {
            Some(next) if next - self.t[i] <= gap => {
                self.x[i] + (self.x[i + 1] - self.x[i]) * ((t - self.t[i]) / (next - self.t[i]))
            }
            _ => f64::NAN,
        }
    }

    fn previous(&mut self, t: f64, gap: f64) -> f64 {
        match self.seek(t + self.slack) {
            Some(i) if t - self.t[i] <= gap => self.x[i],
            _ => f64::NAN,
        }
    }

    /// Mean of the line over the part of `t - width/2 .. t + width/2` that lies in the record.
    fn mean(&mut self, t: f64, width: f64, gap: f64) -> f64 {
        let (Some(first), Some(last)) = (self.t.first(), self.t.last()) else { return f64::NAN };
        let (from, to) = ((t - 0.5 * width).max(*first), (t + 0.5 * width).min(*last));
        if t < *first - self.slack || t > *last + self.slack {
            return f64::NAN;
        }
        let Some(start) = self.seek(from) else { return f64::NAN };
        if to <= from {
            return self.between(start, from, gap);
        }
        let (mut i, mut left, mut sum) = (start, from, 0.0);
        while left < to {
            let right = self.t.get(i + 1).map_or(to, |next| next.min(to));
            // A gap anywhere in the interval makes the mean unknown.
            sum += 0.5 * (right - left) * (self.between(i, left, gap) + self.up_to(i, right, gap));
            (left, i) = (right, i + 1);
        }
        sum / (to - from)
    }

    /// On the line from sample i, its far end included.
    fn up_to(&self, i: usize, t: f64, gap: f64) -> f64 {
        match self.t.get(i + 1) {
            Some(next) if *next == t && next - self.t[i] <= gap => self.x[i + 1],
            _ => self.between(i, t, gap),
        }
    }
}
