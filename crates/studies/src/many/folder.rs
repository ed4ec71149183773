//! The folder of a study of many tasks.

use std::fs;
use std::path::Path;
use std::thread;
use std::time::Duration;

use dynocal_files::run_folder::RunFolder;
use dynocal_files::{FilesError, json};
use dynocal_numerics::watch::Watch;
use serde::{Deserialize, Serialize};

use super::Batch;
use crate::StudyError;

/// How often a worker looks whether another has finished.
pub(super) const LOOK: Duration = Duration::from_millis(20);

/// `tasks.json`.
#[derive(Serialize, Deserialize)]
pub(super) struct Tasks {
    /// Digest of all that the tasks depend on.
    pub(super) digest: String,
    /// Number of tasks.
    pub(super) count: usize,
    /// Tasks a chunk.
    pub(super) chunk_tasks: usize,
}

/// A file of the folder is not what it should be.
pub(super) fn bad(path: &Path, reason: String) -> StudyError {
    FilesError::Malformed { path: path.display().to_string(), format: "study", reason }.into()
}

/// `tasks.json`, if it is there; that of other tasks is refused.
pub(super) fn tasks(batch: &Batch, out: &Path) -> Result<Option<Tasks>, StudyError> {
    let path = out.join("tasks.json");
    if !path.exists() {
        return Ok(None);
    }
    let found: Tasks = json::read(&path)?;
    if found.digest != batch.digest || found.count != batch.count || found.chunk_tasks == 0 {
        return Err(StudyError::OtherTasks { folder: out.display().to_string() });
    }
    Ok(Some(found))
}

/// The folder, held alone; waits for whoever holds it.
pub(super) fn hold(batch: &Batch, out: &Path, watch: Watch) -> Result<RunFolder, StudyError> {
    loop {
        match RunFolder::open(out, "study", &batch.spec) {
            Err(FilesError::Busy { .. }) if !watch.interrupted() => thread::sleep(LOOK),
            Err(FilesError::Busy { .. }) => return Err(StudyError::Interrupted),
            other => return Ok(other?),
        }
    }
}

/// Makes the folders that workers share.
pub(super) fn make(out: &Path) -> Result<(), StudyError> {
    for name in ["chunks", "claims", "workers"] {
        let path = out.join(name);
        let fail =
            |e: std::io::Error| FilesError::Write { path: path.display().to_string(), reason: e.to_string() };
        fs::create_dir_all(&path).map_err(fail)?;
    }
    Ok(())
}

/// Removes what workers that were killed have left: temporary files, dead claims, run folders. Nothing is left to do, so nobody is
/// at work any more but such as do a chunk once more, which finds its folders again.
pub(super) fn sweep(out: &Path) {
    let entries = |name: &str| fs::read_dir(out.join(name)).into_iter().flatten().filter_map(Result::ok);
    // What cannot be removed does no harm.
    for entry in entries("chunks") {
        let name = entry.file_name().to_string_lossy().into_owned();
        if name.starts_with('.') && name.ends_with(".tmp") {
            drop(fs::remove_file(entry.path()));
        }
    }
    for entry in entries("claims") {
        drop(fs::remove_file(entry.path()));
    }
    drop(fs::remove_dir_all(out.join("work")));
}
