//! Stored models as the optimisation takes them.

use super::model::{OutputModel, OutputWay, Source};
use super::{OptimiseError, OptimiseOptions, Optimum, optimise_models};
use crate::problem::{CalibrationProblem, Monomial};
use dynocal_ident::data::Dataset;
use dynocal_ident::derived::Derived;
use dynocal_ident::model::form::Driven;
use dynocal_ident::stored::{StoredError, StoredModel};

/// What a stored model is to an optimisation: the structure that its inputs drive, and the way to it and back.
pub struct StoredOutput {
    output: String,
    driven: Driven,
    inputs: Vec<Source>,
    way: OutputWay,
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
                monomial: monomial(name, &model.derived),
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
        Ok(Self { output: model.user_output().name, driven, inputs, way })
    }

    /// The model in the form of the program.
    pub fn model(&self) -> OutputModel<'_> {
        OutputModel {
            output: self.output.clone(),
            model: self.driven.model.as_ref(),
            theta: &self.driven.theta,
            inputs: self.inputs.clone(),
            way: self.way,
        }
    }
}

/// A channel as a monomial of measured ones.
fn monomial(name: &str, derived: &[Derived]) -> Monomial {
    let mut out = Monomial { factor: 1.0, powers: vec![(name.to_string(), 1)] };
    for d in derived.iter().rev() {
        let Some(at) = out.powers.iter().position(|(known, _)| *known == d.name) else { continue };
        let (_, power) = out.powers.remove(at);
        out.factor *= d.factor.powi(power);
        for (channel, p) in &d.powers {
            match out.powers.iter_mut().find(|(known, _)| known == channel) {
                Some((_, sum)) => *sum += p * power,
                None => out.powers.push((channel.clone(), p * power)),
            }
        }
        out.powers.retain(|(_, p)| *p != 0);
    }
    out
}

/// [`optimise_models`] for stored models.
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
    let taken = models.iter().map(|m| StoredOutput::new(m)).collect::<Result<Vec<_>, _>>()?;
    let all: Vec<OutputModel> = taken.iter().map(StoredOutput::model).collect();
    optimise_models(problem, &all, start, options, interrupt)
}
