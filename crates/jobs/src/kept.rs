//! In which format records stay in a run folder: CSV while a person may look into them, Parquet above.

use std::path::Path;

use dynocal_files::measurement::parquet_io;
use dynocal_files::{FilesError, csv_io};

/// Most rows that are written as CSV where nobody asked for it.
pub const MOST_CSV_ROWS: usize = 100_000;

/// Ending of a file with so many rows.
pub fn ending(rows: usize) -> &'static str {
    if rows > MOST_CSV_ROWS { "parquet" } else { "csv" }
}

/// Writes columns (name, unit, values) of equal length as `STEM.csv` or `STEM.parquet` into `folder`; the name of the file.
///
/// # Errors
/// [`FilesError::Write`].
pub fn write_columns(
    folder: &Path,
    stem: &str,
    columns: &[(&str, &str, &[f64])],
) -> Result<String, FilesError> {
    let ending = ending(columns.iter().map(|c| c.2.len()).min().unwrap_or(0));
    let name = format!("{stem}.{ending}");
    let write = if ending == "parquet" { parquet_io::write_columns } else { csv_io::write_columns };
    write(&folder.join(&name), columns)?;
    Ok(name)
}

#[cfg(test)]
mod tests {
    use super::{MOST_CSV_ROWS, write_columns};
    use dynocal_files::dataset::read_table;

    #[test]
    fn long_columns_are_parquet_and_come_back() {
        let tmp = tempfile::tempdir().unwrap();
        for (rows, name) in [(MOST_CSV_ROWS, "y.csv"), (MOST_CSV_ROWS + 1, "y.parquet")] {
            let y: Vec<f64> = (0..rows).map(|t| (t as f64).sin()).collect();
            assert_eq!(write_columns(tmp.path(), "y", &[("y", "Nm", &y)]).unwrap(), name);
            let table = read_table(&tmp.path().join(name), None).unwrap();
            assert_eq!(table.numbers("y", 0, rows).unwrap(), y);
        }
    }
}
