//! What was measured along the lines of a map, and on which way.
//!
//! The lag of a way is none at rest, and comes with a time constant of its own ([`Way::developed`]):
//!
//! ```text
//! tau s' = u - s     u: 1 up, -1 down, 0 where it rests     s = 0 before the two ways that went before this one
//! ```

/// When a window of a line was measured on its way: there from rest, or back.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Way {
    /// 1: up the axis that was gone along; -1: down; 0: it rested.
    pub up: f64,
    /// Time from the begin of the way to that of the window in s.
    pub since_s: f64,
    /// What was before, oldest first: ways, as `up`, and how long each was gone in s; nothing is a rest.
    pub before: [(f64, f64); 2],
    /// Length of the window in s.
    pub window_s: f64,
}

impl Way {
    /// How far the lag has come in the mean of the window, with the time constant `tau_s`: from 0 at rest to 1 up and -1 down.
    pub fn developed(&self, tau_s: f64) -> f64 {
        if tau_s <= 0.0 {
            return self.up;
        }
        let gone = |t: f64| (-t / tau_s).exp();
        let begun = self.before.iter().fold(0.0, |s, (up, t)| up + (s - up) * gone(*t));
        let left = if self.window_s > 0.0 {
            tau_s / self.window_s * (gone(self.since_s) - gone(self.since_s + self.window_s))
        } else {
            gone(self.since_s)
        };
        self.up + (begun - self.up) * left
    }
}

/// What was measured along lines: an entry each.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Along {
    /// Places over the axes.
    pub at: Vec<Vec<f64>>,
    /// On which ways.
    pub way: Vec<Way>,
    /// Measured less expected.
    pub r: Vec<f64>,
    /// Weights.
    pub weight: Vec<f64>,
}

impl Along {
    /// One more measurement.
    pub fn push(&mut self, at: Vec<f64>, way: Way, r: f64, weight: f64) {
        self.at.push(at);
        self.way.push(way);
        self.r.push(r);
        self.weight.push(weight);
    }
}
