//! What the air ahead was foreseen to be, and what it became.
//!
//! The trim compares the fuel with the charge of the pressure that was there, the fuel itself was given for a pressure ahead. A throttle that
//! is not quite the identified one leads that astray at rest, and no trim by the first sees it:
//!
//! ```text
//! db/dt = s asinh((e - b) / s) / T,   e = ln c(N, p)(t) - ln c(N, p ahead)(t - ahead)
//! ```
//!
//! with T and s of the trim; the charge ahead is multiplied by exp(b).

use super::trim::Trim;
use std::collections::VecDeque;

/// Longest way ahead that is followed, in s.
const LONGEST_S: f64 = 1.0;

/// Logarithms of the charges that were foreseen, newest first, and what they lacked.
#[derive(Clone, Debug)]
pub(super) struct Foresight {
    past: VecDeque<f64>,
    longest: usize,
    lacked: f64,
}

impl Foresight {
    pub(super) fn new(dt_s: f64) -> Self {
        let longest = (LONGEST_S / dt_s).ceil() as usize + 2;
        Self { past: VecDeque::with_capacity(longest), longest, lacked: 0.0 }
    }

    /// What the charge of now is compared with what was foreseen of it `ahead_s` ago; the factor of what is foreseen next.
    pub(super) fn compared(&mut self, trim: &Trim, charge_now: f64, ahead_s: f64, dt_s: f64) -> f64 {
        let age = (ahead_s / dt_s - 1.0).max(0.0);
        let (whole, part) = (age as usize, age.fract());
        if let (Some(a), Some(b)) = (self.past.get(whole), self.past.get(whole + 1)) {
            let foreseen = (1.0 - part) * a + part * b;
            let error = charge_now.max(f64::MIN_POSITIVE).ln() - foreseen;
            if error.is_finite() {
                self.lacked = trim.follow(self.lacked, error, dt_s);
            }
        }
        self.lacked.exp()
    }

    /// Keeps what is foreseen now.
    pub(super) fn foreseen(&mut self, charge: f64) {
        self.past.truncate(self.longest - 1);
        self.past.push_front(charge.max(f64::MIN_POSITIVE).ln());
    }
}
