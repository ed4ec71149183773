//! One instance behind a pointer, as both versions of the standard want it: what their functions have in common.

use std::ffi::{CStr, c_char, c_int, c_uint, c_void};
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::path::PathBuf;

use crate::description::TOKEN;
use crate::engine::{Engine, Setup};

/// Status codes, which are the same in both versions.
pub(crate) const OK: c_int = 0;
pub(crate) const ERROR: c_int = 3;

/// Takes a message to the importer.
pub(crate) type Log = Box<dyn Fn(&str)>;

/// An instance and where its messages go.
pub(crate) struct Unit {
    engine: Engine,
    start_s: f64,
    log: Log,
}

/// Text of a C string; empty for a null pointer.
///
/// # Safety
/// The pointer is null or a string that ends with a zero byte.
pub(crate) unsafe fn text(p: *const c_char) -> String {
    if p.is_null() {
        return String::new();
    }
    // SAFETY: promised by the caller.
    unsafe { CStr::from_ptr(p) }.to_string_lossy().into_owned()
}

/// Folder of a resource location: a file URI (FMI 2.0) or a path (FMI 3.0).
fn folder(location: &str) -> PathBuf {
    let path = match location.strip_prefix("file:") {
        None => return PathBuf::from(location),
        Some(rest) => rest.strip_prefix("//localhost").or(rest.strip_prefix("//")).unwrap_or(rest),
    };
    // Percent signs stand for bytes in a URI.
    let (mut bytes, mut rest) = (Vec::new(), path.as_bytes());
    while let Some((first, more)) = rest.split_first() {
        let code = more.get(..2).and_then(|c| std::str::from_utf8(c).ok());
        match code.and_then(|c| u8::from_str_radix(c, 16).ok()).filter(|_| *first == b'%') {
            Some(byte) => {
                bytes.push(byte);
                rest = &more[2..];
            }
            None => {
                bytes.push(*first);
                rest = more;
            }
        }
    }
    // `/C:/..` of a URI is `C:/..`.
    let path = String::from_utf8_lossy(&bytes).into_owned();
    let drive = path.strip_prefix('/').filter(|p| p.as_bytes().get(1) == Some(&b':'));
    PathBuf::from(drive.map(str::to_string).unwrap_or(path))
}

/// Nothing that goes wrong here may end the importer: a panic would be a fault of ours, and is told as an error.
fn guarded<T>(work: impl FnOnce() -> Result<T, String>) -> Result<T, String> {
    catch_unwind(AssertUnwindSafe(work)).unwrap_or_else(|_| Err("an internal error of the unit".into()))
}

/// A new instance; null where it cannot be, for a reason that `log` is told.
pub(crate) fn create(token: &str, resources: &str, log: Log) -> *mut c_void {
    let made = guarded(|| {
        if token != TOKEN {
            return Err(format!(
                "found the token {token}, expected {TOKEN}: description and binary do not belong together"
            ));
        }
        Setup::from_resources(&folder(resources)).and_then(Engine::new)
    });
    match made {
        Ok(engine) => Box::into_raw(Box::new(Unit { engine, start_s: 0.0, log })).cast(),
        Err(e) => {
            log(&e);
            std::ptr::null_mut()
        }
    }
}

/// # Safety
/// `c` is null, or came from [`create`] and is freed once.
pub(crate) unsafe fn free(c: *mut c_void) {
    if !c.is_null() {
        // SAFETY: promised by the caller.
        drop(unsafe { Box::from_raw(c.cast::<Unit>()) });
    }
}

/// Does `work` with an instance and gives its status.
///
/// # Safety
/// `c` is null, or came from [`create`] and was not freed; no other call has it.
unsafe fn with(c: *mut c_void, work: impl FnOnce(&mut Unit) -> Result<(), String>) -> c_int {
    // SAFETY: promised by the caller.
    let Some(unit) = (unsafe { c.cast::<Unit>().as_mut() }) else { return ERROR };
    match guarded(|| work(unit)) {
        Ok(()) => OK,
        Err(message) => {
            (unit.log)(&message);
            ERROR
        }
    }
}

/// Remembers the start time.
///
/// # Safety
/// As [`with`].
pub(crate) unsafe fn start_at(c: *mut c_void, start_s: f64) -> c_int {
    // SAFETY: promised by the caller.
    unsafe {
        with(c, |u| {
            u.start_s = start_s;
            Ok(())
        })
    }
}

/// Starts with the parameters as they are.
///
/// # Safety
/// As [`with`].
pub(crate) unsafe fn start(c: *mut c_void) -> c_int {
    // SAFETY: promised by the caller.
    unsafe { with(c, |u| u.engine.restart(u.start_s)) }
}

/// Everything as after [`create`].
///
/// # Safety
/// As [`with`].
pub(crate) unsafe fn reset(c: *mut c_void) -> c_int {
    // SAFETY: promised by the caller.
    unsafe {
        with(c, |u| {
            u.start_s = 0.0;
            u.engine.reset()
        })
    }
}

/// # Safety
/// As [`with`]; both arrays hold `n` entries.
pub(crate) unsafe fn get(c: *mut c_void, vr: *const c_uint, n: usize, value: *mut f64) -> c_int {
    // SAFETY: promised by the caller.
    unsafe {
        with(c, |u| {
            for k in 0..n {
                let r = *vr.add(k);
                *value.add(k) = u.engine.get(r).ok_or_else(|| format!("there is no variable {r}"))?;
            }
            Ok(())
        })
    }
}

/// # Safety
/// As [`with`]; both arrays hold `n` entries.
pub(crate) unsafe fn set(c: *mut c_void, vr: *const c_uint, n: usize, value: *const f64) -> c_int {
    // SAFETY: promised by the caller.
    unsafe {
        with(c, |u| {
            for k in 0..n {
                let r = *vr.add(k);
                if !u.engine.set(r, *value.add(k)) {
                    return Err(format!("the variable {r} cannot be set"));
                }
            }
            Ok(())
        })
    }
}

/// # Safety
/// As [`with`].
pub(crate) unsafe fn step(c: *mut c_void, time_s: f64, step_s: f64) -> c_int {
    // SAFETY: promised by the caller.
    unsafe { with(c, |u| u.engine.step(time_s, step_s)) }
}

/// # Safety
/// As [`with`]; `state` points to null or to a state of ours.
pub(crate) unsafe fn save(c: *mut c_void, state: *mut *mut c_void) -> c_int {
    // SAFETY: promised by the caller.
    unsafe {
        with(c, |u| {
            free_state(state);
            *state = Box::into_raw(Box::new(u.engine.save())).cast();
            Ok(())
        })
    }
}

/// # Safety
/// As [`with`]; `state` is null or a state of ours.
pub(crate) unsafe fn restore(c: *mut c_void, state: *mut c_void) -> c_int {
    // SAFETY: promised by the caller.
    unsafe {
        with(c, |u| match state.cast::<Vec<f64>>().as_ref() {
            Some(numbers) => u.engine.restore(numbers),
            None => Err("found no state, expected one".into()),
        })
    }
}

/// # Safety
/// `state` is null or points to null or to a state of ours, which is freed once.
pub(crate) unsafe fn free_state(state: *mut *mut c_void) -> c_int {
    // SAFETY: promised by the caller.
    unsafe {
        if !state.is_null() && !(*state).is_null() {
            drop(Box::from_raw((*state).cast::<Vec<f64>>()));
            *state = std::ptr::null_mut();
        }
    }
    OK
}

/// # Safety
/// `state` is null or a state of ours; `n` is the importer's.
pub(crate) unsafe fn size(state: *mut c_void, n: *mut usize) -> c_int {
    // SAFETY: promised by the caller.
    let Some(numbers) = (unsafe { state.cast::<Vec<f64>>().as_ref() }) else { return ERROR };
    // SAFETY: promised by the caller.
    unsafe { *n = 8 * numbers.len() };
    OK
}

/// # Safety
/// `state` is null or a state of ours; `bytes` holds `n`.
pub(crate) unsafe fn serialise(state: *mut c_void, bytes: *mut u8, n: usize) -> c_int {
    // SAFETY: promised by the caller.
    let Some(numbers) = (unsafe { state.cast::<Vec<f64>>().as_ref() }) else { return ERROR };
    if n != 8 * numbers.len() {
        return ERROR;
    }
    // SAFETY: promised by the caller.
    let to = unsafe { std::slice::from_raw_parts_mut(bytes, n) };
    to.chunks_exact_mut(8).zip(numbers).for_each(|(b, x)| b.copy_from_slice(&x.to_le_bytes()));
    OK
}

/// # Safety
/// As [`with`]; `bytes` holds `n`, `state` points to null or to a state of ours.
pub(crate) unsafe fn deserialise(
    c: *mut c_void,
    bytes: *const u8,
    n: usize,
    state: *mut *mut c_void,
) -> c_int {
    // SAFETY: promised by the caller.
    unsafe {
        with(c, |_| {
            if bytes.is_null() || n == 0 || !n.is_multiple_of(8) {
                return Err(format!("found a state of {n} bytes, expected numbers of 8 bytes"));
            }
            let from = std::slice::from_raw_parts(bytes, n);
            let number = |b: &[u8]| b.try_into().map_or(f64::NAN, f64::from_le_bytes);
            let numbers: Vec<f64> = from.chunks_exact(8).map(number).collect();
            free_state(state);
            *state = Box::into_raw(Box::new(numbers)).cast();
            Ok(())
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn resource_locations_are_uris_or_paths() {
        for (from, to) in [
            ("file:///tmp/a%20b/resources", "/tmp/a b/resources"),
            ("file:/tmp/100%/r", "/tmp/100%/r"),
            ("file://localhost/tmp/r", "/tmp/r"),
            ("file:///C:/Temp/r", "C:/Temp/r"),
            ("/tmp/a%20b/", "/tmp/a%20b/"),
        ] {
            assert_eq!(folder(from), PathBuf::from(to), "{from}");
        }
    }
}
