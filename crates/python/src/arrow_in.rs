//! Columns of an Arrow stream, copied at the door: a stream can be read once.

use std::ffi::c_void;

use numpy::{IntoPyArray, PyArray1};
use pyo3::prelude::*;
use pyo3::types::{PyCapsule, PyCapsuleMethods};

use crate::arrow_type::{Array, Number, OwnedArray, OwnedSchema, Schema, Stream, metadata, text};
use crate::errors::{Kind, Refusal};

/// One column: its name, its unit where the field says one, its type where that is a number, and what has been read.
struct Column {
    name: String,
    unit: Option<String>,
    format: String,
    number: Option<Number>,
    values: Vec<f64>,
}

/// Name and type of a column that holds no numbers.
type LeftOut = (String, String);

/// Name, unit, whether they are stamps or durations, and samples of a column.
type Numbers<'py> = (String, Option<String>, bool, Bound<'py, PyArray1<f64>>);

/// Columns of an object with `__arrow_c_stream__`, missing values as NaN, stamps in s; and the names and types of columns that hold no
/// numbers.
#[pyfunction]
pub(crate) fn record_from_arrow<'py>(
    py: Python<'py>,
    table: &Bound<'py, PyAny>,
) -> PyResult<(Vec<Numbers<'py>>, Vec<LeftOut>)> {
    let capsule = table.call_method0("__arrow_c_stream__")?;
    let capsule = capsule.cast::<PyCapsule>().map_err(|_| {
        Refusal::new(Kind::Data, "__arrow_c_stream__ gave no capsule: expected an Arrow stream")
    })?;
    let stream = capsule.pointer_checked(Some(c"arrow_array_stream"))?.as_ptr().cast::<Stream>();
    // SAFETY: a capsule of this name holds a stream, which the capsule frees if it was not released here.
    let columns = unsafe { read(&mut *stream) }?;
    let (numbers, others): (Vec<Column>, Vec<Column>) = columns.into_iter().partition(|c| c.number.is_some());
    Ok((
        numbers.into_iter().map(|c| numbered(py, c)).collect(),
        others.into_iter().map(|c| (c.name, c.format)).collect(),
    ))
}

fn numbered(py: Python<'_>, c: Column) -> Numbers<'_> {
    let stamps = matches!(c.number, Some(Number::Time(_)));
    (c.name, c.unit, stamps, c.values.into_pyarray(py))
}

fn refused(text: impl Into<String>) -> Refusal {
    Refusal::new(Kind::Data, text)
}

/// Reads a stream to its end and releases it.
///
/// # Safety
/// `stream` is one that its producer has filled.
unsafe fn read(stream: &mut Stream) -> Result<Vec<Column>, Refusal> {
    let (Some(get_schema), Some(get_next), Some(release)) =
        (stream.get_schema, stream.get_next, stream.release)
    else {
        return Err(refused("the Arrow stream was read before: a stream can be read once"));
    };
    let mut done = || -> Result<Vec<Column>, Refusal> {
        let mut schema = OwnedSchema(Schema::EMPTY);
        // SAFETY: the producer's own function on its own stream.
        if unsafe { get_schema(stream, &mut schema.0) } != 0 {
            // SAFETY: as above.
            return Err(unsafe { failed(stream) });
        }
        // SAFETY: a schema that get_schema has filled.
        let mut columns = unsafe { columns(&schema.0) }?;
        loop {
            let mut batch = OwnedArray(Array::EMPTY);
            // SAFETY: as of get_schema.
            if unsafe { get_next(stream, &mut batch.0) } != 0 {
                // SAFETY: as above.
                return Err(unsafe { failed(stream) });
            }
            if batch.0.release.is_none() {
                return Ok(columns);
            }
            // SAFETY: a batch that get_next has filled, of the schema that get_schema gave.
            unsafe { take(&batch.0, &mut columns) }?;
        }
    };
    let found = done();
    // SAFETY: the stream is released once, here.
    unsafe { release(stream) };
    found
}

/// # Safety
/// The last call on `stream` has failed.
unsafe fn failed(stream: &mut Stream) -> Refusal {
    // SAFETY: as of this function; the text lives until the next call.
    let why = stream.get_last_error.map(|last| unsafe { text(last(stream)) }).unwrap_or_default();
    refused(format!("the Arrow stream cannot be read: {why}"))
}

/// # Safety
/// `schema` was filled by its producer.
unsafe fn columns(schema: &Schema) -> Result<Vec<Column>, Refusal> {
    // SAFETY: as of this function.
    let format = unsafe { text(schema.format) };
    if format != "+s" {
        return Err(refused(format!("the Arrow stream holds `{format}`: expected a table of columns")));
    }
    let one = |k: usize| {
        // SAFETY: a schema has n_children children.
        let child = unsafe { &**schema.children.add(k) };
        // SAFETY: texts of the producer.
        let (name, format) = unsafe { (text(child.name), text(child.format)) };
        // SAFETY: metadata of the producer.
        let unit = unsafe { metadata(child.metadata, "unit") };
        let number = Number::of(&format).filter(|_| child.dictionary.is_null());
        Column { name, unit, format, number, values: Vec::new() }
    };
    Ok((0..usize::try_from(schema.n_children).unwrap_or(0)).map(one).collect())
}

/// # Safety
/// `batch` was filled by its producer, for the schema of `columns`.
unsafe fn take(batch: &Array, columns: &mut [Column]) -> Result<(), Refusal> {
    let size =
        |v: i64| usize::try_from(v).map_err(|_| refused("the Arrow stream has a batch of negative length"));
    let (rows, skip) = (size(batch.length)?, size(batch.offset)?);
    if size(batch.n_children)? != columns.len() {
        return Err(refused("the Arrow stream has batches of different columns"));
    }
    for (k, column) in columns.iter_mut().enumerate() {
        let Some(number) = column.number else { continue };
        // SAFETY: a batch has n_children children.
        let child = unsafe { &**batch.children.add(k) };
        let first = skip + size(child.offset)?;
        if child.n_buffers != 2 || size(child.length)? < skip + rows {
            return Err(refused(format!("the Arrow column `{}` is shorter than its batch", column.name)));
        }
        // SAFETY: a column of numbers has two buffers, validity and values, of offset + length entries.
        let (valid, values) = unsafe { (*child.buffers, *child.buffers.add(1)) };
        if values.is_null() && rows > 0 {
            return Err(refused(format!("the Arrow column `{}` has no values", column.name)));
        }
        let all = valid.is_null() || child.null_count == 0;
        column.values.reserve(rows);
        for row in first..first + rows {
            // SAFETY: row is below offset + length.
            let known = all || unsafe { bit(valid, row) };
            // SAFETY: as above.
            column.values.push(if known { unsafe { value(number, values, row) } } else { f64::NAN });
        }
    }
    Ok(())
}

/// # Safety
/// `bits` holds more than `k` bits.
unsafe fn bit(bits: *const c_void, k: usize) -> bool {
    // SAFETY: as of this function.
    unsafe { *bits.cast::<u8>().add(k / 8) >> (k % 8) & 1 == 1 }
}

/// # Safety
/// `values` holds more than `k` values of that type.
unsafe fn value(number: Number, values: *const c_void, k: usize) -> f64 {
    // SAFETY: as of this function; buffers are aligned to their type.
    unsafe {
        match number {
            Number::Bool => f64::from(u8::from(bit(values, k))),
            Number::I8 => f64::from(*values.cast::<i8>().add(k)),
            Number::U8 => f64::from(*values.cast::<u8>().add(k)),
            Number::I16 => f64::from(*values.cast::<i16>().add(k)),
            Number::U16 => f64::from(*values.cast::<u16>().add(k)),
            Number::I32 => f64::from(*values.cast::<i32>().add(k)),
            Number::U32 => f64::from(*values.cast::<u32>().add(k)),
            Number::I64 => *values.cast::<i64>().add(k) as f64,
            Number::U64 => *values.cast::<u64>().add(k) as f64,
            Number::F32 => f64::from(*values.cast::<f32>().add(k)),
            Number::F64 => *values.cast::<f64>().add(k),
            Number::Time(per_s) => *values.cast::<i64>().add(k) as f64 / per_s,
        }
    }
}
