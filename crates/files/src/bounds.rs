//! What a file may become in memory: bounds that are checked before anything of that size is allocated.
//!
//! A file of a megabyte can hold a thousand times as much compressed, and one of a kilobyte can state any number of rows. Longer
//! records are for the formats that are read in pieces (`dynocal show`, `dynocal convert`, MDF 4).

use std::io::{self, Read};

use crate::error::FilesError;

/// Most bytes that what is compressed in one file may inflate to.
pub const MOST_INFLATED: u64 = 1_000_000_000;
/// Most values of a table that is held in memory, 8 bytes each.
pub const MOST_VALUES: u64 = 250_000_000;

/// What a compressed stream holds: it is run through once to see how much it is. `left` is what the file may still inflate to.
///
/// # Errors
/// Broken, or more than that.
pub(crate) fn inflated<R: Read>(
    path: &str,
    left: &mut u64,
    stream: impl Fn() -> R,
) -> io::Result<Result<Vec<u8>, FilesError>> {
    let size = io::copy(&mut stream().take(*left + 1), &mut io::sink())?;
    if size > *left {
        return Ok(Err(FilesError::TooLarge {
            path: path.into(),
            found: format!("more than {:.0} MB when inflated", 1e-6 * MOST_INFLATED as f64),
            most: format!("{:.0} MB", 1e-6 * MOST_INFLATED as f64),
        }));
    }
    *left -= size;
    let mut plain = Vec::with_capacity(size as usize);
    stream().read_to_end(&mut plain)?;
    Ok(Ok(plain))
}

/// A table of so many values is refused before anything is read of it.
pub(crate) fn held(path: &str, rows: u64, columns: usize) -> Result<(), FilesError> {
    let values = rows.saturating_mul(columns as u64);
    if values <= MOST_VALUES {
        return Ok(());
    }
    Err(FilesError::TooLarge {
        path: path.into(),
        found: format!("{rows} rows of {columns} channels"),
        most: format!("{MOST_VALUES} values"),
    })
}

#[cfg(test)]
mod tests {
    use super::{MOST_INFLATED, MOST_VALUES, held, inflated};
    use std::io::{Read, repeat};

    #[test]
    fn what_is_too_much_is_refused_before_it_is_held() {
        assert!(held("a", MOST_VALUES, 1).is_ok());
        assert!(held("a", u64::MAX, 3).is_err());
        let mut left = 15;
        let plain = inflated("a", &mut left, || repeat(0).take(10)).unwrap().unwrap();
        assert_eq!((plain, left), (vec![0; 10], 5));
        // What a file holds counts together.
        let bomb = inflated("a", &mut left, || repeat(0).take(6)).unwrap().unwrap_err();
        assert!(bomb.to_string().contains("1000 MB"), "{bomb}");
        let mut left = MOST_INFLATED;
        assert!(inflated("a", &mut left, || repeat(0)).unwrap().is_err(), "a stream without end");
    }
}
