//! Progress on standard error: a live line on a terminal, plain lines elsewhere, nothing when quiet.

use std::io::IsTerminal;
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::Duration;

use dynocal_numerics::watch::Watch;
use indicatif::{ProgressBar, ProgressStyle};

use crate::interrupt;
use crate::terminal::say;

/// Length of the bar in units, for work that knows its share.
const LENGTH: u64 = 1000;

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
            let bar = ProgressBar::new(LENGTH);
            style(&bar, "{spinner} {msg} {prefix} [{elapsed}]");
            bar.enable_steady_tick(Duration::from_millis(100));
            Kind::Live(bar)
        } else {
            Kind::Lines
        };
        Self { kind, evaluations: AtomicU64::new(0) }
    }

    /// Does `work` under watch: its notes and its share are shown, Ctrl-C stops it, and the live line is taken away at
    /// its end.
    pub(crate) fn during<T>(&self, work: impl FnOnce(Watch) -> T) -> T {
        let interrupt = || {
            self.evaluation();
            interrupt::asked()
        };
        let note = |text: &str| self.note(text);
        let fraction = |done: f64| self.fraction(done);
        let found = work(Watch { interrupt: &interrupt, note: &note, fraction: &fraction });
        self.finish();
        found
    }

    /// A new part of the work begins.
    fn note(&self, text: &str) {
        self.evaluations.store(0, Ordering::Relaxed);
        match &self.kind {
            Kind::Quiet => {}
            Kind::Lines => say(text),
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
    fn evaluation(&self) {
        let count = self.evaluations.fetch_add(1, Ordering::Relaxed) + 1;
        if let Kind::Live(bar) = &self.kind {
            bar.set_prefix(format!("(evaluation {count})"));
        }
    }

    /// The work knows how far it is: the line becomes a bar with the time left.
    fn fraction(&self, done: f64) {
        if let Kind::Live(bar) = &self.kind {
            style(bar, "{msg:32} {bar:32} {percent:>3} %  {elapsed} gone, about {eta} left");
            bar.set_position((LENGTH as f64 * done) as u64);
        }
    }

    /// Takes the live line away.
    fn finish(&self) {
        if let Kind::Live(bar) = &self.kind {
            let last = bar.message();
            if !last.is_empty() {
                bar.println(last);
            }
            bar.finish_and_clear();
        }
    }
}

fn style(bar: &ProgressBar, template: &str) {
    if let Ok(style) = ProgressStyle::with_template(template) {
        bar.set_style(style);
    }
}
