//! Steady response models: an output as a function of d inputs, learnt from points without time.
//!
//! ```text
//! y = f(x) + e,   E f(x) = mean,   var f(x) = variance,   var e = noise
//! ```
//!
//! Every kind gives the mean with its uncertainty and, for optimisers and designs, the exact gradients and Hessians of
//! both with respect to the inputs. A prediction writes to buffers that the caller owns.
//!
//! ```
//! use dynocal_ident::model::response::{Ask, Learn, Points, Prediction, Response, gp::GaussianProcess};
//!
//! let x: Vec<f64> = (0..40).map(|i| f64::from(i) / 8.0).collect();
//! let y = x.iter().map(|x| x.sin()).collect();
//! let points = Points { inputs: vec!["spark".into()], output: "torque".into(), x, y };
//! let learnt = GaussianProcess::default().learn(&points, &|| false)?;
//! let mut at = Prediction::new(1);
//! learnt.model.predict(&[1.3], Ask::Gradient, &mut at);
//! assert!((at.mean - 1.3f64.sin()).abs() < 1e-3 && (at.gradient[0] - 1.3f64.cos()).abs() < 1e-2);
//! # Ok::<(), dynocal_ident::model::response::ResponseError>(())
//! ```

mod bands;
pub mod best_of;
pub mod choose;
mod features;
pub mod form;
pub mod formula;
pub mod gp;
pub mod kinds;
pub mod local_linear;
pub mod mean_of;
pub mod points;
pub mod polynomial;
pub mod rbf;
pub mod scaling;
pub mod score;
pub mod sequential;
mod stepwise;
pub mod transform;
pub mod warp;

use std::sync::Arc;

use dynocal_numerics::linalg::LinalgError;
use dynocal_numerics::registry::{self, BuildError, Member, MemberDoc};
use serde::{Deserialize, Deserializer, Serialize, Serializer};

pub use points::{Points, PointsError};
pub use scaling::Scaling;

/// How much of a prediction is asked for; each includes those before it.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Ask {
    /// The mean alone.
    Mean,
    /// Mean, variance of the response, variance of the noise.
    Variance,
    /// Gradients of mean and variance with respect to the inputs.
    Gradient,
    /// Hessians of both.
    Hessian,
}

/// A prediction and the buffers that it needs, owned by the caller and used again from call to call. What was not asked
/// for keeps what stood there.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Prediction {
    /// Expected response, in the unit of the output.
    pub mean: f64,
    /// Variance of the response: what the model does not know.
    pub variance: f64,
    /// Variance of the noise of one measurement at this point.
    pub noise: f64,
    /// Gradient of the mean with respect to the inputs (d).
    pub gradient: Vec<f64>,
    /// Gradient of the variance (d).
    pub variance_gradient: Vec<f64>,
    /// Hessian of the mean (d x d).
    pub hessian: Vec<f64>,
    /// Hessian of the variance (d x d).
    pub variance_hessian: Vec<f64>,
    /// First input that moves.
    moving: usize,
    /// Space that the model computes in.
    work: Vec<f64>,
    /// Predictions of the members of a mean.
    parts: Vec<Prediction>,
}

impl Prediction {
    /// Buffers for d inputs.
    pub fn new(d: usize) -> Self {
        let mut new = Self::default();
        new.fit(d);
        new
    }

    /// Buffers for d inputs of which those from `first` on move: second derivatives with respect to those before it are not asked for,
    /// and mean nothing.
    #[must_use]
    pub fn of_moving(d: usize, first: usize) -> Self {
        Self { moving: first, ..Self::new(d) }
    }

    /// Makes room for d inputs.
    fn fit(&mut self, d: usize) {
        self.gradient.resize(d, 0.0);
        self.variance_gradient.resize(d, 0.0);
        self.hessian.resize(d * d, 0.0);
        self.variance_hessian.resize(d * d, 0.0);
    }

    /// Standard deviation of a new measurement: response and noise together.
    pub fn measured_std(&self) -> f64 {
        (self.variance + self.noise).max(0.0).sqrt()
    }

    /// Working space of at least `len` numbers, taken out so that the results can be written beside it; give it back.
    fn take_work(&mut self, len: usize) -> Vec<f64> {
        let mut work = std::mem::take(&mut self.work);
        if work.len() < len {
            work.resize(len, 0.0);
        }
        work
    }
}

/// A response model that was learnt.
pub trait Response: Send + Sync {
    /// Number of inputs d.
    fn dim(&self) -> usize;

    /// Prediction at x (d). Variances are never negative.
    fn predict(&self, x: &[f64], ask: Ask, out: &mut Prediction);

    /// One sentence for reports: kind and size.
    fn describe(&self) -> String;
}

/// Prediction of one point from all the others.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct LeftOut {
    /// Measured minus predicted, per point, in the unit of the output.
    pub residuals: Vec<f64>,
    /// Variance of that difference: response without the point, and noise.
    pub variance: Vec<f64>,
}

impl LeftOut {
    /// Root mean square of the residuals.
    pub fn rmse(&self) -> f64 {
        let n = self.residuals.len().max(1) as f64;
        (self.residuals.iter().map(|e| e * e).sum::<f64>() / n).sqrt()
    }
}

/// What learning gave.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Learnt {
    /// The model.
    pub model: ResponseModel,
    /// Leave-one-out in closed form: structure and hyperparameters kept, coefficients estimated again.
    pub left_out: LeftOut,
    /// Sentences for the report.
    pub notes: Vec<String>,
    /// How it was chosen, where there were several candidates.
    #[serde(default)]
    pub choice: Option<choose::Choice>,
}

impl Learnt {
    /// One that nothing was chosen for.
    fn new(model: ResponseModel, left_out: LeftOut, notes: Vec<String>) -> Self {
        Self { model, left_out, notes, choice: None }
    }
}

/// A kind of response model before it has seen points.
pub trait Learn: Send + Sync {
    /// Learns from points. `interrupt` is asked between and within searches (those that run side by side end first); the best
    /// model so far is then given.
    ///
    /// # Errors
    /// [`ResponseError`], which names channel, row or size.
    fn learn(&self, points: &Points, interrupt: &dyn Fn() -> bool) -> Result<Learnt, ResponseError>;
}

/// All kinds of response models.
pub static RESPONSES: &[Member<dyn Learn>] =
    &[polynomial::MEMBER, gp::MEMBER, local_linear::MEMBER, rbf::MEMBER, mean_of::MEMBER, best_of::MEMBER];

/// Builds the kind `name` from the keys of a spec.
///
/// # Errors
/// [`BuildError`] with the nearest known name.
pub fn learner(name: &str, keys: &toml::Table) -> Result<Box<dyn Learn>, BuildError> {
    registry::build("response model", RESPONSES, name, keys)
}

/// Documentation of all kinds.
pub fn docs() -> Vec<MemberDoc> {
    RESPONSES.iter().map(|m| m.doc).collect()
}

/// No model can be given.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum ResponseError {
    /// The points do not fit the task.
    #[error(transparent)]
    Points(#[from] PointsError),
    /// A key has a value outside its range.
    #[error("{model}: {key} is {found}, expected {expected}")]
    Key {
        /// Kind of model.
        model: &'static str,
        /// Key.
        key: &'static str,
        /// Value.
        found: String,
        /// What is allowed.
        expected: String,
    },
    /// An output that a transform is not made for.
    #[error("stepwise_polynomial: this `transform` is for {expected}, and an output is {found}")]
    Domain {
        /// What it is for.
        expected: String,
        /// The first output that is not.
        found: f64,
    },
    /// It would take too much memory.
    #[error(
        "{model}: {points} points would take {mebibytes} MiB, at most {most} points are taken exactly; raise `{key}` or let it choose inducing points"
    )]
    Memory {
        /// Kind of model.
        model: &'static str,
        /// Points.
        points: usize,
        /// What they would take.
        mebibytes: usize,
        /// Most points.
        most: usize,
        /// Key that allows more.
        key: &'static str,
    },
    /// The points that are left without one fold do not fit the task.
    #[error("without fold {fold} of {folds} ({points} points are left): {source}")]
    Fold {
        /// Fold, counted from 1.
        fold: usize,
        /// Number of folds.
        folds: usize,
        /// Points that are left.
        points: usize,
        /// Why nothing can be learnt from them.
        source: Box<ResponseError>,
    },
    /// No start of the search gave a model.
    #[error("{model} of `{output}`: no start gave a positive definite matrix")]
    NoStart {
        /// Kind of model.
        model: &'static str,
        /// Output.
        output: String,
    },
    /// The linear algebra met values that it cannot handle.
    #[error("{model}: {source}")]
    Numeric {
        /// Kind of model.
        model: &'static str,
        /// What happened.
        source: LinalgError,
    },
}

/// A stored response model of any kind.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(tag = "kind", rename_all = "snake_case")]
pub enum ResponseModel {
    /// Polynomial.
    Polynomial(polynomial::PolynomialModel),
    /// Gaussian process.
    GaussianProcess(gp::GpModel),
    /// Sparse Gaussian process.
    SparseGaussianProcess(gp::SparseGpModel),
    /// Local linear or quadratic models.
    LocalLinear(local_linear::LocalLinearModel),
    /// Radial basis functions.
    Rbf(rbf::RbfModel),
    /// Mean of several.
    MeanOf(mean_of::MeanOfModel),
}

impl ResponseModel {
    /// The model behind the contract.
    pub fn as_response(&self) -> &dyn Response {
        match self {
            Self::Polynomial(model) => model,
            Self::GaussianProcess(model) => model,
            Self::SparseGaussianProcess(model) => model,
            Self::LocalLinear(model) => model,
            Self::Rbf(model) => model,
            Self::MeanOf(model) => model,
        }
    }
}

/// A response model that several share.
#[derive(Clone, Debug, PartialEq)]
pub struct LearntModel(pub Arc<ResponseModel>);

impl From<Arc<ResponseModel>> for LearntModel {
    fn from(model: Arc<ResponseModel>) -> Self {
        Self(model)
    }
}

impl Serialize for LearntModel {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        self.0.serialize(serializer)
    }
}

impl<'de> Deserialize<'de> for LearntModel {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        Ok(Self(Arc::new(ResponseModel::deserialize(deserializer)?)))
    }
}

impl Response for ResponseModel {
    fn dim(&self) -> usize {
        self.as_response().dim()
    }

    fn predict(&self, x: &[f64], ask: Ask, out: &mut Prediction) {
        self.as_response().predict(x, ask, out);
    }

    fn describe(&self) -> String {
        self.as_response().describe()
    }
}
