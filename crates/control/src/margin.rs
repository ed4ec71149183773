//! Gain, phase and delay margin, largest sensitivity and complementary sensitivity of each loop with the others closed.
//!
//! ```text
//! l_k = 1 / [(I + G C)^-1]_kk - 1        loop k broken at its output, the others closed (at its input: C G)
//! gain margins:  |1 / l| where l is real and negative;   phase margin: distance of arg l from -180 deg where |l| = 1
//! delay margin:  least (arg l + pi) / w over |l| = 1, arg taken in (-pi, pi]
//! Ms = max |1 / (1 + l)|,   Mt = max |l / (1 + l)|
//! ```
//!
//! Crossings are found between frequencies of the grid and refined to rounding; peaks by golden section.

use std::f64::consts::PI;

use serde::{Deserialize, Serialize};

use crate::closed::{Closed, Responses, one_of};
use crate::error::ControlError;
use crate::matrix::{C, ONE};
use crate::system::Time;

/// Halvings of an interval that holds a crossing.
const HALVINGS: usize = 60;
/// Steps of golden section.
const GOLDEN: usize = 42;

/// Where a loop is broken.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Side {
    /// At the inputs of the plant.
    Inputs,
    /// At its outputs.
    Outputs,
}

/// Margins of one loop.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Margins {
    /// Factor by which the gain may grow; none: any.
    pub gain_up: Option<f64>,
    /// Frequency at which it is lost, rad/s. None where it is infinite: no run can show that one.
    pub gain_up_rad_s: Option<f64>,
    /// Factor below 1 to which the gain may fall; none: any.
    pub gain_down: Option<f64>,
    /// Frequency at which it is lost, rad/s; none as for the other.
    #[serde(default)]
    pub gain_down_rad_s: Option<f64>,
    /// Phase in deg that may be lost or won; none: the loop gain is never 1.
    pub phase_deg: Option<f64>,
    /// Frequency at which the phase margin is, rad/s.
    pub phase_rad_s: Option<f64>,
    /// Delay in s that may be added; none: any.
    pub delay_s: Option<f64>,
    /// Frequency at which the delay margin is, rad/s.
    #[serde(default)]
    pub delay_rad_s: Option<f64>,
    /// Ms, largest |1 / (1 + l)|.
    pub sensitivity: f64,
    /// Its frequency, rad/s.
    pub sensitivity_rad_s: f64,
    /// Mt, largest |l / (1 + l)|.
    pub complementary: f64,
}

/// Margins of loop `k` of a stable closed loop.
///
/// # Errors
/// [`ControlError::Singular`]; [`ControlError::Unstable`] for a loop that is not stable.
pub fn margins(closed: &Closed, side: Side, k: usize) -> Result<Margins, ControlError> {
    let state = closed.unstable();
    if !state.is_stable() {
        return Err(ControlError::Unstable { what: "the closed loop".into(), poles: state.words() });
    }
    let open = |r: &Responses| match side {
        Side::Outputs => one_of(r.at_outputs.at(k, k)),
        Side::Inputs => one_of(r.at_inputs.at(k, k)),
    };
    let values: Vec<C> = closed.responses()?.iter().map(open).collect();
    let at = |w: f64| closed.at(w).map_or(C::new(f64::NAN, f64::NAN), |r| open(&r));
    let mut found = of_response(&closed.grid, &values, &at, closed.plant.time.nyquist_rad_s());
    if let Time::Sampled { sample_time_s } = closed.plant.time {
        found.at_half_sampling(sample_time_s, at(PI / sample_time_s));
    }
    if let (Time::Continuous, Some(last)) = (closed.plant.time, closed.grid.last()) {
        found.at_high(*last, closed.plant.delay_s() + closed.controller.delay_s() > 0.0, &at);
    }
    Ok(found)
}

/// Margins from a response on a grid; `at` gives it between. At half the sampling frequency and at rest a response is real
/// without crossing: both ends of the grid count as crossings there.
pub fn of_response(grid: &[f64], values: &[C], at: &dyn Fn(f64) -> C, nyquist_rad_s: Option<f64>) -> Margins {
    let mut found = Margins {
        gain_up: None,
        gain_up_rad_s: None,
        gain_down: None,
        gain_down_rad_s: None,
        phase_deg: None,
        phase_rad_s: None,
        delay_s: None,
        delay_rad_s: None,
        sensitivity: 0.0,
        sensitivity_rad_s: 0.0,
        complementary: 0.0,
    };
    let n = grid.len();
    for k in 1..n {
        let (a, b) = (values[k - 1], values[k]);
        // What is well within the circle of the crossing that is known can be no nearer to -1: long delays have thousands of them.
        let within = found.gain_up.is_some_and(|g| 1.2 * a.norm().max(b.norm()) * g < 1.0);
        if (a.im > 0.0) != (b.im > 0.0) && a.re.min(b.re) < 0.0 && !within {
            let w = bisect(grid[k - 1], grid[k], |w| at(w).im > 0.0, a.im > 0.0);
            found.real(w, at(w));
        }
        if (a.norm() > 1.0) != (b.norm() > 1.0) {
            let w = bisect(grid[k - 1], grid[k], |w| at(w).norm() > 1.0, a.norm() > 1.0);
            found.unit(w, at(w));
        }
    }
    for (w, v) in grid.first().zip(values.first()).into_iter().chain(grid.last().zip(values.last())) {
        // What integrates has no value at rest: there no gain is too low.
        let at_rest = || Some(w) == grid.first() && (at(0.1 * w).norm() / v.norm() - 1.0).abs() < 0.1;
        let end = nyquist_rad_s.is_some_and(|end| (w / end - 1.0).abs() < 1e-9) || at_rest();
        if end && v.im.abs() < 1e-6 * v.norm() {
            found.real(*w, *v);
        }
    }
    let sensitivity = |w: f64| (ONE / (ONE + at(w))).norm();
    let complementary = |w: f64| {
        let l = at(w);
        if l.norm().is_finite() { (l / (ONE + l)).norm() } else { 1.0 }
    };
    let own: Vec<f64> = values.iter().map(|l| (ONE / (ONE + l)).norm()).collect();
    (found.sensitivity_rad_s, found.sensitivity) = peak(grid, &own, &sensitivity);
    let own: Vec<f64> =
        values.iter().map(|l| if l.norm().is_finite() { (l / (ONE + l)).norm() } else { 1.0 }).collect();
    found.complementary = peak(grid, &own, &complementary).1;
    found
}

impl Margins {
    /// A continuous loop that keeps a gain at all high frequencies: without delay it is real there, with one it takes every phase.
    pub(crate) fn at_high(&mut self, last_rad_s: f64, delayed: bool, at: &dyn Fn(f64) -> C) {
        let (a, b) = (at(1e5 * last_rad_s), at(1e6 * last_rad_s));
        if !(b.norm() > 0.5 * a.norm() && b.norm() > 1e-12 && (delayed || b.re < 0.0)) {
            return;
        }
        let factor = 1.0 / b.norm();
        if factor > 1.0 && self.gain_up.is_none_or(|g| factor < g) {
            (self.gain_up, self.gain_up_rad_s) = (Some(factor), None);
        } else if factor <= 1.0 && self.gain_down.is_none_or(|g| factor > g) {
            (self.gain_down, self.gain_down_rad_s) = (Some(factor), None);
        }
    }

    /// A sampled loop with a gain above 1 at half the sampling frequency: one more sample turns its sign there, whatever crossings say of parts
    /// of a sample, which no sampled loop has.
    fn at_half_sampling(&mut self, sample_time_s: f64, l: C) {
        if l.norm() > 1.0 && self.delay_s.is_none_or(|d| d > sample_time_s) {
            (self.delay_s, self.delay_rad_s) = (Some(sample_time_s), Some(PI / sample_time_s));
        }
    }

    /// A real value of the loop.
    fn real(&mut self, w: f64, l: C) {
        // A pole of the loop changes the sign of the imaginary part too.
        if !(l.re < 0.0 && l.im.abs() < 1e-3 * l.norm()) {
            return;
        }
        let factor = -1.0 / l.re;
        if factor > 1.0 && self.gain_up.is_none_or(|g| factor < g) {
            (self.gain_up, self.gain_up_rad_s) = (Some(factor), Some(w));
        }
        if factor <= 1.0 && self.gain_down.is_none_or(|g| factor > g) {
            (self.gain_down, self.gain_down_rad_s) = (Some(factor), Some(w));
        }
    }

    /// A value of size 1.
    fn unit(&mut self, w: f64, l: C) {
        if !((l.norm() - 1.0).abs() < 1e-3) {
            return;
        }
        let phase = l.arg() + std::f64::consts::PI;
        let margin = phase.min(std::f64::consts::TAU - phase).to_degrees();
        if self.phase_deg.is_none_or(|p| margin < p) {
            (self.phase_deg, self.phase_rad_s) = (Some(margin), Some(w));
        }
        let delay = phase / w;
        if self.delay_s.is_none_or(|d| delay < d) {
            (self.delay_s, self.delay_rad_s) = (Some(delay), Some(w));
        }
    }
}

fn bisect(mut lower: f64, mut upper: f64, side: impl Fn(f64) -> bool, at_lower: bool) -> f64 {
    for _ in 0..HALVINGS {
        let middle = 0.5 * (lower + upper);
        if !(middle > lower && middle < upper) {
            break;
        }
        if side(middle) == at_lower { lower = middle } else { upper = middle }
    }
    0.5 * (lower + upper)
}

/// Frequency and value of the largest of `values`, refined by golden section between its neighbours.
pub(crate) fn peak(grid: &[f64], values: &[f64], at: &dyn Fn(f64) -> f64) -> (f64, f64) {
    let Some(k) = (0..grid.len()).max_by(|a, b| values[*a].total_cmp(&values[*b])) else { return (0.0, 0.0) };
    let (mut lower, mut upper) = (grid[k.saturating_sub(1)], grid[(k + 1).min(grid.len() - 1)]);
    let mut best = (grid[k], values[k]);
    let share = (5f64.sqrt() - 1.0) / 2.0;
    let (mut a, mut b) = (upper - share * (upper - lower), lower + share * (upper - lower));
    let (mut at_a, mut at_b) = (at(a), at(b));
    for _ in 0..GOLDEN {
        for (w, v) in [(a, at_a), (b, at_b)] {
            if v > best.1 {
                best = (w, v);
            }
        }
        // The quotient of values near a peak is that of squares of distances: nothing is won below a millionth.
        if upper - lower < 1e-7 * upper {
            break;
        }
        if at_a > at_b {
            (upper, b, at_b) = (b, a, at_a);
            a = upper - share * (upper - lower);
            at_a = at(a);
        } else {
            (lower, a, at_a) = (a, b, at_b);
            b = lower + share * (upper - lower);
            at_b = at(b);
        }
    }
    best
}
