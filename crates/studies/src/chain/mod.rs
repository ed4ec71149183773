//! Study `chain`: the whole campaign on the virtual engine, three seeds, once more with sensor noise, and what
//! happens when a run is repeated or interrupted.

mod checks;
mod tasks;

use crate::StudyError;
use dynocal_jobs::calibrate::spec::CalibrateSpec;
use dynocal_numerics::registry::MemberDoc;
use dynocal_report::{Cell, Column, Report, Section, Table};
use serde_json::{Value, json};

use crate::{Options, Study, Task, TaskResult};
use checks::{checks, row};
use tasks::{calibrate, interruption};

pub(super) const STUDY: Study = Study {
    doc: MemberDoc {
        name: "chain",
        what: "From the virtual engine to a dynamic map: three seeds, one with noise, resume and interruption",
        params: &[],
    },
    tasks,
    reduce: checks,
    sections,
};

/// Names of the tasks by purpose.
pub(super) const SEED: &str = "seed-";
pub(super) const NOISE: &str = "noise";
pub(super) const INTERRUPTION: &str = "interruption";

/// Sensor noise of the noisy run.
const NOISE_TORQUE_NM: f64 = 1.0;
const NOISE_LAMBDA: f64 = 0.01;

/// The shipped example at reduced length.
const REDUCED: &str = include_str!("../../../../examples/gtdi/quick.toml");
/// A run so short that it can be repeated and interrupted in seconds; its numbers mean nothing.
const SHORTEST: &str = include_str!("../shortest.toml");

fn tasks(o: &Options) -> Vec<Task> {
    let base =
        || if o.reduced { toml::from_str(REDUCED).map_err(spec_error) } else { Ok(CalibrateSpec::default()) };
    let with_seed =
        move |seed: u64| -> Result<CalibrateSpec, StudyError> { Ok(CalibrateSpec { seed, ..base()? }) };
    let seeds = if o.reduced { 1 } else { 3 };
    let mut tasks: Vec<Task> =
        (o.seed..o.seed + seeds).map(|seed| calibration(format!("{SEED}{seed}"), with_seed(seed))).collect();
    let noisy = with_seed(o.seed).map(|mut spec| {
        spec.plant.torque_noise_nm = NOISE_TORQUE_NM;
        spec.plant.lambda_noise = NOISE_LAMBDA;
        spec
    });
    tasks.push(calibration(NOISE.into(), noisy));
    let shortest = toml::from_str(SHORTEST).map_err(spec_error).map(|s| CalibrateSpec { seed: o.seed, ..s });
    tasks.push(task(INTERRUPTION.into(), shortest, interruption));
    tasks
}

fn spec_error(e: toml::de::Error) -> StudyError {
    StudyError::Task { what: "spec of the study".into(), reason: e.to_string() }
}

fn calibration(name: String, spec: Result<CalibrateSpec, StudyError>) -> Task {
    task(name, spec, calibrate)
}

type Work = fn(&str, &CalibrateSpec, &super::Surroundings) -> Result<Value, StudyError>;

fn task(name: String, spec: Result<CalibrateSpec, StudyError>, work: Work) -> Task {
    let inputs = spec.as_ref().map_or_else(|e| json!({ "fault": e.to_string() }), |s| json!(s));
    let (own, fault) = match spec {
        Ok(s) => (s, None),
        Err(e) => (CalibrateSpec::default(), Some(e.to_string())),
    };
    let title = name.clone();
    let run = Box::new(move |around: &super::Surroundings| match &fault {
        Some(reason) => Err(StudyError::Task { what: title.clone(), reason: reason.clone() }),
        None => work(&title, &own, around),
    });
    Task { name, inputs, run }
}

/// One row per calibration: the numbers behind the checks.
fn sections(report: Report, results: &[TaskResult]) -> Report {
    let runs: Vec<&TaskResult> = results.iter().filter(|r| r.name != INTERRUPTION).collect();
    let head = [Column::text("Number"), Column::text("Unit")];
    let columns = head.into_iter().chain(runs.iter().map(|r| Column::number(r.name.as_str(), "").digits(4)));
    let mut table = Table::new(columns.collect()).caption("The numbers of every calibration");
    let read = |r: &&TaskResult| crate::result::<tasks::Calibrated>(results, &r.name);
    let rows: Vec<_> = runs.iter().map(|r| row(read(r).as_ref())).collect();
    for (k, (name, unit, _)) in rows.first().into_iter().flatten().enumerate() {
        let cells = rows.iter().map(|r| Cell::from(r.get(k).and_then(|n| n.2)));
        table =
            table.row([Cell::from(*name), Cell::from(*unit)].into_iter().chain(cells).collect::<Vec<_>>());
    }
    let files = runs.iter().map(|r| format!("runs/{}/report.html", r.name)).collect::<Vec<_>>().join("\n");
    report.section(Section::new("Calibrations").block(table).code("Reports of the calibrations", files))
}
