//! Jobs: what `dynocal` does for a user, one folder a job, each from a typed spec to a run folder.
//!
//! Every job is arranged alike: a *spec* is read as typed and then checked as a whole, so that only the checked form
//! reaches the *work*, which runs in memory and returns a typed *result*; the *page* renders the result, and the *store*
//! writes spec, data, models and summary into the run folder. Faces (program, Python, workbench) call jobs and hold no
//! mathematics; jobs see a plant only as `&mut dyn Plant`.

pub mod calibrate;
pub mod control;
pub mod convert;
pub mod design;
pub mod draft;
pub mod engine;
pub mod estimate;
pub mod export;
pub mod export_spec;
pub mod families;
pub mod fuelling;
pub mod identify;
pub mod kept;
pub mod label;
pub mod map;
pub mod optimise;
pub mod page;
pub mod place;
pub mod runs;
pub mod sequential;
pub mod show;
pub mod signal;
pub mod simulate;
