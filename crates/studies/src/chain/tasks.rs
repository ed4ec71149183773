//! Tasks of the study `chain`.

use std::path::Path;
use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};

use dynocal_calib::map::{FeedforwardMap, Reference};
use dynocal_files::{FilesError, json as json_files};
use dynocal_ident::data::Dataset;
use dynocal_jobs::calibrate::context::{ChainError, Event, load_records};
use dynocal_jobs::calibrate::run::{ChainResult, STEPS};
use dynocal_jobs::calibrate::spec::CalibrateSpec;
use serde_json::{Value, json};

use crate::{StudyError, Surroundings};
use dynocal_jobs::calibrate::job::{self, Campaign};

/// Ids of the sections that a complete report has.
const SECTIONS: [&str; 9] =
    ["result", "excite", "models", "design", "optimise", "maps", "validate", "spec", "files"];

/// A calibration: its summary, and what only its records and its map can tell.
pub(super) fn calibrate(
    name: &str,
    spec: &CalibrateSpec,
    around: &Surroundings,
) -> Result<Value, StudyError> {
    let campaign = Campaign { name: name.into(), spec: spec.clone(), out: around.runs.join(name) };
    let tell = |e: Event| {
        if let Event::Step(k, of, step) = e {
            around.watch.note(&format!("  step {k} of {of}: {step}"));
        }
    };
    let done = job::run(&campaign, "validate", &tell, around.watch.interrupt)?;
    let summary: Value = json_files::read(&done.summary)?;
    let html = text(&done.report)?;
    let missing: Vec<&str> =
        SECTIONS.into_iter().filter(|id| !html.contains(&format!("<section id=\"{id}\""))).collect();
    Ok(json!({
        "summary": summary,
        "lambda_1_99": excited_lambda(&done.result, spec)?,
        "design": designed(&done.result, spec)?,
        "rest_difference": rest_difference(&done.result, spec),
        "report_missing": missing,
        "report_ends": html.trim_end().ends_with("</html>"),
    }))
}

fn text(path: &Path) -> Result<String, StudyError> {
    std::fs::read_to_string(path)
        .map_err(|e| FilesError::Read { path: path.display().to_string(), reason: e.to_string() }.into())
}

/// Lambda that 1 % and 99 % of the samples of the identification records lie below.
fn excited_lambda(r: &ChainResult, spec: &CalibrateSpec) -> Result<Option<[f64; 2]>, StudyError> {
    let Some(excite) = &r.excite else { return Ok(None) };
    lambda_range(&load_records(&excite.folder, &excite.result.identification, spec.sample_time_s)?)
}

fn lambda_range(records: &[Dataset]) -> Result<Option<[f64; 2]>, StudyError> {
    let mut lambda = Vec::new();
    for record in records {
        lambda.extend_from_slice(record.values("lambda")?);
    }
    lambda.sort_by(f64::total_cmp);
    let at = |share: f64| lambda.get((share * (lambda.len() as f64 - 1.0)) as usize).copied();
    Ok(at(0.01).zip(at(0.99)).map(|(a, b)| [a, b]))
}

/// The designed record as it was run: lambda, and the least distance of what was demanded to its limits, as a share
/// of the allowed range.
fn designed(r: &ChainResult, spec: &CalibrateSpec) -> Result<Value, StudyError> {
    let Some(design) = &r.design else { return Ok(Value::Null) };
    let records = load_records(&design.folder, &design.result.records, spec.sample_time_s)?;
    let d = &spec.design;
    let mut least = f64::INFINITY;
    for record in &records {
        for (name, (low, high)) in [
            ("torque_demand", d.torque_nm),
            ("lambda_demand", d.lambda),
            ("spark", d.spark_deg),
            ("speed", d.speed_rpm),
        ] {
            let nearest =
                record.values(name)?.iter().map(|v| (v - low).min(high - v)).fold(f64::INFINITY, f64::min);
            least = least.min(nearest / (high - low));
        }
    }
    // A level that is at its limit may round to either side of it.
    let least = if least.abs() < 1e-12 { 0.0 } else { least };
    Ok(json!({ "least_distance": least, "lambda_1_99": lambda_range(&records)? }))
}

/// Largest difference between what the dynamic map gives after a long held demand and its static part, relative to
/// the range of the actuator: its window differences must vanish.
fn rest_difference(r: &ChainResult, spec: &CalibrateSpec) -> Option<f64> {
    let map = &r.invert.as_ref()?.result.dynamic;
    let s = &spec.validate.scenario;
    let mut worst = 0.0f64;
    for i in 0..5 {
        for j in 0..5 {
            let between = |(a, b): (f64, f64), k: usize| a + (b - a) * k as f64 / 4.0;
            let demand = Reference {
                torque_nm: between(s.torque_nm, i),
                lambda: 1.0,
                speed_rpm: between(s.speed_rpm, j),
            };
            // Starts elsewhere, so that the window has seen a transient before it comes to rest.
            let mut record = vec![Reference { torque_nm: demand.torque_nm + 10.0, ..demand }; 40];
            record.extend(vec![demand; 400]);
            let at_rest = *map.drive(&record, spec.sample_time_s).last()?;
            let steady = map.steady(demand);
            for c in 0..3 {
                let range = map.limits.upper[c] - map.limits.lower[c];
                worst = worst.max((at_rest[c] - steady[c]).abs() / range);
            }
        }
    }
    Some(worst)
}

/// Runs a short calibration, runs it again, and runs it interrupted: the files must come out the same.
pub(super) fn interruption(
    name: &str,
    spec: &CalibrateSpec,
    around: &Surroundings,
) -> Result<Value, StudyError> {
    let campaign = |part: &str| Campaign {
        name: name.into(),
        spec: spec.clone(),
        out: around.runs.join(format!("{name}-{part}")),
    };
    let run = |c: &Campaign, resumed: &AtomicUsize| {
        let tell = |e: Event| {
            if let Event::Resumed(_) = e {
                resumed.fetch_add(1, Ordering::Relaxed);
            }
        };
        job::run(c, "validate", &tell, around.watch.interrupt)
    };
    let (whole, broken) = (campaign("whole"), campaign("broken"));
    let none = AtomicUsize::new(0);
    let first = run(&whole, &none)?;
    let bytes = text(&first.summary)?;
    let resumed_whole = AtomicUsize::new(0);
    let again = run(&whole, &resumed_whole)?;

    // Interrupted as Ctrl-C does it, once the optimisation has begun.
    let asked = AtomicBool::new(false);
    let tell = |e: Event| {
        if let Event::Step(_, _, "optimise") = e {
            asked.store(true, Ordering::Relaxed);
        }
    };
    let stop = || asked.load(Ordering::Relaxed) || around.watch.interrupted();
    let left = clean(&broken.out).and_then(|()| match job::run(&broken, "validate", &tell, &stop) {
        Err(ChainError::Interrupted) => Ok(true),
        Ok(_) => Ok(false),
        Err(e) => Err(e.into()),
    })?;
    let kept = (0..STEPS.len())
        .filter(|k| dynocal_jobs::calibrate::store::step_folder(&broken.out, *k).join("step.json").exists())
        .count();
    let resumed_broken = AtomicUsize::new(0);
    let completed = run(&broken, &resumed_broken)?;
    Ok(json!({
        "steps": STEPS.len(),
        "resumed": resumed_whole.into_inner(),
        "resume_same_bytes": bytes == text(&again.summary)?,
        "interrupted": left,
        "steps_kept": kept,
        "steps_resumed": resumed_broken.into_inner(),
        "completed_same_bytes": bytes == text(&completed.summary)?,
        "completed_same_report": text(&first.report)? == text(&completed.report)?,
    }))
}

/// Takes away what an earlier, unfinished task left.
fn clean(folder: &Path) -> Result<(), StudyError> {
    if folder.exists() {
        std::fs::remove_dir_all(folder)
            .map_err(|e| FilesError::Write { path: folder.display().to_string(), reason: e.to_string() })?;
    }
    Ok(())
}
