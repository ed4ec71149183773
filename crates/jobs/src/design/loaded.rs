//! A model of a design with everything that is known about it.

use std::sync::Arc;

use dynocal_design::criterion::Criterion;
use dynocal_ident::experiment::Experiment;
use dynocal_ident::model::Model;
use dynocal_ident::model::poly::PolyNarx;
use dynocal_ident::validate::boundary::BoundaryModel;

use super::OutputSpec;
use super::error::DesignJobError;

/// A criterion with its name.
pub struct NamedCriterion {
    /// Name.
    pub name: String,
    /// Criterion.
    pub criterion: Box<dyn Criterion>,
}

/// A model of the design with everything that is known about it.
pub struct Loaded {
    /// Name of the output.
    pub name: String,
    /// Its unit.
    pub unit: String,
    /// Model over all channels of the plan; of a model with a noise model, with the sensitivities of its prediction errors.
    pub model: Arc<dyn Model>,
    /// The same with the sensitivities of the free run, where they are others.
    pub predictor: Option<Arc<dyn Model>>,
    /// What the user should know about the information of this model.
    pub note: Option<String>,
    /// Parameters.
    pub theta: Vec<f64>,
    /// Variance of the output noise.
    pub noise_variance: f64,
    /// Criterion that the record is designed for; none for a model that only has limits.
    pub criterion: Option<NamedCriterion>,
    /// Weight.
    pub weight: f64,
    /// Output before the record.
    pub initial_output: f64,
    /// Sensitivities of earlier records.
    pub prior: Vec<f64>,
    /// Records that the model has not seen.
    pub held_out: Vec<Experiment>,
    /// What was identified.
    pub boundary: Option<BoundaryModel>,
    /// Limits of the output.
    pub limits: Option<OutputSpec>,
    /// Where it comes from.
    pub origin: String,
}

impl Loaded {
    /// A model with its parameters and nothing else.
    pub(super) fn bare(
        name: &str,
        unit: &str,
        model: Arc<dyn Model>,
        theta: Vec<f64>,
        noise_variance: f64,
        origin: String,
    ) -> Self {
        Self {
            name: name.into(),
            unit: unit.into(),
            model,
            predictor: None,
            note: None,
            theta,
            noise_variance,
            criterion: None,
            weight: 1.0,
            initial_output: 0.0,
            prior: Vec::new(),
            held_out: Vec::new(),
            boundary: None,
            limits: None,
            origin,
        }
    }
}

/// A model has the sample time of the plan.
pub(super) fn same_time(model: &str, found: f64, expected: f64) -> Result<(), DesignJobError> {
    match (found - expected).abs() <= 1e-6 * expected {
        true => Ok(()),
        false => Err(DesignJobError::SampleTime { model: model.into(), found, expected }),
    }
}

/// The same polynomial over all channels of the plan.
pub(super) fn over_channels(
    model: &dyn Model,
    inputs: &[String],
    output: &str,
    channels: &[String],
) -> Result<PolyNarx, DesignJobError> {
    if let Some(missing) = inputs.iter().find(|n| !channels.contains(n)) {
        return Err(DesignJobError::Channels {
            model: output.into(),
            found: channels.join(", "),
            expected: format!("`{missing}` as well, which the model needs"),
        });
    }
    let regressors: Vec<String> = (0..model.n_params()).map(|k| model.param_name(k)).collect();
    PolyNarx::parse(channels, output, &regressors)
        .map_err(|source| DesignJobError::Structure { file: output.into(), source })
}
