//! The test bed around the engine, and what a real engine adds to the ideal one.
//!
//! | part | file |
//! |---|---|
//! | dynamometer: speed at once, speed of a rotor with inertia, load | [`dynamometer`] |
//! | air-bleed valve | [`bleed`] |
//! | lags, rates, PI controllers | [`dynamics`] |
//! | transport delay | [`delay`] |
//! | sensors: transport, lag, drift, noise, quantisation | [`sensor`] |
//! | limits with back-off | [`guard`] |
//! | cycles that scatter, cylinders that differ | [`crate::deviations`] |
//! | walls, coolant, oil | [`thermal`] |
//! | catalyst | [`catalyst`] |
//! | fuel film of port injection | [`crate::film`] |
//! | fuel cut-off and idle | [`idle`] |
//!
//! [`bed::EngineBed`] puts them together behind the plant contract; [`settings::BedOptions`] are its keys, all ideal by
//! default.

pub mod bed;
pub mod bleed;
pub mod catalyst;
pub mod delay;
pub mod dynamics;
pub mod dynamometer;
pub mod guard;
pub mod idle;
mod inputs;
mod plant;
pub mod quantity;
pub mod sensor;
pub mod settings;
pub mod start;
pub mod state;
mod table;
pub mod thermal;
mod variables;
