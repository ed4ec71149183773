//! The jobs of the program: the same spec gives the same files.

use std::ffi::OsString;
use std::path::PathBuf;

use dynocal_export::format::{Keys, Precision};
use dynocal_export::package::Extrapolation;
use dynocal_jobs::export::{self as exporting, ExportSpec};
use dynocal_jobs::place::Overrides;
use dynocal_jobs::runs::{Asked, Ended, Spec, find};
use dynocal_numerics::watch::Watch;
use dynocal_studies as studies;
use pyo3::prelude::*;

use crate::errors::{Kind, Refusal, run as failed};
use crate::values::table;
use crate::watched::{ready, watched};

/// A finished run.
#[pyclass(frozen, get_all, module = "dynocal._dynocal")]
pub(crate) struct Finished {
    /// Run folder.
    folder: PathBuf,
    /// False when the result must not be used as it is.
    valid: bool,
    /// Sentences.
    warnings: Vec<String>,
    /// Why the job waits for a bed; none where it is done.
    waiting: Option<String>,
}

impl From<Ended> for Finished {
    fn from(e: Ended) -> Self {
        Self { folder: e.folder, valid: e.valid, warnings: e.warnings, waiting: e.waiting }
    }
}

fn asked(
    spec: &Bound<'_, PyAny>,
    name: String,
    seed: Option<u64>,
    out: Option<PathBuf>,
    data: Vec<PathBuf>,
    until: Option<String>,
) -> PyResult<Asked> {
    let spec = match spec.extract::<PathBuf>() {
        Ok(path) => Spec::File(path),
        Err(_) => {
            let text = toml::to_string(&table(spec, "")?).map_err(|e| Refusal::of(Kind::Spec, &e))?;
            Spec::Text { name: format!("{name}.toml"), text }
        }
    };
    Ok(Asked { spec, over: Overrides { seed, out }, data, until })
}

/// What a mapping is called in messages: it has no file.
fn named(spec: &Bound<'_, PyAny>, name: &str) -> (String, String) {
    let is_file = spec.extract::<PathBuf>().is_ok();
    let file = format!("{name}.toml");
    let called = if is_file { file.clone() } else { format!("the spec `{name}`") };
    (file, called)
}

/// Runs a job; `spec` is a file, or a mapping whose files are relative to the working folder.
#[pyfunction]
pub(crate) fn run(
    py: Python<'_>,
    job: &str,
    spec: &Bound<'_, PyAny>,
    name: String,
    seed: Option<u64>,
    out: Option<PathBuf>,
    data: Vec<PathBuf>,
    until: Option<String>,
    progress: Option<Py<PyAny>>,
) -> PyResult<Finished> {
    let verb = find(job).map_err(Refusal::from)?;
    let (file, called) = named(spec, &name);
    let asked = asked(spec, name, seed, out, data, until)?;
    let done = watched(py, progress, move |watch| (verb.run)(&asked, watch))?;
    Ok(done.map_err(|e| Refusal::from(e).instead(&file, &called))?.into())
}

/// What a job would do and take, as JSON; runs nothing.
#[pyfunction]
pub(crate) fn check(
    py: Python<'_>,
    job: &str,
    spec: &Bound<'_, PyAny>,
    name: String,
    seed: Option<u64>,
    out: Option<PathBuf>,
    data: Vec<PathBuf>,
) -> PyResult<String> {
    let verb = find(job).map_err(Refusal::from)?;
    let (file, called) = named(spec, &name);
    let asked = asked(spec, name, seed, out, data, None)?;
    let plan = watched(py, None, move |watch| (verb.plan)(&asked, watch))?
        .map_err(|e| Refusal::from(e).instead(&file, &called))?;
    plan.allowed().map_err(failed)?;
    Ok(serde_json::to_string(&plan).map_err(failed)?)
}

/// Runs a study of the program.
#[pyfunction]
pub(crate) fn study(
    py: Python<'_>,
    name: &str,
    seed: u64,
    quick: bool,
    out: PathBuf,
    reference: Option<PathBuf>,
    data: Option<PathBuf>,
    progress: Option<Py<PyAny>>,
) -> PyResult<Finished> {
    let study = studies::find(name).ok_or_else(|| {
        let known: Vec<&str> = studies::STUDIES.iter().map(|s| s.doc.name).collect();
        Refusal::new(
            Kind::Argument,
            format!("found the study `{name}`, expected one of {}", known.join(", ")),
        )
    })?;
    let options = studies::Options { seed, reduced: quick, reference, data };
    let work = move |watch: Watch| {
        let done = studies::run(study, &options, &out, watch).map_err(failed)?;
        let valid = studies::all_hold(&done.checks);
        Ok::<_, Refusal>(Finished { folder: out, valid, warnings: Vec::new(), waiting: None })
    };
    Ok(watched(py, progress, work)??)
}

/// Writes what a run found, or a map or model file, in formats of the neighbours: files and notes.
#[pyfunction]
pub(crate) fn export(
    py: Python<'_>,
    source: PathBuf,
    to: Vec<String>,
    folder: PathBuf,
    double: bool,
    linear: bool,
    sample_time_s: Option<f64>,
) -> PyResult<(Vec<PathBuf>, Vec<String>)> {
    let spec = ExportSpec {
        to,
        keys: Keys { precision: if double { Precision::Double } else { Precision::Float } },
        extrapolation: if linear { Extrapolation::Linear } else { Extrapolation::Clip },
        sample_time_s,
        ..ExportSpec::default()
    };
    let done = watched(py, None, move |_| exporting::run(&source, &folder, &spec))?.map_err(Refusal::from)?;
    Ok((done.files, done.notes))
}

/// The program: its arguments, the first being its name, and its exit code.
#[pyfunction]
pub(crate) fn program(py: Python<'_>, arguments: Vec<OsString>) -> PyResult<u8> {
    ready()?;
    Ok(py.detach(|| dynocal_cli::run(arguments)))
}
