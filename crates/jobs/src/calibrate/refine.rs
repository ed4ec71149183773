//! The map refined (thesis section 7.8.2): records that the map itself drives, with the loops about it, teach the next map.

use super::context::{Context, Tone};
use super::error::ChainError;
use super::records::{RecordRef, save_records};
use dynocal_calib::map::FeedforwardMap;
use dynocal_calib::map::filter::filtered;
use dynocal_calib::map::structures::MapError;
use dynocal_calib::validate::{ValidateSpec, random_points};
use dynocal_ident::data::Dataset;
use dynocal_numerics::rng::Rng64;
use std::path::Path;

/// Time at a point in s: long enough to end at rest, which is where an offset is seen.
const POINT_S: f64 = 3.0;

/// Record number `k` (from 1): points over the whole range of the problem, inputs by the map, loops that trim to the demand as the map
/// filters it.
///
/// # Errors
/// [`ChainError`].
pub(super) fn driven(
    ctx: &Context,
    folder: &Path,
    k: usize,
    map: &dyn FeedforwardMap,
) -> Result<(Dataset, RecordRef), ChainError> {
    let (spec, problem, dt) = (ctx.spec, &ctx.spec.problem, ctx.spec.sample_time_s);
    let points = (spec.optimise.record_s / POINT_S).ceil().max(2.0) as usize;
    let range = |(lower, upper): (f64, f64)| Some(dynocal_numerics::interval::Interval::new(lower, upper));
    let asked = ValidateSpec {
        points,
        point_s: POINT_S,
        demand: problem.demands.first().and_then(|d| range((d.lower, d.upper))),
        given: problem.given.first().and_then(|g| range((g.lower, g.upper))),
        ..ValidateSpec::default()
    };
    let mut rng = Rng64::stream(spec.seed, 450 + k as u64);
    let reference = random_points(&asked, problem, dt, &mut rng).reference;
    let drive = map.drive(&reference, dt);
    let structure = spec.invert.built().map_err(MapError::from)?;
    let demands = problem.demands.iter().enumerate();
    let demands =
        demands.map(|(d, port)| filtered(&reference.column(d), &structure.filter_s(&port.output, d), dt));
    let given = (0..problem.given.len()).map(|g| reference.column(problem.demands.len() + g));
    let inputs = (0..drive.width()).map(|u| drive.column(u)).collect();
    let plan = ctx.plan(&format!("refine{k}"), inputs, given.collect(), demands.collect(), Tone::Trim);
    let record = ctx.measure(folder, &plan, true)?;
    let mut refs = save_records(folder, std::slice::from_ref(&record))?;
    match refs.pop() {
        Some(kept) => Ok((record, kept)),
        None => Err(ChainError::Design("a record that refines was not kept".into())),
    }
}
