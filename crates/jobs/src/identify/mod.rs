//! From a measured file to validated models: load, split, prepare, structure, estimate, score, write.
//!
//! [`spec`] reads what the user wrote and checks it as a whole, [`job`] does the work with what `ident` offers,
//! [`result`] is what comes out.

pub mod after;
pub mod baseline;
pub mod before;
pub mod bounds;
pub mod curves;
pub mod error;
pub mod estimate;
pub mod finding;
pub mod fit;
pub mod gaps;
pub mod job;
pub mod judge;
pub mod load;
pub mod memory;
pub mod odd;
pub mod page;
pub mod points;
pub mod poles;
pub mod prepare;
mod remembered;
pub mod result;
pub mod score;
pub mod set;
pub mod spec;
pub mod verdict;
