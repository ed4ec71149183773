//! A record as an Arrow stream of one batch; its samples are shared, not copied.

use std::ffi::{CString, c_char, c_int, c_void};
use std::ptr;
use std::sync::Arc;

use dynocal_ident::data::Dataset;
use pyo3::prelude::*;
use pyo3::types::PyCapsule;

use crate::arrow_type::{Array, Schema, Stream};
use crate::errors::{Kind, Refusal};
use crate::record::Record;

/// What a schema keeps alive until it is released.
struct SchemaHold {
    _name: CString,
    _metadata: Vec<u8>,
    children: Vec<*mut Schema>,
}

/// What a batch keeps alive until it is released.
struct ArrayHold {
    _data: Arc<Dataset>,
    buffers: Vec<*const c_void>,
    children: Vec<*mut Array>,
}

/// What a stream keeps.
struct StreamHold {
    data: Arc<Dataset>,
    given: bool,
}

/// A stream that is released when its capsule goes, unless its reader has done so.
struct Exported(Stream);

// SAFETY: the stream holds nothing but an `Arc` of a record, and is read by one thread at a time.
unsafe impl Send for Exported {}

impl Drop for Exported {
    fn drop(&mut self) {
        if let Some(release) = self.0.release {
            // SAFETY: ours, and not released yet.
            unsafe { release(&mut self.0) };
        }
    }
}

/// The record as a capsule of an Arrow stream: float64 columns, their units in the metadata of each field.
#[pyfunction]
pub(crate) fn record_to_arrow<'py>(py: Python<'py>, record: &Record) -> PyResult<Bound<'py, PyCapsule>> {
    if record.data.channels.iter().any(|c| c.name.contains('\0')) {
        return Err(Refusal::new(Kind::Data, "a channel name holds a zero byte: Arrow cannot name it").into());
    }
    let hold = Box::new(StreamHold { data: record.data.clone(), given: false });
    let stream = Stream {
        get_schema: Some(get_schema),
        get_next: Some(get_next),
        get_last_error: Some(get_last_error),
        release: Some(release_stream),
        private: Box::into_raw(hold).cast(),
    };
    PyCapsule::new_with_value(py, Exported(stream), c"arrow_array_stream")
}

unsafe extern "C" fn get_schema(stream: *mut Stream, out: *mut Schema) -> c_int {
    // SAFETY: private is the box of record_to_arrow until the stream is released.
    let data = unsafe { &(*(*stream).private.cast::<StreamHold>()).data };
    let children =
        data.channels.iter().map(|c| boxed_schema(&c.name, c"g".as_ptr(), unit(&c.unit), Vec::new()));
    let children = children.map(|s| Box::into_raw(Box::new(s))).collect();
    // SAFETY: the caller gives room for a schema.
    unsafe { out.write(boxed_schema("", c"+s".as_ptr(), Vec::new(), children)) };
    0
}

/// Metadata of a field: `unit` and its value, as Arrow lays it out.
fn unit(unit: &str) -> Vec<u8> {
    let size = |n: usize| i32::try_from(n).unwrap_or(0).to_ne_bytes();
    let mut bytes = 1i32.to_ne_bytes().to_vec();
    for text in ["unit", unit] {
        bytes.extend(size(text.len()));
        bytes.extend(text.as_bytes());
    }
    bytes
}

fn boxed_schema(name: &str, format: *const c_char, metadata: Vec<u8>, children: Vec<*mut Schema>) -> Schema {
    let name = CString::new(name).unwrap_or_default();
    let mut hold = Box::new(SchemaHold { _name: name, _metadata: metadata, children });
    let nullable = 2;
    Schema {
        format,
        name: hold._name.as_ptr(),
        metadata: if hold._metadata.is_empty() { ptr::null() } else { hold._metadata.as_ptr().cast() },
        flags: if hold.children.is_empty() { nullable } else { 0 },
        n_children: hold.children.len() as i64,
        children: hold.children.as_mut_ptr(),
        dictionary: ptr::null_mut(),
        release: Some(release_schema),
        private: Box::into_raw(hold).cast(),
    }
}

unsafe extern "C" fn release_schema(schema: *mut Schema) {
    // SAFETY: private is the box of boxed_schema; the reader calls this once.
    unsafe {
        let hold = Box::from_raw((*schema).private.cast::<SchemaHold>());
        for child in &hold.children {
            let mut child = Box::from_raw(*child);
            // A reader may have taken a child away: then it has no release any more.
            if let Some(release) = child.release {
                release(&mut *child);
            }
        }
        (*schema).release = None;
    }
}

unsafe extern "C" fn get_next(stream: *mut Stream, out: *mut Array) -> c_int {
    // SAFETY: as of get_schema.
    let hold = unsafe { &mut *(*stream).private.cast::<StreamHold>() };
    let batch = if std::mem::replace(&mut hold.given, true) {
        Array::EMPTY
    } else {
        let one = |k: usize| {
            let values = hold.data.channels[k].values.as_ptr().cast();
            Box::into_raw(Box::new(boxed_array(&hold.data, vec![ptr::null(), values], Vec::new())))
        };
        boxed_array(&hold.data, vec![ptr::null()], (0..hold.data.channels.len()).map(one).collect())
    };
    // SAFETY: the caller gives room for a batch.
    unsafe { out.write(batch) };
    0
}

fn boxed_array(data: &Arc<Dataset>, buffers: Vec<*const c_void>, children: Vec<*mut Array>) -> Array {
    let mut hold = Box::new(ArrayHold { _data: data.clone(), buffers, children });
    Array {
        length: data.len() as i64,
        null_count: 0,
        offset: 0,
        n_buffers: hold.buffers.len() as i64,
        n_children: hold.children.len() as i64,
        buffers: hold.buffers.as_mut_ptr(),
        children: hold.children.as_mut_ptr(),
        dictionary: ptr::null_mut(),
        release: Some(release_array),
        private: Box::into_raw(hold).cast(),
    }
}

unsafe extern "C" fn release_array(array: *mut Array) {
    // SAFETY: private is the box of boxed_array; the reader calls this once.
    unsafe {
        let hold = Box::from_raw((*array).private.cast::<ArrayHold>());
        for child in &hold.children {
            let mut child = Box::from_raw(*child);
            // A reader may have taken a child away: then it has no release any more.
            if let Some(release) = child.release {
                release(&mut *child);
            }
        }
        (*array).release = None;
    }
}

unsafe extern "C" fn get_last_error(_: *mut Stream) -> *const c_char {
    ptr::null()
}

unsafe extern "C" fn release_stream(stream: *mut Stream) {
    // SAFETY: private is the box of record_to_arrow; called once.
    unsafe {
        drop(Box::from_raw((*stream).private.cast::<StreamHold>()));
        (*stream).release = None;
    }
}
