//! Long records cut into experiments: by a trigger, by gaps in time, or where a marker changes.

use serde::{Deserialize, Serialize};

use crate::error::FilesError;
use crate::table::{Cells, Table};

/// Where a record is cut.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase", deny_unknown_fields)]
pub enum Cut {
    /// Rows in which `column` is above `above` form the experiments.
    Trigger {
        /// Column.
        column: String,
        /// Level.
        above: f64,
    },
    /// A step in `column` (a time) of more than `longer` starts a new experiment.
    Gap {
        /// Column of stamps.
        column: String,
        /// Longest step within one experiment, in the unit of the column.
        longer: f64,
    },
    /// A change of `column` starts a new experiment.
    Marker {
        /// Column.
        column: String,
    },
}

/// Half-open ranges of rows, for [`crate::dataset::Select::Rows`]; those with fewer than `shortest` rows are left out.
///
/// # Errors
/// [`FilesError::NoColumn`], [`FilesError::Cell`]; [`FilesError::NoSuchValue`] where nothing is left.
///
/// # Examples
/// ```
/// use dynocal_files::split::{Cut, ranges};
/// let table = dynocal_files::measurement::csv_io::parse("a.csv", b"run,x\n0,1\n1,2\n1,3\n0,4\n1,5\n1,6\n").unwrap();
/// let cut = Cut::Trigger { column: "run".into(), above: 0.5 };
/// assert_eq!(ranges(&table, &cut, 2).unwrap(), [(1, 3), (4, 6)]);
/// ```
pub fn ranges(table: &Table, cut: &Cut, shortest: usize) -> Result<Vec<(usize, usize)>, FilesError> {
    let rows = table.rows();
    let (column, said) = match cut {
        Cut::Trigger { column, above } => (column, format!("above {above}")),
        Cut::Gap { column, longer } => (column, format!("without steps over {longer}")),
        Cut::Marker { column } => (column, "constant".into()),
    };
    let all: Vec<(usize, usize)> = match cut {
        Cut::Trigger { column, above } => {
            let v = table.numbers_or_missing(column, 0, rows)?;
            runs(rows, |a, b| (v[a] > *above) == (v[b] > *above))
                .into_iter()
                .filter(|r| v[r.0] > *above)
                .collect()
        }
        Cut::Gap { column, longer } => {
            let v = table.numbers(column, 0, rows)?;
            runs(rows, |a, b| v[b] - v[a] <= *longer)
        }
        Cut::Marker { column } => {
            let cells: &Cells = &table.column(column)?.cells;
            runs(rows, |a, b| cells.same(a, b))
        }
    };
    let kept: Vec<(usize, usize)> = all.into_iter().filter(|(a, b)| b - a >= shortest.max(1)).collect();
    if kept.is_empty() {
        return Err(FilesError::NoSuchValue {
            path: table.file.clone(),
            column: column.clone(),
            found: format!("{said} for {shortest} rows"),
            known: Vec::new(),
        });
    }
    Ok(kept)
}

/// Longest ranges in which neighbouring rows belong together.
fn runs(rows: usize, together: impl Fn(usize, usize) -> bool) -> Vec<(usize, usize)> {
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
