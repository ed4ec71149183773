//! `dynocal calibrate SPEC`: all steps, or up to one of them, in one run folder.

use std::path::{Path, PathBuf};

use clap::{ArgMatches, Args, FromArgMatches};
use dynocal_jobs::calibrate::error::ChainError;
use dynocal_jobs::calibrate::estimate::estimate;
use dynocal_jobs::calibrate::run::STEPS;

use super::Verb;
use dynocal_jobs::calibrate::job::{self, Campaign, Finished};
use dynocal_jobs::calibrate::store;
use crate::common::{Check, Common, show_plan};
use crate::terminal::{print, say};
use crate::failure::{Exit, Failure, exit};

pub(crate) const VERB: Verb = Verb { name: "calibrate", describe: |c| Calibrate::augment_args(c.about(ABOUT)), run };

const ABOUT: &str = "Calibrate: excite, identify, design, optimise, invert, validate, report";

#[derive(Args, Debug)]
struct Calibrate {
    /// Spec of the calibration (TOML); the run folder is runs/NAME after its file name, unless --out says otherwise
    spec: PathBuf,
    /// Last step that is run; it runs what it builds on unless that is finished already, and ends with its files
    #[arg(long, value_name = "STEP", value_parser = clap::builder::PossibleValuesParser::new(STEPS))]
    until: Option<String>,
    #[command(flatten)]
    plan: Check,
    #[command(flatten)]
    common: Common,
}

fn run(matches: &ArgMatches) -> Result<Exit, Failure> {
    let args = Calibrate::from_arg_matches(matches)?;
    let own = args.until.as_ref().and_then(|name| STEPS.iter().position(|s| s == name));
    let progress = args.common.start()?;
    let campaign = job::read(&args.spec, args.common.seed, args.common.out.as_deref())?;
    let plan = estimate(&campaign);
    if args.plan.check {
        job::check_given(&campaign)?;
        return show_plan(&plan, &campaign.out, "calibrate", &args.common);
    }
    plan.allowed()?;
    let until = args.until.as_deref().unwrap_or_else(|| job::last_step(&campaign.spec));
    match progress.during(|watch| job::run(&campaign, until, watch)) {
        Ok(done) => {
            show(&args.common, &campaign, &done, own)?;
            exported(&campaign, done.result.invert.is_some(), args.common.quiet)?;
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

/// Does what `[export]` asks for, once there are maps.
fn exported(campaign: &Campaign, has_map: bool, quiet: bool) -> Result<(), Failure> {
    let Some(export) = &campaign.spec.export else { return Ok(()) };
    if !has_map {
        say("[export]: nothing leaves before the step invert, which makes the map");
        return Ok(());
    }
    super::export::of_run(&campaign.out, &export.wanted(Path::new("")), quiet)
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
    campaign: &Campaign,
    done: &Finished,
    own: Option<usize>,
) -> Result<(), Failure> {
    for warning in &done.warnings {
        if !common.quiet {
            say(&format!("warning: {warning}"));
        }
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
