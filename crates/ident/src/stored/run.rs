//! Stored models on records in the user's units.

use super::{StoredError, StoredModel};
use crate::data::{Channel, DataError, Dataset, Role, UnitAfter};
use crate::estimate::missing::bridged;
use crate::experiment::Experiment;
use crate::model::Kind;
use crate::model::initial::Initial;
use crate::prepare::{Note, again, prepare, restore};

/// Output of a model on one record as the stored preparation leaves it (a step may split a record into several).
#[derive(Clone, Debug, PartialEq)]
pub struct Computed {
    /// Name of the record.
    pub record: String,
    /// Sample time in s.
    pub sample_time_s: f64,
    /// Computed output (N), in the user's unit; NaN after a run that diverged.
    pub y: Vec<f64>,
    /// Measured output (N), in the user's unit; none where the record has none.
    pub measured: Option<Vec<f64>>,
    /// First sample that is scored; those before initialise.
    pub first: usize,
    /// What an engineer should know, in sentences.
    pub remarks: Vec<String>,
}

/// Share of a record outside of what the estimation saw of one channel.
#[derive(Clone, Debug, PartialEq)]
pub struct Outside {
    /// Channel.
    pub channel: String,
    /// Unit.
    pub unit: String,
    /// Share of the samples outside, 0 to 1.
    pub share: f64,
    /// Least and greatest value of the record.
    pub found: [f64; 2],
    /// Least and greatest value of the estimation.
    pub seen: [f64; 2],
}

impl StoredModel {
    /// Free run over `record`; `initial` instead of the model's own start.
    ///
    /// A record without the output is simulated from rest.
    ///
    /// # Errors
    /// [`StoredError`]: a channel is missing or in another unit, the sample time is another, the stored preparation does not
    /// go with the record, or a start is asked for that needs the output.
    pub fn simulate(&self, record: &Dataset, initial: Option<Initial>) -> Result<Vec<Computed>, StoredError> {
        self.computed(record, Kind::FreeRun, initial)
    }

    /// One step or k steps ahead over `record`, which has measured outputs.
    ///
    /// # Errors
    /// As of [`StoredModel::simulate`].
    pub fn predict(&self, record: &Dataset, steps: usize) -> Result<Vec<Computed>, StoredError> {
        let kind = if steps <= 1 { Kind::OneStep } else { Kind::KStep(steps) };
        self.computed(record, kind, None)
    }

    /// Whether [`StoredModel::simulate`] would take `record`; runs nothing.
    ///
    /// # Errors
    /// As of [`StoredModel::simulate`].
    pub fn takes(&self, record: &Dataset, initial: Option<Initial>) -> Result<(), StoredError> {
        self.start_of(record, Kind::FreeRun, initial)?;
        let (records, _) = self.prepared(record)?;
        Ok(records.iter().try_for_each(|d| self.shaped(d).map(drop))?)
    }

    /// The start of a run over `record`.
    fn start_of(
        &self,
        record: &Dataset,
        kind: Kind,
        initial: Option<Initial>,
    ) -> Result<Initial, StoredError> {
        let user = self.user_output();
        let has_output = record.channels.iter().any(|c| c.name == user.name);
        let initial = match initial {
            Some(rule) => rule,
            None if has_output => self.initial(),
            None => Initial::Rest,
        };
        if !has_output && (kind != Kind::FreeRun || initial != Initial::Rest) {
            let (record, channel) = (record.name.clone(), user.name);
            return Err(StoredError::NoOutput { record, channel });
        }
        Ok(initial)
    }

    /// Output of any kind.
    ///
    /// # Errors
    /// As of [`StoredModel::simulate`].
    pub fn computed(
        &self,
        record: &Dataset,
        kind: Kind,
        initial: Option<Initial>,
    ) -> Result<Vec<Computed>, StoredError> {
        let fitted = self.fitted()?;
        let fitted = fitted.starting(self.start_of(record, kind, initial)?);
        let has_output = record.channels.iter().any(|c| c.name == self.user_output().name);
        let (records, notes) = self.prepared(record)?;
        let mut out = Vec::new();
        for d in &records {
            let (e, remarks) = self.shaped(d)?;
            let first = fitted.first(&e).min(e.len());
            let Some(mut y) = fitted.output(&e, kind) else {
                return Err(StoredError::NotDriven { output: self.output.name.clone() });
            };
            self.to_user(&notes, d, &mut y)?;
            let mut measured =
                has_output.then(|| d.values(&self.output.name).map(<[f64]>::to_vec)).transpose()?;
            if let Some(z) = &mut measured {
                self.to_user(&notes, d, z)?;
            }
            let (record, sample_time_s) = (d.name.clone(), d.sample_time_s);
            out.push(Computed { record, sample_time_s, y, measured, first, remarks });
        }
        Ok(out)
    }

    /// The record as the model sees it, with what was done to it: derived channels added, the stored preparation applied.
    ///
    /// # Errors
    /// As of [`StoredModel::simulate`].
    pub fn prepared(&self, record: &Dataset) -> Result<(Vec<Dataset>, Vec<Note>), StoredError> {
        let mut d = record.clone();
        self.stand_in(&mut d);
        self.check_units(&d)?;
        for derived in &self.derived {
            // One that only other models need may lack its channels.
            let needed = self.inputs.iter().chain([&self.output]).any(|q| q.name == derived.name)
                || self.derived.iter().any(|other| other.powers.contains_key(&derived.name));
            if needed && !d.channels.iter().any(|c| c.name == derived.name) {
                let role = if derived.name == self.output.name { Role::Output } else { Role::Input };
                derived.add_to(&mut d, role)?;
            }
        }
        for q in &self.inputs {
            d.channel(&q.name)?;
        }
        let present: Vec<String> = d.channels.iter().map(|c| c.name.clone()).collect();
        let output = || self.output.name.clone();
        let plan = again(&self.preparation, &present)
            .map_err(|e| StoredError::Step { output: output(), message: e.to_string() })?;
        let (records, notes) = prepare(&plan, vec![d], &mut |_, _| ())
            .map_err(|source| StoredError::Prepare { output: output(), source })?;
        for d in records.iter().filter(|_| !self.is_steady()) {
            if !((d.sample_time_s - self.sample_time_s).abs() <= 1e-6 * self.sample_time_s) {
                return Err(DataError::SampleTime {
                    record: d.name.clone(),
                    found: d.sample_time_s,
                    expected: format!("{} s as in the model of `{}`", self.sample_time_s, self.output.name),
                }
                .into());
            }
        }
        Ok((records, notes))
    }

    /// Inputs and output of a prepared record for the structure; gaps are bridged by straight lines, and said.
    ///
    /// # Errors
    /// [`DataError::NoChannel`].
    pub fn shaped(&self, d: &Dataset) -> Result<(Experiment, Vec<String>), DataError> {
        let names = self.structure.form().inputs();
        let e = Experiment {
            name: d.name.clone(),
            u: d.matrix(names)?,
            y: d.values(&self.output.name)?.to_vec(),
            init_samples: d.init_samples,
            weights: Vec::new(),
        };
        let (whole, missing) = bridged(&e);
        let gaps = missing.inputs.len() + missing.outputs.len();
        let remark = || {
            format!(
                "{}: {gaps} missing samples of the model of `{}` bridged by straight lines",
                d.name, self.output.name
            )
        };
        Ok((whole, if gaps > 0 { vec![remark()] } else { Vec::new() }))
    }

    /// Values of the structure's output on a prepared record, in place to the user's output and unit.
    ///
    /// # Errors
    /// [`StoredError`] where a step cannot be undone.
    pub fn to_user(&self, notes: &[Note], d: &Dataset, values: &mut [f64]) -> Result<(), StoredError> {
        restore(notes, &d.name, &self.output.name, d.sample_time_s, values)
            .map_err(|source| StoredError::Prepare { output: self.output.name.clone(), source })?;
        if let Some(transform) = self.output_transform() {
            values.iter_mut().for_each(|v| *v = transform.inverted(*v).unwrap_or(f64::NAN));
        }
        Ok(())
    }

    /// Channels of `record` that leave what the estimation saw of them.
    pub fn outside(&self, record: &Dataset) -> Vec<Outside> {
        let inputs = self.measured_inputs();
        let one = |s: &super::Seen| {
            let values = record.values(&s.name).ok().filter(|_| inputs.iter().any(|q| q.name == s.name))?;
            // Rounding is no extrapolation.
            let slack = 1e-9 * (s.maximum - s.minimum).abs();
            let out = values.iter().filter(|v| **v < s.minimum - slack || **v > s.maximum + slack).count();
            let range = |from: f64, pick: fn(f64, f64) -> f64| values.iter().copied().fold(from, pick);
            (out > 0).then(|| Outside {
                channel: s.name.clone(),
                unit: s.unit.clone(),
                share: out as f64 / values.len() as f64,
                found: [range(f64::INFINITY, f64::min), range(f64::NEG_INFINITY, f64::max)],
                seen: [s.minimum, s.maximum],
            })
        };
        self.seen.iter().filter_map(one).collect()
    }

    fn check_units(&self, d: &Dataset) -> Result<(), StoredError> {
        for q in self.measured() {
            let c = d.channel(&q.name)?;
            if c.unit != q.unit {
                return Err(StoredError::Unit {
                    record: d.name.clone(),
                    channel: q.name,
                    found: c.unit.clone(),
                    expected: q.unit,
                    output: self.output.name.clone(),
                });
            }
        }
        Ok(())
    }

    /// Where a record lacks the output, steps of the preparation may still name it: a constant stands there, which nothing
    /// reads.
    fn stand_in(&self, d: &mut Dataset) {
        let user = self.user_output();
        if d.channels.iter().any(|c| c.name == user.name) {
            return;
        }
        let seen = self.seen.iter().find(|s| s.name == user.name);
        let level = seen.map_or(1.0, |s| s.minimum + 0.5 * (s.maximum - s.minimum));
        let level = if level == 0.0 { 1.0 } else { level };
        let values = vec![level; d.len()];
        d.channels.push(Channel { name: user.name, unit: user.unit, role: Role::Output, values });
    }
}

impl Outside {
    /// In words.
    pub fn sentence(&self) -> String {
        format!(
            "`{}` leaves what the model was identified on in {:.1} % of the samples: {} to {}{}, identified from {} to {}",
            self.channel,
            100.0 * self.share,
            rounded(self.found[0]),
            rounded(self.found[1]),
            UnitAfter(&self.unit),
            rounded(self.seen[0]),
            rounded(self.seen[1])
        )
    }
}

/// To five digits, for sentences.
fn rounded(v: f64) -> f64 {
    format!("{v:.4e}").parse().unwrap_or(v)
}
