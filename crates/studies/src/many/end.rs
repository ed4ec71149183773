//! The end of a study: all chunks read once, in the order of the tasks.

use std::fs;
use std::path::Path;

use dynocal_files::run_folder::RunFolder;
use dynocal_numerics::watch::Watch;
use serde::{Deserialize, Serialize};
use serde_json::Value;

use super::chunks::{self, Range};
use super::spec::JobStudy;
use super::table::{Columns, Spread};
use super::{Batch, Ended, Line, Written, folder, page, work};
use crate::StudyError;

/// All lines of a study, read from their files.
pub struct Lines<'a> {
    batch: &'a Batch<'a>,
    out: &'a Path,
}

impl Lines<'_> {
    /// Every line in the order of the tasks, each once; one chunk at a time is in memory.
    ///
    /// # Errors
    /// Those of `f`, and [`StudyError::Files`] for a chunk that is not what its name says: it is set aside as `*.damaged`.
    pub fn each(&self, f: &mut dyn FnMut(&Line) -> Result<(), StudyError>) -> Result<(), StudyError> {
        let digest = |task| work::digest(self.batch, task);
        let mut next = 0;
        for range in chunks::done(self.out)? {
            // One that reaches no further than those before brings nothing new.
            if range.last < next || range.last >= self.batch.count {
                continue;
            }
            let lines = chunks::read(self.out, range, &digest).inspect_err(|_| set_aside(self.out, range))?;
            lines.iter().skip(next - range.first).try_for_each(&mut *f)?;
            next = range.last + 1;
        }
        Ok(())
    }
}

fn set_aside(out: &Path, range: Range) {
    let path = chunks::path(out, range);
    // It stays where it cannot be moved, and the error says so again.
    drop(fs::rename(&path, path.with_extension("damaged")));
}

/// Writes the results; none where a chunk turned out to be damaged, whose tasks are left then.
pub(super) fn finish(batch: &Batch, out: &Path, watch: Watch) -> Result<Option<Ended>, StudyError> {
    let held = folder::hold(batch, out, watch)?;
    watch.note("all tasks are done: reading their results");
    let before = chunks::done(out)?.len();
    match (batch.end)(&Lines { batch, out }, &held) {
        Ok(written) => {
            folder::sweep(out);
            let (summary, report) = (out.join("summary.json"), out.join("report.html"));
            Ok(Some(Ended { written, summary, report }))
        }
        Err(e) if chunks::done(out)?.len() < before => {
            watch.note(&format!("{e}: its tasks are done again"));
            Ok(None)
        }
        Err(e) => Err(e),
    }
}

#[derive(Serialize)]
struct Summary<'a> {
    verb: &'static str,
    name: &'a str,
    job: &'a str,
    valid: bool,
    verdict: &'a [String],
    warnings: &'a [String],
    tasks: usize,
    done: usize,
    not_valid: usize,
    failed: usize,
    waiting: usize,
    seeds: usize,
    points: usize,
    results: &'a [Spread],
    files: [&'static str; 3],
}

/// How many tasks ended how.
#[derive(Default)]
pub(super) struct Count {
    pub(super) tasks: usize,
    pub(super) done: usize,
    pub(super) not_valid: usize,
    pub(super) failed: usize,
    pub(super) waiting: usize,
    /// Task, and what was said, of the first that are no good.
    pub(super) bad: Vec<(u64, String)>,
}

/// Most tasks that are named on the page.
const MOST_NAMED: usize = 20;

impl Count {
    fn push(&mut self, line: &Line) {
        self.tasks += 1;
        let status = line.get("status").and_then(Value::as_str).unwrap_or("failed");
        let valid = line.get("valid").and_then(Value::as_bool).unwrap_or(false);
        match (status, valid) {
            ("done", true) => self.done += 1,
            ("done", false) => {
                self.done += 1;
                self.not_valid += 1;
            }
            ("waiting", _) => self.waiting += 1,
            _ => self.failed += 1,
        }
        if !(status == "done" && valid) && self.bad.len() < MOST_NAMED {
            let warned = || line.get("result")?.get("warnings")?.get(0)?.as_str();
            let said = line.get("error").and_then(Value::as_str).or_else(warned).unwrap_or("not valid");
            self.bad.push((line.get("task").and_then(Value::as_u64).unwrap_or(0), said.to_string()));
        }
    }

    fn verdict(&self, job: &str) -> Vec<String> {
        let good = self.done - self.not_valid;
        let mut out = vec![format!("{good} of {} runs of {job} are valid.", self.tasks)];
        if self.not_valid > 0 {
            out.push(format!("{} ended with a result that must not be used as it is.", self.not_valid));
        }
        if self.failed > 0 {
            out.push(format!("{} could not be done.", self.failed));
        }
        if self.waiting > 0 {
            out.push(format!("{} wait for measurements of a bed.", self.waiting));
        }
        if good < self.tasks {
            out.push("Means and spreads are those of all runs that ended, valid or not.".into());
        }
        out
    }
}

/// Writes results.parquet, summary and page of a job over seeds and points.
pub(super) fn of_job(study: &JobStudy, lines: &Lines, folder: &RunFolder) -> Result<Written, StudyError> {
    if let Some(written) = earlier(folder.path()) {
        return Ok(written);
    }
    let (mut columns, mut count) = (Columns::default(), Count::default());
    lines.each(&mut |line| {
        columns.push(line);
        count.push(line);
        Ok(())
    })?;
    let verdict = count.verdict(&study.job);
    let mut warnings = Vec::new();
    if count.failed + count.not_valid + count.waiting > 0 {
        warnings.push(verdict[1..].join(" "));
    }
    if columns.cut {
        warnings.push(
            "There are more numbers than results.parquet has columns: the rest is in the chunks.".into(),
        );
    }
    let valid = count.done - count.not_valid == count.tasks;
    let results = columns.spreads();
    columns.write(&folder.path().join("results.parquet"))?;
    page::write(study, &count, &verdict, &warnings, &results, folder.path())?;
    folder.write_summary(&Summary {
        verb: "study",
        name: &study.name,
        job: &study.job,
        valid,
        verdict: &verdict,
        warnings: &warnings,
        tasks: count.tasks,
        done: count.done,
        not_valid: count.not_valid,
        failed: count.failed,
        waiting: count.waiting,
        seeds: study.seeds.len(),
        points: study.points.len(),
        results: &results,
        files: ["report.html", "results.parquet", "chunks/"],
    })?;
    Ok(Written { valid, verdict, checks: Vec::new() })
}

/// What another worker has written of the same lines: a summary goes as soon as a chunk is done anew.
fn earlier(out: &Path) -> Option<Written> {
    #[derive(Deserialize)]
    struct Said {
        valid: bool,
        verdict: Vec<String>,
    }
    let there = out.join("report.html").exists() && out.join("results.parquet").exists();
    let said: Said = dynocal_files::json::read(&out.join("summary.json")).ok().filter(|_| there)?;
    Some(Written { valid: said.valid, verdict: said.verdict, checks: Vec::new() })
}
