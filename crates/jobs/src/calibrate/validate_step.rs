//! Step 6: the delivered map against its rivals on the plant.

use super::context::{ChainError, Context, RecordRef, Tone, save_records};
use super::invert_step::InvertResult;
use super::lag::best_lag;
use super::optimise_step::Pass;
use dynocal_calib::map::FeedforwardMap;
use dynocal_calib::map::lagged::LaggedStaticMap;
use dynocal_calib::map::static_map::{StaticMap, StaticPoint};
use dynocal_calib::steady::hold::{Resting, hold};
use dynocal_calib::steady::search::{FreeInput, Setting};
use dynocal_calib::steady::{Held, best_point};
use dynocal_calib::validate::{MapScore, Scenario, demand_steps, inner, random_points, reference_row, score};
use dynocal_ident::data::Dataset;
use dynocal_ident::plant::Plant;
use dynocal_ident::play::PlayError;
use dynocal_ident::stored::StoredModel;
use dynocal_numerics::rng::Rng64;
use dynocal_report::with_unit;
use rayon::prelude::*;
use serde::{Deserialize, Serialize};
use std::path::Path;
use std::sync::atomic::{AtomicUsize, Ordering};

/// The objective with the static map's free inputs on the record of the last pass.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct StaticOnRecord {
    /// Mean objective with the demands of the pass held and the static map's values of the inputs that no loop drives.
    pub objective: f64,
    /// Its ratio to the start record.
    pub ratio: f64,
    /// Share of the saving that the static map's values reach: (1 - measured) / (1 - this ratio). None when they save
    /// nothing.
    pub share_of_saving: Option<f64>,
}

/// What step 6 leaves behind.
#[derive(Clone, Debug, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ValidateResult {
    /// The static map.
    pub static_map: StaticMap,
    /// Time constant of the lagged static map in s, from a line search on the identified models.
    pub lag_s: f64,
    /// Scores of all maps in all scenarios, the delivered map first.
    pub scores: Vec<MapScore>,
    /// The static map's free inputs on the record of the last pass.
    pub static_on_record: Option<StaticOnRecord>,
    /// Measured records of all runs.
    pub records: Vec<RecordRef>,
    /// Bed time of the comparison in s (the static map's stands with it).
    pub bed_s: f64,
}

/// Name of the map that is delivered.
pub const DYNAMIC: &str = "dynamic map";

/// Runs the step.
///
/// # Errors
/// [`ChainError`].
pub fn validate(
    ctx: &Context,
    folder: &Path,
    inverse: &InvertResult,
    last: &Pass,
    optimise_folder: &Path,
    models: &[&StoredModel],
) -> Result<ValidateResult, ChainError> {
    let static_map = calibrate_static(ctx)?;
    let (spec, problem, dt) = (&ctx.spec.validate.scenario, &ctx.spec.problem, ctx.spec.sample_time_s);
    let leader = ctx.channels.driven.first().copied().unwrap_or(0);
    let steps = demand_steps(spec, problem, dt);
    let lag_s = best_lag(problem, (&static_map, leader), &steps, models, dt)?;
    let lagged = LaggedStaticMap { map: &static_map, tau_s: lag_s, leader };
    let static_on_record = static_on_record(ctx, folder, &static_map, last, optimise_folder)?;
    let mut maps: Vec<&dyn FeedforwardMap> = vec![&*inverse.dynamic, &static_map, &lagged];
    maps.extend(inverse.rivals.iter().map(|m| &**m));
    let mut rng = Rng64::stream(ctx.spec.seed, 400);
    let scenarios = [random_points(spec, problem, dt, &mut rng), steps];
    let runs = run_all(ctx, folder, &maps, &scenarios)?;
    let names: Vec<&str> = maps.iter().map(|m| m.name()).collect();
    let mut scores = Vec::new();
    for (scenario, records) in scenarios.iter().zip(&runs) {
        scores.extend(score(spec, problem, scenario, &names, &records.iter().collect::<Vec<_>>())?);
    }
    let all: Vec<Dataset> = runs.into_iter().flatten().collect();
    let bed_s = all.iter().map(|r| r.len() as f64 * dt + ctx.spec.excite.lead_in_s).sum();
    let records = save_records(folder, &all)?;
    Ok(ValidateResult { static_map, lag_s, scores, static_on_record, records, bed_s })
}

/// `n` values over a range.
fn spread((lower, upper): (f64, f64), n: usize) -> Vec<f64> {
    (0..n).map(|k| lower + (upper - lower) * k as f64 / (n - 1) as f64).collect()
}

/// Points on each axis of the static map where the spec gives none.
const AXIS: usize = 5;

/// One static map, rows of the leading demand in parallel on plants of their own.
fn calibrate_static(ctx: &Context) -> Result<StaticMap, ChainError> {
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
    let search = &ctx.spec.validate.static_map.search;
    let mut start = ctx.start_inputs()?;
    let free: Vec<FreeInput> = channels
        .free
        .iter()
        .map(|&k| FreeInput { place: k, range: (problem.inputs[k].lower, problem.inputs[k].upper) })
        .collect();
    // A free input begins in the middle of its range.
    free.iter().for_each(|f| start[f.place] = 0.5 * (f.range.0 + f.range.1));
    start.extend(problem.given.iter().map(|g| 0.5 * (g.lower + g.upper)));
    let (mut points, mut bed_s) = (Vec::new(), 0.0);
    for &at in given {
        let reference = reference_row(problem, level, problem.given.first().map(|_| at));
        start[channels.inputs.len()..].copy_from_slice(&reference[channels.demands.len()..]);
        let mut measure = |u: &[f64]| {
            let held = hold_point(ctx, plant.as_mut(), u, &reference)?;
            bed_s += held.used_s;
            Ok(Setting { cost: cost(ctx, &held), held })
        };
        let best = best_point(search, &free, &start, &mut measure)?;
        start.clone_from(&best.held.inputs);
        points.push(StaticPoint {
            demand: level,
            given: at,
            actuators: best.held.inputs[..channels.inputs.len()].to_vec(),
            errors: best.held.errors.clone(),
            objective: objective_at(ctx, &best.held),
            missed: missed(ctx, &best.held),
        });
    }
    Ok((points, bed_s))
}

/// Holds the demands of one row of references from the inputs `u` (moved, then given).
fn hold_point(ctx: &Context, plant: &mut dyn Plant, u: &[f64], reference: &[f64]) -> Result<Held, PlayError> {
    let (problem, channels) = (&ctx.spec.problem, &ctx.channels);
    let spec = &ctx.spec.validate.static_map.search.hold;
    let n = spec.samples(ctx.spec.sample_time_s);
    let (moved, given) = u.split_at(channels.inputs.len());
    let held = |values: &[f64]| values.iter().map(|v| vec![*v; n]).collect::<Vec<_>>();
    let demands = held(&reference[..channels.demands.len()]);
    let plan = ctx.plan("hold", held(moved), held(given), demands, Tone::Lead).settled(0.0);
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

fn objective_at(ctx: &Context, h: &Held) -> f64 {
    let problem = &ctx.spec.problem;
    let term = |t: &dynocal_calib::problem::ObjectiveTerm| {
        let m = problem.monomial(&t.channel);
        t.weight * m.powers.iter().fold(m.factor, |p, (name, k)| p * held_value(ctx, h, name).powi(*k))
    };
    problem.minimise.iter().map(term).sum()
}

/// Objective of a held point, dearer by what it passes limits and misses demands.
fn cost(ctx: &Context, h: &Held) -> f64 {
    let problem = &ctx.spec.problem;
    let base = objective_at(ctx, h);
    let passed = |value: f64, lower: Option<f64>, upper: Option<f64>| {
        let over = upper.map_or(0.0, |u| (value - u).max(0.0) / u.abs().max(1e-12));
        over + lower.map_or(0.0, |l| (l - value).max(0.0) / l.abs().max(1e-12))
    };
    let limits: f64 =
        problem.limits.iter().map(|l| passed(held_value(ctx, h, &l.output), l.lower, l.upper)).sum();
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
    out.join("; ")
}

fn static_on_record(
    ctx: &Context,
    folder: &Path,
    map: &StaticMap,
    last: &Pass,
    optimise_folder: &Path,
) -> Result<Option<StaticOnRecord>, ChainError> {
    if ctx.channels.free.is_empty() {
        return Ok(None);
    }
    let records = ctx.load_records(optimise_folder, &last.records)?;
    let Some(optimum) = records.get(1) else { return Ok(None) };
    let reference = ctx.channels.references(optimum)?;
    let mut actuators = ctx.channels.actuators(optimum)?;
    let mut u = vec![0.0; actuators.width()];
    for t in 0..actuators.len() {
        map.at(reference.row(t), &mut u);
        // What loops drive stays as optimised: they trim what the other inputs need.
        ctx.channels.free.iter().for_each(|&k| actuators.row_mut(t)[k] = u[k]);
    }
    let n = actuators.len();
    let inputs = (0..actuators.width()).map(|k| actuators.column(k)).collect();
    let given = ctx
        .channels
        .given
        .iter()
        .map(|g| Ok(optimum.values(g)?.to_vec()))
        .collect::<Result<_, ChainError>>()?;
    let demands = last.demands.clone();
    debug_assert!(demands.iter().all(|d| d.len() == n));
    let plan = ctx.plan("static_on_record", inputs, given, demands, Tone::Trim);
    let run = ctx.measure(folder, &plan, true)?;
    save_records(folder, std::slice::from_ref(&run))?;
    let objective = super::optimise_step::mean_objective(ctx, &run, last.first)?;
    let ratio = objective / last.measured_start;
    let share_of_saving =
        Some((1.0 - last.measured_ratio) / (1.0 - ratio)).filter(|v| v.is_finite() && ratio < 1.0);
    Ok(Some(StaticOnRecord { objective, ratio, share_of_saving }))
}

fn run_all(
    ctx: &Context,
    folder: &Path,
    maps: &[&dyn FeedforwardMap],
    scenarios: &[Scenario],
) -> Result<Vec<Vec<Dataset>>, ChainError> {
    let jobs: Vec<(usize, usize)> =
        (0..scenarios.len()).flat_map(|s| (0..maps.len()).map(move |m| (s, m))).collect();
    let done = AtomicUsize::new(0);
    let records = jobs
        .par_iter()
        .map(|&(s, m)| {
            let record = run_map(ctx, folder, maps[m], &scenarios[s])?;
            let done = done.fetch_add(1, Ordering::Relaxed) + 1;
            ctx.fraction(0.7 + 0.3 * done as f64 / jobs.len() as f64);
            Ok(record)
        })
        .collect::<Vec<Result<Dataset, ChainError>>>()
        .into_iter()
        .collect::<Result<Vec<_>, _>>()?;
    let mut records = records.into_iter();
    Ok(scenarios.iter().map(|_| records.by_ref().take(maps.len()).collect()).collect())
}

/// Runs a map through a scenario open loop; the raw demands are recorded beside.
fn run_map(
    ctx: &Context,
    folder: &Path,
    map: &dyn FeedforwardMap,
    scenario: &Scenario,
) -> Result<Dataset, ChainError> {
    let drive = map.drive(&scenario.reference, ctx.spec.sample_time_s);
    let demands = ctx.channels.demands.len();
    let inputs = (0..drive.width()).map(|k| drive.column(k)).collect();
    let given = (0..ctx.channels.given.len()).map(|k| scenario.reference.column(demands + k)).collect();
    let wanted = (0..demands).map(|k| scenario.reference.column(k)).collect();
    let name = format!("{}, {}", map.name(), scenario.name);
    let plan = ctx.plan(&name, inputs, given, wanted, Tone::Open).settled(4.0);
    ctx.measure(folder, &plan, false)
}
