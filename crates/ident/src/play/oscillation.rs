//! Whether a loop oscillates in a record.
//!
//! In every stretch of constant demand, its first quarter left to settle, the error e = d - y without mean and trend has the
//! autocorrelation r(k). A loop in a limit cycle (or so poorly damped that noise keeps it going) shows all of these:
//!
//! ```text
//! regular    (1/3) mean(T) / sd(T) > 1 over the intervals T between zero crossings of r     regularity
//! sustained  r(P) >= 0.5 one period P later, and rms of e in the last third >= half of that in the first
//! its own    the input moves with it: |corr(e, u)| >= 0.5 at some lag within a period
//! visible    amplitude sqrt(2) sd(e) >= 2 % of the demand
//! ```
//!
//! N. F. Thornhill, B. Huang, H. Zhang, J. Process Control 13 (2003) 91-100, for the zero crossings of the autocorrelation:
//! they stay regular where noise spoils those of the signal.

use serde::{Deserialize, Serialize};

use crate::data::{DataError, Dataset, runs};
use crate::plan::{PlanLoop, demand_name};

/// An oscillation that was recognised.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Oscillation {
    /// Output.
    pub output: String,
    /// Input that the loop drives.
    pub input: String,
    /// Where the stretch begins, in s from the start of the record.
    pub from_s: f64,
    /// Where it ends.
    pub to_s: f64,
    /// Period in s.
    pub period_s: f64,
    /// Amplitude of the output, in its unit.
    pub amplitude: f64,
    /// Amplitude of the input, in its unit.
    pub input_amplitude: f64,
    /// Autocorrelation one period later: 1 for a pure oscillation.
    pub sustained: f64,
}

impl std::fmt::Display for Oscillation {
    fn fmt(&self, f: &mut std::fmt::Formatter) -> std::fmt::Result {
        write!(
            f,
            "the loop that holds `{}` by `{}` oscillates from {:.1} s to {:.1} s with a period of {:.2} s and an amplitude of {:.3}: its gains are too large for this plant",
            self.output, self.input, self.from_s, self.to_s, self.period_s, self.amplitude
        )
    }
}

/// Least samples of a stretch.
const SHORTEST: usize = 40;
/// Least autocorrelation one period later, and least correlation with the input.
const SUSTAINED: f64 = 0.5;
/// Least amplitude as a share of the demand: what is below is ripple.
const VISIBLE: f64 = 0.02;

/// The largest oscillation of a closed loop in a record with the demand of its output; none where it is quiet, or where no
/// stretch of constant demand is long enough to tell (four periods).
///
/// # Errors
/// [`DataError::NoChannel`] when the record lacks the output, its demand or the input.
pub fn oscillation(record: &Dataset, closed: &PlanLoop) -> Result<Option<Oscillation>, DataError> {
    let demand = record.values(&demand_name(&closed.output))?;
    let (y, u) = (record.values(&closed.output)?, record.values(&closed.input)?);
    let dt = record.sample_time_s;
    let mut largest: Option<Oscillation> = None;
    // A stretch is where the demand is that of the sample before.
    for stretch in runs(demand.len(), |t| t > 0 && demand[t] == demand[t - 1]) {
        let from = stretch.from + stretch.samples() / 4;
        if stretch.to - from < SHORTEST {
            continue;
        }
        let error: Vec<f64> = (from..stretch.to).map(|t| demand[t] - y[t]).collect();
        let Some(found) = regular(&detrended(&error), &detrended(&u[from..stretch.to])) else { continue };
        let visible = found.amplitude >= VISIBLE * demand[from].abs() && found.amplitude > 0.0;
        if visible && largest.as_ref().is_none_or(|l| l.amplitude < found.amplitude) {
            largest = Some(Oscillation {
                output: closed.output.clone(),
                input: closed.input.clone(),
                from_s: from as f64 * dt,
                to_s: stretch.to as f64 * dt,
                period_s: found.period * dt,
                amplitude: found.amplitude,
                input_amplitude: found.input_amplitude,
                sustained: found.sustained,
            });
        }
    }
    Ok(largest)
}

struct Regular {
    /// Period in samples.
    period: f64,
    amplitude: f64,
    input_amplitude: f64,
    sustained: f64,
}

fn regular(e: &[f64], u: &[f64]) -> Option<Regular> {
    let n = e.len();
    let power = mean_square(e);
    let input_power = mean_square(u);
    if !(power > 0.0 && input_power > 0.0) {
        return None;
    }
    // Unbiased, so that the end of the record does not look like decay.
    let r = |k: usize| covariance(e, e, k) / power;
    let curve: Vec<f64> = (0..=n / 2).map(r).collect();
    let crossings: Vec<f64> = (1..curve.len())
        .filter(|k| (curve[k - 1] > 0.0) != (curve[*k] > 0.0))
        .map(|k| (k - 1) as f64 + curve[k - 1] / (curve[k - 1] - curve[k]))
        .collect();
    let halves: Vec<f64> = crossings.windows(2).map(|w| w[1] - w[0]).collect();
    if halves.len() < 3 {
        return None;
    }
    let mean = halves.iter().sum::<f64>() / halves.len() as f64;
    let spread = mean_square(&halves.iter().map(|h| h - mean).collect::<Vec<_>>()).sqrt();
    let period = 2.0 * mean;
    let one = period.round() as usize;
    // Neighbours, because a period is no whole number of samples.
    let sustained =
        (one.saturating_sub(1)..=one + 1).filter_map(|k| curve.get(k)).fold(-1.0, |a: f64, b| a.max(*b));
    let thirds = (mean_square(&e[..n / 3]), mean_square(&e[n - n / 3..]));
    let lasts = thirds.1 >= 0.25 * thirds.0;
    let together = |k: usize| (covariance(e, u, k).abs()).max(covariance(u, e, k).abs());
    let with_input = (0..=one.min(n / 2)).map(together).fold(0.0, f64::max) / (power * input_power).sqrt();
    let holds = mean > 3.0 * spread && sustained >= SUSTAINED && lasts && with_input >= SUSTAINED;
    holds.then(|| Regular {
        period,
        amplitude: (2.0 * power).sqrt(),
        input_amplitude: (2.0 * input_power).sqrt(),
        sustained: sustained.min(1.0),
    })
}

fn mean_square(x: &[f64]) -> f64 {
    x.iter().map(|v| v * v).sum::<f64>() / x.len().max(1) as f64
}

/// Mean of a(t) b(t + k).
fn covariance(a: &[f64], b: &[f64], k: usize) -> f64 {
    let pairs = a.iter().zip(b.iter().skip(k));
    pairs.map(|(a, b)| a * b).sum::<f64>() / (a.len() - k).max(1) as f64
}

/// Without mean and linear trend.
fn detrended(x: &[f64]) -> Vec<f64> {
    let n = x.len() as f64;
    let middle = 0.5 * (n - 1.0);
    let mean = x.iter().sum::<f64>() / n;
    let (mut sxy, mut sxx) = (0.0, 0.0);
    for (t, v) in x.iter().enumerate() {
        sxy += (t as f64 - middle) * (v - mean);
        sxx += (t as f64 - middle).powi(2);
    }
    let slope = sxy / sxx;
    x.iter().enumerate().map(|(t, v)| v - mean - slope * (t as f64 - middle)).collect()
}
