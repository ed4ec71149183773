//! Crank angle of a record over time.
//!
//! ```text
//! phi(t) = 6 integral of n dt  [deg], n in rpm on the line between its samples      (speed channel)
//! phi on the line between its samples, unwrapped                                     (angle channel)
//! ```

use super::PrepareError;
use super::common::{chosen, complete, fault, stamps};
use crate::data::Dataset;

/// Where the angle comes from.
#[derive(Clone, Debug)]
pub(super) enum Source {
    /// Channel with the speed in rpm.
    Speed(String),
    /// Channel with the angle in deg that falls back to zero after so many degrees.
    Angle(String, f64),
}

/// Angle at the samples, with the rate at the two ends of every interval (deg/s).
pub(super) struct Crank {
    pub(super) t: Vec<f64>,
    pub(super) phi: Vec<f64>,
    rates: Vec<(f64, f64)>,
    /// Channel with the stamps, if the record has one.
    pub(super) time: Option<usize>,
}

impl Crank {
    pub(super) fn new(
        step: &'static str,
        record: &Dataset,
        source: &Source,
        time: Option<&str>,
    ) -> Result<Self, PrepareError> {
        let (t, time) = stamps(step, record, time)?;
        let (Source::Speed(name) | Source::Angle(name, _)) = source;
        let c = chosen(record, Some(std::slice::from_ref(name)), &[])?[0];
        let values = complete(step, record, c)?;
        let wanted = if matches!(source, Source::Speed(_)) { "rpm" } else { "deg" };
        if record.channels[c].unit != wanted {
            let message = format!("`{name}` is in `{}`, expected {wanted}", record.channels[c].unit);
            return Err(fault(step, record, message));
        }
        let mut phi = Vec::with_capacity(t.len());
        let mut rates = Vec::with_capacity(t.len());
        match source {
            Source::Speed(_) => {
                if let Some(k) = values.iter().position(|n| *n <= 0.0) {
                    let message = format!("`{name}` is {} rpm at sample {k}: the crank must turn", values[k]);
                    return Err(fault(step, record, message));
                }
                let mut angle = 0.0;
                phi.push(angle);
                for k in 1..t.len() {
                    rates.push((6.0 * values[k - 1], 6.0 * values[k]));
                    angle += 3.0 * (values[k - 1] + values[k]) * (t[k] - t[k - 1]);
                    phi.push(angle);
                }
            }
            Source::Angle(_, wrap) => {
                let mut turns = 0.0;
                for k in 0..t.len() {
                    if k > 0 && values[k] < values[k - 1] {
                        turns += 1.0;
                    }
                    phi.push(values[k] + turns * wrap);
                    if k > 0 {
                        let rate = (phi[k] - phi[k - 1]) / (t[k] - t[k - 1]);
                        if rate <= 0.0 {
                            let message = format!(
                                "`{name}` goes from {} to {} deg at sample {k}: expected it to rise, and to fall back \
                                 after {wrap} deg",
                                values[k - 1],
                                values[k]
                            );
                            return Err(fault(step, record, message));
                        }
                        rates.push((rate, rate));
                    }
                }
            }
        }
        Ok(Self { t, phi, rates, time })
    }

    /// Angle at `t` within interval `i`.
    pub(super) fn angle(&self, i: usize, t: f64) -> f64 {
        let Some((a, b)) = self.rates.get(i) else { return self.phi[i] };
        let (s, h) = (t - self.t[i], self.t[i + 1] - self.t[i]);
        self.phi[i] + s * (a + 0.5 * (b - a) * s / h)
    }

    /// Rate of the angle at `t` within interval `i`, in deg/s.
    pub(super) fn rate(&self, i: usize, t: f64) -> f64 {
        let (a, b) = self.rates[i];
        a + (b - a) * (t - self.t[i]) / (self.t[i + 1] - self.t[i])
    }

    /// Time at which the angle is `phi`, in or after interval `from`, with its interval; none after the end.
    pub(super) fn time_of(&self, phi: f64, from: usize) -> Option<(f64, usize)> {
        let mut i = from;
        while self.phi.get(i + 1).is_some_and(|next| *next < phi) {
            i += 1;
        }
        let (a, b) = *self.rates.get(i)?;
        let h = self.t[i + 1] - self.t[i];
        // a s + (b - a) s^2 / (2 h) = d, in the form that does not cancel for b near a.
        let d = (phi - self.phi[i]).max(0.0);
        let s = 2.0 * d / (a + (a * a + 2.0 * (b - a) / h * d).max(0.0).sqrt());
        // An instant that misses a sample by rounding only is on it.
        let s = if s < SLACK * h { 0.0 } else { s };
        Some(if s > (1.0 - SLACK) * h { (self.t[i + 1], i) } else { (self.t[i] + s, i) })
    }
}

const SLACK: f64 = 1e-8;
