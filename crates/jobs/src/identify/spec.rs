//! The spec of an identification: as typed, and as understood.

mod derive;
mod member;
mod model;
mod saved;
mod source;
mod split;
mod steady;
mod typed;
mod validation;

use dynocal_files::run_folder::RunPlace;
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use dynocal_files::dataset::{Layout, Time};
use dynocal_files::spec::{Faults, LoadError, SpecError, load};
use dynocal_ident::stored::StoredModel;
use serde::Serialize;

use crate::export_spec::ExportSpec;
use crate::place::Place;

use typed::Typed;

pub use crate::kept::MOST_CSV_ROWS;
pub use derive::DeriveSpec;
pub use member::{built, built_with};
pub use model::{Selecting, StructureSpec, Target};
pub(crate) use source::cut;
pub use source::{Source, StepSpec, TestSet};
pub use split::Split;
pub use typed::Keep;
pub(crate) use typed::TypedCut;
pub use validation::Validation;

/// What the command line changes in a spec.
#[derive(Clone, Debug, Default)]
pub struct Overrides {
    /// Data files instead of those that the spec names; none for those of the spec.
    pub data: Vec<PathBuf>,
    /// Seed for every part that draws random numbers.
    pub seed: Option<u64>,
    /// Run folder.
    pub out: Option<PathBuf>,
    /// Folder of the reference data, instead of the environment variable that a spec names.
    pub reference: Option<PathBuf>,
}

/// An identification as understood: nothing left to default, nothing left to fail for a typing error.
#[derive(Clone, Debug, Serialize)]
pub struct Job {
    /// Name of the run.
    pub name: String,
    /// Data files; several are several experiments.
    pub sources: Vec<Source>,
    /// Channels, time, trajectories.
    pub layout: Layout,
    /// Samples of one period, where the inputs are periodic multisines.
    pub multisine_period: Option<usize>,
    /// Division into estimation, selection and test.
    pub split: Split,
    /// Test records in files of their own.
    pub tests: Vec<TestSet>,
    /// Channels that follow from others.
    pub derive: Vec<DeriveSpec>,
    /// Steps of the preparation.
    pub prepare: Vec<StepSpec>,
    /// What is identified.
    pub targets: Vec<Target>,
    /// How it is judged.
    pub validate: Validation,
    /// Seed of what the validation draws.
    pub seed: u64,
    /// Models that are scored instead of estimated; none for an estimation.
    pub saved: Vec<StoredModel>,
    /// How the scored records are kept.
    pub keep: Keep,
    /// Run folder.
    #[serde(skip)]
    pub out: RunPlace,
    /// Formats in which the models leave.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub export: Option<ExportSpec>,
}

/// Reads and checks the spec at `path`. Files in it are relative to its folder; `${NAME}` stands for the
/// environment variable NAME.
///
/// # Errors
/// [`LoadError`] with every fault.
pub fn read(path: &Path, overrides: &Overrides) -> Result<Job, LoadError> {
    let folder = path.parent().unwrap_or(Path::new("")).to_path_buf();
    let stem = path.file_stem().map(|s| s.to_string_lossy().into_owned()).unwrap_or_default();
    load(path, |typed: &Typed, faults| check(typed, &folder, &stem, overrides, faults))
}

/// The same for a spec that is there as text; `file` is its name in messages, and files in it are relative to the
/// working folder.
///
/// # Errors
/// [`SpecError`] with every fault.
pub fn parse(file: &str, text: &str, overrides: &Overrides) -> Result<Job, SpecError> {
    let path = Path::new(file);
    let (folder, stem) = (path.parent().unwrap_or(Path::new("")), path.file_stem().unwrap_or_default());
    dynocal_files::spec::parse(file, text, |typed: &Typed, faults| {
        check(typed, folder, &stem.to_string_lossy(), overrides, faults)
    })
}

fn check(t: &Typed, folder: &Path, stem: &str, over: &Overrides, faults: &mut Faults) -> Option<Job> {
    let data = t.data.as_ref();
    if data.is_none() {
        faults.push("data", "nothing", "a table [data] with the keys file and sample_time_s (or time)");
    }
    let place = source::Place { folder, reference: over.reference.as_deref() };
    let sources = source::sources(data, &place, &over.data, faults);
    let channels = source::channels(t.channels.as_deref().unwrap_or(&[]), faults);
    let names: Vec<String> = channels.iter().map(|c| c.name.clone()).collect();
    let derive = derive::derive(t.derive.as_deref().unwrap_or(&[]), &channels, faults);
    let all: Vec<_> = channels.iter().cloned().chain(derive::as_channels(&derive)).collect();
    let prepare = source::steps(t.prepare.as_deref().unwrap_or(&[]), faults);
    let resampled = prepare.iter().any(|s| s.step == "resample");
    let layout = data.and_then(|d| source::layout(d, channels.clone(), resampled, faults));
    let split = split::split(t.split.as_ref(), faults);
    let tests =
        source::tests(t.test.as_deref().unwrap_or(&[]), &names, &source::reading(data), &place, faults);
    let targets = model::targets(t.model.as_ref(), &all, over.seed, faults);
    let target_names: Vec<String> = targets.iter().flatten().map(|t| t.target.clone()).collect();
    let validate = validation::validation(t.validate.as_ref(), &target_names, faults);
    // A stem may hold dots of its own.
    let spec = folder.join(format!("{stem}.toml"));
    t.export.iter().for_each(|e| e.check(faults));
    if t.export.as_ref().is_some_and(|e| e.engine) {
        faults.push("export.engine", "true", "a spec of `dynocal calibrate`: this one has no plant");
    }
    let run = Place::of(&spec, t.name.as_deref(), t.out.as_deref(), over.out.as_deref(), faults);
    let mut validate = validate;
    let layout = layout?;
    if layout.time == Time::Steady {
        steady::check(t, targets.as_deref(), &mut validate, faults);
    } else if let Some(every) = t.split.as_ref().and_then(|s| s.test_every) {
        let expected = "rows in blocks: neighbours of a record in time are no unseen data";
        faults.push("split.test_every", every, expected);
    }
    Some(Job {
        out: run.out,
        name: run.name,
        sources: sources?,
        layout,
        multisine_period: data.and_then(|d| d.multisine_period),
        split: split?,
        tests,
        derive,
        prepare,
        targets: targets?,
        validate,
        seed: over.seed.unwrap_or(0),
        saved: Vec::new(),
        keep: t.records.unwrap_or_default(),
        export: t.export.as_ref().map(|e| e.wanted(folder)),
    })
}

impl Job {
    /// Whether the rows are points without time.
    pub fn is_steady(&self) -> bool {
        self.layout.time == Time::Steady
    }

    /// The part of the job that decides the result, for the digest of the step; where files lie does not count.
    pub fn inputs(&self) -> BTreeMap<&'static str, serde_json::Value> {
        let tests: Vec<_> =
            self.tests.iter().map(|t| (&t.name, &t.init_samples, &t.columns, t.cut)).collect();
        BTreeMap::from([
            ("reading", serde_json::json!(self.sources.first().map(|s| (s.format, &s.keys)))),
            ("layout", serde_json::json!(self.layout)),
            ("multisine_period", serde_json::json!(self.multisine_period)),
            ("split", serde_json::json!(self.split)),
            ("tests", serde_json::json!(tests)),
            ("derive", serde_json::json!(self.derive)),
            ("prepare", serde_json::json!(self.prepare)),
            ("targets", serde_json::json!(self.targets)),
            ("validate", serde_json::json!(self.validate)),
            ("seed", serde_json::json!(self.seed)),
            ("saved", serde_json::json!(self.saved)),
            ("keep", serde_json::json!(self.keep)),
        ])
    }
}
