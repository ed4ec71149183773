//! What the program writes to its standard output and standard error.
//!
//! `println!` and `eprintln!` panic where the reader has gone away (`dynocal .. 2>&1 | head -1`), so nothing else in
//! this crate writes to either stream.

use std::io::{ErrorKind, Write};

/// Standard output takes no more: a full disk is the user's to know.
#[derive(Debug, thiserror::Error)]
#[error("cannot write to standard output: {0}")]
pub(crate) struct OutputError(std::io::Error);

/// Prints to standard output. A reader that has gone away is not our error; a result that could not be written is.
///
/// # Errors
/// The text could not be written whole.
pub(crate) fn print(text: &str) -> Result<(), OutputError> {
    let mut out = std::io::stdout().lock();
    match out.write_all(text.as_bytes()).and_then(|()| out.flush()) {
        Err(e) if e.kind() != ErrorKind::BrokenPipe => Err(OutputError(e)),
        _ => Ok(()),
    }
}

/// A line on standard error: there is nowhere left to say that it failed.
pub(crate) fn say(line: &str) {
    let mut err = std::io::stderr().lock();
    let _ = writeln!(err, "{line}");
}
