//! Step 1: identification and validation records in closed loop.

use super::context::{ChainError, Context, RecordRef, gains, save_records};
use dynocal_calib::control::LoopGains;
use dynocal_calib::excite::{References, plan_of, references};
use dynocal_calib::record::{Demand, engine_plan};
use dynocal_ident::data::Dataset;
use dynocal_numerics::rng::Rng64;
use rayon::prelude::*;
use serde::{Deserialize, Serialize};
use std::path::Path;

/// What step 1 leaves behind.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct ExciteResult {
    /// Identification records.
    pub identification: Vec<RecordRef>,
    /// Validation records of other seeds and speed periods.
    pub validation: Vec<RecordRef>,
    /// Bed time of the identification records in s.
    pub identification_bed_s: f64,
    /// Bed time of the validation records in s.
    pub validation_bed_s: f64,
}

/// Time before a record in which the loops find the first operating point, in s.
pub const LEAD_IN_S: f64 = 3.0;

/// Stream numbers of the random generator: one per record, far apart per purpose.
mod stream {
    pub(super) const IDENTIFICATION: u64 = 100;
    pub(super) const VALIDATION: u64 = 200;
}

/// Runs the step: all records, independent of each other and hence in parallel.
///
/// # Errors
/// [`ChainError`].
pub fn excite(ctx: &Context, folder: &Path) -> Result<ExciteResult, ChainError> {
    let spec = &ctx.spec.excite;
    let total = spec.identification_records + spec.validation_records;
    let done = std::sync::atomic::AtomicUsize::new(0);
    let records = (0..total)
        .into_par_iter()
        .map(|k| {
            let (name, references) = record_references(ctx, k)?;
            let record = run(ctx, folder, &name, &references)?;
            let done = done.fetch_add(1, std::sync::atomic::Ordering::Relaxed) + 1;
            (ctx.tell)(super::context::Event::Fraction(done as f64 / total as f64));
            Ok(record)
        })
        .collect::<Vec<Result<Dataset, ChainError>>>()
        .into_iter()
        .collect::<Result<Vec<_>, _>>()?;
    let (identification, validation) = records.split_at(spec.identification_records);
    let bed_s = |n: usize| n as f64 * (spec.record_s + LEAD_IN_S);
    Ok(ExciteResult {
        identification: save_records(folder, identification)?,
        validation: save_records(folder, validation)?,
        identification_bed_s: bed_s(spec.identification_records),
        validation_bed_s: bed_s(spec.validation_records),
    })
}

/// Name and references of record `k`: identification records first.
fn record_references(ctx: &Context, k: usize) -> Result<(String, References), ChainError> {
    let spec = &ctx.spec.excite;
    let ident = spec.identification_records;
    let (name, number, sweep_s) = if k < ident {
        // Sweeps of different periods, so that speed and the 3 s levels do not repeat together.
        (format!("ident{:02}", k + 1), stream::IDENTIFICATION + k as u64, spec.sweep_s + k as f64)
    } else {
        let v = k - ident;
        (format!("val{:02}", v + 1), stream::VALIDATION + v as u64, spec.sweep_s - 1.0 + 1.7 * v as f64)
    };
    let mut rng = Rng64::stream(ctx.spec.seed, number);
    Ok((name, references(spec, sweep_s, ctx.spec.sample_time_s, &mut rng)?))
}

/// One more identification record by the same recipe, of a stream of its own.
///
/// # Errors
/// [`ChainError`].
pub fn extra_record(ctx: &Context, folder: &Path, name: &str, number: u64) -> Result<Dataset, ChainError> {
    let spec = &ctx.spec.excite;
    let mut rng = Rng64::stream(ctx.spec.seed, stream::IDENTIFICATION + 50 + number);
    let references = references(spec, spec.sweep_s + 0.5, ctx.spec.sample_time_s, &mut rng)?;
    run(ctx, folder, name, &references)
}

fn run(ctx: &Context, folder: &Path, name: &str, references: &References) -> Result<Dataset, ChainError> {
    let gains = gains(&ctx.spec.excite.gains)?;
    through_loops(ctx, folder, name, &plan_of(references), &references.demand, gains)
}

/// Runs a demand through loops with `gains` over a feedforward.
///
/// # Errors
/// [`ChainError`].
pub fn through_loops(
    ctx: &Context,
    folder: &Path,
    name: &str,
    feedforward: &[[f64; 4]],
    demand: &[Demand],
    gains: LoopGains,
) -> Result<Dataset, ChainError> {
    let limits = ctx.actuator_limits();
    let plan = engine_plan(name, ctx.spec.sample_time_s, feedforward, demand, gains, limits, LEAD_IN_S);
    let mut record = ctx.measure(folder, &plan, true)?;
    record.init_samples = ctx.spec.identify.init_samples;
    Ok(record)
}
