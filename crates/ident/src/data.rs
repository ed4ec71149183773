//! Records: channels of equal length, usually uniformly sampled.
//!
//! A sample that is not known is NaN, no other number marks it and no other value but a finite one is a sample. What
//! needs every sample calls [`Dataset::check`]; what can deal with missing ones calls [`Dataset::check_marked`].
//! A record whose stamps are not uniform has a sample time of NaN and its stamps in a channel (see
//! [`crate::prepare`], step `resample`).

use std::fmt;

use serde::{Deserialize, Serialize};

/// A unit behind a number in a sentence: a space and the unit, nothing where there is none (`-`).
///
/// ```
/// use dynocal_ident::data::UnitAfter;
/// assert_eq!(format!("{}{}", 1.02, UnitAfter("-")), "1.02");
/// assert_eq!(format!("{}{}", 20, UnitAfter("Nm")), "20 Nm");
/// ```
#[derive(Clone, Copy, Debug)]
pub struct UnitAfter<'a>(pub &'a str);

impl fmt::Display for UnitAfter<'_> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        if matches!(self.0, "-" | "") { Ok(()) } else { write!(f, " {}", self.0) }
    }
}

/// What a channel is to an identification.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Role {
    /// Drives the system.
    Input,
    /// Answers.
    Output,
    /// Recorded beside, used by nothing unless asked for.
    Auxiliary,
}

/// One channel of a record.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Channel {
    /// Name, e.g. `torque`.
    pub name: String,
    /// Unit, e.g. `Nm`; `-` for none.
    pub unit: String,
    /// Role.
    pub role: Role,
    /// Samples; NaN where one is missing.
    #[serde(deserialize_with = "crate::nullable::numbers")]
    pub values: Vec<f64>,
}

/// Consecutive missing samples of one channel.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Gap {
    /// First missing sample.
    pub from: usize,
    /// One past the last.
    pub to: usize,
}

impl Gap {
    /// Number of missing samples.
    pub fn samples(&self) -> usize {
        self.to - self.from
    }
}

/// Runs of consecutive samples for which `bad` holds, in order.
pub fn runs(n: usize, bad: impl Fn(usize) -> bool) -> Vec<Gap> {
    let mut found: Vec<Gap> = Vec::new();
    for t in (0..n).filter(|t| bad(*t)) {
        match found.last_mut() {
            Some(gap) if gap.to == t => gap.to = t + 1,
            _ => found.push(Gap { from: t, to: t + 1 }),
        }
    }
    found
}

impl Channel {
    /// The channel with other samples.
    pub fn with(&self, values: Vec<f64>) -> Self {
        Self { name: self.name.clone(), unit: self.unit.clone(), role: self.role, values }
    }

    /// The gaps of the channel, in order.
    pub fn gaps(&self) -> Vec<Gap> {
        runs(self.values.len(), |t| self.values[t].is_nan())
    }
}

/// One experiment: channels of equal length.
///
/// Several experiments are a `Vec<Dataset>`. Estimation never changes its input.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Dataset {
    /// Name of the experiment, e.g. `ident01`.
    pub name: String,
    /// Sample time in s; NaN while the stamps are not uniform (they then stand in a channel).
    #[serde(deserialize_with = "crate::nullable::number")]
    pub sample_time_s: f64,
    /// Channels, all of one length.
    pub channels: Vec<Channel>,
    /// Number of leading samples that only initialise states and enter no score.
    pub init_samples: usize,
    /// Where the record came from (file, plant and seed).
    pub origin: String,
}

/// A record is not what the caller said.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum DataError {
    /// No channel of that name.
    #[error("{record}: no channel `{found}`; channels are: {}", .known.join(", "))]
    NoChannel {
        /// Record name.
        record: String,
        /// Name asked for.
        found: String,
        /// Names there are.
        known: Vec<String>,
    },
    /// Channels differ in length.
    #[error("{record}: channel `{channel}` has {found} samples, the others have {expected}")]
    Length {
        /// Record name.
        record: String,
        /// Channel name.
        channel: String,
        /// Its length.
        found: usize,
        /// Length of the first channel.
        expected: usize,
    },
    /// A sample is NaN or infinite.
    #[error("{record}: channel `{channel}`, sample {sample}: found {found}, expected a finite number")]
    NonFinite {
        /// Record name.
        record: String,
        /// Channel name.
        channel: String,
        /// Zero-based sample index.
        sample: usize,
        /// The value.
        found: f64,
    },
    /// A channel without a single sample.
    #[error("{record}: channel `{channel}` is missing in all {samples} samples: leave it out or record it")]
    AllMissing {
        /// Record name.
        record: String,
        /// Channel name.
        channel: String,
        /// Number of samples.
        samples: usize,
    },
    /// An input that never changes cannot be identified.
    #[error(
        "{record}: input `{channel}` is constant ({value}) over all {samples} samples: it excites nothing; remove it from the inputs or record a test that moves it"
    )]
    ConstantInput {
        /// Record name.
        record: String,
        /// Channel name.
        channel: String,
        /// Its value.
        value: f64,
        /// Number of samples.
        samples: usize,
    },
    /// Too few samples.
    #[error("{record}: {found} usable samples, expected at least {expected} ({why})")]
    TooShort {
        /// Record name.
        record: String,
        /// Samples found.
        found: usize,
        /// Samples needed.
        expected: usize,
        /// Reason, e.g. `23 parameters`.
        why: String,
    },
    /// Sample times of experiments differ or are not positive.
    #[error("{record}: sample time {found} s, expected {expected}")]
    SampleTime {
        /// Record name.
        record: String,
        /// Value found, in s.
        found: f64,
        /// What was expected.
        expected: String,
    },
}

impl Dataset {
    /// Number of samples (0 when there is no channel).
    pub fn len(&self) -> usize {
        self.channels.first().map_or(0, |c| c.values.len())
    }

    /// Whether there is no sample.
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// The channel `name`.
    ///
    /// # Errors
    /// [`DataError::NoChannel`] with the names there are.
    pub fn channel(&self, name: &str) -> Result<&Channel, DataError> {
        self.channels.iter().find(|c| c.name == name).ok_or_else(|| DataError::NoChannel {
            record: self.name.clone(),
            found: name.to_string(),
            known: self.channels.iter().map(|c| c.name.clone()).collect(),
        })
    }

    /// The samples of channel `name`.
    ///
    /// # Errors
    /// [`DataError::NoChannel`].
    pub fn values(&self, name: &str) -> Result<&[f64], DataError> {
        self.channel(name).map(|c| c.values.as_slice())
    }

    /// The channels `names` as one row-major N x m matrix.
    ///
    /// # Errors
    /// [`DataError::NoChannel`].
    pub fn matrix(&self, names: &[String]) -> Result<Vec<f64>, DataError> {
        let cols = names.iter().map(|n| self.values(n)).collect::<Result<Vec<_>, _>>()?;
        let mut rows = Vec::with_capacity(self.len() * cols.len());
        for t in 0..self.len() {
            rows.extend(cols.iter().map(|c| c[t]));
        }
        Ok(rows)
    }

    /// A copy with one more channel, `f` of each sample of channel `from` (e.g. 1/speed, 1/lambda).
    ///
    /// # Errors
    /// [`DataError::NoChannel`]; [`DataError::NonFinite`] (of the new channel) when `f` is not finite somewhere.
    pub fn with_derived(
        &self,
        from: &str,
        name: &str,
        unit: &str,
        role: Role,
        f: impl Fn(f64) -> f64,
    ) -> Result<Self, DataError> {
        let values: Vec<f64> = self.values(from)?.iter().map(|v| f(*v)).collect();
        let mut copy = self.clone();
        copy.channels.push(Channel { name: name.into(), unit: unit.into(), role, values });
        copy.check()?;
        Ok(copy)
    }

    /// Names of the channels with `role`, in file order.
    pub fn names(&self, role: Role) -> Vec<String> {
        self.channels.iter().filter(|c| c.role == role).map(|c| c.name.clone()).collect()
    }

    /// Samples `from..to` as a record of its own, under `name`; the origin says which they are.
    pub fn part(&self, from: usize, to: usize, name: String) -> Self {
        let cut = |c: &Channel| c.with(c.values[from..to].to_vec());
        Self {
            name,
            sample_time_s: self.sample_time_s,
            channels: self.channels.iter().map(cut).collect(),
            init_samples: self.init_samples,
            origin: format!("{}, samples {from} to {}", self.origin, to.saturating_sub(1)),
        }
    }

    /// Checks that lengths agree, the sample time is positive and every sample finite.
    ///
    /// # Errors
    /// The first fault found.
    pub fn check(&self) -> Result<(), DataError> {
        if !(self.sample_time_s > 0.0 && self.sample_time_s.is_finite()) {
            let expected = if self.sample_time_s.is_nan() {
                "uniform stamps: a step `resample` in the preparation makes them"
            } else {
                "a positive number"
            };
            return Err(DataError::SampleTime {
                record: self.name.clone(),
                found: self.sample_time_s,
                expected: expected.into(),
            });
        }
        self.check_samples(f64::is_finite)
    }

    /// The same with missing samples (NaN) and stamps that are not uniform (sample time NaN) allowed; a channel must
    /// have one sample at least.
    ///
    /// # Errors
    /// The first fault found.
    pub fn check_marked(&self) -> Result<(), DataError> {
        if self.sample_time_s <= 0.0 || self.sample_time_s.is_infinite() {
            let (record, found) = (self.name.clone(), self.sample_time_s);
            return Err(DataError::SampleTime { record, found, expected: "a positive number".into() });
        }
        self.check_samples(|v| !v.is_infinite())?;
        match self.channels.iter().find(|c| !c.values.is_empty() && c.values.iter().all(|v| v.is_nan())) {
            Some(c) => Err(DataError::AllMissing {
                record: self.name.clone(),
                channel: c.name.clone(),
                samples: self.len(),
            }),
            None => Ok(()),
        }
    }

    fn check_samples(&self, allowed: impl Fn(f64) -> bool) -> Result<(), DataError> {
        for c in &self.channels {
            if c.values.len() != self.len() {
                return Err(DataError::Length {
                    record: self.name.clone(),
                    channel: c.name.clone(),
                    found: c.values.len(),
                    expected: self.len(),
                });
            }
            if let Some((t, v)) = c.values.iter().enumerate().find(|(_, v)| !allowed(**v)) {
                return Err(DataError::NonFinite {
                    record: self.name.clone(),
                    channel: c.name.clone(),
                    sample: t,
                    found: *v,
                });
            }
        }
        Ok(())
    }
}
