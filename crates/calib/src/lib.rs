//! Calibration campaigns: problems, optimisation over records, steady and dynamic maps, validation.
//!
//! A campaign sees a plant only as `&mut dyn Plant`: a test bed, a recording and the virtual engine are the same
//! thing to it.

pub mod fuelling;
pub mod gains;
pub mod limits;
pub mod loops;
pub mod map;
pub mod optimise;
pub mod problem;
pub mod steady;
pub mod supervisor;
pub mod validate;
