//! Parameter estimation: the contract, its table, and what every estimator reports.

pub mod bands;
pub mod cost;
mod covariance;
mod fit;
pub mod initial;
pub mod iv;
pub mod missing;
pub mod narmax;
mod noise;
pub mod ols;
pub mod pem;
pub mod rls;
pub mod search;
pub mod sem;
pub mod several;
mod simulation;
mod stability;
pub mod train;

use dynocal_numerics::linalg::LinalgError;
use dynocal_numerics::registry::{self, BuildError, Member, MemberDoc, ParamDoc};

pub use covariance::{CovarianceChoice, CovarianceKind};
pub use fit::{Fit, Minimised};
pub use noise::Residuals;

use crate::data::DataError;
use crate::experiment::Experiment;
use crate::model::Model;

/// An estimator: model structure and experiments in, parameters with what is known about them out.
pub trait Estimator: Send + Sync {
    /// Estimates the parameters of `model` from all experiments together.
    ///
    /// `start` is a start point (p) for iterative estimators; without one they start from least squares.
    /// `interrupt` is asked often and ends the search with the best point so far.
    ///
    /// # Errors
    /// [`EstimateError`]: the data cannot give an answer, or no stable start exists.
    fn estimate(
        &self,
        model: &dyn Model,
        data: &[Experiment],
        start: Option<&[f64]>,
        interrupt: &dyn Fn() -> bool,
    ) -> Result<Fit, EstimateError>;
}

/// No estimate is possible.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum EstimateError {
    /// The data do not fit the task.
    #[error(transparent)]
    Data(#[from] DataError),
    /// The orders do not fit the channels.
    #[error(transparent)]
    Structure(#[from] crate::model::poly::StructureError),
    /// Least squares needs a model that is linear in its parameters.
    #[error(
        "{estimator}: the model is not linear in its {params} parameters; give a start point or another estimator"
    )]
    NotLinear {
        /// Estimator.
        estimator: &'static str,
        /// Number of parameters.
        params: usize,
    },
    /// A start point of the wrong length.
    #[error("start point has {found} entries, the model has {expected} parameters")]
    Start {
        /// Entries found.
        found: usize,
        /// Parameters.
        expected: usize,
    },
    /// A linear start was asked of a structure that has no linear path.
    #[error(
        "start = \"linear\": the model `{model}` has no linear path; a network has one with `direct = true`"
    )]
    NoLinearPath {
        /// First parameters of the model.
        model: String,
    },
    /// The free run diverges and no repaired start was found.
    #[error(
        "the free run of the model `{model}` diverges on {record} from sample {sample} on, also with all output terms shrunk; try fewer output terms or a start point"
    )]
    Unstable {
        /// First regressors of the model.
        model: String,
        /// Record.
        record: String,
        /// First non-finite sample.
        sample: usize,
    },
    /// More is unknown than can be estimated together.
    #[error(
        "{record}: {found} missing samples and initial states, expected at most {most}: bridge short gaps or split the record at long ones"
    )]
    Missing {
        /// Record.
        record: String,
        /// Unknowns.
        found: usize,
        /// Most that are estimated together.
        most: usize,
    },
    /// The linear algebra met values it cannot handle (overflow in the regressors).
    #[error("{estimator}: {source}")]
    Numeric {
        /// Estimator.
        estimator: &'static str,
        /// What happened.
        source: LinalgError,
    },
}

/// All estimators.
pub static ESTIMATORS: &[Member<dyn Estimator>] = &[
    Member {
        doc: MemberDoc {
            name: "ols",
            what: "one-step prediction error by column-scaled QR least squares (PEM)",
            params: &[
                ParamDoc {
                    name: "ridge",
                    unit: "-",
                    default: "0",
                    what: "weight on squared parameters, each in units of its regressor's rms, relative to the number of samples",
                },
                ParamDoc {
                    name: "cost",
                    unit: "-",
                    default: "\"squared\"",
                    what: "cost of an error: squared, or huber, which outliers pull with a constant force only",
                },
                ParamDoc {
                    name: "threshold",
                    unit: "-",
                    default: "1.345",
                    what: "where Huber's cost turns linear, in robust standard deviations of the errors",
                },
                ParamDoc {
                    name: "covariance",
                    unit: "-",
                    default: "\"auto\"",
                    what: "white, robust (sandwich for coloured errors), or auto: as a test of the errors says",
                },
            ],
        },
        build: |keys| Ok(Box::new(registry::keys::<ols::Ols>("ols", keys)?)),
    },
    Member {
        doc: MemberDoc {
            name: "iv",
            what: "instrumental variables from the free run of least squares, eqs. (2.18) to (2.21)",
            params: &[
                ParamDoc {
                    name: "four_step",
                    unit: "-",
                    default: "true",
                    what: "whether a noise model then filters the instruments",
                },
                ParamDoc {
                    name: "noise_order",
                    unit: "samples",
                    default: "0",
                    what: "order of that noise model; 0 for the number of parameters",
                },
                ParamDoc {
                    name: "reference_order",
                    unit: "samples",
                    default: "4",
                    what: "order of the models from an external reference, where there is one",
                },
            ],
        },
        build: |keys| Ok(Box::new(registry::keys::<iv::Iv>("iv", keys)?)),
    },
    Member {
        doc: MemberDoc {
            name: "sem",
            what: "simulation (free-run) error with exact recursive sensitivities, by Levenberg-Marquardt or another search",
            params: &[
                ParamDoc {
                    name: "search",
                    unit: "-",
                    default: "\"lm\"",
                    what: "lm, line_search, quasi_newton, lbfgsb, nelder_mead or pattern_search",
                },
                ParamDoc {
                    name: "max_evaluations",
                    unit: "-",
                    default: "0",
                    what: "most cost evaluations per start; 0: 200 for lm, 200 per parameter for nelder_mead, more for others",
                },
                ParamDoc {
                    name: "cost_tolerance",
                    unit: "-",
                    default: "1e-12",
                    what: "relative decrease that ends the search",
                },
                ParamDoc {
                    name: "restarts",
                    unit: "-",
                    default: "0",
                    what: "further starts around the first one",
                },
                ParamDoc {
                    name: "spread",
                    unit: "-",
                    default: "0.1",
                    what: "relative spread of the further starts",
                },
                ParamDoc { name: "seed", unit: "-", default: "0", what: "seed of the further starts" },
                ParamDoc {
                    name: "ridge",
                    unit: "-",
                    default: "0",
                    what: "weight on squared parameters, as of ols",
                },
                ParamDoc {
                    name: "cost",
                    unit: "-",
                    default: "\"squared\"",
                    what: "cost of an error: squared, or huber, which outliers pull with a constant force only",
                },
                ParamDoc {
                    name: "threshold",
                    unit: "-",
                    default: "1.345",
                    what: "where Huber's cost turns linear, in robust standard deviations of the errors",
                },
                ParamDoc {
                    name: "covariance",
                    unit: "-",
                    default: "\"auto\"",
                    what: "white, robust (sandwich for coloured errors), or auto: as a test of the errors says",
                },
            ],
        },
        build: |keys| Ok(Box::new(registry::keys::<sem::Sem>("sem", keys)?)),
    },
    train::MEMBER,
];

/// Builds the estimator `name` from the keys of a spec.
///
/// # Errors
/// [`BuildError`] with the nearest known name.
pub fn estimator(name: &str, keys: &toml::Table) -> Result<Box<dyn Estimator>, BuildError> {
    registry::build("estimator", ESTIMATORS, name, keys)
}

/// Documentation of all estimators.
pub fn docs() -> Vec<MemberDoc> {
    ESTIMATORS.iter().map(|m| m.doc).collect()
}

/// All parameter names.
fn names(model: &dyn Model) -> Vec<String> {
    (0..model.n_params()).map(|k| model.param_name(k)).collect()
}

/// The model in a few words, for messages.
fn short_name(names: &[String]) -> String {
    let head = names.iter().take(3).cloned().collect::<Vec<_>>().join(" + ");
    if names.len() > 3 { format!("{head} + ... ({} terms)", names.len()) } else { head }
}
