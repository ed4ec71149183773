//! Calibration campaigns: excitation, optimisation over records, maps, controllers, validation.
//!
//! A campaign sees a plant only as `&mut dyn Plant`: a test bed, a recording and the virtual engine are the same
//! thing to it.

pub mod control;
pub mod engine_model;
pub mod excite;
pub mod fuel;
pub mod loops;
pub mod map;
pub mod optimise;
pub mod problem;
pub mod record;
pub mod steady;
pub mod supervisor;
pub mod validate;
