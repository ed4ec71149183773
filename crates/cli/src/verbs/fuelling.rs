//! `dynocal fuelling`: fuel by measured states, identified from records or on a plant.

use std::path::PathBuf;

use clap::{ArgMatches, Args, FromArgMatches};
use dynocal_jobs::fuelling::work::estimate;
use dynocal_jobs::fuelling::{Fuelled, run as fuelling, spec};
use dynocal_report::significant;

use super::Verb;
use crate::common::{Check, Common, show_plan};
use crate::failure::{Exit, Failure, exit};
use crate::table;
use crate::terminal::{print, say};

pub(crate) const VERB: Verb =
    Verb { name: "fuelling", describe: |c| Fuelling::augment_args(c.about(ABOUT)), run };

const ABOUT: &str = "Identify air charge, manifold, fuel film and lambda sensor, and the fuel that inverts them";

#[derive(Args, Debug)]
struct Fuelling {
    /// Spec: records of a bed, or a plant that is driven (TOML)
    spec: PathBuf,
    #[command(flatten)]
    plan: Check,
    #[command(flatten)]
    common: Common,
}

fn run(matches: &ArgMatches) -> Result<Exit, Failure> {
    let args = Fuelling::from_arg_matches(matches)?;
    let progress = args.common.start()?;
    let job = spec::read(&args.spec, &args.common.overrides())?;
    if args.plan.check {
        return show_plan(&estimate(&job)?, &job.out, "fuelling", &args.common);
    }
    let (found, folder) = progress.during(|watch| fuelling(&job, watch))?;
    for warning in &found.warnings {
        say(&format!("warning: {warning}"));
    }
    args.common.print_summary(&folder.path().join("summary.json"))?;
    if args.common.shows_text() {
        print(&text(&found))?;
        print(&format!("\nreport: {}\n", folder.path().join("report.html").display()))?;
    }
    Ok(exit(found.valid))
}

fn text(found: &Fuelled) -> String {
    let percent = |v: f64| significant(100.0 * v, 3);
    let scores: Vec<Vec<String>> = found
        .scores
        .iter()
        .map(|s| vec![s.record.clone(), s.role.into(), percent(s.rms), percent(s.rms_without_film)])
        .collect();
    let header = ["record", "role", "error of 1 / lambda [%]", "without a film [%]"];
    let mut out = format!("{}\n\n{}", found.verdict.join("\n"), table::render(&header, &scores, &[2, 3]));
    if !found.driven.is_empty() {
        let rows: Vec<Vec<String>> = found
            .driven
            .iter()
            .map(|d| vec![d.name.clone(), d.setting.clone(), percent(d.mean), percent(d.lean), percent(d.rich)])
            .collect();
        let header = ["driven by", "tuned", "mean |lambda - 1| [%]", "leanest [%]", "richest [%]"];
        out.push_str(&format!("\n{}", table::render(&header, &rows, &[2, 3, 4])));
    }
    out
}
