//! JSON with a schema version: the neutral form as it is, programs included.

use dynocal_numerics::registry::MemberDoc;
use serde::{Deserialize, Serialize};

use crate::characteristic::identifier;
use crate::error::ExportError;
use crate::format::{Export, Holds, OutFile};
use crate::package::Package;

/// Name of the schema.
pub const SCHEMA: &str = "dynocal/export";
/// Its version.
pub const VERSION: u32 = 1;

/// Row of the table of exports.
pub const EXPORT: Export = Export {
    doc: MemberDoc { name: "json", what: "JSON of the neutral form, with a schema version", params: &[] },
    holds: &[Holds::Characteristics, Holds::Programs],
    ecu_names: true,
    write: |package, _| {
        let stored = Stored { schema: SCHEMA.into(), version: VERSION, package: package.clone() };
        let bytes = serde_json::to_vec_pretty(&stored).map_err(|e| ExportError::Tool(e.to_string()))?;
        Ok(vec![OutFile { name: format!("{}.json", identifier(&package.name)), bytes }])
    },
    read: Some((".json", read)),
};

#[derive(Serialize, Deserialize)]
struct Stored {
    schema: String,
    version: u32,
    package: Package,
}

/// Reads a file.
///
/// # Errors
/// [`ExportError::Malformed`]: no JSON, another schema, a newer version, or a package that contradicts itself.
pub fn read(file: &str, bytes: &[u8]) -> Result<Package, ExportError> {
    let fail = |line: usize, reason: String| ExportError::Malformed { file: file.into(), line, reason };
    let stored: Stored = serde_json::from_slice(bytes).map_err(|e| fail(e.line(), e.to_string()))?;
    if stored.schema != SCHEMA || stored.version > VERSION {
        let found = format!("{} {}", stored.schema, stored.version);
        return Err(fail(0, format!("found {found}, expected {SCHEMA} up to version {VERSION}")));
    }
    stored.package.check().map_err(|e| fail(0, e.to_string()))?;
    Ok(stored.package)
}
