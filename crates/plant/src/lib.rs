//! What answers a test: the virtual engine and literature systems.
//!
//! [`engine::VirtualEngine`] is a crank-angle resolved 2.0 l four-cylinder gasoline engine of the
//! filling-and-emptying kind (level F0): eight gas volumes, three conserved species, direct injection,
//! Wiebe combustion with a burn sub-model, Woschni heat transfer, Chen-Flynn friction. It stands in
//! for the engine model of the thesis (chapters 3, 6, 7). [`bed::EngineBed`] puts it behind the plant
//! contract of the identification crate;
//! [`statics`] finds steady points and best spark; [`plants`] is the table that specs name.

pub mod bed;
mod bookkeeping;
pub mod cams;
pub mod combustion;
pub mod deviations;
pub mod dissociation;
pub mod driven;
pub mod egr;
pub mod emissions;
pub mod end_gas;
pub mod engine;
pub mod equilibrium;
pub mod error;
pub mod exhaust_wall;
pub mod film;
mod flatten;
pub mod full_load;
pub mod gas;
pub mod geometry;
mod grid;
pub mod heat;
mod initial;
pub mod inputs;
pub mod nitric_oxide;
pub mod orifice;
pub mod outputs;
pub mod params;
pub mod plants;
pub mod sensors;
pub mod state;
pub mod statics;
mod step;
pub mod testbed;
pub mod trace;
pub mod turbocharger;
pub mod vehicle;
