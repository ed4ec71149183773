//! Progress on standard error: a live line on a terminal, plain lines elsewhere, nothing when quiet.

use std::cell::Cell;
use std::io::IsTerminal;
use std::time::Duration;

use indicatif::{ProgressBar, ProgressStyle};

/// Where progress goes.
pub(crate) struct Progress {
    kind: Kind,
    evaluations: Cell<u64>,
}

enum Kind {
    Quiet,
    Lines,
    Live(ProgressBar),
}

impl Progress {
    pub(crate) fn new(quiet: bool) -> Self {
        let kind = if quiet {
            Kind::Quiet
        } else if std::io::stderr().is_terminal() {
            let bar = ProgressBar::new_spinner();
            if let Ok(style) = ProgressStyle::with_template("{spinner} {msg} {prefix} [{elapsed}]") {
                bar.set_style(style);
            }
            bar.enable_steady_tick(Duration::from_millis(100));
            Kind::Live(bar)
        } else {
            Kind::Lines
        };
        Self { kind, evaluations: Cell::new(0) }
    }

    /// A new part of the work begins.
    pub(crate) fn note(&self, text: &str) {
        self.evaluations.set(0);
        match &self.kind {
            Kind::Quiet => {}
            Kind::Lines => eprintln!("{text}"),
            Kind::Live(bar) => {
                // Earlier notes stay as lines above the live one.
                let before = bar.message();
                if !before.is_empty() {
                    bar.println(before);
                }
                bar.set_prefix("");
                bar.set_message(text.to_string());
            }
        }
    }

    /// One more evaluation of an iteration whose number of steps nobody knows beforehand.
    pub(crate) fn evaluation(&self) {
        self.evaluations.set(self.evaluations.get() + 1);
        if let Kind::Live(bar) = &self.kind {
            bar.set_prefix(format!("(evaluation {})", self.evaluations.get()));
        }
    }

    /// Takes the live line away.
    pub(crate) fn finish(&self) {
        if let Kind::Live(bar) = &self.kind {
            let last = bar.message();
            if !last.is_empty() {
                bar.println(last);
            }
            bar.finish_and_clear();
        }
    }
}
