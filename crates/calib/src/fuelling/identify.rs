//! Identification from records of a bed.

mod chosen;
mod filled;
mod follow;
mod loss;
mod moved;
mod moving;
mod parameters;
mod record;
mod search;
mod steady;
mod worth;

pub use record::{STILL_S, TransientRecord};
pub use steady::SteadyPoint;

use super::adapt::Left;
use super::charge::Charge;
use super::coolant::CoolantLaw;
use super::filling::Filling;
use super::film::Film;
use super::trim::Trim;
use super::{Fuelling, Timing};
use chosen::{chosen, swings};
use dynocal_numerics::linalg::LinalgError;
use dynocal_numerics::status::Status;
use filled::{filled, refilled};
use follow::{pressure, richness, richness_slopes};
use loss::Loss;
use moved::moved_at_rest;
use parameters::{FILM, TIMING, given, half_k, has_film, taken};
use record::{charge_at_rest, rested};
use search::{Effort, Errors, Slopes, searched};
use worth::block;

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
    /// Records that do not belong together.
    #[error("record {number} has {found}, expected {expected} as in the first one")]
    Records {
        /// Number of the record, from 1.
        number: usize,
        /// What it has.
        found: String,
        /// What it should have.
        expected: String,
    },
    /// Interrupted.
    #[error("interrupted")]
    Interrupted,
    /// Least squares.
    #[error(transparent)]
    Linalg(#[from] LinalgError),
}

/// Corrections of the filling that are tried, in 1/s.
const CORRECTIONS: [f64; 5] = [0.1, 0.25, 0.5, 1.0, 2.0];
/// Shares of a film that are searched; a film of less is none.
const LEAST_SHARE: f64 = 1e-4;
const MOST_SHARE: f64 = 0.95;
/// Times that throttle and filling are taken anew by the charge that the mixture gave.
const ROUNDS: usize = 2;
/// Temperature of a coolant in K: gas that becomes a kelvin warmer is one over that thinner.
const COOLANT_K: f64 = 340.0;

/// What is identified from: records of one engine, and steady points that were measured beside them.
#[derive(Clone, Copy)]
struct Measured<'a> {
    records: &'a [TransientRecord<'a>],
    steady: &'a [SteadyPoint],
    /// Weights of all samples of the records ([`moving::weights`]); none: each counts alike.
    weights: &'a [f64],
}

impl Measured<'_> {
    fn weight(&self, t: usize) -> f64 {
        self.weights.get(t).copied().unwrap_or(1.0)
    }
}

/// Identifies charge, filling, film and timing from records that were made with one engine; where the coolant is given and its
/// temperatures differ by 10 K and more, film and charge over them too. `interrupt` is asked once per trial.
///
/// # Errors
/// [`FuellingError`].
pub fn identify(
    records: &[TransientRecord<'_>],
    interrupt: &(dyn Fn() -> bool + Sync),
) -> Result<Fuelling, FuellingError> {
    identify_with(records, &[], interrupt)
}

/// The same with steady points of the engine beside the records: those of its steady map, whose pressures and loads a short record does not
/// reach. Throttle and charge go by them as by the rests of the records, and in the last searches each counts as a second of a record at rest,
///
/// ```text
/// sum over samples of w^2 l(1/lambda - 1/lambda shown)^2  +  sum over points of (1 s / dt) l(fuel / c - 1)^2
/// ```
///
/// with w 1 where nothing moves and less where something does, l as all errors count (large ones by their logarithm), and c the charge at the speed, pressure, coolant and cams of the point.
///
/// # Errors
/// [`FuellingError`]; [`FuellingError::Channel`] for a point that is no number, or that has no cams where the records have them.
pub fn identify_with(
    records: &[TransientRecord<'_>],
    steady: &[SteadyPoint],
    interrupt: &(dyn Fn() -> bool + Sync),
) -> Result<Fuelling, FuellingError> {
    identified(Measured { records, steady, weights: &[] }, true, interrupt)
}

/// The same as if all fuel went into the cylinder at once: what a model without a film makes of the records.
///
/// # Errors
/// [`FuellingError`].
pub fn identify_without_film(
    records: &[TransientRecord<'_>],
    interrupt: &(dyn Fn() -> bool + Sync),
) -> Result<Fuelling, FuellingError> {
    identified(Measured { records, steady: &[], weights: &[] }, false, interrupt)
}

fn identified(
    measured: Measured<'_>,
    with_film: bool,
    interrupt: &(dyn Fn() -> bool + Sync),
) -> Result<Fuelling, FuellingError> {
    let records = measured.records;
    let rested = rested(records, measured.steady)?;
    let mut start = started(records, &rested)?;
    if !with_film {
        start.film.share = 0.0;
    }
    let start = filled(records, &rested, start, interrupt)?;
    let found = corrected(measured, &start, interrupt)?;
    // A model without a film leaves what goes with movement, and is not let off it.
    let weighed = |f: &Fuelling, loss| if with_film { moving::weights(records, f, loss) } else { Vec::new() };
    let mut weights = weighed(&found, Loss::CHOOSING);
    let mut found = chosen(Measured { weights: &weights, ..measured }, &rested, found, interrupt)?;
    // The policy fills the manifold by the charge that the mixture gave: so must the pressure that this charge was found with.
    for round in 1..=ROUNDS {
        found = refilled(records, &rested, found, interrupt)?;
        let loss = Loss::of_left(records, &found);
        weights = weighed(&found, loss);
        // What is expected before any record is weighed by the errors as they count now.
        let begun = Fuelling { rms: loss.rms(records, &found, &weights), ..found };
        let measured = Measured { weights: &weights, ..measured };
        let effort = if round == ROUNDS { Effort::Delivered } else { Effort::Compared };
        found = once_more(measured, begun, (effort, loss), interrupt)?;
    }
    let left: Vec<_> = records.iter().map(|r| residual(r, &found)).collect();
    found.left = Left::of(&left, found.sample_time_s);
    found.trim = Trim::suited(
        &left_apart(Measured { weights: &weights, ..measured }, &found, interrupt)?,
        found.sample_time_s,
    );
    found.rms = Loss::CHOOSING.rms(records, &found, &[]);
    Ok(found)
}

/// One of the last fits. Where slopes of the film over speed and pressure run away, or its inverse would swing with them, without them.
fn once_more(
    measured: Measured<'_>,
    begun: Fuelling,
    (effort, loss): (Effort, Loss),
    interrupt: &dyn Fn() -> bool,
) -> Result<Fuelling, FuellingError> {
    let fit = |begun: &Fuelling| {
        let by = |effort| mixed_by(measured, (begun, begun), &|_| true, effort, interrupt);
        match by((effort, loss)) {
            // Hardly anything tells: then as models are chosen.
            Err(FuellingError::Search { .. }) => by((Effort::Delivered, Loss::CHOOSING)),
            found => found,
        }
    };
    let found = fit(&begun);
    let astray = match &found {
        Ok(f) => f.film_ends.is_some() && swings(f),
        Err(e) => begun.film_ends.is_some() && matches!(e, FuellingError::Search { .. }),
    };
    if astray { fit(&Fuelling { film_ends: None, ..begun }) } else { found }
}

/// What is left of each half of the blocks of the records by the model that is fitted to the other one: a trim has to take out what a model
/// leaves where it was not fitted, and there errors stay that its fit takes out of its own record.
fn left_apart(
    measured: Measured<'_>,
    found: &Fuelling,
    interrupt: &dyn Fn() -> bool,
) -> Result<Vec<(Vec<f64>, usize)>, FuellingError> {
    let records = measured.records;
    let samples = length(records);
    let mut out: Vec<(Vec<f64>, usize)> = records.iter().map(|r| residual(r, found)).collect();
    let loss = Loss::of_left(records, found);
    for odd in [0, 1] {
        let apart = |t: usize| block(t, samples) % 2 == odd;
        let fitted = mixed_by(measured, (found, found), &|t| !apart(t), (Effort::Judged, loss), interrupt)?;
        let mut first = 0;
        for (r, (errors, _)) in records.iter().zip(&mut out) {
            let half = residual(r, &fitted).0;
            let own = errors.iter_mut().zip(half).enumerate().filter(|(t, _)| apart(first + t));
            own.for_each(|(_, (e, h))| *e = h);
            first += r.lambda.len();
        }
    }
    Ok(out)
}

/// Which correction of the filling suits is what the lambda that was measured says. All manifolds are those of the charge of the start;
/// each search begins where the one before it ended.
fn corrected(
    measured: Measured<'_>,
    start: &Fuelling,
    interrupt: &dyn Fn() -> bool,
) -> Result<Fuelling, FuellingError> {
    let mut last = start.clone();
    let mut best: Option<Fuelling> = None;
    for correction_per_s in CORRECTIONS {
        let filling = Filling { correction_per_s, ..start.filling.clone() };
        let tried = Fuelling { filling, ..start.clone() };
        last = mixed(measured, &tried, &last, Effort::Compared, interrupt)?;
        if best.as_ref().is_none_or(|b| last.rms < b.rms) {
            best = Some(last.clone());
        }
    }
    best.ok_or(FuellingError::Interrupted)
}

/// The charge from the ends of holds alone, by the pressure that is measured there, with what cams do to it where the holds tell, and what
/// the coolant makes of it.
///
/// # Errors
/// [`FuellingError::Channel`], [`FuellingError::Records`], [`FuellingError::Rests`], [`FuellingError::Linalg`].
pub fn steady_charge(records: &[TransientRecord<'_>]) -> Result<(Charge, Option<CoolantLaw>), FuellingError> {
    steady_charge_with(records, &[])
}

/// The same with steady points that were measured beside the records.
///
/// # Errors
/// As of [`steady_charge`]; those of points as of [`identify_with`].
pub fn steady_charge_with(
    records: &[TransientRecord<'_>],
    steady: &[SteadyPoint],
) -> Result<(Charge, Option<CoolantLaw>), FuellingError> {
    charge_of_rests(records, &rested(records, steady)?)
}

fn charge_of_rests(
    records: &[TransientRecord<'_>],
    rested: &[SteadyPoint],
) -> Result<(Charge, Option<CoolantLaw>), FuellingError> {
    let (charge, coolant) = charge_at_rest(records, rested)?;
    let moved = moved_at_rest(records, rested, (&charge, coolant.as_ref()))?;
    Ok((moved.unwrap_or(charge), coolant))
}

/// Where the searches begin: the charge at rest, a cycle of transport, as much through volumes, half of it mixed, and a film of some cycles.
fn started(records: &[TransientRecord<'_>], rested: &[SteadyPoint]) -> Result<Fuelling, FuellingError> {
    let (charge, coolant) = charge_of_rests(records, rested)?;
    let speeds = || records.iter().flat_map(|r| r.speed_rpm);
    let cycle_s = 120.0 * speeds().count() as f64 / speeds().sum::<f64>();
    let flow = charge.flow(charge.speed_rpm[0], charge.pressure_kpa[0]).max(1e-9);
    Ok(Fuelling {
        sample_time_s: records[0].sample_time_s,
        charge,
        filling: Filling {
            upstream_kpa: records[0].upstream_kpa,
            throttle_deg: 1.0,
            area: Vec::new(),
            gain: 1.0,
            throttle_lag_s: 0.05,
            throttle_rate_deg_s: None,
            sensor_lag_s: 0.0,
            correction_per_s: 0.5,
        },
        film: Film { share: 1.0 / (1.0 + 1.5_f64.exp()), tau_s: 6.0 * cycle_s },
        film_ends: None,
        timing: Timing {
            charge_s: 0.0,
            charge_cycles: 0.5,
            transport_cycles: 1.0,
            transport_fuel: 0.5 * cycle_s * flow,
            mixing_fuel: 0.5 * cycle_s * flow,
            sensor_lag_s: 0.5 * cycle_s,
        },
        coolant,
        trim: None,
        left: None,
        rms: 0.0,
        pressure_rms_kpa: 0.0,
    })
}

fn length(records: &[TransientRecord<'_>]) -> usize {
    records.iter().map(|r| r.speed_rpm.len()).sum()
}

/// Film, timing, law and charge, by the lambda of the records: the manifold is that of `start`, the search begins at `from`.
fn mixed(
    measured: Measured<'_>,
    start: &Fuelling,
    from: &Fuelling,
    effort: Effort,
    interrupt: &dyn Fn() -> bool,
) -> Result<Fuelling, FuellingError> {
    mixed_by(measured, (start, from), &|_| true, (effort, Loss::CHOOSING), interrupt)
}

/// The same by the samples of all records that `counts` takes.
fn mixed_by(
    measured: Measured<'_>,
    (start, from): (&Fuelling, &Fuelling),
    counts: &(dyn Fn(usize) -> bool + Sync),
    (effort, loss): (Effort, Loss),
    interrupt: &dyn Fn() -> bool,
) -> Result<Fuelling, FuellingError> {
    let Measured { records, steady, .. } = measured;
    let pressures: Vec<Vec<f64>> = records.iter().map(|r| pressure(r, start)).collect();
    let samples = length(records);
    let weigh = |of: &mut [f64]| {
        let all = of.iter_mut().take(samples).enumerate();
        all.for_each(|(t, e)| *e = if counts(t) { measured.weight(t) * *e } else { 0.0 });
    };
    let counted = (0..samples).filter(|t| counts(*t)).count();
    let expected = prior(start);
    let errors = |x: &[f64], out: &mut [f64]| {
        let f = taken(x, start);
        let (out, rest) = out.split_at_mut(samples);
        let (points, beside) = rest.split_at_mut(steady.len());
        steady::unexplained(steady, &f, loss, points);
        beside.iter_mut().zip(&expected).for_each(|(e, (at, weight))| *e = weight * x[*at]);
        let timing = &f.timing;
        // Where nothing tells of a film its share runs away, and one of 0 has other parameters.
        let share = !has_film(start) || (LEAST_SHARE..MOST_SHARE).contains(&f.film.share);
        if !(share && timing.transport_cycles < 10.0 && timing.charge_s.abs() < 0.5) {
            return false;
        }
        unexplained(records, &pressures, &f, loss, out);
        weigh(out);
        out.iter().chain(points.iter()).all(|e| e.is_finite())
    };
    let slopes = |x: &[f64], out: &mut [Vec<f64>]| {
        let f = taken(x, start);
        unexplained_slopes(records, &pressures, &f, loss, out);
        out.iter_mut().for_each(|column| weigh(column));
        steady::unexplained_slopes(steady, &f, loss, samples, out);
    };
    let rows = samples + steady.len() + expected.len();
    let by = (&errors as Errors<'_>, Some((start.charge.coefficients.len(), &slopes as Slopes<'_>)));
    let found = searched("film and timing", by, rows, &given(from), effort, interrupt)?;
    Ok(Fuelling { rms: (found.cost / counted.max(1) as f64).sqrt(), ..taken(&found.x, start) })
}

/// What 1 / lambda is beside that of the model, sample by sample, as it counts.
fn unexplained(
    records: &[TransientRecord<'_>],
    pressures: &[Vec<f64>],
    f: &Fuelling,
    loss: Loss,
    out: &mut [f64],
) {
    let mut out = out.iter_mut();
    for (r, pressure) in records.iter().zip(pressures) {
        let shown = richness(r, f, pressure);
        // The record first: at its end nothing more is taken of the others.
        let from = r.counts_from();
        for (t, ((lambda, phi), e)) in r.lambda.iter().zip(shown).zip(out.by_ref()).enumerate() {
            *e = if t < from { 0.0 } else { loss.of(1.0 / lambda - phi) };
        }
    }
}

/// What is expected of parameters before any record, as places and weights of rows beside the errors: that slopes over a cam are 0 with a
/// standard deviation of pi / 360 a degree, at which the volume of a cylinder goes with its crank at most, over its displacement.
/// A cam that moves the end of induction cannot move the charge by more, and two cams that move together tell one slope only. Nor do
/// slopes change by more than they are.
///
/// And that the charge falls to the ends of speed and pressure by as much as a gas does that becomes as warm as the coolant, at most: records
/// that hardly warm up do not tell these slopes.
fn prior(f: &Fuelling) -> Vec<(usize, f64)> {
    let mut out = Vec::new();
    if let Some(half) = half_k(f) {
        let first = if has_film(f) { FILM } else { 0 } + TIMING + 3;
        out.extend([first, first + 1].map(|at| (at, f.rms * COOLANT_K / half)));
    }
    if let Some(law) = &f.charge.cams {
        let most = law.most_of();
        let from = given(f).len() - f.charge.coefficients.len() - most.len();
        let weight = |most_deg: &f64| f.rms / (most_deg * std::f64::consts::PI / 360.0).max(1e-9);
        out.extend(most.iter().enumerate().map(|(k, m)| (from + k, weight(m))));
    }
    out
}

/// Its derivatives by the coefficients of the charge, one column each.
fn unexplained_slopes(
    records: &[TransientRecord<'_>],
    pressures: &[Vec<f64>],
    f: &Fuelling,
    loss: Loss,
    out: &mut [Vec<f64>],
) {
    let mut from = 0;
    for (r, pressure) in records.iter().zip(pressures) {
        richness_slopes(r, f, pressure, &mut |t, phi, by| {
            let weight = if t < r.counts_from() { 0.0 } else { -loss.slope(1.0 / r.lambda[t] - phi) };
            out.iter_mut().zip(by).for_each(|(column, d)| column[from + t] = weight * d);
        });
        from += r.lambda.len();
    }
}

impl Fuelling {
    /// 1 / lambda as the sensor would show it, sample by sample of a record.
    ///
    /// # Errors
    /// [`FuellingError::Channel`], [`FuellingError::Records`]: a record that cannot be read, or with another sample time.
    pub fn shown(&self, record: &TransientRecord<'_>) -> Result<Vec<f64>, FuellingError> {
        record::check(std::slice::from_ref(record))?;
        if record.sample_time_s != self.sample_time_s {
            let found = format!("samples of {} s", record.sample_time_s);
            let expected = format!("{} s", self.sample_time_s);
            return Err(FuellingError::Channel { channel: "time", found, expected });
        }
        Ok(richness(record, self, &pressure(record, self)))
    }
}

/// The logarithm of what the sensor showed over what it would show, sample by sample; forward in time by what it shows late.
fn residual(r: &TransientRecord<'_>, f: &Fuelling) -> (Vec<f64>, usize) {
    let pressure = pressure(r, f);
    let shown = richness(r, f, &pressure);
    let late = |t: usize| {
        let speed = r.speed_rpm[t];
        let flow = f.air(r.coolant_c(t), r.cams_deg(t)).flow(speed, pressure[t]);
        f.timing.delay_s(speed, flow) + f.timing.lag_s(flow)
    };
    let n = r.lambda.len();
    let late_s = (0..n).map(late).sum::<f64>() / n as f64;
    let errors = r.lambda.iter().zip(shown).map(|(lambda, phi)| (phi * lambda).max(1e-3).ln()).collect();
    (errors, (late_s / r.sample_time_s).round() as usize)
}

#[cfg(test)]
mod tests;
