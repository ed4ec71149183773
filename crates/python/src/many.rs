//! Studies of many tasks: the plan, one chunk, or a part, in a folder that workers share.

use std::path::PathBuf;
use std::time::Duration;

use dynocal_jobs::place::Overrides;
use dynocal_numerics::watch::Watch;
use dynocal_studies::many::{self, Batch, How, Part, Range};
use dynocal_studies::{self as studies, Options, StudyError};
use pyo3::prelude::*;

use crate::errors::{Kind, Refusal, run as failed};
use crate::watched::watched;

/// A study, and where: all that another process needs to do a part of it.
#[pyclass(frozen, module = "dynocal._dynocal")]
#[derive(Clone)]
pub(crate) struct Tasks {
    what: What,
    out: Option<PathBuf>,
    how: How,
}

#[derive(Clone)]
enum What {
    Named(String, Options),
    File(PathBuf, Option<Vec<u64>>),
    Text { name: String, text: String, seeds: Option<Vec<u64>> },
}

impl From<StudyError> for Refusal {
    fn from(e: StudyError) -> Self {
        match e {
            StudyError::Files(e) => e.into(),
            StudyError::Spec(e) => e.into(),
            StudyError::Job(e) => e.into(),
            e => failed(e),
        }
    }
}

impl Tasks {
    /// Does `work` with the tasks and their folder.
    fn with<T>(
        &self,
        watch: Watch,
        work: impl FnOnce(&Batch, &How, PathBuf) -> Result<T, StudyError>,
    ) -> Result<T, Refusal> {
        let replaced = |seeds: &Option<Vec<u64>>| many::Replaced {
            seeds: seeds.clone(),
            over: Overrides { seed: None, out: self.out.clone() },
        };
        let study = match &self.what {
            What::Named(name, options) => {
                let known = || studies::STUDIES.iter().map(|s| s.doc.name).collect::<Vec<_>>().join(", ");
                let study = studies::find(name).ok_or_else(|| {
                    let text = format!(
                        "name: found `{name}`, expected a file ending in .toml, or one of {}",
                        known()
                    );
                    Refusal::new(Kind::Argument, text)
                })?;
                let batch = many::of_study(study, options)?;
                let folder =
                    self.out.clone().unwrap_or_else(|| PathBuf::from("runs").join(format!("study-{name}")));
                return Ok(work(&batch, &self.how, folder)?);
            }
            What::File(path, seeds) => many::read(path, &replaced(seeds))?,
            What::Text { name, text, seeds } => many::parse(name, text, &replaced(seeds)).map_err(|e| {
                let called = PathBuf::from(name).file_stem().map(|s| s.to_string_lossy().into_owned());
                Refusal::from(e).instead(name, &format!("the spec `{}`", called.unwrap_or_default()))
            })?,
        };
        let batch = many::of_job(&study, watch)?;
        let how = How { chunk_tasks: self.how.chunk_tasks.or(study.chunk_tasks), ..self.how };
        Ok(work(&batch, &how, study.out.to_path_buf())?)
    }
}

/// Folder, number of tasks, number that are done, and the chunks that are left as first and last task.
type Planned = (PathBuf, usize, usize, Vec<(usize, usize)>);

/// Folder, and where all is done whether it is valid, with the verdict.
type Parted = (PathBuf, Option<(bool, Vec<String>)>);

#[pymethods]
impl Tasks {
    /// `spec`: name of a study, a file, or the name of `text`.
    #[new]
    fn new(
        spec: String,
        text: Option<String>,
        seeds: Option<Vec<u64>>,
        out: Option<PathBuf>,
        chunk_tasks: Option<usize>,
        lease_s: f64,
        quick: bool,
        reference: Option<PathBuf>,
        data: Option<PathBuf>,
    ) -> PyResult<Self> {
        let lease = Duration::try_from_secs_f64(lease_s)
            .map_err(|e| Refusal::new(Kind::Argument, format!("lease_s: found {lease_s}: {e}")))?;
        let what = match text {
            Some(text) => What::Text { name: spec, text, seeds },
            None if spec.ends_with(".toml") => What::File(spec.into(), seeds),
            None => {
                let seed = match seeds.as_deref() {
                    None => 1,
                    Some([seed]) => *seed,
                    Some(_) => {
                        let text = "seeds: found several for a study of the program, expected one: it takes its own from there";
                        return Err(Refusal::new(Kind::Argument, text).into());
                    }
                };
                What::Named(spec, Options { seed, reduced: quick, reference, data })
            }
        };
        Ok(Self { what, out, how: How { chunk_tasks, lease, ..How::join() } })
    }

    /// How far the study is; the first call plans its chunks.
    fn plan(&self, py: Python<'_>, progress: Option<Py<PyAny>>) -> PyResult<Planned> {
        let tasks = self.clone();
        let work = move |watch: Watch| {
            tasks.with(watch, |batch, how, out| {
                let state = many::plan(batch, how, &out, watch)?;
                Ok((out, state.tasks, state.done, state.left.iter().map(|r| (r.first, r.last)).collect()))
            })
        };
        Ok(watched(py, progress, work)??)
    }

    /// Does one chunk unless its file is there; returns the file.
    fn chunk(&self, py: Python<'_>, first: usize, last: usize) -> PyResult<PathBuf> {
        let tasks = self.clone();
        let work = move |watch: Watch| {
            tasks.with(watch, |batch, how, out| {
                let end = batch.count;
                if first > last || last >= end {
                    let reason = format!("found {first} to {last}, expected tasks from 0 to {}", end - 1);
                    return Err(StudyError::Task { what: "chunk".into(), reason });
                }
                many::chunk(batch, how, Range { first, last }, &out, watch)
            })
        };
        Ok(watched(py, None, work)??)
    }

    /// Works until nothing is left, or does its share; the folder, the verdict and whether it is valid where all is done.
    fn part(
        &self,
        py: Python<'_>,
        shard: Option<(usize, usize)>,
        progress: Option<Py<PyAny>>,
    ) -> PyResult<Parted> {
        let tasks = self.clone();
        let part = shard.map_or(Part::Join, |(index, of)| Part::Shard { index, of });
        let work = move |watch: Watch| {
            tasks.with(watch, |batch, how, out| {
                let left = many::run(batch, &How { part, ..*how }, &out, watch)?;
                Ok((out, left.finished.map(|e| (e.written.valid, e.written.verdict))))
            })
        };
        Ok(watched(py, progress, work)??)
    }
}
