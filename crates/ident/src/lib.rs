//! Signals, data, dynamic models, estimation and validation; the contract with a plant.
//!
//! Usable alone: from a test signal to a validated model. Time runs down the rows everywhere; a matrix of
//! inputs is a flat row-major slice `u[t * m + i]` (N x m), a sensitivity matrix `s[t * p + k]` (N x p).

pub mod correlation;
pub mod data;
pub mod derived;
pub mod estimate;
pub mod excitation;
pub mod experiment;
pub mod linear;
pub mod model;
pub mod nullable;
pub mod pi;
pub mod plan;
pub mod plant;
pub mod play;
pub mod prepare;
pub mod select;
pub mod signal;
pub mod stored;
pub mod validate;
