//! MLVLG (`.mlg`), the binary log of tuning tools for open ECUs, versions 1 and 2, read record by record.
//!
//! ```text
//! 0   "MLVLG\0"   6  i16 version   8  i32 seconds since 1970                            big-endian throughout
//! 12  start of the text (i16, in version 2 i32), i32 start of the data, i16 bytes of a record, i16 number of fields
//! field   u8 type, 34 name, 10 unit, u8 style, f32 scale, f32 offset, i8 digits [version 2: 34 category]
//!         value = (raw + offset) scale
//! record  u8 0, u8 counter, u16 ticks of 10 us, the fields, u8 sum of the bytes of the fields
//! marker  u8 1, u8 counter, u16 ticks, 50 text
//! ```
//!
//! The ticks run over every 0.655 s. They are unwrapped into the channel `time`; the field `Time` counts only where more than one
//! turn lies between two records, because it repeats, and is not ordered in the records of before the trigger.

use std::fs::File;
use std::io::{BufReader, Read, Seek, SeekFrom};
use std::path::Path;

use dynocal_numerics::registry::MemberDoc;

use super::mlg_write;
use crate::error::{FilesError, reason};
use crate::measurement::{ChannelInfo, GroupInfo, Reader, Source, TakeChunk};
use crate::table::Cells;
use crate::units;

/// Row of the table of formats.
pub const FORMAT: Reader = Reader {
    doc: MemberDoc { name: "mlg", what: "MLVLG 1 and 2, logs of open ECUs; record by record", params: &[] },
    endings: &[".mlg"],
    recognises: |head| head.starts_with(MAGIC),
    open: |path, _| Ok(Box::new(Mlg::open(path)?)),
    write: Some(mlg_write::write_raster),
    several: false,
};

pub(super) const MAGIC: &[u8] = b"MLVLG\0";
/// Length of one tick in s, and of a whole turn of the counter.
pub(super) const TICK_S: f64 = 1e-5;
const TURN_S: f64 = 65536.0 * TICK_S;
/// Bytes of a marker after its type.
const MARKER: usize = 53;
/// Records in a chunk.
const CHUNK: usize = 4096;
/// Most bytes of the text before the data.
const MOST_TEXT: u64 = 64_000_000;

/// How a raw value is stored.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Raw {
    /// Unsigned, of so many bytes.
    Unsigned(usize),
    /// Signed, of so many bytes.
    Signed(usize),
    /// IEEE, 4 bytes.
    Float,
}

impl Raw {
    fn of(code: u8) -> Option<Self> {
        Some(match code {
            0 | 10 | 16 => Raw::Unsigned(1),
            2 | 11 => Raw::Unsigned(2),
            4 | 12 => Raw::Unsigned(4),
            1 => Raw::Signed(1),
            3 => Raw::Signed(2),
            5 => Raw::Signed(4),
            6 => Raw::Signed(8),
            7 => Raw::Float,
            _ => return None,
        })
    }

    pub(super) fn bytes(self) -> usize {
        match self {
            Raw::Unsigned(n) | Raw::Signed(n) => n,
            Raw::Float => 4,
        }
    }

    fn value(self, b: &[u8]) -> f64 {
        let unsigned = || b.iter().fold(0u64, |v, x| (v << 8) | u64::from(*x));
        match self {
            Raw::Unsigned(_) => unsigned() as f64,
            Raw::Signed(n) => {
                let unused = 64 - 8 * n as u32;
                (((unsigned() << unused) as i64) >> unused) as f64
            }
            Raw::Float => f64::from(f32::from_bits(unsigned() as u32)),
        }
    }
}

/// A field of a record.
#[derive(Clone, Debug, PartialEq)]
pub struct Field {
    /// Name as in the file; of a nameless one its number.
    pub name: String,
    /// Unit as in the file.
    pub unit: String,
    /// How it is stored.
    pub raw: Raw,
    /// `value = (raw + offset) scale`; bit fields have 1 and 0.
    pub scale: f64,
    /// See `scale`.
    pub offset: f64,
    /// Decimals that are shown.
    pub digits: usize,
    /// First byte within the record.
    at: usize,
}

/// An opened log.
pub struct Mlg {
    path: String,
    /// Fields in their order.
    pub fields: Vec<Field>,
    /// Text before the data: who wrote it, and in version 2 whole files.
    text: Vec<u8>,
    data: u64,
    record: usize,
    groups: [GroupInfo; 1],
    notes: Vec<String>,
}

/// What stands in the data at one place.
enum Block {
    Record { ticks: u16, whole: bool },
    Marker,
    End,
}

impl Mlg {
    /// Opens a log and runs through it once: how many records, which of them are broken.
    ///
    /// # Errors
    /// [`FilesError::Read`], [`FilesError::Malformed`] with the byte.
    pub fn open(path: &Path) -> Result<Self, FilesError> {
        let name = path.display().to_string();
        let file = File::open(path).map_err(|e| FilesError::unread(path, &e))?;
        let size = file.metadata().map_err(|e| FilesError::unread(path, &e))?.len();
        let mut r = Head { path: &name, reader: BufReader::new(file), at: 0 };
        let magic = r.take(6)?;
        if magic != MAGIC {
            return Err(r.bad("no MLVLG at its start".into()));
        }
        let version = r.integer(2)?;
        if !(1..=2).contains(&version) {
            return Err(r.bad(format!("found version {version}, expected 1 or 2")));
        }
        r.take(4)?;
        let text_at = r.integer(if version == 1 { 2 } else { 4 })?;
        let (data, record, count) = (r.integer(4)?, r.integer(2)?, r.integer(2)?);
        let fields = r.fields(count, version)?;
        let sum: usize = fields.iter().map(|f| f.raw.bytes()).sum();
        if record != sum as i64 {
            return Err(r.bad(format!("found records of {record} bytes, expected {sum} as its fields have")));
        }
        let head_end = r.at;
        if data < head_end as i64 || data as u64 > size {
            return Err(r.bad(format!("its data start at byte {data}, expected {head_end} to {size}")));
        }
        let text_at = if text_at >= head_end as i64 && text_at <= data { text_at as u64 } else { head_end };
        let text = r.text(text_at, (data as u64 - text_at).min(MOST_TEXT))?;
        let mut log = Self {
            path: name,
            groups: [group(&fields)],
            fields,
            text,
            data: data as u64,
            record: sum,
            notes: Vec::new(),
        };
        log.count()?;
        Ok(log)
    }

    /// The text before the data, as it is (ISO-8859-1), without files that are in it.
    pub fn info(&self) -> String {
        let end = find(&self.text, PROVIDER).unwrap_or(self.text.len());
        latin(&self.text[..end]).trim_end_matches(['\0', '\n']).to_string()
    }

    /// The tune (`.msq`) that a log of version 2 carries, byte by byte.
    pub fn tune(&self) -> Option<&[u8]> {
        let from = find(&self.text, TUNE)? + TUNE.len();
        let rest = &self.text[from..];
        let line = rest.iter().position(|b| *b == b'\n')?;
        let head = latin(&rest[..line]);
        let digits: String = head.split("Length:").nth(1)?.chars().take_while(char::is_ascii_digit).collect();
        rest.get(line + 1..)?.get(..digits.parse::<usize>().ok()?)
    }

    fn reader(&self) -> Result<BufReader<File>, FilesError> {
        let fail = |e: std::io::Error| FilesError::Read { path: self.path.clone(), reason: reason(&e) };
        let mut file = File::open(&self.path).map_err(fail)?;
        file.seek(SeekFrom::Start(self.data)).map_err(fail)?;
        Ok(BufReader::with_capacity(1 << 18, file))
    }

    /// The next block; its fields are then in `bytes`.
    fn next(&self, r: &mut impl Read, at: &mut u64, bytes: &mut [u8]) -> Result<Block, FilesError> {
        let mut head = [0; 1];
        if !filled(r, &mut head, &self.path)? {
            return Ok(Block::End);
        }
        let size = match head[0] {
            0 => self.record + 4,
            1 => MARKER,
            other => {
                return Err(malformed(
                    &self.path,
                    format!("found a block of type {other} at byte {at}, expected 0 (record) or 1 (marker)"),
                ));
            }
        };
        let bytes = &mut bytes[..size];
        if !filled(r, bytes, &self.path)? {
            return Ok(Block::End);
        }
        *at += 1 + size as u64;
        if head[0] == 1 {
            return Ok(Block::Marker);
        }
        let fields = &bytes[3..3 + self.record];
        let sum = fields.iter().fold(0u8, |s, b| s.wrapping_add(*b));
        Ok(Block::Record { ticks: u16::from_be_bytes([bytes[1], bytes[2]]), whole: sum == bytes[size - 1] })
    }

    fn buffer(&self) -> Vec<u8> {
        vec![0; (self.record + 4).max(MARKER)]
    }

    fn count(&mut self) -> Result<(), FilesError> {
        let (mut r, mut at, mut bytes) = (self.reader()?, self.data, self.buffer());
        let (mut rows, mut broken, mut markers) = (0, 0usize, 0usize);
        loop {
            match self.next(&mut r, &mut at, &mut bytes)? {
                Block::Record { whole: true, .. } => rows += 1,
                Block::Record { .. } => broken += 1,
                Block::Marker => markers += 1,
                Block::End => break,
            }
        }
        self.groups[0].rows = rows;
        if broken > 0 {
            self.notes.push(format!("{broken} records whose sum of bytes is wrong are left out"));
        }
        if markers > 0 {
            self.notes.push(format!("{markers} markers of the driver are not read"));
        }
        if self.fields.iter().all(|f| f.name != "Time") {
            self.notes.push(
                "there is no field `Time`: gaps of more than 0.65 s between records are not seen".into(),
            );
        }
        Ok(())
    }
}

impl Source for Mlg {
    fn file(&self) -> &str {
        &self.path
    }

    fn groups(&self) -> &[GroupInfo] {
        &self.groups
    }

    fn notes(&self) -> &[String] {
        &self.notes
    }

    fn chunks(&self, _group: usize, channels: &[usize], take: &mut TakeChunk<'_>) -> Result<(), FilesError> {
        let (mut r, mut at, mut bytes) = (self.reader()?, self.data, self.buffer());
        let stamp = self.fields.iter().find(|f| f.name == "Time");
        let mut clock = Clock::default();
        let mut values: Vec<Vec<f64>> = vec![Vec::with_capacity(CHUNK); channels.len()];
        loop {
            let block = self.next(&mut r, &mut at, &mut bytes)?;
            if let Block::Record { ticks, whole: true } = block {
                let time_s = clock.at(ticks, stamp.map(|f| f.value(&bytes[3..])));
                for (v, &c) in values.iter_mut().zip(channels) {
                    v.push(if c == 0 { time_s } else { self.fields[c - 1].value(&bytes[3..]) });
                }
            }
            let end = matches!(block, Block::End);
            if values.first().is_some_and(|v| v.len() == CHUNK || (end && !v.is_empty())) {
                let cells: Vec<Cells> = values.iter_mut().map(|v| Cells::Number(std::mem::take(v))).collect();
                take(&cells)?;
            }
            if end {
                return Ok(());
            }
        }
    }
}

impl Field {
    fn value(&self, record: &[u8]) -> f64 {
        let raw = self.raw.value(&record[self.at..self.at + self.raw.bytes()]);
        (raw + self.offset) * self.scale
    }
}

/// Unwraps the ticks.
#[derive(Default)]
struct Clock {
    last: Option<(u16, Option<f64>)>,
    time_s: f64,
}

impl Clock {
    fn at(&mut self, ticks: u16, stamp_s: Option<f64>) -> f64 {
        if let Some((before, stamp_before)) = self.last {
            let step_s = f64::from(ticks.wrapping_sub(before)) * TICK_S;
            // Whole turns that the field `Time` tells; it goes back where the trigger was.
            let told = stamp_s.zip(stamp_before).map(|(b, a)| b - a).filter(|d| d.is_finite() && *d > 0.0);
            let turns = told.map_or(0.0, |d| ((d - step_s) / TURN_S).round().max(0.0));
            self.time_s += step_s + turns * TURN_S;
        }
        self.last = Some((ticks, stamp_s));
        self.time_s
    }
}

fn group(fields: &[Field]) -> GroupInfo {
    let channel = |name: &str, unit: Option<String>| ChannelInfo {
        name: name.into(),
        unit,
        comment: String::new(),
        text: false,
    };
    let mut channels = vec![channel("time", Some("s".into()))];
    channels.extend(fields.iter().map(|f| {
        let unit = Some(f.unit.trim()).filter(|u| !u.is_empty()).map(units::normalise);
        channel(&f.name, unit)
    }));
    GroupInfo { name: String::new(), channels, time: Some(0), rows: 0 }
}

/// The head while it is read.
struct Head<'a> {
    path: &'a str,
    reader: BufReader<File>,
    at: u64,
}

impl Head<'_> {
    fn bad(&self, reason: String) -> FilesError {
        malformed(self.path, reason)
    }

    fn take(&mut self, n: usize) -> Result<Vec<u8>, FilesError> {
        let mut bytes = vec![0; n];
        if !filled(&mut self.reader, &mut bytes, self.path)? {
            return Err(self.bad(format!("it ends in its head, after byte {}", self.at)));
        }
        self.at += n as u64;
        Ok(bytes)
    }

    fn integer(&mut self, n: usize) -> Result<i64, FilesError> {
        Ok(Raw::Signed(n).value(&self.take(n)?) as i64)
    }

    fn fields(&mut self, count: i64, version: i64) -> Result<Vec<Field>, FilesError> {
        if count < 1 {
            return Err(self.bad(format!("found {count} fields, expected at least 1")));
        }
        let size = if version == 1 { 55 } else { 89 };
        let mut out: Vec<Field> = Vec::new();
        let mut at = 0;
        for k in 0..count {
            let b = self.take(size)?;
            let raw = Raw::of(b[0]).ok_or_else(|| {
                self.bad(format!("field {} has the type {}, which is not known", k + 1, b[0]))
            })?;
            let name = word(&b[1..35]);
            let bits = (10..=12).contains(&b[0]);
            let real = |from: usize| Raw::Float.value(&b[from..from + 4]);
            // A bit field has an index into names there; TunerStudio's nameless byte (16) has no scale worth the name.
            let plain = bits || b[0] == 16;
            out.push(Field {
                name: if name.is_empty() { format!("field {}", k + 1) } else { name },
                unit: word(&b[35..45]),
                raw,
                scale: if plain { 1.0 } else { real(46) },
                offset: if plain { 0.0 } else { real(50) },
                digits: if plain { 0 } else { usize::from(b[54]).min(9) },
                at,
            });
            at += raw.bytes();
        }
        Ok(out)
    }

    fn text(&mut self, from: u64, size: u64) -> Result<Vec<u8>, FilesError> {
        let fail = |e: std::io::Error| FilesError::Read { path: self.path.into(), reason: reason(&e) };
        self.reader.seek(SeekFrom::Start(from)).map_err(fail)?;
        let mut text = Vec::new();
        (&mut self.reader).take(size).read_to_end(&mut text).map_err(fail)?;
        Ok(text)
    }
}

const PROVIDER: &[u8] = b"NEW_INFO_PROVIDER,";
const TUNE: &[u8] = b"NEW_INFO_PROVIDER,LogStart_MAIN_TUNE,";

fn find(text: &[u8], what: &[u8]) -> Option<usize> {
    text.windows(what.len()).position(|w| w == what)
}

fn malformed(path: &str, reason: String) -> FilesError {
    FilesError::Malformed { path: path.into(), format: "MLVLG", reason }
}

/// Text of a fixed width, ended by a zero.
fn word(bytes: &[u8]) -> String {
    let end = bytes.iter().position(|b| *b == 0).unwrap_or(bytes.len());
    latin(&bytes[..end]).trim().to_string()
}

fn latin(bytes: &[u8]) -> String {
    bytes.iter().map(|b| char::from(*b)).collect()
}

/// Fills `bytes`; `false` where the file ends before.
fn filled(r: &mut impl Read, bytes: &mut [u8], path: &str) -> Result<bool, FilesError> {
    match r.read_exact(bytes) {
        Ok(()) => Ok(true),
        Err(e) if e.kind() == std::io::ErrorKind::UnexpectedEof => Ok(false),
        Err(e) => Err(FilesError::Read { path: path.into(), reason: reason(&e) }),
    }
}

#[cfg(test)]
mod tests {
    use super::{Clock, Raw};

    #[test]
    fn ticks_are_unwrapped_and_gaps_are_seen() {
        let mut clock = Clock::default();
        let told = [(65000, 180.0), (464, 0.01), (10_464, 0.11), (10_464, 2.07608)];
        let found: Vec<f64> = told.iter().map(|(t, s)| clock.at(*t, Some(*s))).collect();
        // 1000 ticks over the end; 10 000 ticks; three whole turns, which only the stamps tell.
        for (a, b) in found.iter().zip([0.0, 0.01, 0.11, 0.11 + 3.0 * 0.65536]) {
            assert!((a - b).abs() < 1e-12, "{found:?}");
        }
    }

    #[test]
    fn raw_values_are_signed_as_they_say() {
        assert_eq!(Raw::Signed(1).value(&[0xff]), -1.0);
        assert_eq!(Raw::Signed(2).value(&[0xff, 0xfe]), -2.0);
        assert_eq!(Raw::Signed(8).value(&[0xff; 8]), -1.0);
        assert_eq!(Raw::Unsigned(2).value(&[1, 2]), 258.0);
        assert_eq!(Raw::Float.value(&1.5f32.to_be_bytes()), 1.5);
    }
}
