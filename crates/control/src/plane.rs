//! PI controllers in the plane of their gains: loci of margins and damping, and the set of stable gains.
//!
//! ```text
//! C(x) = kp + ki phi(x)         phi = 1/s,  or dt / (1 - q) as it runs
//! G(x) C(x) = r                 kp = Re(r/G) - ki Re(phi),  ki = Im(r/G) / Im(phi)
//! gain margin g: r = -1/g      phase margin p: r = -e^(j p)      stability: r = -1
//! damping z: r = -1 at s = w (-z + j sqrt(1 - z^2)),  q = e^(-s dt)
//! Ms: |1 + G C| >= 1/Ms at each w leaves out an interval of ki for each kp
//! ```
//!
//! On a locus a pole of the closed loop crosses; between the loci their number is constant, so the stable set follows from one
//! count in every piece (decomposition of the parameter plane, J. Ackermann, Robust Control (2002), chapters 2 and 3; thesis
//! section 7.7.1). Delays are exact.

use dynocal_numerics::fft::Complex;
use dynocal_numerics::interval::Interval;
use serde::{Deserialize, Serialize};

use crate::closed::{Unstable, continuous, sampled};
use crate::error::ControlError;
use crate::grid::frequencies;
use crate::margin::{Margins, of_response};
use crate::matrix::{C, ONE};
use crate::poly::{degree, value};
use crate::runtime::PidGains;
use crate::system::{System, Time, Transfer};

/// Halvings of an interval that holds a crossing.
const HALVINGS: usize = 80;

/// One channel that a PI is to control.
#[derive(Clone, Debug)]
pub struct Channel {
    /// Continuous or sampled.
    pub time: Time,
    /// Transfer function with exact delay.
    pub transfer: Transfer,
    /// Frequencies in rad/s.
    pub grid: Vec<f64>,
    response: Vec<C>,
    phi: Vec<C>,
    /// Denominators of the channel and of the integral.
    poles: [Vec<f64>; 2],
    /// The same at the frequencies of the grid.
    poles_at: Vec<C>,
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

/// The stable set with positive integral gain.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct StableSet {
    /// Ranges of kp in which there is a stable ki.
    pub kp: Vec<Interval>,
    /// Largest stable ki.
    pub largest_ki: f64,
    /// kp at it.
    pub kp_at_largest_ki: f64,
    /// Area in the plane.
    pub area: f64,
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
        let integral = PidGains::pi(1.0, 1.0).transfer(time);
        let poles = [transfer.den.clone(), integral.den.clone()];
        let grid = frequencies(&system, &System::single(time, integral)?);
        let response: Vec<C> = grid.iter().map(|w| transfer.at(time, *w)).collect();
        let phi = grid.iter().map(|w| phi(time, time.variable(*w))).collect();
        let poles_at = grid.iter().map(|w| product(&poles, time.variable(*w))).collect();
        Ok(Self { time, transfer, grid, response, phi, poles, poles_at })
    }

    /// Gains at which `G C = r` for `r(w)` along the frequencies of the grid.
    pub fn locus(&self, r: &dyn Fn(f64) -> C) -> Vec<LocusPoint> {
        let point = |k: usize| self.point(self.grid[k], r(self.grid[k]) / self.response[k], self.phi[k]);
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
            self.point(*w, -ONE / g, phi(self.time, x))
        };
        self.grid.iter().filter_map(point).collect()
    }

    fn states(&self) -> usize {
        self.poles.iter().map(|p| degree(p)).sum()
    }

    fn point(&self, w: f64, c: C, phi: C) -> Option<LocusPoint> {
        let ki = c.im / phi.im;
        let kp = c.re - ki * phi.re;
        (ki.is_finite() && kp.is_finite()).then_some(LocusPoint { w_rad_s: w, kp, ki })
    }

    fn boundary_at(&self, w: f64) -> (f64, f64) {
        let c = -ONE / self.transfer.at(self.time, w);
        let phi = phi(self.time, self.time.variable(w));
        let ki = c.im / phi.im;
        (c.re - ki * phi.re, ki)
    }

    /// Unstable poles under `kp + ki phi`.
    pub fn unstable(&self, kp: f64, ki: f64) -> Unstable {
        let chi = |w: f64| {
            let x = self.time.variable(w);
            product(&self.poles, x) * (ONE + self.transfer.at(self.time, w) * (phi(self.time, x) * ki + kp))
        };
        match self.time {
            Time::Sampled { .. } => sampled(&chi, &self.grid),
            Time::Continuous => {
                let beyond = self.grid.last().map_or(0.0, |w| self.transfer.at(self.time, w * 1e3).norm());
                if self.transfer.delay_s > 0.0 && beyond * kp.abs() >= 1.0 {
                    return Unstable::Neutral;
                }
                continuous(&chi, &self.grid, self.states())
            }
        }
    }

    /// Loop response on the grid.
    pub fn open(&self, kp: f64, ki: f64) -> Vec<C> {
        self.response.iter().zip(&self.phi).map(|(g, phi)| g * (phi * ki + kp)).collect()
    }

    /// Margins under `kp + ki phi`; none where the loop is not stable.
    pub fn margins(&self, kp: f64, ki: f64) -> Option<Margins> {
        if !self.unstable(kp, ki).is_stable() {
            return None;
        }
        let at = |w: f64| self.transfer.at(self.time, w) * (phi(self.time, self.time.variable(w)) * ki + kp);
        Some(of_response(&self.grid, &self.open(kp, ki), &at, self.time.nyquist_rad_s()))
    }

    /// Largest |1 / (1 + G C)| on the grid, without refinement and without asking for stability.
    pub fn sensitivity_on_grid(&self, kp: f64, ki: f64) -> f64 {
        let least = self
            .response
            .iter()
            .zip(&self.phi)
            .map(|(g, phi)| (ONE + g * (phi * ki + kp)).norm_sqr())
            .fold(f64::INFINITY, f64::min);
        1.0 / least.sqrt()
    }

    /// Whether `kp + ki phi` is stable, on the grid alone where it is fine enough for that, else with all refinement.
    pub fn is_stable(&self, kp: f64, ki: f64) -> bool {
        let mut sum = 0.0;
        let mut last: Option<C> = None;
        for ((g, phi), p) in self.response.iter().zip(&self.phi).zip(&self.poles_at) {
            let v = p * (ONE + g * (phi * ki + kp));
            if let Some(before) = last {
                let angle = (v / before).arg();
                if !(angle.abs() < 1.0) {
                    return self.unstable(kp, ki).is_stable();
                }
                sum += angle;
            } else if !(v.im.abs() < 0.05 * v.re.abs()) {
                return self.unstable(kp, ki).is_stable();
            }
            last = Some(v);
        }
        let count = match self.time {
            Time::Sampled { .. } => -sum / std::f64::consts::PI,
            Time::Continuous => self.states() as f64 / 2.0 - sum / std::f64::consts::PI,
        };
        if (count - count.round()).abs() > 0.2 {
            self.unstable(kp, ki).is_stable()
        } else {
            count.round() == 0.0
        }
    }

    /// Intervals of positive ki that are stable with `kp`: the boundary is looked for along all frequencies, and one ki of
    /// each piece is asked.
    pub fn stable_ki(&self, kp: f64) -> Vec<Interval> {
        let mut edges = vec![0.0];
        let own: Vec<(f64, f64)> = self.grid.iter().map(|w| self.boundary_at(*w)).collect();
        for k in 1..own.len() {
            let (a, b) = (own[k - 1].0 - kp, own[k].0 - kp);
            if (a > 0.0) != (b > 0.0) && a.is_finite() && b.is_finite() {
                let (mut lower, mut upper) = (self.grid[k - 1], self.grid[k]);
                for _ in 0..HALVINGS {
                    let middle = 0.5 * (lower + upper);
                    if (self.boundary_at(middle).0 > kp) == (a > 0.0) {
                        lower = middle
                    } else {
                        upper = middle
                    }
                }
                edges.push(self.boundary_at(0.5 * (lower + upper)).1);
            }
        }
        // At half the sampling frequency a real pole passes: 1 + G (kp + ki phi) = 0 there.
        if let Some(end) = self.time.nyquist_rad_s() {
            let (g, phi) = (self.transfer.at(self.time, end), phi(self.time, self.time.variable(end)));
            edges.push((-1.0 / g.re - kp) / phi.re);
        }
        edges.retain(|v| *v >= 0.0 && v.is_finite());
        edges.sort_by(f64::total_cmp);
        edges.push(edges.last().map_or(0.0, |v| 2.0 * v).max(wide(self).1));
        let pieces = edges.windows(2).filter(|e| e[1] - e[0] > 1e-12 * e[1]);
        pieces
            .filter(|e| self.is_stable(kp, 0.5 * (e[0] + e[1])))
            .map(|e| Interval { lower: e[0], upper: e[1] })
            .collect()
    }

    /// Intervals of positive ki with `kp` that are stable and keep `Ms <= most` on the grid.
    pub fn ki_with_sensitivity(&self, kp: f64, most: f64) -> Vec<Interval> {
        let mut left = self.stable_ki(kp);
        for (g, phi) in self.response.iter().zip(&self.phi) {
            let (a, b) = (ONE + g * kp, g * phi);
            let (square, half) = (b.norm_sqr(), (a * b.conj()).re);
            let root = half * half - square * (a.norm_sqr() - 1.0 / (most * most));
            if root > 0.0 && square > 0.0 {
                let out = ((-half - root.sqrt()) / square, (-half + root.sqrt()) / square);
                left = left.into_iter().flat_map(|i| without(i, out)).collect();
            }
        }
        left
    }

    /// The stable set with positive ki, its extent and its area (`points` values of kp in each range, Gauss-Legendre pieces).
    ///
    /// ```
    /// use dynocal_control::plane::Channel;
    /// use dynocal_control::system::{Time, Transfer};
    /// let lag = Channel::new(Time::Continuous, Transfer::continuous(&[1.0], &[4.0, 1.0], 1.0))?;
    /// let set = lag.stable_set(200);
    /// assert!((set.largest_ki - 3.21360).abs() < 1e-4 && (set.kp[0].upper - 6.93451).abs() < 1e-4);
    /// # Ok::<(), dynocal_control::error::ControlError>(())
    /// ```
    pub fn stable_set(&self, points: usize) -> StableSet {
        let mut set =
            StableSet { kp: self.kp_ranges(), largest_ki: 0.0, kp_at_largest_ki: f64::NAN, area: 0.0 };
        let height = |kp: f64| self.stable_ki(kp).iter().map(|i| i.upper - i.lower).sum::<f64>();
        for range in &set.kp {
            let width = (range.upper - range.lower) / points as f64;
            let mut best = (0.0, f64::NAN);
            for k in 0..points {
                let start = range.lower + width * k as f64;
                // Two points of Gauss: exact for cubic pieces.
                for share in [0.5 - 0.5 / 3f64.sqrt(), 0.5 + 0.5 / 3f64.sqrt()] {
                    let kp = start + share * width;
                    let ki = height(kp);
                    set.area += 0.5 * width * ki;
                    if ki > best.0 {
                        best = (ki, kp);
                    }
                }
            }
            let top = |kp: f64| self.stable_ki(kp).last().map_or(0.0, |i| i.upper);
            let grid = [best.1 - width, best.1, best.1 + width];
            let (kp, ki) = crate::margin::peak(&grid, &grid.map(top), &top);
            if ki > set.largest_ki {
                (set.largest_ki, set.kp_at_largest_ki) = (ki, kp);
            }
        }
        set
    }

    /// Ranges of kp with some stable positive ki: ends are where the boundary meets ki = 0, or turns round.
    pub fn kp_ranges(&self) -> Vec<Interval> {
        let own: Vec<(f64, f64)> = self.grid.iter().map(|w| self.boundary_at(*w)).collect();
        let mut ends = Vec::new();
        for k in 1..own.len() {
            if (own[k - 1].1 > 0.0) != (own[k].1 > 0.0) {
                let (mut lower, mut upper) = (self.grid[k - 1], self.grid[k]);
                let at_lower = own[k - 1].1 > 0.0;
                for _ in 0..HALVINGS {
                    let middle = 0.5 * (lower + upper);
                    if (self.boundary_at(middle).1 > 0.0) == at_lower {
                        lower = middle
                    } else {
                        upper = middle
                    }
                }
                ends.push(self.boundary_at(0.5 * (lower + upper)).0);
            }
            if k + 1 < own.len() && (own[k].0 - own[k - 1].0) * (own[k + 1].0 - own[k].0) < 0.0 {
                ends.push(own[k].0);
            }
        }
        if let Some(end) = self.time.nyquist_rad_s() {
            ends.push(-1.0 / self.transfer.at(self.time, end).re);
        }
        ends.push(-1.0 / self.transfer.steady_gain(self.time));
        ends.retain(|v| v.is_finite());
        ends.sort_by(f64::total_cmp);
        let first = ends.first().copied().unwrap_or(0.0);
        let last = ends.last().copied().unwrap_or(0.0);
        let reach = (last - first).max(last.abs());
        ends.insert(0, first - 0.5 * reach);
        // Without delay there may be no upper end: gains of twenty times the plant's are enough to choose from.
        ends.push((last + 0.5 * reach).max(wide(self).0));
        let mut out: Vec<Interval> = Vec::new();
        // Ends grow with the frequency without limit where the plant falls faster than one over it: what is narrow is told by the ends of
        // each piece alone.
        for e in ends.windows(2).filter(|e| e[1] - e[0] > 1e-9 * e[0].abs().max(e[1].abs())) {
            if !self.stable_ki(0.5 * (e[0] + e[1])).is_empty() {
                match out.last_mut() {
                    Some(before) if before.upper == e[0] => before.upper = e[1],
                    _ => out.push(Interval { lower: e[0], upper: e[1] }),
                }
            }
        }
        out
    }
}

/// Gains kp and ki to choose from where the plane has no end: twenty times those at which the channel, where it has fallen to half of its
/// gain at rest, has gain 1; an integrator in the middle of its grid.
fn wide(channel: &Channel) -> (f64, f64) {
    let steady = channel.transfer.steady_gain(channel.time).abs();
    let fallen =
        if steady.is_finite() { channel.response.iter().position(|g| g.norm() < 0.5 * steady) } else { None };
    let k = fallen.unwrap_or(channel.grid.len() / 2);
    let gain = channel.response[k].norm().max(f64::MIN_POSITIVE);
    let kp = 20.0 / gain;
    (if kp.is_finite() { kp } else { 0.0 }, if kp.is_finite() { kp * channel.grid[k] } else { 1.0 })
}

fn product(poles: &[Vec<f64>; 2], x: C) -> C {
    value(&poles[0], x) * value(&poles[1], x)
}

/// Integral part of a unit gain.
fn phi(time: Time, x: C) -> C {
    match time {
        Time::Continuous => x.inv(),
        Time::Sampled { sample_time_s } => Complex::new(sample_time_s, 0.0) / (ONE - x),
    }
}

fn without(i: Interval, out: (f64, f64)) -> Vec<Interval> {
    let below = Interval { lower: i.lower, upper: i.upper.min(out.0) };
    let above = Interval { lower: i.lower.max(out.1), upper: i.upper };
    [below, above].into_iter().filter(|i| i.upper > i.lower).collect()
}
