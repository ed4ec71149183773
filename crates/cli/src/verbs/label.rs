//! `dynocal label`: labels of an ECU from logs.

use std::path::PathBuf;

use clap::{ArgMatches, Args, FromArgMatches, Subcommand};
use dynocal_jobs::label::{Job, Labelled, run as label};

use super::Verb;
use crate::common::Common;
use crate::failure::{Exit, Failure, exit};
use crate::terminal::{print, say};

pub(crate) const VERB: Verb = Verb { name: "label", describe: |c| Label::augment_args(c.about(ABOUT)), run };

const ABOUT: &str = "Fit labels of an ECU to logs: the fuel table of an open ECU";

#[derive(Args, Debug)]
struct Label {
    #[command(subcommand)]
    recipe: Recipe,
}

#[derive(Subcommand, Debug)]
enum Recipe {
    /// The fuel table (VE) from logs with a lambda sensor; writes .msq and .table
    Ve(Ve),
}

#[derive(Args, Debug)]
struct Ve {
    /// Log (.mlg, .msl, CSV); several are fitted together
    #[arg(required = true, value_name = "LOG")]
    logs: Vec<PathBuf>,
    /// Tune that was in the ECU; without it the one that the first log carries
    #[arg(long, value_name = "FILE.msq")]
    tune: Option<PathBuf>,
    /// Definition of the ECU: steps and limits of its labels
    #[arg(long, value_name = "FILE.ini")]
    ini: Option<PathBuf>,
    /// Lambda that is wanted everywhere; without it what the target table of the tune asks for
    #[arg(long, value_name = "LAMBDA")]
    target: Option<f64>,
    /// Share of the samples, first in time, that the judged table is fitted to
    #[arg(long, value_name = "SHARE", default_value_t = 0.6)]
    train: f64,
    /// Weight of the smoothness, 1 as much as the data; without it by generalised cross-validation
    #[arg(long, value_name = "WEIGHT")]
    smooth: Option<f64>,
    /// Cells without data follow their neighbours instead of keeping their values
    #[arg(long)]
    extrapolate: bool,
    #[command(flatten)]
    common: Common,
}

fn run(matches: &ArgMatches) -> Result<Exit, Failure> {
    let Label { recipe: Recipe::Ve(args) } = Label::from_arg_matches(matches)?;
    let progress = args.common.start()?;
    let mut job = Job::ve(args.logs.clone(), args.tune.clone(), args.ini.clone(), args.common.out.as_deref());
    job.target_lambda = args.target;
    job.keys.train = args.train;
    job.keys.fit.smooth = args.smooth;
    job.keys.fit.extrapolate = args.extrapolate;
    let (found, folder) = progress.during(|watch| label(&job, watch))?;
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

fn text(found: &Labelled) -> String {
    let mut out = found.verdict.join("\n");
    out.push('\n');
    for file in found.files.iter().filter(|f| f.ends_with(".msq") || f.ends_with(".table")) {
        out.push_str(&format!("written: {file}\n"));
    }
    out
}
