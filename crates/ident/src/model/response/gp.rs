//! Gaussian processes: exact with estimated noise, sparse above a stated number of points.
//!
//! Inputs and output are scaled to mean zero and standard deviation one; lengths, noise ratio and signal variance are
//! estimated by the restricted likelihood (`likelihood`), in logarithms, with its exact gradient, from several starts.

mod factors;
mod fit;
mod fit_sparse;
pub mod kernel;
pub mod likelihood;
mod mean;
mod model;
mod newton;
pub mod noise;
mod packed;
mod predict;
mod slopes;
mod sparse;
mod tiles;

pub(super) use fit::MEMBER;

pub use factors::Factors;
pub use fit::{GaussianProcess, KernelChoice, NoiseChoice, OutputChoice};
pub use kernel::Kernel;
pub use mean::Mean;
pub use model::{GpModel, Hyperparameters};
pub use sparse::SparseGpModel;
