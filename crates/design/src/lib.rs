//! Optimal test-signal design: information, criteria, constraints, search.

pub mod criterion;
