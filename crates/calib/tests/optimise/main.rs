//! Optimisation over a record.

mod cases;
mod common;
mod reference;
mod smoothing;
mod ways;
