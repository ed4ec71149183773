//! The jobs of the program: the same spec gives the same files.

use std::ffi::OsString;
use std::path::{Path, PathBuf};

use dynocal_export::format::{Keys, Precision};
use dynocal_export::package::Extrapolation;
use dynocal_jobs::estimate::Estimate;
use dynocal_jobs::export::{self as exporting, ExportSpec};
use dynocal_jobs::place::Overrides;
use dynocal_jobs::{calibrate, design, identify, map, optimise, sequential, signal, simulate};
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

impl Finished {
    fn new(folder: &Path, valid: bool, warnings: &[String]) -> Self {
        Self { folder: folder.into(), valid, warnings: warnings.to_vec(), waiting: None }
    }

    fn waiting(folder: &Path, why: String) -> Self {
        Self { folder: folder.into(), valid: false, warnings: Vec::new(), waiting: Some(why) }
    }
}

/// The spec of a job.
enum Spec {
    File(PathBuf),
    /// Name for messages and text.
    Text(String, String),
}

/// What is asked of a job.
struct Asked {
    spec: Spec,
    over: Overrides,
    data: Vec<PathBuf>,
    until: Option<String>,
}

/// Reads a job from its file or its text.
macro_rules! job {
    ($asked:expr, $module:path, $over:expr) => {{
        use $module as module;
        match &$asked.spec {
            Spec::File(path) => module::read(path, $over)?,
            Spec::Text(name, text) => module::parse(name, text, $over)?,
        }
    }};
}

impl Asked {
    fn identify(&self) -> Result<identify::spec::Job, Refusal> {
        let over = identify::spec::Overrides {
            data: self.data.clone(),
            seed: self.over.seed,
            out: self.over.out.clone(),
            reference: None,
        };
        Ok(job!(self, identify::spec, &over))
    }

    fn campaign(&self) -> Result<calibrate::job::Campaign, Refusal> {
        let (seed, out) = (self.over.seed, self.over.out.as_deref());
        Ok(match &self.spec {
            Spec::File(path) => calibrate::job::read(path, seed, out)?,
            Spec::Text(name, text) => calibrate::job::parse(name, text, seed, out)?,
        })
    }
}

/// A job of the program.
struct Verb {
    name: &'static str,
    run: fn(&Asked, Watch) -> Result<Finished, Refusal>,
    /// What it would do and take.
    plan: fn(&Asked, Watch) -> Result<Estimate, Refusal>,
}

static VERBS: &[Verb] = &[
    Verb {
        name: "identify",
        run: |asked, watch| {
            let job = asked.identify()?;
            let (found, folder) = identify::job::run(&job, watch)?;
            identify::page::write(&found, folder.path()).map_err(failed)?;
            if let Some(export) = &job.export {
                exporting::of_run(folder.path(), export).map_err(failed)?;
            }
            Ok(Finished::new(folder.path(), found.valid, &found.warnings))
        },
        plan: |asked, watch| Ok(identify::job::check(&asked.identify()?, watch)?),
    },
    Verb {
        name: "simulate",
        run: |asked, watch| {
            let job = job!(asked, simulate::spec, &asked.over);
            let (found, folder) = simulate::run(&job, watch).map_err(failed)?;
            Ok(Finished::new(folder.path(), found.valid, &found.warnings))
        },
        plan: |asked, _| {
            let job = job!(asked, simulate::spec, &asked.over);
            simulate::work::estimate(&job).map_err(failed)
        },
    },
    Verb {
        name: "optimise",
        run: |asked, watch| {
            let job = job!(asked, optimise::spec, &asked.over);
            let (found, folder) = optimise::run(&job, watch).map_err(failed)?;
            Ok(Finished::new(folder.path(), found.valid, &found.warnings))
        },
        plan: |asked, _| {
            let job = job!(asked, optimise::spec, &asked.over);
            optimise::work::estimate(&job).map_err(failed)
        },
    },
    Verb {
        name: "design",
        run: |asked, watch| {
            let job = job!(asked, design, &asked.over);
            design::estimate::estimate(&job).map_err(failed)?.allowed().map_err(failed)?;
            let (found, curves, folder) = design::run::run(&job, watch).map_err(failed)?;
            design::page::write(&job, &found, &curves, folder.path()).map_err(failed)?;
            Ok(Finished::new(folder.path(), found.valid, &found.warnings))
        },
        plan: |asked, _| {
            let job = job!(asked, design, &asked.over);
            design::estimate::estimate(&job).map_err(failed)
        },
    },
    Verb {
        name: "sequential",
        run: |asked, watch| {
            let job = job!(asked, sequential::spec, &asked.over);
            sequential::estimate::estimate(&job).map_err(failed)?.allowed().map_err(failed)?;
            let (found, folder) = sequential::run(&job, watch).map_err(failed)?;
            Ok(Finished::new(folder.path(), found.valid, &found.warnings))
        },
        plan: |asked, _| {
            let job = job!(asked, sequential::spec, &asked.over);
            sequential::estimate::estimate(&job).map_err(failed)
        },
    },
    Verb {
        name: "signal",
        run: |asked, watch| {
            let job = job!(asked, signal::spec, &asked.over);
            signal::work::estimate(&job).allowed().map_err(failed)?;
            let (made, folder) = signal::run(&job, watch).map_err(failed)?;
            Ok(Finished::new(folder.path(), true, &made.warnings))
        },
        plan: |asked, _| Ok(signal::work::estimate(&job!(asked, signal::spec, &asked.over))),
    },
    Verb {
        name: "map",
        run: |asked, watch| {
            let job = job!(asked, map::job, &asked.over);
            map::estimate::estimate(&job).allowed().map_err(failed)?;
            match map::run(&job, watch) {
                Ok((found, folder)) => Ok(Finished::new(folder.path(), found.valid, &found.warnings)),
                Err(e @ map::MapError::NeedsMeasurement { .. }) => {
                    Ok(Finished::waiting(&job.out, e.to_string()))
                }
                Err(e) => Err(failed(e)),
            }
        },
        plan: |asked, _| Ok(map::estimate::estimate(&job!(asked, map::job, &asked.over))),
    },
    Verb {
        name: "calibrate",
        run: campaign,
        plan: |asked, _| Ok(calibrate::estimate::estimate(&asked.campaign()?)),
    },
];

fn campaign(asked: &Asked, watch: Watch) -> Result<Finished, Refusal> {
    use calibrate::error::ChainError;
    let campaign = asked.campaign()?;
    calibrate::estimate::estimate(&campaign).allowed().map_err(failed)?;
    let steps = calibrate::run::STEPS;
    let until = asked.until.as_deref().unwrap_or_else(|| calibrate::job::last_step(&campaign.spec));
    let place = |name: &str| steps.iter().position(|s| *s == name);
    if place(until).is_none() {
        let text = format!("until: found `{until}`, expected one of {}", steps.join(", "));
        return Err(Refusal::new(Kind::Argument, text));
    }
    let done = match calibrate::job::run(&campaign, until, watch) {
        Ok(done) => done,
        Err(e @ ChainError::NeedsMeasurement { .. }) => {
            return Ok(Finished::waiting(&campaign.out, e.to_string()));
        }
        Err(e) => return Err(failed(e)),
    };
    if let Some(export) = &campaign.spec.export
        && place(until) >= place("invert")
    {
        exporting::of_run(&campaign.out, &export.wanted(Path::new(""))).map_err(failed)?;
    }
    Ok(Finished::new(&campaign.out, done.valid, &done.warnings))
}

fn verb(name: &str) -> Result<&'static Verb, Refusal> {
    VERBS.iter().find(|v| v.name == name).ok_or_else(|| {
        let known: Vec<&str> = VERBS.iter().map(|v| v.name).collect();
        Refusal::new(Kind::Argument, format!("found the job `{name}`, expected one of {}", known.join(", ")))
    })
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
            Spec::Text(format!("{name}.toml"), text)
        }
    };
    Ok(Asked { spec, over: Overrides { seed, out }, data, until })
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
    let verb = verb(job)?;
    let asked = asked(spec, name, seed, out, data, until)?;
    Ok(watched(py, progress, move |watch| (verb.run)(&asked, watch))??)
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
    let verb = verb(job)?;
    let asked = asked(spec, name, seed, out, data, None)?;
    let plan = watched(py, None, move |watch| (verb.plan)(&asked, watch))??;
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
        Ok::<_, Refusal>(Finished::new(&out, studies::all_hold(&done.checks), &[]))
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
    let done = watched(py, None, move |_| exporting::run(&source, &folder, &spec))?.map_err(failed)?;
    Ok((done.files, done.notes))
}

/// The program: its arguments, the first being its name, and its exit code.
#[pyfunction]
pub(crate) fn program(py: Python<'_>, arguments: Vec<OsString>) -> PyResult<u8> {
    ready()?;
    Ok(py.detach(|| dynocal_cli::run(arguments)))
}
