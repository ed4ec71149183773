//! What leaves the house: maps and models in the formats of the neighbours.
//!
//! A source is a run folder of `calibrate` (its maps) or of `identify` (its models), one of their files, or a file in a
//! neutral or foreign form (`.json`, `.dcm`, `.cdfx`, `.csv`). It becomes a [`Package`], and a row of the table of exports
//! writes it. A spec (`.toml`) is a source too: its plant leaves as an FMU.

mod build;
mod controller;
mod dynamic_map;
mod engine;
mod fuelling;
mod lead_lag;
mod model;
mod origin;
mod oxygen;
mod response;
mod static_map;

use std::path::{Path, PathBuf};

use dynocal_calib::map::MapForm;
use dynocal_calib::map::structures::StoredMap;
use dynocal_control::stored::{CONTROLLER_SCHEMA, CONTROLLER_VERSION, StoredController};
use dynocal_export::ExportError;
use dynocal_export::characteristic::Characteristic;
use dynocal_export::format::{self, Keys, OutFile};
use dynocal_export::package::Package;
use dynocal_files::{FilesError, atomic, json};
use dynocal_ident::stored::{MODEL_SCHEMA, MODEL_VERSION, StoredError, StoredModel};
use serde::Serialize;
use serde_json::Value;

use crate::export_spec::UNITS;
pub use crate::export_spec::{ExportKeys, ExportSpec};
use crate::fuelling::stored::{FUELLING_FILE, FUELLING_SCHEMA, FUELLING_VERSION, StoredFuelling};
pub use controller::controller;
pub use dynamic_map::dynamic_map;
pub use lead_lag::lead_lag;
pub use model::model;
pub use static_map::static_map;

use origin::Origin;

/// Why nothing left.
#[derive(Debug, thiserror::Error)]
pub enum ExportJobError {
    /// A file.
    #[error(transparent)]
    Files(#[from] FilesError),
    /// A form or format.
    #[error(transparent)]
    Export(#[from] ExportError),
    /// A stored model that cannot be used so.
    #[error("{path}: {source}")]
    Model {
        /// File.
        path: String,
        /// Why.
        source: StoredError,
    },
    /// The source is nothing that can be exported.
    #[error("{path}: {reason}")]
    Source {
        /// What was given.
        path: String,
        /// Found and expected.
        reason: String,
    },
}

impl ExportJobError {
    fn source(path: &Path, reason: impl Into<String>) -> Self {
        Self::Source { path: path.display().to_string(), reason: reason.into() }
    }
}

/// What was written.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct Exported {
    /// Files.
    pub files: Vec<PathBuf>,
    /// What the user should know.
    pub notes: Vec<String>,
}

/// A package with what was decided or lost while it was made.
#[derive(Clone, Debug, PartialEq)]
pub struct Made {
    /// Package.
    pub package: Package,
    /// Sentences.
    pub notes: Vec<String>,
}

/// Exports `source` into `folder`.
///
/// # Errors
/// [`ExportJobError`]; nothing is written unless something fits every format that was asked for.
pub fn run(source: &Path, folder: &Path, spec: &ExportSpec) -> Result<Exported, ExportJobError> {
    let mut out = Exported::default();
    if source.extension().is_some_and(|e| e == "toml") {
        write_all(engine::of_spec(source, &spec.to, spec.library.as_deref())?, folder, &mut out)?;
        return Ok(out);
    }
    let mut made = packages(source, spec)?;
    for m in &mut made {
        m.package.extrapolation = spec.extrapolation;
        if let Some(path) = &spec.a2l {
            let entries = dynocal_export::format::a2l::read(&path.display().to_string(), &read(path)?)?;
            m.notes.extend(dynocal_export::format::a2l::adopt(&mut m.package, &entries));
        }
        out.notes.append(&mut m.notes);
    }
    let mut ready: Vec<OutFile> = Vec::new();
    for name in &spec.to {
        let (files, left_out) = written(&made, name, &spec.keys)?;
        if files.is_empty() {
            return Err(ExportJobError::source(source, left_out.join("; ")));
        }
        ready.extend(files);
        out.notes.extend(left_out);
    }
    write_all(ready, folder, &mut out)?;
    Ok(out)
}

fn write_all(files: Vec<OutFile>, folder: &Path, out: &mut Exported) -> Result<(), ExportJobError> {
    for file in files {
        let path = folder.join(&file.name);
        atomic::write(&path, &file.bytes)?;
        out.files.push(path);
    }
    Ok(())
}

/// The characteristics of a source (a run of `calibrate`, or a map file), and what was said while they were read.
///
/// # Errors
/// [`ExportJobError`].
pub fn characteristics(source: &Path) -> Result<(Vec<Characteristic>, Vec<String>), ExportJobError> {
    let (mut all, mut notes) = (Vec::new(), Vec::new());
    for made in packages(source, &ExportSpec::default())? {
        all.extend(made.package.characteristics);
        notes.extend(made.notes);
    }
    if all.is_empty() {
        return Err(ExportJobError::source(source, "found no curve, map or scalar, expected at least one"));
    }
    Ok((all, notes))
}

/// Folder of the files of `[export]` in a run folder.
pub const FOLDER: &str = "export";

/// Exports what the run in `folder` found into its folder [`FOLDER`].
///
/// # Errors
/// As [`run`].
pub fn of_run(folder: &Path, spec: &ExportSpec) -> Result<Exported, ExportJobError> {
    let to = folder.join(FOLDER);
    let mut out = run(folder, &to, spec)?;
    if spec.engine {
        let units: Vec<String> = spec.to.iter().filter(|n| UNITS.contains(&n.as_str())).cloned().collect();
        let files = engine::of_spec(&folder.join("spec.json"), &units, spec.library.as_deref())?;
        write_all(files, &to, &mut out)?;
    }
    Ok(out)
}

/// The files of one format, and what it could not hold: a run has several maps, and not every format holds each.
fn written(made: &[Made], name: &str, keys: &Keys) -> Result<(Vec<OutFile>, Vec<String>), ExportJobError> {
    let (mut files, mut left_out) = (Vec::new(), Vec::new());
    for m in made {
        match format::write(&m.package, name, keys) {
            Ok(more) => files.extend(more),
            Err(e @ ExportError::Unfit { .. }) => left_out.push(e.to_string()),
            Err(e) => return Err(e.into()),
        }
    }
    Ok((files, left_out))
}

fn read(path: &Path) -> Result<Vec<u8>, FilesError> {
    std::fs::read(path).map_err(|e| FilesError::unread(path, &e))
}

/// The packages of a source.
fn packages(source: &Path, spec: &ExportSpec) -> Result<Vec<Made>, ExportJobError> {
    if !source.is_dir() {
        return Ok(vec![of_file(source, spec)?]);
    }
    let controller = source.join("controller.json");
    if controller.is_file() {
        return Ok(vec![of_file(&controller, spec)?]);
    }
    let mut found: Vec<PathBuf> = Vec::new();
    let steps = source.join("steps");
    let entries = |f: &Path| std::fs::read_dir(f).into_iter().flatten().flatten().map(|e| e.path());
    let of_run = finished_steps(source);
    for step in entries(&steps).filter(|p| p.is_dir() && of_run.as_ref().is_none_or(|names| of(p, names))) {
        found.extend(entries(&step).filter(|p| p.is_file() && wanted(p)));
    }
    found.sort();
    // The maps are what a calibration is for; its models are named by file.
    if found.iter().any(|p| is_map(p)) {
        found.retain(|p| is_map(p));
    }
    if found.is_empty() {
        let reason = "found no map and no model in its steps and no controller: expected a finished run of `dynocal \
                      calibrate`, `dynocal map`, `dynocal identify` or `dynocal control` (sampled loops without a decoupler), or a file";
        return Err(ExportJobError::source(source, reason));
    }
    found.iter().map(|p| of_file(p, spec)).collect()
}

/// Names of the steps that belong to a run, by its summary: folders of others are left from an earlier spec. None where it does not say.
fn finished_steps(run: &Path) -> Option<Vec<String>> {
    let summary: Value = serde_json::from_slice(&std::fs::read(run.join("summary.json")).ok()?).ok()?;
    Some(summary.get("steps")?.as_array()?.iter().filter_map(|s| s.as_str().map(str::to_string)).collect())
}

/// Whether the folder `NN-NAME` is of one of the steps.
fn of(folder: &Path, names: &[String]) -> bool {
    let name = file_name(folder);
    names.iter().any(|n| name.split_once('-').is_some_and(|(_, step)| step == n))
}

fn file_name(path: &Path) -> String {
    path.file_name().map(|n| n.to_string_lossy().into_owned()).unwrap_or_default()
}

/// What a calibration delivers: its maps, and what injects in place of them.
fn is_map(path: &Path) -> bool {
    ["static_map.json", "dynamic_map.json", FUELLING_FILE].contains(&file_name(path).as_str())
}

/// `model.json`, or `NAME_model.json` and `model_NAME.json` where there are several.
fn wanted(path: &Path) -> bool {
    let name = file_name(path);
    let model =
        name.strip_suffix(".json").is_some_and(|stem| stem.starts_with("model") || stem.ends_with("_model"));
    is_map(path) || (model && schema(path).is_some_and(|s| s == MODEL_SCHEMA))
}

fn schema(path: &Path) -> Option<String> {
    let value: Value = serde_json::from_slice(&std::fs::read(path).ok()?).ok()?;
    Some(value.get("schema")?.as_str()?.to_string())
}

/// A file of any kind.
fn of_file(path: &Path, spec: &ExportSpec) -> Result<Made, ExportJobError> {
    let bytes = read(path)?;
    let origin = Origin::of(path, &bytes);
    let json = path.extension().is_some_and(|e| e == "json");
    let kind = if json { schema(path).unwrap_or_default() } else { String::new() };
    let mut made = match kind.as_str() {
        MODEL_SCHEMA => {
            let stored: StoredModel = json::read_versioned(path, MODEL_SCHEMA, MODEL_VERSION)?;
            model(&stored).map_err(|e| e.at(path))?
        }
        CONTROLLER_SCHEMA => {
            let stored: StoredController = json::read_versioned(path, CONTROLLER_SCHEMA, CONTROLLER_VERSION)?;
            stored.check().map_err(|e| ExportJobError::source(path, e.to_string()))?;
            controller(&stored)
        }
        FUELLING_SCHEMA => {
            let stored: StoredFuelling = json::read_versioned(path, FUELLING_SCHEMA, FUELLING_VERSION)?;
            if !stored.valid {
                return Err(ExportJobError::source(
                    path,
                    "found a model that must not be used (`valid` is false): its report says why",
                ));
            }
            stored.check().map_err(|e| ExportJobError::source(path, e))?;
            fuelling::fuelling(&stored)
        }
        "dynocal/static-map" => {
            let map = json::read_versioned(path, "dynocal/static-map", 2)?;
            static_map(&map, spec.sample_time_s.or(origin.sample_time_s))
        }
        "dynocal/dynamic-map" => {
            let map: StoredMap = json::read_versioned(path, "dynocal/dynamic-map", 3)?;
            let dt = spec.sample_time_s.or(origin.sample_time_s).ok_or_else(|| {
                ExportJobError::source(
                    path,
                    "found no run with its sample time, expected one around it (or --sample-time-s)",
                )
            })?;
            match map.form() {
                MapForm::Terms(terms) => dynamic_map(terms, dt),
                MapForm::Tables(tables) => lead_lag(tables, dt),
                MapForm::Other => {
                    let reason = format!(
                        "found a map of the structure `{}`, expected one that is made of terms or tables",
                        map.structure()
                    );
                    return Err(ExportJobError::source(path, reason));
                }
            }
        }
        _ => {
            let package = format::read(&path.display().to_string(), &bytes)?;
            let notes = package.left_out.iter().map(|l| format!("left out {l}")).collect();
            Made { package, notes }
        }
    };
    let validity = std::mem::take(&mut made.package.provenance.validity);
    if made.package.provenance.version.is_empty() {
        made.package.provenance = origin.provenance(validity);
    } else {
        made.package.provenance.validity = validity;
    }
    made.package.check()?;
    Ok(made)
}
