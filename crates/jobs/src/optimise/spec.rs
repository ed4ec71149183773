//! Models, record, problem and options of an optimisation: read as typed, checked as meant.

use dynocal_files::run_folder::RunPlace;
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use dynocal_calib::optimise::OptimiseOptions;
use dynocal_calib::problem::CalibrationProblem;
use dynocal_files::spec::{Faults, LoadError, SpecError};
use serde::{Deserialize, Serialize};

use crate::place::{Overrides, Place};

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Typed {
    name: Option<String>,
    out: Option<PathBuf>,
    models: Option<Vec<PathBuf>>,
    record: Option<TypedRecord>,
    problem: Option<CalibrationProblem>,
    #[serde(default)]
    optimise: OptimiseOptions,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct TypedRecord {
    file: Option<PathBuf>,
    time: Option<String>,
    #[serde(default)]
    columns: BTreeMap<String, String>,
    from_s: Option<f64>,
    to_s: Option<f64>,
}

/// The record that an optimisation starts from.
#[derive(Clone, Debug, Serialize)]
pub struct RecordSpec {
    /// Measurement file.
    pub file: PathBuf,
    /// Column of the time stamps; none: `time` where the file has it, else rows are as far apart as the models' samples.
    pub time: Option<String>,
    /// Column of a channel where it has another name.
    pub columns: BTreeMap<String, String>,
    /// Part of the record that is taken, in s from its start.
    pub from_s: f64,
    /// End of that part; none: that of the record.
    pub to_s: Option<f64>,
}

/// An optimisation as understood.
#[derive(Clone, Debug, Serialize)]
pub struct Job {
    /// Name of the run and of the plan.
    pub name: String,
    /// Model files, one for each output of the problem.
    pub models: Vec<PathBuf>,
    /// Start inputs, given channels, demands.
    pub record: RecordSpec,
    /// What may move, what is asked, what is minimised.
    pub problem: CalibrationProblem,
    /// How it is solved.
    pub optimise: OptimiseOptions,
    /// Run folder.
    #[serde(skip)]
    pub out: RunPlace,
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
    let place = Place::of(spec, t.name.as_deref(), t.out.as_deref(), over.out.as_deref(), faults);
    let models: Vec<PathBuf> = t.models.iter().flatten().map(|f| folder.join(f)).collect();
    if models.is_empty() {
        let expected =
            "a list of model files (model.json of `dynocal identify`), one for each output of the problem";
        faults.push("models", "nothing", expected);
    }
    let problem = faults.required("problem", &t.problem, "what may move, is demanded, limited and minimised");
    let record = record(t.record.as_ref(), folder, problem.as_ref(), faults);
    if let Some(p) = &problem {
        p.check("problem", faults);
    }
    t.optimise.check("optimise", faults);
    let (record, problem) = (record?, problem?);
    Some(Job { name: place.name, out: place.out, models, record, problem, optimise: t.optimise })
}

fn record(
    t: Option<&TypedRecord>,
    folder: &Path,
    problem: Option<&CalibrationProblem>,
    faults: &mut Faults,
) -> Option<RecordSpec> {
    let expected = "a measurement file with the start inputs and the given channels (`dynocal list formats`)";
    let Some(t) = t else {
        faults.push("record.file", "nothing", expected);
        return None;
    };
    let from_s = t.from_s.unwrap_or(0.0);
    if !(from_s >= 0.0 && from_s.is_finite()) {
        faults.push("record.from_s", from_s, "0 or a positive number, s");
    }
    if let Some(to) = t.to_s.filter(|to| !(*to > from_s)) {
        faults.push("record.to_s", to, format!("later than from_s = {from_s} s"));
    }
    if let Some(p) = problem {
        let known = channels(p);
        for name in t.columns.keys().filter(|n| !known.contains(n)) {
            faults.unknown("record.columns", name, &known);
        }
    }
    let file = faults.required("record.file", &t.file, expected)?;
    let (time, columns, to_s) = (t.time.clone(), t.columns.clone(), t.to_s);
    Some(RecordSpec { file: folder.join(file), time, columns, from_s, to_s })
}

/// Channels of a problem that a record can have: inputs, given channels, outputs.
fn channels(p: &CalibrationProblem) -> Vec<String> {
    [p.input_names(), p.given_names(), p.demand_names(), p.other_outputs()].concat()
}
