//! What both versions of the standard have in common, seen from the plant.

use std::path::Path;

use libloading::Library;

use crate::error::FmuError;

/// A loaded and instantiated unit.
pub(crate) trait Instance: Send {
    /// Back to the start, with `parameters` (reference, value) set, ready for the first step.
    fn start(&mut self, parameters: &[(u32, f64)]) -> Result<(), FmuError>;

    /// Sets variables.
    fn set(&mut self, references: &[u32], values: &[f64]) -> Result<(), FmuError>;

    /// Reads variables.
    fn get(&self, references: &[u32], values: &mut [f64]) -> Result<(), FmuError>;

    /// Advances from `time_s` by `step_s`.
    fn step(&mut self, time_s: f64, step_s: f64) -> Result<(), FmuError>;

    /// The state as bytes.
    fn save(&self) -> Result<Vec<u8>, FmuError>;

    /// Back to a state.
    fn restore(&mut self, bytes: &[u8]) -> Result<(), FmuError>;
}

/// Loads the library of a unit. All its symbols are looked up now: a missing one is an error here, and no end of the program at
/// the first call.
pub(crate) fn load(path: &str, binary: &Path) -> Result<Library, FmuError> {
    let fail = |e: libloading::Error| unlinked(path, &e);
    let bytes = std::fs::read(binary)
        .map_err(|e| FmuError::Library { path: path.into(), reason: format!("{}: {e}", binary.display()) })?;
    if let Some(wanted) = missing(&bytes) {
        let reason = format!("its binary is cut: found {} bytes, expected {wanted}", bytes.len());
        return Err(FmuError::Library { path: path.into(), reason });
    }
    #[cfg(unix)]
    {
        use libloading::os::unix::{Library as Unix, RTLD_GLOBAL, RTLD_LOCAL, RTLD_NOW};
        // Units are often linked without the mathematical functions of C, which other importers happen to have at hand.
        // SAFETY: a library of the system; it stays loaded.
        if let Ok(functions) = unsafe { Unix::open(Some("libm.so.6"), RTLD_NOW | RTLD_GLOBAL) } {
            std::mem::forget(functions);
        }
        // SAFETY: loading runs the library's initialisers; the user named this file as a plant.
        unsafe { Unix::open(Some(binary), RTLD_NOW | RTLD_LOCAL) }.map(Library::from).map_err(fail)
    }
    #[cfg(not(unix))]
    // SAFETY: loading runs the library's initialisers; the user named this file as a plant.
    unsafe { Library::new(binary) }.map_err(fail)
}

/// Bytes that a library for Linux (ELF, 64 bits, little-endian) should have and has not: where its segments end. To load a library
/// that was cut would end the program.
fn missing(bytes: &[u8]) -> Option<u64> {
    let number = |at: usize, n: usize| {
        bytes.get(at..at.checked_add(n)?).map(|b| b.iter().rev().fold(0u64, |a, b| a << 8 | u64::from(*b)))
    };
    if !bytes.starts_with(b"\x7fELF\x02\x01") {
        return None;
    }
    let Some((first, size, count)) =
        number(32, 8).and_then(|f| Some((usize::try_from(f).ok()?, number(54, 2)?, number(56, 2)?)))
    else {
        return Some(64);
    };
    let ends = (0..count as usize).map(|k| {
        let at = first.saturating_add(k * size as usize);
        number(at.saturating_add(8), 8)
            .zip(number(at.saturating_add(32), 8))
            .map_or(u64::MAX, |(o, n)| o.saturating_add(n))
    });
    ends.max().filter(|end| *end > bytes.len() as u64)
}

/// A library or a function that is not there, with what the system says.
pub(crate) fn unlinked(path: &str, e: &libloading::Error) -> FmuError {
    let cause = std::error::Error::source(e).map(|s| format!(": {s}")).unwrap_or_default();
    FmuError::Library { path: path.into(), reason: format!("{e}{cause}") }
}

/// Names of the status codes, which are the same in both versions.
pub(crate) fn check(path: &str, function: &'static str, status: i32) -> Result<(), FmuError> {
    let (status, hint) = match status {
        // OK and warning.
        0 | 1 => return Ok(()),
        2 => ("discard", " (does the step fit the unit's own?)"),
        3 => ("error", ""),
        4 => ("fatal", ""),
        _ => ("an unknown status", ""),
    };
    Err(FmuError::Refused { path: path.into(), function, status, hint })
}
