//! What cannot be exported or read back, with the names of things.

/// An export or its re-import failed.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum ExportError {
    /// The neutral form contradicts itself.
    #[error("`{what}`: {reason}")]
    Form {
        /// Characteristic, axis, node or signal.
        what: String,
        /// Found and expected.
        reason: String,
    },
    /// The format cannot hold what is to be written.
    #[error("{format} cannot hold `{what}`: {reason}")]
    Unfit {
        /// Format.
        format: &'static str,
        /// What was to be written.
        what: String,
        /// Why not, and what can.
        reason: String,
    },
    /// A file that is read back is broken.
    #[error("{file}{}: {reason}", at(.line))]
    Malformed {
        /// File.
        file: String,
        /// Line from 1; 0 where there is none.
        line: usize,
        /// Found and expected.
        reason: String,
    },
    /// A tool of the system failed.
    #[error("{0}")]
    Tool(String),
}

fn at(line: &usize) -> String {
    if *line == 0 { String::new() } else { format!(", line {line}") }
}

impl ExportError {
    pub(crate) fn form(what: &str, reason: impl Into<String>) -> Self {
        ExportError::Form { what: what.into(), reason: reason.into() }
    }
}
