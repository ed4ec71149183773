//! The run folder of an optimisation.

use dynocal_files::csv_io;
use dynocal_files::plan;
use dynocal_files::run_folder::RunFolder;
use dynocal_ident::data::Role;
use dynocal_ident::plan::{Plan, PlanChannel, PlanDemand, demand_name};

use super::page;
use super::result::{OptimiseJobError, Optimised};
use super::spec::Job;

/// Name of the plan and of the record of the optimum.
const NAME: &str = "optimum";

/// Writes plan, optimum, prices, page and summary. A search that did not end at an optimum leaves no plan behind.
///
/// # Errors
/// [`OptimiseJobError::Files`], [`OptimiseJobError::Page`].
pub fn write(job: &Job, found: &Optimised) -> Result<RunFolder, OptimiseJobError> {
    let folder = RunFolder::open_at(&job.out, "optimise", job)?;
    let mut files = vec!["report.html".to_string(), format!("{NAME}.csv")];
    record(&folder.path().join(format!("{NAME}.csv")), found)?;
    if found.status.is_success() {
        plan::write(folder.path(), &plan_of(found))?;
        files.extend(["csv", "json"].map(|ending| format!("{NAME}.plan.{ending}")));
    }
    if found.optimum.prices.iter().any(|p| !p.by_sample.is_empty()) {
        prices(&folder.path().join("prices.csv"), found)?;
        files.push("prices.csv".into());
    }
    page::write(found, folder.path())?;
    // What an earlier run left and this one does not give would pass for its result.
    for earlier in [format!("{NAME}.plan.csv"), format!("{NAME}.plan.json"), "prices.csv".into()] {
        if !files.contains(&earlier) {
            // Not there is as good as removed.
            let _ = std::fs::remove_file(folder.path().join(earlier));
        }
    }
    folder.write_summary(&Optimised { files, ..found.clone() })?;
    Ok(folder)
}

/// The optimum as a plan: optimal inputs within their ranges and rates, given channels as they were, demands beside them.
/// It has no loops and no abort rules: an optimum stands at its limits, and a rule without a margin would end it there.
pub fn plan_of(found: &Optimised) -> Plan {
    let (o, p) = (&found.optimum, &found.problem);
    let inputs = o.inputs.iter().zip(&p.inputs).map(|(c, i)| PlanChannel {
        rate_per_s: i.rate_per_s,
        ..PlanChannel::free(&c.name, &c.unit, c.values.clone()).within(i.lower, i.upper)
    });
    let given = p.given.iter().filter_map(|g| {
        let values = found.start.values(&g.name).ok()?.to_vec();
        Some(PlanChannel::free(&g.name, &g.unit, values))
    });
    let demands = o.demands.iter().map(|d| PlanDemand {
        output: d.name.clone(),
        unit: d.unit.clone(),
        values: d.values.clone(),
    });
    Plan::open_loop(NAME, o.sample_time_s, inputs.chain(given).collect())
        .with_loops(demands.collect(), Vec::new())
}

/// Time, optimal inputs, responses of the models, demands, inputs of the start.
fn record(path: &std::path::Path, found: &Optimised) -> Result<(), OptimiseJobError> {
    let o = &found.optimum;
    let time = time(found);
    let mut names: Vec<(String, &str, &[f64])> = vec![("time".into(), "s", &time)];
    names.extend(o.inputs.iter().map(|c| (c.name.clone(), c.unit.as_str(), c.values.as_slice())));
    for g in &found.problem.given {
        names.push((g.name.clone(), &g.unit, found.start.values(&g.name)?));
    }
    names.extend(o.responses.iter().map(|c| (c.name.clone(), c.unit.as_str(), c.values.as_slice())));
    // The least and the greatest of an output over the draws.
    let drawn = o.outputs.iter().filter(|c| c.role == Role::Auxiliary);
    names.extend(drawn.map(|c| (c.name.clone(), c.unit.as_str(), c.values.as_slice())));
    names.extend(o.demands.iter().map(|c| (demand_name(&c.name), c.unit.as_str(), c.values.as_slice())));
    for c in &o.inputs {
        names.push((format!("{}_start", c.name), &c.unit, found.start.values(&c.name)?));
    }
    let columns: Vec<(&str, &str, &[f64])> = names.iter().map(|(n, u, v)| (n.as_str(), *u, *v)).collect();
    csv_io::write_columns(path, &columns)?;
    Ok(())
}

fn time(found: &Optimised) -> Vec<f64> {
    (0..found.record.samples).map(|t| t as f64 * found.record.sample_time_s).collect()
}

/// Time and the price of each demand and bound at each sample.
fn prices(path: &std::path::Path, found: &Optimised) -> Result<(), OptimiseJobError> {
    let (n, time) = (found.record.samples, time(found));
    let by_sample = found.optimum.prices.iter().filter(|p| p.by_sample.len() >= n);
    let named: Vec<(String, String, &[f64])> = by_sample
        .map(|p| (format!("{}_{}", p.channel, p.of), format!("1/({})", p.unit), &p.by_sample[..n]))
        .collect();
    let mut columns: Vec<(&str, &str, &[f64])> = vec![("time", "s", &time)];
    columns.extend(named.iter().map(|(n, u, v)| (n.as_str(), u.as_str(), *v)));
    csv_io::write_columns(path, &columns)?;
    Ok(())
}
