//! `dynocal sequential`: rounds of design and measurement on a plant, with a stop rule.

use std::path::PathBuf;

use clap::{ArgMatches, Args, FromArgMatches};
use dynocal_jobs::sequential::{estimate::estimate, run as play, spec};
use dynocal_report::significant;

use super::Verb;
use crate::common::{Check, Common, show_plan};
use crate::failure::{Exit, Failure, exit};
use crate::table;
use crate::terminal::{print, say};

pub(crate) const VERB: Verb =
    Verb { name: "sequential", describe: |c| Sequential::augment_args(c.about(ABOUT)), run };

const ABOUT: &str = "Identify, design the next record, measure it, again, until the next one is worth too little";

#[derive(Args, Debug)]
struct Sequential {
    /// Spec of the campaign (TOML, docs/sequential.md)
    spec: PathBuf,
    #[command(flatten)]
    plan: Check,
    #[command(flatten)]
    common: Common,
}

fn run(matches: &ArgMatches) -> Result<Exit, Failure> {
    let args = Sequential::from_arg_matches(matches)?;
    let progress = args.common.start()?;
    let job = spec::read(&args.spec, &args.common.overrides())?;
    let plan = estimate(&job)?;
    if args.plan.check {
        return show_plan(&plan, &job.out, "sequential", &args.common);
    }
    plan.allowed()?;
    let (found, folder) = progress.during(|watch| play(&job, watch))?;
    for warning in &found.warnings {
        say(&format!("warning: {warning}"));
    }
    args.common.print_summary(&folder.path().join("summary.json"))?;
    if args.common.shows_text() {
        let number = |v: Option<f64>| v.map_or("-".into(), |v| significant(v, 4));
        let row = |o: &dynocal_jobs::sequential::result::OutputLine| {
            let errors = [o.rmse_first, o.rmse_designed, o.rmse_random].map(number);
            [vec![o.output.clone(), o.unit.clone()], errors.to_vec()].concat()
        };
        let rows: Vec<Vec<String>> = found.outputs.iter().map(row).collect();
        let header = ["output", "unit", "first record", "designed", "random instead"];
        print(&format!("{}\n\n", found.verdict))?;
        print(&table::render(&header, &rows, &[2, 3, 4]))?;
        print(&format!("\nreport: {}\n", folder.path().join("report.html").display()))?;
    }
    Ok(exit(found.valid))
}
