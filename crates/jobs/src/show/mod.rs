//! What is in a measurement file: channels, units, rates, ranges, gaps.
//!
//! [`contents`] reads a file piece by piece: where the format allows it, memory holds one piece of all channels whatever the
//! length.

pub mod page;
mod tally;

use std::path::Path;

use dynocal_files::FilesError;
use dynocal_files::dataset::Format;
use dynocal_files::measurement::{self, ChannelInfo, ReadKeys, Source};
use dynocal_files::table::Cells;
use dynocal_files::units;
use dynocal_numerics::interval::Interval;
use serde::Serialize;

use tally::{Clock, Tally};

/// One channel of a file.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct ChannelSummary {
    /// Name.
    pub name: String,
    /// Unit, empty where the file has none.
    pub unit: String,
    /// Rows.
    pub rows: u64,
    /// Rows without a value.
    pub gaps: u64,
    /// Least value; none where there is no number.
    pub min: Option<f64>,
    /// Greatest value.
    pub max: Option<f64>,
    /// Mean of the values that are there.
    pub mean: Option<f64>,
    /// First states, of a channel of words.
    pub states: Vec<String>,
    /// Cells that are words in a channel of numbers, with the first of them: faults of the file rather than states.
    pub words: Option<(u64, String)>,
    /// A thinned trace, one entry for each of the group's `trace_time`; empty for words.
    #[serde(skip)]
    pub trace: Vec<Extremes>,
}

/// Least and greatest value of a stretch of a channel; NaN where it holds none.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Extremes {
    /// Least value.
    pub min: f64,
    /// Greatest value.
    pub max: f64,
}

/// One group of a file.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct GroupSummary {
    /// Name; may be empty.
    pub name: String,
    /// Rows.
    pub rows: u64,
    /// Name of the time channel; empty where there is none.
    pub time: String,
    /// Least and greatest stamp in s.
    pub span_s: Option<Interval>,
    /// Mean of the intervals in s by which stamps go forward.
    pub interval_s: Option<f64>,
    /// Longest interval in s, where it is more than one and a half times the mean.
    pub longest_interval_s: Option<f64>,
    /// Stamps that are not after the one before.
    pub stamps_not_increasing: u64,
    /// Channels but time.
    pub channels: Vec<ChannelSummary>,
    /// Rows of one stretch of the thinned traces.
    #[serde(skip)]
    pub stretch: u64,
    /// First stamp in s of each stretch of the thinned traces, or its first row where `trace_in_rows`.
    #[serde(skip)]
    pub trace_time: Vec<f64>,
    /// Whether the traces are over rows: no time, or stamps that do not increase.
    #[serde(skip)]
    pub trace_in_rows: bool,
}

/// What is in a file.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Contents {
    /// File.
    pub file: String,
    /// Format.
    pub format: String,
    /// What was decided or left out while it was read.
    pub notes: Vec<String>,
    /// Groups.
    pub groups: Vec<GroupSummary>,
}

/// Stretches of a thinned trace.
const STRETCHES: u64 = 500;

/// Reads a file once and says what is in it.
///
/// # Errors
/// [`FilesError`].
///
/// # Examples
/// ```
/// use dynocal_jobs::show::contents;
/// let tmp = tempfile::tempdir().unwrap();
/// let path = tmp.path().join("bed.csv");
/// dynocal_files::atomic::write(&path, b"time [ms],torque [Nm]\n0,30\n20,\n40,50\n").unwrap();
/// let found = contents(&path, None, &Default::default()).unwrap();
/// let (group, torque) = (&found.groups[0], &found.groups[0].channels[0]);
/// let span_s = group.span_s.map(<(f64, f64)>::from);
/// assert_eq!((span_s, group.interval_s), (Some((0.0, 0.04)), Some(0.02)));
/// assert_eq!((torque.rows, torque.gaps, torque.mean), (3, 1, Some(40.0)));
/// ```
pub fn contents(path: &Path, format: Option<Format>, keys: &ReadKeys) -> Result<Contents, FilesError> {
    let name = match format {
        Some(f) => String::from(f),
        None => measurement::recognise(path)?.doc.name.to_string(),
    };
    let source = measurement::open(path, Some(&name), keys)?;
    let groups = (0..source.groups().len()).map(|g| group(source.as_ref(), g)).collect::<Result<_, _>>()?;
    Ok(Contents { file: path.display().to_string(), format: name, notes: source.notes().to_vec(), groups })
}

fn group(source: &dyn Source, g: usize) -> Result<GroupSummary, FilesError> {
    let info = &source.groups()[g];
    let time = info.time.or_else(|| measurement::time_channel(info));
    let stride = info.rows.div_ceil(STRETCHES).max(1);
    let all: Vec<usize> = (0..info.channels.len()).collect();
    let mut tallies: Vec<Tally> = all.iter().map(|_| Tally::new(stride)).collect();
    let mut clock = Clock::new(stride);
    source.chunks(g, &all, &mut |chunk| {
        tallies.iter_mut().zip(chunk).for_each(|(tally, cells)| tally.take(cells));
        if let Some(Cells::Number(stamps)) = time.map(|t| &chunk[t]) {
            clock.take(stamps);
        }
        Ok(())
    })?;
    let summary = |(c, t): (&ChannelInfo, Tally)| t.summary(&c.name, c.unit.as_deref());
    let mut channels: Vec<ChannelSummary> = info.channels.iter().zip(tallies).map(summary).collect();
    let time = time.map(|t| channels.remove(t));
    // Stamps whose unit nobody says are in s.
    let unit = time.as_ref().map_or("s", |t| if t.unit.is_empty() { "s" } else { t.unit.as_str() });
    let scale = units::conversion(unit, "s").map(|c| c.0).filter(|_| clock.rows > 0);
    let interval = (clock.steps > 0).then(|| clock.forward / clock.steps as f64);
    let mut trace_time: Vec<f64> = clock.trace.iter().map(|t| t * scale.unwrap_or(1.0)).collect();
    let trace_in_rows = scale.is_none()
        || trace_time.windows(2).any(|w| !(w[1] > w[0]))
        || !trace_time.iter().all(|t| t.is_finite());
    if trace_in_rows {
        trace_time = (0..info.rows.div_ceil(stride)).map(|k| (k * stride) as f64).collect();
    }
    Ok(GroupSummary {
        name: info.name.clone(),
        rows: info.rows,
        time: time.map_or(String::new(), |t| t.name),
        span_s: scale.map(|s| Interval::new(clock.least * s, clock.greatest * s)),
        interval_s: interval.zip(scale).map(|(i, s)| i * s),
        longest_interval_s: interval
            .filter(|i| clock.longest > 1.5 * i)
            .zip(scale)
            .map(|(_, s)| clock.longest * s),
        stamps_not_increasing: clock.backward,
        channels,
        stretch: stride,
        trace_time,
        trace_in_rows,
    })
}
