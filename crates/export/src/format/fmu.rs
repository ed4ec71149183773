//! FMU 2.0 and 3.0 for co-simulation: the generated C with a wrapper, its description, and a binary where a C compiler is
//! at hand.
//!
//! Inputs that are set at a communication point act on the step from there; outputs show it at its end, so nothing feeds
//! through within a point. A communication step is a whole number of samples.

use std::io::{Cursor, Write};
use std::path::Path;
use std::process::Command;

use dynocal_numerics::registry::MemberDoc;
use zip::write::SimpleFileOptions;

use crate::characteristic::identifier;
use crate::error::ExportError;
use crate::format::c;
use crate::format::fmu_xml;
use crate::format::{Export, Holds, Keys, OutFile, Precision};
use crate::package::Package;
use crate::program::Program;

/// Row of the table of exports.
pub const FMU2: Export = Export {
    doc: MemberDoc { name: "fmu2", what: "FMU 2.0, co-simulation, sources and binary", params: &[] },
    holds: &[Holds::Programs],
    ecu_names: false,
    write: |package, _| pack(package, Version::Two),
    read: None,
};

/// Row of the table of exports.
pub const FMU3: Export = Export {
    doc: MemberDoc { name: "fmu3", what: "FMU 3.0, co-simulation, sources and binary", params: &[] },
    holds: &[Holds::Programs],
    ecu_names: false,
    write: |package, _| pack(package, Version::Three),
    read: None,
};

/// Version of the standard.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Version {
    /// FMI 2.0.
    Two,
    /// FMI 3.0.
    Three,
}

/// Types, what the binary of an FMU exports, and functions outside the capabilities.
const PARTS_2: [&str; 3] = [
    include_str!("fmi/fmi2_types.h"),
    include_str!("fmi/fmi2_wrapper.c"),
    include_str!("fmi/fmi2_outside.c"),
];
const PARTS_3: [&str; 3] = [
    include_str!("fmi/fmi3_types.h"),
    include_str!("fmi/fmi3_wrapper.c"),
    include_str!("fmi/fmi3_outside.c"),
];

fn pack(package: &Package, version: Version) -> Result<Vec<OutFile>, ExportError> {
    let program =
        package.program.as_ref().ok_or_else(|| ExportError::form(&package.name, "found no program"))?;
    let name = identifier(&package.name);
    let mut sources = c::sources(package, &Keys { precision: Precision::Double })?;
    let token = token(&sources, version);
    sources
        .push(OutFile { name: "fmu.c".into(), bytes: wrapper(program, &name, &token, version).into_bytes() });
    let mut files =
        vec![("modelDescription.xml".to_string(), fmu_xml::description(package, program, &token, version))];
    if version == Version::Three {
        files.push(("sources/buildDescription.xml".into(), fmu_xml::build(&name)));
    }
    let mut files: Vec<(String, Vec<u8>)> = files.into_iter().map(|(n, t)| (n, t.into_bytes())).collect();
    if let Some(binary) = compile(&sources)? {
        files.push((binary_path(&name, version), binary));
    }
    files.extend(sources.into_iter().map(|s| (format!("sources/{}", s.name), s.bytes)));
    let ending = if version == Version::Two { "fmi2" } else { "fmi3" };
    Ok(vec![OutFile { name: format!("{name}_{ending}.fmu"), bytes: archive(&files)? }])
}

/// Path of a binary inside an FMU on this platform.
pub fn binary_path(name: &str, version: Version) -> String {
    let (os, ending) = if cfg!(windows) {
        ("windows", "dll")
    } else if cfg!(target_os = "macos") {
        ("darwin", "dylib")
    } else {
        ("linux", "so")
    };
    let folder = match version {
        Version::Two if os == "linux" => "linux64".to_string(),
        Version::Two if os == "windows" => "win64".into(),
        Version::Two => "darwin64".into(),
        Version::Three => format!("{}-{os}", std::env::consts::ARCH),
    };
    format!("binaries/{folder}/{name}.{ending}")
}

/// A zip archive; without a clock, so that equal files give equal bytes.
///
/// # Errors
/// [`ExportError::Tool`].
pub fn archive(files: &[(String, Vec<u8>)]) -> Result<Vec<u8>, ExportError> {
    let fail = |e: String| ExportError::Tool(format!("cannot pack the FMU: {e}"));
    let mut zip = zip::ZipWriter::new(Cursor::new(Vec::new()));
    let options = SimpleFileOptions::default()
        .compression_method(zip::CompressionMethod::Deflated)
        .last_modified_time(zip::DateTime::default());
    for (name, bytes) in files {
        zip.start_file(name.as_str(), options).map_err(|e| fail(e.to_string()))?;
        zip.write_all(bytes).map_err(|e| fail(e.to_string()))?;
    }
    Ok(zip.finish().map_err(|e| fail(e.to_string()))?.into_inner())
}

/// An identifier that changes with the code: two 64-bit FNV-1a digests in the form of a UUID.
fn token(sources: &[OutFile], version: Version) -> String {
    let digest = |start: u64| {
        let step = |h: u64, b: &u8| (h ^ u64::from(*b)).wrapping_mul(0x0100_0000_01b3);
        sources.iter().flat_map(|s| &s.bytes).fold(start, step)
    };
    let a = digest(0xcbf2_9ce4_8422_2325);
    let b = digest(a ^ if version == Version::Two { 2 } else { 3 });
    format!(
        "{{{:08x}-{:04x}-{:04x}-{:04x}-{:012x}}}",
        a >> 32,
        (a >> 16) & 0xffff,
        a & 0xffff,
        b >> 48,
        b & 0xffff_ffff_ffff
    )
}

fn wrapper(p: &Program, name: &str, token: &str, version: Version) -> String {
    let [types, body, outside] = if version == Version::Two { PARTS_2 } else { PARTS_3 };
    let starts: Vec<String> = p.inputs.iter().map(|i| format!("{:?}", i.start)).collect();
    let starts = if starts.is_empty() { "0.0".to_string() } else { starts.join(", ") };
    let body = body
        .replace("P_state_T", &format!("{name}_state_T"))
        .replace("P_init", &format!("{name}_init"))
        .replace("P_step", &format!("{name}_step"));
    format!(
        "{types}#include \"{name}.h\"\n\n#define GUID \"{token}\"\n#define INPUTS ({}U)\n#define N_IN ({}U)\n#define N_OUT ({}U)\n\
#define SAMPLE_TIME ({:?})\n#define START_VALUES {{ {starts} }}\n\n{body}{outside}",
        p.inputs.len(),
        p.inputs.len().max(1),
        p.outputs.len().max(1),
        p.sample_time_s,
    )
}

/// A shared library of the sources; `None` where there is no C compiler (the FMU then holds sources only).
fn compile(sources: &[OutFile]) -> Result<Option<Vec<u8>>, ExportError> {
    let fail = |e: std::io::Error| ExportError::Tool(format!("cannot compile the FMU: {e}"));
    let folder = tempfile::tempdir().map_err(fail)?;
    for s in sources {
        dynocal_files::atomic::write(&folder.path().join(&s.name), &s.bytes)
            .map_err(|e| ExportError::Tool(format!("cannot compile the FMU: {e}")))?;
    }
    let library = folder.path().join("fmu.so");
    let compiler = std::env::var("CC").unwrap_or_else(|_| "cc".into());
    let mut command = Command::new(&compiler);
    command
        .current_dir(folder.path())
        .args(["-std=c99", "-O2", "-fPIC", "-shared", "-ffp-contract=off", "-o"])
        .arg(&library);
    command.args(sources.iter().filter(|s| has_ending(&s.name, "c")).map(|s| s.name.as_str())).arg("-lm");
    let Ok(done) = command.output() else { return Ok(None) };
    if !done.status.success() {
        let said = String::from_utf8_lossy(&done.stderr).into_owned();
        return Err(ExportError::Tool(format!("{compiler} does not compile the FMU: {said}")));
    }
    std::fs::read(&library).map(Some).map_err(fail)
}

fn has_ending(name: &str, ending: &str) -> bool {
    Path::new(name).extension().is_some_and(|e| e == ending)
}
