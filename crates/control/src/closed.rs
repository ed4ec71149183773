//! Closed loops: their responses, and how many unstable poles they have.
//!
//! ```text
//! chi(x) = p_G(x) p_C(x) det(I + G C)        zeros of chi are the poles of the closed loop, with its exact delay
//! continuous, n = degree:   unstable = n/2 - (change of arg chi from w = 0 to infinity) / pi
//! sampled, q = z^-1:        unstable = (change of arg chi over q = e^-jw, w from 0 to pi, negative) / pi
//! ```
//!
//! The first is the criterion of Mikhailov, the second the principle of the argument for |q| < 1. The argument is followed with
//! steps that are halved until it turns by less than 0.5 rad, so that no grid decides about stability.

use std::sync::OnceLock;

use dynocal_numerics::fft::Complex;

use crate::error::ControlError;
use crate::grid::frequencies;
use crate::matrix::{C, Matrix, ONE};
use crate::poly::value;
use crate::system::{System, Time};

/// Largest turn of the argument in one step, in rad.
const TURN: f64 = 0.5;
/// Most halvings of one step.
const HALVINGS: usize = 40;

/// A plant under a controller, `u = C (r - y)`, `y = G u`. What is asked of it more than once is computed once.
#[derive(Clone, Debug)]
pub struct Closed {
    /// Plant G.
    pub plant: System,
    /// Controller C.
    pub controller: System,
    /// Frequencies in rad/s at which the loop is looked at.
    pub grid: Vec<f64>,
    state: OnceLock<Unstable>,
    responses: OnceLock<Result<Vec<Responses>, ControlError>>,
}

/// Responses at one frequency.
#[derive(Clone, Debug)]
pub struct Responses {
    /// G.
    pub plant: Matrix,
    /// C.
    pub controller: Matrix,
    /// (I + G C)^-1.
    pub at_outputs: Matrix,
    /// (I + C G)^-1.
    pub at_inputs: Matrix,
}

/// What the argument says of a closed loop.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Unstable {
    /// That many poles on the wrong side; 0 is stable.
    Poles(usize),
    /// A pole on the boundary, or one so near that it cannot be told.
    Boundary,
    /// Infinitely many: gain past every frequency around a loop with delay.
    Neutral,
}

impl Unstable {
    /// Whether the loop is stable.
    pub fn is_stable(self) -> bool {
        self == Self::Poles(0)
    }

    /// In words.
    pub fn words(self) -> String {
        match self {
            Self::Poles(0) => "stable".into(),
            Self::Poles(1) => "1 unstable pole".into(),
            Self::Poles(n) => format!("{n} unstable poles"),
            Self::Boundary => "a pole on the boundary of stability".into(),
            Self::Neutral => "gain above 1 at all high frequencies around a loop with delay".into(),
        }
    }
}

impl Closed {
    /// A loop with the grid of [`frequencies`].
    ///
    /// # Errors
    /// [`ControlError::Shape`] where plant and controller do not belong together.
    pub fn new(plant: System, controller: System) -> Result<Self, ControlError> {
        let shape = |s: &System| format!("{} x {}", s.outputs, s.inputs);
        if (plant.outputs, plant.inputs) != (controller.inputs, controller.outputs) {
            let expected = format!("{} x {}", plant.inputs, plant.outputs);
            return Err(ControlError::shape(
                "outputs x inputs of the controller",
                shape(&controller),
                expected,
            ));
        }
        if plant.time != controller.time {
            let words =
                |t: Time| t.sample_time_s().map_or("continuous".into(), |s| format!("sampled at {s} s"));
            return Err(ControlError::shape(
                "time of the controller",
                words(controller.time),
                words(plant.time),
            ));
        }
        let grid = frequencies(&plant, &controller);
        Ok(Self { plant, controller, grid, state: OnceLock::new(), responses: OnceLock::new() })
    }

    /// A loop that is only run in time: without frequencies.
    pub fn in_time(plant: System, controller: System) -> Self {
        Self { plant, controller, grid: Vec::new(), state: OnceLock::new(), responses: OnceLock::new() }
    }

    /// Responses at the frequencies of the grid.
    ///
    /// # Errors
    /// As of [`Closed::at`].
    pub fn responses(&self) -> Result<&[Responses], ControlError> {
        let all = self.responses.get_or_init(|| self.grid.iter().map(|w| self.at(*w)).collect());
        all.as_ref().map(Vec::as_slice).map_err(Clone::clone)
    }

    /// Responses at an angular frequency in rad/s.
    ///
    /// # Errors
    /// [`ControlError::Singular`] where the closed loop has a pole there.
    pub fn at(&self, w: f64) -> Result<Responses, ControlError> {
        let (plant, controller) = (self.plant.at(w), self.controller.at(w));
        let inverse = |l: &Matrix, what: &str| {
            let sum = l.sum(ONE, &Matrix::identity(l.rows), ONE);
            let singular = || ControlError::Singular { what: what.into(), frequency_rad_s: w };
            sum.inverse().ok_or_else(singular)
        };
        let at_outputs = inverse(&plant.times(&controller), "I + G C")?;
        let at_inputs = inverse(&controller.times(&plant), "I + C G")?;
        Ok(Responses { plant, controller, at_outputs, at_inputs })
    }

    /// Unstable poles of the closed loop.
    pub fn unstable(&self) -> Unstable {
        *self.state.get_or_init(|| self.counted())
    }

    fn counted(&self) -> Unstable {
        let time = self.plant.time;
        let exact = |w: f64| {
            let x = time.variable(w);
            let l = self.plant.at(w).times(&self.controller.at(w));
            let poles = self.plant.poles_at(x) * self.controller.poles_at(x);
            poles * l.sum(ONE, &Matrix::identity(l.rows), ONE).determinant()
        };
        // On a pole of the open loop the product is 0 times infinity, and next to it rounding; beside it, it is what it is.
        let factors = || self.plant.poles.iter().chain(&self.controller.poles);
        let chi = |w: f64| {
            let x = time.variable(w);
            let on_pole = factors().any(|p| value(p, x).norm() < 1e-8 * size(p, x.norm()));
            exact(if on_pole { w * (1.0 + 1e-6) } else { w })
        };
        match time {
            Time::Sampled { .. } => sampled(&chi, &self.grid),
            Time::Continuous => {
                let n = self.plant.states() + self.controller.states();
                let beyond = self.grid.last().copied().unwrap_or(1.0) * 1e3;
                let gain = self.plant.at(beyond).times(&self.controller.at(beyond)).norm();
                let delayed = self.plant.delay_s() + self.controller.delay_s() > 0.0;
                if delayed && gain >= 1.0 {
                    return Unstable::Neutral;
                }
                continuous(&chi, &self.grid, n, beyond_end(delayed, gain))
            }
        }
    }

    /// Whether the closed loop is stable.
    pub fn is_stable(&self) -> bool {
        self.unstable().is_stable()
    }
}

/// Unstable zeros of a continuous function that grows as s^n, followed to `beyond` times the end of the grid.
pub(crate) fn continuous(chi: &dyn Fn(f64) -> C, grid: &[f64], n: usize, beyond: f64) -> Unstable {
    let (Some(first), Some(last)) = (grid.first(), grid.last()) else { return Unstable::Boundary };
    let Some(start) = real_start(chi, *first) else { return Unstable::Boundary };
    let Some(turned) = turn(chi, &with_ends(grid, start, *last * beyond)) else { return Unstable::Boundary };
    whole(n as f64 / 2.0 - turned / std::f64::consts::PI)
}

/// How far a loop is followed: one with delay that keeps a gain below 1 turns for ever and goes nowhere.
pub(crate) fn beyond_end(delayed: bool, gain: f64) -> f64 {
    if delayed && gain > 1e-6 { 1.0 } else { 1e4 }
}

/// Zeros within |q| < 1 of a function of q = z^-1.
pub(crate) fn sampled(chi: &dyn Fn(f64) -> C, grid: &[f64]) -> Unstable {
    let (Some(first), Some(last)) = (grid.first(), grid.last()) else { return Unstable::Boundary };
    let Some(start) = real_start(chi, *first) else { return Unstable::Boundary };
    let Some(turned) = turn(chi, &with_ends(grid, start, *last)) else { return Unstable::Boundary };
    // q runs clockwise.
    whole(-turned / std::f64::consts::PI)
}

/// Sum of the sizes of the terms of a polynomial: what its value is small against.
fn size(p: &[f64], x: f64) -> f64 {
    p.iter().rev().fold(0.0, |sum, c| sum * x + c.abs())
}

fn with_ends(grid: &[f64], start: f64, end: f64) -> Vec<f64> {
    let inner = grid.iter().copied().filter(|w| *w > start && *w < end);
    std::iter::once(start).chain(inner).chain([end]).collect()
}

/// A frequency so low that the function is as good as real there; none where it vanishes at rest.
fn real_start(chi: &dyn Fn(f64) -> C, first: f64) -> Option<f64> {
    (0..7).map(|k| first * 10f64.powi(-2 * k)).find(|w| {
        let v = chi(*w);
        v.im.abs() < 0.05 * v.re.abs()
    })
}

/// Change of the argument along the grid in rad; none where the function is zero or not finite.
fn turn(chi: &dyn Fn(f64) -> C, grid: &[f64]) -> Option<f64> {
    let sound = |v: C| v.norm() > 0.0 && v.norm().is_finite();
    let mut at = *grid.first()?;
    let mut value = chi(at);
    let mut sum = 0.0;
    for &end in &grid[1..] {
        let mut ahead = vec![(end, chi(end), 0usize)];
        while let Some((w, v, depth)) = ahead.pop() {
            if !(sound(value) && sound(v)) {
                return None;
            }
            let angle = (v / value).arg();
            if angle.abs() < TURN {
                sum += angle;
                (at, value) = (w, v);
            } else if depth == HALVINGS {
                return None;
            } else {
                let middle = 0.5 * (at + w);
                ahead.push((w, v, depth + 1));
                ahead.push((middle, chi(middle), depth + 1));
            }
        }
    }
    Some(sum)
}

fn whole(count: f64) -> Unstable {
    let near = count.round();
    if (count - near).abs() > 0.3 || near < -0.5 {
        Unstable::Boundary
    } else {
        Unstable::Poles(near.max(0.0) as usize)
    }
}

/// Loop `k` with the others closed, seen where its part of `(I + L)^-1` is `s`: `1/s - 1`.
pub fn one_of(s: C) -> C {
    if s.norm() == 0.0 { Complex::new(f64::INFINITY, 0.0) } else { s.inv() - ONE }
}
