//! MDF 4 by `falcon_mdf`: groups with conversions applied, invalid samples as gaps, read in pieces; and MDF 4.1 written.
//!
//! The file is read through a buffer, not mapped, so that memory stays bounded by one piece and one data block.

use std::path::{Path, PathBuf};

use dynocal_numerics::registry::MemberDoc;
use falcon_mdf::blocks::DataType;
use falcon_mdf::{Channel, Mf4Error, Mf4File, Mf4Writer, Signal, SignalValues, ValueKind, WriteCodec};

use crate::atomic;
use crate::error::FilesError;
use crate::measurement::mdf4_columns::Columns;
use crate::measurement::{ChannelInfo, GroupInfo, Raster, Reader, Source, TakeChunk};
use crate::table::Cells;
use crate::units;

/// Row of the table of formats.
pub const FORMAT: Reader = Reader {
    doc: MemberDoc {
        name: "mdf4",
        what: "ASAM MDF 4.x, sorted or not, compressed or not; streamed",
        params: &[],
    },
    endings: &[".mf4", ".mdf4"],
    recognises: |head| head.starts_with(b"MDF     4") || head.starts_with(b"UnFinMF 4"),
    open: |path, _| Ok(Box::new(Mdf4::open(path)?)),
    write: Some(write),
    several: true,
};

/// Rows of one piece.
const ROWS: usize = 1 << 15;

/// Signals of a group, piece by piece.
type Pieces<'a> = Box<dyn Iterator<Item = Result<Vec<Signal>, Mf4Error>> + 'a>;

struct Mdf4 {
    path: String,
    place: PathBuf,
    file: Mf4File,
    groups: Vec<GroupInfo>,
    /// For each group its channels in the file's terms.
    channels: Vec<Vec<Channel>>,
    notes: Vec<String>,
}

impl Mdf4 {
    fn open(path: &Path) -> Result<Self, FilesError> {
        let name = path.display().to_string();
        let file = Mf4File::open_buffered(path).map_err(|e| fault(&name, &e))?;
        let (mut groups, mut channels, mut notes) = (Vec::new(), Vec::new(), Vec::new());
        for group in file.data_groups().iter().flat_map(|d| &d.channel_groups).filter(|g| !g.is_vlsd()) {
            let (readable, left): (Vec<&Channel>, Vec<&Channel>) =
                group.channels.iter().partition(|c| left_out(c).is_none());
            for c in left {
                let why = left_out(c).unwrap_or_default();
                notes.push(format!("channel `{}` is left out: {why}", c.name));
            }
            let name =
                if group.acquisition_name.is_empty() { &group.comment } else { &group.acquisition_name };
            groups.push(GroupInfo {
                name: name.trim().to_string(),
                time: readable.iter().position(|c| c.is_time_channel()),
                channels: readable.iter().map(|c| info(c)).collect(),
                rows: group.sample_count,
            });
            channels.push(readable.into_iter().cloned().collect());
        }
        notes.extend(lost(&file));
        if file.unfinalized().is_some() {
            notes.push("the file was not closed by its writer: what could be found is read".into());
        }
        Ok(Self { path: name, place: path.into(), file, groups, channels, notes })
    }
}

/// Groups that hold fewer samples than they state, in words; a file that its writer did not close states nothing reliable.
fn lost(file: &Mf4File) -> Vec<String> {
    let mut notes = Vec::new();
    for d in file.data_groups().iter().filter(|_| file.unfinalized().is_none()) {
        // Link of the data group to its first channel group, and of each to the next.
        let mut next = number(file, d.block_offset() + 32);
        for g in &d.channel_groups {
            let Some(at) = next.filter(|at| *at > 0) else { break };
            next = number(file, at + 24);
            // Behind the head, the links and the record number.
            let links = number(file, at + 16).filter(|n| *n <= 64);
            let stated = links.and_then(|n| number(file, at + 24 + 8 * n + 8));
            if let Some(stated) = stated.filter(|n| !g.is_vlsd() && *n > g.sample_count) {
                notes.push(format!(
                    "group {} states {stated} samples and holds {}: the rest is lost",
                    g.index + 1,
                    g.sample_count
                ));
            }
        }
    }
    notes
}

/// Eight bytes of the file as a number.
fn number(file: &Mf4File, at: u64) -> Option<u64> {
    Some(u64::from_le_bytes(file.read_raw(at, 8).ok()?.try_into().ok()?))
}

/// Why a channel is not read; none where it is.
fn left_out(c: &Channel) -> Option<&'static str> {
    // The reader below knows floats of 32 and 64 bits and gives zeros for others.
    let float = matches!(c.data_type, DataType::FloatLe | DataType::FloatBe);
    match c.unreadable() {
        Some(reason) => Some(reason.detail()),
        None if c.is_array() => Some("an array in every sample"),
        None if float && !matches!(c.bit_count, 32 | 64) => Some("a float that has neither 32 nor 64 bits"),
        None if matches!(c.value_kind(), ValueKind::Bytes) => Some("bytes without a meaning here"),
        None => None,
    }
}

fn info(c: &Channel) -> ChannelInfo {
    ChannelInfo {
        name: c.name.clone(),
        // A time channel without a unit is in seconds by the standard.
        unit: match c.unit.trim() {
            "" if c.is_time_channel() => Some("s".into()),
            "" => None,
            u => Some(units::normalise(u)),
        },
        comment: c.comment.trim().to_string(),
        text: matches!(c.value_kind(), ValueKind::Str),
    }
}

fn fault(path: &str, e: &Mf4Error) -> FilesError {
    match e {
        Mf4Error::Io(io) if io.kind() != std::io::ErrorKind::UnexpectedEof => {
            FilesError::Read { path: path.into(), reason: crate::error::reason(io) }
        }
        other => FilesError::Malformed { path: path.into(), format: "MDF 4", reason: other.to_string() },
    }
}

impl Source for Mdf4 {
    fn file(&self) -> &str {
        &self.path
    }

    fn groups(&self) -> &[GroupInfo] {
        &self.groups
    }

    fn notes(&self) -> &[String] {
        &self.notes
    }

    fn chunks(&self, group: usize, channels: &[usize], take: &mut TakeChunk<'_>) -> Result<(), FilesError> {
        let (mut found, stated) = (0u64, self.groups[group].rows);
        self.pieces(group, channels, &mut |cells| {
            found += cells.first().map_or(0, Cells::len) as u64;
            take(cells)
        })?;
        // A file that its writer did not close says nothing reliable about its rows.
        if channels.is_empty() || found >= stated || self.file.unfinalized().is_some() {
            return Ok(());
        }
        let reason =
            format!("found {found} rows, expected the {stated} that the file states: the rest is lost");
        Err(FilesError::Malformed { path: self.path.clone(), format: "MDF 4", reason })
    }
}

impl Mdf4 {
    fn pieces(&self, group: usize, channels: &[usize], take: &mut TakeChunk<'_>) -> Result<(), FilesError> {
        let wanted: Vec<&Channel> = channels.iter().map(|c| &self.channels[group][*c]).collect();
        let fail = |e: Mf4Error| fault(&self.path, &e);
        if wanted.is_empty() || self.groups[group].rows == 0 {
            return Ok(());
        }
        if let Some(columns) = Columns::find(&self.file, &self.place, &wanted) {
            let fault = |reason| FilesError::Malformed { path: self.path.clone(), format: "MDF 4", reason };
            return columns.each(fault, |cells| take(cells));
        }
        // One channel comes block by block; several of them, aligned, cost two more copies of every record.
        let pieces: Result<Pieces<'_>, Mf4Error> = match wanted.as_slice() {
            [one] => {
                self.file.signal_chunks(one).map(|p| Box::new(p.map(|s| s.map(|s| vec![s]))) as Pieces<'_>)
            }
            all => self.file.signals_chunks(all, ROWS).map(|p| Box::new(p) as Pieces<'_>),
        };
        match pieces {
            Ok(pieces) => {
                for piece in pieces {
                    let signals = piece.map_err(fail)?;
                    take(&signals.iter().map(cells).collect::<Result<Vec<_>, _>>().map_err(fail)?)?;
                }
                Ok(())
            }
            // Text of variable length beside a sorted group cannot be cut into pieces: such channels are read whole.
            Err(Mf4Error::Unsupported { .. }) => {
                let signals = self.file.signals(&wanted).map_err(fail)?;
                take(&signals.iter().map(cells).collect::<Result<Vec<_>, _>>().map_err(fail)?)
            }
            Err(e) => Err(fail(e)),
        }
    }
}

/// Physical values with NaN where the file says invalid.
fn cells(signal: &Signal) -> Result<Cells, Mf4Error> {
    let validity = signal.validity();
    Ok(match signal.values()? {
        SignalValues::Str(mut text) => {
            mask(&mut text, validity.as_deref(), String::new);
            Cells::Text(text)
        }
        values @ (SignalValues::Bytes { .. } | SignalValues::VarBytes { .. }) => {
            let text = |k| String::from_utf8_lossy(values.bytes_at(k).unwrap_or_default()).into_owned();
            let mut text: Vec<String> = (0..values.len()).map(text).collect();
            mask(&mut text, validity.as_deref(), String::new);
            Cells::Text(text)
        }
        SignalValues::F64(mut numbers) => {
            mask(&mut numbers, validity.as_deref(), || f64::NAN);
            Cells::Number(numbers)
        }
        other => {
            let mut numbers = other.to_f64();
            mask(&mut numbers, validity.as_deref(), || f64::NAN);
            Cells::Number(numbers)
        }
    })
}

fn mask<T>(values: &mut [T], validity: Option<&[bool]>, gap: impl Fn() -> T) {
    let Some(valid) = validity else { return };
    values.iter_mut().zip(valid).filter(|(_, ok)| !**ok).for_each(|(v, _)| *v = gap());
}

/// Writes every raster as a group: f64 channels with units, NaN as invalid samples, states as text; transposed deflate.
fn write(path: &Path, rasters: &[Raster]) -> Result<(), FilesError> {
    let fail = |e: Mf4Error| FilesError::Write { path: path.display().to_string(), reason: e.to_string() };
    // No clock in results: equal data, equal bytes.
    let mut writer = Mf4Writer::with_start_time_ns(0);
    writer.set_compression(true);
    writer.set_codec(WriteCodec::TransposedDeflate);
    for raster in rasters {
        let group = writer.add_group(&raster.time_s).map_err(fail)?;
        for c in &raster.columns {
            let unit = c.unit.as_ref().map_or("", |u| u.0.as_str());
            match &c.cells {
                Cells::Number(v) if v.iter().any(|x| x.is_nan()) => {
                    let valid: Vec<bool> = v.iter().map(|x| !x.is_nan()).collect();
                    group.add_channel_with_validity(&c.name, unit, v, Some(&valid)).map_err(fail)?;
                }
                Cells::Number(v) => group.add_channel(&c.name, unit, v).map_err(fail)?,
                Cells::Text(v) => {
                    group.add_channel_typed(&c.name, unit, SignalValues::Str(v.clone())).map_err(fail)?;
                }
            }
        }
    }
    let mut bytes = Vec::new();
    writer.write(&mut bytes).map_err(fail)?;
    atomic::write(path, &bytes)
}
