//! Smith predictor: the loop of the undelayed model, and how wrong its delay and gain may be.
//!
//! ```text
//! Kbar = K / (1 + K P (1 - F e^(-D s)))        model P e^(-D s), F = 1 or a low-pass filter of the prediction error
//! plant  k P' e^(-(D + d) s):   boundary of stability  e^(-j w (D + d)) = -(1 + K P (1 - F e^(-j w D))) / (k K F P')
//! ```
//!
//! For every frequency at which the right side has size 1 there are delays d at which a pole is on the boundary; the interval
//! that is given ends at the first of them on either side of the nominal delay. Beyond, there can be islands in which the loop is
//! stable again: they are not within the interval, since a delay that drifts would have to pass through instability.
//!
//! Thesis (7.27), (7.28); filter: J. E. Normey-Rico, E. F. Camacho, Control of Dead-time Processes (2007), chapter 6.

use std::f64::consts::{PI, TAU};

use dynocal_numerics::interval::Interval;
use serde::{Deserialize, Serialize};

use crate::closed::{Unstable, continuous, sampled};
use crate::error::ControlError;
use crate::matrix::{C, ONE};
use crate::poly::{degree, value};
use crate::system::{System, Time, Transfer};

/// Halvings of an interval that holds a crossing.
const HALVINGS: usize = 80;

/// A Smith predictor about one loop.
#[derive(Clone, Debug, PartialEq)]
pub struct Smith {
    /// Continuous or sampled.
    pub time: Time,
    /// Controller K of the undelayed loop.
    pub controller: Transfer,
    /// Model P without the delay that is predicted.
    pub model: Transfer,
    /// Delay D of the model in s.
    pub delay_s: f64,
    /// Filter F of the prediction error, 1 at rest.
    pub filter: Transfer,
}

/// How wrong the delay may be.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct DelayInterval {
    /// Error in s (plant less model) at which stability is first lost upwards; none: not before `searched_s`.
    pub above_s: Option<f64>,
    /// Error in s, negative, at which it is first lost downwards; none: not before there is no delay left.
    pub below_s: Option<f64>,
    /// Frequency of the loss above, rad/s.
    pub above_rad_s: Option<f64>,
    /// Frequency of the loss below, rad/s.
    pub below_rad_s: Option<f64>,
}

impl Smith {
    /// An unfiltered predictor.
    pub fn new(time: Time, controller: Transfer, model: Transfer, delay_s: f64) -> Self {
        Self { time, controller, model, delay_s, filter: Transfer::gain(1.0) }
    }

    /// K P at a frequency.
    fn inner(&self, w: f64) -> C {
        self.controller.at(self.time, w) * self.model.at(self.time, w)
    }

    /// `1 + K P (1 - F e^-Ds) + k K F P' e^-(D+d)s` without its poles.
    fn equation(&self, plant: &Transfer, gain: f64, error_s: f64, w: f64) -> C {
        let turn = |s: f64| C::from_polar(1.0, -w * s);
        let filter = self.filter.at(self.time, w);
        let outer = self.controller.at(self.time, w) * plant.at(self.time, w) * filter * gain;
        ONE + self.inner(w) * (ONE - filter * turn(self.delay_s)) + outer * turn(self.delay_s + error_s)
    }

    /// Loop response of the predictor with a plant (without delay) of `gain` times `plant` whose delay is `error_s` longer.
    pub fn loop_response(&self, plant: &Transfer, gain: f64, error_s: f64, w: f64) -> C {
        let turn = |s: f64| C::from_polar(1.0, -w * s);
        let filter = self.filter.at(self.time, w);
        let k =
            self.controller.at(self.time, w) / (ONE + self.inner(w) * (ONE - filter * turn(self.delay_s)));
        k * plant.at(self.time, w) * filter * gain * turn(self.delay_s + error_s)
    }

    /// Unstable poles with a plant of `gain` times `plant` (given without the delay) whose delay is `error_s` longer.
    ///
    /// # Errors
    /// [`ControlError`]: parts that are no systems.
    pub fn unstable(&self, plant: &Transfer, gain: f64, error_s: f64) -> Result<Unstable, ControlError> {
        let grid = self.grid(plant, error_s)?;
        let mut parts = vec![&self.controller.den, &self.filter.den, &self.model.den];
        // States that model and plant share appear twice, as they do in the running loop.
        parts.push(&plant.den);
        let chi = |w: f64| {
            let x = self.time.variable(w);
            parts.iter().map(|p| value(p, x)).product::<C>() * self.equation(plant, gain, error_s, w)
        };
        let n = parts.iter().map(|p| degree(p)).sum();
        Ok(match self.time {
            Time::Continuous => continuous(&chi, &grid, n, 1e4),
            Time::Sampled { .. } => sampled(&chi, &grid),
        })
    }

    fn grid(&self, plant: &Transfer, error_s: f64) -> Result<Vec<f64>, ControlError> {
        let delayed = self.model.delayed(self.delay_s + error_s.max(0.0));
        let g = System::new(self.time, 1, 3, vec![delayed, plant.clone(), self.filter.clone()])?;
        let k = System::new(self.time, 3, 1, vec![self.controller.clone(); 3])?;
        let mut grid = crate::grid::frequencies(&g, &k);
        // What the predictor makes of its loop is as fine as its own delay.
        let last = grid.iter().copied().rev().find(|w| self.inner(*w).norm() > 0.02).unwrap_or(0.0);
        let step = PI / (16.0 * (self.delay_s + error_s.abs()).max(1e-12));
        grid.extend((1..=((last / step) as usize).min(40_000)).map(|k| k as f64 * step));
        if let Some(end) = self.time.nyquist_rad_s() {
            grid.retain(|w| *w <= end);
        }
        grid.sort_by(f64::total_cmp);
        grid.dedup();
        Ok(grid)
    }

    /// First losses of stability on either side of the nominal delay, for a plant of `gain` times `plant` (given without the
    /// delay).
    ///
    /// ```
    /// use dynocal_control::smith::Smith;
    /// use dynocal_control::system::{Time, Transfer};
    /// // e^-s / (s + 1), complementary sensitivity 1 / (0.5 s + 1) without the delay: K = (s + 1) / (0.5 s).
    /// let p = Transfer::continuous(&[1.0], &[1.0, 1.0], 0.0);
    /// let k = Transfer::continuous(&[1.0, 1.0], &[0.5, 0.0], 0.0);
    /// let found = Smith::new(Time::Continuous, k, p.clone(), 1.0).delay_interval(&p, 1.0)?;
    /// assert!((found.above_s.unwrap() - 1.62724).abs() < 1e-5 && found.below_s.is_none());
    /// # Ok::<(), dynocal_control::error::ControlError>(())
    /// ```
    ///
    /// # Errors
    /// [`ControlError::Unstable`] where the loop is not stable with the nominal delay.
    pub fn delay_interval(&self, plant: &Transfer, gain: f64) -> Result<DelayInterval, ControlError> {
        let nominal = self.unstable(plant, gain, 0.0)?;
        if !nominal.is_stable() {
            let what = format!("the predictor with {gain} times the gain");
            return Err(ControlError::Unstable { what, poles: nominal.words() });
        }
        // What e^(-j w (D + d)) must be.
        let wanted = |w: f64| {
            let turn = C::from_polar(1.0, -w * self.delay_s);
            let filter = self.filter.at(self.time, w);
            let outer = self.controller.at(self.time, w) * plant.at(self.time, w) * filter * gain;
            -(ONE + self.inner(w) * (ONE - filter * turn)) / outer
        };
        let grid = self.grid(plant, self.delay_s)?;
        let mut found = DelayInterval { above_s: None, below_s: None, above_rad_s: None, below_rad_s: None };
        let side = |w: f64| wanted(w).norm() > 1.0;
        for pair in grid.windows(2) {
            if side(pair[0]) == side(pair[1]) {
                continue;
            }
            let w = crossing(pair[0], pair[1], side);
            found.take(w, -wanted(w).arg() / w, self.delay_s);
        }
        // Real values at half the sampling frequency need no crossing; whole delays pass there by their sign alone.
        Ok(found)
    }

    /// Factors of the gain about 1 between which the loop with the nominal delay is stable, found by steps of one percent and
    /// halving; beyond the first loss on either side nothing is looked at. Ends of `within` stand where nothing is lost.
    ///
    /// # Errors
    /// As of [`Smith::unstable`].
    pub fn gain_interval(
        &self,
        plant: &Transfer,
        error_s: f64,
        within: Interval,
    ) -> Result<Interval, ControlError> {
        let stable = |gain: f64| self.unstable(plant, gain, error_s).map(Unstable::is_stable);
        if !stable(1.0)? {
            return Err(ControlError::Unstable {
                what: "the predictor".into(),
                poles: "at the nominal gain".into(),
            });
        }
        let edge = |factor: f64, end: f64| -> Result<f64, ControlError> {
            let beyond = |g: f64| if factor > 1.0 { g >= end } else { g <= end };
            let (mut good, mut bad) = (1.0, factor);
            while stable(bad)? {
                (good, bad) = (bad, bad * factor);
                if beyond(good) {
                    return Ok(end);
                }
            }
            for _ in 0..40 {
                let middle = 0.5 * (good + bad);
                if stable(middle)? { good = middle } else { bad = middle }
            }
            Ok(good)
        };
        Ok(Interval { lower: edge(1.0 / 1.01, within.lower)?, upper: edge(1.01, within.upper)? })
    }
}

impl DelayInterval {
    /// Delays `total + 2 pi k / w` less the nominal one: the nearest on either side.
    fn take(&mut self, w: f64, total_s: f64, nominal_s: f64) {
        let period = TAU / w;
        let above = (total_s - nominal_s).rem_euclid(period);
        let below = above - period;
        if self.above_s.is_none_or(|d| above < d) {
            (self.above_s, self.above_rad_s) = (Some(above), Some(w));
        }
        if nominal_s + below >= 0.0 && self.below_s.is_none_or(|d| below > d) {
            (self.below_s, self.below_rad_s) = (Some(below), Some(w));
        }
    }
}

fn crossing(mut lower: f64, mut upper: f64, side: impl Fn(f64) -> bool) -> f64 {
    let at_lower = side(lower);
    for _ in 0..HALVINGS {
        let middle = 0.5 * (lower + upper);
        if !(middle > lower && middle < upper) {
            break;
        }
        if side(middle) == at_lower { lower = middle } else { upper = middle }
    }
    0.5 * (lower + upper)
}
