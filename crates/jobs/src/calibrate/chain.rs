//! Models that read what another one says: where engine and fuelling are one plant, the injection goes through all others, as the flow
//! through the engine does. Their free runs stand on its free run.

use super::channels::Channels;
use super::error::ChainError;
use dynocal_ident::data::{Channel, Dataset, Role};
use dynocal_ident::stored::StoredModel;

/// Puts the free run of `model` into a record in place of what was measured of its output. From where it is no number any more it stays
/// where it was: what reads it is judged by what that gives.
///
/// # Errors
/// [`ChainError`]: a channel that the model reads is not there.
pub(super) fn put(model: &StoredModel, record: &mut Dataset) -> Result<(), ChainError> {
    let output = model.user_output();
    let mut values: Vec<f64> = model.simulate(record, None)?.into_iter().flat_map(|r| r.y).collect();
    for t in 0..values.len() {
        if !values[t].is_finite() {
            values[t] = if t > 0 { values[t - 1] } else { 0.0 };
        }
    }
    match record.channels.iter_mut().find(|c| c.name == output.name) {
        Some(c) => c.values = values,
        None => {
            record.channels.push(Channel {
                name: output.name,
                unit: output.unit,
                role: Role::Output,
                values,
            });
        }
    }
    Ok(())
}

/// A record with the free runs of the outputs that other models read.
///
/// # Errors
/// As of [`put`].
pub(super) fn with_read(
    channels: &Channels,
    models: &[&StoredModel],
    record: &Dataset,
) -> Result<Dataset, ChainError> {
    let mut record = record.clone();
    for name in &channels.read {
        if let Some(model) = models.iter().find(|m| m.user_output().name == *name) {
            put(model, &mut record)?;
        }
    }
    Ok(record)
}
