//! Claims: a file that one worker alone can make, touched while the worker lives.
//!
//! A claim that has not changed for the length of a lease, by the clock of the one who waits, is taken for dead and removed. Clocks of
//! several machines are never compared. Two that find a dead claim at the same moment may both do its chunk: the results are equal,
//! and each is written whole.

use std::collections::BTreeMap;
use std::fs;
use std::io::Write;
use std::path::{Path, PathBuf};
use std::sync::Mutex;
use std::time::{Duration, Instant, SystemTime};

use dynocal_files::FilesError;

use super::chunks::Range;
use crate::StudyError;

/// A claim that is held; it goes with the value.
pub(super) struct Claim {
    path: PathBuf,
}

impl Drop for Claim {
    fn drop(&mut self) {
        // One that stays dies by its lease.
        drop(fs::remove_file(&self.path));
    }
}

impl Claim {
    /// Tells the others that its worker lives.
    pub(super) fn touch(path: &Path) {
        if let Ok(file) = fs::OpenOptions::new().append(true).open(path) {
            // A byte more changes length and time, on file systems of coarse times too.
            drop((&file).write_all(b"."));
        }
    }

    pub(super) fn path(&self) -> &Path {
        &self.path
    }
}

/// How a claim looked when it was seen first, and when that was.
type Seen = ((u64, Option<SystemTime>), Instant);

/// Claims of others, as they were seen.
pub(super) struct Claims {
    folder: PathBuf,
    lease: Duration,
    seen: Mutex<BTreeMap<Range, Seen>>,
}

impl Claims {
    pub(super) fn new(out: &Path, lease: Duration) -> Self {
        Self { folder: out.join("claims"), lease, seen: Mutex::new(BTreeMap::new()) }
    }

    /// Claims `range` for `worker`; none where another lives that has claimed it.
    pub(super) fn take(&self, range: Range, worker: &str) -> Result<Option<Claim>, StudyError> {
        let path = self.folder.join(range.name());
        match fs::OpenOptions::new().write(true).create_new(true).open(&path) {
            Ok(mut file) => {
                let claim = Claim { path };
                file.write_all(worker.as_bytes()).map_err(|e| unwritten(&claim.path, &e))?;
                Ok(Some(claim))
            }
            Err(e) if e.kind() == std::io::ErrorKind::AlreadyExists => {
                if self.is_dead(range, &path) {
                    drop(fs::remove_file(&path));
                }
                Ok(None)
            }
            Err(e) => Err(unwritten(&path, &e).into()),
        }
    }

    fn is_dead(&self, range: Range, path: &Path) -> bool {
        let Ok(mut seen) = self.seen.lock() else { return false };
        let Ok(about) = fs::metadata(path) else {
            seen.remove(&range);
            return false;
        };
        let looks = (about.len(), about.modified().ok());
        let (before, since) = *seen.entry(range).or_insert((looks, Instant::now()));
        if before != looks {
            seen.insert(range, (looks, Instant::now()));
            return false;
        }
        let dead = since.elapsed() >= self.lease;
        if dead {
            seen.remove(&range);
        }
        dead
    }
}

fn unwritten(path: &Path, e: &std::io::Error) -> FilesError {
    FilesError::Write { path: path.display().to_string(), reason: e.to_string() }
}

#[cfg(test)]
mod tests {
    use std::time::Duration;

    use super::{Claim, Claims, Range};

    #[test]
    fn one_has_it_and_the_next_gets_it_when_it_is_given_back_or_dead() {
        let tmp = tempfile::tempdir().unwrap();
        std::fs::create_dir(tmp.path().join("claims")).unwrap();
        let range = Range { first: 3, last: 5 };
        let lease = Duration::from_millis(300);
        let (mine, other) = (Claims::new(tmp.path(), lease), Claims::new(tmp.path(), lease));
        let held = mine.take(range, "a").unwrap().unwrap();
        assert!(other.take(range, "b").unwrap().is_none());
        drop(held);
        let held = other.take(range, "b").unwrap().unwrap();
        // One that lives is not taken, however long it takes.
        for _ in 0..5 {
            std::thread::sleep(lease / 3);
            Claim::touch(held.path());
            assert!(mine.take(range, "a").unwrap().is_none());
        }
        // One that has died is, after the lease.
        std::mem::forget(held);
        std::thread::sleep(lease / 3);
        assert!(mine.take(range, "a").unwrap().is_none());
        std::thread::sleep(lease * 2);
        assert!(mine.take(range, "a").unwrap().is_none(), "it is removed first");
        assert!(mine.take(range, "a").unwrap().is_some());
    }
}
