//! A job over seeds and points as tasks: each is a run of the job in a folder of its own, of which the summary stays.

use std::fs;
use std::path::Path;

use dynocal_files::FilesError;
use dynocal_files::run_folder::digest_of;
use dynocal_jobs::place::Overrides;
use dynocal_jobs::runs::{self, Asked, Ended, RunError, Spec};
use dynocal_numerics::watch::Watch;
use serde_json::{Value, json};

use super::spec::JobStudy;
use super::{Batch, Line, Place, end};
use crate::StudyError;

/// Parts of a summary that are the same for every task or name files that do not stay.
const LEFT_OUT: [&str; 3] = ["schema", "schema_version", "files"];

/// The tasks of `study`. The spec of the first task is checked, unless the folder holds tasks already.
///
/// # Errors
/// [`StudyError::Job`] where the job refuses the spec.
pub fn batch<'a>(study: &'a JobStudy, watch: Watch<'_>) -> Result<Batch<'a>, StudyError> {
    if !study.out.join("tasks.json").exists() {
        let verb = runs::find(&study.job)?;
        (verb.plan)(&asked(study, 0, None)?, watch)?.allowed().map_err(RunError::from)?;
    }
    let spec = serde_json::to_value(study).map_err(|e| problem(study, &e.to_string()))?;
    Ok(Batch {
        name: study.name.clone(),
        digest: digest_of(&(env!("CARGO_PKG_VERSION"), &spec))?,
        spec,
        count: study.count(),
        about: Box::new(|task| about(study, task)),
        work: Box::new(|task, place, watch| work(study, task, place, watch)),
        end: Box::new(|lines, folder| end::of_job(study, lines, folder)),
    })
}

fn problem(study: &JobStudy, reason: &str) -> StudyError {
    StudyError::Task { what: study.name.clone(), reason: reason.into() }
}

/// Seed and point of a task.
fn about(study: &JobStudy, task: usize) -> Line {
    let (point, seed) = study.task(task);
    let mut line = Line::new();
    if let Some(seed) = seed {
        line.insert("seed".into(), seed.into());
    }
    if !point.is_empty() {
        line.insert("point".into(), json!(point));
    }
    line
}

/// What is asked of the job in a task.
fn asked(study: &JobStudy, task: usize, out: Option<&Path>) -> Result<Asked, StudyError> {
    let (point, seed) = study.task(task);
    let spec = study.at(point).map_err(|reason| problem(study, &reason))?;
    let text = toml::to_string(&spec).map_err(|e| problem(study, &e.to_string()))?;
    let spec = Spec::Text { name: study.spec_name.clone(), text };
    Ok(Asked { over: Overrides { seed, out: out.map(Path::to_path_buf) }, ..Asked::of(spec) })
}

fn work(study: &JobStudy, task: usize, place: &Place, watch: Watch) -> Result<Line, StudyError> {
    let folder = place.own.join(format!("task-{task:010}"));
    // What an interrupted try has left is no earlier run.
    drop(fs::remove_dir_all(&folder));
    let verb = runs::find(&study.job)?;
    let line = match (verb.run)(&asked(study, task, Some(&folder))?, watch) {
        Ok(ended) => done(&ended, &folder)?,
        Err(e) => failed(&e),
    };
    if study.keep {
        keep(&folder, &place.out.join("runs").join(format!("task-{task:010}")))?;
    }
    drop(fs::remove_dir_all(&folder));
    Ok(line)
}

fn done(ended: &Ended, folder: &Path) -> Result<Line, StudyError> {
    let mut line = Line::new();
    if let Some(why) = &ended.waiting {
        line.insert("status".into(), "waiting".into());
        line.insert("error".into(), why.clone().into());
        return Ok(line);
    }
    line.insert("status".into(), "done".into());
    line.insert("valid".into(), ended.valid.into());
    let mut summary: Value = dynocal_files::json::read(&folder.join("summary.json"))?;
    if let Some(s) = summary.as_object_mut() {
        s.retain(|key, _| !LEFT_OUT.contains(&key.as_str()));
    }
    line.insert("result".into(), summary);
    Ok(line)
}

/// A task that cannot be done is a result too: the others go on.
fn failed(e: &RunError) -> Line {
    let mut line = Line::new();
    line.insert("status".into(), "failed".into());
    line.insert("error".into(), e.to_string().into());
    line
}

/// Moves the run folder of a task to where it stays; one that is there is of the same task.
fn keep(folder: &Path, at: &Path) -> Result<(), StudyError> {
    let fail =
        |e: std::io::Error| FilesError::Write { path: at.display().to_string(), reason: e.to_string() };
    if at.exists() || !folder.exists() {
        return Ok(());
    }
    fs::create_dir_all(at.parent().unwrap_or(at)).map_err(fail)?;
    match fs::rename(folder, at) {
        Err(_) if at.exists() => Ok(()),
        other => Ok(other.map_err(fail)?),
    }
}
