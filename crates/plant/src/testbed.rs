//! The test bed around the engine, and what a real engine adds to the ideal one.
//!
//! The engine itself is deterministic, has four equal cylinders and warm walls, and is driven at an imposed speed.
//! [`deviations`] holds what the bed changes inside it: scatter from cycle to cycle, unequal cylinders, wall and oil
//! temperature; [`film`] is the fuel film of port injection.

pub mod deviations;
pub mod film;
