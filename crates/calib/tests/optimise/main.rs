//! Optimisation over a record.

mod cases;
mod common;
mod dynamic;
mod giving;
mod guard;
mod local_bounds;
mod reference;
mod robust;
mod smoothing;
mod ways;
