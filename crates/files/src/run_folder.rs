//! The folder of a run.
//!
//! ```text
//! OUT/measured/...             records of a bed, put there by its people; may be there before the run
//! OUT/run.json                 which verb made it (so that a foreign folder is never overwritten)
//! OUT/spec.json                the spec as understood
//! OUT/steps/01-excite/...      files of a step; step.json is written last and says that it is finished
//! OUT/summary.json             results that a program reads (no times)
//! OUT/timing.json              wall times, the only file that differs between equal runs
//! OUT/log.txt                  what happened, line by line; locked while a run works in the folder
//! ```
//!
//! A step is skipped when its `step.json` carries the digest of the same inputs and its files are still those
//! that it wrote. The inputs of a step are its part of the spec, the seed and the digests of the results that it
//! builds on, so a change runs exactly the steps that depend on it.

use std::collections::BTreeMap;
use std::fs;
use std::io::Write;
use std::path::{Path, PathBuf};
use std::time::Instant;

use serde::de::DeserializeOwned;
use serde::{Deserialize, Serialize};

use crate::error::{FilesError, reason};
use crate::json;

const STEP_VERSION: u32 = 1;
/// File of a step that is written last.
const STEP_RECORD: &str = "step.json";

/// Folder of a run into which the records of a bed are put.
pub const MEASURED: &str = "measured";

/// FNV-1a digest of `bytes`, 128 bits as 32 hexadecimal digits (detects change, not malice).
pub fn digest(bytes: &[u8]) -> String {
    const OFFSET: u128 = 0x6c62_272e_07bb_0142_62b8_2175_6295_c58d;
    const PRIME: u128 = 0x0000_0000_0100_0000_0000_0000_0000_013b;
    let h = bytes.iter().fold(OFFSET, |h, b| (h ^ u128::from(*b)).wrapping_mul(PRIME));
    format!("{h:032x}")
}

/// Digest of a value through its JSON text.
///
/// # Errors
/// [`FilesError::Malformed`] when the value cannot be written as JSON.
pub fn digest_of<T: Serialize + ?Sized>(value: &T) -> Result<String, FilesError> {
    Ok(digest(json::to_text(value)?.as_bytes()))
}

#[derive(Serialize, Deserialize)]
struct Marker {
    tool: String,
    version: String,
    kind: String,
    /// The spec whose name the folder has, as seen from the folder.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    spec: Option<PathBuf>,
}

/// Where a run goes: a folder, and the spec that it has its name from, where nobody has named a folder.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct RunPlace {
    folder: PathBuf,
    spec: Option<PathBuf>,
}

impl RunPlace {
    /// `folder`, named after the spec at `spec`: it is not shared with another spec of that name.
    pub fn named_after(folder: PathBuf, spec: &Path) -> Self {
        Self { folder, spec: Some(spec.into()) }
    }
}

impl From<PathBuf> for RunPlace {
    /// A folder that somebody has chosen.
    fn from(folder: PathBuf) -> Self {
        Self { folder, spec: None }
    }
}

impl std::ops::Deref for RunPlace {
    type Target = Path;

    fn deref(&self) -> &Path {
        &self.folder
    }
}

#[derive(Serialize, Deserialize)]
struct StepRecord<T> {
    step_version: u32,
    step: String,
    inputs_digest: String,
    result_digest: String,
    /// Digest of every file of the step.
    files: BTreeMap<String, String>,
    result: T,
}

/// A finished step.
#[derive(Clone, Debug)]
pub struct Done<T> {
    /// What the step found.
    pub result: T,
    /// Digest of result and files: goes into the inputs of the steps that build on it.
    pub digest: String,
    /// Folder of the step.
    pub folder: PathBuf,
    /// Whether it was taken from an earlier run instead of computed.
    pub resumed: bool,
}

/// The folder of one run.
#[derive(Debug)]
pub struct RunFolder {
    path: PathBuf,
    steps: usize,
    timing: Vec<(String, f64)>,
    started: Instant,
    /// `log.txt`, held open: its lock tells another run that the folder is taken, and goes with this process.
    log: fs::File,
    /// `spec.json` of an earlier run.
    earlier_spec: Option<Vec<u8>>,
}

impl RunFolder {
    /// Makes the folder, or continues in it when the same verb (`kind`, e.g. `calibrate`) made it.
    /// `spec` is stored as `spec.json`. Temporary files that a killed run has left are removed.
    ///
    /// # Errors
    /// [`FilesError::ForeignFolder`] when the folder holds something else, [`FilesError::Busy`] when another run works in
    /// it, [`FilesError::Write`] when it cannot be written.
    ///
    /// # Examples
    /// ```
    /// use dynocal_files::{FilesError, run_folder::RunFolder};
    /// let tmp = tempfile::tempdir().unwrap();
    /// let spec = 3.0;
    /// for pass in 0..2 {
    ///     let mut run = RunFolder::open(&tmp.path().join("run"), "example", &spec).unwrap();
    ///     let done = run.step("square", &(spec, 1u64), |_| Ok::<f64, FilesError>(spec * spec)).unwrap();
    ///     assert_eq!(done.result, 9.0);
    ///     assert_eq!(done.resumed, pass == 1);
    /// }
    /// ```
    pub fn open<S: Serialize + ?Sized>(path: &Path, kind: &str, spec: &S) -> Result<Self, FilesError> {
        Self::open_at(&path.to_path_buf().into(), kind, spec)
    }

    /// [`RunFolder::open`] at a place; one that is named after a spec is refused while it holds the run of another spec that is
    /// still there.
    ///
    /// # Errors
    /// As of [`RunFolder::open`].
    pub fn open_at<S: Serialize + ?Sized>(
        place: &RunPlace,
        kind: &str,
        spec: &S,
    ) -> Result<Self, FilesError> {
        let path: &Path = place;
        let from = place.spec.as_ref().and_then(|s| seen_from(path, s));
        is_ours(path, kind, from.as_ref())?;
        let log = locked_log(path)?;
        sweep(path);
        json::write(
            &path.join("run.json"),
            &Marker {
                tool: "dynocal".into(),
                version: env!("CARGO_PKG_VERSION").into(),
                kind: kind.into(),
                spec: from,
            },
        )?;
        let earlier_spec = fs::read(path.join("spec.json")).ok();
        json::write(&path.join("spec.json"), spec)?;
        let (path, timing, started) = (path.into(), Vec::new(), Instant::now());
        let run = Self { path, steps: 0, timing, started, log, earlier_spec };
        run.log(&format!("dynocal {} {kind}", env!("CARGO_PKG_VERSION")))?;
        Ok(run)
    }

    /// Whether [`RunFolder::open_at`] would open the folder; what it tries to write is gone when this returns.
    ///
    /// # Errors
    /// As of [`RunFolder::open_at`], but for runs that are at work.
    pub fn check_at(place: &RunPlace, kind: &str) -> Result<(), FilesError> {
        let path: &Path = place;
        is_ours(path, kind, place.spec.as_ref().and_then(|s| seen_from(path, s)).as_ref())?;
        let there = path.ancestors().find(|p| p.exists()).filter(|p| !p.as_os_str().is_empty());
        let there = there.unwrap_or(Path::new("."));
        let tried = there.join(format!(".dynocal-check-{}.tmp", std::process::id()));
        fs::File::create_new(&tried).and_then(|_| fs::remove_file(&tried)).map_err(|e| unwritten(path, &e))
    }

    /// Whether the folder held a run of another spec, or of none that is known, before it was opened.
    ///
    /// # Errors
    /// [`FilesError::Read`] where the spec that was just written cannot be read back.
    pub fn had_another_spec(&self) -> Result<bool, FilesError> {
        let path = self.path.join("spec.json");
        let now = fs::read(&path)
            .map_err(|e| FilesError::Read { path: path.display().to_string(), reason: e.to_string() })?;
        Ok(self.earlier_spec.as_ref() != Some(&now))
    }

    /// The folder.
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// Runs the step `name`, or takes its result from an earlier run with the same `inputs`.
    ///
    /// `work` gets the folder of the step, writes its files there and returns the result. Steps are numbered in the
    /// order of the calls. An error or an interruption leaves the step unfinished, so that the next run does it again.
    ///
    /// # Errors
    /// Those of `work` and [`FilesError`] from reading and writing.
    pub fn step<T, E, I, F>(&mut self, name: &str, inputs: &I, work: F) -> Result<Done<T>, E>
    where
        T: Serialize + DeserializeOwned,
        I: Serialize + ?Sized,
        E: From<FilesError>,
        F: FnOnce(&Path) -> Result<T, E>,
    {
        let (label, folder) = self.next(name);
        let digest = inputs_digest(name, inputs)?;
        match earlier(&folder, &digest) {
            Some(done) => self.taken(&label, done),
            None => self.worked(&label, folder, digest, work),
        }
    }

    /// [`RunFolder::step`] with a first part, `read`, that writes nothing, and with an earlier result that stays until there is
    /// another: where reading or work fails, or is killed, the step is again what the earlier run left.
    ///
    /// # Errors
    /// Those of `read` and as of [`RunFolder::step`].
    pub fn step_after<T, P, E, I, R, F>(
        &mut self,
        name: &str,
        inputs: &I,
        read: R,
        work: F,
    ) -> Result<Done<T>, E>
    where
        T: Serialize + DeserializeOwned,
        I: Serialize + ?Sized,
        E: From<FilesError>,
        R: FnOnce() -> Result<P, E>,
        F: FnOnce(P, &Path) -> Result<T, E>,
    {
        let (label, folder) = self.next(name);
        let digest = inputs_digest(name, inputs)?;
        let aside = aside_of(&folder);
        put_back(&folder, &aside)?;
        if let Some(done) = earlier(&folder, &digest) {
            return self.taken(&label, done);
        }
        let done = read().and_then(|first| {
            if folder.join(STEP_RECORD).exists() {
                moved(&folder, &aside)?;
            }
            self.worked(&label, folder.clone(), digest, |folder| work(first, folder))
        });
        put_back(&folder, &aside)?;
        if let (Err(_), Some(spec), true) = (&done, &self.earlier_spec, folder.join(STEP_RECORD).exists()) {
            // The results that stay are of the spec that made them.
            crate::atomic::write(&self.path.join("spec.json"), spec)?;
        }
        done
    }

    /// Label and folder of the step that comes next.
    fn next(&mut self, name: &str) -> (String, PathBuf) {
        self.steps += 1;
        let label = format!("{:02}-{name}", self.steps);
        let folder = self.path.join("steps").join(&label);
        (label, folder)
    }

    fn taken<T, E: From<FilesError>>(&self, label: &str, done: Done<T>) -> Result<Done<T>, E> {
        self.log(&format!("{label}: taken from the earlier run"))?;
        Ok(done)
    }

    fn worked<T, E, F>(
        &mut self,
        label: &str,
        folder: PathBuf,
        inputs_digest: String,
        work: F,
    ) -> Result<Done<T>, E>
    where
        T: Serialize + DeserializeOwned,
        E: From<FilesError>,
        F: FnOnce(&Path) -> Result<T, E>,
    {
        let start = Instant::now();
        clear(&folder)?;
        self.log(&format!("{label}: started"))?;
        let result = work(&folder)?;
        let files = files_digest(&folder)?;
        let result_digest = digest_of(&(&result, &files))?;
        let record = StepRecord {
            step_version: STEP_VERSION,
            step: label.into(),
            inputs_digest,
            result_digest: result_digest.clone(),
            files,
            result,
        };
        json::write(&folder.join(STEP_RECORD), &record)?;
        self.log(&format!("{label}: finished"))?;
        self.timing.push((label.into(), start.elapsed().as_secs_f64()));
        self.write_timing()?;
        Ok(Done { result: record.result, digest: result_digest, folder, resumed: false })
    }

    /// The finished step `name` of an earlier run with the same `inputs`, if there is one. Like [`RunFolder::step`] it counts the
    /// steps, so that the order of the calls is that of the steps.
    ///
    /// # Errors
    /// [`FilesError`].
    pub fn finished<T, I>(&mut self, name: &str, inputs: &I) -> Result<Option<Done<T>>, FilesError>
    where
        T: Serialize + DeserializeOwned,
        I: Serialize + ?Sized,
    {
        let (_, folder) = self.next(name);
        Ok(earlier(&folder, &inputs_digest(name, inputs)?))
    }

    /// Appends a line to `log.txt`.
    ///
    /// # Errors
    /// [`FilesError::Write`].
    pub fn log(&self, line: &str) -> Result<(), FilesError> {
        writeln!(&self.log, "{line}").map_err(|e| unwritten(&self.path.join("log.txt"), &e))
    }

    /// Writes `summary.json` (schema `dynocal/summary`, version 1) and returns its path.
    ///
    /// # Errors
    /// [`FilesError::Write`].
    pub fn write_summary<T: Serialize>(&self, summary: &T) -> Result<PathBuf, FilesError> {
        let path = self.path.join("summary.json");
        json::write_versioned(&path, "dynocal/summary", 1, summary)?;
        self.write_timing()?;
        Ok(path)
    }

    fn write_timing(&self) -> Result<(), FilesError> {
        let steps: serde_json::Map<String, serde_json::Value> =
            self.timing.iter().map(|(n, t)| (n.clone(), (*t).into())).collect();
        let total = self.started.elapsed().as_secs_f64();
        json::write(
            &self.path.join("timing.json"),
            &serde_json::json!({ "unit": "s", "total": total, "steps": steps }),
        )
    }
}

fn inputs_digest<I: Serialize + ?Sized>(name: &str, inputs: &I) -> Result<String, FilesError> {
    digest_of(&(STEP_VERSION, env!("CARGO_PKG_VERSION"), name, inputs))
}

/// `file` as a path from `folder`, which need not be there; none where one of them cannot be placed.
fn seen_from(folder: &Path, file: &Path) -> Option<PathBuf> {
    let (folder, file) = (std::path::absolute(folder).ok()?, std::path::absolute(file).ok()?);
    let shared = folder.components().zip(file.components()).take_while(|(a, b)| a == b).count();
    let up = std::iter::repeat_n(std::path::Component::ParentDir, folder.components().count() - shared);
    Some(up.chain(file.components().skip(shared)).collect())
}

/// Refuses a folder that holds anything but an earlier run of this verb, and of this spec (`from` the folder) where one is named.
fn is_ours(path: &Path, kind: &str, from: Option<&PathBuf>) -> Result<(), FilesError> {
    let marker = path.join("run.json");
    if !marker.exists() {
        let entries = fs::read_dir(path).into_iter().flatten().filter_map(Result::ok);
        let entries = entries.filter(|e| !is_beginning(e));
        let names = entries.map(|e| e.file_name().to_string_lossy().into_owned());
        // Records of a bed may be there before the first run.
        return match names.filter(|n| n != MEASURED).min() {
            Some(name) => Err(foreign(path, kind, &format!("it holds `{name}`"))),
            None => Ok(()),
        };
    }
    let m: Marker = json::read(&marker).map_err(|_| foreign(path, kind, "run.json of another tool"))?;
    if m.tool != "dynocal" || m.kind != kind {
        return Err(foreign(path, kind, &format!("a run of `{} {}`", m.tool, m.kind)));
    }
    // One file may be named in several ways.
    let real = |s: &PathBuf| fs::canonicalize(path.join(s)).ok();
    match (from.and_then(real), m.spec.as_ref().and_then(real)) {
        (Some(own), Some(other)) if own != other => {
            let (path, other) = (path.display().to_string(), other.display().to_string());
            Err(FilesError::OtherSpec { path, other })
        }
        _ => Ok(()),
    }
}

/// What a run that opens the folder at this moment has written before its marker: the lock of its log says who is first.
fn is_beginning(e: &fs::DirEntry) -> bool {
    let name = e.file_name().to_string_lossy().into_owned();
    let empty = || e.metadata().is_ok_and(|m| m.len() == 0);
    (name == "log.txt" && empty()) || (name.starts_with(".run.json.") && name.ends_with(".tmp"))
}

fn foreign(path: &Path, kind: &str, found: &str) -> FilesError {
    FilesError::ForeignFolder { path: path.display().to_string(), found: found.into(), expected: kind.into() }
}

fn unwritten(path: &Path, e: &std::io::Error) -> FilesError {
    FilesError::Write { path: path.display().to_string(), reason: reason(e) }
}

/// The log of the folder, opened for lines at its end and locked. A file system without locks goes without.
fn locked_log(folder: &Path) -> Result<fs::File, FilesError> {
    let path = folder.join("log.txt");
    fs::create_dir_all(folder).map_err(|e| unwritten(folder, &e))?;
    let log = fs::OpenOptions::new().create(true).append(true).open(&path);
    let log = log.map_err(|e| unwritten(&path, &e))?;
    match log.try_lock() {
        Err(fs::TryLockError::WouldBlock) => Err(FilesError::Busy { path: folder.display().to_string() }),
        _ => Ok(log),
    }
}

/// Removes the temporary files (see [`crate::atomic`]) of a run that was killed while it wrote, in the folder and in
/// its steps. Nobody else writes there: the folder is locked.
fn sweep(folder: &Path) {
    let entries = |f: &Path| fs::read_dir(f).into_iter().flatten().filter_map(Result::ok).map(|e| e.path());
    let steps = entries(&folder.join("steps")).filter(|p| p.is_dir());
    for place in [folder.to_path_buf(), folder.join("steps")].into_iter().chain(steps) {
        let stray = |p: &PathBuf| {
            let name = p.file_name().map(|n| n.to_string_lossy().into_owned()).unwrap_or_default();
            p.is_file() && name.starts_with('.') && name.ends_with(".tmp")
        };
        // One that cannot be removed does no harm.
        entries(&place).filter(stray).for_each(|p| drop(fs::remove_file(p)));
    }
}

/// The finished step in `folder`, if it had the same inputs and its result and files are untouched.
fn earlier<T: DeserializeOwned>(folder: &Path, inputs_digest: &str) -> Option<Done<T>> {
    let record: StepRecord<serde_json::Value> = json::read(&folder.join(STEP_RECORD)).ok()?;
    let same = record.step_version == STEP_VERSION
        && record.inputs_digest == inputs_digest
        && files_digest(folder).ok()? == record.files
        && digest_of(&(&record.result, &record.files)).ok()? == record.result_digest;
    let result = serde_json::from_value(record.result).ok()?;
    same.then(|| Done { result, digest: record.result_digest, folder: folder.into(), resumed: true })
}

/// Where the earlier result of a step waits while another is made.
fn aside_of(folder: &Path) -> PathBuf {
    let name = folder.file_name().map(|n| n.to_string_lossy().into_owned()).unwrap_or_default();
    folder.with_file_name(format!(".{name}.earlier"))
}

/// An earlier result that waits comes back where no other was finished; where one was, it is removed.
fn put_back(folder: &Path, aside: &Path) -> Result<(), FilesError> {
    if !aside.exists() {
        return Ok(());
    }
    if folder.join(STEP_RECORD).exists() {
        return fs::remove_dir_all(aside).map_err(|e| unwritten(aside, &e));
    }
    if folder.exists() {
        fs::remove_dir_all(folder).map_err(|e| unwritten(folder, &e))?;
    }
    moved(aside, folder)
}

fn moved(from: &Path, to: &Path) -> Result<(), FilesError> {
    fs::rename(from, to).map_err(|e| unwritten(to, &e))
}

/// An empty folder for a step that starts: what an unfinished one left must not be taken for its result.
fn clear(folder: &Path) -> Result<(), FilesError> {
    let fail =
        |e: std::io::Error| FilesError::Write { path: folder.display().to_string(), reason: reason(&e) };
    if folder.exists() {
        fs::remove_dir_all(folder).map_err(fail)?;
    }
    fs::create_dir_all(folder).map_err(fail)
}

fn files_digest(folder: &Path) -> Result<BTreeMap<String, String>, FilesError> {
    let fail =
        |p: &Path, e: std::io::Error| FilesError::Read { path: p.display().to_string(), reason: reason(&e) };
    let mut out = BTreeMap::new();
    for entry in fs::read_dir(folder).map_err(|e| fail(folder, e))? {
        let path = entry.map_err(|e| fail(folder, e))?.path();
        let name = path.file_name().map(|n| n.to_string_lossy().into_owned()).unwrap_or_default();
        if path.is_file() && name != STEP_RECORD && !name.ends_with(".tmp") {
            out.insert(name, digest(&fs::read(&path).map_err(|e| fail(&path, e))?));
        }
    }
    Ok(out)
}
