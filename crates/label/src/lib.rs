//! Labels (scalars, curves, maps of an ECU function) fitted to measurements.
//!
//! ```text
//! minimise over theta   sum_k w_k (b_k - a_k' theta)^2  +  lambda |D (theta - base)|^2  +  sum_i v_i (theta_i - base_i)^2
//! subject to            lower <= theta <= upper,   C theta >= d          (monotone, convex, gradient window, locks)
//! ```
//!
//! a_k holds the weights of the cells around an operating point ([`rows`]), D the curvature along each axis in physical units
//! ([`label`]). [`linear`] solves it, chooses lambda and says what the data tell of each cell; [`qp`] is the solver with limits,
//! [`quantise`] finds whole steps, [`truncated`] a table from look-ups that were cut; a function that is not linear in its labels is a graph ([`graph`]) and goes to [`nonlinear`].
//!
//! ```
//! use dynocal_label::label::Label;
//! use dynocal_label::linear::{Options, Problem, fit};
//! use dynocal_label::rows::Rows;
//! // A curve of two points through three measurements of y = 1 + 2 x.
//! let label = Label::curve("GAIN", "-", "x", "-", &[0.0, 1.0], &[0.0, 0.0]);
//! let (mut rows, mut y) = (Rows::default(), Vec::new());
//! for x in [0.0, 0.5, 1.0] {
//!     rows.start();
//!     label.enter(&mut rows, 0, 1.0, &[x]);
//!     y.push(1.0 + 2.0 * x);
//! }
//! let problem = Problem::new(std::slice::from_ref(&label), &rows, &y);
//! let found = fit(&problem, &Options::default()).unwrap();
//! assert!((found.values[0] - 1.0).abs() < 1e-6 && (found.values[1] - 3.0).abs() < 1e-6);
//! ```

pub mod correlation;
pub mod error;
pub mod follow;
pub mod graph;
pub mod label;
pub mod linear;
pub mod nonlinear;
pub mod qp;
pub mod quantise;
pub mod rows;
pub mod truncated;
pub mod ve;

pub use error::LabelError;
