//! Parquet (zstd, snappy, gzip or plain pages), flat columns: float32, float64, signed and unsigned integers,
//! booleans, text, and time stamps (dates, clocks) as seconds since the first. Page checksums are verified. Key-value metadata
//! `unit:NAME` gives the unit of a column, beside `NAME [unit]` and suffixes.

use std::collections::BTreeSet;
use std::fs::File;
use std::path::Path;
use std::sync::Arc;

use dynocal_ident::data::Dataset;
use dynocal_numerics::registry::MemberDoc;
use parquet::basic::{
    Compression, ConvertedType, LogicalType, Repetition, TimeUnit, Type as Physical, ZstdLevel,
};
use parquet::column::reader::{ColumnReader, ColumnReaderImpl};
use parquet::data_type::{ByteArray, DataType, DoubleType};
use parquet::errors::ParquetError;
use parquet::file::metadata::ColumnChunkMetaData;
use parquet::file::properties::WriterProperties;
use parquet::file::reader::{FileReader, SerializedFileReader};
use parquet::file::writer::SerializedFileWriter;
use parquet::schema::types::{ColumnDescriptor, Type};

use crate::error::{FilesError, reason};
use crate::measurement::{self, Raster, Reader, Whole, csv_io};
use crate::table::{Cells, Column, Table, UnitSource};
use crate::{atomic, bounds, units};

/// Row of the table of formats.
pub const FORMAT: Reader = Reader {
    doc: MemberDoc { name: "parquet", what: "Parquet with flat columns; read whole", params: &[] },
    endings: &[".parquet"],
    recognises: |head| head.starts_with(b"PAR1"),
    open: |path, _| Ok(Box::new(Whole::new(read(path)?))),
    write: Some(write_rasters),
    several: false,
};

/// Reads a Parquet file.
///
/// # Errors
/// [`FilesError`]: unreadable, not Parquet, empty, a column that is nested or of a type without numbers or text.
pub fn read(path: &Path) -> Result<Table, FilesError> {
    let file = path.display().to_string();
    let fail = |e: std::io::Error| FilesError::Read { path: file.clone(), reason: reason(&e) };
    let handle = File::open(path).map_err(fail)?;
    let empty =
        || FilesError::Empty { path: file.clone(), expected: "a Parquet table with at least one row" };
    let meta = handle.metadata().map_err(fail)?;
    if meta.is_dir() {
        return Err(FilesError::Read { path: file, reason: "it is a folder".into() });
    }
    if meta.len() == 0 {
        return Err(empty());
    }
    let malformed = |e: ParquetError| malformed(&file, &in_words(&e));
    let reader = SerializedFileReader::new(handle).map_err(malformed)?;
    let info = reader.metadata().file_metadata();
    let schema = info.schema_descr_ptr();
    let metadata = info.key_value_metadata();
    let stated = |name: &str| {
        let key = format!("unit:{name}");
        metadata?.iter().find(|kv| kv.key == key)?.value.as_deref().map(units::normalise)
    };
    measurement::bounded(&file, "Parquet", schema.num_columns())?;
    bounds::held(&file, u64::try_from(info.num_rows()).unwrap_or(0), schema.num_columns())?;
    let mut columns: Vec<Column> = Vec::with_capacity(schema.num_columns());
    let mut names = BTreeSet::new();
    let mut notes = Vec::new();
    for k in 0..schema.num_columns() {
        let descr = schema.column(k);
        let raw = descr.path().string();
        check_type(&file, &raw, &descr)?;
        let (name, bracket) = units::split_header(&raw);
        let unit = match bracket.or_else(|| stated(&raw)) {
            Some(u) => Some((u, UnitSource::Bracket)),
            None => units::from_suffix(&name).map(|u| (u.to_string(), UnitSource::Suffix)),
        };
        if !names.insert(name.clone()) {
            return Err(FilesError::DuplicateColumn { path: file, column: name });
        }
        let mut cells = Grow::default();
        for g in 0..reader.num_row_groups() {
            let group = reader.get_row_group(g).map_err(malformed)?;
            check_place(&file, &raw, group.metadata().column(k), meta.len())?;
            let rows = usize::try_from(group.metadata().num_rows()).unwrap_or(0);
            let column = group.get_column_reader(k).map_err(malformed)?;
            cells.read(column, rows, &descr).map_err(malformed)?;
        }
        // Stamps have their unit from the type, whatever a name or its suffix says.
        let stamped = Stamps::of(&descr).map(|s| (s, cells.first));
        let unit = if stamped.is_some() { Some(("s".into(), UnitSource::Bracket)) } else { unit };
        if let Some((s, first)) = stamped {
            let from =
                if s.absolute { format!(", {} since 1970", first.unwrap_or(0)) } else { String::new() };
            notes.push(format!(
                "column `{name}`: {} in {} as seconds since its first value{from}",
                s.what, s.unit
            ));
        }
        columns.push(Column { name, unit, cells: cells.finish() });
    }
    if columns.first().is_none_or(|c| c.cells.is_empty()) {
        return Err(empty());
    }
    Ok(Table { file, columns, lines: Vec::new(), notes })
}

/// The library asserts what a broken file does not keep: where a column lies is checked before it is asked.
fn check_place(file: &str, name: &str, chunk: &ColumnChunkMetaData, length: u64) -> Result<(), FilesError> {
    let start = chunk.dictionary_page_offset().unwrap_or_else(|| chunk.data_page_offset());
    let place = u64::try_from(start).ok().zip(u64::try_from(chunk.compressed_size()).ok());
    match place.and_then(|(a, n)| a.checked_add(n)) {
        Some(end) if end <= length && chunk.data_page_offset() >= 0 => Ok(()),
        _ => {
            let size = chunk.compressed_size();
            Err(malformed(
                file,
                &format!("column `{name}` claims {size} bytes at {start} of a file of {length}"),
            ))
        }
    }
}

fn malformed(file: &str, reason: &str) -> FilesError {
    FilesError::Malformed { path: file.into(), format: "Parquet", reason: reason.into() }
}

fn check_type(file: &str, name: &str, descr: &ColumnDescriptor) -> Result<(), FilesError> {
    let refuse = |what: &str| {
        let why = format!("column `{name}`: found {what}, expected a float, integer, boolean or text column");
        Err(malformed(file, &why))
    };
    if descr.max_rep_level() > 0 || descr.path().parts().len() > 1 {
        return refuse("a nested column");
    }
    // A decimal stores scaled integers: reading them as they are would be a wrong number, not a reading.
    if matches!(descr.logical_type_ref(), Some(LogicalType::Decimal { .. }))
        || descr.converted_type() == ConvertedType::DECIMAL
    {
        return refuse("a decimal column");
    }
    match descr.physical_type() {
        Physical::INT96 | Physical::FIXED_LEN_BYTE_ARRAY => refuse("a fixed-length binary column"),
        _ => Ok(()),
    }
}

/// A column of instants or times of day: whole numbers whose unit stands in the type.
#[derive(Clone, Copy)]
struct Stamps {
    what: &'static str,
    unit: &'static str,
    second: f64,
    absolute: bool,
}

impl Stamps {
    fn of(descr: &ColumnDescriptor) -> Option<Self> {
        let scale = |unit: &TimeUnit| match unit {
            TimeUnit::MILLIS => ("ms", 1e3),
            TimeUnit::MICROS => ("us", 1e6),
            TimeUnit::NANOS => ("ns", 1e9),
        };
        let (what, (unit, second), absolute) = match (descr.logical_type_ref(), descr.converted_type()) {
            (Some(LogicalType::Timestamp(t)), _) => ("time stamps", scale(&t.unit), true),
            (Some(LogicalType::Time(t)), _) => ("a clock", scale(&t.unit), false),
            (Some(LogicalType::Date), _) | (None, ConvertedType::DATE) => {
                ("dates", ("days", 1.0 / 86400.0), true)
            }
            (None, ConvertedType::TIMESTAMP_MILLIS) => ("time stamps", ("ms", 1e3), true),
            (None, ConvertedType::TIMESTAMP_MICROS) => ("time stamps", ("us", 1e6), true),
            (None, ConvertedType::TIME_MILLIS) => ("a clock", ("ms", 1e3), false),
            (None, ConvertedType::TIME_MICROS) => ("a clock", ("us", 1e6), false),
            _ => return None,
        };
        Some(Self { what, unit, second, absolute })
    }
}

/// A column while its row groups are read.
#[derive(Default)]
struct Grow {
    numbers: Vec<f64>,
    text: Option<Vec<String>>,
    /// First stamp, in its unit.
    first: Option<i64>,
}

impl Grow {
    fn read(
        &mut self,
        column: ColumnReader,
        rows: usize,
        descr: &ColumnDescriptor,
    ) -> Result<(), ParquetError> {
        let unsigned = matches!(descr.logical_type_ref(), Some(LogicalType::Integer(i)) if !i.is_signed)
            || matches!(descr.converted_type(), ConvertedType::UINT_32 | ConvertedType::UINT_64);
        if let Some(stamps) = Stamps::of(descr) {
            return match column {
                ColumnReader::Int64ColumnReader(r) => self.stamps(r, rows, stamps, |x| *x),
                ColumnReader::Int32ColumnReader(r) => self.stamps(r, rows, stamps, |x| i64::from(*x)),
                _ => Err(ParquetError::General("time stamps that are no whole numbers".into())),
            };
        }
        match column {
            ColumnReader::DoubleColumnReader(r) => self.numbers(r, rows, |x| *x),
            ColumnReader::FloatColumnReader(r) => self.numbers(r, rows, |x| f64::from(*x)),
            ColumnReader::Int32ColumnReader(r) if unsigned => {
                self.numbers(r, rows, |x| f64::from(x.cast_unsigned()))
            }
            ColumnReader::Int32ColumnReader(r) => self.numbers(r, rows, |x| f64::from(*x)),
            ColumnReader::Int64ColumnReader(r) if unsigned => {
                self.numbers(r, rows, |x| x.cast_unsigned() as f64)
            }
            ColumnReader::Int64ColumnReader(r) => self.numbers(r, rows, |x| *x as f64),
            ColumnReader::BoolColumnReader(r) => self.numbers(r, rows, |x| f64::from(u8::from(*x))),
            ColumnReader::ByteArrayColumnReader(r) => {
                let out = self.text.get_or_insert_default();
                each(r, rows, |v: Option<&ByteArray>| {
                    out.push(v.map(|b| String::from_utf8_lossy(b.data()).into_owned()).unwrap_or_default());
                })
            }
            _ => Err(ParquetError::General("column type without numbers or text".into())),
        }
    }

    /// Null cells become NaN: a channel that uses them is refused with row and column.
    fn numbers<T: DataType>(
        &mut self,
        reader: ColumnReaderImpl<T>,
        rows: usize,
        convert: impl Fn(&T::T) -> f64,
    ) -> Result<(), ParquetError> {
        self.numbers.reserve(rows);
        each(reader, rows, |v: Option<&T::T>| self.numbers.push(v.map_or(f64::NAN, &convert)))
    }

    /// Seconds since the first one: as whole numbers they are subtracted exactly, as seconds since 1970 they would lose digits.
    fn stamps<T: DataType>(
        &mut self,
        reader: ColumnReaderImpl<T>,
        rows: usize,
        stamps: Stamps,
        whole: impl Fn(&T::T) -> i64,
    ) -> Result<(), ParquetError> {
        self.numbers.reserve(rows);
        each(reader, rows, |v: Option<&T::T>| {
            let v = v.map(&whole);
            self.first = self.first.or(v);
            let since = v.zip(self.first).map(|(v, first)| v.saturating_sub(first) as f64 / stamps.second);
            self.numbers.push(since.unwrap_or(f64::NAN));
        })
    }

    fn finish(self) -> Cells {
        match self.text {
            Some(t) => Cells::Text(t),
            None => Cells::Number(self.numbers),
        }
    }
}

/// Calls `take` for each of `rows` cells, `None` for null.
fn each<T: DataType>(
    mut reader: ColumnReaderImpl<T>,
    rows: usize,
    mut take: impl FnMut(Option<&T::T>),
) -> Result<(), ParquetError> {
    let (mut values, mut levels) = (Vec::new(), Vec::new());
    let mut left = rows;
    while left > 0 {
        values.clear();
        levels.clear();
        let (records, found, _) =
            reader.read_records(left.min(1 << 16), Some(&mut levels), None, &mut values)?;
        if records == 0 {
            return Err(ParquetError::General(format!("{left} of {rows} rows are missing")));
        }
        let mut next = values[..found].iter();
        if found == records {
            next.for_each(|v| take(Some(v)));
        } else {
            // Flat columns have one definition level: 1 where there is a value.
            levels.iter().for_each(|l| take(if *l > 0 { next.next() } else { None }));
        }
        left -= records;
    }
    Ok(())
}

/// Writes a dataset as float64 columns `name [unit]` with zstd pages: time in s, then every channel.
///
/// # Errors
/// [`FilesError::Write`], or [`FilesError::Data`] when the dataset is not consistent.
pub fn write_dataset(path: &Path, data: &Dataset) -> Result<(), FilesError> {
    data.check()?;
    let time: Vec<f64> = (0..data.len()).map(|t| t as f64 * data.sample_time_s).collect();
    let mut columns = vec![("time [s]".to_string(), time.as_slice())];
    columns.extend(data.channels.iter().map(|c| (format!("{} [{}]", c.name, c.unit), c.values.as_slice())));
    let bytes = encode(&columns)
        .map_err(|e| FilesError::Write { path: path.display().to_string(), reason: e.to_string() })?;
    atomic::write(path, &bytes)
}

/// Writes columns (name, unit or none, values) of equal length; as [`write_dataset`], missing samples as NaN.
///
/// # Errors
/// [`FilesError::Write`].
pub fn write_columns(path: &Path, columns: &[(&str, &str, &[f64])]) -> Result<(), FilesError> {
    let headed: Vec<(String, &[f64])> = columns.iter().map(|(n, u, v)| (csv_io::heading(n, u), *v)).collect();
    let bytes = encode(&headed)
        .map_err(|e| FilesError::Write { path: path.display().to_string(), reason: e.to_string() })?;
    atomic::write(path, &bytes)
}

/// Writes the only raster of a recording. States in words are refused: the columns are numbers.
fn write_rasters(path: &Path, rasters: &[Raster]) -> Result<(), FilesError> {
    let fail = |reason: String| FilesError::Write { path: path.display().to_string(), reason };
    let raster = csv_io::only(path, "Parquet", rasters)?;
    let mut columns = vec![("time [s]".to_string(), raster.time_s.as_slice())];
    for c in &raster.columns {
        let Cells::Number(values) = &c.cells else {
            return Err(fail(format!(
                "column `{}` holds words, expected numbers (write CSV instead)",
                c.name
            )));
        };
        columns.push((csv_io::heading(&c.name, c.unit.as_ref().map_or("", |u| u.0.as_str())), values));
    }
    atomic::write(path, &encode(&columns).map_err(|e| fail(e.to_string()))?)
}

/// What the library says; a compression that it was built without in the user's words.
fn in_words(e: &ParquetError) -> String {
    let text = e.to_string();
    match text.rsplit_once("Disabled feature at compile time: ") {
        Some((_, name)) => {
            format!("it is compressed by {name}, which is not read; expected snappy, gzip, zstd or none")
        }
        None => text,
    }
}

fn encode(columns: &[(String, &[f64])]) -> Result<Vec<u8>, ParquetError> {
    let fields = columns
        .iter()
        .map(|(name, _)| {
            Type::primitive_type_builder(name, Physical::DOUBLE)
                .with_repetition(Repetition::REQUIRED)
                .build()
                .map(Arc::new)
        })
        .collect::<Result<Vec<_>, _>>()?;
    let schema = Type::group_type_builder("schema").with_fields(fields).build()?;
    let properties = WriterProperties::builder()
        .set_compression(Compression::ZSTD(ZstdLevel::try_new(3)?))
        .set_created_by("dynocal".into())
        .build();
    let mut writer = SerializedFileWriter::new(Vec::new(), Arc::new(schema), Arc::new(properties))?;
    let mut group = writer.next_row_group()?;
    for (_, values) in columns {
        if let Some(mut column) = group.next_column()? {
            column.typed::<DoubleType>().write_batch(values, None, None)?;
            column.close()?;
        }
    }
    group.close()?;
    writer.into_inner()
}
