//! Long records cut into experiments: where a trigger is on, or at pauses of the time. (A marker that changes from experiment to
//! experiment is [`crate::dataset::Layout::trajectory`].)

use std::ops::Range;

use serde::{Deserialize, Serialize};

use crate::error::FilesError;
use crate::table::Table;
use crate::units;

/// Where a record is cut, and which pieces count.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Cut {
    /// Where.
    pub by: By,
    /// Pieces with fewer rows are left out.
    pub shortest: usize,
}

/// Where a record is cut.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum By {
    /// Every run of rows in which `column` is above `above` is an experiment; other rows belong to none.
    Trigger {
        /// Column.
        column: String,
        /// Level.
        above: f64,
    },
    /// A pause of more than `longer_s` between two stamps starts a new experiment; so do stamps that go back.
    Gap {
        /// Column of stamps.
        column: String,
        /// Unit of the stamps where the file does not say it.
        unit: Option<String>,
        /// Longest pause within one experiment, in s.
        longer_s: f64,
    },
}

/// The experiments of a record.
#[derive(Clone, Debug, PartialEq)]
pub struct Experiments {
    /// Half-open ranges of rows, in order.
    pub ranges: Vec<Range<usize>>,
    /// Where the record was cut and what is left out, in the user's words.
    pub note: String,
}

/// Cuts a record.
///
/// # Errors
/// [`FilesError`]: no such column, a cell that is no number, stamps in no unit of time, nothing left.
///
/// # Examples
/// ```
/// use dynocal_files::split::{By, Cut, experiments};
/// let table = dynocal_files::measurement::csv_io::parse("a.csv", b"run,x\n0,1\n1,2\n1,3\n0,4\n1,5\n1,6\n1,7\n0,8\n1,9\n").unwrap();
/// let cut = Cut { by: By::Trigger { column: "run".into(), above: 0.5 }, shortest: 2 };
/// let found = experiments(&table, &cut).unwrap();
/// assert_eq!(found.ranges, [1..3, 4..7]);
/// assert_eq!(
///     found.note,
///     "cut where `run` is above 0.5: 2 experiments, 5 of 9 rows; 1 piece of fewer than 2 rows is left out"
/// );
/// ```
pub fn experiments(table: &Table, cut: &Cut) -> Result<Experiments, FilesError> {
    let rows = table.rows();
    let (said, pieces) = match &cut.by {
        By::Trigger { column, above } => {
            let v = table.numbers_or_missing(column, 0, rows)?;
            let mut pieces = runs(rows, |a, b| (v[a] > *above) == (v[b] > *above));
            pieces.retain(|r| v[r.0] > *above);
            (format!("where `{column}` is above {above}"), pieces)
        }
        By::Gap { column, unit, longer_s } => {
            let v = table.numbers(column, 0, rows)?;
            let scale = seconds(table, column, unit.as_deref())?;
            let together = |a: usize, b: usize| (0.0..=*longer_s).contains(&((v[b] - v[a]) * scale));
            (format!("at pauses of `{column}` over {longer_s} s"), runs(rows, together))
        }
    };
    let found = pieces.len();
    let kept: Vec<(usize, usize)> =
        pieces.into_iter().filter(|(a, b)| b - a >= cut.shortest.max(1)).collect();
    let short = match found - kept.len() {
        0 => String::new(),
        1 => format!("; 1 piece of fewer than {} rows is left out", cut.shortest),
        n => format!("; {n} pieces of fewer than {} rows are left out", cut.shortest),
    };
    if kept.is_empty() {
        return Err(FilesError::NoExperiment { path: table.file.clone(), cut: said + &short });
    }
    let inside: usize = kept.iter().map(|(a, b)| b - a).sum();
    let s = if kept.len() == 1 { "" } else { "s" };
    let note = format!("cut {said}: {} experiment{s}, {inside} of {rows} rows{short}", kept.len());
    Ok(Experiments { ranges: kept.into_iter().map(|(from, to)| from..to).collect(), note })
}

/// Factor that brings the stamps of a column to s.
fn seconds(table: &Table, column: &str, unit: Option<&str>) -> Result<f64, FilesError> {
    let given = table.column(column)?.unit.as_ref().map(|u| u.0.clone());
    let Some(found) = unit.map(units::normalise).or(given) else {
        return Err(FilesError::NoTimeUnit { path: table.file.clone(), column: column.into() });
    };
    units::conversion(&found, "s").map(|c| c.0).ok_or_else(|| FilesError::Unit {
        path: table.file.clone(),
        column: column.into(),
        found,
        expected: "s".into(),
        hint: " (or ms, min, h)".into(),
    })
}

/// Longest ranges in which neighbouring rows belong together.
pub(crate) fn runs(rows: usize, together: impl Fn(usize, usize) -> bool) -> Vec<(usize, usize)> {
    let (mut out, mut start) = (Vec::new(), 0);
    for row in 1..rows {
        if !together(row - 1, row) {
            out.push((start, row));
            start = row;
        }
    }
    if rows > start {
        out.push((start, rows));
    }
    out
}

/// What of the ranges `a` lies in those of `b`; both in order or not.
pub(crate) fn within(a: &[(usize, usize)], b: &[Range<usize>]) -> Vec<(usize, usize)> {
    let common = |x: &(usize, usize), y: &Range<usize>| (x.0.max(y.start), x.1.min(y.end));
    a.iter().flat_map(|x| b.iter().map(move |y| common(x, y))).filter(|r| r.0 < r.1).collect()
}
