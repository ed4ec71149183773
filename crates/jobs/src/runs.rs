//! The jobs by name: what a face, a study or another machine needs to run one of a spec and to know how it ended.

use std::error::Error;
use std::path::{Path, PathBuf};

use dynocal_files::FilesError;
use dynocal_files::spec::{LoadError, SpecError};
use dynocal_numerics::watch::Watch;

use crate::estimate::{Estimate, TooLarge};
use crate::export as exporting;
use crate::identify::error::IdentifyError;
use crate::place::Overrides;
use crate::{
    calibrate, control, design, fuelling, identify, label, map, optimise, sequential, signal, simulate,
};

/// Where a spec is.
#[derive(Clone, Debug)]
pub enum Spec {
    /// A file.
    File(PathBuf),
    /// Text.
    Text {
        /// Its name in messages; files in the spec are relative to the folder of that name.
        name: String,
        /// TOML.
        text: String,
    },
}

/// What is asked of a job.
#[derive(Clone, Debug)]
pub struct Asked {
    /// Its spec.
    pub spec: Spec,
    /// What the face changes in it.
    pub over: Overrides,
    /// Data files of `identify` in place of those of the spec.
    pub data: Vec<PathBuf>,
    /// Last step of `calibrate`.
    pub until: Option<String>,
}

impl Asked {
    /// The spec as it is.
    pub fn of(spec: Spec) -> Self {
        Self { spec, over: Overrides::default(), data: Vec::new(), until: None }
    }
}

/// How a job has ended.
#[derive(Clone, Debug)]
pub struct Ended {
    /// Run folder.
    pub folder: PathBuf,
    /// False when the result must not be used as it is.
    pub valid: bool,
    /// Sentences.
    pub warnings: Vec<String>,
    /// Why the job waits for a bed; none where it is done.
    pub waiting: Option<String>,
}

impl Ended {
    fn new(folder: &Path, valid: bool, warnings: &[String]) -> Self {
        Self { folder: folder.into(), valid, warnings: warnings.to_vec(), waiting: None }
    }

    fn waiting(folder: &Path, why: String) -> Self {
        Self { folder: folder.into(), valid: false, warnings: Vec::new(), waiting: Some(why) }
    }
}

/// Why a job could not be done.
#[derive(Debug, thiserror::Error)]
pub enum RunError {
    /// No such job, or an argument that it does not take.
    #[error("{0}")]
    Argument(String),
    /// The spec cannot be read.
    #[error(transparent)]
    File(#[from] FilesError),
    /// Faults of the spec.
    #[error(transparent)]
    Spec(#[from] SpecError),
    /// Too large for a machine.
    #[error(transparent)]
    TooLarge(#[from] TooLarge),
    /// An identification.
    #[error(transparent)]
    Identify(Box<IdentifyError>),
    /// Any other job.
    #[error(transparent)]
    Job(Box<dyn Error + Send + Sync>),
}

impl From<LoadError> for RunError {
    fn from(e: LoadError) -> Self {
        match e {
            LoadError::File(e) => e.into(),
            LoadError::Spec(e) => e.into(),
        }
    }
}

impl From<IdentifyError> for RunError {
    fn from(e: IdentifyError) -> Self {
        Self::Identify(Box::new(e))
    }
}

/// An error of a job at work.
fn failed(e: impl Error + Send + Sync + 'static) -> RunError {
    RunError::Job(Box::new(e))
}

/// A job of the program.
pub struct Verb {
    /// Name.
    pub name: &'static str,
    /// Runs it, with its files.
    pub run: fn(&Asked, Watch) -> Result<Ended, RunError>,
    /// What it would do and take.
    pub plan: fn(&Asked, Watch) -> Result<Estimate, RunError>,
}

/// Reads a job from its file or its text.
macro_rules! job {
    ($asked:expr, $module:path, $over:expr) => {{
        use $module as module;
        match &$asked.spec {
            Spec::File(path) => module::read(path, $over)?,
            Spec::Text { name, text } => module::parse(name, text, $over)?,
        }
    }};
}

/// All jobs of a spec and a run folder.
pub static VERBS: &[Verb] = &[
    Verb {
        name: "identify",
        run: identified,
        plan: |asked, watch| Ok(identify::job::check(&identification(asked)?, watch)?),
    },
    Verb {
        name: "simulate",
        run: |asked, watch| {
            let (found, folder) =
                simulate::run(&job!(asked, simulate::spec, &asked.over), watch).map_err(failed)?;
            Ok(Ended::new(folder.path(), found.valid, &found.warnings))
        },
        plan: |asked, _| simulate::work::estimate(&job!(asked, simulate::spec, &asked.over)).map_err(failed),
    },
    Verb {
        name: "optimise",
        run: |asked, watch| {
            let (found, folder) =
                optimise::run(&job!(asked, optimise::spec, &asked.over), watch).map_err(failed)?;
            Ok(Ended::new(folder.path(), found.valid, &found.warnings))
        },
        plan: |asked, _| optimise::work::estimate(&job!(asked, optimise::spec, &asked.over)).map_err(failed),
    },
    Verb {
        name: "design",
        run: |asked, watch| {
            let job = job!(asked, design, &asked.over);
            design::estimate::estimate(&job).map_err(failed)?.allowed()?;
            let (found, curves, folder) = design::run::run(&job, watch).map_err(failed)?;
            design::page::write(&job, &found, &curves, folder.path()).map_err(failed)?;
            Ok(Ended::new(folder.path(), found.valid, &found.warnings))
        },
        plan: |asked, _| design::estimate::estimate(&job!(asked, design, &asked.over)).map_err(failed),
    },
    Verb {
        name: "sequential",
        run: |asked, watch| {
            let job = job!(asked, sequential::spec, &asked.over);
            sequential::estimate::estimate(&job).map_err(failed)?.allowed()?;
            let (found, folder) = sequential::run(&job, watch).map_err(failed)?;
            Ok(Ended::new(folder.path(), found.valid, &found.warnings))
        },
        plan: |asked, _| {
            sequential::estimate::estimate(&job!(asked, sequential::spec, &asked.over)).map_err(failed)
        },
    },
    Verb {
        name: "signal",
        run: |asked, watch| {
            let job = job!(asked, signal::spec, &asked.over);
            signal::work::estimate(&job).allowed()?;
            let (made, folder) = signal::run(&job, watch).map_err(failed)?;
            Ok(Ended::new(folder.path(), true, &made.warnings))
        },
        plan: |asked, _| Ok(signal::work::estimate(&job!(asked, signal::spec, &asked.over))),
    },
    Verb {
        name: "map",
        run: mapped,
        plan: |asked, _| Ok(map::estimate::estimate(&job!(asked, map::job, &asked.over))),
    },
    Verb {
        name: "control",
        run: |asked, watch| {
            let (found, folder) =
                control::run(&job!(asked, control::spec, &asked.over), watch).map_err(failed)?;
            Ok(Ended::new(folder.path(), found.valid, &found.warnings))
        },
        plan: |asked, _| control::estimate(&job!(asked, control::spec, &asked.over)).map_err(failed),
    },
    Verb {
        name: "fuelling",
        run: |asked, watch| {
            let (found, folder) =
                fuelling::run(&job!(asked, fuelling::spec, &asked.over), watch).map_err(failed)?;
            let why = if found.valid { Vec::new() } else { found.verdict.clone() };
            Ok(Ended::new(folder.path(), found.valid, &[why, found.warnings].concat()))
        },
        plan: |asked, _| fuelling::work::estimate(&job!(asked, fuelling::spec, &asked.over)).map_err(failed),
    },
    Verb {
        name: "label",
        run: |asked, watch| {
            let job = job!(asked, label::function::spec, &asked.over);
            let (found, folder) = label::function::run(&job, watch).map_err(failed)?;
            let why = if found.valid { Vec::new() } else { found.verdict.clone() };
            Ok(Ended::new(folder.path(), found.valid, &why))
        },
        plan: |asked, _| {
            let job = job!(asked, label::function::spec, &asked.over);
            let targets: Vec<&str> = job.rows.iter().map(|r| r.target.as_str()).collect();
            let fit = format!("{} to {} data files", targets.join(", "), job.data.len());
            Ok(Estimate::new(job.name).line("fit", fit))
        },
    },
    Verb {
        name: "calibrate",
        run: calibrated,
        plan: |asked, _| Ok(calibrate::estimate::estimate(&campaign(asked)?)),
    },
];

/// The job of that name.
///
/// # Errors
/// [`RunError::Argument`] with all names.
pub fn find(name: &str) -> Result<&'static Verb, RunError> {
    VERBS.iter().find(|v| v.name == name).ok_or_else(|| {
        let known: Vec<&str> = VERBS.iter().map(|v| v.name).collect();
        RunError::Argument(format!("found the job `{name}`, expected one of {}", known.join(", ")))
    })
}

fn identification(asked: &Asked) -> Result<identify::spec::Job, RunError> {
    let over = identify::spec::Overrides {
        data: asked.data.clone(),
        seed: asked.over.seed,
        out: asked.over.out.clone(),
        reference: None,
    };
    Ok(job!(asked, identify::spec, &over))
}

fn identified(asked: &Asked, watch: Watch) -> Result<Ended, RunError> {
    let job = identification(asked)?;
    let (found, folder) = identify::job::run(&job, watch)?;
    identify::page::write(&found, folder.path()).map_err(failed)?;
    if let Some(export) = &job.export {
        exporting::of_run(folder.path(), export).map_err(failed)?;
    }
    Ok(Ended::new(folder.path(), found.valid, &found.warnings))
}

fn mapped(asked: &Asked, watch: Watch) -> Result<Ended, RunError> {
    let job = job!(asked, map::job, &asked.over);
    map::estimate::estimate(&job).allowed()?;
    match map::run(&job, watch) {
        Ok((found, folder)) => Ok(Ended::new(folder.path(), found.valid, &found.warnings)),
        Err(e @ map::MapError::NeedsMeasurement { .. }) => Ok(Ended::waiting(&job.out, e.to_string())),
        Err(e) => Err(failed(e)),
    }
}

fn campaign(asked: &Asked) -> Result<calibrate::job::Campaign, RunError> {
    let (seed, out) = (asked.over.seed, asked.over.out.as_deref());
    Ok(match &asked.spec {
        Spec::File(path) => calibrate::job::read(path, seed, out)?,
        Spec::Text { name, text } => calibrate::job::parse(name, text, seed, out)?,
    })
}

fn calibrated(asked: &Asked, watch: Watch) -> Result<Ended, RunError> {
    use calibrate::error::ChainError;
    let campaign = campaign(asked)?;
    calibrate::estimate::estimate(&campaign).allowed()?;
    let steps = calibrate::run::STEPS;
    let until = asked.until.as_deref().unwrap_or_else(|| calibrate::job::last_step(&campaign.spec));
    let place = |name: &str| steps.iter().position(|s| *s == name);
    if place(until).is_none() {
        return Err(RunError::Argument(format!(
            "until: found `{until}`, expected one of {}",
            steps.join(", ")
        )));
    }
    let done = match calibrate::job::run(&campaign, until, watch) {
        Ok(done) => done,
        Err(e @ ChainError::NeedsMeasurement { .. }) => {
            return Ok(Ended::waiting(&campaign.out, e.to_string()));
        }
        Err(e) => return Err(failed(e)),
    };
    if let Some(export) = &campaign.spec.export
        && place(until) >= place("invert")
    {
        exporting::of_run(&campaign.out, &export.wanted(Path::new(""))).map_err(failed)?;
    }
    Ok(Ended::new(&campaign.out, done.valid, &done.warnings))
}
