//! Steady calibration on a plant.
//!
//! Two ways to a map: demands held by loops and the inputs that no loop drives searched on the plant, point by point ([`search`]);
//! or a day of planned points ([`station`], [`day`]) from which response models are learnt, and the optimum of every cell of the
//! map found on them ([`cell`], [`grid`]).

pub mod breakpoints;
pub mod cell;
pub mod corner;
pub mod day;
pub mod envelope;
pub mod front;
pub mod grid;
pub mod hold;
pub mod layout;
pub mod plan;
pub mod quantise;
pub mod refine;
pub mod search;
pub mod station;
pub mod trim;
pub mod valleys;
pub mod way;
pub mod whole;

pub use hold::{Held, HoldSpec, hold};
pub use search::{SearchSpec, best_point};
