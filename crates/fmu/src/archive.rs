//! The archive: what is in it, within bounds, and what of it is unpacked.

use std::fs::File;
use std::io::{BufWriter, Read};
use std::path::Path;

use tempfile::TempDir;
use zip::ZipArchive;

use crate::description::{Description, Version};
use crate::error::FmuError;

/// Most bytes that are unpacked; an archive that holds more is refused before they are written.
const MOST: u64 = 1 << 30;
/// Most bytes of a description.
const MOST_DESCRIPTION: u64 = 64 << 20;
/// Most entries.
const MOST_ENTRIES: usize = 100_000;

fn fault(path: &Path, reason: String) -> FmuError {
    FmuError::Archive { path: path.display().to_string(), reason }
}

/// Opens the archive.
pub(crate) fn open(path: &Path) -> Result<ZipArchive<File>, FmuError> {
    let file = File::open(path).map_err(|e| fault(path, format!("cannot be read: {e}")))?;
    let archive =
        ZipArchive::new(file).map_err(|e| fault(path, format!("is no FMU (a zip archive): {e}")))?;
    match archive.len() {
        n if n > MOST_ENTRIES => {
            Err(fault(path, format!("holds {n} entries, expected at most {MOST_ENTRIES}")))
        }
        _ => Ok(archive),
    }
}

/// Text of `modelDescription.xml`.
pub(crate) fn description(path: &Path, archive: &mut ZipArchive<File>) -> Result<String, FmuError> {
    let fail = |reason: String| fault(path, format!("modelDescription.xml: {reason}"));
    let entry = archive.by_name("modelDescription.xml").map_err(|e| fail(e.to_string()))?;
    let mut bytes = Vec::new();
    entry.take(MOST_DESCRIPTION + 1).read_to_end(&mut bytes).map_err(|e| fail(e.to_string()))?;
    if bytes.len() as u64 > MOST_DESCRIPTION {
        return Err(fail(format!("holds more than {MOST_DESCRIPTION} bytes")));
    }
    String::from_utf8(bytes).map_err(|e| fail(format!("is no UTF-8 text: {e}")))
}

/// Path of the library for this platform.
pub(crate) fn binary_path(about: &Description) -> String {
    let (os, ending) = if cfg!(windows) {
        ("windows", "dll")
    } else if cfg!(target_os = "macos") {
        ("darwin", "dylib")
    } else {
        ("linux", "so")
    };
    let platform = match about.version {
        Version::Two => format!("{}64", if os == "windows" { "win" } else { os }),
        Version::Three => format!("{}-{os}", std::env::consts::ARCH),
    };
    format!("binaries/{platform}/{}.{ending}", about.identifier)
}

/// Unpacks what runs (the folder of the library `wanted`, and resources) into a folder of its own. Entries that would lie
/// outside it are refused.
pub(crate) fn unpack(path: &Path, archive: &mut ZipArchive<File>, wanted: &str) -> Result<TempDir, FmuError> {
    let fail = |reason: String| fault(path, reason);
    if archive.index_for_name(wanted).is_none() {
        return Err(no_binary(path, archive, wanted));
    }
    let library = wanted.rsplit_once('/').map_or(wanted, |p| p.0);
    let folder = tempfile::tempdir().map_err(|e| fail(format!("cannot be unpacked: {e}")))?;
    let mut left = MOST;
    for k in 0..archive.len() {
        let mut entry = archive.by_index(k).map_err(|e| fail(format!("entry {k}: {e}")))?;
        let name = entry.name().map_or_else(|_| format!("entry {k}"), |n| n.into_owned());
        let inner = entry
            .enclosed_name()
            .ok_or_else(|| fail(format!("the entry `{name}` would lie outside the archive")))?;
        if entry.is_dir() || !(inner.starts_with(library) || inner.starts_with("resources")) {
            continue;
        }
        let too_much = || fail(format!("`{name}`: the archive unpacks to more than {MOST} bytes"));
        // The size that an entry states is refused at once; one that it does not state, while it grows.
        if entry.size() > left {
            return Err(too_much());
        }
        let to = folder.path().join(inner);
        let done = to.parent().map_or(Ok(()), std::fs::create_dir_all).and_then(|()| {
            let mut out = BufWriter::new(File::create(&to)?);
            std::io::copy(&mut entry.by_ref().take(left + 1), &mut out)
        });
        let n = done.map_err(|e| fail(format!("`{name}`: {e}")))?;
        left = left.checked_sub(n).ok_or_else(too_much)?;
    }
    Ok(folder)
}

fn no_binary(path: &Path, archive: &ZipArchive<File>, wanted: &str) -> FmuError {
    let mut found: Vec<String> = archive
        .file_names()
        .filter_map(|n| n.ok().map(|n| n.to_string()))
        .filter(|n| n.starts_with("binaries/") && !n.ends_with('/'))
        .take(20)
        .collect();
    found.sort();
    let found =
        if found.is_empty() { "none (sources only: compile it first)".into() } else { found.join(", ") };
    FmuError::NoBinary { path: path.display().to_string(), wanted: wanted.into(), found }
}
