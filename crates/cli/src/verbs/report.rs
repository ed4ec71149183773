//! `dynocal report RUN`: summary and report of a run folder, built again from its finished steps.

use std::path::PathBuf;

use clap::{ArgMatches, Args, FromArgMatches};

use super::Verb;
use dynocal_files::FilesError;
use dynocal_jobs::calibrate::error::ChainError;
use dynocal_jobs::calibrate::job;
use crate::terminal::print;
use crate::failure::{Exit, Failure, exit};

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
    let done = job::rebuild(&args.run).map_err(with_hint)?;
    if args.json {
        print(&std::fs::read_to_string(&done.summary)?)?;
    } else if !args.quiet {
        print(&format!("{}\n", done.report.display()))?;
    }
    Ok(exit(done.valid))
}

/// A folder of another verb.
#[derive(Debug, thiserror::Error)]
#[error("{path}: found {found}, expected a run of `dynocal calibrate`")]
struct OtherRun {
    path: String,
    found: String,
}

fn with_hint(e: ChainError) -> Failure {
    if let ChainError::Files(FilesError::ForeignFolder { path, found, .. }) = e {
        return Failure::from(OtherRun { path, found })
            .hint("other verbs write their page, report.html of the run folder, with the run; the same command writes it anew, finished steps are taken over");
    }
    let foreign = matches!(&e, ChainError::Files(FilesError::Read { .. }));
    let failure = Failure::from(e);
    if foreign {
        failure.hint("give the folder that `dynocal calibrate` wrote, e.g. runs/calibrate")
    } else {
        failure
    }
}
