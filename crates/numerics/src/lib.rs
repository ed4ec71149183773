//! Numerical ground floor of dynocal: linear algebra, random numbers, member tables, optimisers.
//!
//! Nothing here knows what an engine is. The linear-algebra backend is named in [`linalg`] only, the
//! random generator in [`rng`] only, the sparse factorisation in [`nlp`] only.

pub mod fft;
pub mod interval;
pub mod lanes;
pub mod linalg;
pub mod lm;
pub mod nlp;
pub mod optim;
pub mod registry;
pub mod rng;
pub mod status;
mod vector_state;
pub mod watch;
