//! What a pass of the optimisation plays: a record of references and the optimum over it, as the models have it.

use super::context::Context;
use super::error::ChainError;
use super::optimise_start::start_record;
use dynocal_calib::optimise::{DemandFrom, OptimiseOptions, Optimum, optimise_record};
use dynocal_calib::validate::inner;
use dynocal_ident::data::{Channel, Dataset};
use dynocal_ident::stored::StoredModel;
use std::path::PathBuf;

/// Largest violation of a demand at which an optimum counts as feasible, as a share of its range. It
/// is small beside what models and sensors are off by.
pub const VIOLATION: f64 = 1e-3;

/// Samples at the end of a record that count for nothing: what is applied there acts after the end, so that the optimum
/// leaves it out.
pub const END_EFFECT: usize = 12;

/// Records of references that are drawn for one pass at most.
const DRAWS: usize = 2;

/// A record with its optimum.
pub(super) struct Planned {
    pub(super) start: Dataset,
    pub(super) optimum: Optimum,
    /// Records that were drawn.
    pub(super) draws: usize,
}

/// The optimum over a record of references; where the models find none, over another one, and last with demands that give way. The references only have to lead through
/// the operating range: one that the models do not reach is no loss.
pub(super) fn planned(
    ctx: &Context,
    k: usize,
    models: &[&StoredModel],
    data: &[(Dataset, PathBuf)],
) -> Result<Planned, ChainError> {
    let spec = &ctx.spec.optimise;
    let exact = OptimiseOptions {
        demand: DemandFrom::Within,
        max_iterations: spec.max_iterations,
        tolerance: spec.tolerance,
        smoothing: spec.smoothing,
        // What is missing where no way is found is not asked: another record is tried.
        explain: false,
        // What an optimum does because nobody looks beyond its end it does out of sight.
        extend_s: END_EFFECT as f64 * ctx.spec.sample_time_s,
        ..OptimiseOptions::default()
    };
    // A record on which an exact search does not end leads to the edge of what the models know: another one goes first.
    let exactly = (0..DRAWS).map(|draw| (draw, exact));
    let tries = exactly.chain((spec.give > 0.0).then_some((0, OptimiseOptions { give: spec.give, ..exact })));
    let (mut found, mut fault): (Option<Planned>, _) = (None, None);
    for (draw, options) in tries {
        let start = start_record(ctx, k, draw, models, data)?;
        let result =
            optimise_record(&ctx.spec.problem, models, &start, &options, &|| ctx.watch.interrupted());
        ctx.check_interrupt()?;
        let optimum = match result {
            Ok(optimum) => optimum,
            Err(e) => {
                fault = Some(e);
                continue;
            }
        };
        let draws = draw + 1;
        if optimum.status.is_success() && missed(ctx, &optimum).is_none() {
            return Ok(Planned { start, optimum, draws });
        }
        let less = |p: &Planned| worst(ctx, &optimum) < worst(ctx, &p.optimum);
        if found.as_ref().is_none_or(less) {
            found = Some(Planned { start, optimum, draws });
        }
    }
    match (found, fault) {
        (Some(found), _) => Ok(Planned { draws: DRAWS, ..found }),
        (None, Some(e)) => Err(e.into()),
        (None, None) => Err(ChainError::Design("no record of references was drawn".into())),
    }
}

/// The first output that misses its demand, or a limit, on the models.
fn missed(ctx: &Context, optimum: &Optimum) -> Option<String> {
    let of = |output: &String| !(optimum.violation(output) <= VIOLATION * range_of(ctx, output));
    ctx.channels.outputs().into_iter().find(of)
}

/// The largest miss, as a share of the range of its demand.
fn worst(ctx: &Context, optimum: &Optimum) -> f64 {
    let outputs = ctx.channels.outputs();
    outputs.iter().map(|o| optimum.violation(o) / range_of(ctx, o)).fold(0.0, f64::max)
}

/// Range of the demand of an output; 1 where it has none.
pub(super) fn range_of(ctx: &Context, output: &str) -> f64 {
    let d = ctx.spec.problem.demands.iter().find(|d| d.output == output);
    d.map_or(1.0, |d| d.upper - d.lower)
}

/// Demands of an optimum as loops are asked to hold them: a search that found no way may end with short peaks far outside, which
/// nobody wants a plant to follow.
pub(super) fn within_reach(ctx: &Context, optimum: &Optimum) -> Vec<Vec<f64>> {
    let ranges = ctx.spec.problem.demands.iter().map(|d| inner((d.lower, d.upper), -BEYOND));
    let one = |(c, (lower, upper)): (&Channel, (f64, f64))| {
        c.values.iter().map(|v| v.clamp(lower, upper)).collect()
    };
    optimum.demands.iter().zip(ranges).map(one).collect()
}

/// Share of its range by which a demand may lie outside of it when it is played: as far as the optimisation lets it.
const BEYOND: f64 = 0.5;
