//! `dynocal report RUN`: summary and report of a run folder, built again from its finished steps.

use std::path::PathBuf;

use clap::{ArgMatches, Args, FromArgMatches};

use super::Verb;
use crate::campaign;
use crate::common::print;
use crate::failure::{Exit, Failure};

pub(crate) const VERB: Verb = Verb { name: "report", describe: |c| Report::augment_args(c.about(ABOUT)), run };

const ABOUT: &str = "Build report.html again from the finished steps of a calibration";

#[derive(Args, Debug)]
struct Report {
    /// Run folder of a calibration
    run: PathBuf,
    /// Print summary.json on standard output
    #[arg(long)]
    json: bool,
    /// Say nothing but errors
    #[arg(long, short)]
    quiet: bool,
}

fn run(matches: &ArgMatches) -> Result<Exit, Failure> {
    let args = Report::from_arg_matches(matches)?;
    let done = campaign::rebuild(&args.run)?;
    if args.json {
        print(&std::fs::read_to_string(&done.summary)?);
    } else if !args.quiet {
        print(&format!("{}\n", done.report.display()));
    }
    Ok(done.exit())
}
