//! Optimal test-signal design: information, criteria, constraints, search.
//!
//! Which test next? Given models with their parameters and noise, [`search::design`] finds the input record within
//! amplitude, rate, hold and output limits whose measured outputs would determine the parameters, or the
//! predictions, best. From the bottom: [`information`] (what a record tells), [`criterion`] (one number of it),
//! [`problem`] (value and exact gradient with respect to every free sample), [`search`], [`safety`].

pub mod certificate;
pub mod channel;
pub mod criterion;
pub mod error;
pub mod information;
mod kernel;
pub mod noise_model;
pub mod points;
pub mod problem;
pub mod safety;
pub mod schedule;
pub mod search;
pub mod stationarity;
