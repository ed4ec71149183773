//! What PI and PID gains are asked for and judged by, and gains by rules beside those of [`crate::search`].
//!
//! ```text
//! step response: 28 % and 63 % of the end -> gain k, T = 1.5 (t63 - t28), L = t63 - T
//! SIMC    kp = T / (k (tau + L)),  ki = kp / min(T, 4 (tau + L)),  tau = L
//! lambda  kp = T / (k (tau + L)),  ki = kp / T
//! ```
//!
//! S. Skogestad, J. Process Control 13 (2003) 291-309; E. B. Dahlin, Instruments and Control Systems 41 (1968) 77-83.

use rayon::prelude::*;
use serde::{Deserialize, Serialize};

use crate::closed::Closed;
use crate::error::ControlError;
use crate::margin::Margins;
use crate::plane::Channel;
use crate::runtime::PidGains;
use crate::simulate::{run, settling_s};
use crate::system::{System, Time, Transfer};

/// A lag with dead time.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Lag {
    /// Gain at rest.
    pub gain: f64,
    /// Time constant in s.
    pub lag_s: f64,
    /// Dead time in s.
    pub dead_s: f64,
}

/// Margins that are asked for on every plant.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Asked {
    /// Factor by which the gain may grow at least.
    pub gain_margin: f64,
    /// Phase margin in deg at least.
    pub phase_margin_deg: f64,
    /// Ms at most.
    pub sensitivity: f64,
    /// Delay margin in s at least.
    pub delay_margin_s: f64,
    /// Time in s within which a step of the demand settles to 2 %; none: as fast as the margins allow. A stable plant keeps any
    /// margins under a controller that is slow enough: this is what can make them impossible.
    pub settling_s: Option<f64>,
}

impl Default for Asked {
    fn default() -> Self {
        Self {
            gain_margin: 2.0,
            phase_margin_deg: 45.0,
            sensitivity: 1.7,
            delay_margin_s: 0.0,
            settling_s: None,
        }
    }
}

impl Asked {
    /// Whether gains keep everything on every plant.
    pub fn kept_by(&self, tuned: &Tuned) -> bool {
        let in_time = self.settling_s.is_none_or(|most| tuned.settling_s.is_some_and(|s| s <= most));
        tuned.violation.is_some_and(|v| v <= 1.0) && in_time
    }

    /// How far margins are from what is asked: the largest ratio of asked to had; at most 1 keeps all.
    pub fn violation(&self, m: &Margins) -> f64 {
        let ratio = |asked: f64, had: Option<f64>| {
            had.map_or(0.0, |h| if asked > 0.0 { asked / h.max(1e-300) } else { 0.0 })
        };
        ratio(self.gain_margin, m.gain_up)
            .max(ratio(self.phase_margin_deg, m.phase_deg))
            .max(ratio(self.delay_margin_s, m.delay_s))
            .max(m.sensitivity / self.sensitivity)
    }
}

/// Gains that a rule or a search gave, with what they keep on each plant.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Tuned {
    /// Where they come from.
    pub rule: String,
    /// Proportional gain.
    pub kp: f64,
    /// Integral gain in 1/s.
    pub ki: f64,
    /// Derivative gain in s, and the time constant of its filter in s; both 0 for a PI.
    #[serde(default)]
    pub kd: f64,
    /// Time constant of the filter of the derivative in s.
    #[serde(default)]
    pub filter_s: f64,
    /// Margins on each plant; none where the loop is not stable.
    pub margins: Vec<Option<Margins>>,
    /// Worst settling time in s of a step of the demand, within 2 %; none where a plant does not settle within the run.
    pub settling_s: Option<f64>,
    /// Largest overshoot of such a step, as a share of it.
    pub overshoot: f64,
    /// Largest ratio of asked to had: at most 1 keeps everything; none where a plant is not stable.
    pub violation: Option<f64>,
}

/// How much finer than a plant's own steps those of its loop are at most.
pub(crate) const FINER: f64 = 50.0;
/// Rows of the first of runs that grow in a search, and of the last.
const SOON: usize = 400;
const SEARCHED: usize = 20_000;
/// Most rows of an open step.
const ROWS: f64 = 200_000.0;
/// Share of the step within which it counts as settled.
const SETTLED: f64 = 0.02;

/// Lag with dead time of a stable channel, from its step response.
///
/// # Errors
/// [`ControlError::Number`]: no steady gain, or a response that does not settle.
pub fn lag(channel: &Channel) -> Result<Lag, ControlError> {
    let steady = channel.transfer.steady_gain(channel.time);
    let refused =
        || ControlError::number("the step response of the channel at its end", steady, "that it settles");
    let (fine_s, whole_s) = horizon(channel);
    let step_s = if channel.time == Time::Continuous { fine_s.max(whole_s / ROWS) } else { fine_s };
    let rows = (whole_s / step_s).min(ROWS) as usize;
    let open = open_step(channel, step_s, rows)?;
    let end = *open.last().ok_or_else(refused)?;
    if !(steady.is_finite() && (end / steady - 1.0).abs() < 0.05) {
        return Err(refused());
    }
    let reaches = |share: f64| {
        let t = open.iter().position(|y| y / steady >= share).unwrap_or(rows - 1);
        let (before, after) = (open[t.saturating_sub(1)] / steady, open[t] / steady);
        let within = if after > before { (share - before) / (after - before) } else { 1.0 };
        (t as f64 - 1.0 + within).max(0.0) * step_s
    };
    let (t28, t63) = (reaches(0.283), reaches(0.632));
    let lag_s = 1.5 * (t63 - t28);
    Ok(Lag { gain: steady, lag_s: lag_s.max(0.1 * step_s), dead_s: (t63 - lag_s).max(0.5 * step_s) })
}

/// Step that follows a channel, and the time that shows it from its delay to its slowest pole, both in s.
fn horizon(channel: &Channel) -> (f64, f64) {
    let poles = crate::poly::roots(&channel.transfer.den).unwrap_or_default();
    let slowest =
        |rates: &mut dyn Iterator<Item = f64>| rates.filter(|r| *r > 0.0).fold(f64::INFINITY, f64::min);
    match channel.time {
        // Integrators alone have no time of their own: that of gains to choose from about the middle of the grid.
        Time::Continuous if channel.transfer.delay_s == 0.0 && poles.iter().all(|p| p.norm() == 0.0) => {
            let middle = channel.grid[channel.grid.len() / 2];
            (0.005 / middle, 8.0 / middle)
        }
        Time::Continuous => {
            let slow = slowest(&mut poles.iter().map(|p| -p.re));
            let fast = poles.iter().map(|p| p.norm()).fold(0.0, f64::max);
            let delay = channel.transfer.delay_s;
            let fine = (0.1 / fast).min(if delay > 0.0 { delay / 4.0 } else { f64::INFINITY });
            let fine = dividing(fine, delay);
            let whole = if slow.is_finite() { 8.0 / slow } else { 0.0 } + 4.0 * delay;
            (fine, whole.max(400.0 * fine))
        }
        Time::Sampled { sample_time_s } => {
            let slow = slowest(&mut poles.iter().map(|p| p.norm().ln()));
            let n = if slow.is_finite() { 8.0 / slow } else { 0.0 };
            let lags = channel.transfer.num.len() as f64 + channel.transfer.delay_s / sample_time_s;
            (sample_time_s, (n + 4.0 * lags).max(50.0) * sample_time_s)
        }
    }
}

/// The longest step that is no longer than `step_s` and divides a delay: what jumps arrives between two steps.
fn dividing(step_s: f64, delay_s: f64) -> f64 {
    let n = (delay_s / step_s - 1e-6).ceil();
    if delay_s > 0.0 && n.is_finite() { delay_s / n.max(1.0) } else { step_s }
}

/// Answer of the channel to a unit step: the plant of a loop whose controller is nothing, under a load.
fn open_step(channel: &Channel, step_s: f64, rows: usize) -> Result<Vec<f64>, ControlError> {
    let plant = System::single(channel.time, channel.transfer.clone())?;
    let nothing = System::single(channel.time, Transfer::gain(0.0))?;
    let closed = Closed::in_time(plant, nothing);
    Ok(run(&closed, step_s, rows, &|_, r| r.fill(0.0), &|_, d| d.fill(1.0))?.y)
}

/// SIMC gains for a closed-loop time of `tau_s` (the dead time where none is given).
pub fn simc(lag: &Lag, tau_s: Option<f64>) -> PidGains {
    let tau_s = tau_s.unwrap_or(lag.dead_s);
    let kp = lag.lag_s / (lag.gain * (tau_s + lag.dead_s));
    PidGains::pi(kp, kp / lag.lag_s.min(4.0 * (tau_s + lag.dead_s)))
}

/// Lambda tuning for a closed-loop time of `tau_s` (the time constant where none is given).
pub fn lambda(lag: &Lag, tau_s: Option<f64>) -> PidGains {
    let kp = lag.lag_s / (lag.gain * (tau_s.unwrap_or(lag.lag_s) + lag.dead_s));
    PidGains::pi(kp, kp / lag.lag_s)
}

/// Run of a step of the demand that shows how it settles: step and rows for plants like `lag`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct StepRun {
    /// Step in s.
    pub step_s: f64,
    /// Rows.
    pub rows: usize,
}

/// The run in which all plants can settle: twenty times the lag with its dead time, and two and a half times what shows the channel from its
/// delay to its slowest pole (a lightly damped one is slow under a PI), for channels without a lag ten times that.
pub fn step_run(channels: &[Channel], lags: &[Lag]) -> StepRun {
    let shown = |c: &Channel| 10.0 * horizon(c).1;
    let share = if lags.len() < channels.len() { 1.0 } else { 0.25 };
    let other = channels.iter().map(|c| share * shown(c)).fold(0.0, f64::max);
    let whole = lags.iter().map(|l| 20.0 * (l.lag_s + l.dead_s)).fold(other, f64::max);
    let finest = channels.iter().map(|c| horizon(c).0).fold(f64::INFINITY, f64::min);
    StepRun { step_s: finest, rows: ((whole / finest) as usize).clamp(60, 50_000) }
}

/// The same run in steps that follow the loop of a channel under gains: a fifth of its fastest crossover, a third of the filter of a
/// derivative part. Sampled channels have their own step.
pub fn followed(channel: &Channel, gains: &PidGains, r: StepRun) -> StepRun {
    if channel.time != Time::Continuous {
        return r;
    }
    let controller = gains.transfer(channel.time);
    let above = |k: &usize| {
        let c = controller.at(channel.time, channel.grid[*k]);
        (channel.response[*k] * c).norm() > 0.5
    };
    let w = (0..channel.grid.len()).rev().find(above).map_or(0.0, |k| channel.grid[k]);
    let filter_s = if gains.kd != 0.0 { gains.filter_s / 3.0 } else { f64::INFINITY };
    // A plant that keeps its gain at all high frequencies has no last crossover: its delay is what is followed.
    let step_s = r.step_s.min((0.2 / w).max(r.step_s / FINER)).min(filter_s);
    let step_s = dividing(step_s, channel.transfer.delay_s);
    let whole = r.step_s * r.rows as f64;
    StepRun { step_s, rows: ((whole / step_s).ceil() as usize).clamp(r.rows, (ROWS as usize).max(r.rows)) }
}

/// Answer of one channel to a unit step of the demand, with the steps in which it is.
///
/// # Errors
/// As of [`run`].
pub fn step_response(
    channel: &Channel,
    gains: &PidGains,
    r: StepRun,
) -> Result<(Vec<f64>, StepRun), ControlError> {
    let r = followed(channel, gains, r);
    Ok((in_loop(channel, gains, r, [1.0, 0.0])?, r))
}

/// Outputs under constant demand and load. Plant and controller that both answer at once have a loop without time: two steps of delay give
/// it one.
fn in_loop(channel: &Channel, gains: &PidGains, r: StepRun, of: [f64; 2]) -> Result<Vec<f64>, ControlError> {
    let controller = System::single(channel.time, gains.transfer(channel.time))?;
    let own = |transfer: Transfer| -> Result<Vec<f64>, ControlError> {
        let closed = Closed::in_time(System::single(channel.time, transfer)?, controller.clone());
        Ok(run(&closed, r.step_s, r.rows, &|_, r| r.fill(of[0]), &|_, d| d.fill(of[1]))?.y)
    };
    match own(channel.transfer.clone()) {
        Err(_) if channel.time == Time::Continuous && channel.transfer.delay_s == 0.0 => {
            own(channel.transfer.delayed(2.0 * r.step_s))
        }
        found => found,
    }
}

/// Time in s in which a step of the demand settles to 2 % of it. A channel that integrates needs no integral for that: of such a one a
/// step of a load has to fade to 2 % of its largest effect as well. None: not within the run.
pub fn settled_s(channel: &Channel, gains: &PidGains, r: StepRun) -> Option<f64> {
    settled(channel, gains, r).0
}

/// That time, with the answer to the step of the demand; without any where the run fails.
fn settled(channel: &Channel, gains: &PidGains, r: StepRun) -> (Option<f64>, Vec<f64>) {
    let Ok((y, r)) = step_response(channel, gains, r) else { return (None, Vec::new()) };
    let demand = settling_s(&y, 1, 0, r.step_s, 1.0, SETTLED);
    if channel.transfer.steady_gain(channel.time).is_finite() {
        return (demand, y);
    }
    let found = demand.and_then(|demand| {
        let y = in_loop(channel, gains, r, [0.0, 1.0]).ok()?;
        let largest = y.iter().fold(0.0f64, |m, v| m.max(v.abs()));
        let last = y.iter().rposition(|v| v.abs() > SETTLED * largest)?;
        (last + 1 < y.len()).then(|| demand.max((last + 1) as f64 * r.step_s))
    });
    (found, y)
}

/// The same without runs that are much longer than they have to be: a time is taken once it is a tenth of its run, of which there are
/// at most `most` rows; with the answer that told it.
fn soon(channel: &Channel, gains: &PidGains, r: StepRun, most: usize) -> (Option<f64>, Vec<f64>) {
    let r = followed(channel, gains, r);
    let most = r.rows.min(most);
    let mut rows = SOON;
    loop {
        let own = StepRun { rows: rows.min(most), ..r };
        let found = settled(channel, gains, own);
        if own.rows == most || found.0.is_some_and(|s| s < 0.1 * own.step_s * own.rows as f64) {
            return found;
        }
        rows *= 5;
    }
}

/// As [`settled_s`] for a search.
pub(crate) fn soon_settled_s(channel: &Channel, gains: &PidGains, r: StepRun) -> Option<f64> {
    soon(channel, gains, r, SEARCHED).0
}

/// Margins and settling of gains on all plants.
pub fn judged(rule: &str, gains: &PidGains, channels: &[Channel], asked: &Asked, r: StepRun) -> Tuned {
    // The plane of a channel has a derivative part of its own: gains are judged with theirs.
    let own = |c: &Channel| match c.derivative == (gains.kd, gains.filter_s) {
        true => Some(c.clone()),
        false => c.with_derivative(gains.kd, gains.filter_s).ok(),
    };
    let channels: Vec<Option<Channel>> = channels.iter().map(own).collect();
    let margins: Vec<Option<Margins>> =
        channels.par_iter().map(|c| c.as_ref().and_then(|c| c.margins(gains.kp, gains.ki))).collect();
    let violation = margins
        .iter()
        .map(|m| m.as_ref().map(|m| asked.violation(m)))
        .try_fold(0.0, |w: f64, v| Some(w.max(v?)));
    let mut tuned = Tuned {
        rule: rule.into(),
        kp: gains.kp,
        ki: gains.ki,
        kd: gains.kd,
        filter_s: gains.filter_s,
        margins,
        settling_s: Some(0.0),
        overshoot: 0.0,
        violation,
    };
    for c in channels.iter().flatten() {
        let (settled, y) = violation.map_or((None, Vec::new()), |_| soon(c, gains, r, usize::MAX));
        tuned.settling_s = tuned.settling_s.zip(settled).map(|(a, b)| a.max(b));
        let top = y.iter().copied().fold(f64::NEG_INFINITY, f64::max);
        tuned.overshoot = tuned.overshoot.max(if top.is_finite() { top - 1.0 } else { f64::INFINITY });
    }
    tuned
}
