//! Progress on standard error: a live line on a terminal, plain lines elsewhere, nothing when quiet.

use std::io::IsTerminal;
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::Duration;

use indicatif::{ProgressBar, ProgressStyle};

/// Where progress goes.
pub(crate) struct Progress {
    kind: Kind,
    evaluations: AtomicU64,
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
        Self { kind, evaluations: AtomicU64::new(0) }
    }

    /// A new part of the work begins.
    pub(crate) fn note(&self, text: &str) {
        self.evaluations.store(0, Ordering::Relaxed);
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
        let count = self.evaluations.fetch_add(1, Ordering::Relaxed) + 1;
        if let Kind::Live(bar) = &self.kind {
            bar.set_prefix(format!("(evaluation {count})"));
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
