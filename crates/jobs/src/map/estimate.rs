//! What a steady calibration takes, before it runs.

use super::budget::Budget;
use super::job::Job;
use crate::estimate::Estimate;

/// The day with its bed time. The largest work is that of the models: nested folds of every candidate, each with factorisations
/// of all points.
pub fn estimate(job: &Job) -> Estimate {
    let s = &job.spec;
    let a = &s.bed.approach;
    let free: Vec<&str> = s
        .problem
        .inputs
        .iter()
        .filter(|i| !s.loops.iter().any(|l| l.input == i.name))
        .map(|i| i.name.as_str())
        .collect();
    let budget = Budget::of(s);
    let (planned, follow) = budget.map_or((0, 0), |b| (b.planned, b.followed));
    let repeats: usize = budget.map_or(0, |b| b.repeats.iter().sum());
    let points = s.bed.points as f64;
    // In the order of maps: the demand, then the given channel.
    let axes: Vec<Vec<f64>> = s
        .problem
        .demand_names()
        .iter()
        .chain(&s.problem.given_names())
        .filter_map(|n| s.axes.get(n).cloned())
        .collect();
    // Points that follow models may be approached over a corner.
    let corners_s = (follow + s.verify.points) as f64 * a.ramp_s;
    let most_s =
        points * (a.ramp_s + a.settle_s + a.average_s) + corners_s + super::line_time::expected_s(s, &axes);
    let most_s = most_s.min(60.0 * s.bed.minutes);
    let axes = s.axes.iter().map(|(name, v)| format!("{name} ({})", v.len()));
    let held: Vec<String> = s.held.iter().map(|(name, v)| format!("{name} = {v}")).collect();
    // One without bounds is measured, and limits nothing.
    let bound = s.problem.limits.iter().filter(|l| l.lower.is_some() || l.upper.is_some());
    let limits: Vec<String> = bound.map(|l| l.output.clone()).collect();
    let responses = (s.loops.len() + s.problem.limits.len() + s.problem.minimise.len()) as f64;
    let cells: usize = s.axes.values().map(Vec::len).product();
    let folds = s.models.folds as f64;
    // What a polynomial takes is little beside it.
    let processes = s
        .models
        .candidates
        .iter()
        .filter(|c| c.get("kind").and_then(|k| k.as_str()) == Some("gaussian_process"));
    let processes = processes.count().max(1) as f64;
    let fits = responses * processes * (folds * folds + 2.0 * folds + 1.0);
    let given = s.loops.iter().all(|l| l.gains.is_some());
    Estimate::new(&job.name)
        .line("run folder", job.out.display().to_string())
        .line("plant", job.plant())
        .line("axes", axes.collect::<Vec<_>>().join(", "))
        .line("held", if held.is_empty() { "nothing".into() } else { held.join(", ") })
        .line("optimised", free.join(", "))
        .line("limits", if limits.is_empty() { "none".into() } else { limits.join(", ") })
        .line(
            "gains of the loops",
            match (s.plant.name == "bed", given) {
                (true, _) => "those of the bed",
                (_, true) => "as given",
                _ => "found on the plant",
            },
        )
        .line(
            "points",
            format!(
                "{planned} planned, {follow} at the expected optimum, {repeats} repeats, {} to verify",
                s.verify.points
            ),
        )
        .line("bed time", format!("at most about {:.0} min", most_s / 60.0))
        .memory(8.0 * points * points * 10.0)
        .work(fits * 300.0 * points.powi(3) + cells as f64 * s.optimise.starts as f64 * 1e6)
}
