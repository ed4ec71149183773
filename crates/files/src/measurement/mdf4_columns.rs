//! Columns of whole numbers and floats, taken where they lie: in `##DZ` blocks of transposed deflate a channel's bytes already
//! stand beside each other when a block is inflated, and in plain `##DT` blocks they are picked out of a window that fits the
//! cache.
//!
//! Whatever is not of this kind (other blocks, records across blocks, bit fields, words, invalid samples) is not read here: the
//! general reader does it.

use std::collections::BTreeSet;
use std::fs::File;
use std::io::{Read, Seek, SeekFrom};
use std::path::Path;

use falcon_mdf::blocks::{
    ChannelType, CompressionType, ConversionInput, ConversionOutput, DataBlock, DataType,
};
use falcon_mdf::{Channel, Mf4File};
use flate2::{Decompress, FlushDecompress, Status};

use crate::table::Cells;

/// Blocks of more than this are left to the general reader, which has its own bounds.
const MOST_BYTES: u64 = 64 << 20;
/// Block lists that are longer are no lists.
const MOST_BLOCKS: usize = 1 << 24;
/// Head of a list: longer ones are read again in full.
const HEAD: usize = 24;
/// Head of a compressed block.
const DZ_HEAD: usize = 48;

/// Head of a plain block.
const DT_HEAD: u64 = 24;
/// Bytes of one window of a plain block: it stays in the cache while its columns are picked out.
const WINDOW: usize = 512 << 10;

/// One block of whole records.
#[derive(Clone, Copy)]
enum Block {
    /// `##DZ`: inflated, column by column.
    Transposed { offset: u64, compressed: usize, inflated: usize },
    /// `##DT`: record by record.
    Plain { offset: u64, bytes: u64 },
}

/// How the records of some bytes lie.
#[derive(Clone, Copy)]
enum Layout {
    /// All first bytes, then all second ones.
    ByColumn,
    /// Records of this many bytes.
    ByRecord(usize),
}

impl Block {
    /// Bytes of records.
    fn held(&self) -> u64 {
        match self {
            Self::Transposed { inflated, .. } => *inflated as u64,
            Self::Plain { bytes, .. } => *bytes,
        }
    }
}

/// Where the bytes of one value are, and what they mean.
struct Field<'a> {
    from: usize,
    bytes: usize,
    channel: &'a Channel,
}

/// The columns of some channels, block by block.
pub(super) struct Columns<'a> {
    file: &'a Mf4File,
    path: &'a Path,
    blocks: Vec<Block>,
    fields: Vec<Field<'a>>,
    record: usize,
    rows: u64,
}

impl<'a> Columns<'a> {
    /// The columns of `channels` (of one group), where all of them can be taken from blocks of whole records.
    pub(super) fn find(file: &'a Mf4File, path: &'a Path, channels: &[&'a Channel]) -> Option<Self> {
        let first = channels.first()?;
        let data = &file.data_groups()[first.data_group_index];
        let [group] = data.channel_groups.as_slice() else { return None };
        // Without record numbers before the records.
        let record = group.record_size(0);
        let fields = channels.iter().map(|c| field(c, group.data_bytes_len())).collect::<Option<Vec<_>>>()?;
        let blocks = blocks(file, data.data_block_offset(), record)?;
        let held: u64 = blocks.iter().map(|b| b.held() / record as u64).sum();
        (file.unfinalized().is_none() && held == group.sample_count).then_some(Self {
            file,
            path,
            blocks,
            fields,
            record,
            rows: group.sample_count,
        })
    }

    /// Reads block after block and hands on physical values.
    ///
    /// # Errors
    /// In words: a block that cannot be read or inflated; and what `take` returns.
    pub(super) fn each<E>(
        &self,
        fault: impl Fn(String) -> E,
        mut take: impl FnMut(&[Cells]) -> Result<(), E>,
    ) -> Result<(), E> {
        let mut inflate = Decompress::new(true);
        let (mut room, mut bits, mut row) = (Vec::new(), Vec::new(), 0u64);
        let in_words = |e: std::io::Error| crate::error::reason(&e);
        // A handle of its own reads plain records into one buffer; the library's would allocate one for every window.
        let mut plain = File::open(self.path).map_err(|e| fault(in_words(e)))?;
        let mut give = |bytes: &[u8], layout: Layout| {
            let rows = bytes.len() / self.record;
            let value = |f: &Field<'_>| Cells::Number(f.values(bytes, rows, layout, &mut bits));
            let cells: Vec<Cells> = self.fields.iter().map(value).collect();
            row += rows as u64;
            take(&cells)
        };
        for block in &self.blocks {
            match *block {
                Block::Transposed { offset, compressed, inflated } => {
                    let packed = self.file.read_raw(offset + DZ_HEAD as u64, compressed);
                    let packed = packed.map_err(|e| fault(e.to_string()))?;
                    room.resize(inflated.max(room.len()), 0u8);
                    let bytes = &mut room[..inflated];
                    inflate_into(&mut inflate, &packed, bytes)
                        .map_err(|why| fault(format!("the block at {offset} cannot be inflated: {why}")))?;
                    give(bytes, Layout::ByColumn)?;
                }
                Block::Plain { offset, bytes } => {
                    let window = (WINDOW / self.record).max(1) * self.record;
                    plain.seek(SeekFrom::Start(offset + DT_HEAD)).map_err(|e| fault(in_words(e)))?;
                    room.resize(window.max(room.len()), 0u8);
                    let mut left = bytes;
                    while left > 0 {
                        let records = &mut room[..(window as u64).min(left) as usize];
                        plain.read_exact(records).map_err(|e| fault(in_words(e)))?;
                        give(records, Layout::ByRecord(self.record))?;
                        left -= records.len() as u64;
                    }
                }
            }
        }
        debug_assert_eq!(row, self.rows);
        Ok(())
    }
}

/// Inflates `packed`, which must give exactly `bytes`; in words why it does not.
fn inflate_into(inflate: &mut Decompress, packed: &[u8], bytes: &mut [u8]) -> Result<(), String> {
    inflate.reset(true);
    let done = inflate.decompress(packed, bytes, FlushDecompress::Finish);
    if matches!(done, Ok(Status::StreamEnd)) && inflate.total_out() == bytes.len() as u64 {
        return Ok(());
    }
    Err(done.err().map_or("its length is not the stated one".into(), |e| e.to_string()))
}

/// A whole number or float of whole bytes whose physical value is a number.
fn field(c: &Channel, record_bytes: usize) -> Option<Field<'_>> {
    let numbers = matches!(
        c.data_type,
        DataType::UIntLe
            | DataType::UIntBe
            | DataType::IntLe
            | DataType::IntBe
            | DataType::FloatLe
            | DataType::FloatBe
    );
    let float = matches!(c.data_type, DataType::FloatLe | DataType::FloatBe);
    let widths: &[u32] = if float { &[32, 64] } else { &[8, 16, 32, 64] };
    let (from, bytes) = (c.byte_offset as usize, c.bit_count as usize / 8);
    let plain = numbers
        && matches!(c.channel_type, ChannelType::FixedLength | ChannelType::Master)
        && c.bit_offset == 0
        && widths.contains(&c.bit_count)
        && !c.all_invalid
        && !c.invalidation_bit
        && !c.is_array()
        && c.conversion.input() == ConversionInput::Numeric
        && c.conversion.output() == ConversionOutput::Numeric
        && from + bytes <= record_bytes;
    plain.then_some(Field { from, bytes, channel: c })
}

/// The blocks of a group in their order, where all are plain or transposed deflate, of whole records.
fn blocks(file: &Mf4File, at: u64, record: usize) -> Option<Vec<Block>> {
    let mut out = Vec::new();
    let mut lists = BTreeSet::new();
    let mut next = at;
    loop {
        let mut links = Vec::new();
        match block_at(file, next, record)? {
            Found::List(DataBlock::HeaderList(h)) => {
                next = h.dl_first;
                lists.insert(next).then_some(())?;
                continue;
            }
            Found::List(DataBlock::DataList(list)) => {
                links = list.data_links;
                next = list.dl_next;
            }
            Found::Data(_) => {
                links.push(next);
                next = 0;
            }
            Found::List(_) => return None,
        }
        for link in links.into_iter().filter(|l| *l != 0) {
            let Found::Data(block) = block_at(file, link, record)? else { return None };
            if record == 0 || !block.held().is_multiple_of(record as u64) || out.len() >= MOST_BLOCKS {
                return None;
            }
            out.push(block);
        }
        if next == 0 {
            return Some(out);
        }
        // A list that comes back to itself.
        lists.insert(next).then_some(())?;
    }
}

/// What stands at a place of the file.
enum Found {
    /// A list of blocks, whole.
    List(DataBlock),
    /// Records.
    Data(Block),
}

/// The block at `offset`: what the head of data says, the whole of a list; none where it is neither or cannot be.
fn block_at(file: &Mf4File, offset: u64, record: usize) -> Option<Found> {
    let head = file.read_raw(offset, HEAD).ok()?;
    let length = u64::from_le_bytes(head.get(8..16)?.try_into().ok()?);
    let read = |bytes: usize| DataBlock::parse(&file.read_raw(offset, bytes).ok()?, offset).ok();
    match head.get(..4)? {
        b"##DL" | b"##HL" if length <= file.file_size() => {
            read(usize::try_from(length).ok()?).map(Found::List)
        }
        b"##DT" => {
            let bytes = length.checked_sub(DT_HEAD)?;
            let inside = offset.checked_add(length)? <= file.file_size();
            inside.then_some(Found::Data(Block::Plain { offset, bytes }))
        }
        b"##DZ" => {
            let DataBlock::Compressed(z) = read(DZ_HEAD)? else { return None };
            let whole = z.zip_type == CompressionType::TransposedDeflate
                && z.zip_parameter as usize == record
                && z.original_size <= MOST_BYTES
                && z.compressed_size <= file.file_size()
                && z.original_type == *b"DT";
            let (compressed, inflated) = (z.compressed_size as usize, z.original_size as usize);
            whole.then_some(Found::Data(Block::Transposed { offset, compressed, inflated }))
        }
        _ => None,
    }
}

impl Field<'_> {
    /// Physical values of `rows` records that lie in `bytes` as `layout` says.
    fn values(&self, bytes: &[u8], rows: usize, layout: Layout, bits: &mut Vec<u64>) -> Vec<f64> {
        bits.clear();
        bits.resize(rows, 0);
        let big = matches!(self.channel.data_type, DataType::UIntBe | DataType::IntBe | DataType::FloatBe);
        match layout {
            Layout::ByColumn => self.bits_of_columns(bytes, big, bits),
            Layout::ByRecord(record) => self.bits_of_records(bytes, record, big, bits),
        }
        let c = &self.channel.conversion;
        let unused = 64 - 8 * self.bytes;
        let all = |f: fn(u64, usize) -> f64, float: bool| match c.is_identity() {
            true => bits.iter().map(|x| f(*x, unused)).collect(),
            false => bits.iter().map(|x| c.convert(f(*x, unused), float)).collect(),
        };
        match (self.channel.data_type, self.bytes) {
            (DataType::UIntLe | DataType::UIntBe, _) => all(|x, _| x as f64, false),
            (DataType::IntLe | DataType::IntBe, _) => all(|x, n| ((x << n) as i64 >> n) as f64, false),
            (_, 4) => all(|x, _| f64::from(f32::from_bits(x as u32)), true),
            _ => all(|x, _| f64::from_bits(x), true),
        }
    }

    fn bits_of_columns(&self, bytes: &[u8], big: bool, bits: &mut [u64]) {
        let rows = bits.len();
        for k in 0..self.bytes {
            let column = &bytes[(self.from + k) * rows..][..rows];
            let shift = 8 * if big { self.bytes - 1 - k } else { k };
            bits.iter_mut().zip(column).for_each(|(x, b)| *x |= u64::from(*b) << shift);
        }
    }

    fn bits_of_records(&self, bytes: &[u8], record: usize, big: bool, bits: &mut [u64]) {
        let values = bytes.chunks_exact(record).map(|r| &r[self.from..][..self.bytes]);
        let whole = |v: &[u8]| v.try_into().map_or(0, u64::from_le_bytes);
        match (self.bytes, big) {
            (8, false) => bits.iter_mut().zip(values).for_each(|(x, v)| *x = whole(v)),
            (8, true) => bits.iter_mut().zip(values).for_each(|(x, v)| *x = whole(v).swap_bytes()),
            (_, false) => bits.iter_mut().zip(values).for_each(|(x, v)| {
                *x = v.iter().rev().fold(0, |x, b| x << 8 | u64::from(*b));
            }),
            (_, true) => bits.iter_mut().zip(values).for_each(|(x, v)| {
                *x = v.iter().fold(0, |x, b| x << 8 | u64::from(*b));
            }),
        }
    }
}
