//! Why a design could not be made.

use dynocal_design::error::DesignError;
use dynocal_design::search::Failure;
use dynocal_files::FilesError;
use dynocal_ident::data::{DataError, UnitAfter};
use dynocal_ident::model::poly::StructureError;
use dynocal_ident::stored::StoredError;
use dynocal_numerics::registry::BuildError;

/// A design could not be made.
#[derive(Debug, thiserror::Error)]
pub enum DesignJobError {
    /// Files.
    #[error(transparent)]
    Files(#[from] FilesError),
    /// Records.
    #[error(transparent)]
    Data(#[from] DataError),
    /// A stored model that cannot be used.
    #[error("{file}: {source}")]
    Stored {
        /// File.
        file: String,
        /// What is wrong.
        source: StoredError,
    },
    /// A model file whose parts do not belong together.
    #[error("{file}: {source}")]
    Structure {
        /// Model file.
        file: String,
        /// What does not fit.
        source: StructureError,
    },
    /// A criterion, search or signal that cannot be built.
    #[error(transparent)]
    Build(#[from] BuildError),
    /// The problem as stated.
    #[error(transparent)]
    Design(#[from] DesignError),
    /// The search.
    #[error(transparent)]
    Search(#[from] Failure),
    /// A model needs channels that the plan does not have, or has them in another order.
    #[error("{model}: found the channels {found}, expected {expected}")]
    Channels {
        /// Model.
        model: String,
        /// Channels of the plan.
        found: String,
        /// What the model needs.
        expected: String,
    },
    /// A channel of the plan in another unit than the model's.
    #[error(
        "{model}: found the unit `{found}` of the channel `{channel}` in the spec, expected `{expected}`, that of the model"
    )]
    Unit {
        /// Model.
        model: String,
        /// Channel.
        channel: String,
        /// In the spec.
        found: String,
        /// Of the model.
        expected: String,
    },
    /// A model of present values.
    #[error(
        "{model}: found a steady model, expected a dynamic one: a test signal is designed for what a record in time tells; the points of steady models are planned by `dynocal map`"
    )]
    Steady {
        /// Model.
        model: String,
    },
    /// A model for another sample time.
    #[error("{model}: found sample_time_s = {found} in the spec, expected {expected} s, that of the model")]
    SampleTime {
        /// Model.
        model: String,
        /// In the spec.
        found: f64,
        /// Of the model.
        expected: f64,
    },
    /// A model without a noise level.
    #[error("{model}: no noise level is known, expected the key noise_std (in {unit})")]
    NoNoise {
        /// Model.
        model: String,
        /// Unit of its output.
        unit: String,
    },
    /// A model without parameters.
    #[error(
        "the model of {model} has no parameters (a response model is its points, splits or terms), so that a test signal can \
         tell nothing about them; expected a model with parameters"
    )]
    NoParameters {
        /// Model.
        model: String,
    },
    /// A model that nothing drives, or with a form that has no sensitivities.
    #[error("{model}: found a {kind} that the inputs do not drive, expected a model with inputs")]
    NotDriven {
        /// Model.
        model: String,
        /// Kind.
        kind: String,
    },
    /// A model whose free run grows without bound within the limits.
    #[error(
        "{model} is unstable: on the objective signal, repeated (a random record within the limits where none is given), its free run grows from {early:.4} to {late:.4}{u} \
         in {samples} samples; expected a stable model (see `stability` in the report of `dynocal identify`)",
        u = UnitAfter(.unit)
    )]
    Unstable {
        /// Model.
        model: String,
        /// Largest output in the first quarter.
        early: f64,
        /// Largest output in the last quarter.
        late: f64,
        /// Unit.
        unit: String,
        /// Samples that were run.
        samples: usize,
    },
    /// The objective signal asks for predictions where the plan may not go.
    #[error(
        "objective signal: found {channel} = {value}{u} at sample {sample}, expected {lower} to {upper}{u}, the \
         limits of the channel",
        u = UnitAfter(.unit)
    )]
    Objective {
        /// Channel.
        channel: String,
        /// Value.
        value: f64,
        /// Unit.
        unit: String,
        /// Sample.
        sample: usize,
        /// Least value.
        lower: f64,
        /// Largest value.
        upper: f64,
    },
    /// Stopped before there was anything.
    #[error("interrupted before a design was found")]
    Interrupted,
}
