//! The bed under its short name.

pub use crate::testbed::bed::{BedSettings, EngineBed};
pub use crate::testbed::guard::LimitSettings;
