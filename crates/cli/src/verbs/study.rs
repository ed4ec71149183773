//! `dynocal study NAME`: a named comparison with its checks.

use std::path::{Path, PathBuf};

use clap::{ArgMatches, Args, FromArgMatches};

use super::Verb;
use crate::common::Common;
use crate::terminal::print;
use crate::failure::{Exit, Failure};
use dynocal_studies::{self as studies, Check, Options, STUDIES, StudyError};
use crate::table;

pub(crate) const VERB: Verb = Verb { name: "study", describe: |c| Study::augment_args(c.about(ABOUT)), run };

const ABOUT: &str = "Run a study; exit code 1 when one of its checks does not hold";

#[derive(Args, Debug)]
struct Study {
    /// Name of the study (`dynocal list studies`)
    #[arg(value_parser = clap::builder::PossibleValuesParser::new(STUDIES.iter().map(|s| s.doc.name)))]
    name: String,
    /// Reduced length: shows that everything runs, not the numbers of the study
    #[arg(long = "quick")]
    reduced: bool,
    /// Reference values that the study compares with (`engine`: virtual_engine_reference.json, otherwise that of
    /// $DYNOCAL_REFERENCE_DIR/reference)
    #[arg(long, value_name = "FILE")]
    reference: Option<PathBuf>,
    /// Folder of measured data (`benchmarks`: with `data/sysid` and `data/engine`; otherwise that of
    /// $DYNOCAL_REFERENCE_DIR)
    #[arg(long, value_name = "DIR")]
    data: Option<PathBuf>,
    #[command(flatten)]
    common: Common,
}

fn run(matches: &ArgMatches) -> Result<Exit, Failure> {
    let args = Study::from_arg_matches(matches)?;
    let Some(study) = studies::find(&args.name) else { return Ok(Exit::CouldNot) };
    let progress = args.common.start()?;
    let options = Options {
        seed: args.common.seed.unwrap_or(1),
        reduced: args.reduced,
        reference: args.reference.clone(),
        data: args.data.clone(),
    };
    let folder = if args.reduced { format!("study-{}-quick", args.name) } else { format!("study-{}", args.name) };
    let out = args.common.out.clone().unwrap_or_else(|| Path::new("runs").join(folder));
    let done = progress.during(|watch| studies::run(study, &options, &out, watch)).map_err(|e| {
        let interrupted = matches!(e, StudyError::Interrupted);
        let failure = Failure::from(e);
        if interrupted { failure.hint("the same command goes on with the tasks that are left") } else { failure }
    })?;
    args.common.print_summary(&done.summary)?;
    if args.common.shows_text() {
        if args.reduced {
            print("reduced length: the numbers are not those of the study\n\n")?;
        }
        print(&text(&done.checks))?;
        print(&format!("\n{}\n", done.report.display()))?;
    }
    Ok(if studies::all_hold(&done.checks) { Exit::Done } else { Exit::NotValid })
}

fn text(checks: &[Check]) -> String {
    let rows: Vec<Vec<String>> = checks
        .iter()
        .map(|c| {
            let verdict = match c.holds {
                Some(true) => "holds",
                Some(false) => "DOES NOT HOLD",
                None => "reported",
            };
            vec![
                c.id.clone(),
                c.asked.clone().unwrap_or_default(),
                c.measured.map_or("none".into(), |m| dynocal_report::significant(m, 5)),
                c.unit.into(),
                verdict.into(),
                c.note.clone(),
            ]
        })
        .collect();
    table::render(&["check", "asked", "measured", "unit", "verdict", "note"], &rows, &[1, 2])
}
