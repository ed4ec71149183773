//! Study `engine`: the virtual engine against its reference table, its verification cases and the thesis.

pub mod air_path;
pub mod as_measured;
mod as_measured_rows;
mod boosted;
mod boosted_tables;
mod checks;
pub mod class_rows;
pub mod class_values;
mod light_off;
pub mod other;
pub mod reach;
mod results;
mod row_plots;
mod rows;
mod tables;
mod tasks;
pub mod transients;
mod twin;
pub mod verification;

use std::path::{Path, PathBuf};

use crate::StudyError;
use crate::engine::verification::ReferencePoint;
use dynocal_numerics::registry::MemberDoc;
use serde::Serialize;
use serde_json::{Value, json};

use crate::{Options, Study, Surroundings, Task};
use boosted::tasks as boosted_tasks;
use checks::checks;
use tables::sections;
use tasks::{self as work, StaticTask};

pub(super) const STUDY: Study = Study {
    doc: MemberDoc {
        name: "engine",
        what: "The virtual engine: reference table, verification cases, comparison with the thesis, class values of gtdi_2l",
        params: &[],
    },
    tasks,
    reduce: checks,
    sections,
};

/// Names of the tasks.
pub(super) const STATIC: &str = "static-";
pub(super) const MOTORED: &str = "motored";
pub(super) const OPEN: &str = "open-throttle";
pub(super) const SPARK: &str = "spark";
pub(super) const TRANSIENTS: &str = "transients";
pub(super) const RANDOM: &str = "random-inputs";

/// Where the reference lies below the folder that the environment names.
const REFERENCE: &str = "reference/virtual_engine_reference.json";

fn tasks(o: &Options) -> Vec<Task> {
    let reference = reference(o.reference.as_deref());
    let step = if o.reduced { 5 } else { 1 };
    let speeds = (0..=10).step_by(step).map(|k| 1000.0 + 200.0 * f64::from(k));
    let torques: Vec<f64> = if o.reduced {
        vec![0.0, 30.0, 70.0, 100.0]
    } else {
        (0..=10).map(|k| 10.0 * f64::from(k)).collect()
    };
    let mut tasks = Vec::new();
    for (k, speed_rpm) in speeds.enumerate() {
        let rows = reference.as_ref().map(|r| {
            r.as_ref().map(|all| all.iter().copied().filter(|p| p.speed_rpm == speed_rpm).collect())
        });
        let (rows, fault): (Option<Vec<ReferencePoint>>, _) = match rows {
            None => (None, None),
            Some(Ok(rows)) => (Some(rows), None),
            Some(Err(e)) => (None, Some(e.clone())),
        };
        let spec = StaticTask {
            speed_rpm,
            torques_nm: torques.clone(),
            seed: o.seed,
            first: (k * torques.len()) as u64,
            reference: rows,
            fault,
        };
        let inputs = json!(spec);
        tasks.push(task(format!("{STATIC}{speed_rpm}"), inputs, move || spec.run()));
    }
    tasks.push(task(MOTORED.into(), json!(work::MOTORED_RPM), work::motored));
    tasks.push(task(OPEN.into(), json!(work::OPEN_RPM), work::open_throttle));
    tasks.push(task(SPARK.into(), Value::Null, work::spark));
    tasks.push(task(TRANSIENTS.into(), Value::Null, work::transients));
    let (seed, time_s) = (o.seed, if o.reduced { 30.0 } else { 600.0 });
    tasks.push(task(RANDOM.into(), json!([seed, time_s]), move || work::random_inputs(seed, time_s)));
    tasks.extend(boosted_tasks(o));
    tasks.extend(rows::tasks(o));
    tasks.extend(as_measured_rows::tasks());
    tasks.extend(reach::tasks());
    tasks.extend(other::tasks());
    tasks.extend(twin::tasks());
    tasks.extend(light_off::tasks());
    tasks
}

pub(super) fn task<T: Serialize>(
    name: String,
    inputs: Value,
    run: impl Fn() -> Result<T, StudyError> + 'static,
) -> Task {
    Task { name, inputs, run: Box::new(move |_: &Surroundings| run().map(|found| json!(found))) }
}

/// The reference table: of the file asked for, else of the folder that the environment names, else none.
fn reference(asked: Option<&Path>) -> Option<Result<Vec<ReferencePoint>, String>> {
    let path: PathBuf = match asked {
        Some(p) => p.into(),
        None => Path::new(&std::env::var_os("DYNOCAL_REFERENCE_DIR")?).join(REFERENCE),
    };
    Some(read(&path))
}

fn read(path: &Path) -> Result<Vec<ReferencePoint>, String> {
    let all: Value = dynocal_files::json::read(path).map_err(|e| e.to_string())?;
    serde_json::from_value(all["static_reference"].clone()).map_err(|e| {
        format!("{}: table `static_reference` does not hold the points of a static map: {e}", path.display())
    })
}
