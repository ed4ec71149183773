//! Reading and writing measurement and result files.
//!
//! - [`atomic`]: every output is written whole (temporary name, then rename)
//! - [`csv_io`], [`parquet_io`]: files to a raw [`table::Table`] and back
//! - [`dataset`]: table, channel roles and sample time to [`dynocal_ident::data::Dataset`]s
//! - [`plan`]: a plan as two files, and the record that a bed made of it
//! - [`units`]: unit names, their aliases, exact conversions
//! - [`json`]: results with a schema version
//! - [`run_folder`]: the folder of a run, resumable step by step
//! - [`spec`]: TOML specs with every fault named at once

pub mod atomic;
pub mod csv_io;
pub mod dataset;
pub mod error;
pub mod json;
pub mod parquet_io;
pub mod plan;
pub mod run_folder;
pub mod spec;
pub mod table;
pub mod units;

pub use error::FilesError;
