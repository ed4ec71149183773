//! Uniformly sampled records.

use serde::{Deserialize, Serialize};

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
    /// Samples.
    pub values: Vec<f64>,
}

/// One experiment: uniformly sampled channels of equal length.
///
/// Several experiments are a `Vec<Dataset>`. Estimation never changes its input.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Dataset {
    /// Name of the experiment, e.g. `ident01`.
    pub name: String,
    /// Sample time in s.
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

    /// Checks that lengths agree, the sample time is positive and every sample finite.
    ///
    /// # Errors
    /// The first fault found.
    pub fn check(&self) -> Result<(), DataError> {
        if !(self.sample_time_s > 0.0 && self.sample_time_s.is_finite()) {
            return Err(DataError::SampleTime {
                record: self.name.clone(),
                found: self.sample_time_s,
                expected: "a positive number".into(),
            });
        }
        for c in &self.channels {
            if c.values.len() != self.len() {
                return Err(DataError::Length {
                    record: self.name.clone(),
                    channel: c.name.clone(),
                    found: c.values.len(),
                    expected: self.len(),
                });
            }
            if let Some((t, v)) = c.values.iter().enumerate().find(|(_, v)| !v.is_finite()) {
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
