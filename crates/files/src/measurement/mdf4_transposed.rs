//! Columns of transposed blocks: where a group's values lie in `##DZ` blocks of transposed deflate, a channel's bytes already stand
//! beside each other when a block is inflated, and nothing needs to be transposed back.
//!
//! Whatever is not of this kind (other blocks, records across blocks, bit fields, words, invalid samples) is not read here: the
//! general reader does it.

use std::collections::BTreeSet;

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

/// One compressed block.
struct Block {
    offset: u64,
    compressed: usize,
    inflated: usize,
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
    blocks: Vec<Block>,
    fields: Vec<Field<'a>>,
    record: usize,
    rows: u64,
}

impl<'a> Columns<'a> {
    /// The columns of `channels` (of one group), where all of them can be taken from transposed blocks.
    pub(super) fn find(file: &'a Mf4File, channels: &[&'a Channel]) -> Option<Self> {
        let first = channels.first()?;
        let data = &file.data_groups()[first.data_group_index];
        let [group] = data.channel_groups.as_slice() else { return None };
        // Without record numbers before the records.
        let record = group.record_size(0);
        let fields = channels.iter().map(|c| field(c, group.data_bytes_len())).collect::<Option<Vec<_>>>()?;
        let blocks = blocks(file, data.data_block_offset(), record)?;
        let held: u64 = blocks.iter().map(|b| (b.inflated / record) as u64).sum();
        (file.unfinalized().is_none() && held == group.sample_count).then_some(Self {
            file,
            blocks,
            fields,
            record,
            rows: group.sample_count,
        })
    }

    /// Inflates block after block and hands on physical values.
    ///
    /// # Errors
    /// In words: a block that cannot be read or inflated; and what `take` returns.
    pub(super) fn each<E>(
        &self,
        fault: impl Fn(String) -> E,
        mut take: impl FnMut(&[Cells]) -> Result<(), E>,
    ) -> Result<(), E> {
        let mut inflate = Decompress::new(true);
        let largest = self.blocks.iter().map(|b| b.inflated).max().unwrap_or(0);
        let mut bytes = vec![0u8; largest];
        let mut bits = Vec::new();
        let mut row = 0u64;
        for block in &self.blocks {
            let packed = self
                .file
                .read_raw(block.offset + DZ_HEAD as u64, block.compressed)
                .map_err(|e| fault(e.to_string()))?;
            let bytes = &mut bytes[..block.inflated];
            inflate.reset(true);
            let done = inflate.decompress(&packed, bytes, FlushDecompress::Finish);
            if !matches!(done, Ok(Status::StreamEnd)) || inflate.total_out() != block.inflated as u64 {
                let why = done.err().map_or("its length is not the stated one".into(), |e| e.to_string());
                return Err(fault(format!("the block at {} cannot be inflated: {why}", block.offset)));
            }
            let rows = block.inflated / self.record;
            let cells: Vec<Cells> =
                self.fields.iter().map(|f| Cells::Number(f.values(bytes, rows, &mut bits))).collect();
            row += rows as u64;
            take(&cells)?;
        }
        debug_assert_eq!(row, self.rows);
        Ok(())
    }
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

/// The blocks of a group in their order, where all are transposed deflate of whole records.
fn blocks(file: &Mf4File, at: u64, record: usize) -> Option<Vec<Block>> {
    let mut out = Vec::new();
    let mut lists = BTreeSet::new();
    let mut next = at;
    loop {
        let mut links = Vec::new();
        match block_at(file, next)? {
            DataBlock::HeaderList(h) => {
                next = h.dl_first;
                lists.insert(next).then_some(())?;
                continue;
            }
            DataBlock::DataList(list) => {
                links = list.data_links;
                next = list.dl_next;
            }
            DataBlock::Compressed(_) => {
                links.push(next);
                next = 0;
            }
            _ => return None,
        }
        for link in links.into_iter().filter(|l| *l != 0) {
            let DataBlock::Compressed(z) = block_at(file, link)? else { return None };
            let whole = z.zip_type == CompressionType::TransposedDeflate
                && z.zip_parameter as usize == record
                && record > 0
                && z.original_size % record as u64 == 0
                && z.original_size <= MOST_BYTES
                && z.compressed_size <= file.file_size()
                && z.original_type == *b"DT";
            if !whole || out.len() >= MOST_BLOCKS {
                return None;
            }
            let (compressed, inflated) = (z.compressed_size as usize, z.original_size as usize);
            out.push(Block { offset: link, compressed, inflated });
        }
        if next == 0 {
            return Some(out);
        }
        // A list that comes back to itself.
        lists.insert(next).then_some(())?;
    }
}

/// The block at `offset`: the head of compressed data, the whole of a list.
fn block_at(file: &Mf4File, offset: u64) -> Option<DataBlock> {
    let head = file.read_raw(offset, HEAD).ok()?;
    let length = u64::from_le_bytes(head.get(8..16)?.try_into().ok()?);
    let wanted = match head.get(..4)? {
        b"##DZ" => DZ_HEAD,
        b"##DL" | b"##HL" if length <= file.file_size() => usize::try_from(length).ok()?,
        _ => return None,
    };
    DataBlock::parse(&file.read_raw(offset, wanted).ok()?, offset).ok()
}

impl Field<'_> {
    /// Physical values of `rows` records, column by column in `bytes`.
    fn values(&self, bytes: &[u8], rows: usize, bits: &mut Vec<u64>) -> Vec<f64> {
        bits.clear();
        bits.resize(rows, 0);
        let big = matches!(self.channel.data_type, DataType::UIntBe | DataType::IntBe | DataType::FloatBe);
        for k in 0..self.bytes {
            let column = &bytes[(self.from + k) * rows..][..rows];
            let shift = 8 * if big { self.bytes - 1 - k } else { k };
            bits.iter_mut().zip(column).for_each(|(x, b)| *x |= u64::from(*b) << shift);
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
}
