//! Which models run on which records: read as typed, checked as meant.

use dynocal_files::run_folder::RunPlace;
use std::path::{Path, PathBuf};

use dynocal_files::spec::{Faults, LoadError, SpecError};
use dynocal_ident::model::initial::Initial;
use serde::{Deserialize, Serialize};

use crate::place::{Overrides, Place};

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Typed {
    name: Option<String>,
    out: Option<PathBuf>,
    models: Option<Vec<PathBuf>>,
    data: Option<Vec<PathBuf>>,
    start: Option<Initial>,
    init_samples: Option<usize>,
}

/// A simulation as understood.
#[derive(Clone, Debug, Serialize)]
pub struct Job {
    /// Name of the run.
    pub name: String,
    /// Model files.
    pub models: Vec<PathBuf>,
    /// Data files with the channels of the models, by name.
    pub data: Vec<PathBuf>,
    /// Where the models start; none: as each model says where its output was measured, else from rest.
    pub start: Option<Initial>,
    /// Samples at the start of every record that only initialise (those of the measured output are then the start).
    pub init_samples: usize,
    /// Run folder.
    #[serde(skip)]
    pub out: RunPlace,
}

impl Job {
    /// A simulation without a spec.
    pub fn new(models: Vec<PathBuf>, data: Vec<PathBuf>, out: Option<&Path>) -> Self {
        let place = Place::run("simulated", out);
        Self { name: place.name, models, data, start: None, init_samples: 0, out: place.out }
    }
}

/// Reads and checks the spec at `path`. Files in it are relative to its folder.
///
/// # Errors
/// [`LoadError`] with every fault.
pub fn read(path: &Path, overrides: &Overrides) -> Result<Job, LoadError> {
    dynocal_files::spec::load(path, |t: &Typed, faults| check(t, path, overrides, faults))
}

/// The same for a spec that is there as text; `file` is its name in messages.
///
/// # Errors
/// [`SpecError`] with every fault.
pub fn parse(file: &str, text: &str, overrides: &Overrides) -> Result<Job, SpecError> {
    dynocal_files::spec::parse(file, text, |t: &Typed, faults| check(t, Path::new(file), overrides, faults))
}

fn check(t: &Typed, spec: &Path, over: &Overrides, faults: &mut Faults) -> Option<Job> {
    let folder = spec.parent().unwrap_or(Path::new(""));
    let models = files(
        "models",
        t.models.as_deref(),
        folder,
        "model files (model.json of `dynocal identify`)",
        faults,
    );
    let data = files("data", t.data.as_deref(), folder, "data files with the channels of the models", faults);
    let place = Place::of(spec, t.name.as_deref(), t.out.as_deref(), over.out.as_deref(), faults);
    Some(Job {
        name: place.name,
        out: place.out,
        models: models?,
        data: data?,
        start: t.start,
        init_samples: t.init_samples.unwrap_or(0),
    })
}

fn files(
    key: &str,
    given: Option<&[PathBuf]>,
    folder: &Path,
    what: &str,
    faults: &mut Faults,
) -> Option<Vec<PathBuf>> {
    let given = given.unwrap_or(&[]);
    if given.is_empty() {
        faults.push(key, "nothing", format!("a list of {what}"));
        return None;
    }
    Some(given.iter().map(|f| folder.join(f)).collect())
}
