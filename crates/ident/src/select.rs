//! Structure selection: candidate pools and forward regression.

pub mod pool;
