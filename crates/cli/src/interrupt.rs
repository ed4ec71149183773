//! Ctrl-C: the first asks the work to stop at the next good point, the second ends the process.

use crate::terminal::say;
use std::sync::atomic::{AtomicBool, Ordering};

static ASKED: AtomicBool = AtomicBool::new(false);

/// Exit code of a process that a signal ended, as shells report it for Ctrl-C.
const KILLED: i32 = 130;

/// Catches Ctrl-C from now on.
pub(crate) fn install() -> Result<(), ctrlc::Error> {
    ctrlc::set_handler(|| {
        if ASKED.swap(true, Ordering::Relaxed) {
            std::process::exit(KILLED);
        }
        say("stopping at the next safe point; press Ctrl-C again to end at once");
    })
}

/// Whether the user has asked to stop.
pub(crate) fn asked() -> bool {
    ASKED.load(Ordering::Relaxed)
}
