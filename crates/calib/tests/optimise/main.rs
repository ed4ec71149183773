//! Optimisation over a record.

mod cases;
mod common;
mod giving;
mod reference;
mod smoothing;
mod ways;
