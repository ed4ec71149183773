//! Structure selection: candidate pools and forward regression.

pub mod frols;
pub mod pool;
pub mod prune;
