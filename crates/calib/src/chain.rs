//! The campaign end to end: seven steps, each a function from files to files.

pub mod context;
pub mod design_step;
pub mod excite_step;
pub mod invert_step;
pub mod models;
pub mod optimise_step;
pub mod reference_design;
pub mod run;
pub mod spec;
pub mod validate_step;
