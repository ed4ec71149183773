//! Step 1: identification and validation records in closed loop.

use super::context::{Context, FuelledFrom, Tone};
use super::error::ChainError;
use super::levels::Telling;
use super::records::{RecordRef, all_measured, save_records};
use super::signals::{aprbs, sweep};
use super::spec::INFORMATIVE;
use super::{fuelled, given, loops};
use dynocal_calib::gains::Tuned;
use dynocal_calib::problem::{DemandChannel, GivenChannel};
use dynocal_ident::data::Dataset;
use dynocal_ident::plan::Plan;
use dynocal_numerics::rng::Rng64;
use rayon::prelude::*;
use serde::{Deserialize, Serialize};
use std::path::Path;
use std::sync::atomic::{AtomicUsize, Ordering};

/// What step 1 leaves behind.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ExciteResult {
    /// Identification records.
    pub identification: Vec<RecordRef>,
    /// Validation records of other seeds and sweep periods.
    pub validation: Vec<RecordRef>,
    /// Bed time of the identification records in s; 0 for records that were there before.
    pub identification_bed_s: f64,
    /// Bed time of the validation records in s.
    pub validation_bed_s: f64,
    /// Gains of the loops where the spec gives none.
    pub tuned: Option<Tuned>,
    /// How the records followed their demands; empty for records that were there before.
    pub followed: Vec<Followed>,
    /// Where the fuelling of the campaign comes from, whose model lies beside the records; none where the map injects.
    #[serde(default)]
    pub fuelled: Option<FuelledFrom>,
}

/// A demanded output over all records of the step.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Followed {
    /// Output.
    pub output: String,
    /// Unit.
    pub unit: String,
    /// Mean of measured less demanded.
    pub mean_error: f64,
    /// The same as a share of the range of the demand.
    pub share: f64,
}

/// Measured less demanded, over all records; the demands are those of the plans, which a bed need not record.
fn followed(ctx: &Context, plans: &[Plan], records: &[Dataset]) -> Result<Vec<Followed>, ChainError> {
    let one = |d: &DemandChannel| {
        let (mut sum, mut n) = (0.0, 0usize);
        for (plan, r) in plans.iter().zip(records) {
            let demands = plan.demands.iter().filter(|p| p.output == d.output);
            for demand in demands {
                sum += r.values(&d.output)?.iter().zip(&demand.values).map(|(y, d)| y - d).sum::<f64>();
                n += demand.values.len();
            }
        }
        let mean_error = sum / n.max(1) as f64;
        let share = mean_error / (d.upper - d.lower);
        Ok(Followed { output: d.output.clone(), unit: d.unit.clone(), mean_error, share })
    };
    let mut out = ctx.spec.problem.demands.iter().map(one).collect::<Result<Vec<_>, ChainError>>()?;
    // What the fuelling holds, beside the given channel that demands it.
    for (output, given) in ctx.held() {
        let (mut sum, mut n) = (0.0, 0usize);
        for r in records {
            let demanded = r.values(&given.name)?;
            sum += r.values(output)?.iter().zip(demanded).map(|(y, d)| y - d).sum::<f64>();
            n += demanded.len();
        }
        let mean_error = sum / n.max(1) as f64;
        let share = mean_error / (given.upper - given.lower);
        out.push(Followed { output: output.into(), unit: given.unit.clone(), mean_error, share });
    }
    Ok(out)
}

/// Stream numbers of the random generator: one per record, far apart per purpose.
mod stream {
    pub(super) const IDENTIFICATION: u64 = 100;
    pub(super) const VALIDATION: u64 = 200;
    pub(super) const CHOSEN: u64 = 900_000;
    pub(super) const FURTHER: u64 = 900_001;
}

/// Runs the step: all records, independent of each other and hence in parallel. Fuelling and gains are found on the engine of
/// `whole`, records are those of the plant of `ctx`: the same, or engine and fuelling as one.
///
/// # Errors
/// [`ChainError`].
pub fn excite(whole: &Context, ctx: &Context, folder: &Path) -> Result<ExciteResult, ChainError> {
    let spec = &ctx.spec.excite;
    let fuelled = fuelled::identified(whole, folder)?;
    fuelled::inject(whole, folder, fuelled.as_ref())?;
    let tuned = loops::tuned(whole, folder)?;
    for c in [whole, ctx] {
        c.close_loops_with(tuned.as_ref());
    }
    if !spec.identification_files.is_empty() {
        return Ok(ExciteResult { fuelled, ..taken_over(ctx, folder, tuned)? });
    }
    let total = spec.identification_records + spec.validation_records;
    let done = AtomicUsize::new(0);
    let chosen = chosen_levels(ctx, spec.identification_records)?;
    let plans = (0..total).map(|k| record_plan(ctx, k, &chosen)).collect::<Result<Vec<_>, _>>()?;
    let records = plans
        .par_iter()
        .map(|plan| {
            let record = fuelled::excited(ctx, folder, plan)?;
            let done = done.fetch_add(1, Ordering::Relaxed) + 1;
            ctx.fraction(done as f64 / total as f64);
            Ok(record)
        })
        .collect();
    let records = all_measured(records)?;
    let followed = followed(ctx, &plans, &records)?;
    let (identification, validation) = records.split_at(spec.identification_records);
    let bed_s = |n: usize| n as f64 * (spec.record_s + spec.lead_in_s);
    Ok(ExciteResult {
        identification: save_records(folder, identification)?,
        validation: save_records(folder, validation)?,
        identification_bed_s: bed_s(spec.identification_records),
        validation_bed_s: bed_s(spec.validation_records),
        tuned,
        followed,
        fuelled,
    })
}

/// Records that are there already.
fn taken_over(ctx: &Context, folder: &Path, tuned: Option<Tuned>) -> Result<ExciteResult, ChainError> {
    let spec = &ctx.spec.excite;
    let read = |key: &str, files: &[std::path::PathBuf]| -> Result<Vec<Dataset>, ChainError> {
        files.iter().map(|f| given::record(ctx, key, f, &super::records::stem(f))).collect()
    };
    let identification = read("excite.identification_files", &spec.identification_files)?;
    let validation = read("excite.validation_files", &spec.validation_files)?;
    Ok(ExciteResult {
        identification: save_records(folder, &identification)?,
        validation: save_records(folder, &validation)?,
        identification_bed_s: 0.0,
        validation_bed_s: 0.0,
        tuned,
        followed: Vec::new(),
        fuelled: None,
    })
}

/// Plan of record `k`: identification records first, with levels where these are chosen.
fn record_plan(ctx: &Context, k: usize, chosen: &[Levels]) -> Result<Plan, ChainError> {
    let spec = &ctx.spec.excite;
    let ident = spec.identification_records;
    if k < ident {
        // Sweeps of different periods, so that the given channel and the levels do not repeat together.
        let number = stream::IDENTIFICATION + k as u64;
        let levels = chosen.get(k).map(Vec::as_slice);
        return excitation(ctx, &format!("ident{:02}", k + 1), number, spec.sweep_s + k as f64, levels);
    }
    let v = k - ident;
    let (number, sweep_s) = (stream::VALIDATION + v as u64, spec.sweep_s - 1.0 + 1.7 * v as f64);
    excitation(ctx, &format!("val{:02}", v + 1), number, sweep_s, None)
}

/// One more identification record by the same recipe, of a stream of its own.
///
/// # Errors
/// [`ChainError`].
pub fn extra_record(ctx: &Context, folder: &Path, name: &str, number: u64) -> Result<Dataset, ChainError> {
    let spec = &ctx.spec.excite;
    let (stream, sweep_s) = (stream::IDENTIFICATION + 50 + number, spec.sweep_s + 0.5);
    // Records that were given have holds of their own: what comes next is the first one of this recipe.
    let before = if spec.identification_files.is_empty() { spec.identification_records } else { 0 };
    let levels = chosen_levels(ctx, before + 1)?.pop();
    fuelled::excited(ctx, folder, &excitation(ctx, name, stream, sweep_s, levels.as_deref())?)
}

/// One more record whose levels tell most beside `records`, whatever recipe these had.
///
/// # Errors
/// [`ChainError`].
pub fn telling_record(
    ctx: &Context,
    folder: &Path,
    name: &str,
    records: &[Dataset],
) -> Result<Dataset, ChainError> {
    let spec = &ctx.spec.excite;
    let sweep_s = spec.sweep_s + spec.identification_records as f64;
    let mut rng = Rng64::stream(ctx.spec.seed, stream::FURTHER);
    let mut telling = telling(ctx, &mut rng);
    for r in records {
        known(ctx, r, &mut telling)?;
    }
    let levels = telling.record(&shares(ctx, sweep_s)?, &mut rng);
    fuelled::excited(ctx, folder, &excitation(ctx, name, stream::FURTHER, sweep_s, Some(&levels))?)
}

/// Adds the holds of a measured record.
fn known(ctx: &Context, record: &Dataset, telling: &mut Telling) -> Result<(), ChainError> {
    let (problem, channels) = (&ctx.spec.problem, &ctx.channels);
    let demands = problem.demands.iter().map(|d| (d.output.as_str(), (d.lower, d.upper)));
    let free =
        channels.free.iter().map(|&k| &problem.inputs[k]).map(|i| (i.name.as_str(), (i.lower, i.upper)));
    let given = problem.given.iter().map(|g| (g.name.as_str(), (g.lower, g.upper)));
    let column = |(name, own): (&str, (f64, f64))| Ok((record.values(name)?, range(ctx, name, own)));
    let moved = demands.chain(free).map(column).collect::<Result<Vec<_>, ChainError>>()?;
    let given = given.map(column).collect::<Result<Vec<_>, ChainError>>()?;
    let at = |of: &[(&[f64], (f64, f64))], t: usize| -> Vec<f64> {
        of.iter().map(|(v, (lo, hi))| (v[t] - lo) / (hi - lo)).collect()
    };
    let hold = hold_samples(ctx);
    for t in (together(ctx, 0)..record.len()).step_by(hold) {
        telling.know(&at(&moved, t), &at(&moved, t.saturating_sub(hold)), &at(&given, t));
    }
    Ok(())
}

/// Levels on every demand and every free input, displaced by equal parts of the hold time; given channels swept. Levels (holds x
/// channels, on 0 .. 1) are drawn at random where there are none.
fn excitation(
    ctx: &Context,
    name: &str,
    stream: u64,
    sweep_s: f64,
    chosen: Option<&[Vec<f64>]>,
) -> Result<Plan, ChainError> {
    let (spec, problem, channels) = (&ctx.spec.excite, &ctx.spec.problem, &ctx.channels);
    let (n, dt) = (samples(ctx), ctx.spec.sample_time_s);
    let mut rng = Rng64::stream(ctx.spec.seed, stream);
    let moved = moved(ctx);
    let mut number = 0;
    let mut levels = |name: &str, own: (f64, f64)| {
        // So much earlier each channel switches than the first one.
        let phase_s = number as f64 * spec.hold_s / moved as f64;
        number += 1;
        let (lower, upper) = range(ctx, name, own);
        let Some(levels) = chosen else {
            return aprbs((lower, upper), spec.levels, spec.hold_s, phase_s, n, dt, &mut rng);
        };
        let (hold, phase) = (hold_samples(ctx), (phase_s / dt).round() as usize);
        let at = |t: usize| levels[((t + phase) / hold).min(levels.len() - 1)][number - 1];
        Ok((0..n).map(|t| lower + (upper - lower) * at(t)).collect())
    };
    let demands = problem
        .demands
        .iter()
        .map(|d| levels(&d.output, (d.lower, d.upper)))
        .collect::<Result<Vec<_>, _>>()?;
    let free = channels
        .free
        .iter()
        .map(|&k| {
            let i = &problem.inputs[k];
            levels(&i.name, (i.lower, i.upper))
        })
        .collect::<Result<Vec<_>, _>>()?;
    let start = ctx.start_inputs()?;
    let mut inputs: Vec<Vec<f64>> = start.iter().map(|v| vec![*v; n]).collect();
    for (&k, values) in channels.free.iter().zip(free) {
        inputs[k] = values;
    }
    Ok(ctx.plan(name, inputs, sweeps(ctx, sweep_s)?, demands, Tone::Lead))
}

/// Range of a channel in the excitation.
fn range(ctx: &Context, name: &str, own: (f64, f64)) -> (f64, f64) {
    ctx.spec.excite.ranges.get(name).copied().unwrap_or(own)
}

fn moved(ctx: &Context) -> usize {
    ctx.channels.demands.len() + ctx.channels.free.len()
}

fn samples(ctx: &Context) -> usize {
    (ctx.spec.excite.record_s / ctx.spec.sample_time_s).round() as usize
}

fn hold_samples(ctx: &Context) -> usize {
    (ctx.spec.excite.hold_s / ctx.spec.sample_time_s).round().max(1.0) as usize
}

/// Given channels from end to end and back, each with a period of its own.
fn sweeps(ctx: &Context, sweep_s: f64) -> Result<Vec<Vec<f64>>, ChainError> {
    let (n, dt) = (samples(ctx), ctx.spec.sample_time_s);
    let one = |(k, g): (usize, &GivenChannel)| {
        let period = sweep_s * (1.0 + 0.37 * k as f64);
        Ok(sweep(range(ctx, &g.name, (g.lower, g.upper)), period, ctx.spec.excite.dwell_s, n, dt)?)
    };
    ctx.spec.problem.given.iter().enumerate().map(one).collect()
}

/// Levels of a record, holds x channels on 0 .. 1.
type Levels = Vec<Vec<f64>>;

/// The last sample at which all channels have their level of hold `h`: then the one that is displaced most goes on.
fn together(ctx: &Context, h: usize) -> usize {
    let (hold, moved) = (hold_samples(ctx), moved(ctx));
    h * hold + (hold / moved.max(1)).max(1) - 1
}

/// Given channels at each hold (holds x given), on 0 .. 1.
fn shares(ctx: &Context, sweep_s: f64) -> Result<Levels, ChainError> {
    let given = sweeps(ctx, sweep_s)?;
    let ranges: Vec<(f64, f64)> =
        ctx.spec.problem.given.iter().map(|g| range(ctx, &g.name, (g.lower, g.upper))).collect();
    // What is displaced has begun the last hold before the end of the record.
    let at = |h: usize| {
        let one =
            |(v, (lo, hi)): (&Vec<f64>, &(f64, f64))| (v[together(ctx, h).min(v.len() - 1)] - lo) / (hi - lo);
        given.iter().zip(&ranges).map(one).collect()
    };
    Ok((0..=samples(ctx).div_ceil(hold_samples(ctx))).map(at).collect())
}

fn telling(ctx: &Context, rng: &mut Rng64) -> Telling {
    Telling::new(moved(ctx), ctx.spec.problem.given.len(), ctx.spec.excite.levels, rng)
}

/// Levels of the identification records before `count`, each aware of the earlier ones; none where they are drawn at random.
fn chosen_levels(ctx: &Context, count: usize) -> Result<Vec<Levels>, ChainError> {
    if ctx.spec.excite.signal != INFORMATIVE {
        return Ok(Vec::new());
    }
    let mut rng = Rng64::stream(ctx.spec.seed, stream::CHOSEN);
    let mut telling = telling(ctx, &mut rng);
    let one = |k: usize| {
        ctx.check_interrupt()?;
        Ok(telling.record(&shares(ctx, ctx.spec.excite.sweep_s + k as f64)?, &mut rng))
    };
    (0..count).map(one).collect()
}
