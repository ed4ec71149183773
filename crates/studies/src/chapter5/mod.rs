//! Study `chapter5`: what it is worth to identify a simulation model by its simulation error (thesis chapter 5 and
//! section 7.4).
//!
//! The thesis stands beside ours in every table; every section says how the thesis was read.

mod engine;
mod known;
mod networks;
pub mod work;

use std::path::{Path, PathBuf};

use crate::StudyError;
use crate::chapter5::work::Chapter5Error;
use dynocal_ident::plant::{Plant, PlantError};
use dynocal_numerics::registry::MemberDoc;
use dynocal_plant::bed::{BedSettings, EngineBed};
use dynocal_plant::params::EngineParams;
use dynocal_report::{Cell, Report};
use serde_json::Value;

use super::{Check, Options, Study, Surroundings, Task, TaskResult, check, result};

pub(super) const STUDY: Study = Study {
    doc: MemberDoc {
        name: "chapter5",
        what: "Prediction error against simulation error: the known system and the engine models of thesis chapter 5 and section 7.4",
        params: &[],
    },
    tasks,
    reduce,
    sections,
};

fn tasks(o: &Options) -> Vec<Task> {
    let mut tasks = known::tasks(o);
    tasks.extend(engine::tasks(o));
    tasks.extend(networks::tasks(o));
    tasks
}

fn reduce(results: &[TaskResult]) -> Vec<Check> {
    let mut checks = known::checks(results);
    checks.extend(engine::checks(results));
    checks.extend(networks::checks(results));
    checks
}

fn sections(report: Report, results: &[TaskResult]) -> Report {
    let report = engine::sections(known::sections(report, results), results);
    networks::sections(report, results)
}

/// Names of the models of section 7.4 among the tasks.
const SECTION_7_4: [&str; 3] = [engine::LOOP, networks::NETWORKS[0], networks::NETWORKS[1]];

/// The tasks of section 7.4 alone: polynomials and networks in closed loop.
pub(super) fn section_7_4(o: &Options) -> Vec<Task> {
    tasks(o).into_iter().filter(|t| SECTION_7_4.contains(&t.name.as_str())).collect()
}

/// A model of section 7.4 beside the thesis, R2 in percent.
pub(super) struct Fit {
    pub(super) thesis_identification_pct: f64,
    pub(super) identification_pct: Option<f64>,
    pub(super) thesis_unseen_pct: f64,
    pub(super) unseen_pct: Option<f64>,
}

/// Polynomials by simulation error, then networks; torque, then lambda.
pub(super) fn fits_7_4(results: &[TaskResult]) -> [[Fit; 2]; 2] {
    let polynomials = engine::closed_loop_models(results);
    let known = [&work::published::TORQUE_7_8, &work::published::LAMBDA_7_8];
    let polynomial = |k: usize| {
        let sem = polynomials.as_ref().map(|p| &p.models[k].sem);
        Fit {
            thesis_identification_pct: known[k].identification[1].1,
            identification_pct: sem.map(|s| percent(s.free_run.r2)),
            thesis_unseen_pct: known[k].unseen[1].map_or(f64::NAN, |u| u.1),
            unseen_pct: sem.map(|s| percent(s.mean_unseen().r2)),
        }
    };
    let network = |k: usize| {
        let found = networks::best_of_two_records(results, k);
        Fit {
            thesis_identification_pct: work::published::TABLE_7_2[k].r2,
            identification_pct: found.map(|f| percent(f.0)),
            thesis_unseen_pct: work::published::TABLE_7_5[k].r2,
            unseen_pct: found.map(|f| percent(f.1)),
        }
    };
    [[0, 1].map(polynomial), [0, 1].map(network)]
}

/// The virtual engine of the thesis set, without sensor noise.
pub(super) fn plant(_noise: bool) -> Result<Box<dyn Plant>, PlantError> {
    let settings = BedSettings::default();
    let bed =
        EngineBed::new(&EngineParams::thesis(), settings).map_err(|e| PlantError::Call(e.to_string()))?;
    Ok(Box::new(bed))
}

/// Where the stored engine records lie: beside the file asked for, else in the folder that the environment names, else
/// nowhere.
fn reference(o: &Options) -> Option<PathBuf> {
    let folder = match &o.reference {
        Some(file) => file.parent().unwrap_or(Path::new(".")).to_path_buf(),
        None => Path::new(&std::env::var_os("DYNOCAL_REFERENCE_DIR")?).join("reference"),
    };
    Some(folder.join("estimation_inputs"))
}

/// A task whose result is that of a computation of the chapter.
fn task<T: serde::Serialize>(
    name: &str,
    inputs: Value,
    run: impl Fn(&(dyn Fn() -> bool + Sync)) -> Result<T, Chapter5Error> + 'static,
) -> Task {
    let of = name.to_string();
    let work = move |around: &Surroundings| match run(around.watch.interrupt) {
        Ok(found) => serde_json::to_value(found)
            .map_err(|e| StudyError::Task { what: of.clone(), reason: e.to_string() }),
        Err(Chapter5Error::Interrupted) => Err(StudyError::Interrupted),
        Err(e) => Err(StudyError::Task { what: format!("chapter 5, {of}"), reason: e.to_string() }),
    };
    Task { name: name.into(), inputs, run: Box::new(work) }
}

/// R2 as the thesis prints it.
fn percent(r2: f64) -> f64 {
    100.0 * r2
}

/// Parameters in one cell.
fn vector(theta: &[f64]) -> Cell {
    theta.iter().map(|v| dynocal_report::significant(*v, 4)).collect::<Vec<_>>().join(", ").into()
}
