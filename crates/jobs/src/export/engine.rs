//! The plant of a spec as an FMU: the virtual engine on its bed, or a published model.
//!
//! The binary is the library `dynocal_engine_fmu`, which is built with the program and stands beside it; no compiler is asked.

use std::path::{Path, PathBuf};

use dynocal_engine_fmu::description::{IDENTIFIER, TOKEN, xml};
use dynocal_engine_fmu::engine::{Engine, PARAMETERS, PLANT, Setup};
use dynocal_export::format::OutFile;
use dynocal_export::format::fmu::{Version, archive, binary_path};
use dynocal_plant::plants::PlantSpec;
use serde::Deserialize;

use super::{ExportJobError, read};

/// Step that the FMU proposes where the spec has no `sample_time_s`, in s: that of the campaigns.
const STEP_S: f64 = 0.03;

/// What of a spec matters here; its other tables are left alone.
#[derive(Deserialize)]
struct Part {
    plant: Option<PlantSpec>,
    sample_time_s: Option<f64>,
}

/// FMUs of the plant of the spec `source` (as written, or as a run keeps it; the virtual engine where it names none) in the
/// formats `to`, which are `fmu2` and `fmu3`; `library` where it does not stand beside the program.
///
/// # Errors
/// [`ExportJobError`]: a spec whose plant cannot leave, a format that holds no plant, a library that is not there or another's.
pub(super) fn of_spec(
    source: &Path,
    to: &[String],
    library: Option<&Path>,
) -> Result<Vec<OutFile>, ExportJobError> {
    let fail = |reason: String| ExportJobError::source(source, reason);
    let text = String::from_utf8(read(source)?).map_err(|e| fail(e.to_string()))?;
    let part: Part = match source.extension().is_some_and(|e| e == "json") {
        true => serde_json::from_str(&text).map_err(|e| fail(e.to_string()))?,
        false => toml::from_str(&text).map_err(|e| fail(e.to_string()))?,
    };
    let plant = part.plant.unwrap_or_default();
    let versions = to.iter().map(|name| match name.as_str() {
        "fmu2" => Ok(Version::Two),
        "fmu3" => Ok(Version::Three),
        other => Err(fail(format!(
            "found the format `{other}`, expected `fmu2` or `fmu3`: a plant leaves as an FMU"
        ))),
    });
    let versions = versions.collect::<Result<Vec<_>, _>>()?;
    if plant.name == "fmu" {
        return Err(fail("found a plant that is an FMU already".into()));
    }
    let engine = Setup::new(plant.clone()).and_then(Engine::new).map_err(&fail)?;
    let binary = binary(library).map_err(&fail)?;
    let step_s = part.sample_time_s.filter(|s| s.is_finite() && *s > 0.0).unwrap_or(STEP_S);
    let mut resources = vec![(
        format!("resources/{PLANT}"),
        toml::to_string(&plant).map_err(|e| fail(e.to_string()))?.into_bytes(),
    )];
    if plant.parameters.ends_with(".toml") {
        resources.push((format!("resources/{PARAMETERS}"), read(Path::new(&plant.parameters))?));
    }
    let about = format!(
        "{} with parameters {}; exported by dynocal {} from {}",
        plant.name,
        plant.parameters,
        env!("CARGO_PKG_VERSION"),
        source.file_name().map(|n| n.to_string_lossy()).unwrap_or_default()
    );
    let pack = |version: &Version| {
        let (number, ending) = if *version == Version::Two { (2, "fmi2") } else { (3, "fmi3") };
        let mut files = vec![
            ("modelDescription.xml".to_string(), xml(&engine, number, &about, step_s).into_bytes()),
            (binary_path(IDENTIFIER, *version), binary.clone()),
        ];
        files.extend(resources.iter().cloned());
        Ok(OutFile { name: format!("{IDENTIFIER}_{ending}.fmu"), bytes: archive(&files)? })
    };
    versions.iter().map(pack).collect()
}

/// Name of the library on this system.
fn library_name() -> String {
    format!("{}dynocal_engine_fmu{}", std::env::consts::DLL_PREFIX, std::env::consts::DLL_SUFFIX)
}

/// The library: beside the program, in `deps` below it (where cargo leaves it), or in `../lib`.
fn binary(library: Option<&Path>) -> Result<Vec<u8>, String> {
    let program = std::env::current_exe().map_err(|e| format!("the place of the program is unknown: {e}"))?;
    let folder = program.parent().unwrap_or(Path::new("."));
    let places: Vec<PathBuf> = match library {
        Some(path) => vec![path.to_path_buf()],
        None => ["", "deps", "../lib"].iter().map(|p| folder.join(p).join(library_name())).collect(),
    };
    let Some(found) = places.iter().find(|p| p.is_file()) else {
        let list: Vec<String> = places.iter().map(|p| p.display().to_string()).collect();
        return Err(format!(
            "found no library of the engine at {}; it is built with the program (cargo build --release), and `--library` names it",
            list.join(", ")
        ));
    };
    let bytes = std::fs::read(found).map_err(|e| format!("{}: {e}", found.display()))?;
    if !bytes.windows(TOKEN.len()).any(|w| w == TOKEN.as_bytes()) {
        return Err(format!(
            "{}: found no {TOKEN} in it, expected the library of this version",
            found.display()
        ));
    }
    Ok(bytes)
}
