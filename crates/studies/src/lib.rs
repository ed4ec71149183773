//! Studies: named, reproducible comparisons whose checks are computed from their runs.
//!
//! A study is a list of independent tasks, each a pure function of its inputs to a JSON result, and a reduction of
//! all results to checks. Tasks know nothing of each other. One file per study, one line in [`STUDIES`].

mod asked;
pub mod benchmarks;
mod chain;
pub mod chapter4;
pub mod chapter5;
mod chapter6;
mod chapter7;
mod control;
mod design;
mod dynamic;
pub mod engine;
mod error;
mod labels;
mod limits;
pub mod loops;
pub mod many;
mod map;
mod promise;
mod records;
mod report;

use std::path::{Path, PathBuf};

use dynocal_files::run_folder::RunFolder;
use dynocal_numerics::registry::MemberDoc;
use dynocal_numerics::watch::Watch;
use dynocal_report::Report;
use serde::Serialize;
use serde::de::DeserializeOwned;
use serde_json::Value;

use asked::Asked;
pub use error::StudyError;

/// How a study is run.
#[derive(Clone, Debug, Serialize)]
pub struct Options {
    /// First seed; a study with several seeds counts on from it.
    pub seed: u64,
    /// Reduced length: proves that everything runs, not the numbers.
    pub reduced: bool,
    /// File of reference values, for a study that compares with one. What it holds counts, not where it lies.
    #[serde(skip)]
    pub reference: Option<PathBuf>,
    /// Folder of measured data, for a study that needs some.
    #[serde(skip)]
    pub data: Option<PathBuf>,
}

/// What a task gets from its surroundings.
pub struct Surroundings<'a> {
    /// Folder that the task may keep runs in.
    pub runs: PathBuf,
    /// Whether to stop, and where lines of progress go.
    pub watch: Watch<'a>,
}

/// What a task does.
pub type Work = dyn Fn(&Surroundings) -> Result<Value, StudyError>;

/// One task.
pub struct Task {
    /// Name, unique in the study.
    pub name: String,
    /// Everything that its result depends on.
    pub inputs: Value,
    /// Does it.
    pub run: Box<Work>,
}

/// The result of a task.
pub struct TaskResult {
    /// Name of the task.
    pub name: String,
    /// Its result.
    pub value: Value,
}

/// A number that a study stands for.
#[derive(Clone, Debug, Serialize)]
pub struct Check {
    /// Name, unique in the study.
    pub id: String,
    /// What is measured.
    pub what: String,
    /// What is asked, e.g. `<= 1.5`; none when the number is only reported.
    pub asked: Option<String>,
    /// What came out.
    pub measured: Option<f64>,
    /// Unit.
    pub unit: &'static str,
    /// Whether it holds; none when nothing is asked.
    pub holds: Option<bool>,
    /// More, e.g. the number of each seed.
    pub note: String,
}

/// A study.
pub struct Study {
    /// Name and summary.
    pub doc: MemberDoc,
    /// Its tasks.
    pub tasks: fn(&Options) -> Vec<Task>,
    /// From results to checks.
    pub reduce: fn(&[TaskResult]) -> Vec<Check>,
    /// Sections of the report below the checks.
    pub sections: fn(Report, &[TaskResult]) -> Report,
}

/// All studies.
pub static STUDIES: &[Study] = &[
    benchmarks::STUDY,
    chain::STUDY,
    chapter4::STUDY,
    chapter5::STUDY,
    chapter6::STUDY,
    chapter7::STUDY,
    control::STUDY,
    design::STUDY,
    dynamic::STUDY,
    engine::STUDY,
    labels::STUDY,
    limits::STUDY,
    loops::STUDY,
    map::STUDY,
    promise::STUDY,
    records::STUDY,
];

/// The study of that name.
pub fn find(name: &str) -> Option<&'static Study> {
    STUDIES.iter().find(|s| s.doc.name == name)
}

/// A finished study.
pub struct Finished {
    /// Checks.
    pub checks: Vec<Check>,
    /// Path of summary.json.
    pub summary: PathBuf,
    /// Path of report.html.
    pub report: PathBuf,
}

#[derive(Serialize)]
struct Summary<'a> {
    verb: &'static str,
    name: &'a str,
    valid: bool,
    reduced_length: bool,
    warnings: Vec<String>,
    options: &'a Options,
    checks: &'a [Check],
    tasks: Vec<&'a str>,
    files: Vec<String>,
}

/// Runs a study in `out`; finished tasks of an earlier run are taken over.
///
/// # Errors
/// [`StudyError`].
pub fn run(study: &Study, options: &Options, out: &Path, watch: Watch) -> Result<Finished, StudyError> {
    let mut folder = RunFolder::open(out, "study", &(study.doc.name, options))?;
    let tasks = (study.tasks)(options);
    let mut results = Vec::new();
    for (k, task) in tasks.iter().enumerate() {
        if watch.interrupted() {
            return Err(StudyError::Interrupted);
        }
        watch.fraction(k as f64 / tasks.len() as f64);
        watch.note(&format!("task {} of {}: {}", k + 1, tasks.len(), task.name));
        let around = Surroundings { runs: out.join("runs"), watch };
        let done = folder.step(&task.name, &task.inputs, |_| (task.run)(&around))?;
        results.push(TaskResult { name: task.name.clone(), value: done.result });
    }
    conclude(study, options, &results, &folder)
}

/// From all results to checks, page and summary.
fn conclude(
    study: &Study,
    options: &Options,
    results: &[TaskResult],
    folder: &RunFolder,
) -> Result<Finished, StudyError> {
    let checks = (study.reduce)(results);
    let warnings = warnings(options, &checks);
    let html = report::html(study, options, &checks, &warnings, results)?;
    let report = folder.path().join("report.html");
    dynocal_files::atomic::write(&report, html.as_bytes())?;
    let summary = folder.write_summary(&Summary {
        verb: "study",
        name: study.doc.name,
        valid: all_hold(&checks),
        reduced_length: options.reduced,
        warnings,
        options,
        checks: &checks,
        tasks: results.iter().map(|r| r.name.as_str()).collect(),
        files: vec!["report.html".into(), "runs/".into()],
    })?;
    Ok(Finished { checks, summary, report })
}

/// Whether every check holds that asks for something.
pub fn all_hold(checks: &[Check]) -> bool {
    checks.iter().all(|c| c.holds != Some(false))
}

fn warnings(options: &Options, checks: &[Check]) -> Vec<String> {
    let mut out = Vec::new();
    if options.reduced {
        out.push(
            "Reduced length: one seed and short records. This shows that everything runs; its numbers are not those of the study.".into(),
        );
    }
    let failed: Vec<&str> = checks.iter().filter(|c| c.holds == Some(false)).map(|c| c.id.as_str()).collect();
    if !failed.is_empty() {
        out.push(format!("{} of {} checks do not hold: {}.", failed.len(), checks.len(), failed.join(", ")));
    }
    out
}

/// The result of the task `name`; none where it cannot be read, and then its checks fail.
fn result<T: DeserializeOwned>(results: &[TaskResult], name: &str) -> Option<T> {
    let found = results.iter().find(|r| r.name == name)?;
    serde_json::from_value(found.value.clone()).ok()
}

/// A check of `measured` against what is `asked`.
fn check(
    id: impl Into<String>,
    what: impl Into<String>,
    asked: Asked,
    measured: Option<f64>,
    unit: &'static str,
    note: impl Into<String>,
) -> Check {
    Check {
        id: id.into(),
        what: what.into(),
        asked: asked.text(),
        measured,
        unit,
        holds: asked.holds(measured),
        note: note.into(),
    }
}
