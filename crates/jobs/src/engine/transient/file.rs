//! A file of inputs over time.

use dynocal_files::table::Table;
use dynocal_files::units;
use dynocal_ident::plant::Variable;

use crate::engine::EngineJobError;

/// What is wrong with a file of inputs, with the bed's file, or with the way of sampling.
#[derive(Debug, thiserror::Error)]
pub enum DriveFileError {
    /// No time.
    #[error("{file}: no column `time` in s; there are: {columns}")]
    Time {
        /// File.
        file: String,
        /// Columns that there are.
        columns: String,
    },
    /// A column that is no input.
    #[error("{file}: column `{column}` is no input of this bed; inputs: {known}")]
    Unknown {
        /// File.
        file: String,
        /// Column.
        column: String,
        /// Inputs of the bed.
        known: String,
    },
    /// Two columns of the same input.
    #[error("{file}: columns `{first}` and `{second}` are both `{input}`: expected one")]
    Twice {
        /// File.
        file: String,
        /// One.
        first: String,
        /// The other.
        second: String,
        /// Input.
        input: String,
    },
    /// A value outside the range of its input.
    #[error("{file}: {place}: {column} = {found} {unit}: expected {min} to {max} {unit}")]
    Range {
        /// File.
        file: String,
        /// Line or row.
        place: String,
        /// Column.
        column: String,
        /// Value.
        found: f64,
        /// Unit of the input.
        unit: String,
        /// Its least value.
        min: f64,
        /// Its greatest value.
        max: f64,
    },
    /// A column in another unit.
    #[error("{file}: column `{column}` is in {found}: expected {expected}")]
    Unit {
        /// File.
        file: String,
        /// Column.
        column: String,
        /// Its unit.
        found: String,
        /// The unit of the input.
        expected: String,
    },
    /// Time does not grow.
    #[error("{file}: row {row}: time {found} s: expected a time after that of the row before")]
    Order {
        /// File.
        file: String,
        /// Row of the data, from 1.
        row: usize,
        /// Time in s.
        found: f64,
    },
    /// Too few rows.
    #[error("{file}: {rows} rows: expected at least 2")]
    Short {
        /// File.
        file: String,
        /// Rows that there are.
        rows: usize,
    },
    /// The bed's file.
    #[error("bed file {file}: {message}")]
    Bed {
        /// File.
        file: String,
        /// What is wrong.
        message: String,
    },
    /// A sample time out of its range.
    #[error("--every-s {0}: expected more than 0 and at most 10 s")]
    Sample(f64),
    /// A sample angle out of its range.
    #[error("--every-deg {0}: expected more than 0 and at most 7200 deg")]
    Angle(f64),
    /// A record that does not fit into memory.
    #[error(
        "{file}: about {samples:.2e} samples of {variables} variables: expected at most {most:.0e} values in all; sample less often or drive a shorter file"
    )]
    Large {
        /// File.
        file: String,
        /// Samples.
        samples: f64,
        /// Variables of the bed.
        variables: usize,
        /// Most values.
        most: f64,
    },
    /// A plan has a sample time of its own.
    #[error("{file}: a plan is sampled every {expected_s} s: leave out --every-s and --every-deg")]
    Sampled {
        /// File.
        file: String,
        /// Its sample time in s.
        expected_s: f64,
    },
}

/// Inputs over time: for each input of the bed a column of the file, or none.
pub(super) struct Drive {
    pub(super) time_s: Vec<f64>,
    pub(super) columns: Vec<Option<Vec<f64>>>,
}

impl Drive {
    /// The last row holds as long as the one before it; length in s.
    pub(super) fn length_s(&self) -> f64 {
        let n = self.time_s.len();
        2.0 * self.time_s[n - 1] - self.time_s[n - 2] - self.time_s[0]
    }

    /// Whether every value lies in the range of its input.
    ///
    /// # Errors
    /// [`DriveFileError::Range`] for the first one that does not.
    pub(super) fn within(&self, data: &Table, inputs: &[Variable]) -> Result<(), DriveFileError> {
        for row in 0..self.time_s.len() {
            for (v, column) in inputs.iter().zip(&self.columns) {
                let Some(found) = column.as_ref().map(|c| c[row]) else { continue };
                if found < v.min || found > v.max {
                    let (file, place) = (data.file.clone(), data.place(row));
                    let (column, unit) = (v.name.clone(), v.unit.clone());
                    return Err(DriveFileError::Range {
                        file,
                        place,
                        column,
                        found,
                        unit,
                        min: v.min,
                        max: v.max,
                    });
                }
            }
        }
        Ok(())
    }
}

/// Column for a name, with or without the unit as a suffix (`speed`, `speed_rpm`).
pub(super) fn column_of(data: &Table, name: &str) -> Option<usize> {
    data.columns.iter().position(|c| stem(&c.name) == name || c.name == name)
}

/// Name without a suffix that stands for a unit.
fn stem(name: &str) -> &str {
    match (units::from_suffix(name), name.rsplit_once('_')) {
        (Some(_), Some((stem, _))) => stem,
        _ => name,
    }
}

/// The columns that are inputs of the bed.
///
/// # Errors
/// [`DriveFileError`].
pub(super) fn drive(data: &Table, inputs: &[Variable]) -> Result<Drive, EngineJobError> {
    let file = || data.file.clone();
    let names = |v: &mut dyn Iterator<Item = &str>| v.collect::<Vec<_>>().join(", ");
    let time = column_of(data, "time").ok_or_else(|| DriveFileError::Time {
        file: file(),
        columns: names(&mut data.columns.iter().map(|c| c.name.as_str())),
    })?;
    let mut columns: Vec<Option<Vec<f64>>> = vec![None; inputs.len()];
    let mut names_of: Vec<Option<&str>> = vec![None; inputs.len()];
    for (i, c) in data.columns.iter().enumerate() {
        let place = inputs.iter().position(|v| v.name == c.name || v.name == stem(&c.name));
        let expected = match place {
            Some(k) => inputs[k].unit.clone(),
            None if i == time => "s".into(),
            None => {
                let known = names(&mut inputs.iter().map(|v| v.name.as_str()));
                return Err(DriveFileError::Unknown { file: file(), column: c.name.clone(), known }.into());
            }
        };
        if let Some((found, _)) = c.unit.as_ref().filter(|(u, _)| *u != units::normalise(&expected)) {
            let (column, found) = (c.name.clone(), found.clone());
            return Err(DriveFileError::Unit { file: file(), column, found, expected }.into());
        }
        if let Some(k) = place {
            if let Some(first) = names_of[k].replace(&c.name) {
                let (first, second, input) = (first.to_owned(), c.name.clone(), inputs[k].name.clone());
                return Err(DriveFileError::Twice { file: file(), first, second, input }.into());
            }
            columns[k] = Some(data.numbers(&c.name, 0, data.rows())?.to_vec());
        }
    }
    if data.rows() < 2 {
        return Err(DriveFileError::Short { file: file(), rows: data.rows() }.into());
    }
    let time_s = data.numbers(&data.columns[time].name, 0, data.rows())?.to_vec();
    if let Some(k) = (1..time_s.len()).find(|&k| time_s[k] <= time_s[k - 1]) {
        return Err(DriveFileError::Order { file: file(), row: k + 1, found: time_s[k] }.into());
    }
    Ok(Drive { time_s, columns })
}
