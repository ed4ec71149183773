//! MAT files of version 7.3 by `hdf5-pure`: an HDF5 file with a block of 512 bytes before it.
//!
//! Structs are groups, arrays are datasets stored transposed, text is a dataset of 16-bit characters, and an attribute
//! `MATLAB_class` tells them apart. A table of any other HDF5 file has its rows in the first dimension.

use std::path::Path;

use dynocal_numerics::registry::MemberDoc;
use hdf5_pure::{AttrValue, DType, Dataset, Error, File, Group};

use crate::error::{FilesError, reason};
use crate::measurement::Reader;
use crate::measurement::mat::{MatValue, Variables};

/// Row of the table of formats.
pub const FORMAT: Reader = Reader {
    doc: MemberDoc {
        name: "mat73",
        what: "MATLAB .mat of version 7.3 and plain HDF5; read whole",
        params: &[],
    },
    endings: &[".h5", ".hdf5"],
    recognises: |head| head.starts_with(b"\x89HDF\r\n\x1a\n") || head.get(124..128) == Some(b"\x00\x02IM"),
    open: |path, _| Ok(Box::new(Variables::new(&path.display().to_string(), read(path)?)?)),
    write: None,
    several: false,
};

const DEPTH: usize = 16;

/// The variables of a file, in the order of their names.
///
/// # Errors
/// [`FilesError::Read`], [`FilesError::Malformed`].
pub fn read(path: &Path) -> Result<Vec<(String, MatValue)>, FilesError> {
    let name = path.display().to_string();
    let bytes =
        std::fs::read(path).map_err(|e| FilesError::Read { path: name.clone(), reason: reason(&e) })?;
    parse(&name, bytes)
}

/// As [`read`], from bytes; `file` is the name for messages.
///
/// # Errors
/// [`FilesError::Malformed`].
pub fn parse(file: &str, bytes: Vec<u8>) -> Result<Vec<(String, MatValue)>, FilesError> {
    let fail = |e: Error| FilesError::Malformed {
        path: file.into(),
        format: "HDF5 (MAT 7.3)",
        reason: e.to_string(),
    };
    let size = bytes.len() as u64;
    let hdf5 = File::from_bytes(bytes).map_err(fail)?;
    fields(&hdf5.root(), size, 0).map_err(fail)
}

fn fields(group: &Group, size: u64, depth: usize) -> Result<Vec<(String, MatValue)>, Error> {
    let mut out = Vec::new();
    if depth > DEPTH {
        return Ok(out);
    }
    for name in group.datasets()? {
        let data = group.dataset(&name)?;
        out.push((name, value(&data, size)?));
    }
    for name in group.groups()? {
        // MATLAB keeps what references point to in `#refs#`.
        if !name.starts_with('#') {
            let inner = fields(&group.group(&name)?, size, depth + 1)?;
            out.push((name, MatValue::Struct(inner)));
        }
    }
    out.sort_by(|a, b| a.0.cmp(&b.0));
    Ok(out)
}

fn value(data: &Dataset, size: u64) -> Result<MatValue, Error> {
    let shape = data.shape()?;
    let count = shape.iter().try_fold(1u64, |a, d| a.checked_mul(*d)).unwrap_or(u64::MAX);
    // Deflate gives a thousand bytes for one at most: more values than that are no data but a broken size.
    if count > size.saturating_mul(1100) {
        return Ok(MatValue::Other(format!("size {shape:?}, which the file cannot hold,")));
    }
    let class = match data.attrs()?.get("MATLAB_class") {
        Some(AttrValue::String(s) | AttrValue::AsciiString(s)) => s.trim_end_matches('\0').to_string(),
        _ => String::new(),
    };
    let numbers = matches!(
        data.dtype()?,
        DType::F32
            | DType::F64
            | DType::I8
            | DType::I16
            | DType::I32
            | DType::I64
            | DType::U8
            | DType::U16
            | DType::U32
            | DType::U64
    );
    if !numbers {
        return Ok(MatValue::Other(if class.is_empty() { "no numbers".into() } else { class }));
    }
    let mut values = data.read_f64()?;
    if let ([rows, columns], true) = (shape.as_slice(), class.is_empty()) {
        // No MATLAB: rows of the table are rows of the dataset.
        let (rows, columns) = (*rows as usize, *columns as usize);
        if values.len() == rows * columns {
            values = (0..columns)
                .flat_map(|c| (0..rows).map(move |r| (r, c)))
                .map(|(r, c)| values[r * columns + c])
                .collect();
            return Ok(MatValue::Numbers { dims: vec![rows, columns], values });
        }
    }
    if class == "char" {
        let units = values.iter().map(|v| *v as u16);
        return Ok(MatValue::Text(char::decode_utf16(units).map(|c| c.unwrap_or('\u{fffd}')).collect()));
    }
    // Stored transposed: row-major in HDF5 is column-major in MATLAB, only the sizes turn round.
    let mut dims: Vec<usize> = shape.iter().rev().map(|d| *d as usize).collect();
    dims.resize(dims.len().max(2), 1);
    Ok(MatValue::Numbers { dims, values })
}
