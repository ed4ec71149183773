//! PI and PID controllers in the plane of their gains kp and ki: loci of margins and damping.
//!
//! ```text
//! C(x) = kp + ki phi(x) + kd d(x)     phi = 1/s,          or dt / (1 - q) as it runs
//!                                     d = s / (T s + 1),  or (1 - q) / (T + dt - T q)
//! G(x) C(x) = r                       kp = Re(r/G - kd d) - ki Re(phi),  ki = Im(r/G - kd d) / Im(phi)
//! gain margin g: r = -1/g      phase margin p: r = -e^(j p)      stability: r = -1
//! damping z: r = -1 at s = w (-z + j sqrt(1 - z^2)),  q = e^(-s dt)
//! ```
//!
//! kd and its filter are the channel's: with them the plane is that of a PI about another curve. What is stable in it:
//! [`crate::stable`]. Delays are exact. (J. Ackermann, Robust Control (2002), chapters 2 and 3; thesis section 7.7.1.)

use dynocal_numerics::fft::Complex;
use serde::{Deserialize, Serialize};

use crate::closed::{Unstable, beyond_end, continuous, sampled};
use crate::error::ControlError;
use crate::grid::frequencies;
use crate::margin::{Margins, of_response};
use crate::matrix::{C, ONE};
use crate::poly::{degree, roots, value};
use crate::runtime::PidGains;
use crate::system::{System, Time, Transfer};

/// One channel that a PI, or a PID whose derivative part is given, is to control.
#[derive(Clone, Debug)]
pub struct Channel {
    /// Continuous or sampled.
    pub time: Time,
    /// Transfer function with exact delay.
    pub transfer: Transfer,
    /// Frequencies in rad/s.
    pub grid: Vec<f64>,
    /// Derivative gain in input unit x s per output unit, and the time constant of its filter in s.
    pub derivative: (f64, f64),
    pub(crate) response: Vec<C>,
    pub(crate) phi: Vec<C>,
    /// Derivative part of the controller, whatever kp and ki.
    pub(crate) known: Vec<C>,
    /// Denominators of the channel, of the integral and of the derivative.
    poles: [Vec<f64>; 3],
    /// The same at the frequencies of the grid.
    pub(crate) poles_at: Vec<C>,
    /// Gains of the boundary of stability there.
    pub(crate) boundary: Vec<(f64, f64)>,
}

/// A point of a locus.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct LocusPoint {
    /// Frequency in rad/s.
    pub w_rad_s: f64,
    /// Proportional gain.
    pub kp: f64,
    /// Integral gain in 1/s.
    pub ki: f64,
}

impl Channel {
    /// A channel; its gain at rest must be positive (turn the sign of channel and gains where it is not).
    ///
    /// # Errors
    /// [`ControlError`]: a transfer function that is none, without steady gain, or with a negative one.
    pub fn new(time: Time, transfer: Transfer) -> Result<Self, ControlError> {
        let system = System::single(time, transfer.clone())?;
        let steady = transfer.steady_gain(time);
        if !(steady > 0.0) {
            return Err(ControlError::number("the gain of the channel at rest", steady, "a positive number"));
        }
        Ok(Self::seen(time, transfer, (0.0, 0.0), &system))
    }

    /// The same channel under a derivative part.
    ///
    /// # Errors
    /// [`ControlError`]: a gain that is no number, a filter that is not 0 or positive, or none where the time is continuous.
    pub fn with_derivative(&self, kd: f64, filter_s: f64) -> Result<Self, ControlError> {
        if !kd.is_finite() {
            return Err(ControlError::number("kd", kd, "a finite number"));
        }
        let least = if self.time == Time::Continuous && kd != 0.0 { f64::MIN_POSITIVE } else { 0.0 };
        if !(filter_s >= least && filter_s.is_finite()) {
            let expected = "a positive number of seconds (0 only where the loop is sampled)";
            return Err(ControlError::number("the filter time of the derivative", filter_s, expected));
        }
        let system = System::single(self.time, self.transfer.clone())?;
        Ok(Self::seen(self.time, self.transfer.clone(), (kd, filter_s), &system))
    }

    fn seen(time: Time, transfer: Transfer, derivative: (f64, f64), system: &System) -> Self {
        let unit = PidGains { kd: derivative.0, filter_s: derivative.1, ..middling(time, &transfer) };
        let part = |gains: PidGains| gains.transfer(time);
        let integral = part(PidGains { kp: 0.0, ki: 1.0, kd: 0.0, ..unit });
        let rate = part(PidGains { kp: 0.0, ki: 0.0, ..unit });
        let grid = System::single(time, part(unit)).map_or(Vec::new(), |c| frequencies(system, &c));
        let poles = [transfer.den.clone(), integral.den, rate.den.clone()];
        let response: Vec<C> = grid.iter().map(|w| transfer.at(time, *w)).collect();
        let phi = grid.iter().map(|w| phi(time, time.variable(*w))).collect();
        let known = grid.iter().map(|w| rate.at(time, *w)).collect();
        let poles_at = grid.iter().map(|w| product(&poles, time.variable(*w))).collect();
        let boundary = Vec::new();
        let mut out =
            Self { time, transfer, grid, derivative, response, phi, known, poles, poles_at, boundary };
        out.boundary = out.grid.iter().map(|w| out.boundary_at(*w)).collect();
        out
    }

    /// The controller of gains with the channel's derivative part.
    pub fn gains(&self, kp: f64, ki: f64) -> PidGains {
        PidGains { kp, ki, kd: self.derivative.0, filter_s: self.derivative.1 }
    }

    /// Derivative part at `x` (s or q).
    pub(crate) fn known_at(&self, x: C) -> C {
        let (kd, filter_s) = self.derivative;
        match self.time {
            _ if kd == 0.0 => C::new(0.0, 0.0),
            Time::Continuous => x * kd / (x * filter_s + ONE),
            Time::Sampled { sample_time_s } => {
                (ONE - x) * kd / (ONE * (filter_s + sample_time_s) - x * filter_s)
            }
        }
    }

    /// Controller at `x`.
    fn controller(&self, x: C, kp: f64, ki: f64) -> C {
        phi(self.time, x) * ki + kp + self.known_at(x)
    }

    /// Gains at which `G C = r` for `r(w)` along the frequencies of the grid.
    pub fn locus(&self, r: &dyn Fn(f64) -> C) -> Vec<LocusPoint> {
        let point = |k: usize| {
            self.point(self.grid[k], r(self.grid[k]) / self.response[k] - self.known[k], self.phi[k])
        };
        (0..self.grid.len()).filter_map(point).collect()
    }

    /// Locus of a gain margin (a factor; 1: the boundary of stability).
    pub fn gain_locus(&self, factor: f64) -> Vec<LocusPoint> {
        self.locus(&|_| C::new(-1.0 / factor, 0.0))
    }

    /// Locus of a phase margin in deg.
    pub fn phase_locus(&self, deg: f64) -> Vec<LocusPoint> {
        self.locus(&|_| -C::from_polar(1.0, deg.to_radians()))
    }

    /// Locus of a delay margin in s.
    pub fn delay_locus(&self, delay_s: f64) -> Vec<LocusPoint> {
        self.locus(&|w| -C::from_polar(1.0, w * delay_s))
    }

    /// Locus on which a pair of poles has the damping `z` (0: the boundary of stability).
    pub fn damping_locus(&self, z: f64) -> Vec<LocusPoint> {
        let across = (1.0 - z * z).max(0.0).sqrt();
        let point = |w: &f64| {
            let s = Complex::new(-z, across) * *w;
            let x = match self.time {
                Time::Continuous => s,
                Time::Sampled { sample_time_s } => (-s * sample_time_s).exp(),
            };
            let rational = value(&self.transfer.num, x) / value(&self.transfer.den, x);
            let g = rational * (-s * self.transfer.delay_s).exp();
            self.point(*w, -ONE / g - self.known_at(x), phi(self.time, x))
        };
        self.grid.iter().filter_map(point).collect()
    }

    pub(crate) fn states(&self) -> usize {
        self.poles.iter().map(|p| degree(p)).sum()
    }

    fn point(&self, w: f64, c: C, phi: C) -> Option<LocusPoint> {
        let ki = c.im / phi.im;
        let kp = c.re - ki * phi.re;
        (ki.is_finite() && kp.is_finite()).then_some(LocusPoint { w_rad_s: w, kp, ki })
    }

    /// kp and ki of the boundary of stability at a frequency in rad/s.
    pub(crate) fn boundary_at(&self, w: f64) -> (f64, f64) {
        let x = self.time.variable(w);
        let c = -ONE / self.transfer.at(self.time, w) - self.known_at(x);
        let phi = phi(self.time, x);
        let ki = c.im / phi.im;
        (c.re - ki * phi.re, ki)
    }

    /// Unstable poles under `kp + ki phi`.
    pub fn unstable(&self, kp: f64, ki: f64) -> Unstable {
        let chi = |w: f64| {
            let x = self.time.variable(w);
            product(&self.poles, x) * (ONE + self.transfer.at(self.time, w) * self.controller(x, kp, ki))
        };
        match self.time {
            Time::Sampled { .. } => sampled(&chi, &self.grid),
            Time::Continuous => {
                let beyond = self.grid.last().map_or(0.0, |w| self.transfer.at(self.time, w * 1e3).norm());
                let (kd, filter_s) = self.derivative;
                let most = kp + if kd == 0.0 { 0.0 } else { kd / filter_s };
                let (delayed, gain) = (self.transfer.delay_s > 0.0, beyond * most.abs());
                if delayed && gain >= 1.0 {
                    return Unstable::Neutral;
                }
                continuous(&chi, &self.grid, self.states(), beyond_end(delayed, gain))
            }
        }
    }

    /// Gain at infinite frequency: 0 where the response fades there (always, where it is sampled).
    pub fn at_infinity(&self) -> f64 {
        let degree = |p: &[f64]| p.iter().rposition(|c| *c != 0.0);
        let (num, den) = (degree(&self.transfer.num), degree(&self.transfer.den));
        match (self.time, num, den) {
            (Time::Continuous, Some(n), Some(d)) if n >= d => {
                (self.transfer.num[n] / self.transfer.den[d]).abs()
            }
            _ => 0.0,
        }
    }

    /// Loop response on the grid.
    pub fn open(&self, kp: f64, ki: f64) -> Vec<C> {
        (0..self.grid.len()).map(|k| self.open_at(k, kp, ki)).collect()
    }

    pub(crate) fn open_at(&self, k: usize, kp: f64, ki: f64) -> C {
        self.response[k] * (self.phi[k] * ki + kp + self.known[k])
    }

    /// Margins under `kp + ki phi + kd d`; none where the loop is not stable.
    pub fn margins(&self, kp: f64, ki: f64) -> Option<Margins> {
        if !self.is_stable(kp, ki) {
            return None;
        }
        let at = |w: f64| self.transfer.at(self.time, w) * self.controller(self.time.variable(w), kp, ki);
        let mut found = of_response(&self.grid, &self.open(kp, ki), &at, self.time.nyquist_rad_s());
        if let (Time::Continuous, Some(last)) = (self.time, self.grid.last()) {
            found.at_high(*last, self.transfer.delay_s > 0.0, &at);
        }
        Some(found)
    }

    /// Largest |1 / (1 + G C)| on the grid, without refinement and without asking for stability.
    pub fn sensitivity_on_grid(&self, kp: f64, ki: f64) -> f64 {
        let size = |k: usize| (ONE + self.open_at(k, kp, ki)).norm_sqr();
        let least = (0..self.grid.len()).map(size).fold(f64::INFINITY, f64::min);
        1.0 / least.sqrt()
    }
}

/// A PI of the size and time of a channel, for the frequencies at which it is looked at whatever its units.
fn middling(time: Time, transfer: &Transfer) -> PidGains {
    let poles = roots(&transfer.den).unwrap_or_default();
    let rate = |p: &C| match time {
        Time::Continuous => p.norm(),
        Time::Sampled { sample_time_s } => p.norm().ln().abs() / sample_time_s,
    };
    let end = time.nyquist_rad_s().unwrap_or(f64::INFINITY);
    let slow = poles
        .iter()
        .map(rate)
        .filter(|r| *r > if end.is_finite() { 1e-6 * end } else { 0.0 })
        .fold(f64::INFINITY, f64::min);
    let late = if transfer.delay_s > 0.0 { 1.0 / transfer.delay_s } else { f64::INFINITY };
    let w = slow.min(late).min(0.3 * end);
    let w = if w.is_finite() { w } else { 1.0 };
    let size = transfer.at(time, w).norm();
    let kp = if size > 0.0 && size.is_finite() { 1.0 / size } else { 1.0 };
    PidGains::pi(kp, kp * w)
}

fn product(poles: &[Vec<f64>; 3], x: C) -> C {
    poles.iter().map(|p| value(p, x)).product()
}

/// Integral part of a unit gain.
pub(crate) fn phi(time: Time, x: C) -> C {
    match time {
        Time::Continuous => x.inv(),
        Time::Sampled { sample_time_s } => Complex::new(sample_time_s, 0.0) / (ONE - x),
    }
}
