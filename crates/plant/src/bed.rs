//! The bed under its short name.

pub use crate::testbed::bed::EngineBed;
pub use crate::testbed::guard::LimitSettings;
pub use crate::testbed::start::BedSettings;
