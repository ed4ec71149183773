//! Chunks: which tasks are done is what the names of the files say.

use std::fs;
use std::path::{Path, PathBuf};

use dynocal_files::FilesError;
use serde::{Deserialize, Serialize};
use serde_json::Value;

use super::{Line, folder};
use crate::StudyError;

/// Tasks from the first to the last, both with it.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
pub struct Range {
    /// First task.
    pub first: usize,
    /// Last task.
    pub last: usize,
}

impl Range {
    /// How many.
    pub fn len(self) -> usize {
        self.last - self.first + 1
    }

    /// Never: a range has a first task.
    pub fn is_empty(self) -> bool {
        false
    }

    /// Name of its files.
    pub(super) fn name(self) -> String {
        format!("{:010}-{:010}", self.first, self.last)
    }
}

/// Reads `2/8`: part 2 of 8.
///
/// # Errors
/// What was found, and what is expected.
pub fn parse_share(text: &str) -> Result<(usize, usize), String> {
    let parts = text.split_once('/').and_then(|(i, n)| Some((i.parse().ok()?, n.parse().ok()?)));
    match parts {
        Some((i, n)) if (1..=n).contains(&i) => Ok((i, n)),
        _ => Err(format!("found `{text}`, expected I/N with I from 1 to N, e.g. 2/8")),
    }
}

/// Part `index` of `of` of `count` tasks: neighbours, in sizes that differ by one at most.
pub(super) fn share(count: usize, index: usize, of: usize) -> Result<Range, StudyError> {
    // In 128 bits, for the number of parts is anything that a user may type.
    let edge = |i: usize| (count as u128 * i as u128 / of.max(1) as u128) as usize;
    let (first, end) = (edge(index.saturating_sub(1)), edge(index));
    if !(1..=of).contains(&index) || first == end {
        let reason =
            format!("found part {index} of {of}, expected a part of at most {count} (the number of tasks)");
        return Err(StudyError::Task { what: "shard".into(), reason });
    }
    Ok(Range { first, last: end - 1 })
}

pub(super) fn path(out: &Path, range: Range) -> PathBuf {
    out.join("chunks").join(format!("{}.jsonl", range.name()))
}

/// The chunks that are there, in order. A name that is none of ours is left alone.
pub(super) fn done(out: &Path) -> Result<Vec<Range>, StudyError> {
    let place = out.join("chunks");
    let mut found = Vec::new();
    let read =
        |e: std::io::Error| FilesError::Read { path: place.display().to_string(), reason: e.to_string() };
    for entry in fs::read_dir(&place).map_err(read)? {
        let name = entry.map_err(read)?.file_name().to_string_lossy().into_owned();
        let range = name
            .strip_suffix(".jsonl")
            .and_then(|n| n.split_once('-'))
            .and_then(|(a, b)| Some(Range { first: a.parse().ok()?, last: b.parse().ok()? }));
        found.extend(range.filter(|r| r.first <= r.last));
    }
    found.sort_unstable();
    Ok(found)
}

/// What is left of `range`, cut at multiples of `chunk_tasks`; `done` is in order and may overlap.
pub(super) fn left(range: Range, done: &[Range], chunk_tasks: usize) -> Vec<Range> {
    let mut out = Vec::new();
    let mut cut = |mut first: usize, end: usize| {
        while first < end {
            let stop = ((first / chunk_tasks + 1) * chunk_tasks).min(end);
            out.push(Range { first, last: stop - 1 });
            first = stop;
        }
    };
    let mut at = range.first;
    for d in done {
        if d.first > range.last {
            break;
        }
        cut(at, d.first.min(range.last + 1));
        at = at.max(d.last + 1);
    }
    cut(at, range.last + 1);
    out
}

/// Writes a chunk whole.
pub(super) fn write(out: &Path, range: Range, lines: &[Line]) -> Result<(), StudyError> {
    let mut text = String::new();
    for line in lines {
        text.push_str(
            &serde_json::to_string(line).map_err(|e| folder::bad(&path(out, range), e.to_string()))?,
        );
        text.push('\n');
    }
    dynocal_files::atomic::write(&path(out, range), text.as_bytes())?;
    Ok(())
}

/// Reads a chunk; what is not `range` tasks of the batch, each with its digest, is damaged.
pub(super) fn read(
    out: &Path,
    range: Range,
    digest: &dyn Fn(usize) -> Result<String, StudyError>,
) -> Result<Vec<Line>, StudyError> {
    let file = path(out, range);
    let text = fs::read_to_string(&file).map_err(|e| folder::bad(&file, e.to_string()))?;
    let mut lines = Vec::with_capacity(range.len());
    for (k, text) in text.lines().enumerate() {
        let line: Line =
            serde_json::from_str(text).map_err(|e| folder::bad(&file, format!("line {}: {e}", k + 1)))?;
        let task = range.first + k;
        if line.get("task").and_then(Value::as_u64) != Some(task as u64) {
            return Err(folder::bad(
                &file,
                format!("line {}: found another task, expected task {task}", k + 1),
            ));
        }
        if line.get("digest").and_then(Value::as_str) != Some(&digest(task)?) {
            return Err(folder::bad(&file, format!("line {}: found a task with other inputs", k + 1)));
        }
        lines.push(line);
    }
    if lines.len() != range.len() {
        return Err(folder::bad(&file, format!("found {} lines, expected {}", lines.len(), range.len())));
    }
    Ok(lines)
}

#[cfg(test)]
mod tests {
    use super::{Range, left, parse_share, share};

    fn range(first: usize, last: usize) -> Range {
        Range { first, last }
    }

    #[test]
    fn shares_are_all_tasks_once_and_nearly_equal() {
        for count in [1, 2, 7, 100, 101] {
            for of in 1..=count {
                let parts: Vec<Range> = (1..=of).map(|i| share(count, i, of).unwrap()).collect();
                assert_eq!((parts[0].first, parts[of - 1].last), (0, count - 1));
                assert!(parts.windows(2).all(|w| w[0].last + 1 == w[1].first));
                let sizes = parts.iter().map(|p| p.len());
                assert!(sizes.clone().max().unwrap() - sizes.min().unwrap() <= 1);
            }
        }
        for (index, of) in [(0, 2), (3, 2), (1, 0), (1, usize::MAX)] {
            assert!(share(5, index, of).is_err(), "{index}/{of}");
        }
    }

    #[test]
    fn a_share_is_read_as_part_and_number() {
        assert_eq!(parse_share("2/8"), Ok((2, 8)));
        for bad in ["", "2", "0/8", "9/8", "a/8", "1/0", "-1/2", "1/2/3", "1.5/2"] {
            assert!(parse_share(bad).unwrap_err().contains("expected I/N"), "{bad}");
        }
    }

    /// By a second way: every task of the range is done or left, never both, and no chunk crosses a multiple.
    #[test]
    fn what_is_left_is_what_no_chunk_holds() {
        let cases = [
            vec![],
            vec![range(0, 0)],
            vec![range(0, 9), range(5, 14)],
            vec![range(3, 3), range(8, 30)],
            vec![range(0, 99)],
        ];
        for done in &cases {
            for (whole, size) in
                [(range(0, 29), 7), (range(5, 20), 1), (range(4, 4), 10), (range(0, 29), 1000)]
            {
                let found = left(whole, done, size);
                for task in whole.first..=whole.last {
                    let has = |ranges: &[Range]| {
                        ranges.iter().filter(|r| (r.first..=r.last).contains(&task)).count()
                    };
                    assert_eq!(has(&found), usize::from(has(done) == 0), "{task} of {done:?}");
                }
                assert!(found.iter().all(|r| r.first / size == r.last / size && r.len() <= size));
                assert!(found.iter().all(|r| whole.first <= r.first && r.last <= whole.last));
            }
        }
    }
}
