//! The C interface of Arrow: three structures, their owners, and what a column is.
//!
//! Reference: Arrow C data interface and C stream interface, version 1.

use std::ffi::{CStr, c_char, c_int, c_void};

/// Type and name of a column or a batch.
#[repr(C)]
pub(crate) struct Schema {
    pub(crate) format: *const c_char,
    pub(crate) name: *const c_char,
    pub(crate) metadata: *const c_char,
    pub(crate) flags: i64,
    pub(crate) n_children: i64,
    pub(crate) children: *mut *mut Schema,
    pub(crate) dictionary: *mut Schema,
    pub(crate) release: Option<unsafe extern "C" fn(*mut Schema)>,
    pub(crate) private: *mut c_void,
}

/// Values of a column or a batch.
#[repr(C)]
pub(crate) struct Array {
    pub(crate) length: i64,
    pub(crate) null_count: i64,
    pub(crate) offset: i64,
    pub(crate) n_buffers: i64,
    pub(crate) n_children: i64,
    pub(crate) buffers: *mut *const c_void,
    pub(crate) children: *mut *mut Array,
    pub(crate) dictionary: *mut Array,
    pub(crate) release: Option<unsafe extern "C" fn(*mut Array)>,
    pub(crate) private: *mut c_void,
}

/// A stream of batches.
#[repr(C)]
pub(crate) struct Stream {
    pub(crate) get_schema: Option<unsafe extern "C" fn(*mut Stream, *mut Schema) -> c_int>,
    pub(crate) get_next: Option<unsafe extern "C" fn(*mut Stream, *mut Array) -> c_int>,
    pub(crate) get_last_error: Option<unsafe extern "C" fn(*mut Stream) -> *const c_char>,
    pub(crate) release: Option<unsafe extern "C" fn(*mut Stream)>,
    pub(crate) private: *mut c_void,
}

impl Schema {
    pub(crate) const EMPTY: Self = Self {
        format: std::ptr::null(),
        name: std::ptr::null(),
        metadata: std::ptr::null(),
        flags: 0,
        n_children: 0,
        children: std::ptr::null_mut(),
        dictionary: std::ptr::null_mut(),
        release: None,
        private: std::ptr::null_mut(),
    };
}

impl Array {
    pub(crate) const EMPTY: Self = Self {
        length: 0,
        null_count: 0,
        offset: 0,
        n_buffers: 0,
        n_children: 0,
        buffers: std::ptr::null_mut(),
        children: std::ptr::null_mut(),
        dictionary: std::ptr::null_mut(),
        release: None,
        private: std::ptr::null_mut(),
    };
}

/// A schema that is released when it goes.
pub(crate) struct OwnedSchema(pub(crate) Schema);

impl Drop for OwnedSchema {
    fn drop(&mut self) {
        if let Some(release) = self.0.release {
            // SAFETY: filled by its producer and not released yet.
            unsafe { release(&mut self.0) };
        }
    }
}

/// A batch that is released when it goes.
pub(crate) struct OwnedArray(pub(crate) Array);

impl Drop for OwnedArray {
    fn drop(&mut self) {
        if let Some(release) = self.0.release {
            // SAFETY: filled by its producer and not released yet.
            unsafe { release(&mut self.0) };
        }
    }
}

/// Type of a column of numbers.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) enum Number {
    Bool,
    I8,
    U8,
    I16,
    U16,
    I32,
    U32,
    I64,
    U64,
    F32,
    F64,
    /// An integer of 64 bits, so many of which are a second: stamps and durations.
    Time(f64),
}

impl Number {
    /// From the format string of a column.
    pub(crate) fn of(format: &str) -> Option<Self> {
        let of_unit = |unit: &str| match unit.as_bytes().first() {
            Some(b's') => Some(Self::Time(1.0)),
            Some(b'm') => Some(Self::Time(1e3)),
            Some(b'u') => Some(Self::Time(1e6)),
            Some(b'n') => Some(Self::Time(1e9)),
            _ => None,
        };
        Some(match format {
            "b" => Self::Bool,
            "c" => Self::I8,
            "C" => Self::U8,
            "s" => Self::I16,
            "S" => Self::U16,
            "i" => Self::I32,
            "I" => Self::U32,
            "l" => Self::I64,
            "L" => Self::U64,
            "f" => Self::F32,
            "g" => Self::F64,
            f => return f.strip_prefix("ts").or_else(|| f.strip_prefix("tD")).and_then(of_unit),
        })
    }
}

/// A text of a producer; empty where there is none.
///
/// # Safety
/// `text` is null or ends with a zero byte.
pub(crate) unsafe fn text(text: *const c_char) -> String {
    if text.is_null() {
        return String::new();
    }
    // SAFETY: as of this function.
    unsafe { CStr::from_ptr(text) }.to_string_lossy().into_owned()
}

/// The value of a key in the metadata of a field: a count, then length and bytes of key and of value for each entry, lengths as 32-bit
/// integers of this machine.
///
/// # Safety
/// `metadata` is null or laid out like that.
pub(crate) unsafe fn metadata(metadata: *const c_char, key: &str) -> Option<String> {
    if metadata.is_null() {
        return None;
    }
    let mut at = metadata.cast::<u8>();
    // SAFETY: as of this function; integers need not be aligned.
    let entries = unsafe { integer(&mut at) };
    for _ in 0..entries {
        // SAFETY: every entry has two texts.
        let (name, value) = unsafe { (counted(&mut at), counted(&mut at)) };
        if name == key {
            return Some(value);
        }
    }
    None
}

/// # Safety
/// Four bytes are there.
unsafe fn integer(at: &mut *const u8) -> usize {
    // SAFETY: as of this function.
    unsafe {
        let found = at.cast::<i32>().read_unaligned();
        *at = at.add(4);
        usize::try_from(found).unwrap_or(0)
    }
}

/// # Safety
/// A length and so many bytes are there.
unsafe fn counted(at: &mut *const u8) -> String {
    // SAFETY: as of this function.
    unsafe {
        let n = integer(at);
        let bytes = std::slice::from_raw_parts(*at, n);
        *at = at.add(n);
        String::from_utf8_lossy(bytes).into_owned()
    }
}
