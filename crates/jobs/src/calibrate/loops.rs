//! Gains of the loops where the spec gives none: a short identification on the plant at the ends of the range.

use std::path::Path;

use super::context::{Context, Tone};
use super::error::ChainError;
use super::records::{all_measured, noise_seed};
use dynocal_calib::gains::{self, Tuned};
use dynocal_calib::validate::{inner, reference_row};
use dynocal_ident::plan::Plan;

/// Parts of the range of the leading demand and of the first given channel that are left out at either end: where the static
/// map has its outermost points.
const LEFT_OUT: (f64, f64) = (0.125, 0.05);

/// Gains of all loops; none where the spec has them. On a real bed the tests are plans that wait for their records.
///
/// # Errors
/// [`ChainError`].
pub(super) fn tuned(ctx: &Context, folder: &Path) -> Result<Option<Tuned>, ChainError> {
    if ctx.spec.loops.iter().all(|l| l.gains.is_some()) {
        return Ok(None);
    }
    let (plans, spec, seed) = (points(ctx)?, &ctx.spec.tune, ctx.spec.seed);
    let found = if ctx.plants.is_some() {
        let mut plant = ctx.plant(true)?;
        plant.reset(noise_seed(seed, "gains"));
        gains::tune(plant.as_mut(), &plans, spec, seed, &|| ctx.watch.interrupted())?
    } else {
        let measured = |(k, p)| ctx.measure(folder, &gains::test_plan(p, spec, seed, k), true);
        let records = all_measured(plans.iter().enumerate().map(measured).collect())?;
        gains::from_tests(&plans, &records, spec)?
    };
    let loops = found
        .loops
        .iter()
        .map(|l| format!("{} by {}: ki {:.4}, kp {:.4}", l.output, l.input, l.gains.ki, l.gains.kp));
    ctx.watch.note(&format!("gains of the loops: {}", loops.collect::<Vec<_>>().join("; ")));
    Ok(Some(found))
}

/// The ends of the leading demand at the ends of the first given channel, everything else in its middle.
fn points(ctx: &Context) -> Result<Vec<Plan>, ChainError> {
    let (spec, problem) = (ctx.spec, &ctx.spec.problem);
    let or = |name: &str, own: (f64, f64)| spec.excite.ranges.get(name).copied().unwrap_or(own);
    let lead = problem.demands.first().map(|d| inner(or(&d.output, (d.lower, d.upper)), LEFT_OUT.0));
    let given = problem.given.first().map(|g| inner(or(&g.name, (g.lower, g.upper)), LEFT_OUT.1));
    // What waits for records of a bed is open loop: the demand does not matter.
    let lead = if ctx.plants.is_some() { lead } else { lead.map(|(a, b)| (0.5 * (a + b), 0.5 * (a + b))) };
    let ends = |range: Option<(f64, f64)>| match range {
        None => vec![None],
        Some((a, b)) if a == b => vec![Some(a)],
        Some((a, b)) => vec![Some(a), Some(b)],
    };
    let mut inputs: Vec<Vec<f64>> = ctx.start_inputs()?.into_iter().map(|v| vec![v]).collect();
    for &k in &ctx.channels.free {
        let i = &problem.inputs[k];
        let (a, b) = or(&i.name, (i.lower, i.upper));
        inputs[k] = vec![0.5 * (a + b)];
    }
    let mut plans = Vec::new();
    for level in ends(lead) {
        for at in ends(given) {
            let row = reference_row(problem, level.unwrap_or(0.0), at);
            let (demands, given) = row.split_at(ctx.channels.demands.len());
            let columns = |values: &[f64]| values.iter().map(|v| vec![*v]).collect();
            let name = format!("gains{:02}", plans.len() + 1);
            plans.push(ctx.plan(&name, inputs.clone(), columns(given), columns(demands), Tone::Lead));
        }
    }
    Ok(plans)
}
