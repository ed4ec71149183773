//! The table of export formats.

pub mod a2l;
pub mod c;
mod c_program;
pub mod cdfx;
mod cdfx_read;
pub mod csv;
pub mod dcm;
mod dcm_read;
pub mod fmu;
mod fmu_xml;
pub mod json;
pub mod mat;
pub mod onnx;
mod protobuf;
pub mod python;
pub mod simulink;

use dynocal_numerics::registry::{MemberDoc, ParamDoc};
use serde::{Deserialize, Serialize};

use crate::characteristic::{Characteristic, identifier, is_identifier};
use crate::error::ExportError;
use crate::package::Package;

/// Arithmetic of generated code.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Precision {
    /// 32 bits, as most ECUs compute.
    #[default]
    Float,
    /// 64 bits, bit-equal to this program.
    Double,
}

/// Keys of an export.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Keys {
    /// Arithmetic of generated C.
    pub precision: Precision,
}

/// A file of an export.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct OutFile {
    /// Name, without a folder.
    pub name: String,
    /// Content.
    pub bytes: Vec<u8>,
}

/// What a format holds.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Holds {
    /// Scalars, curves and maps.
    Characteristics,
    /// Programs (and the characteristics that they read).
    Programs,
    /// Networks.
    Networks,
}

/// A row of [`EXPORTS`].
pub struct Export {
    /// Name, one line, keys.
    pub doc: MemberDoc,
    /// What it holds.
    pub holds: &'static [Holds],
    /// Whether it holds names as an ECU has them, dots and brackets included; else identifiers stand for them.
    pub ecu_names: bool,
    /// Writes a checked package.
    pub write: fn(&Package, &Keys) -> Result<Vec<OutFile>, ExportError>,
    /// Ending of files that can be read back, and how (name for messages, bytes).
    pub read: Option<(&'static str, ReadBack)>,
}

/// Reads a file back: its name for messages, its bytes.
pub type ReadBack = fn(&str, &[u8]) -> Result<Package, ExportError>;

/// The key `precision`.
pub(crate) const PRECISION: ParamDoc = ParamDoc {
    name: "precision",
    unit: "-",
    default: "float",
    what: "arithmetic of the code: float or double",
};

/// Export formats.
pub static EXPORTS: &[Export] = &[
    c::EXPORT,
    dcm::EXPORT,
    cdfx::EXPORT,
    csv::EXPORT,
    json::EXPORT,
    mat::EXPORT,
    a2l::EXPORT,
    python::EXPORT,
    simulink::EXPORT,
    onnx::EXPORT,
    fmu::FMU2,
    fmu::FMU3,
];

/// The package with dots and brackets of names as underscores; none where there are none.
fn with_identifiers(package: &Package) -> Option<Package> {
    let odd = |c: &Characteristic| {
        !is_identifier(&c.name) || c.axes.iter().any(|a| !a.name.is_empty() && !is_identifier(&a.name))
    };
    if !package.characteristics.iter().any(odd) {
        return None;
    }
    let mut out = package.clone();
    for c in &mut out.characteristics {
        c.name = identifier(&c.name);
        c.axes.iter_mut().filter(|a| !a.name.is_empty()).for_each(|a| a.name = identifier(&a.name));
    }
    Some(out)
}

/// Writes `package` in format `name`.
///
/// # Errors
/// [`ExportError`]: unknown format, faulty package, or one that the format cannot hold.
pub fn write(package: &Package, name: &str, keys: &Keys) -> Result<Vec<OutFile>, ExportError> {
    let row = find(name)?;
    package.check()?;
    let renamed = (!row.ecu_names).then(|| with_identifiers(package)).flatten();
    let package = renamed.as_ref().unwrap_or(package);
    // Two names may have become one.
    package.check()?;
    let unfit = |what: &str| ExportError::Unfit {
        format: row.doc.name,
        what: package.name.clone(),
        reason: format!("it holds {what}, which the package has not"),
    };
    if !row.holds.contains(&Holds::Characteristics) && package.program.is_none() {
        return Err(unfit("programs"));
    }
    if row.holds == [Holds::Characteristics] && package.characteristics.is_empty() {
        return Err(unfit("scalars, curves and maps"));
    }
    (row.write)(package, keys)
}

/// The row of format `name`.
///
/// # Errors
/// [`ExportError::Form`] with the nearest name and all names.
pub fn find(name: &str) -> Result<&'static Export, ExportError> {
    EXPORTS.iter().find(|e| e.doc.name == name).ok_or_else(|| {
        let known: Vec<String> = EXPORTS.iter().map(|e| e.doc.name.to_string()).collect();
        let near = dynocal_numerics::registry::nearest(name, &known);
        let hint = near.map(|n| format!(" (did you mean `{n}`?)")).unwrap_or_default();
        ExportError::form(name, format!("no such export format{hint}; expected one of {}", known.join(", ")))
    })
}

/// Reads characteristics back from a file of one of the formats, told by the ending of its name.
///
/// # Errors
/// [`ExportError::Malformed`].
pub fn read(file: &str, bytes: &[u8]) -> Result<Package, ExportError> {
    let lower = file.to_lowercase();
    let row = EXPORTS.iter().filter_map(|e| e.read).find(|(ending, _)| lower.ends_with(ending));
    let endings: Vec<&str> = EXPORTS.iter().filter_map(|e| e.read).map(|r| r.0).collect();
    match row {
        Some((_, read)) => read(file, bytes),
        None => Err(ExportError::Malformed {
            file: file.into(),
            line: 0,
            reason: format!("format not known from the name, expected {}", endings.join(", ")),
        }),
    }
}
