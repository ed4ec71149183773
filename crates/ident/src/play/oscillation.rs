//! Whether a loop oscillates in a record.
//!
//! In every stretch of constant demand, its first quarter left to settle, the error e = d - y without mean and trend has the
//! autocorrelation r(k) and the periodogram p(f). A loop in a limit cycle (or so poorly damped that noise keeps it going) shows
//! this:
//!
//! ```text
//! sustained  rms of e in the last third >= half of that in the first
//! its own    the input moves with it: |corr(e, u)| >= 0.5 at some lag within a period
//!
//! and, as a steady wave,
//! regular    (1/3) mean(T) / sd(T) > 1 over the intervals T between zero crossings of r     regularity
//!            r(P) >= 0.5 one period P later
//! visible    amplitude sqrt(2) sd(e) >= 2 % of the demand
//!
//! or, as a swing of changing size,
//! narrow     sum of p from f/1.6 to 1.6 f >= 0.7 of all, at least six periods 1/f
//! large      amplitude >= 10 % of the demand
//! ```
//!
//! Where the demand keeps changing, the whole record is looked at for a swing whose period is shorter than 0.7 of the time
//! between two changes: what is slower the demand may have made.
//!
//! Noise: a band that holds the share w of all m frequencies has of white noise the share w +- sqrt(w (1 - w)/m) of the power, so
//! that a swing has to have five of these deviations more than w; the error of a second-order loop with a damping of 0.3 has
//! about 0.65.
//!
//! N. F. Thornhill, B. Huang, H. Zhang, J. Process Control 13 (2003) 91-100, for the zero crossings of the autocorrelation:
//! they stay regular where noise spoils those of the signal.

use serde::{Deserialize, Serialize};

use dynocal_numerics::fft::RealDft;

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
    /// Autocorrelation one period later: 1 for a pure wave.
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
/// Least autocorrelation of a wave one period later.
const SUSTAINED: f64 = 0.5;
/// Least correlation with the input.
const TOGETHER: f64 = 0.5;
/// Least amplitude of a wave as a share of the demand: what is below is ripple.
const VISIBLE: f64 = 0.02;

/// Least amplitude of a swing as a share of the demand, least share of its power in the band, half width of the band as a factor,
/// and least periods.
const LARGE: f64 = 0.1;
const NARROW: f64 = 0.7;
const BAND: f64 = 1.6;
const PERIODS: usize = 6;
/// Standard deviations by which a share has to exceed that of white noise.
const BY_CHANCE: f64 = 5.0;
/// Longest period of a swing, as a share of the time between two changes of the demand.
const FASTER: f64 = 0.7;

/// The largest oscillation of a closed loop in a record with the demand of its output; none where it is quiet, or where nothing is
/// long enough to tell (four periods of a wave, six of a swing).
///
/// # Errors
/// [`DataError::NoChannel`] when the record lacks the output, its demand or the input.
pub fn oscillation(record: &Dataset, closed: &PlanLoop) -> Result<Option<Oscillation>, DataError> {
    let demand = record.values(&demand_name(&closed.output))?;
    let (y, u) = (record.values(&closed.output)?, record.values(&closed.input)?);
    // A stretch is where the demand is that of the sample before.
    let stretches = runs(demand.len(), |t| t > 0 && demand[t] == demand[t - 1]);
    let mut lengths: Vec<usize> = stretches.iter().map(|s| s.samples()).collect();
    lengths.sort_unstable();
    let middle = lengths.get(lengths.len() / 2).map_or(0.0, |n| (n + 1) as f64);
    let looks = stretches
        .iter()
        .map(|s| Look { from: s.from + s.samples() / 4, to: s.to, waves: true, longest: f64::INFINITY })
        .chain((stretches.len() > 1).then(|| Look {
            from: stretches[0].samples() / 4,
            to: demand.len(),
            waves: false,
            longest: FASTER * middle,
        }));
    let mut largest: Option<Oscillation> = None;
    for look in looks.filter(|l| l.to >= l.from + SHORTEST) {
        let place = look.from..look.to;
        let error: Vec<f64> = place.clone().map(|t| demand[t] - y[t]).collect();
        let size = demand[place.clone()].iter().map(|d| d.abs()).sum::<f64>() / place.len() as f64;
        let (e, u) = (detrended(&error), detrended(&u[place]));
        let wave = if look.waves { regular(&e, &u) } else { None };
        let wave = wave.filter(|w| w.amplitude >= VISIBLE * size);
        let found = wave.or_else(|| swing(&e, &u, look.longest).filter(|s| s.amplitude >= LARGE * size));
        let Some(found) = found.filter(|f| f.amplitude > 0.0) else { continue };
        if largest.as_ref().is_none_or(|l| l.amplitude < found.amplitude) {
            let dt = record.sample_time_s;
            largest = Some(Oscillation {
                output: closed.output.clone(),
                input: closed.input.clone(),
                from_s: look.from as f64 * dt,
                to_s: look.to as f64 * dt,
                period_s: found.period * dt,
                amplitude: found.amplitude,
                input_amplitude: found.input_amplitude,
                sustained: found.sustained,
            });
        }
    }
    Ok(largest)
}

/// A part of a record that is looked at.
struct Look {
    from: usize,
    to: usize,
    /// Whether for waves as well as for swings.
    waves: bool,
    /// Longest period in samples.
    longest: f64,
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
    let holds = mean > 3.0 * spread && sustained >= SUSTAINED && goes_on(e, u, one);
    holds.then(|| Regular {
        period,
        amplitude: (2.0 * power).sqrt(),
        input_amplitude: (2.0 * input_power).sqrt(),
        sustained: sustained.min(1.0),
    })
}

/// Whether e does not decay, and moves with u within `one` samples.
fn goes_on(e: &[f64], u: &[f64], one: usize) -> bool {
    let n = e.len();
    let thirds = (mean_square(&e[..n / 3]), mean_square(&e[n - n / 3..]));
    let together = |k: usize| (covariance(e, u, k).abs()).max(covariance(u, e, k).abs());
    let scale = (mean_square(e) * mean_square(u)).sqrt();
    let with_input = (0..=one.min(n / 2)).map(together).fold(0.0, f64::max) / scale;
    thirds.1 >= 0.25 * thirds.0 && with_input >= TOGETHER
}

/// Most of the power in a narrow band about a period of at most `longest` samples.
fn swing(e: &[f64], u: &[f64], longest: f64) -> Option<Regular> {
    let n = e.len();
    let power: Vec<f64> = RealDft::new(n).transform(e).iter().map(|c| c.norm_sqr()).collect();
    let mut sums = vec![0.0; power.len()];
    (1..power.len()).for_each(|k| sums[k] = sums[k - 1] + power[k]);
    let total = *sums.last()?;
    let last = power.len() - 1;
    let band = |k: usize| ((k as f64 / BAND).ceil() as usize, ((k as f64 * BAND) as usize).min(last));
    let share = |k: usize| {
        let (low, high) = band(k);
        (sums[high] - sums[low - 1]) / total
    };
    // Least share that white noise of this length does not have by chance.
    let least = |k: usize| {
        let (low, high) = band(k);
        let w = (high + 1 - low) as f64 / last as f64;
        (w + BY_CHANCE * (w * (1.0 - w) / last as f64).sqrt()).max(NARROW)
    };
    let slowest = PERIODS.max((n as f64 / longest).ceil() as usize);
    let best =
        (slowest..=last).filter(|k| share(*k) >= least(*k)).max_by(|a, b| share(*a).total_cmp(&share(*b)))?;
    let period = n as f64 / best as f64;
    let one = period.round() as usize;
    if !(total > 0.0 && goes_on(e, u, one)) {
        return None;
    }
    Some(Regular {
        period,
        amplitude: (2.0 * mean_square(e)).sqrt(),
        input_amplitude: (2.0 * mean_square(u)).sqrt(),
        sustained: covariance(e, e, one.min(n - 1)) / mean_square(e),
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
