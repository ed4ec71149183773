//! Reading and writing measurement and result files.
//!
//! - [`atomic`]: every output is written whole (temporary name, then rename)
//! - [`measurement`]: measurement files of any format in [`measurement::FORMATS`], listed and read in pieces
//! - [`csv_io`], [`parquet_io`] and the modules of [`measurement`]: the formats, one file each
//! - [`measurement::merge`], [`split`]: several rasters on one time axis; long records cut into experiments
//! - [`dataset`]: table, channel roles and sample time to [`dynocal_ident::data::Dataset`]s
//! - [`plan`]: a plan as two files, and the record that a bed made of it
//! - [`units`]: unit names, their aliases, exact conversions
//! - [`json`]: results with a schema version
//! - [`run_folder`]: the folder of a run, resumable step by step
//! - [`spec`]: TOML specs with every fault named at once

pub mod atomic;
pub mod bounds;
pub mod dataset;
pub mod error;
pub mod json;
pub mod measurement;
pub mod plan;
pub mod run_folder;
pub mod spec;
pub mod split;
pub mod table;
pub mod units;

pub use error::FilesError;
pub use measurement::{csv_io, parquet_io};
