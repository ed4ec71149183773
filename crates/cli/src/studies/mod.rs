//! Studies: named, reproducible comparisons whose checks are computed from their runs.
//!
//! A study is a list of independent tasks, each a pure function of its inputs to a JSON result, and a reduction of
//! all results to checks. Tasks know nothing of each other. One file per study, one line in [`STUDIES`].

mod asked;
mod benchmark_cases;
mod benchmarks;
mod chain;
mod chain_checks;
mod chain_tasks;
mod chapter4;
mod chapter5;
mod design;
mod engine;
mod engine_boosted;
mod engine_boosted_tables;
mod engine_checks;
mod engine_tables;
mod engine_tasks;
mod loops;
mod report;

use std::path::{Path, PathBuf};

use dynocal_calib::chain::context::ChainError;
use dynocal_deliver::Report;
use dynocal_files::run_folder::RunFolder;
use dynocal_numerics::registry::MemberDoc;
use serde::Serialize;
use serde::de::DeserializeOwned;
use serde_json::Value;

use asked::Asked;

/// How a study is run.
#[derive(Clone, Debug, Serialize)]
pub(crate) struct Options {
    /// First seed; a study with several seeds counts on from it.
    pub(crate) seed: u64,
    /// Reduced length: proves that everything runs, not the numbers.
    pub(crate) reduced: bool,
    /// File of reference values, for a study that compares with one. What it holds counts, not where it lies.
    #[serde(skip)]
    pub(crate) reference: Option<PathBuf>,
    /// Folder of measured data, for a study that needs some.
    #[serde(skip)]
    pub(crate) data: Option<PathBuf>,
}

/// What a task gets from its surroundings.
pub(crate) struct Surroundings<'a> {
    /// Folder that the task may keep runs in.
    pub(crate) runs: PathBuf,
    /// Whether to stop.
    pub(crate) interrupt: &'a (dyn Fn() -> bool + Sync),
    /// A line of progress.
    pub(crate) note: &'a (dyn Fn(&str) + Sync),
}

/// What a task does.
pub(crate) type Work = dyn Fn(&Surroundings) -> Result<Value, ChainError>;

/// One task.
pub(crate) struct Task {
    /// Name, unique in the study.
    pub(crate) name: String,
    /// Everything that its result depends on.
    pub(crate) inputs: Value,
    /// Does it.
    pub(crate) run: Box<Work>,
}

/// The result of a task.
pub(crate) struct TaskResult {
    pub(crate) name: String,
    pub(crate) value: Value,
}

/// A number that a study stands for.
#[derive(Clone, Debug, Serialize)]
pub(crate) struct Check {
    /// Name, unique in the study.
    pub(crate) id: String,
    /// What is measured.
    pub(crate) what: String,
    /// What is asked, e.g. `<= 1.5`; none when the number is only reported.
    pub(crate) asked: Option<String>,
    /// What came out.
    pub(crate) measured: Option<f64>,
    /// Unit.
    pub(crate) unit: &'static str,
    /// Whether it holds; none when nothing is asked.
    pub(crate) holds: Option<bool>,
    /// More, e.g. the number of each seed.
    pub(crate) note: String,
}

/// A study.
pub(crate) struct Study {
    /// Name and summary.
    pub(crate) doc: MemberDoc,
    /// Its tasks.
    pub(crate) tasks: fn(&Options) -> Vec<Task>,
    /// From results to checks.
    pub(crate) reduce: fn(&[TaskResult]) -> Vec<Check>,
    /// Sections of the report below the checks.
    pub(crate) sections: fn(Report, &[TaskResult]) -> Report,
}

/// All studies.
pub(crate) static STUDIES: &[Study] = &[
    benchmarks::STUDY,
    chain::STUDY,
    chapter4::STUDY,
    chapter5::STUDY,
    design::STUDY,
    engine::STUDY,
    loops::STUDY,
];

/// The study of that name.
pub(crate) fn find(name: &str) -> Option<&'static Study> {
    STUDIES.iter().find(|s| s.doc.name == name)
}

/// A finished study.
pub(crate) struct Finished {
    pub(crate) checks: Vec<Check>,
    pub(crate) summary: PathBuf,
    pub(crate) report: PathBuf,
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
pub(crate) fn run(
    study: &Study,
    options: &Options,
    out: &Path,
    interrupt: &(dyn Fn() -> bool + Sync),
    note: &(dyn Fn(&str) + Sync),
) -> Result<Finished, ChainError> {
    let mut folder = RunFolder::open(out, "study", &(study.doc.name, options))?;
    let tasks = (study.tasks)(options);
    let mut results = Vec::new();
    for (k, task) in tasks.iter().enumerate() {
        if interrupt() {
            return Err(ChainError::Interrupted);
        }
        note(&format!("task {} of {}: {}", k + 1, tasks.len(), task.name));
        let around = Surroundings { runs: out.join("runs"), interrupt, note };
        let done = folder.step(&task.name, &task.inputs, |_| (task.run)(&around))?;
        results.push(TaskResult { name: task.name.clone(), value: done.result });
    }
    let checks = (study.reduce)(&results);
    let warnings = warnings(options, &checks);
    let html = report::html(study, options, &checks, &warnings, &results)?;
    let report = out.join("report.html");
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
pub(crate) fn all_hold(checks: &[Check]) -> bool {
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
