//! A worker: plans, claims, does chunks.

use std::fs;
use std::io::{ErrorKind, Write};
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::path::{Path, PathBuf};
use std::sync::Mutex;
use std::sync::atomic::{AtomicBool, Ordering};
use std::thread;
use std::time::{Duration, Instant};

use dynocal_files::run_folder::digest_of;
use dynocal_files::{FilesError, json};
use dynocal_numerics::watch::Watch;
use serde_json::json;

use super::chunks::{self, Range};
use super::claims::{Claim, Claims};
use super::folder::{self, LOOK, Tasks};
use super::{Batch, How, LEAST_CHUNK_S, Line, Place, State};
use crate::StudyError;

/// One that works in the folder.
pub(super) struct Worker<'a> {
    batch: &'a Batch<'a>,
    how: &'a How,
    watch: Watch<'a>,
    place: Place,
    name: String,
    log: Mutex<fs::File>,
    started: Instant,
    chunk_tasks: usize,
}

impl Drop for Worker<'_> {
    fn drop(&mut self) {
        drop(fs::remove_dir_all(&self.place.own));
        // Goes when it is empty, with the last worker.
        drop(fs::remove_dir(self.place.out.join("work")));
    }
}

/// Digest of a task.
pub(super) fn digest(batch: &Batch, task: usize) -> Result<String, StudyError> {
    Ok(digest_of(&(&batch.digest, task, (batch.about)(task)))?)
}

/// How far the study in `out` is.
pub(super) fn state(out: &Path, tasks: usize, chunk_tasks: usize) -> Result<State, StudyError> {
    let left = chunks::left(Range { first: 0, last: tasks - 1 }, &chunks::done(out)?, chunk_tasks);
    Ok(State { tasks, done: tasks - left.iter().map(|r| r.len()).sum::<usize>(), left })
}

impl<'a> Worker<'a> {
    /// Opens the folder; the first plans the chunks, the others wait for that.
    pub(super) fn open(
        batch: &'a Batch<'a>,
        how: &'a How,
        out: &Path,
        watch: Watch<'a>,
    ) -> Result<Self, StudyError> {
        let planned = folder::tasks(batch, out)?;
        let held = match planned {
            Some(_) => None,
            None => Some(folder::hold(batch, out, watch)?),
        };
        folder::make(out)?;
        let (name, log, own) = own(out)?;
        let place = Place { out: out.into(), own };
        let mut worker = Self {
            batch,
            how,
            watch,
            place,
            name,
            log: Mutex::new(log),
            started: Instant::now(),
            chunk_tasks: 1,
        };
        // Somebody may have planned while this one waited for the folder.
        let tasks = match (planned, folder::tasks(batch, out)?) {
            (Some(t), _) | (None, Some(t)) => t,
            (None, None) => worker.plan()?,
        };
        drop(held);
        worker.chunk_tasks = tasks.chunk_tasks;
        Ok(worker)
    }

    /// As many tasks a chunk as the first task says: enough for [`LEAST_CHUNK_S`], one where a task is longer.
    fn plan(&self) -> Result<Tasks, StudyError> {
        let chunk_tasks = match self.how.chunk_tasks {
            Some(n) => n.max(1),
            None => {
                let start = Instant::now();
                self.chunk(Range { first: 0, last: 0 })?;
                let task_s = start.elapsed().as_secs_f64().max(1e-6);
                // At least a few chunks, so that there is something to share.
                let most = self.batch.count.div_ceil(8).max(1);
                ((LEAST_CHUNK_S / task_s).ceil() as usize).clamp(1, most)
            }
        };
        let tasks = Tasks { digest: self.batch.digest.clone(), count: self.batch.count, chunk_tasks };
        json::write(&self.place.out.join("tasks.json"), &tasks)?;
        Ok(tasks)
    }

    /// How far all are.
    pub(super) fn state(&self) -> Result<State, StudyError> {
        state(&self.place.out, self.batch.count, self.chunk_tasks)
    }

    fn left(&self, range: Range) -> Result<Vec<Range>, StudyError> {
        Ok(chunks::left(range, &chunks::done(&self.place.out)?, self.chunk_tasks))
    }

    /// Does what is left of `range`, whatever others do.
    pub(super) fn alone(&self, range: Range) -> Result<(), StudyError> {
        let left = self.left(range)?;
        for (k, chunk) in left.iter().enumerate() {
            self.watch.fraction(k as f64 / left.len() as f64);
            self.watch.note(&format!("tasks {} to {}", chunk.first, chunk.last));
            self.chunk(*chunk)?;
        }
        Ok(())
    }

    /// Does what nobody else has claimed until nothing of `range` is left.
    pub(super) fn join(&self, range: Range) -> Result<(), StudyError> {
        let claims = Claims::new(&self.place.out, self.how.lease);
        let (over, held) = (AtomicBool::new(false), Mutex::new(None::<PathBuf>));
        thread::scope(|scope| {
            scope.spawn(|| beat(&over, &held, self.how.lease));
            let done = self.rounds(range, &claims, &held);
            over.store(true, Ordering::Relaxed);
            done
        })
    }

    fn rounds(&self, range: Range, claims: &Claims, held: &Mutex<Option<PathBuf>>) -> Result<(), StudyError> {
        let mut waited = false;
        loop {
            let left = self.left(range)?;
            if left.is_empty() {
                return Ok(());
            }
            let mut worked = false;
            for chunk in left {
                if self.watch.interrupted() {
                    return Err(StudyError::Interrupted);
                }
                // Another may have finished it since the listing.
                if chunks::path(&self.place.out, chunk).exists() {
                    continue;
                }
                let Some(claim) = claims.take(chunk, &self.name)? else { continue };
                hold(held, Some(claim.path().into()));
                self.watch.fraction(chunk.first as f64 / self.batch.count as f64);
                self.watch.note(&format!("tasks {} to {} of {}", chunk.first, chunk.last, self.batch.count));
                let done = self.chunk(chunk);
                hold(held, None);
                done?;
                (worked, waited) = (true, false);
            }
            if !worked {
                if !waited {
                    self.watch.note("waiting for the chunks of other workers");
                    waited = true;
                }
                thread::sleep(LOOK);
            }
        }
    }

    /// Does the tasks of `range`, unless their file is there.
    pub(super) fn chunk(&self, range: Range) -> Result<(), StudyError> {
        let file = chunks::path(&self.place.out, range);
        if file.exists() {
            return Ok(());
        }
        // What was written when all was done does not hold any more. Whoever does a chunk writes it again at the end.
        drop(fs::remove_file(self.place.out.join("summary.json")));
        let from_s = self.started.elapsed().as_secs_f64();
        self.say(&json!({ "first": range.first, "last": range.last, "from_s": from_s }))?;
        let mut lines = Vec::with_capacity(range.len());
        for task in range.first..=range.last {
            if self.watch.interrupted() {
                return Err(StudyError::Interrupted);
            }
            lines.push(self.task(task)?);
        }
        let worked_s = self.started.elapsed().as_secs_f64() - from_s;
        // Another that took this one for dead may be ahead, and may have ended the study and swept this one's folder.
        if !file.exists() {
            chunks::write(&self.place.out, range, &lines)?;
        }
        self.say(&json!({ "first": range.first, "last": range.last, "worked_s": worked_s }))
    }

    fn task(&self, task: usize) -> Result<Line, StudyError> {
        let silent = Watch { note: &|_| (), fraction: &|_| (), ..self.watch };
        let found = catch_unwind(AssertUnwindSafe(|| (self.batch.work)(task, &self.place, silent)));
        if self.watch.interrupted() {
            return Err(StudyError::Interrupted);
        }
        let found = found.unwrap_or_else(|_| {
            let mut line = Line::new();
            line.insert("status".into(), "failed".into());
            line.insert("error".into(), "this is a bug in dynocal, not in your input".into());
            Ok(line)
        })?;
        let mut line = Line::new();
        line.insert("task".into(), task.into());
        line.insert("digest".into(), digest(self.batch, task)?.into());
        line.extend((self.batch.about)(task));
        line.extend(found);
        Ok(line)
    }

    fn say(&self, what: &serde_json::Value) -> Result<(), StudyError> {
        let Ok(mut log) = self.log.lock() else { return Ok(()) };
        let fail = |e: std::io::Error| FilesError::Write { path: self.name.clone(), reason: e.to_string() };
        // One write: lines of other workers of this process come between two.
        Ok(log.write_all(format!("{what}\n").as_bytes()).map_err(fail)?)
    }
}

/// Name, log and folder of a worker. Workers of one process share a log, to which they add whole lines; the folder is this one's alone.
fn own(out: &Path) -> Result<(String, fs::File, PathBuf), StudyError> {
    let fail = |path: &Path, e: std::io::Error| FilesError::Write {
        path: path.display().to_string(),
        reason: e.to_string(),
    };
    let host = fs::read_to_string("/proc/sys/kernel/hostname").unwrap_or_default();
    let host: String = host.trim().chars().filter(|c| c.is_ascii_alphanumeric()).take(40).collect();
    let host = if host.is_empty() { "host".into() } else { host };
    let name = format!("{host}-{}", std::process::id());
    let path = out.join("workers").join(format!("{name}.jsonl"));
    let log = fs::OpenOptions::new().append(true).create(true).open(&path).map_err(|e| fail(&path, e))?;
    for k in 0usize.. {
        let folder = out.join("work").join(format!("{name}-{k}"));
        // The folder above goes with the last worker, and may go between the two calls.
        drop(fs::create_dir_all(out.join("work")));
        match fs::create_dir(&folder) {
            Ok(()) => return Ok((name, log, folder)),
            Err(e) if [ErrorKind::AlreadyExists, ErrorKind::NotFound].contains(&e.kind()) => {}
            Err(e) => return Err(fail(&folder, e).into()),
        }
    }
    Err(folder::bad(&out.join("work"), "found no free name".into()))
}

fn hold(held: &Mutex<Option<PathBuf>>, claim: Option<PathBuf>) {
    if let Ok(mut h) = held.lock() {
        *h = claim;
    }
}

/// Touches the claim that is held, four times a lease.
fn beat(over: &AtomicBool, held: &Mutex<Option<PathBuf>>, lease: Duration) {
    let mut last = Instant::now();
    while !over.load(Ordering::Relaxed) {
        thread::sleep(LOOK.min(lease / 4));
        if last.elapsed() < lease / 4 {
            continue;
        }
        last = Instant::now();
        if let Ok(h) = held.lock()
            && let Some(path) = h.as_ref()
        {
            Claim::touch(path);
        }
    }
}
