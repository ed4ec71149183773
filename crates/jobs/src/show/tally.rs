//! Numbers about channels while their values pass.
//!
//! A trace is thinned to stretches of `stride` rows: the least and the greatest value of each, so that no peak is lost.

use dynocal_files::table::Cells;

use super::{ChannelSummary, Extremes};

/// States that are named.
const MOST_STATES: usize = 8;

/// Stamps while they pass, in the unit of the file.
#[derive(Default)]
pub(super) struct Clock {
    stride: u64,
    pub(super) rows: u64,
    last: f64,
    /// Sum and number of the intervals by which stamps go forward.
    pub(super) forward: f64,
    pub(super) steps: u64,
    pub(super) least: f64,
    pub(super) greatest: f64,
    pub(super) longest: f64,
    /// Stamps that are not after the one before, or no numbers.
    pub(super) backward: u64,
    /// First stamp of every stretch.
    pub(super) trace: Vec<f64>,
}

impl Clock {
    pub(super) fn new(stride: u64) -> Self {
        Self { stride, ..Self::default() }
    }

    pub(super) fn take(&mut self, stamps: &[f64]) {
        for t in stamps {
            if self.rows == 0 {
                (self.least, self.greatest) = (*t, *t);
            } else {
                let interval = t - self.last;
                if interval > 0.0 {
                    self.forward += interval;
                    self.steps += 1;
                    self.longest = self.longest.max(interval);
                } else {
                    self.backward += 1;
                }
            }
            if self.rows.is_multiple_of(self.stride) {
                self.trace.push(*t);
            }
            (self.least, self.greatest) = (self.least.min(*t), self.greatest.max(*t));
            self.last = *t;
            self.rows += 1;
        }
    }
}

/// Values of one channel while they pass.
#[derive(Default)]
pub(super) struct Tally {
    stride: u64,
    rows: u64,
    gaps: u64,
    numbers: u64,
    range: Option<(f64, f64)>,
    /// Sum of the differences from the first number: exact for a channel far from zero.
    sum: f64,
    origin: f64,
    words: u64,
    states: Vec<String>,
    trace: Vec<Extremes>,
}

impl Tally {
    pub(super) fn new(stride: u64) -> Self {
        Self { stride, ..Self::default() }
    }

    pub(super) fn take(&mut self, cells: &Cells) {
        match cells {
            Cells::Number(v) => v.iter().for_each(|x| self.number(*x)),
            Cells::Text(v) => v.iter().for_each(|x| self.state(x)),
        }
    }

    fn number(&mut self, x: f64) {
        if self.rows.is_multiple_of(self.stride) {
            self.trace.push(Extremes { min: f64::NAN, max: f64::NAN });
        }
        self.rows += 1;
        if x.is_nan() {
            self.gaps += 1;
            return;
        }
        if self.numbers == 0 {
            self.origin = x;
        }
        self.numbers += 1;
        self.sum += x - self.origin;
        self.range = Some(self.range.map_or((x, x), |(low, high)| (low.min(x), high.max(x))));
        if let Some(stretch) = self.trace.last_mut() {
            // The lesser of NaN and a number is the number.
            *stretch = Extremes { min: stretch.min.min(x), max: stretch.max.max(x) };
        }
    }

    fn state(&mut self, x: &str) {
        // A file with decimal commas keeps them in a column that holds words as well.
        if let Ok(number) = x.trim().replacen(',', ".", 1).parse() {
            return self.number(number);
        }
        self.number(f64::NAN);
        if x.is_empty() {
            return;
        }
        self.gaps -= 1;
        self.words += 1;
        if !x.is_empty() && self.states.len() < MOST_STATES && !self.states.iter().any(|s| s == x) {
            self.states.push(x.into());
        }
    }

    pub(super) fn summary(self, name: &str, unit: Option<&str>) -> ChannelSummary {
        let mean = self.origin + self.sum / self.numbers as f64;
        // Mostly numbers: the words among them are faults; mostly words: the numbers are states.
        let numbers = self.words == 0 || self.numbers > self.words;
        let (states, words) = match self.states.first() {
            Some(first) if numbers => (Vec::new(), Some((self.words, first.clone()))),
            _ => (self.states, None),
        };
        let (range, trace) = if numbers { (self.range, self.trace) } else { (None, Vec::new()) };
        ChannelSummary {
            name: name.into(),
            unit: unit.unwrap_or("").into(),
            rows: self.rows,
            gaps: self.gaps,
            min: range.map(|r| r.0),
            max: range.map(|r| r.1),
            // An infinite value has no mean.
            mean: Some(mean).filter(|m| numbers && m.is_finite()),
            states,
            words,
            trace,
        }
    }
}
