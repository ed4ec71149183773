//! The campaign end to end: seven steps, each a function from files to files.

mod check;
pub mod context;
pub mod design_step;
pub mod excite_step;
pub mod invert_step;
pub mod job;
pub mod models;
pub mod optimise_step;
pub mod page;
pub mod reference_design;
pub mod run;
pub mod spec;
pub mod store;
pub mod summary;
pub mod validate_step;
pub mod verdict;
