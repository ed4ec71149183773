//! Outliers by the Hampel identifier.
//!
//! ```text
//! m(t) = median of x(t - k .. t + k),   s(t) = 1.4826 median |x(t - k .. t + k) - m(t)|
//! x(t) is an outlier when |x(t) - m(t)| > n_sigma max(s(t), least)
//! ```
//!
//! 1.4826 makes s the standard deviation of a normal distribution. Where more than half of a window is one value, s is
//! zero; `least` then keeps single steps of the quantisation from being outliers: it defaults to the smallest
//! change between successive samples of the channel. (R. K. Pearson, IEEE Trans. Control Syst. Technol. 10 (2002)
//! 55-63.)

use dynocal_numerics::registry::{self, Member, MemberDoc, ParamDoc};
use serde::Deserialize;

use super::action::{ACTION, Action, LEAST, Outliers, act, least};
use super::common::{chosen, key_fault, positive};
use super::{Outcome, PrepareError, Step};
use crate::data::{Dataset, Role};

const NAME: &str = "hampel";

pub(super) const MEMBER: Member<dyn Step> = Member {
    doc: MemberDoc {
        name: NAME,
        what: "outliers against the median of a moving window",
        params: &[
            ParamDoc {
                name: "half_width",
                unit: "samples",
                default: "5",
                what: "samples on either side in the window",
            },
            ParamDoc {
                name: "n_sigma",
                unit: "-",
                default: "3",
                what: "distance from the median in robust standard deviations",
            },
            ParamDoc {
                name: "least",
                unit: "channel",
                default: "smallest change",
                what: "the standard deviation counts as no smaller than this",
            },
            ACTION,
            ParamDoc { name: "channels", unit: "-", default: "outputs", what: "channels that are looked at" },
            LEAST,
        ],
    },
    build: |keys| {
        let step: Hampel = registry::keys(NAME, keys)?;
        positive(NAME, "n_sigma", step.n_sigma)?;
        if step.half_width == 0 {
            return Err(key_fault(NAME, "found half_width = 0, expected 1 or more samples".into()));
        }
        if let Some(least) = step.least.filter(|v| !(*v >= 0.0 && v.is_finite())) {
            return Err(key_fault(
                NAME,
                format!("found least = {least}, expected zero or a positive number"),
            ));
        }
        Ok(Box::new(step))
    },
};

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Hampel {
    #[serde(default = "five")]
    half_width: usize,
    #[serde(default = "three")]
    n_sigma: f64,
    least: Option<f64>,
    #[serde(default)]
    action: Action,
    channels: Option<Vec<String>>,
    #[serde(default = "least")]
    least_samples: usize,
}

fn five() -> usize {
    5
}

fn three() -> f64 {
    3.0
}

impl Step for Hampel {
    fn apply(&self, records: Vec<Dataset>) -> Result<Outcome, PrepareError> {
        let mut outcome = Outcome::default();
        for record in records {
            let channels = chosen(&record, self.channels.as_deref(), &[Role::Output])?;
            let found: Vec<Outliers> =
                channels.iter().map(|c| self.outliers(*c, &record.channels[*c].values)).collect();
            self.warn(&record, &found, &mut outcome);
            act(self.action, record, &found, self.least_samples, &mut outcome);
        }
        Ok(outcome)
    }
}

impl Hampel {
    fn outliers(&self, channel: usize, x: &[f64]) -> Outliers {
        let least = self.least.unwrap_or_else(|| smallest_change(x));
        let mut window = Window::default();
        let mut found = Outliers { channel, rows: Vec::new(), expected: Vec::new() };
        let k = self.half_width;
        x[..k.min(x.len())].iter().for_each(|v| window.insert(*v));
        for t in 0..x.len() {
            if let Some(v) = x.get(t + k) {
                window.insert(*v);
            }
            if t > k {
                window.remove(x[t - k - 1]);
            }
            if x[t].is_nan() {
                continue;
            }
            let (median, sigma) = window.median_and_sigma();
            if (x[t] - median).abs() > self.n_sigma * sigma.max(least) {
                found.rows.push(t);
                found.expected.push(median);
            }
        }
        found
    }

    /// An honest outlier is rare: many of them mean that the window is no match for the signal.
    fn warn(&self, record: &Dataset, found: &[Outliers], outcome: &mut Outcome) {
        for f in found.iter().filter(|f| 20 * f.rows.len() > record.len()) {
            outcome.remarks.push(format!(
                "{}, {}: {:.1} % of the samples count as outliers; the window of {} samples may be too long for how \
                 fast the channel moves, or n_sigma = {} too small",
                record.name,
                record.channels[f.channel].name,
                100.0 * f.rows.len() as f64 / record.len() as f64,
                2 * self.half_width + 1,
                self.n_sigma
            ));
        }
    }
}

fn smallest_change(x: &[f64]) -> f64 {
    let changes = x.windows(2).map(|w| (w[1] - w[0]).abs()).filter(|d| *d > 0.0);
    let least = changes.fold(f64::INFINITY, f64::min);
    if least.is_finite() { least } else { 0.0 }
}

/// The known samples of the window in rising order.
#[derive(Default)]
struct Window(Vec<f64>);

impl Window {
    fn insert(&mut self, v: f64) {
        if !v.is_nan() {
            self.0.insert(self.0.partition_point(|w| *w < v), v);
        }
    }

    fn remove(&mut self, v: f64) {
        if !v.is_nan() {
            self.0.remove(self.0.partition_point(|w| *w < v));
        }
    }

    /// Median and 1.4826 times the median distance from it; the window holds a sample at least.
    fn median_and_sigma(&self) -> (f64, f64) {
        let w = &self.0;
        let n = w.len();
        let median = 0.5 * (w[(n - 1) / 2] + w[n / 2]);
        // The distances rise from the median outwards on either side: merging the two sides sorts them.
        let (mut below, mut above) = (w.partition_point(|v| *v < median), w.partition_point(|v| *v < median));
        let (mut last, mut before) = (0.0, 0.0);
        for _ in 0..=n / 2 {
            let down = if below > 0 { median - w[below - 1] } else { f64::INFINITY };
            let up = if above < n { w[above] - median } else { f64::INFINITY };
            before = last;
            last = down.min(up);
            if down <= up { below -= 1 } else { above += 1 }
        }
        (median, 1.4826 * if n % 2 == 1 { last } else { 0.5 * (before + last) })
    }
}

#[cfg(test)]
mod tests {
    use super::Window;

    /// Median absolute deviation of 1, 1, 2, 2, 4, 6, 9 about their median 2 is 1; of 1, 2, 3, 4 about 2.5 it is 1.
    #[test]
    fn the_textbook_deviation() {
        for (values, median) in
            [(vec![9.0, 1.0, 2.0, f64::NAN, 6.0, 1.0, 2.0, 4.0], 2.0), (vec![3.0, 1.0, 4.0, 2.0], 2.5)]
        {
            let mut w = Window::default();
            values.iter().for_each(|v| w.insert(*v));
            assert_eq!(w.median_and_sigma(), (median, 1.4826));
        }
    }
}
