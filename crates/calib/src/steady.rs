//! Steady calibration on a plant: demands held by loops, the inputs that no loop drives searched for the least objective.

pub mod hold;
pub mod search;

pub use hold::{Held, HoldSpec, hold};
pub use search::{SearchSpec, best_point};
