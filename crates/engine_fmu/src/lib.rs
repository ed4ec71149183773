//! The virtual engine and its bed as an FMU for co-simulation, FMI 2.0 and 3.0 from one library.
//!
//! The library exports both C interfaces. What it simulates stands in the resources of the FMU: `plant.toml` (the table
//! `[plant]` of a spec) and, where the parameter set came from a file, `parameters.toml`. The real numbers of the set are the
//! parameters of the FMU. Inputs are held over a communication step, outputs are what a bed records for it; the whole state can
//! be saved, restored and taken out as bytes.
//!
//! All `unsafe` is in the modules `unit`, `abi2` and `abi3`: what an importer hands over is believed as the standard promises it,
//! null pointers are answered with an error where the standard leaves room, and no panic goes through the interface.
//!
//! [`description`] writes the `modelDescription.xml` that fits; packing is the export job's.

mod abi2;
mod abi3;
pub mod description;
pub mod engine;
mod outside;
mod unit;
