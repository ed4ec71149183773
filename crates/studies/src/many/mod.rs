//! Many tasks on many machines: a study, or a job over seeds and points, whose parts meet in a folder.
//!
//! The contract is files. A task is a pure function of its inputs; a *chunk* is a run of neighbouring tasks whose results are one file
//! of JSON lines, written whole and renamed. Which tasks are done is what a listing of `chunks` says, so a killed worker costs the
//! chunk that it was at, and the same command goes on.
//!
//! ```text
//! DIR/run.json, spec.json                     as in any run folder
//! DIR/tasks.json                              whose tasks these are, how many, how many make a chunk
//! DIR/chunks/0000000040-0000000049.jsonl      tasks 40 to 49, a line each
//! DIR/claims/0000000050-0000000059            a worker is at these; it touches the file while it lives
//! DIR/workers/HOST-PID.jsonl                  what a worker did and how long it took (differs between equal runs)
//! DIR/results.parquet, summary.json, report.html      written when nothing is left
//! ```
//!
//! [`Part::Shard`] does a fixed share and needs no shared folder: the files of `chunks` may be copied together afterwards.
//! [`Part::Join`] takes what nobody else has claimed until nothing is left, then writes the results.

mod chunks;
mod claims;
mod end;
mod folder;
mod jobs;
mod named;
mod page;
mod spec;
mod table;
mod work;

use std::path::{Path, PathBuf};
use std::time::Duration;

use dynocal_files::run_folder::RunFolder;
use dynocal_numerics::watch::Watch;
use serde::Serialize;
use serde_json::{Map, Value};

pub use chunks::{Range, parse_share};
pub use end::Lines;
pub use jobs::batch as of_job;
pub use named::batch as of_study;
pub use spec::{JobStudy, Replaced, parse, read};

use crate::{Check, StudyError};

/// Least work of a chunk that is planned by measuring: what it costs to hand one out is then lost in it.
pub const LEAST_CHUNK_S: f64 = 2.0;
/// How long a claim counts after its worker was last seen, unless another time is asked for.
pub const LEASE: Duration = Duration::from_secs(10);

/// A line of a chunk, and of `results`: JSON by name.
pub type Line = Map<String, Value>;

/// What a task does: its number and the study's folder in, what it found out.
pub type Work<'a> = dyn Fn(usize, &Place, Watch) -> Result<Line, StudyError> + 'a;

/// Where a task may write.
pub struct Place {
    /// Folder of the study.
    pub out: PathBuf,
    /// Folder of this worker alone; what is in it goes when the worker ends.
    pub own: PathBuf,
}

/// What the end of a study writes beside the table of its results.
pub struct Written {
    /// Whether the result may be used as it is.
    pub valid: bool,
    /// What came out, in sentences; the first is the verdict.
    pub verdict: Vec<String>,
    /// Checks, where the study has some.
    pub checks: Vec<Check>,
}

/// From all lines to summary and page in the folder, which is held open for it.
pub type End<'a> = dyn Fn(&Lines, &RunFolder) -> Result<Written, StudyError> + 'a;

/// Tasks that belong together.
pub struct Batch<'a> {
    /// Name of the study.
    pub name: String,
    /// What is stored as `spec.json`.
    pub spec: Value,
    /// Digest of all that the tasks depend on: a folder holds the tasks of one digest.
    pub digest: String,
    /// Number of tasks.
    pub count: usize,
    /// Inputs of a task.
    pub about: Box<dyn Fn(usize) -> Line + 'a>,
    /// Does a task.
    pub work: Box<Work<'a>>,
    /// Does the end.
    pub end: Box<End<'a>>,
}

/// Which part of the work is done here.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Part {
    /// Part `index` (from 1) of `of`, whatever others do.
    Shard {
        /// Which, from 1.
        index: usize,
        /// Of how many.
        of: usize,
    },
    /// What nobody else does, then the end.
    Join,
}

/// How it is done.
#[derive(Clone, Copy, Debug)]
pub struct How {
    /// Which part.
    pub part: Part,
    /// Tasks a chunk; none: planned by measuring the first task.
    pub chunk_tasks: Option<usize>,
    /// How long a claim counts after its worker was last seen.
    pub lease: Duration,
}

impl How {
    /// Joins, with the defaults.
    pub fn join() -> Self {
        Self { part: Part::Join, chunk_tasks: None, lease: LEASE }
    }
}

/// How far a study is.
#[derive(Clone, Debug, Serialize)]
pub struct State {
    /// Number of tasks.
    pub tasks: usize,
    /// Tasks that are done.
    pub done: usize,
    /// Chunks that are left, as first and last task.
    pub left: Vec<Range>,
}

/// What a worker leaves.
pub struct Left {
    /// How far the study is.
    pub state: State,
    /// Summary, page and verdict, where nothing is left to do.
    pub finished: Option<Ended>,
}

/// The end of a study.
pub struct Ended {
    /// What came out.
    pub written: Written,
    /// Path of summary.json.
    pub summary: PathBuf,
    /// Path of report.html.
    pub report: PathBuf,
}

/// Does a part of the tasks in the folder `out`, and the end where nothing is left.
///
/// # Errors
/// [`StudyError`]; an interruption leaves all chunks that are finished.
pub fn run(batch: &Batch, how: &How, out: &Path, watch: Watch) -> Result<Left, StudyError> {
    let worker = work::Worker::open(batch, how, out, watch)?;
    let range = match how.part {
        Part::Shard { index, of } => chunks::share(batch.count, index, of)?,
        Part::Join => Range { first: 0, last: batch.count - 1 },
    };
    loop {
        match how.part {
            Part::Shard { .. } => worker.alone(range)?,
            Part::Join => worker.join(range)?,
        }
        let state = worker.state()?;
        if !state.left.is_empty() {
            return Ok(Left { state, finished: None });
        }
        // A chunk that turns out to be damaged is set aside, and is work again.
        if let Some(ended) = end::finish(batch, out, watch)? {
            return Ok(Left { state, finished: Some(ended) });
        }
    }
}

/// How far the study in `out` is; the first call plans the chunks, for which it may do a task.
///
/// # Errors
/// [`StudyError`].
pub fn plan(batch: &Batch, how: &How, out: &Path, watch: Watch) -> Result<State, StudyError> {
    match folder::tasks(batch, out)? {
        Some(tasks) if out.join("chunks").is_dir() => work::state(out, batch.count, tasks.chunk_tasks),
        _ => work::Worker::open(batch, how, out, watch)?.state(),
    }
}

/// Does one chunk, whatever others do, unless its file is there; returns the file.
///
/// # Errors
/// [`StudyError`].
pub fn chunk(
    batch: &Batch,
    how: &How,
    range: Range,
    out: &Path,
    watch: Watch,
) -> Result<PathBuf, StudyError> {
    let worker = work::Worker::open(batch, how, out, watch)?;
    worker.chunk(range)?;
    Ok(chunks::path(out, range))
}
