//! What the loops are worth, measured: on the virtual engine as a black box (thesis section 4.10) and on known models.
//!
//! Every comparison is paired over seeds, on records that no model has seen; see [`paired::Paired`].

pub mod black_box;
pub mod engine;
pub mod known;
pub mod mimo;
pub mod paired;
pub mod pools;
pub mod signals;
pub mod violations;
