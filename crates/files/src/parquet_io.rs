//! placeholder
use crate::{FilesError, table::Table};
use std::path::Path;
/// x
pub fn read(path: &Path) -> Result<Table, FilesError> {
    Err(FilesError::Format { path: path.display().to_string() })
}
