//! Validation: scores that say what they are, tests of residuals, pools of records, cross-validation, stability of free
//! runs, and how far a point or a plan is from what was identified.

pub mod boundary;
pub mod cross;
mod departure;
mod lack;
mod score;
pub mod spread;
pub mod stability;

pub use crate::correlation::{
    ChiSquared, Correlation, NamedCorrelation, autocorrelation, cross_correlation, independence,
    nonlinear_tests, whiteness,
};
pub use departure::{BEYOND, Departure, departure};
pub use lack::{Lack, lack};
pub use score::{
    Band, Reference, Score, Seen, score, score_form, score_in_band, score_noise_free, score_values,
};

pub use crate::model::{Kind, output};
