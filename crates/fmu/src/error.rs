//! What can be wrong with an FMU.

/// An FMU cannot be used.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum FmuError {
    /// The archive cannot be read.
    #[error("{path}: {reason}")]
    Archive {
        /// File.
        path: String,
        /// Why.
        reason: String,
    },
    /// The description is not usable.
    #[error("{path}, modelDescription.xml{}: {reason}", at_line(.line))]
    Description {
        /// File.
        path: String,
        /// Line from 1, 0 where there is none.
        line: usize,
        /// Found and expected.
        reason: String,
    },
    /// There is no library for this platform.
    #[error("{path}: no binary for this platform ({wanted}); the archive has: {found}")]
    NoBinary {
        /// File.
        path: String,
        /// Path that was looked for.
        wanted: String,
        /// Binaries there are.
        found: String,
    },
    /// The library cannot be loaded or lacks a function.
    #[error("{path}: {reason}")]
    Library {
        /// File.
        path: String,
        /// What the system said.
        reason: String,
    },
    /// The unit refused a call.
    #[error("{path}: {function} returned {status}{hint}")]
    Refused {
        /// File.
        path: String,
        /// Function.
        function: &'static str,
        /// Its status.
        status: &'static str,
        /// What it may mean.
        hint: &'static str,
    },
}

fn at_line(line: &usize) -> String {
    if *line == 0 { String::new() } else { format!(", line {line}") }
}
