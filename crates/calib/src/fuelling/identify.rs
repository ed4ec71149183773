//! Identification from one record of a bed.

use super::charge::{Charge, TERMS};
use super::filling::{Filling, FillingState};
use super::film::Film;
use super::{Fuelling, Timing};
use dynocal_numerics::linalg::LinalgError;
use dynocal_numerics::lm::{LeastSquares, LmOptions, LmOutcome, levenberg_marquardt_interruptible};
use dynocal_numerics::status::Status;
use rayon::prelude::*;

/// Channels of a record of holds and steps, sampled together.
#[derive(Clone, Copy, Debug)]
pub struct TransientRecord<'a> {
    /// Sample time in s.
    pub sample_time_s: f64,
    /// Speed in rpm.
    pub speed_rpm: &'a [f64],
    /// Throttle as it was commanded in deg.
    pub throttle_deg: &'a [f64],
    /// Fuel per cycle as it was commanded.
    pub injection: &'a [f64],
    /// Manifold pressure in kPa, after each sample.
    pub map_kpa: &'a [f64],
    /// Lambda as the sensor shows it, after each sample.
    pub lambda: &'a [f64],
    /// Pressure before the throttle in kPa.
    pub upstream_kpa: f64,
}

/// Why nothing was identified.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum FuellingError {
    /// Channels that are not as long as the others, or values that cannot be.
    #[error("channel `{channel}` has {found}, expected {expected}")]
    Channel {
        /// Channel.
        channel: &'static str,
        /// What it has.
        found: String,
        /// What it should have.
        expected: String,
    },
    /// Too few places at rest.
    #[error(
        "the record rests {found} times for {still_s} s with speed and throttle held, expected {expected} times at least: hold its points longer, or make more of them"
    )]
    Rests {
        /// Rests.
        found: usize,
        /// Rests needed.
        expected: usize,
        /// Time without movement before a rest counts, in s.
        still_s: f64,
    },
    /// A search that did not end.
    #[error("the {what} did not come to an end ({status:?}) on this record")]
    Search {
        /// What was searched.
        what: &'static str,
        /// How it ended.
        status: Status,
    },
    /// Interrupted.
    #[error("interrupted")]
    Interrupted,
    /// Least squares.
    #[error(transparent)]
    Linalg(#[from] LinalgError),
}

/// Time without movement after which a sample is at rest, and time that is averaged there, in s.
const STILL_S: f64 = 2.0;
const MEAN_S: f64 = 0.6;
/// Movement that counts as none: of the speed, relative; of the throttle, of the range of the record.
const STILL_SPEED: f64 = 0.01;
const STILL_THROTTLE: f64 = 0.005;
/// Corrections of the filling that are tried, in 1/s.
const CORRECTIONS: [f64; 5] = [0.1, 0.25, 0.5, 1.0, 2.0];
/// Errors of 1 / lambda beyond this count less and less.
const ROBUST: f64 = 0.05;
/// Parameters of timing and film before those of the charge.
const FIRST: usize = 7;
/// Relative step of the differences.
const STEP: f64 = 1e-6;

/// Identifies charge, filling, film and timing. `interrupt` is asked once per trial.
///
/// # Errors
/// [`FuellingError`].
pub fn identify(
    record: &TransientRecord<'_>,
    interrupt: &(dyn Fn() -> bool + Sync),
) -> Result<Fuelling, FuellingError> {
    let charge = steady_charge(record)?;
    let throttle: Vec<[f64; 3]> = rests(record)
        .iter()
        .map(|r| [mean(record.speed_rpm, r), mean(record.map_kpa, r), mean(record.throttle_deg, r)])
        .collect();
    let filling = Filling::of_rest(&charge, &throttle, record.upstream_kpa)?;
    let (filling, pressure_rms_kpa) = filled(record, &charge, filling, interrupt)?;
    // Which correction suits is what the lambda that was measured says.
    let tries: Vec<Fuelling> = CORRECTIONS
        .par_iter()
        .map(|c| {
            let filling = Filling { correction_per_s: *c, ..filling.clone() };
            mixed(record, &charge, filling, pressure_rms_kpa, interrupt)
        })
        .collect::<Result<_, _>>()?;
    let best = tries.into_iter().min_by(|a, b| a.rms.total_cmp(&b.rms));
    best.ok_or(FuellingError::Interrupted)
}

/// The charge from the ends of holds alone: by the pressure that is measured there.
///
/// # Errors
/// [`FuellingError::Channel`], [`FuellingError::Rests`], [`FuellingError::Linalg`].
pub fn steady_charge(record: &TransientRecord<'_>) -> Result<Charge, FuellingError> {
    check(record)?;
    let rests = rests(record);
    let expected = TERMS + 5;
    if rests.len() < expected {
        return Err(FuellingError::Rests { found: rests.len(), expected, still_s: STILL_S });
    }
    let fuel: Vec<f64> = record.injection.iter().zip(record.lambda).map(|(q, lambda)| q * lambda).collect();
    let point = |r| [mean(record.speed_rpm, r), mean(record.map_kpa, r), mean(&fuel, r)];
    Ok(Charge::fit(&rests.iter().map(point).collect::<Vec<_>>())?)
}

fn mean(v: &[f64], r: &std::ops::Range<usize>) -> f64 {
    v[r.clone()].iter().sum::<f64>() / r.len() as f64
}

fn check(r: &TransientRecord<'_>) -> Result<(), FuellingError> {
    let n = r.speed_rpm.len();
    let channels: [(&'static str, &[f64], f64); 5] = [
        ("speed", r.speed_rpm, 50.0),
        ("throttle", r.throttle_deg, -1e3),
        ("injection", r.injection, 0.0),
        ("map", r.map_kpa, 1.0),
        ("lambda", r.lambda, 0.05),
    ];
    let refused =
        |channel, found: String, expected: String| FuellingError::Channel { channel, found, expected };
    for (name, values, least) in channels {
        if values.len() != n || n < 100 {
            return Err(refused(
                name,
                format!("{} samples", values.len()),
                format!("{} (100 at least)", n.max(100)),
            ));
        }
        if let Some(v) = values.iter().find(|v| !(v.is_finite() && **v >= least)) {
            return Err(refused(name, format!("the value {v}"), format!("numbers of at least {least}")));
        }
    }
    let greatest = r.map_kpa.iter().copied().fold(0.0, f64::max);
    if !(r.upstream_kpa > greatest) {
        let found = format!("a pressure of {greatest} kPa");
        return Err(refused(
            "map",
            found,
            format!("less than the {} kPa before the throttle", r.upstream_kpa),
        ));
    }
    if !(r.sample_time_s > 0.0 && r.sample_time_s <= 0.05) {
        return Err(refused(
            "time",
            format!("samples of {} s", r.sample_time_s),
            "0.05 s at most: cycles are shorter".into(),
        ));
    }
    Ok(())
}

/// Stretches of [`MEAN_S`] before a movement (or the end) after [`STILL_S`] without any.
fn rests(r: &TransientRecord<'_>) -> Vec<std::ops::Range<usize>> {
    let (still, mean) = ((STILL_S / r.sample_time_s) as usize, (MEAN_S / r.sample_time_s).max(1.0) as usize);
    let width =
        |v: &[f64]| v.iter().fold((f64::INFINITY, f64::NEG_INFINITY), |(l, h), x| (l.min(*x), h.max(*x)));
    let (low, high) = width(r.throttle_deg);
    let mut out = Vec::new();
    let mut from = 0;
    for t in 1..=r.speed_rpm.len() {
        let moved = t == r.speed_rpm.len()
            || (r.speed_rpm[t] - r.speed_rpm[from]).abs() > STILL_SPEED * r.speed_rpm[from]
            || (r.throttle_deg[t] - r.throttle_deg[from]).abs() > STILL_THROTTLE * (high - low);
        if moved {
            if t - from >= still {
                out.push(t - mean..t);
            }
            from = t;
        }
    }
    out
}

/// Gain and throttle lag of the filling, by the pressure of the record.
fn filled(
    record: &TransientRecord<'_>,
    charge: &Charge,
    start: Filling,
    interrupt: &dyn Fn() -> bool,
) -> Result<(Filling, f64), FuellingError> {
    let with = |x: &[f64]| Filling { gain: x[0].exp(), throttle_lag_s: x[1].exp(), ..start.clone() };
    let errors = |x: &[f64], r: &mut [f64]| {
        let shown = shown(record, charge, &with(x));
        r.iter_mut().zip(record.map_kpa.iter().zip(shown)).for_each(|(r, (m, s))| *r = m - s);
        r.iter().all(|v| v.is_finite())
    };
    let found =
        searched("filling", &errors, record.speed_rpm.len(), &[0.0, start.throttle_lag_s.ln()], interrupt)?;
    let rms = (found.cost / record.speed_rpm.len() as f64).sqrt();
    Ok((with(&found.x), rms))
}

/// What the pressure channel would show.
fn shown(r: &TransientRecord<'_>, charge: &Charge, filling: &Filling) -> Vec<f64> {
    followed(r, charge, filling, |state, t| state.shown_kpa(r.speed_rpm[t], r.sample_time_s))
}

/// Pressure of the filling, corrected by what was measured.
fn pressure(r: &TransientRecord<'_>, charge: &Charge, filling: &Filling) -> Vec<f64> {
    followed(r, charge, filling, |state, _| state.pressure_kpa())
}

/// `of` the filling after each sample of the record.
fn followed(
    r: &TransientRecord<'_>,
    charge: &Charge,
    filling: &Filling,
    of: impl Fn(&FillingState, usize) -> f64,
) -> Vec<f64> {
    let dt = r.sample_time_s;
    let mut state = FillingState::at_rest(r.map_kpa[0], r.throttle_deg[0], dt);
    let step = |t: usize| {
        let before = r.map_kpa[t.saturating_sub(1)];
        state.step(filling, charge, r.speed_rpm[t], r.throttle_deg[t], before, dt);
        of(&state, t)
    };
    (0..r.speed_rpm.len()).map(step).collect()
}

/// Film, timing and charge, by the lambda of the record.
fn mixed(
    record: &TransientRecord<'_>,
    charge: &Charge,
    filling: Filling,
    pressure_rms_kpa: f64,
    interrupt: &dyn Fn() -> bool,
) -> Result<Fuelling, FuellingError> {
    let pressure = pressure(record, charge, &filling);
    let errors = |x: &[f64], r: &mut [f64]| {
        let (film, timing, charge) = taken(x, charge);
        if !(film.share < 0.95 && timing.transport_cycles < 10.0 && timing.charge_s.abs() < 0.5) {
            return false;
        }
        let shown = richness(record, &charge, film, &timing, &pressure);
        for (r, (lambda, phi)) in r.iter_mut().zip(record.lambda.iter().zip(shown)) {
            *r = ROBUST * ((1.0 / lambda - phi) / ROBUST).asinh();
        }
        r.iter().all(|v| v.is_finite())
    };
    let cycle_s = 120.0 * record.speed_rpm.len() as f64 / record.speed_rpm.iter().sum::<f64>();
    let flow = charge.flow(charge.speed_rpm[0], charge.pressure_kpa[0]).max(1e-9);
    // A cycle of transport, as much through volumes, and a film of some cycles.
    let start = [-1.5, (6.0 * cycle_s).ln(), 0.0, 0.5, 0.0, (cycle_s * flow).ln(), (0.5 * cycle_s).ln()];
    let start: Vec<f64> = start.into_iter().chain(charge.coefficients.iter().copied()).collect();
    let found = searched("film and timing", &errors, record.speed_rpm.len(), &start, interrupt)?;
    let (film, timing, charge) = taken(&found.x, charge);
    let rms = (found.cost / record.speed_rpm.len() as f64).sqrt();
    Ok(Fuelling { sample_time_s: record.sample_time_s, charge, filling, film, timing, rms, pressure_rms_kpa })
}

/// The parameters of a search: share (logit), tau, timing (logarithms where they are positive), charge.
fn taken(x: &[f64], charge: &Charge) -> (Film, Timing, Charge) {
    let film = Film { share: 1.0 / (1.0 + (-x[0]).exp()), tau_s: x[1].exp() };
    let timing = Timing {
        charge_s: x[2],
        charge_cycles: x[3],
        transport_cycles: x[4].exp(),
        transport_fuel: x[5].exp(),
        sensor_lag_s: x[6].exp(),
    };
    (film, timing, Charge { coefficients: x[FIRST..].to_vec(), ..charge.clone() })
}

/// A value between samples, held at the ends.
fn between(v: &[f64], t: f64) -> f64 {
    let t = t.clamp(0.0, (v.len() - 1) as f64);
    let k = (t as usize).min(v.len() - 2);
    v[k] + (t - k as f64) * (v[k + 1] - v[k])
}

/// 1 / lambda as the sensor would show it.
pub(super) fn richness(
    r: &TransientRecord<'_>,
    charge: &Charge,
    film: Film,
    timing: &Timing,
    pressure: &[f64],
) -> Vec<f64> {
    let (n, dt) = (r.speed_rpm.len(), r.sample_time_s);
    let mut state = film.at_rest(r.injection[0], r.speed_rpm[0]);
    let in_cylinder: Vec<f64> = (0..n)
        .map(|t| {
            let speed = r.speed_rpm[t];
            let fuel = film.forward(&mut state, r.injection[t], speed, dt);
            let ahead = (timing.charge_s + timing.charge_cycles * 120.0 / speed) / dt;
            fuel / charge.at(speed, between(pressure, t as f64 + ahead))
        })
        .collect();
    let follow = -(-dt / timing.sensor_lag_s).exp_m1();
    let mut shown = in_cylinder[0];
    (0..n)
        .map(|t| {
            let speed = r.speed_rpm[t];
            let flow = charge.flow(speed, pressure[t]).max(1e-9);
            let delay_s = timing.transport_cycles * 120.0 / speed + timing.transport_fuel / flow;
            shown += follow * (between(&in_cylinder, t as f64 - delay_s / dt) - shown);
            shown
        })
        .collect()
}

/// Levenberg-Marquardt with forward differences: two and some twenty parameters, each run of the record a few milliseconds.
fn searched(
    what: &'static str,
    errors: &dyn Fn(&[f64], &mut [f64]) -> bool,
    samples: usize,
    start: &[f64],
    interrupt: &dyn Fn() -> bool,
) -> Result<LmOutcome, FuellingError> {
    let mut problem = Differences { errors, samples, n: start.len(), other: vec![0.0; samples] };
    // One standard deviation of a parameter changes the cost by 1 / samples of it: steps below a hundredth of that say nothing.
    let cost_tolerance = 0.01 / samples as f64;
    let options = LmOptions { max_evaluations: 300, cost_tolerance, ..LmOptions::default() };
    let found = levenberg_marquardt_interruptible(&mut problem, start, &options, interrupt);
    match found.status {
        Status::Converged | Status::Stalled => Ok(found),
        Status::Interrupted => Err(FuellingError::Interrupted),
        status => Err(FuellingError::Search { what, status }),
    }
}

struct Differences<'a> {
    errors: &'a dyn Fn(&[f64], &mut [f64]) -> bool,
    samples: usize,
    n: usize,
    other: Vec<f64>,
}

impl LeastSquares for Differences<'_> {
    fn n(&self) -> usize {
        self.n
    }

    fn residuals(&self) -> usize {
        self.samples
    }

    fn residual(&mut self, x: &[f64], r: &mut [f64]) -> bool {
        (self.errors)(x, r)
    }

    fn residual_jacobian(&mut self, x: &[f64], r: &mut [f64], jac: &mut [f64]) -> bool {
        if !(self.errors)(x, r) {
            return false;
        }
        let mut y = x.to_vec();
        for k in 0..self.n {
            let h = STEP * x[k].abs().max(1.0);
            y[k] = x[k] + h;
            if !(self.errors)(&y, &mut self.other) {
                return false;
            }
            y[k] = x[k];
            for (t, (o, r)) in self.other.iter().zip(r.iter()).enumerate() {
                jac[t * self.n + k] = (o - r) / h;
            }
        }
        true
    }
}

#[cfg(test)]
mod tests;
