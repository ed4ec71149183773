//! Stored models as the optimisation takes them.

use super::model::{OutputModel, OutputWay, Source};
use super::{OptimiseError, OptimiseOptions, Optimum, optimise_models};
use crate::problem::CalibrationProblem;
use dynocal_ident::data::Dataset;
use dynocal_ident::derived::Monomial;
use dynocal_ident::model::form::Driven;
use dynocal_ident::stored::{StoredError, StoredModel};
use dynocal_ident::validate::boundary::BoundaryModel;

/// What a stored model is to an optimisation: the structure that its inputs drive, and the way to it and back.
pub struct StoredOutput {
    output: String,
    driven: Driven,
    inputs: Vec<Source>,
    way: OutputWay,
    boundary: Option<BoundaryModel>,
}

impl StoredOutput {
    /// Takes the model apart.
    ///
    /// # Errors
    /// [`StoredError`]: nothing drives it, or its preparation does not act sample by sample.
    pub fn new(model: &StoredModel) -> Result<Self, StoredError> {
        let (driven, pointwise) = (model.driven()?, model.pointwise()?);
        let inputs = pointwise
            .inputs
            .iter()
            .map(|(name, affine)| Source {
                monomial: Monomial::of(name, &model.derived),
                offset: affine.offset,
                scale: affine.scale,
            })
            .collect();
        // The structure's own output is a monomial of the user's.
        let (factor, power) = match model.output_transform() {
            Some(t) => (t.factor, t.powers.values().next().copied().unwrap_or(1)),
            None => (1.0, 1),
        };
        let (offset, scale) = (pointwise.output.offset, pointwise.output.scale);
        let way = OutputWay { factor, power, offset, scale };
        let boundary = model.boundary.clone();
        Ok(Self { output: model.user_output().name, driven, inputs, way, boundary })
    }

    /// The model in the form of the program.
    pub fn model(&self) -> OutputModel<'_> {
        OutputModel {
            output: self.output.clone(),
            model: self.driven.model.as_ref(),
            theta: &self.driven.theta,
            inputs: self.inputs.clone(),
            way: self.way,
            boundary: self.boundary.as_ref(),
        }
    }
}

/// Largest relative difference of sample times that counts as equal.
const SAME_TIME: f64 = 1e-6;

/// [`optimise_models`] for stored models, whose units and sample time must be those of the record.
///
/// # Errors
/// [`OptimiseError`].
pub fn optimise_record(
    problem: &CalibrationProblem,
    models: &[&StoredModel],
    start: &Dataset,
    options: &OptimiseOptions,
    interrupt: &dyn Fn() -> bool,
) -> Result<Optimum, OptimiseError> {
    models.iter().try_for_each(|m| belongs(m, start))?;
    let taken = models.iter().map(|m| StoredOutput::new(m)).collect::<Result<Vec<_>, _>>()?;
    let all: Vec<OutputModel> = taken.iter().map(StoredOutput::model).collect();
    optimise_models(problem, &all, start, options, interrupt)
}

fn belongs(model: &StoredModel, record: &Dataset) -> Result<(), OptimiseError> {
    let (name, output) = (record.name.clone(), model.user_output().name);
    let (found, expected) = (record.sample_time_s, model.sample_time_s);
    if (found - expected).abs() > SAME_TIME * expected {
        return Err(OptimiseError::SampleTime { record: name, found, output, expected });
    }
    for q in model.measured() {
        let channel = record.channel(&q.name)?;
        // Old files do not know the unit of every measured channel.
        if channel.unit != q.unit && q.unit != "-" {
            let (found, expected) = (channel.unit.clone(), q.unit);
            return Err(OptimiseError::Unit { record: name, channel: q.name, found, output, expected });
        }
    }
    Ok(())
}
