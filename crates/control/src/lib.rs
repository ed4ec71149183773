//! Feedback around a model: loops with exact delay, their margins, controllers in the parameter plane, predictors, and
//! the controller that runs.
//!
//! ```text
//! u = C (r - y),   y = G u        G(s) = N(s)/D(s) e^(-L s),  or in q = z^-1;   the delay is never approximated
//! S = (I + G C)^-1,  T = I - S
//! ```
//!
//! Nothing here knows what an engine is: [`linear`] takes a linear model out of a stored one, the rest sees transfer
//! functions only.

pub mod closed;
pub mod disk;
pub mod error;
pub mod experiment;
pub mod grid;
pub mod horizon;
pub mod identify;
pub mod interaction;
pub mod linear;
pub mod margin;
pub mod matrix;
pub mod mu;
pub mod oxygen;
pub mod perturb;
pub mod plane;
pub mod poly;
pub mod predictor;
pub mod response;
pub mod runtime;
pub mod search;
pub mod simulate;
pub mod smith;
pub mod stable;
pub mod stored;
pub mod system;
pub mod trial;
pub mod trim;
pub mod tune;
