//! A calibration end to end: six steps, each a function from files to files, and the report.
//!
//! `calibrate` is a composition of other jobs. Step 2 writes specs of `identify` and runs them, step 3 one of `design`, step 4
//! optimises the [calibration problem](dynocal_calib::problem) over a record; each step may be given a file instead of being run:
//! measured records (`excite.identification_files`), a stored model (`identify.files`), a designed and measured record
//! (`design.record`). Every product can be taken out of the run folder and used elsewhere.

pub mod at_rest;
mod chain;
pub mod channels;
mod check;
pub mod context;
mod design_spec;
pub mod design_step;
pub mod error;
pub mod estimate;
pub mod excite_step;
mod excited;
mod fuel_driven;
mod fuel_on_model;
mod fuel_plant;
pub mod fuelled;
mod given;
pub mod invert_step;
pub mod job;
mod lag;
mod levels;
mod loops;
mod model_spec;
pub mod models;
pub mod optimise_miss;
pub mod optimise_plan;
mod optimise_start;
pub mod optimise_step;
pub mod optimise_trials;
pub mod page;
mod poor;
pub mod records;
mod refine;
pub mod run;
mod signals;
pub mod spec;
pub mod start_maps;
mod static_search;
pub mod store;
pub mod summary;
pub mod validate_step;
pub mod verdict;
