//! Study `loops`: iterative, black-box, robust and sequential design, pools of structures, the stop rule, and one record for
//! two outputs, on the virtual engine (thesis sections 4.10 and 4.11) and on a known system.

mod black_box;
mod others;
mod sequence;
pub mod shown;

use crate::StudyError;
use dynocal_calib::loops::LoopError;
use dynocal_ident::plant::{Plant, PlantError};
use dynocal_numerics::registry::MemberDoc;
use dynocal_plant::bed::{BedSettings, EngineBed};
use dynocal_plant::params::EngineParams;
use dynocal_plant::sensors::NoiseLevels;
use dynocal_report::Report;
use serde_json::Value;

use super::{Check, Options, Study, Surroundings, Task, TaskResult, check, result};

pub(super) const STUDY: Study = Study {
    doc: MemberDoc {
        name: "loops",
        what: "Loops of test design: black box on the engine (thesis 4.10), limits, pools, robust, sequential, when to stop, two outputs (4.11)",
        params: &[],
    },
    tasks,
    reduce,
    sections,
};

/// Sensor noise of the engine: standard deviations of torque in Nm and lambda.
const NOISE: NoiseLevels = NoiseLevels { torque_nm: 2.0, lambda: 0.01 };

fn tasks(o: &Options) -> Vec<Task> {
    let mut tasks = black_box::tasks(o);
    tasks.extend(others::tasks(o));
    tasks.extend(sequence::tasks(o));
    tasks
}

fn reduce(results: &[TaskResult]) -> Vec<Check> {
    let mut checks = black_box::checks(results);
    checks.extend(others::checks(results));
    checks.extend(sequence::checks(results));
    checks
}

fn sections(report: Report, results: &[TaskResult]) -> Report {
    let report = black_box::sections(report, results);
    sequence::sections(others::sections(report, results), results)
}

/// Campaigns of a full and of a reduced study.
fn seeds(o: &Options, full: u64) -> u64 {
    if o.reduced { 2 } else { full }
}

/// The virtual engine of the thesis set.
fn plant(noise: bool) -> Result<Box<dyn Plant>, PlantError> {
    let noise = if noise { NOISE } else { NoiseLevels::default() };
    let settings = BedSettings { noise, ..BedSettings::default() };
    let bed =
        EngineBed::new(&EngineParams::thesis(), settings).map_err(|e| PlantError::Call(e.to_string()))?;
    Ok(Box::new(bed))
}

/// A task whose result is that of a loop.
fn task<T: serde::Serialize>(
    name: &str,
    inputs: Value,
    run: impl Fn(&Surroundings) -> Result<T, LoopError> + 'static,
) -> Task {
    let of = name.to_string();
    let work = move |around: &Surroundings| match run(around) {
        Ok(found) => serde_json::to_value(found)
            .map_err(|e| StudyError::Task { what: of.clone(), reason: e.to_string() }),
        Err(LoopError::Interrupted) => Err(StudyError::Interrupted),
        Err(e) => Err(StudyError::Task { what: of.clone(), reason: e.to_string() }),
    };
    Task { name: name.into(), inputs, run: Box::new(work) }
}

/// A structure of a fixed list of regressors.
fn built<T>(model: Result<T, dynocal_ident::model::poly::StructureError>) -> Result<T, LoopError> {
    model.map_err(|e| LoopError::Model { what: "structure".into(), reason: e.to_string() })
}

fn mean(v: &[f64]) -> f64 {
    v.iter().sum::<f64>() / v.len() as f64
}
