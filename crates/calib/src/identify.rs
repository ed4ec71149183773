//! From a measured file to a validated model: load, split, structure, estimate, score, write.
//!
//! [`spec`] reads what the user wrote and checks it as a whole, [`job`] does the work with what `ident` offers,
//! [`result`] is what comes out.

pub mod job;
pub mod result;
pub mod spec;
