//! The rival of the dynamic map: a static map whose points are searched on the plant.

use super::context::{Context, Tone};
use super::error::ChainError;
use super::records::meter_conversion;
use dynocal_calib::map::static_map::{StaticMap, StaticPoint};
use dynocal_calib::problem::{LimitChannel, ObjectiveTerm};
use dynocal_calib::steady::hold::{Resting, hold};
use dynocal_calib::steady::search::{FreeInput, Setting};
use dynocal_calib::steady::{Held, best_point};
use dynocal_calib::validate::{inner, reference_row};
use dynocal_ident::plant::Plant;
use dynocal_ident::play::PlayError;
use dynocal_numerics::interval::Interval;
use dynocal_report::with_unit;
use rayon::prelude::*;
use std::sync::atomic::{AtomicUsize, Ordering};

/// `n` values over a range.
fn spread((lower, upper): (f64, f64), n: usize) -> Vec<f64> {
    (0..n).map(|k| lower + (upper - lower) * k as f64 / (n - 1) as f64).collect()
}

/// Points on each axis of the static map where the spec gives none.
const AXIS: usize = 5;

/// One static map, rows of the leading demand in parallel on plants of their own. What is minimised is what a meter of the plant
/// says where it has one, as everywhere.
///
/// # Errors
/// [`ChainError`].
pub(super) fn calibrate_static(ctx: &Context) -> Result<StaticMap, ChainError> {
    let (spec, problem) = (&ctx.spec.validate.static_map, &ctx.spec.problem);
    let or = |own: &Vec<f64>, range: (f64, f64), share: f64| match own.is_empty() {
        true => spread(inner(range, share), AXIS),
        false => own.clone(),
    };
    let lead = problem.demands.first().map_or((0.0, 1.0), |d| (d.lower, d.upper));
    let demand = or(&spec.demand, lead, 0.125);
    let given = match problem.given.first() {
        Some(g) => or(&spec.given, (g.lower, g.upper), 0.05),
        None => vec![0.0],
    };
    let done = AtomicUsize::new(0);
    let rows = demand
        .par_iter()
        .map(|level| {
            ctx.check_interrupt()?;
            let row = static_row(ctx, *level, &given)?;
            let done = done.fetch_add(1, Ordering::Relaxed) + 1;
            ctx.fraction(0.7 * done as f64 / demand.len() as f64);
            Ok(row)
        })
        .collect::<Vec<Result<_, ChainError>>>()
        .into_iter()
        .collect::<Result<Vec<_>, _>>()?;
    let bed_s = rows.iter().map(|(_, s)| s).sum();
    let points = rows.into_iter().flat_map(|(r, _)| r).collect();
    Ok(StaticMap { ports: ctx.channels.ports.clone(), demand, given, points, bed_s })
}

/// All points of one demand, each started from its neighbour; with the bed seconds that they took.
fn static_row(ctx: &Context, level: f64, given: &[f64]) -> Result<(Vec<StaticPoint>, f64), ChainError> {
    let (problem, channels) = (&ctx.spec.problem, &ctx.channels);
    // Free of sensor noise: the rival is given its best case.
    let mut plant = ctx.plant(false)?;
    plant.reset(ctx.spec.seed);
    let meters = meters(ctx, plant.as_ref())?;
    let search = &ctx.spec.validate.static_map.search;
    let mut start = ctx.start_inputs()?;
    let free: Vec<FreeInput> = channels
        .free
        .iter()
        .map(|&k| FreeInput {
            place: k,
            range: Interval::new(problem.inputs[k].lower, problem.inputs[k].upper),
        })
        .collect();
    // A free input begins in the middle of its range.
    free.iter().for_each(|f| start[f.place] = f.range.middle());
    start.extend(problem.given.iter().map(|g| 0.5 * (g.lower + g.upper)));
    let (mut points, mut bed_s) = (Vec::new(), 0.0);
    for &at in given {
        let reference = reference_row(problem, level, problem.given.first().map(|_| at));
        start[channels.inputs.len()..].copy_from_slice(&reference[channels.demands.len()..]);
        let mut measure = |u: &[f64]| {
            let held = hold_point(ctx, plant.as_mut(), &meters, u, &reference)?;
            bed_s += held.used_s;
            Ok(Setting { cost: cost(ctx, &meters, &held), held })
        };
        let best = best_point(search, &free, &start, &mut measure)?;
        start.clone_from(&best.held.inputs);
        points.push(StaticPoint {
            demand: level,
            given: at,
            actuators: best.held.inputs[..channels.inputs.len()].to_vec(),
            errors: best.held.errors.clone(),
            objective: objective_at(ctx, &meters, &best.held),
            missed: missed(ctx, &best.held),
        });
    }
    Ok((points, bed_s))
}

/// Holds the demands of one row of references from the inputs `u` (moved, then given).
fn hold_point(
    ctx: &Context,
    plant: &mut dyn Plant,
    meters: &[Meter],
    u: &[f64],
    reference: &[f64],
) -> Result<Held, PlayError> {
    let (problem, channels) = (&ctx.spec.problem, &ctx.channels);
    let spec = &ctx.spec.validate.static_map.search.hold;
    let n = spec.samples(ctx.spec.sample_time_s);
    let (moved, given) = u.split_at(channels.inputs.len());
    let held = |values: &[f64]| values.iter().map(|v| vec![*v; n]).collect::<Vec<_>>();
    let demands = held(&reference[..channels.demands.len()]);
    let mut plan = ctx.plan("hold", held(moved), held(given), demands, Tone::Lead).settled(0.0);
    // Behind the outputs of the problem, whose places stay.
    plan.outputs.extend(meters.iter().map(|m| m.channel.clone()));
    let resting: Vec<Resting> = problem
        .demands
        .iter()
        .zip(reference)
        .map(|(d, demand)| Resting {
            output: d.output.clone(),
            demand: *demand,
            resolution: RESOLUTION * (d.upper - d.lower),
        })
        .collect();
    hold(plant, spec, &plan, &resting)
}

/// Change of an output that counts as none, as a share of the range of its demand.
const RESOLUTION: f64 = 2.5e-4;
/// Error of a held demand from which on a point counts as missed, as a share of its range.
const MISSED: f64 = 0.0125;
/// Share of a limit by which a point may be beyond it without a word.
const PASSED: f64 = 0.02;
/// Price of a limit that is passed by its own size, in units of the objective's size.
const PRICE: f64 = 10.0;

/// The same of a loop that oscillates: its point is taken only where there is no other.
const SWINGS: f64 = 10.0;

/// Mean value of a channel of a held point.
fn held_value(ctx: &Context, h: &Held, name: &str) -> f64 {
    let inputs = ctx.channels.plant_inputs();
    let outputs = ctx.channels.outputs();
    let input = inputs.iter().position(|n| n == name).map(|k| h.inputs[k]);
    input.or_else(|| outputs.iter().position(|n| n == name).map(|k| h.outputs[k])).unwrap_or(f64::NAN)
}

/// Mean value of a channel, of a derived one by those that it is derived from.
fn value_of(ctx: &Context, h: &Held, name: &str) -> f64 {
    let m = ctx.spec.problem.monomial(name);
    m.powers.iter().fold(m.factor, |p, (name, k)| p * held_value(ctx, h, name).powi(*k))
}

/// A meter of the plant for a channel that is minimised, in the unit of the problem: `scale v + offset`.
struct Meter {
    channel: String,
    scale: f64,
    offset: f64,
}

fn meters(ctx: &Context, plant: &dyn Plant) -> Result<Vec<Meter>, ChainError> {
    let outputs = ctx.channels.outputs();
    let ports = ctx.meters_of(plant).into_iter().filter(|m| !outputs.contains(&m.name));
    ports
        .map(|m| {
            let unit = plant.variables().iter().find(|v| v.name == m.name).map_or("", |v| v.unit.as_str());
            let (scale, offset) = meter_conversion(&m, unit, "the plant", "hold")?;
            Ok(Meter { channel: m.name, scale, offset })
        })
        .collect()
}

/// What is minimised at a held point: of a channel that is metered what the meter said, else what follows from the others.
fn objective_at(ctx: &Context, meters: &[Meter], h: &Held) -> f64 {
    let problem = &ctx.spec.problem;
    let first_meter = h.outputs.len() - meters.len();
    let term = |t: &ObjectiveTerm| {
        if ctx.channels.outputs().contains(&t.channel) {
            return t.weight * held_value(ctx, h, &t.channel);
        }
        if let Some(k) = meters.iter().position(|m| m.channel == t.channel) {
            return t.weight * (meters[k].scale * h.outputs[first_meter + k] + meters[k].offset);
        }
        t.weight * value_of(ctx, h, &t.channel)
    };
    problem.minimise.iter().map(term).sum()
}

/// Objective of a held point, dearer by what it passes limits and misses demands.
fn cost(ctx: &Context, meters: &[Meter], h: &Held) -> f64 {
    let problem = &ctx.spec.problem;
    let base = objective_at(ctx, meters, h);
    let passed = |value: f64, lower: Option<f64>, upper: Option<f64>| {
        let over = upper.map_or(0.0, |u| (value - u).max(0.0) / u.abs().max(1e-12));
        over + lower.map_or(0.0, |l| (l - value).max(0.0) / l.abs().max(1e-12))
    };
    // At rest a mean is the value.
    let of = |l: &LimitChannel| {
        let value = value_of(ctx, h, &l.output);
        passed(value, l.lower, l.upper) + passed(value, None, l.mean_upper)
    };
    let limits: f64 = problem.limits.iter().map(of).sum();
    let missed: f64 = h
        .errors
        .iter()
        .zip(&problem.demands)
        .map(|(e, d)| (e.abs() / (d.upper - d.lower) - MISSED).max(0.0))
        .sum();
    let swings = if h.oscillation.is_some() { SWINGS } else { 0.0 };
    let all = base + PRICE * base.abs() * (limits + missed + swings);
    if all.is_finite() { all } else { f64::MAX }
}

/// Why a point was not reached as asked, with the loop input that stands at its limit; empty when it was.
fn missed(ctx: &Context, h: &Held) -> String {
    let problem = &ctx.spec.problem;
    let mut out: Vec<String> = h.oscillation.iter().map(ToString::to_string).collect();
    for (k, (e, &input)) in h.errors.iter().zip(&ctx.channels.driven).enumerate() {
        let d = &problem.demands[k];
        if e.abs() > MISSED * (d.upper - d.lower) {
            let (value, i) = (h.inputs[input], &problem.inputs[input]);
            let edge = 1e-3 * (i.upper - i.lower);
            let why = if value <= i.lower + edge || value >= i.upper - edge {
                format!("`{}` stands at its limit {value:.4}", i.name)
            } else {
                "it did not come to rest".into()
            };
            out.push(format!("{} is off by {}: {why}", d.output, with_unit(*e, 3, &d.unit)));
        }
    }
    for l in problem.limits.iter().filter(|l| l.soft_weight.is_none()) {
        let value = value_of(ctx, h, &l.output);
        let beyond = |limit: Option<f64>, sign: f64| {
            limit.filter(|limit| sign * (value - limit) > PASSED * limit.abs())
        };
        let limit = beyond(l.upper.or(l.mean_upper), 1.0).or(beyond(l.lower, -1.0));
        out.extend(limit.map(|limit| {
            let (value, limit) = (with_unit(value, 3, &l.unit), with_unit(limit, 3, &l.unit));
            format!("{} is {value}, beyond its limit of {limit}", l.output)
        }));
    }
    out.join("; ")
}
