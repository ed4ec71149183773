//! Results as JSON: pretty, keys in the order of the struct, numbers that read back to the same bits,
//! a schema name and version first.

use std::path::Path;

use serde::de::DeserializeOwned;
use serde::{Deserialize, Serialize};

use crate::atomic;
use crate::error::{FilesError, reason};

/// A result with the name and version of its layout.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct Versioned<T> {
    /// Name of the layout, e.g. `dynocal/model`.
    pub schema: String,
    /// Version of the layout; a change that breaks readers increases it.
    pub schema_version: u32,
    /// The result itself, at the same level.
    #[serde(flatten)]
    pub body: T,
}

/// Pretty JSON text of `value`, ending in a newline.
///
/// # Errors
/// [`FilesError::Malformed`] when the value has keys that JSON cannot hold.
pub fn to_text<T: Serialize + ?Sized>(value: &T) -> Result<String, FilesError> {
    let mut text = serde_json::to_string_pretty(value).map_err(|e| FilesError::Malformed {
        path: "value".into(),
        format: "JSON",
        reason: e.to_string(),
    })?;
    text.push('\n');
    Ok(text)
}

/// Writes `value` as pretty JSON, whole. A non-finite number becomes `null`.
///
/// # Errors
/// [`FilesError::Write`].
pub fn write<T: Serialize + ?Sized>(path: &Path, value: &T) -> Result<(), FilesError> {
    atomic::write(path, to_text(value)?.as_bytes())
}

/// Writes `value` with `schema` and `version` as its first keys.
///
/// # Errors
/// [`FilesError::Write`].
///
/// # Examples
/// ```
/// # use std::collections::BTreeMap;
/// let folder = tempfile::tempdir().unwrap();
/// let path = folder.path().join("model.json");
/// let theta = BTreeMap::from([("theta".to_string(), vec![0.1, 0.2])]);
/// dynocal_files::json::write_versioned(&path, "dynocal/example", 1, &theta).unwrap();
/// let back: BTreeMap<String, Vec<f64>> =
///     dynocal_files::json::read_versioned(&path, "dynocal/example", 1).unwrap();
/// assert_eq!(back, theta);
/// ```
pub fn write_versioned<T: Serialize>(
    path: &Path,
    schema: &str,
    version: u32,
    value: &T,
) -> Result<(), FilesError> {
    write(path, &Versioned { schema: schema.into(), schema_version: version, body: value })
}

/// Reads JSON from `path`.
///
/// # Errors
/// [`FilesError::Read`], or [`FilesError::Malformed`] with line and column.
pub fn read<T: DeserializeOwned>(path: &Path) -> Result<T, FilesError> {
    let name = path.display().to_string();
    let bytes =
        std::fs::read(path).map_err(|e| FilesError::Read { path: name.clone(), reason: reason(&e) })?;
    if bytes.is_empty() {
        return Err(FilesError::Empty { path: name, expected: "a JSON document" });
    }
    serde_json::from_slice(&bytes).map_err(|e| FilesError::Malformed {
        path: name,
        format: "JSON",
        reason: e.to_string(),
    })
}

/// Reads JSON that [`write_versioned`] wrote, of this schema and at most this version.
///
/// # Errors
/// As [`read`], and [`FilesError::Schema`] for another kind or a newer version.
pub fn read_versioned<T: DeserializeOwned>(path: &Path, schema: &str, version: u32) -> Result<T, FilesError> {
    let value: serde_json::Value = read(path)?;
    let name = value.get("schema").and_then(|s| s.as_str()).unwrap_or("none");
    let found = value.get("schema_version").and_then(serde_json::Value::as_u64).unwrap_or(0);
    if name != schema || found == 0 || found > u64::from(version) {
        return Err(FilesError::Schema {
            path: path.display().to_string(),
            found: format!("schema `{name}` version {found}"),
            expected: format!("schema `{schema}` version 1 to {version}"),
        });
    }
    let v: Versioned<T> = serde_json::from_value(value).map_err(|e| FilesError::Malformed {
        path: path.display().to_string(),
        format: "JSON",
        reason: e.to_string(),
    })?;
    Ok(v.body)
}
