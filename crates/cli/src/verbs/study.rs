//! `dynocal study`: a named comparison with its checks, or a job over seeds and points; on one machine or in parts on many.

use std::path::{Path, PathBuf};
use std::time::Duration;

use clap::{ArgMatches, Args, FromArgMatches};

use super::Verb;
use crate::common::Common;
use crate::failure::{Exit, Failure, exit};
use crate::progress::Progress;
use crate::table;
use crate::terminal::{print, say};
use dynocal_jobs::place::Overrides;
use dynocal_studies::many::{self, Batch, How, Left, Part};
use dynocal_studies::{self as studies, Check, Options, STUDIES, StudyError};

pub(crate) const VERB: Verb = Verb { name: "study", describe: |c| Study::augment_args(c.about(ABOUT)), run };

const ABOUT: &str = "Run a study, or a job over seeds and points; exit code 1 when a check does not hold or a run is not valid";

#[derive(Args, Debug)]
struct Study {
    /// Name of a study (`dynocal list studies`), or a spec (TOML) of a job over seeds and points
    #[arg(value_name = "NAME|SPEC.toml", value_parser = what)]
    what: What,
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
    /// Do this share of the tasks, e.g. 2/8, whatever others do
    #[arg(long, value_name = "I/N", value_parser = many::parse_share, conflicts_with = "join")]
    shard: Option<(usize, usize)>,
    /// Work in this folder together with all others that join it, until nothing is left
    #[arg(long, value_name = "DIR", conflicts_with = "out")]
    join: Option<PathBuf>,
    /// Tasks whose results are one file; without it enough for two seconds of work
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(1..))]
    chunk: Option<u32>,
    /// Seconds after which the chunk of a worker that was not heard of is taken by another
    #[arg(long, value_name = "SECONDS", default_value_t = many::LEASE.as_secs_f64(), value_parser = lease)]
    lease: f64,
    #[command(flatten)]
    common: Common,
}

/// What is studied.
#[derive(Clone, Debug)]
enum What {
    /// A name of the table.
    Named(String),
    Spec(PathBuf),
}

fn what(text: &str) -> Result<What, String> {
    if studies::find(text).is_some() {
        return Ok(What::Named(text.into()));
    }
    if Path::new(text).extension().is_some_and(|e| e == "toml") {
        return Ok(What::Spec(text.into()));
    }
    let known: Vec<&str> = STUDIES.iter().map(|s| s.doc.name).collect();
    Err(format!("expected a file ending in .toml, or one of {}", known.join(", ")))
}

fn lease(text: &str) -> Result<f64, String> {
    let found = text.parse::<f64>().ok().filter(|s| (0.1..=86_400.0).contains(s));
    found.ok_or_else(|| "expected seconds from 0.1 to 86400".to_string())
}

impl Study {
    fn how(&self, chunk_tasks: Option<usize>) -> How {
        let part = match self.shard {
            Some((index, of)) => Part::Shard { index, of },
            None => Part::Join,
        };
        let chunk_tasks = self.chunk.map(|n| n as usize).or(chunk_tasks);
        How { part, chunk_tasks, lease: Duration::from_secs_f64(self.lease) }
    }

    fn options(&self) -> Options {
        Options {
            seed: self.common.seed.unwrap_or(1),
            reduced: self.reduced,
            reference: self.reference.clone(),
            data: self.data.clone(),
        }
    }
}

fn run(matches: &ArgMatches) -> Result<Exit, Failure> {
    let args = Study::from_arg_matches(matches)?;
    let progress = args.common.start()?;
    match &args.what {
        What::Named(name) => match studies::find(name) {
            Some(study) => named(study, &args, &progress),
            None => Ok(Exit::CouldNot),
        },
        What::Spec(path) => job(path, &args, &progress),
    }
}

/// A study of the table, alone or as a part.
fn named(study: &'static studies::Study, args: &Study, progress: &Progress) -> Result<Exit, Failure> {
    let (options, name) = (args.options(), study.doc.name);
    let folder = if args.reduced { format!("study-{name}-quick") } else { format!("study-{name}") };
    let out = args.join.clone().or_else(|| args.common.out.clone());
    let out = out.unwrap_or_else(|| Path::new("runs").join(folder));
    if args.shard.is_some() || args.join.is_some() {
        let batch = many::of_study(study, &options)?;
        return part(&batch, &args.how(None), &out, args, progress);
    }
    let done = progress.during(|watch| studies::run(study, &options, &out, watch)).map_err(stopped)?;
    args.common.print_summary(&done.summary)?;
    if args.common.shows_text() {
        if args.reduced {
            print("reduced length: the numbers are not those of the study\n\n")?;
        }
        print(&text(&done.checks))?;
        print(&format!("\n{}\n", done.report.display()))?;
    }
    Ok(exit(studies::all_hold(&done.checks)))
}

/// A job over seeds and points.
fn job(path: &Path, args: &Study, progress: &Progress) -> Result<Exit, Failure> {
    let out = args.join.clone().or_else(|| args.common.out.clone());
    let seeds = args.common.seed.map(|s| vec![s]);
    let replaced = many::Replaced { seeds, over: Overrides { seed: None, out } };
    let study = many::read(path, &replaced)?;
    let batch = progress.during(|watch| many::of_job(&study, watch)).map_err(stopped)?;
    part(&batch, &args.how(study.chunk_tasks), &study.out, args, progress)
}

/// Does a part of the tasks and says how far all are.
fn part(batch: &Batch, how: &How, out: &Path, args: &Study, progress: &Progress) -> Result<Exit, Failure> {
    let left = progress.during(|watch| many::run(batch, how, out, watch)).map_err(stopped)?;
    let Left { state, finished: Some(ended) } = left else {
        let Left { state, .. } = left;
        let text = format!("{} of {} tasks are done in {}", state.done, state.tasks, out.display());
        say(&text);
        say("  hint: `--join` does what is left and writes the results");
        if args.common.json {
            print(&format!("{}\n", serde_json::to_string_pretty(&state)?))?;
        }
        return Ok(Exit::Done);
    };
    args.common.print_summary(&ended.summary)?;
    if args.common.shows_text() {
        print(&format!("{} tasks: {}\n", state.tasks, ended.written.verdict.join(" ")))?;
        if !ended.written.checks.is_empty() {
            print(&format!("\n{}", text(&ended.written.checks)))?;
        }
        print(&format!("\n{}\n", ended.report.display()))?;
    }
    Ok(exit(ended.written.valid))
}

fn stopped(e: StudyError) -> Failure {
    let interrupted = matches!(e, StudyError::Interrupted);
    let failure = Failure::from(e);
    if interrupted { failure.hint("the same command goes on with the tasks that are left") } else { failure }
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
