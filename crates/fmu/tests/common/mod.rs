//! Units of the tests.

#![allow(dead_code)] // no test uses all of it

use std::io::{Cursor, Read, Write};
use std::path::{Path, PathBuf};
use std::process::Command;

use zip::write::SimpleFileOptions;

pub(crate) type Entry = (String, Vec<u8>);

/// Packs the reference's sources and compiles them with FMPy; says SKIPPED where either is missing.
pub(crate) fn made(folder: &Path) -> Option<Vec<PathBuf>> {
    let Ok(reference) = std::env::var("DYNOCAL_REFERENCE_DIR") else {
        println!("SKIPPED: DYNOCAL_REFERENCE_DIR is not set");
        return None;
    };
    let target = std::env::var_os("CARGO_TARGET_DIR")
        .map_or_else(|| Path::new(env!("CARGO_MANIFEST_DIR")).join("../../target"), PathBuf::from);
    let python = std::env::var_os("DYNOCAL_READERS_PYTHON")
        .map_or_else(|| target.join("readers/bin/python"), PathBuf::from);
    if !Command::new(&python).args(["-c", "import fmpy"]).output().is_ok_and(|o| o.status.success()) {
        println!("SKIPPED READER: no Python with fmpy (run scripts/readers.sh)");
        return None;
    }
    // The script runs in its own folder, where a relative path would lead nowhere.
    let tools = std::fs::canonicalize(python.parent()?).ok()?;
    // FMPy brings the CMake that it compiles with.
    let path = format!("{}:{}", tools.display(), std::env::var("PATH").unwrap_or_default());
    let done = Command::new(tools.join("python"))
        .env("PATH", path)
        .current_dir(Path::new(&reference).join("formats/fmu"))
        .arg("make_fmu.py")
        .arg(folder)
        .output()
        .unwrap();
    assert!(done.status.success(), "{}", String::from_utf8_lossy(&done.stderr));
    Some(["InjMap_fmi2.fmu", "InjMap_fmi3.fmu"].map(|n| folder.join(n)).to_vec())
}

/// Files of an archive.
pub(crate) fn entries(path: &Path) -> Vec<Entry> {
    let mut archive = zip::ZipArchive::new(std::fs::File::open(path).unwrap()).unwrap();
    (0..archive.len())
        .map(|k| {
            let mut entry = archive.by_index(k).unwrap();
            let mut bytes = Vec::new();
            entry.read_to_end(&mut bytes).unwrap();
            (entry.name().unwrap().to_string(), bytes)
        })
        .filter(|(name, _)| !name.ends_with('/'))
        .collect()
}

/// An archive of entries.
pub(crate) fn pack(entries: &[Entry]) -> Vec<u8> {
    let mut zip = zip::ZipWriter::new(Cursor::new(Vec::new()));
    for (name, bytes) in entries {
        zip.start_file(name.as_str(), SimpleFileOptions::default()).unwrap();
        zip.write_all(bytes).unwrap();
    }
    zip.finish().unwrap().into_inner()
}
