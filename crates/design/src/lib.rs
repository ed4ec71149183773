//! Optimal test-signal design: information, criteria, constraints, search.

pub mod channel;
pub mod criterion;
pub mod error;
pub mod information;
pub mod kernel;
pub mod problem;
