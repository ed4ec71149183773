//! `dynocal optimise`: optimal inputs over a record, for stored models and a calibration problem.

use std::path::PathBuf;

use clap::{ArgMatches, Args, FromArgMatches};
use dynocal_jobs::optimise::{Optimised, estimate, run as optimise, spec};
use dynocal_report::significant;

use super::Verb;
use crate::common::{Check, Common, show_plan};
use crate::failure::{Exit, Failure, exit};
use crate::table;
use crate::terminal::{print, say};

pub(crate) const VERB: Verb =
    Verb { name: "optimise", describe: |c| Optimise::augment_args(c.about(ABOUT)), run };

const ABOUT: &str = "Optimise the inputs of a whole record on stored models, within limits and rates";

#[derive(Args, Debug)]
struct Optimise {
    /// Spec of the optimisation (TOML)
    spec: PathBuf,
    #[command(flatten)]
    check: Check,
    #[command(flatten)]
    common: Common,
}

fn run(matches: &ArgMatches) -> Result<Exit, Failure> {
    let args = Optimise::from_arg_matches(matches)?;
    let progress = args.common.start()?;
    let job = spec::read(&args.spec, &args.common.overrides())?;
    if args.check.check {
        return show_plan(&estimate(&job)?, &job.out, "optimise", &args.common);
    }
    let (found, folder) = progress.during(|watch| optimise(&job, watch))?;
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

/// Verdict, terms, what was asked, and what it costs.
fn text(found: &Optimised) -> String {
    let mut out = found.verdict.join("\n");
    out.push_str("\n\n");
    let number = |v: f64| significant(v, 5);
    let rows: Vec<Vec<String>> = found
        .terms
        .iter()
        .map(|t| vec![t.channel.clone(), t.unit.clone(), number(t.weight), number(t.start), number(t.optimum)])
        .collect();
    let end = if found.status.is_success() { "optimum" } else { "end of the search" };
    out += &table::render(&["minimised", "unit", "weight", "start", end], &rows, &[2, 3, 4]);
    let rows: Vec<Vec<String>> = found
        .asked
        .iter()
        .map(|a| {
            let missed = a.largest.map_or("diverged".into(), |l| significant(l, 3));
            let kept = if a.kept { "yes" } else { "no" };
            vec![a.channel.clone(), a.of.clone(), a.unit.clone(), missed, kept.into()]
        })
        .collect();
    out.push('\n');
    out += &table::render(&["channel", "asked", "unit", "missed by", "kept"], &rows, &[3]);
    if !found.prices.is_empty() {
        let rows: Vec<Vec<String>> = found
            .prices
            .iter()
            .map(|p| vec![p.channel.clone(), p.of.clone(), p.unit.clone(), number(p.price), number(p.per_percent)])
            .collect();
        out.push('\n');
        out += &table::render(&["channel", "one more of", "unit", "objective", "per 1 % of it"], &rows, &[3, 4]);
    }
    out
}
