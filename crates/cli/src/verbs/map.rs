//! `dynocal map SPEC`: steady calibration, from a day on the bed to maps.

use std::path::PathBuf;

use clap::{ArgMatches, Args, FromArgMatches};
use dynocal_jobs::map::{MapError, estimate::estimate, job, run as calibrate, work};

use super::Verb;
use crate::common::{Check, Common, show_plan};
use crate::failure::{Exit, Failure, exit};
use crate::terminal::{print, say};

pub(crate) const VERB: Verb = Verb { name: "map", describe: |c| Map::augment_args(c.about(ABOUT)), run };

const ABOUT: &str = "Steady calibration: a day of points on the bed, response models, the optimum of every cell, verified maps";

#[derive(Args, Debug)]
struct Map {
    /// Spec of the calibration (TOML, docs/map.md)
    spec: PathBuf,
    #[command(flatten)]
    plan: Check,
    #[command(flatten)]
    common: Common,
}

fn run(matches: &ArgMatches) -> Result<Exit, Failure> {
    let args = Map::from_arg_matches(matches)?;
    let progress = args.common.start()?;
    let job = job::read(&args.spec, &args.common.overrides())?;
    let mut plan = estimate(&job);
    if args.plan.check {
        work::lacks(&job)?;
        for work::Given { file, points, usable } in work::given(&job)? {
            let fewer = if usable < points { format!(", {usable} of them can be used") } else { String::new() };
            plan = plan.line("measured", format!("{file}: {points} points{fewer}"));
        }
        return show_plan(&plan, &job.out, "map", &args.common);
    }
    plan.allowed()?;
    let (found, folder) = match progress.during(|watch| calibrate(&job, watch)) {
        // The day is not over: a bed has to measure first.
        Err(e @ MapError::NeedsMeasurement { .. }) => {
            if args.common.json {
                print(&format!("{}\n", waiting(&job.name, &e)))?;
            }
            Failure::from(e).print();
            return Ok(Exit::NotValid);
        }
        Err(e @ MapError::Interrupted) => {
            let hint = "the same command goes on with the points that are measured; they are kept in";
            return Err(Failure::from(e).hint(format!("{hint} `{}`", job.out.display())));
        }
        other => other?,
    };
    if !args.common.quiet {
        for warning in &found.warnings {
            say(&format!("warning: {warning}"));
        }
    }
    args.common.print_summary(&folder.path().join("summary.json"))?;
    if args.common.shows_text() {
        print(&format!("{}\n\nreport: {}\n", found.verdict, folder.path().join("report.html").display()))?;
    }
    Ok(exit(found.valid))
}

/// The state of a day that waits for a bed, as `--json` prints it in place of a summary.
fn waiting(name: &str, e: &MapError) -> String {
    let MapError::NeedsMeasurement { count, plan, measured, channels, .. } = e else { return String::new() };
    let state = serde_json::json!({
        "schema": "dynocal/waiting",
        "schema_version": 1,
        "verb": "map",
        "name": name,
        "state": "waiting",
        "points": count,
        "plan": plan,
        "measured": measured,
        "channels": channels.split(", ").collect::<Vec<_>>(),
    });
    serde_json::to_string_pretty(&state).unwrap_or_default()
}
