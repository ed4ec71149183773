//! A record as one model sees it: where it starts, how many samples it scores.

use super::{Model, Run};
use crate::data::DataError;
use crate::experiment::Experiment;

impl Experiment {
    /// First sample that `model` computes and that is scored: `max(init_samples, longest lag)`. A free run starts
    /// there from the measured outputs before it.
    pub fn first(&self, model: &dyn Model) -> usize {
        self.init_samples.max(model.max_lag())
    }

    /// What the model needs.
    pub fn run(&self, model: &dyn Model) -> Run<'_> {
        Run { u: &self.u, y: &self.y, start: self.first(model) }
    }
}

/// Total number of scored samples.
///
/// # Errors
/// [`DataError::TooShort`] when a record ends before its first scored sample, or all together hold fewer scored
/// samples than the model has parameters; [`DataError::Length`] when inputs or weights do not fit the output.
pub fn usable_samples(model: &dyn Model, data: &[Experiment]) -> Result<usize, DataError> {
    let mut total = 0;
    for e in data {
        let m = model.n_inputs();
        let fault = |channel: &str, found| DataError::Length {
            record: e.name.clone(),
            channel: channel.into(),
            found,
            expected: e.len(),
        };
        if e.u.len() != m * e.len() {
            return Err(fault("inputs", e.u.len() / m.max(1)));
        }
        if !e.weights.is_empty() && e.weights.len() != e.len() {
            return Err(fault("weights", e.weights.len()));
        }
        let first = e.first(model);
        if e.len() <= first {
            let why = format!("{first} samples initialise, one must be left");
            return Err(DataError::TooShort {
                record: e.name.clone(),
                found: e.len(),
                expected: first + 1,
                why,
            });
        }
        total += e.len() - first;
    }
    let p = model.n_params();
    if total < p {
        let record = data.iter().map(|e| e.name.as_str()).collect::<Vec<_>>().join(", ");
        let why = format!("{p} parameters");
        return Err(DataError::TooShort { record, found: total, expected: p, why });
    }
    Ok(total)
}
