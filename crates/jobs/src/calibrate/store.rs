//! What a run folder holds: finished steps and files, read back without running anything.

use std::path::{Path, PathBuf};

use crate::calibrate::run::{ChainResult, STEPS};
use crate::calibrate::spec::CalibrateSpec;
use crate::fuelling::stored::FUELLING_FILE;
use dynocal_files::FilesError;
use dynocal_files::json;
use dynocal_files::run_folder::Done;
use serde::de::DeserializeOwned;
use serde::{Deserialize, Serialize};

/// Kind of the run folder: all steps work in the folder of the whole calibration.
pub const KIND: &str = "calibrate";

/// A file of a run and what it is.
#[derive(Clone, Debug, Serialize)]
pub struct RunFile {
    /// Path inside the run folder.
    pub file: String,
    /// What it is.
    pub what: String,
}

/// Folder of step number `k` (from 0).
pub fn step_folder(run: &Path, k: usize) -> PathBuf {
    run.join("steps").join(format!("{:02}-{}", k + 1, STEPS[k]))
}

/// The files of the finished steps and of the run itself.
pub fn files(run: &Path, result: &ChainResult) -> Result<Vec<RunFile>, FilesError> {
    let mut out: Vec<RunFile> = [
        ("summary.json", "results for programs"),
        ("report.html", "this report"),
        ("spec.json", "spec as understood, defaults filled in"),
        ("timing.json", "computing times"),
        ("log.txt", "log"),
    ]
    .map(|(file, what)| RunFile { file: file.into(), what: what.into() })
    .into();
    for (k, step) in STEPS.iter().enumerate().take(finished(result)) {
        let folder = step_folder(run, k);
        let mut names: Vec<String> = std::fs::read_dir(&folder)
            .map_err(|e| FilesError::Read { path: folder.display().to_string(), reason: e.to_string() })?
            .filter_map(Result::ok)
            .filter(|e| e.path().is_file())
            .map(|e| e.file_name().to_string_lossy().into_owned())
            .filter(|n| !n.ends_with(".tmp"))
            .collect();
        names.sort();
        out.extend(names.iter().map(|name| RunFile {
            file: format!("steps/{:02}-{step}/{name}", k + 1),
            what: what(step, name),
        }));
    }
    Ok(out)
}

fn what(step: &str, name: &str) -> String {
    match name {
        "step.json" => format!("result of the step {step}"),
        _ if name.ends_with("_model.json") => {
            format!(
                "chosen {} model (`dynocal identify --model`, `design`, `simulate`)",
                name.trim_end_matches("_model.json")
            )
        }
        "dynamic_map.json" => "the dynamic map that is delivered".into(),
        FUELLING_FILE => "fuel by measured states, which injects in place of the dynamic map".into(),
        "static_map.json" => "static map that it is compared with".into(),
        "design.toml" => "spec of the design (`dynocal design`)".into(),
        _ if name.ends_with(".toml") => "spec of the model (`dynocal identify`)".into(),
        _ if name.ends_with(".plan.csv") || name.ends_with(".plan.json") => "plan for the bed".into(),
        _ if name.ends_with(".csv") => "measured record".into(),
        _ => "file of the step".into(),
    }
}

/// How many steps, from the first, have a result.
pub fn finished(r: &ChainResult) -> usize {
    let have = [
        r.excite.is_some(),
        r.identify.is_some(),
        r.design.is_some(),
        r.optimise.is_some(),
        r.invert.is_some(),
        r.validate.is_some(),
    ];
    have.iter().take_while(|h| **h).count()
}

#[derive(Deserialize)]
struct Marker {
    tool: String,
    kind: String,
}

#[derive(Deserialize)]
struct Step<T> {
    result_digest: String,
    result: T,
}

/// Keys of an earlier summary that are needed to write it again.
#[derive(Deserialize)]
struct Earlier {
    name: String,
    steps: Vec<String>,
}

/// Name, spec and finished steps of a run folder.
pub fn run(path: &Path) -> Result<(String, CalibrateSpec, ChainResult), FilesError> {
    let marker: Marker = json::read(&path.join("run.json"))?;
    if marker.tool != "dynocal" || marker.kind != KIND {
        return Err(FilesError::ForeignFolder {
            path: path.display().to_string(),
            found: format!("a run of `{} {}`", marker.tool, marker.kind),
            expected: KIND.into(),
        });
    }
    let spec: CalibrateSpec = json::read(&path.join("spec.json"))?;
    // The summary says which steps belong to this spec; later folders may be left from another one.
    let earlier: Option<Earlier> = json::read(&path.join("summary.json")).ok();
    let folder = path.file_name().map(|s| s.to_string_lossy().into_owned()).unwrap_or_default();
    let (name, count) = earlier.map_or((folder, STEPS.len()), |e| (e.name, e.steps.len()));
    let result = ChainResult {
        excite: step(path, 0, count)?,
        identify: step(path, 1, count)?,
        design: step(path, 2, count)?,
        optimise: step(path, 3, count)?,
        invert: step(path, 4, count)?,
        validate: step(path, 5, count)?,
    };
    Ok((name, spec, result))
}

/// The result of step `k`; none when it is not finished or not among the first `count`.
fn step<T: DeserializeOwned>(run: &Path, k: usize, count: usize) -> Result<Option<Done<T>>, FilesError> {
    let folder = step_folder(run, k);
    let path = folder.join("step.json");
    if k >= count || !path.exists() {
        return Ok(None);
    }
    let s: Step<T> = json::read(&path)?;
    Ok(Some(Done { result: s.result, digest: s.result_digest, folder, resumed: true }))
}
