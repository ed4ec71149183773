//! Several rasters on one time axis, by a stated rule, with every loss announced.
//!
//! ```text
//! hold    the last sample at or before t
//! line    the straight line between the samples around t
//! mean    the mean of the samples in (previous t, t]
//! event   the sample whose stamp is t (within the tolerance), else a gap
//! ```
//!
//! Stamps are compared with a tolerance: two clocks write one instant in two ways.

use std::collections::BTreeMap;

use serde::{Deserialize, Serialize};

use crate::error::FilesError;
use crate::measurement::{self, Raster, Source};
use crate::table::{Cells, Column, Table, UnitSource};

/// How a channel comes to the common time axis.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Rule {
    /// The last sample at or before t.
    #[default]
    Hold,
    /// The straight line between the samples around t.
    Line,
    /// The mean of the samples in (previous t, t].
    Mean,
    /// The sample at t, else a gap.
    Event,
}

/// What the user decides.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Keys {
    /// Rule for all channels.
    pub rule: Rule,
    /// Rules of single channels.
    pub rules: BTreeMap<String, Rule>,
    /// A channel (or the name of a group) whose raster is the common one; the one with most samples where absent.
    pub raster: Option<String>,
    /// A uniform common axis instead of a raster of the file, in s.
    pub sample_time_s: Option<f64>,
    /// Stamps that differ by less are equal, in s.
    pub tolerance_s: f64,
}

impl Default for Keys {
    fn default() -> Self {
        Self {
            rule: Rule::Hold,
            rules: BTreeMap::new(),
            raster: None,
            sample_time_s: None,
            tolerance_s: 1e-6,
        }
    }
}

/// A whole file on one time axis: its only table as it is, or its rasters merged.
///
/// # Errors
/// [`FilesError`] of the file, or of [`merge`].
pub fn whole(source: &dyn Source, keys: &Keys) -> Result<Table, FilesError> {
    if let [only] = source.groups()
        && keys.sample_time_s.is_none()
    {
        let all: Vec<usize> = (0..only.channels.len()).collect();
        let mut table = measurement::table(source, 0, &all)?;
        if *keys != Keys::default() {
            table.notes.push("one raster: nothing was merged".into());
        }
        return Ok(table);
    }
    let found = measurement::recording(source)?;
    let mut table = merge(source.file(), &found.rasters, keys)?;
    table.notes.splice(0..0, source.notes().iter().cloned().chain(found.notes));
    Ok(table)
}

/// Puts `rasters` on one time axis; the first column of the result is `time [s]`.
///
/// # Errors
/// [`FilesError::Merge`]: no raster, stamps that do not increase, a raster or channel that does not exist, no common time.
///
/// # Examples
/// ```
/// use dynocal_files::measurement::Raster;
/// use dynocal_files::measurement::merge::{Keys, Rule, merge};
/// use dynocal_files::table::{Cells, Column};
/// let raster = |name: &str, time_s: &[f64], values: &[f64]| Raster {
///     name: name.into(),
///     time_s: time_s.to_vec(),
///     columns: vec![Column { name: name.into(), unit: None, cells: Cells::Number(values.to_vec()) }],
/// };
/// let fast = raster("speed", &[0.0, 0.1, 0.2, 0.3], &[1.0, 2.0, 3.0, 4.0]);
/// let slow = raster("temperature", &[0.0, 0.2], &[80.0, 90.0]);
/// let keys = Keys { rule: Rule::Line, ..Default::default() };
/// let table = merge("a.mf4", &[fast, slow], &keys).unwrap();
/// assert_eq!(table.numbers("temperature", 0, 3).unwrap(), [80.0, 85.0, 90.0]);
/// assert!(table.notes.iter().any(|n| n.contains("1 of 4 rows of the common time have no sample")), "{:?}", table.notes);
/// ```
pub fn merge(file: &str, rasters: &[Raster], keys: &Keys) -> Result<Table, FilesError> {
    let fail = |reason: String| FilesError::Merge { path: file.into(), reason };
    for r in rasters {
        if let Some(k) = r.time_s.windows(2).position(|w| w[1] < w[0] || w[0].is_nan() || w[1].is_nan()) {
            return Err(fail(format!(
                "stamps of raster `{}` go back from {} s to {} s at its row {}",
                label(r),
                r.time_s[k],
                r.time_s[k + 1],
                k + 2
            )));
        }
    }
    for name in keys.rules.keys() {
        if !rasters.iter().flat_map(|r| &r.columns).any(|c| c.name == *name) {
            return Err(fail(format!("a rule is given for `{name}`, but there is no such channel")));
        }
    }
    let (time_s, mut notes) = axis(rasters, keys).map_err(fail)?;
    let unit = Some(("s".to_string(), UnitSource::Bracket));
    let mut columns = vec![Column { name: "time".into(), unit, cells: Cells::Number(time_s.clone()) }];
    for raster in rasters {
        let own = raster.time_s.len() == time_s.len()
            && raster.time_s.iter().zip(&time_s).all(|(a, b)| (a - b).abs() <= keys.tolerance_s);
        let mut lost: BTreeMap<&str, usize> = BTreeMap::new();
        for c in &raster.columns {
            let rule = keys.rules.get(&c.name).copied().unwrap_or(keys.rule);
            let (cells, gaps) = if own {
                (c.cells.clone(), 0)
            } else {
                resample(&raster.time_s, &c.cells, &time_s, rule, keys.tolerance_s)
            };
            if gaps > 0 {
                lost.insert(&c.name, gaps);
            }
            columns.push(Column { name: c.name.clone(), unit: c.unit.clone(), cells });
        }
        notes.extend(losses(raster, &time_s, own, keys, &lost));
    }
    Ok(Table { file: file.into(), columns, lines: Vec::new(), notes })
}

fn label(r: &Raster) -> &str {
    if r.name.is_empty() { r.columns.first().map_or("", |c| c.name.as_str()) } else { &r.name }
}

/// The common axis and what is to be said about it.
fn axis(rasters: &[Raster], keys: &Keys) -> Result<(Vec<f64>, Vec<String>), String> {
    let used = || rasters.iter().filter(|r| !r.time_s.is_empty());
    if let Some(dt) = keys.sample_time_s {
        if !(dt > 0.0 && dt.is_finite()) {
            return Err(format!("found a sample time of {dt} s, expected a positive one"));
        }
        let from = used().map(|r| r.time_s[0]).fold(f64::NEG_INFINITY, f64::max);
        let to = used().map(|r| r.time_s[r.time_s.len() - 1]).fold(f64::INFINITY, f64::min);
        if to <= from {
            return Err(format!(
                "the rasters have no common time: the last begins at {from} s, the first ends at {to} s"
            ));
        }
        let steps = ((to - from) / dt + 1e-9).floor();
        if steps > 1e9 {
            return Err(format!("{steps:.0} samples of {dt} s between {from} s and {to} s are too many"));
        }
        let time_s = (0..=steps as usize).map(|k| from + k as f64 * dt).collect();
        return Ok((
            time_s,
            vec![format!("common time: every {dt} s from {from} s to {to} s, which all rasters cover")],
        ));
    }
    let named = |name: &String| used().find(|r| r.name == *name || r.columns.iter().any(|c| c.name == *name));
    let raster = match &keys.raster {
        Some(name) => {
            named(name).ok_or_else(|| format!("no group or channel `{name}` to take the time from"))?
        }
        // The first of the longest: max_by_key would take the last.
        None => used()
            .fold(None, |best: Option<&Raster>, r| match best {
                Some(b) if b.time_s.len() >= r.time_s.len() => Some(b),
                _ => Some(r),
            })
            .ok_or("no group has samples and a time channel")?,
    };
    let note = format!("common time: raster `{}` with {} rows", label(raster), raster.time_s.len());
    Ok((raster.time_s.clone(), if rasters.len() > 1 { vec![note] } else { Vec::new() }))
}

/// Sentences about what a raster loses.
fn losses(
    raster: &Raster,
    time_s: &[f64],
    own: bool,
    keys: &Keys,
    lost: &BTreeMap<&str, usize>,
) -> Vec<String> {
    let mut notes = Vec::new();
    if own || raster.time_s.is_empty() {
        return notes;
    }
    let tol = keys.tolerance_s;
    let (first, last) = (time_s.first().copied().unwrap_or(0.0), time_s.last().copied().unwrap_or(0.0));
    let outside = raster.time_s.iter().filter(|t| **t < first - tol || **t > last + tol).count();
    let name = label(raster);
    let rule = match keys.rule {
        Rule::Hold => "held",
        Rule::Line => "interpolated",
        Rule::Mean => "averaged",
        Rule::Event => "taken at equal stamps",
    };
    notes.push(format!("raster `{name}`: {} rows {rule} onto {}", raster.time_s.len(), time_s.len()));
    if outside > 0 {
        notes.push(format!("raster `{name}`: {outside} rows lie outside the common time and are lost"));
    }
    // A row is unseen when another row of the raster stands between it and the next common stamp.
    if matches!(keys.rule, Rule::Hold | Rule::Event | Rule::Line) && raster.time_s.len() > time_s.len() {
        notes.push(format!(
            "raster `{name}`: at least {} rows are finer than the common time and are lost (`mean` keeps their average)",
            raster.time_s.len() - time_s.len()
        ));
    }
    if let Some(most) = lost.values().max() {
        let which = if lost.len() == 1 { "channel".into() } else { format!("{} channels", lost.len()) };
        let names: Vec<&str> = lost.keys().take(5).copied().collect();
        notes.push(format!(
            "raster `{name}`: up to {most} of {} rows of the common time have no sample in {which} {}; they are gaps",
            time_s.len(),
            names.join(", ")
        ));
    }
    notes
}

/// Cells at `to`, and how many are gaps that the rule made.
fn resample(from: &[f64], cells: &Cells, to: &[f64], rule: Rule, tolerance: f64) -> (Cells, usize) {
    match cells {
        Cells::Number(v) => {
            let out: Vec<f64> = match rule {
                Rule::Mean => means(from, v, to, tolerance),
                Rule::Line => to.iter().map(|t| line(from, v, *t, tolerance)).collect(),
                _ => picks(from, to, rule, tolerance).iter().map(|k| k.map_or(f64::NAN, |k| v[k])).collect(),
            };
            let gaps = out.iter().filter(|x| x.is_nan()).count();
            let before = v.iter().filter(|x| x.is_nan()).count();
            (Cells::Number(out), gaps.saturating_sub(before))
        }
        // Words have no mean and no line between them: they are held.
        Cells::Text(v) => {
            let rule = if rule == Rule::Event { rule } else { Rule::Hold };
            let picks = picks(from, to, rule, tolerance);
            let gaps = picks.iter().filter(|k| k.is_none()).count();
            (Cells::Text(picks.iter().map(|k| k.map_or(String::new(), |k| v[k].clone())).collect()), gaps)
        }
    }
}

/// Row of `from` for each of `to`: the last at or before it, or the one at it.
fn picks(from: &[f64], to: &[f64], rule: Rule, tolerance: f64) -> Vec<Option<usize>> {
    let last = from.last().copied().unwrap_or(f64::NEG_INFINITY);
    to.iter()
        .map(|t| {
            let k = from.partition_point(|s| *s <= t + tolerance).checked_sub(1)?;
            let keep = match rule {
                Rule::Event => (from[k] - t).abs() <= tolerance,
                // Beyond its last stamp a raster says nothing, but for one interval of its own.
                _ => *t <= last + tolerance + if k > 0 { from[k] - from[k - 1] } else { 0.0 },
            };
            keep.then_some(k)
        })
        .collect()
}

fn line(from: &[f64], v: &[f64], t: f64, tolerance: f64) -> f64 {
    let k = from.partition_point(|s| *s <= t);
    let near = |k: usize| (from[k] - t).abs() <= tolerance;
    match k {
        0 if from.is_empty() || !near(0) => f64::NAN,
        0 => v[0],
        k if near(k - 1) => v[k - 1],
        k if k == from.len() => f64::NAN,
        k => {
            let a = (t - from[k - 1]) / (from[k] - from[k - 1]);
            v[k - 1] + a * (v[k] - v[k - 1])
        }
    }
}

fn means(from: &[f64], v: &[f64], to: &[f64], tolerance: f64) -> Vec<f64> {
    let mut k = 0;
    to.iter()
        .map(|t| {
            let (mut sum, mut n) = (0.0, 0usize);
            while k < from.len() && from[k] <= t + tolerance {
                if !v[k].is_nan() {
                    sum += v[k];
                    n += 1;
                }
                k += 1;
            }
            if n == 0 { f64::NAN } else { sum / n as f64 }
        })
        .collect()
}
