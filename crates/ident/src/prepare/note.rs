//! What a step did: to read, to repeat, to undo.

use serde::{Deserialize, Serialize};

use super::PrepareError;
use crate::data::{Dataset, Gap};

/// Number of records and of samples in all of them.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Size {
    /// Records.
    pub records: usize,
    /// Samples (rows).
    pub samples: usize,
}

impl Size {
    pub(super) fn of(records: &[Dataset]) -> Self {
        Self { records: records.len(), samples: records.iter().map(Dataset::len).sum() }
    }
}

/// The report of one step.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Note {
    /// Name of the step.
    pub step: String,
    /// Its keys.
    pub keys: toml::Table,
    /// Before the step.
    pub before: Size,
    /// After it.
    pub after: Size,
    /// What changed where.
    pub changes: Vec<Change>,
    /// What an engineer should know about it, in sentences.
    pub remarks: Vec<String>,
}

/// One change of one record, or of one channel of it.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Change {
    /// Record, under the name that it has after the step.
    pub record: String,
    /// Channel; none where all channels are meant.
    pub channel: Option<String>,
    /// What was done.
    pub effect: Effect,
}

/// What became of samples that were missing or outlying.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Became {
    /// On the line between the known neighbours.
    Interpolated,
    /// The last known value.
    Held,
    /// The median of the window, or the value of the model.
    Replaced,
    /// Missing (NaN).
    Missing,
    /// Cut out; the record was split there.
    CutOut,
}

/// What was done.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(tag = "kind", rename_all = "snake_case")]
pub enum Effect {
    /// `level + slope_per_s t` was subtracted, t in s from the first sample of the record.
    Subtracted {
        /// In the unit of the channel.
        level: f64,
        /// In the unit of the channel per s.
        slope_per_s: f64,
    },
    /// Divided by a scale; the unit before.
    Divided {
        /// Scale in the unit of the channel.
        by: f64,
        /// Unit before.
        unit: String,
    },
    /// Samples were missing or outlying.
    Samples {
        /// Where, in samples of the record before the step.
        runs: Vec<Gap>,
        /// What became of them.
        became: Became,
    },
    /// The record is a part of another one.
    Part {
        /// Name of the record before the step.
        of: String,
        /// First sample of it.
        from: usize,
        /// One past the last sample of it.
        to: usize,
        /// Sample time in s; NaN for stamps that were not uniform.
        #[serde(deserialize_with = "crate::nullable::number")]
        sample_time_s: f64,
    },
    /// Part of a record that was given up.
    Dropped {
        /// First sample.
        from: usize,
        /// One past the last.
        to: usize,
        /// Why.
        why: String,
    },
    /// Sampled anew in time.
    Resampled {
        /// Sample time before in s; NaN for stamps that were not uniform.
        #[serde(deserialize_with = "crate::nullable::number")]
        from_s: f64,
        /// Sample time now in s.
        to_s: f64,
        /// Time of the first sample after the first sample of the record before, in s; NaN on the way back from a
        /// crank angle base.
        #[serde(deserialize_with = "crate::nullable::number")]
        start_s: f64,
        /// Samples before.
        samples_before: usize,
        /// Samples now.
        samples_after: usize,
    },
    /// From time to crank angle.
    PerEvent {
        /// Crank angle from sample to sample in deg.
        every_deg: f64,
        /// Speed in rpm at which the sample time that the record now carries is true.
        nominal_rpm: f64,
        /// Events.
        events: usize,
    },
    /// The channel was advanced: what is now at t was at t + seconds and `strokes` strokes (180 deg) later.
    Advanced {
        /// Fixed part in s.
        seconds: f64,
        /// Part that goes with the speed, in strokes.
        strokes: f64,
        /// Time that was cut off the start of the record, in s.
        cut_s: f64,
    },
    /// Filtered, forward and backward.
    Filtered {
        /// The filter in words.
        filter: String,
    },
}

/// `3, 7 to 9, 12`: the first runs as people write them.
fn places(runs: &[Gap]) -> String {
    let one = |g: &Gap| match g.samples() {
        1 => g.from.to_string(),
        _ => format!("{} to {}", g.from, g.to - 1),
    };
    let mut text = runs.iter().take(8).map(one).collect::<Vec<_>>().join(", ");
    if runs.len() > 8 {
        text += &format!(" and {} more places", runs.len() - 8);
    }
    text
}

impl Effect {
    fn sentence(&self) -> String {
        match self {
            Self::Subtracted { level, slope_per_s: 0.0 } => format!("{level:.6} subtracted"),
            Self::Subtracted { level, slope_per_s } => {
                format!("trend {level:.6} + {slope_per_s:.6}/s t subtracted")
            }
            Self::Divided { by, unit } => format!("divided by {by:.6} {unit}"),
            Self::Samples { runs, became } => {
                let n: usize = runs.iter().map(Gap::samples).sum();
                let became = match became {
                    Became::Interpolated => "interpolated",
                    Became::Held => "held at the value before",
                    Became::Replaced => "replaced",
                    Became::Missing => "left missing",
                    Became::CutOut => "cut out",
                };
                format!("{n} sample{} {became} ({})", if n == 1 { "" } else { "s" }, places(runs))
            }
            Self::Part { of, from, to, .. } => format!("is {of}, samples {from} to {}", to.saturating_sub(1)),
            Self::Dropped { from, to, why } => {
                format!("samples {from} to {} given up: {why}", to.saturating_sub(1))
            }
            Self::Resampled { from_s, to_s, samples_before, samples_after, .. } => {
                let from = if from_s.is_nan() { "irregular stamps".into() } else { format!("{from_s} s") };
                format!("{samples_before} samples ({from}) became {samples_after} ({to_s} s)")
            }
            Self::PerEvent { every_deg, nominal_rpm, events } => {
                format!("{events} events of {every_deg} deg; sample time as at {nominal_rpm:.1} rpm")
            }
            Self::Advanced { seconds, strokes, .. } if *strokes == 0.0 => format!("advanced by {seconds} s"),
            Self::Advanced { seconds, strokes, .. } => {
                format!("advanced by {seconds} s and {strokes} strokes")
            }
            Self::Filtered { filter } => filter.clone(),
        }
    }
}

impl Note {
    /// Every change as one sentence, then the remarks.
    pub fn sentences(&self) -> Vec<String> {
        let one = |c: &Change| match &c.channel {
            Some(channel) => format!("{}, {channel}: {}", c.record, c.effect.sentence()),
            None => format!("{}: {}", c.record, c.effect.sentence()),
        };
        self.changes.iter().map(one).chain(self.remarks.iter().cloned()).collect()
    }
}

/// Brings `values` of `channel` in `record`, as they are after all steps of `notes`, back to the channel's own unit
/// and level: what was subtracted is added at the times of the samples (`sample_time_s` apart), what was divided is
/// multiplied. Model outputs go the same way.
///
/// # Errors
/// [`PrepareError::Step`] where a trend in time was subtracted before the record left the time base.
pub fn restore(
    notes: &[Note],
    record: &str,
    channel: &str,
    sample_time_s: f64,
    values: &mut [f64],
) -> Result<(), PrepareError> {
    // The record's name and the time of its first sample, as they were before the steps that are already undone.
    let (mut name, mut start_s) = (record.to_string(), 0.0_f64);
    for note in notes.iter().rev() {
        let mut before = None;
        let mine = note.changes.iter().filter(|c| c.record == name);
        for c in mine.filter(|c| c.channel.as_deref().is_none_or(|found| found == channel)) {
            match &c.effect {
                Effect::Subtracted { level, slope_per_s } => {
                    if *slope_per_s != 0.0 && !start_s.is_finite() {
                        let message = format!("the trend of `{channel}` cannot be added back: {LOST}");
                        return Err(PrepareError::Step { step: "offset", record: name, message });
                    }
                    for (t, v) in values.iter_mut().enumerate() {
                        let drift = if *slope_per_s == 0.0 {
                            0.0
                        } else {
                            slope_per_s * (start_s + t as f64 * sample_time_s)
                        };
                        *v += level + drift;
                    }
                }
                Effect::Divided { by, .. } => values.iter_mut().for_each(|v| *v *= by),
                Effect::Part { of, from, sample_time_s, .. } => {
                    start_s += *from as f64 * sample_time_s;
                    before = Some(of.clone());
                }
                Effect::Resampled { start_s: first, .. } => start_s += first,
                Effect::PerEvent { .. } => start_s = f64::NAN,
                Effect::Advanced { strokes, .. } if *strokes != 0.0 => start_s = f64::NAN,
                Effect::Advanced { seconds, cut_s, .. } => start_s += seconds + cut_s,
                Effect::Samples { .. } | Effect::Dropped { .. } | Effect::Filtered { .. } => {}
            }
        }
        name = before.unwrap_or(name);
    }
    Ok(())
}

const LOST: &str = "its samples left the time base after it was subtracted; remove trends after that step";
