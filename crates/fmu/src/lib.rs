//! A functional mock-up unit (FMI 2.0 or 3.0, co-simulation) as a plant.
//!
//! An FMU is a zip archive with a description and a shared library. [`FmuPlant`] unpacks it, loads the library and is
//! then a [`dynocal_ident::plant::Plant`] like any other: its inputs and outputs are channels with units, a step holds
//! the inputs and calls the unit's `DoStep`.
//!
//! This crate stands alone because it calls foreign code: an FMU runs with the rights of the program. All `unsafe` is in
//! the modules `library`, `library2` and `library3`. What an archive says is checked before anything of it is run: sizes, places,
//! numbers of the description; what its binary does cannot be.

mod archive;
mod description;
mod error;
mod library;
mod library2;
mod library3;
mod plant;

pub use description::{Description, FmiVariable, Role, Version};
pub use error::FmuError;
pub use plant::{FmuPlant, FmuSettings};
