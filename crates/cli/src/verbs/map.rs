//! `dynocal map SPEC`: steady calibration, from a day on the bed to maps.

use std::path::PathBuf;

use clap::{ArgMatches, Args, FromArgMatches};
use dynocal_jobs::map::{MapError, estimate::estimate, job, run as calibrate};

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
    let plan = estimate(&job);
    if args.plan.check {
        return show_plan(&plan);
    }
    plan.allowed()?;
    let (found, folder) = match progress.during(|watch| calibrate(&job, watch)) {
        // The day is not over: a bed has to measure first.
        Err(e @ MapError::NeedsMeasurement { .. }) => {
            Failure::from(e).print();
            return Ok(Exit::NotValid);
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
