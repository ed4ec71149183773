//! MAT files of version 5 (`save -v6` and `-v7`): a small reader and writer of numbers, text, structs and cells.
//!
//! A file is 128 bytes of header and a sequence of elements, each a type, a length and data padded to 8 bytes; an
//! element may be a whole deflate stream (MathWorks, "MAT-File Format", level 5).

use std::io::Write;
use std::path::Path;

use dynocal_numerics::registry::MemberDoc;
use flate2::Compression;
use flate2::read::ZlibDecoder;
use flate2::write::ZlibEncoder;

use crate::atomic;
use crate::bounds;
use crate::error::{FilesError, reason};
use crate::measurement::mat::{MatValue, Variables, variables};
use crate::measurement::{Raster, Reader};

/// Row of the table of formats.
pub const FORMAT: Reader = Reader {
    doc: MemberDoc { name: "mat5", what: "MATLAB .mat up to version 7 (not 7.3); read whole", params: &[] },
    endings: &[".mat"],
    recognises: |head| {
        head.starts_with(b"MATLAB 5.0") || (head.len() > 128 && &head[124..128] == b"\x00\x01IM")
    },
    open: |path, _| Ok(Box::new(Variables::new(&path.display().to_string(), read(path)?)?)),
    write: Some(write_rasters),
    several: true,
};

/// Structs and cells inside each other.
const DEPTH: usize = 16;

/// The variables of a file, in order.
///
/// # Errors
/// [`FilesError::Read`], [`FilesError::Malformed`] with the place.
pub fn read(path: &Path) -> Result<Vec<(String, MatValue)>, FilesError> {
    let name = path.display().to_string();
    let bytes =
        std::fs::read(path).map_err(|e| FilesError::Read { path: name.clone(), reason: reason(&e) })?;
    parse(&name, &bytes)
}

/// As [`read`], from bytes; `file` is the name for messages.
///
/// # Errors
/// [`FilesError::Malformed`].
///
/// # Examples
/// ```
/// use dynocal_files::measurement::mat::MatValue;
/// use dynocal_files::measurement::mat5;
/// let variables = vec![("speed".to_string(), MatValue::vector(&[800.0, 900.0]))];
/// assert_eq!(mat5::parse("a.mat", &mat5::encode(&variables)).unwrap(), variables);
/// ```
pub fn parse(file: &str, bytes: &[u8]) -> Result<Vec<(String, MatValue)>, FilesError> {
    let fail = |reason: String| FilesError::Malformed { path: file.into(), format: "MAT 5", reason };
    if bytes.len() < 128 || &bytes[126..128] != b"IM" {
        let found = if bytes.get(126..128) == Some(b"MI") { "a big-endian file" } else { "no MAT 5 header" };
        return Err(fail(format!("found {found}, expected a little-endian file of version 5")));
    }
    if bytes[125] == 2 {
        return Err(fail("found version 7.3, which is HDF5".into()));
    }
    let mut cursor = Cursor { bytes, at: 128 };
    let (mut out, mut left) = (Vec::new(), bounds::MOST_INFLATED);
    while cursor.at + 8 <= bytes.len() {
        let place = cursor.at;
        let at = |reason: String| fail(format!("at byte {place}: {reason}"));
        let (kind, data) = cursor.element().map_err(at)?;
        let variable = if kind == 15 {
            let plain = bounds::inflated(file, &mut left, || ZlibDecoder::new(data))
                .map_err(|e| at(e.to_string()))??;
            let (kind, data) = Cursor { bytes: &plain, at: 0 }.element().map_err(at)?;
            matrix(kind, data, 0).map_err(at)?
        } else {
            matrix(kind, data, 0).map_err(at)?
        };
        // MATLAB keeps data of its own in a variable without a name.
        if !variable.0.is_empty() {
            out.push(variable);
        }
    }
    Ok(out)
}

struct Cursor<'a> {
    bytes: &'a [u8],
    at: usize,
}

impl<'a> Cursor<'a> {
    fn word(&self, at: usize) -> Option<u32> {
        Some(u32::from_le_bytes(self.bytes.get(at..at + 4)?.try_into().ok()?))
    }

    /// Type and data of the next element; small ones keep their data in the tag.
    fn element(&mut self) -> Result<(u32, &'a [u8]), String> {
        let short = || "the file ends inside an element".to_string();
        let tag = self.word(self.at).ok_or_else(short)?;
        if tag >> 16 != 0 {
            let (kind, length) = (tag & 0xffff, (tag >> 16) as usize);
            let data = self.bytes.get(self.at + 4..self.at + 4 + length.min(4)).ok_or_else(short)?;
            self.at += 8;
            return if length <= 4 {
                Ok((kind, data))
            } else {
                Err(format!("small element of {length} bytes"))
            };
        }
        let length = self.word(self.at + 4).ok_or_else(short)? as usize;
        let from = self.at + 8;
        let data = from.checked_add(length).and_then(|to| self.bytes.get(from..to)).ok_or_else(|| {
            format!("an element of {length} bytes, but {} are left", self.bytes.len().saturating_sub(from))
        })?;
        // Compressed elements are not padded.
        self.at = from + if tag == 15 { length } else { length.div_ceil(8) * 8 };
        Ok((tag, data))
    }

    fn left(&self) -> bool {
        self.at + 8 <= self.bytes.len()
    }
}

/// Name and value of a matrix element.
fn matrix(kind: u32, data: &[u8], depth: usize) -> Result<(String, MatValue), String> {
    if kind != 14 {
        return Err(format!("found an element of type {kind}, expected a matrix (14)"));
    }
    if depth > DEPTH {
        return Err(format!("more than {DEPTH} structs inside each other"));
    }
    if data.is_empty() {
        return Ok((String::new(), MatValue::Numbers { dims: vec![0, 0], values: Vec::new() }));
    }
    let mut c = Cursor { bytes: data, at: 0 };
    let flags = Cursor { bytes: c.element()?.1, at: 0 }.word(0).ok_or("no array flags")?;
    let (class, complex) = (flags & 0xff, flags & 0x0800 != 0);
    let (kind, bytes) = c.element()?;
    let dims: Vec<usize> = numbers(kind, bytes)?.iter().map(|d| *d as usize).collect();
    let (_, bytes) = c.element()?;
    let name: String = bytes.iter().take_while(|b| **b != 0).map(|b| char::from(*b)).collect();
    let count =
        dims.iter().try_fold(1usize, |a, d| a.checked_mul(*d)).filter(|n| *n <= data.len().max(1) * 8);
    let count =
        count.ok_or_else(|| format!("`{name}` of size {dims:?} does not fit its {} bytes", data.len()))?;
    let value = match class {
        1 => {
            let mut cells = Vec::new();
            for _ in 0..count {
                let (kind, data) = c.element()?;
                cells.push(matrix(kind, data, depth + 1)?.1);
            }
            MatValue::Cell(cells)
        }
        2 => fields(&mut c, count, depth)?,
        4 => {
            let (kind, bytes) = c.element()?;
            MatValue::Text(text(kind, bytes)?)
        }
        6..=15 if complex => MatValue::Other("complex".into()),
        6..=15 => {
            let (kind, bytes) = c.element()?;
            let values = numbers(kind, bytes)?;
            if values.len() != count {
                return Err(format!("`{name}` of size {dims:?} has {} values", values.len()));
            }
            MatValue::Numbers { dims, values }
        }
        3 => MatValue::Other("object".into()),
        5 => MatValue::Other("sparse".into()),
        n => MatValue::Other(format!("number {n}")),
    };
    Ok((name, value))
}

fn fields(c: &mut Cursor, count: usize, depth: usize) -> Result<MatValue, String> {
    let (kind, bytes) = c.element()?;
    let width = numbers(kind, bytes)?.first().map_or(0, |w| *w as usize);
    let (_, names) = c.element()?;
    if width == 0 || names.len() % width != 0 {
        return Err(format!("field names of {width} characters in {} bytes", names.len()));
    }
    let names: Vec<String> = names
        .chunks(width)
        .map(|n| n.iter().take_while(|b| **b != 0).map(|b| char::from(*b)).collect())
        .collect();
    if count != 1 {
        return Ok(MatValue::Other(format!("struct array of {count}")));
    }
    let mut out = Vec::new();
    for name in names {
        if !c.left() {
            return Err(format!("the struct ends before its field `{name}`"));
        }
        let (kind, data) = c.element()?;
        out.push((name, matrix(kind, data, depth + 1)?.1));
    }
    Ok(MatValue::Struct(out))
}

fn numbers(kind: u32, bytes: &[u8]) -> Result<Vec<f64>, String> {
    macro_rules! read {
        ($t:ty) => {{
            const N: usize = std::mem::size_of::<$t>();
            let value = |c: &[u8]| <[u8; N]>::try_from(c).map_or(f64::NAN, |b| <$t>::from_le_bytes(b) as f64);
            bytes.chunks_exact(N).map(value).collect()
        }};
    }
    Ok(match kind {
        1 => read!(i8),
        2 => read!(u8),
        3 => read!(i16),
        4 => read!(u16),
        5 => read!(i32),
        6 => read!(u32),
        7 => read!(f32),
        9 => read!(f64),
        12 => read!(i64),
        13 => read!(u64),
        other => return Err(format!("found numbers of type {other}, expected 1 to 7, 9, 12 or 13")),
    })
}

fn text(kind: u32, bytes: &[u8]) -> Result<String, String> {
    Ok(match kind {
        1 | 2 | 16 => String::from_utf8_lossy(bytes).into_owned(),
        4 | 17 => {
            let units = bytes.chunks_exact(2).map(|c| u16::from_le_bytes([c[0], c[1]]));
            char::decode_utf16(units).map(|c| c.unwrap_or('\u{fffd}')).collect()
        }
        other => return Err(format!("found characters of type {other}, expected 1, 2, 4, 16 or 17")),
    })
}

fn write_rasters(path: &Path, rasters: &[Raster]) -> Result<(), FilesError> {
    let fail = |reason: String| FilesError::Write { path: path.display().to_string(), reason };
    atomic::write(path, &encode(&variables(rasters).map_err(fail)?))
}

/// A whole file: every variable as a deflate stream. Without a clock: equal variables, equal bytes.
pub fn encode(variables: &[(String, MatValue)]) -> Vec<u8> {
    let mut out = format!("{:<116}", "MATLAB 5.0 MAT-file, written by dynocal").into_bytes();
    out.extend([0; 8]);
    out.extend(b"\x00\x01IM");
    for (name, value) in variables {
        let mut plain = Vec::new();
        put_matrix(&mut plain, name, value);
        let mut z = ZlibEncoder::new(Vec::new(), Compression::default());
        // Writing to a vector cannot fail.
        let packed = z.write_all(&plain).and_then(|()| z.finish()).unwrap_or_default();
        out.extend(15u32.to_le_bytes());
        out.extend((packed.len() as u32).to_le_bytes());
        out.extend(packed);
    }
    out
}

fn put(out: &mut Vec<u8>, kind: u32, data: &[u8]) {
    out.extend(kind.to_le_bytes());
    out.extend((data.len() as u32).to_le_bytes());
    out.extend(data);
    out.resize(out.len().div_ceil(8) * 8, 0);
}

fn put_matrix(out: &mut Vec<u8>, name: &str, value: &MatValue) {
    let mut body = Vec::new();
    let head = |body: &mut Vec<u8>, class: u32, dims: &[usize]| {
        put(body, 6, &[class.to_le_bytes(), [0; 4]].concat());
        let dims: Vec<u8> = dims.iter().flat_map(|d| (*d as i32).to_le_bytes()).collect();
        put(body, 5, &dims);
        put(body, 1, name.as_bytes());
    };
    match value {
        MatValue::Numbers { dims, values } => {
            head(&mut body, 6, dims);
            put(&mut body, 9, &values.iter().flat_map(|v| v.to_le_bytes()).collect::<Vec<_>>());
        }
        MatValue::Text(text) => {
            let units: Vec<u16> = text.encode_utf16().collect();
            head(&mut body, 4, &[usize::from(!units.is_empty()), units.len()]);
            put(&mut body, 17, &units.iter().flat_map(|u| u.to_le_bytes()).collect::<Vec<_>>());
        }
        MatValue::Struct(fields) => {
            head(&mut body, 2, &[1, 1]);
            let width = 64;
            put(&mut body, 5, &(width as i32).to_le_bytes());
            let mut names = vec![0u8; width * fields.len()];
            for (slot, (n, _)) in names.chunks_mut(width).zip(fields) {
                n.bytes().take(width - 1).zip(slot).for_each(|(b, s)| *s = b);
            }
            put(&mut body, 1, &names);
            fields.iter().for_each(|(_, v)| put_matrix(&mut body, "", v));
        }
        MatValue::Cell(cells) => {
            head(&mut body, 1, &[cells.len(), 1]);
            cells.iter().for_each(|v| put_matrix(&mut body, "", v));
        }
        MatValue::Other(_) => head(&mut body, 6, &[0, 0]),
    }
    put(out, 14, &body);
}
