//! The design as a plan: the two files that a player takes (`dynocal engine transient`, a bed).

use std::path::Path;

use dynocal_files::{FilesError, plan};
use dynocal_ident::data::Dataset;
use dynocal_ident::plan::{Plan, PlanChannel, PlanLimit};
use dynocal_numerics::interval::Interval;

use super::Job;
use super::result::Designed;

/// Time at the first row before the record: the design assumes that the inputs have stood there (convention `hold`).
const SETTLE_S: f64 = 3.0;

/// Writes `design.plan.csv` and `design.plan.json`: the inputs open loop within their ranges, the limits of the outputs as
/// reasons to end.
///
/// # Errors
/// [`FilesError`].
pub(super) fn write(job: &Job, designed: &Designed, data: &Dataset, folder: &Path) -> Result<(), FilesError> {
    let channels = data
        .channels
        .iter()
        .zip(&job.channels)
        .map(|(d, c)| {
            let free = PlanChannel::free(&d.name, &d.unit, d.values.clone());
            if c.file.is_some() { free } else { free.within(c.channel.lower, c.channel.upper) }
        })
        .collect();
    let limits: Vec<PlanLimit> = designed
        .safety
        .iter()
        .filter_map(|s| {
            let Interval { lower, upper } = s.limits?;
            Some(PlanLimit::between(&s.output.name, &s.output.unit, lower, upper, 0.0))
        })
        .collect();
    let outputs: Vec<&str> = designed.safety.iter().map(|s| s.output.name.as_str()).collect();
    let made = Plan::open_loop("design", job.sample_time_s, channels)
        .settled(SETTLE_S)
        .recording(&outputs)
        .with_limits(limits);
    plan::write(folder, &made)?;
    Ok(())
}
