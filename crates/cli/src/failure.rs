//! How a verb ends: exit codes, and errors with their causes and a hint.

use std::error::Error;

use dynocal_files::spec::brief;

use crate::terminal::say;

/// Exit codes of every verb.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Exit {
    /// 0: done.
    Done,
    /// 1: done, but not converged or not valid; the warnings say why.
    NotValid,
    /// 2: could not.
    CouldNot,
}

/// How a verb ends whose result is usable (0) or not (1).
pub(crate) fn exit(valid: bool) -> Exit {
    if valid { Exit::Done } else { Exit::NotValid }
}

impl Exit {
    /// The exit code of the process.
    pub(crate) fn code(self) -> u8 {
        match self {
            Self::Done => 0,
            Self::NotValid => 1,
            Self::CouldNot => 2,
        }
    }
}

/// Most lines of a message.
const MOST_LINES: usize = 200;

/// Says a message, long numbers and long lines cut: what a file holds may be as long as it likes, what is said of it not.
fn said(text: &str) {
    let lines: Vec<String> = text.lines().take(MOST_LINES).map(brief).collect();
    say(&lines.join("\n"));
    if text.lines().nth(MOST_LINES).is_some() {
        say("  ..");
    }
}

/// Why a verb could not do its work.
#[derive(Debug)]
pub(crate) struct Failure {
    error: Box<dyn Error>,
    hint: Option<String>,
}

impl<E: Error + 'static> From<E> for Failure {
    fn from(error: E) -> Self {
        Self { error: Box::new(error), hint: None }
    }
}

impl Failure {
    /// The same with a hint at what to do.
    pub(crate) fn hint(mut self, text: impl Into<String>) -> Self {
        self.hint = Some(text.into());
        self
    }

    /// Prints error, causes and hint to standard error.
    pub(crate) fn print(&self) {
        let mut shown = self.error.to_string();
        said(&format!("error: {shown}"));
        let mut cause = self.error.source();
        while let Some(c) = cause {
            let text = c.to_string();
            // Messages that already contain their cause need not say it twice.
            if !shown.contains(&text) {
                said(&format!("  because: {text}"));
            }
            shown = text;
            cause = c.source();
        }
        if let Some(hint) = &self.hint {
            say(&format!("  hint: {hint}"));
        }
    }
}
