//! Progress of a calibration on standard error: a bar with the time left on a terminal, one line per step elsewhere.

use std::io::IsTerminal;
use std::sync::Mutex;

use dynocal_jobs::calibrate::context::Event;
use indicatif::{ProgressBar, ProgressStyle};

use crate::terminal::say;

/// Rough shares of the seven steps in the whole time, for the bar only.
const SHARES: [f64; 7] = [0.10, 0.12, 0.28, 0.34, 0.03, 0.12, 0.01];
/// Length of the bar in units.
const LENGTH: f64 = 1000.0;

/// Shows events; safe to call from several threads.
pub(crate) struct StepProgress {
    quiet: bool,
    bar: Option<ProgressBar>,
    /// Step from 1, and the text that stays when it is over.
    now: Mutex<(usize, String)>,
}

impl StepProgress {
    pub(crate) fn new(quiet: bool) -> Self {
        let live = !quiet && std::io::stderr().is_terminal();
        let bar = live.then(|| {
            let bar = ProgressBar::new(LENGTH as u64);
            if let Ok(style) = ProgressStyle::with_template(
                "{msg:32} {bar:32} {percent:>3} %  {elapsed} gone, about {eta} left",
            ) {
                bar.set_style(style);
            }
            bar.enable_steady_tick(std::time::Duration::from_millis(200));
            bar
        });
        Self { quiet, bar, now: Mutex::new((0, String::new())) }
    }

    /// Shows one event.
    pub(crate) fn tell(&self, event: Event) {
        let Ok(mut now) = self.now.lock() else { return };
        match event {
            Event::Step(k, of, name) => {
                *now = (k, format!("step {k} of {of}: {name}"));
                match &self.bar {
                    Some(bar) => {
                        bar.set_message(now.1.clone());
                        self.place(k, 0.0);
                    }
                    None => self.line(&now.1),
                }
            }
            Event::Resumed(_) => self.line(&format!("{}: taken from the earlier run", now.1)),
            Event::Fraction(f) => self.place(now.0, f),
            Event::Note(text) => self.line(&text),
        }
    }

    /// A line that stays.
    pub(crate) fn line(&self, text: &str) {
        match &self.bar {
            Some(bar) => bar.println(text),
            None if !self.quiet => say(text),
            None => {}
        }
    }

    /// Takes the bar away.
    pub(crate) fn finish(&self) {
        if let Some(bar) = &self.bar {
            bar.finish_and_clear();
        }
    }

    fn place(&self, step: usize, fraction: f64) {
        if let Some(bar) = &self.bar {
            let before: f64 = SHARES.iter().take(step.saturating_sub(1)).sum();
            let share = SHARES.get(step.saturating_sub(1)).copied().unwrap_or(0.0);
            bar.set_position((LENGTH * (before + share * fraction.clamp(0.0, 1.0))) as u64);
        }
    }
}
