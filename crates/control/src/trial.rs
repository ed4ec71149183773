//! Margins as runs: what a margin says may be put into a loop is put in, and the loop is run in time.
//!
//! ```text
//! gain k     the plant times k
//! phase p    the signal times e^(-jp), run in pairs of real and imaginary parts: [cos p, sin p; -sin p, cos p]
//! delay d    continuous: the delay itself
//!            sampled: whole samples, and for the rest an all-pass (a + q)/(1 + a q) that is late by it at the frequency of the margin
//! ```
//!
//! A phase has no system that is real; as a pair it is exact at all frequencies, and the pair is stable where p and -p are. The time of
//! a sampled loop is its samples: what is between them exists at one frequency only.

use std::f64::consts::TAU;

use dynocal_numerics::fft::Complex;

use crate::closed::Closed;
use crate::error::ControlError;
use crate::margin::Side;
use crate::perturb::within;
use crate::poly::roots;
use crate::simulate::growth;
use crate::system::{System, Time, Transfer};

/// Turns of the critical frequency in a run, and the least that decide: of a margin that is passed by 2 % a turn grows by some hundredths.
const TURNS: (f64, f64) = (400.0, 60.0);
/// Least and most rows of a run.
const ROWS: (usize, usize) = (4000, 1_000_000);
/// Share of the fastest pole below which one is an integrator but for rounding.
const INTEGRATES: f64 = 1e-9;
/// Largest step of a continuous run over its fastest pole (and crossing), over its shortest delay: as a rule, and where a run would be too
/// long otherwise, what the method bears: there poles that are that fast do nothing but follow.
const STEP: [(f64, f64, f64); 2] = [(0.05, 0.05, 0.25), (0.5, 0.1, 0.5)];

/// Longest delay, and time of the slowest pole, in a run: what answers late must have answered before growth is looked at.
const SLOW: (f64, f64) = (20.0, 10.0);

/// Natural logarithm of how much a loop's answer to a pulse grows ([`growth`]) over a run that is long against the frequency `w_rad_s`
/// at which it is critical, and against everything that is slow in it. Below 0 it fades. `fastest_rad_s` is the highest frequency at which
/// one of its loops has a gain of 1.
///
/// # Errors
/// As of [`crate::simulate::run`]; [`ControlError::Number`] where the run that would decide is too long: one loop is too slow for another.
pub fn grows(closed: &Closed, w_rad_s: f64, fastest_rad_s: f64) -> Result<f64, ControlError> {
    let speeds = Speeds::of(closed);
    let turn_s = TAU / w_rad_s;
    let slow_s = (SLOW.0 * speeds.longest_s).max(SLOW.1 / speeds.slowest_rad_s);
    let steps = |step_s: f64| (TURNS.0 * turn_s).max(slow_s) / step_s;
    let step_s = match closed.plant.time {
        Time::Sampled { sample_time_s } => sample_time_s,
        Time::Continuous => {
            let [usual, largest] = STEP.map(|rule| speeds.step_s(w_rad_s.max(fastest_rad_s), rule));
            // As fine as the rows go.
            (usual * (steps(usual) / ROWS.1 as f64).max(1.0)).min(largest)
        }
    };
    let rows = (steps(step_s) as usize).clamp(ROWS.0, ROWS.1);
    let (turns, time_s) = (rows as f64 * step_s / turn_s, rows as f64 * step_s);
    if turns < TURNS.1 {
        let what = format!("turns of {w_rad_s:.3e} rad/s within {rows} steps");
        return Err(ControlError::number(what, turns, "60 at least, for a run that decides"));
    }
    if time_s < 0.999 * slow_s {
        let what = format!("time of {rows} steps, in s");
        return Err(ControlError::number(
            what,
            time_s,
            "20 times the longest delay and ten of the slowest pole",
        ));
    }
    let found = growth(closed, step_s, rows)?;
    if found.is_nan() || found == f64::NEG_INFINITY {
        return Err(ControlError::number("growth of a run", found, "a number"));
    }
    Ok(found)
}

/// What is fast and what is slow in a loop.
struct Speeds {
    fastest_rad_s: f64,
    /// Of the poles that are no integrators.
    slowest_rad_s: f64,
    shortest_s: f64,
    longest_s: f64,
}

impl Speeds {
    fn of(closed: &Closed) -> Self {
        let channels =
            || closed.plant.channels.iter().chain(&closed.controller.channels).filter(|g| !g.is_zero());
        let time = closed.plant.time;
        // In q = z^-1 a pole of exp(s dt) stands at exp(-s dt).
        let speed = |p: Complex<f64>| match time {
            Time::Continuous => p.norm(),
            Time::Sampled { sample_time_s } => p.ln().norm() / sample_time_s,
        };
        let poles: Vec<f64> = channels()
            .flat_map(|g| roots(&g.den).unwrap_or_default())
            .map(speed)
            .filter(|p| p.is_finite())
            .collect();
        let fastest_rad_s = poles.iter().copied().fold(0.0, f64::max);
        let moving = poles.iter().copied().filter(|p| *p > INTEGRATES * fastest_rad_s);
        let zeros = |g: &Transfer| match time {
            Time::Continuous => 0.0,
            Time::Sampled { sample_time_s } => {
                sample_time_s * g.num.iter().take_while(|v| **v == 0.0).count() as f64
            }
        };
        let delays = || channels().map(|g| g.delay_s + zeros(g)).filter(|d| *d > 0.0);
        Self {
            fastest_rad_s,
            slowest_rad_s: moving.fold(f64::INFINITY, f64::min),
            shortest_s: delays().fold(f64::INFINITY, f64::min),
            longest_s: delays().fold(0.0, f64::max),
        }
    }

    fn step_s(&self, crossing_rad_s: f64, (pole, crossing, delay): (f64, f64, f64)) -> f64 {
        (pole / self.fastest_rad_s).min(crossing / crossing_rad_s).min(delay * self.shortest_s)
    }
}

/// The plant with the gain of a loop times `factor`.
///
/// # Errors
/// As of [`System::new`].
pub fn louder(plant: &System, at: (Side, usize), factor: f64) -> Result<System, ControlError> {
    within(plant, at, &Transfer::gain(factor))
}

/// The plant with `delay_s` more in a loop that is critical at `w_rad_s`.
///
/// # Errors
/// As of [`System::new`].
pub fn later(plant: &System, at: (Side, usize), delay_s: f64, w_rad_s: f64) -> Result<System, ControlError> {
    let own = match plant.time {
        Time::Continuous => Transfer::gain(1.0).delayed(delay_s),
        Time::Sampled { sample_time_s } => {
            let (samples, turn) = (delay_s / sample_time_s, w_rad_s * sample_time_s);
            // Between half a sample and one and a half the all-pass is fast; what is whole needs none.
            let near = samples.round();
            let whole = if (samples - near).abs() < 1e-9 { near } else { (samples - 0.5).floor().max(0.0) };
            between(samples - whole, turn).delayed(whole * sample_time_s)
        }
    };
    within(plant, at, &own)
}

/// All-pass `(a + q)/(1 + a q)` that is late by `part` of a sample at the frequency of `turn` rad a sample:
/// `a = sin(b) / sin(turn - b)`, `b = (1 - part) turn / 2`.
fn between(part: f64, turn: f64) -> Transfer {
    if part.abs() < 1e-9 {
        return Transfer::gain(1.0);
    }
    let b = (1.0 - part) * turn / 2.0;
    let a = b.sin() / (turn - b).sin();
    Transfer { num: vec![a, 1.0], den: vec![1.0, a], delay_s: 0.0 }
}

/// The loop with its signal turned by `phase_rad`, as pairs of real and imaginary parts. The controller turns it: copies of a plant's unstable
/// pole would drift apart by rounding.
///
/// # Errors
/// As of [`System::new`].
pub fn turned(closed: &Closed, (side, k): (Side, usize), phase_rad: f64) -> Result<Closed, ControlError> {
    let (sin, cos) = phase_rad.sin_cos();
    let rotation = [[cos, sin], [-sin, cos]];
    let unit = [[1.0, 0.0], [0.0, 1.0]];
    // Outputs of the controller are inputs of the plant.
    let controller = paired(&closed.controller, &|output, input| {
        let own = match side {
            Side::Inputs => output,
            Side::Outputs => input,
        };
        if own == k { rotation } else { unit }
    })?;
    Ok(Closed::in_time(paired(&closed.plant, &|_, _| unit)?, controller))
}

/// A system whose signals are pairs: each channel times its two by two gains.
fn paired(s: &System, gains: &dyn Fn(usize, usize) -> [[f64; 2]; 2]) -> Result<System, ControlError> {
    let (p, m) = (s.outputs, s.inputs);
    let mut channels = Vec::with_capacity(4 * p * m);
    for i in 0..2 * p {
        for j in 0..2 * m {
            let gain = gains(i / 2, j / 2)[i % 2][j % 2];
            let own = s.channel(i / 2, j / 2);
            // A channel that is not there shall not be run.
            channels.push(if gain == 0.0 { Transfer::gain(0.0) } else { own.scaled(gain) });
        }
    }
    System::new(s.time, 2 * p, 2 * m, channels)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::matrix::C;

    /// Size 1 everywhere, and late by what was asked at its frequency.
    #[test]
    fn an_all_pass_is_late_by_its_part_of_a_sample() {
        let time = Time::Sampled { sample_time_s: 0.1 };
        for part in [0.05, 0.5, 0.9, 1.0, 1.3, 1.49] {
            for turn in [1e-3, 0.3, 1.0, 2.0] {
                let g = between(part, turn);
                let at = g.at(time, turn / 0.1);
                assert!((at - C::from_polar(1.0, -part * turn)).norm() < 1e-9, "{part} {turn}: {at}");
                assert!(g.den[1].abs() < 1.0, "{part} {turn}: stable");
                assert!((g.at(time, 7.0).norm() - 1.0).abs() < 1e-12);
            }
        }
    }

    /// What is late by three samples and 0.3 has three in its delay, or two and 1.3 in both.
    #[test]
    fn whole_samples_are_exact() {
        let time = Time::Sampled { sample_time_s: 0.1 };
        let plant = System::single(time, Transfer::sampled(&[0.0, 1.0], &[1.0, -0.5])).unwrap();
        let whole = later(&plant, (Side::Outputs, 0), 0.3, 5.0).unwrap();
        assert_eq!((whole.channels[0].delay_s, whole.channels[0].den.len()), (3.0 * 0.1, 2));
        let part = later(&plant, (Side::Outputs, 0), 0.33, 5.0).unwrap();
        let (own, with) = (plant.channels[0].at(time, 5.0), part.channels[0].at(time, 5.0));
        assert!((with / own - C::from_polar(1.0, -0.33 * 5.0)).norm() < 1e-9);
    }
}
