//! Steps of the demands with every loop closed: what a user of all loops gets, whatever each would do alone.

use dynocal_control::closed::Closed;
use dynocal_control::plane::Channel;
use dynocal_control::simulate::{run, settling_s};
use dynocal_control::tune::{followed, step_run};

use super::load::Loaded;
use super::loops::controller;
use super::result::{ControlJobError, LoopResult, StepResult, Together};
use super::spec::Job;

/// Share of the step within which it counts as settled.
const SETTLED: f64 = 0.02;
/// Rows of the first run, how much longer the next is, and most of them. A time is taken once it is a tenth of its run.
const ROWS: (usize, usize, usize) = (2000, 10, 200_000);

/// Step in s that follows the fastest loop of all set points; none without a channel.
fn step_of(job: &Job, loaded: &Loaded, loops: &[LoopResult]) -> Option<f64> {
    let one = |(k, l): (usize, &LoopResult)| {
        let channel = |p: &super::load::AtPoint| {
            let own = super::decouple::channel(loaded, &p.nominal, k).ok()?;
            Channel::new(loaded.time, own.scaled(l.sign)).ok()
        };
        let channels: Vec<Channel> = loaded.points.iter().filter_map(channel).collect();
        let lags: Vec<_> = l.lags.iter().flatten().copied().collect();
        let r = step_run(&channels, &lags);
        let each = channels.iter().enumerate().map(|(i, c)| followed(c, &l.gains_at(i), r).step_s);
        each.reduce(f64::min)
    };
    loops.iter().take(job.loops.len()).enumerate().filter_map(one).reduce(f64::min)
}

/// Fills in how each loop follows a step of its demand at every set point that is stable, all loops closed.
///
/// # Errors
/// [`ControlJobError::Point`]: a controller that is no system.
pub(super) fn steps(
    job: &Job,
    loaded: &Loaded,
    loops: &[LoopResult],
    together: &mut [Together],
) -> Result<(), ControlJobError> {
    let Some(step_s) = step_of(job, loaded, loops) else { return Ok(()) };
    for (i, (p, t)) in
        loaded.points.iter().zip(together).enumerate().filter(|(_, (_, t))| !t.loops.is_empty())
    {
        let refused = |source| ControlJobError::Point { point: p.name.clone(), source };
        let controller = controller(job, loaded, loops, i).map_err(refused)?;
        let closed = Closed::in_time(p.nominal.clone(), controller);
        // What cannot be run (a delay that is no whole number of samples) is judged loop by loop.
        let each: Option<Vec<StepResult>> = (0..loops.len()).map(|k| step(&closed, k, step_s)).collect();
        t.steps = each.unwrap_or_default();
    }
    Ok(())
}

/// Answer of output `k` to a step of its demand; none where there is no run.
fn step(closed: &Closed, k: usize, step_s: f64) -> Option<StepResult> {
    let n = closed.plant.outputs;
    let mut rows = ROWS.0;
    loop {
        let demand = |_: usize, r: &mut [f64]| (0..r.len()).for_each(|j| r[j] = f64::from(u8::from(j == k)));
        let found = run(closed, step_s, rows, &demand, &|_, d| d.fill(0.0)).ok()?;
        let settled = settling_s(&found.y, n, k, found.step_s, 1.0, SETTLED);
        let soon = settled.is_some_and(|s| s < 0.1 * found.step_s * rows as f64);
        if soon || rows >= ROWS.2 {
            let top = found.y.iter().skip(k).step_by(n).copied().fold(f64::NEG_INFINITY, f64::max);
            return Some(StepResult { settling_s: settled, overshoot: top - 1.0 });
        }
        rows = (rows * ROWS.1).min(ROWS.2);
    }
}
