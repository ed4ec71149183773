//! The day kept point by point: a run that was interrupted goes on where it stopped.
//!
//! `day.jsonl` in the run folder has a first line with the digest of what the points depend on, and a line for each point with the state
//! in which the plant was left. A later run takes points over as long as it asks for the same ones in the same order; then the plant
//! is put back into the state after the last of them, and the day goes on as if it had never been left. Where the earlier day went another way, all of it stays in `day-1.jsonl` (or the next
//! number): bed time is dear.

use std::fs::{File, OpenOptions};
use std::io::Write;
use std::path::{Path, PathBuf};

use dynocal_calib::steady::day::{self, DayEnd, DayPoint, Measures, Purpose, Task};
use dynocal_calib::steady::station::{Leg, Stand, Station, SteadyPoint, Swept};
use dynocal_files::run_folder::{digest, digest_of};
use dynocal_files::{FilesError, atomic};
use dynocal_ident::plant::PlantState;
use dynocal_ident::play::PlayError;
use dynocal_numerics::watch::Watch;
use serde::{Deserialize, Serialize};
use serde_json::Value;

use super::bench::{Bench, swept};
use super::error::{MapError, stopped};

/// File in the run folder.
pub(super) const FILE: &str = "day.jsonl";
/// Numbers of a state above which days are not kept: a unit that cannot save itself has all that was ever done to it as its state.
const LARGEST: usize = 100_000;

#[derive(Serialize, Deserialize)]
struct Head {
    schema: String,
    schema_version: u32,
    inputs: String,
}

/// What was measured.
#[derive(Clone, Serialize, Deserialize)]
#[serde(untagged)]
enum Measured {
    Point {
        purpose: Purpose,
        target: Vec<f64>,
        #[serde(default, skip_serializing_if = "Option::is_none")]
        via: Option<Vec<f64>>,
        #[serde(default, skip_serializing_if = "Vec::is_empty")]
        gains: Vec<f64>,
        point: SteadyPoint,
    },
    Sweep {
        from: Vec<f64>,
        legs: Vec<Leg>,
        swept: Swept,
    },
}

/// What was measured with the place where it left the bed; numbers of the state as their bits, for they need not be finite.
#[derive(Clone, Serialize, Deserialize)]
struct Kept {
    #[serde(flatten)]
    measured: Measured,
    plant: Vec<u64>,
    at: Vec<f64>,
    driven: Vec<f64>,
    used_s: f64,
}

impl Kept {
    fn stand(&self) -> Stand {
        let plant = PlantState(self.plant.iter().map(|b| f64::from_bits(*b)).collect());
        Stand { plant, at: self.at.clone(), driven: self.driven.clone(), used_s: self.used_s }
    }
}

/// A station whose points are kept.
pub(super) struct Journal<'s, 'a> {
    station: &'s mut Station<'a>,
    path: PathBuf,
    head: String,
    /// Points and sweeps of an earlier run.
    kept: Vec<Kept>,
    /// Those of this run so far.
    count: usize,
    /// Where new points go; none before the first of them, and where the file cannot be written.
    file: Option<File>,
    /// Whether the bed itself measures now.
    live: bool,
    watch: Watch<'s>,
}

impl<'s, 'a> Journal<'s, 'a> {
    /// In `folder`; `inputs` are all that the points depend on.
    ///
    /// # Errors
    /// [`FilesError::Malformed`] where `inputs` cannot be written.
    pub(super) fn open<I: Serialize>(
        station: &'s mut Station<'a>,
        folder: &Path,
        inputs: &I,
        watch: Watch<'s>,
    ) -> Result<Self, FilesError> {
        let inputs = digest_of(&(env!("CARGO_PKG_VERSION"), inputs))?;
        let head = Head { schema: "dynocal/day".into(), schema_version: 2, inputs };
        let path = folder.join(FILE);
        // The latest day goes on; where it is another one, the longest of those that were set aside for it.
        let mut kept = earlier(&path, &head);
        if kept.is_empty() {
            let aside = (1..).map(|k| numbered(&path, k)).take_while(|p| p.exists());
            kept = aside.map(|p| earlier(&p, &head)).max_by_key(Vec::len).unwrap_or_default();
        }
        let head = line(&head).unwrap_or_default();
        Ok(Self { station, path, head, kept, count: 0, file: None, live: false, watch })
    }

    /// From here on the bed measures: what the earlier run had beyond is not of this day, and stands aside.
    fn begin(&mut self) {
        self.live = true;
        self.kept.truncate(self.count);
        match set_aside(&self.path, self.count) {
            Ok(Some((others, path))) => self.watch.note(&format!(
                "{others} points and lines of an earlier day are not taken over: they are of another day (seed, plant, limits, loops, approach or choice of points), or stand behind a line that cannot be read. All of that day is kept in {}",
                path.display()
            )),
            Ok(None) => {}
            Err(e) => {
                self.unkept(&e);
                return;
            }
        }
        if self.count > 0 {
            self.watch.note(&format!("{} points are those of the earlier run", self.count));
        }
        let lines: Vec<String> = self.kept.iter().filter_map(line).collect();
        let text = format!("{}{}", self.head, lines.concat());
        let opened = atomic::write(&self.path, text.as_bytes()).map_err(|e| e.to_string());
        let opened =
            opened.and_then(|()| OpenOptions::new().append(true).open(&self.path).map_err(|e| e.to_string()));
        match opened {
            Ok(file) => self.file = Some(file),
            Err(e) => self.unkept(&e),
        }
    }

    fn unkept(&mut self, why: &str) {
        self.file = None;
        self.watch
            .note(&format!("{}: {why}. A run that is interrupted begins the day anew", self.path.display()));
    }

    /// The next one of the earlier run, where it is what is asked for now.
    fn known(&mut self, same: impl Fn(&Measured) -> bool) -> Option<Measured> {
        let kept = self.kept.get(self.count).filter(|k| !self.live && same(&k.measured))?;
        self.station.go_on(&kept.stand()).ok()?;
        self.count += 1;
        Some(kept.measured.clone())
    }

    fn keep(&mut self, measured: Measured) {
        let Some(file) = &mut self.file else { return };
        let Stand { plant, at, driven, used_s } = self.station.stand();
        if plant.0.len() > LARGEST {
            self.unkept(&format!("the plant has a state of {} numbers, too large to be kept", plant.0.len()));
            return;
        }
        let plant = plant.0.iter().map(|v| v.to_bits()).collect();
        let kept = Kept { measured, plant, at, driven, used_s };
        let written = line(&kept).map(|l| file.write_all(l.as_bytes()).and_then(|()| file.flush()));
        match written {
            Some(Ok(())) => {}
            Some(Err(e)) => self.unkept(&e.to_string()),
            None => self.unkept("a point cannot be written as JSON"),
        }
    }
}

/// Digests of the files that a spec names: a plant whose file has changed is another one.
pub(super) fn digests<T: Serialize>(spec: &T) -> Vec<String> {
    let (mut left, mut found) = (vec![serde_json::to_value(spec).unwrap_or_default()], Vec::new());
    while let Some(value) = left.pop() {
        match value {
            Value::String(path) => found.extend(std::fs::read(path).ok().map(|bytes| digest(&bytes))),
            Value::Array(all) => left.extend(all),
            Value::Object(all) => left.extend(all.into_iter().map(|(_, v)| v)),
            _ => {}
        }
    }
    found
}

/// Copies a day of which more than the first `count` points and lines are there to a name of its own, as it is; their number, and where they are now.
fn set_aside(path: &Path, count: usize) -> Result<Option<(usize, PathBuf)>, String> {
    let bytes = match std::fs::read(path) {
        Ok(bytes) => bytes,
        Err(e) if e.kind() == std::io::ErrorKind::NotFound => return Ok(None),
        // What cannot be read is not written over.
        Err(e) => return Err(format!("the earlier day cannot be read: {e}")),
    };
    // A last line that was cut off is no point.
    let others = bytes.split_inclusive(|b| *b == b'\n').skip(1).filter(|l| l.ends_with(b"\n")).count();
    let others = others.saturating_sub(count);
    if others == 0 {
        return Ok(None);
    }
    let aside = (1..).map(|k| numbered(path, k)).find(|p| !p.exists()).unwrap_or_else(|| numbered(path, 0));
    atomic::write(&aside, &bytes).map_err(|e| e.to_string())?;
    Ok(Some((others, aside)))
}

/// Name of a day that was set aside.
fn numbered(path: &Path, k: u32) -> PathBuf {
    path.with_file_name(format!("day-{k}.jsonl"))
}

fn line<T: Serialize>(value: &T) -> Option<String> {
    serde_json::to_string(value).ok().map(|l| l + "\n")
}

/// Points of an earlier run with the same inputs, up to the first line that was not written to its end.
fn earlier(path: &Path, head: &Head) -> Vec<Kept> {
    let Ok(bytes) = std::fs::read(path) else { return Vec::new() };
    let text = String::from_utf8_lossy(&bytes);
    let mut lines = text.lines();
    let same = lines.next().and_then(|l| serde_json::from_str::<Head>(l).ok()).is_some_and(|h| {
        h.schema == head.schema && h.schema_version == head.schema_version && h.inputs == head.inputs
    });
    if !same {
        return Vec::new();
    }
    lines.map_while(|l| serde_json::from_str(l).ok()).collect()
}

impl Measures for Journal<'_, '_> {
    fn measure(&mut self, task: &Task) -> Result<SteadyPoint, PlayError> {
        let over = task.via.as_ref().map(|c| &c.at);
        let same = |m: &Measured| matches!(m, Measured::Point { purpose: p, target: t, via: v, gains: g, .. } if *p == task.purpose && *t == task.target && v.as_ref() == over && *g == task.gains);
        if let Some(Measured::Point { point, .. }) = self.known(same) {
            return Ok(point);
        }
        if !self.live {
            self.begin();
        }
        let point = self.station.measure(&task.target, task.via.as_ref(), &task.driven, &task.gains)?;
        let (purpose, target, gains) = (task.purpose, task.target.clone(), task.gains.clone());
        self.keep(Measured::Point { purpose, target, via: over.cloned(), gains, point: point.clone() });
        Ok(point)
    }
    fn bed_s(&self) -> f64 {
        self.station.used_s
    }
}

impl Bench for Journal<'_, '_> {
    fn run(
        &mut self,
        tasks: Vec<Task>,
        bed_s: f64,
        points: &mut Vec<DayPoint>,
        watch: Watch,
    ) -> Result<DayEnd, MapError> {
        day::run(self, tasks, bed_s, points, watch).map_err(stopped(watch))
    }
    fn sweep(&mut self, from: &[f64], legs: &[Leg], watch: Watch) -> Result<Option<Swept>, MapError> {
        let same =
            |m: &Measured| matches!(m, Measured::Sweep { from: f, legs: l, .. } if f == from && l == legs);
        if let Some(Measured::Sweep { swept, .. }) = self.known(same) {
            return Ok(Some(swept));
        }
        if !self.live {
            self.begin();
        }
        let swept = swept(self.station.sweep(from, legs), watch)?;
        self.keep(Measured::Sweep { from: from.to_vec(), legs: legs.to_vec(), swept: swept.clone() });
        Ok(Some(swept))
    }
    fn stands_at(&self) -> &[f64] {
        self.station.at()
    }
    fn used_s(&self) -> f64 {
        self.station.used_s
    }
    fn widen_limits(&mut self, share: f64) {
        self.station.widen(share);
    }
}
