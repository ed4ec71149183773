//! `dynocal calibrate SPEC` and its steps as verbs of their own: all work in the same run folder.

use std::path::{Path, PathBuf};

use clap::{ArgMatches, Args, Command, FromArgMatches};
use dynocal_jobs::calibrate::context::ChainError;
use dynocal_jobs::calibrate::run::STEPS;

use super::Verb;
use dynocal_jobs::calibrate::job::{self, Campaign, Finished};
use dynocal_jobs::calibrate::store;
use crate::common::Common;
use crate::terminal::print;
use crate::failure::{Exit, Failure, exit};
use crate::interrupt;
use crate::step_progress::StepProgress;

pub(crate) const VERB: Verb =
    Verb { name: "calibrate", describe: |c| describe(c, ABOUT), run: |m| run_until(m, "validate", None) };

const ABOUT: &str = "Calibrate: excite, identify, design, optimise, invert, validate, report";

/// The steps of `calibrate`; each runs what it builds on unless that is finished already.
pub(crate) static STEP_VERBS: &[Verb] = &[
    Verb {
        name: "excite",
        describe: |c| describe(c, "Step 1 of calibrate: measure identification and validation records"),
        run: |m| run_until(m, "excite", Some(0)),
    },
    Verb {
        name: "model",
        describe: |c| describe(c, "Step 2 of calibrate: identify the torque and lambda models"),
        run: |m| run_until(m, "identify", Some(1)),
    },
    Verb {
        name: "test",
        describe: |c| describe(c, "Step 3 of calibrate: design an optimal test signal and run it"),
        run: |m| run_until(m, "design", Some(2)),
    },
    Verb {
        name: "optimise",
        describe: |c| describe(c, "Step 4 of calibrate: minimise fuel over a record and measure the result"),
        run: |m| run_until(m, "optimise", Some(3)),
    },
    Verb {
        name: "invert",
        describe: |c| describe(c, "Step 5 of calibrate: turn the optimal records into a dynamic map"),
        run: |m| run_until(m, "invert", Some(4)),
    },
    Verb {
        name: "validate",
        describe: |c| describe(c, "Step 6 of calibrate: compare the dynamic map with its rivals"),
        run: |m| run_until(m, "validate", Some(5)),
    },
];

#[derive(Args, Debug)]
struct Calibrate {
    /// Spec of the calibration (TOML); the run folder is runs/NAME after its file name, unless --out says otherwise
    spec: PathBuf,
    #[command(flatten)]
    common: Common,
}

fn describe(command: Command, about: &'static str) -> Command {
    Calibrate::augment_args(command.about(about))
}

/// Runs up to the step `until`; a step verb (`own` is its number from 0) ends with the files of its step.
fn run_until(matches: &ArgMatches, until: &str, own: Option<usize>) -> Result<Exit, Failure> {
    let args = Calibrate::from_arg_matches(matches)?;
    let progress = args.common.start_steps()?;
    let campaign = job::read(&args.spec, args.common.seed, args.common.out.as_deref())?;
    let outcome = job::run(&campaign, until, &|e| progress.tell(e), &interrupt::asked);
    progress.finish();
    match outcome {
        Ok(done) => {
            show(&args.common, &progress, &campaign, &done, own)?;
            Ok(exit(done.valid))
        }
        // The campaign is not over: a bed has to run a plan first.
        Err(e @ ChainError::NeedsMeasurement { .. }) => {
            Failure::from(e).print();
            Ok(Exit::NotValid)
        }
        Err(e) => Err(with_hint(e, &campaign)),
    }
}

fn with_hint(e: ChainError, campaign: &Campaign) -> Failure {
    let hint = match &e {
        ChainError::Interrupted => {
            Some(format!("the same command goes on in `{}`; finished steps are kept", campaign.out.display()))
        }
        ChainError::Files(dynocal_files::FilesError::ForeignFolder { .. }) => {
            Some("give another folder with --out".into())
        }
        _ => None,
    };
    let failure = Failure::from(e);
    match hint {
        Some(h) => failure.hint(h),
        None => failure,
    }
}

fn show(
    common: &Common,
    progress: &StepProgress,
    campaign: &Campaign,
    done: &Finished,
    own: Option<usize>,
) -> Result<(), Failure> {
    for warning in &done.warnings {
        progress.line(&format!("warning: {warning}"));
    }
    common.print_summary(&done.summary)?;
    if common.shows_text() {
        print(&super::calibrate_text::results(&done.result))?;
        if let Some(k) = own {
            print(&format!("files of the step {}:\n{}", STEPS[k], files(&campaign.out, k)?))?;
        }
        print(&format!("run folder: {}\n{}\n", campaign.out.display(), done.report.display()))?;
    }
    Ok(())
}

fn files(run: &Path, k: usize) -> Result<String, Failure> {
    let folder = store::step_folder(run, k);
    let mut names: Vec<String> = std::fs::read_dir(&folder)?
        .filter_map(Result::ok)
        .map(|e| format!("  {}\n", folder.join(e.file_name()).display()))
        .collect();
    names.sort();
    Ok(names.concat())
}
