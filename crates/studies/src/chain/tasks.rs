//! Tasks of the study `chain`.

use std::path::Path;
use std::sync::atomic::{AtomicBool, Ordering};

use dynocal_calib::validate::MapScore;
use dynocal_files::FilesError;
use dynocal_jobs::calibrate::error::ChainError;
use dynocal_jobs::calibrate::records::RecordRef;
use dynocal_jobs::calibrate::run::{ChainResult, STEPS};
use dynocal_jobs::calibrate::spec::CalibrateSpec;
use dynocal_numerics::status::Status;
use dynocal_numerics::watch::Watch;
use serde::{Deserialize, Serialize};
use serde_json::{Value, json};

use crate::{StudyError, Surroundings};
use dynocal_jobs::calibrate::job::{self, Campaign};

/// Ids of the sections that a complete report has.
const SECTIONS: [&str; 9] =
    ["result", "excite", "models", "design", "optimise", "maps", "validate", "spec", "files"];

/// What the study keeps of one calibration: the numbers behind its checks.
#[derive(Clone, Debug, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct Calibrated {
    /// Whether the run calls its map usable.
    pub(super) valid: bool,
    /// Lambda that 1 % and 99 % of the identification samples lie below.
    pub(super) excited_lambda: Option<(f64, f64)>,
    /// The same of the designed record.
    pub(super) designed_lambda: Option<(f64, f64)>,
    /// Free-run R2 on unseen records after the last pass, by output.
    pub(super) final_r2: Vec<(String, Option<f64>)>,
    /// R2 gained by the designed record over the identification records, by output.
    pub(super) design_gain: Vec<(String, Option<f64>)>,
    /// R2 of the designed record less that of one more record of the first recipe, by output.
    pub(super) design_against_rival: Vec<(String, Option<f64>)>,
    /// Passes, and those whose optimum is not usable.
    pub(super) passes: usize,
    pub(super) unusable_passes: usize,
    pub(super) unconverged_passes: usize,
    /// Largest violation of a demand on the models, by output.
    pub(super) violations: Vec<(String, f64)>,
    /// Ratios of the last pass.
    pub(super) promised_ratio: Option<f64>,
    pub(super) measured_ratio: Option<f64>,
    /// Ratio with the static map's spark on the same record, and the share of its saving that was reached.
    pub(super) static_ratio: Option<f64>,
    pub(super) share_of_saving: Option<f64>,
    /// Tuned lag of the rival in s.
    pub(super) lag_s: Option<f64>,
    /// All scores.
    pub(super) maps: Vec<MapScore>,
    /// Bed times in s.
    /// Beyond the gains of the loops, which the static map needs as well.
    pub(super) bed_s: f64,
    pub(super) static_bed_s: Option<f64>,
    pub(super) validation_bed_s: Option<f64>,
    /// Sections that the report lacks.
    pub(super) report_missing: Vec<String>,
}

/// A calibration in a folder of its own.
pub(super) fn calibrate(
    name: &str,
    spec: &CalibrateSpec,
    around: &Surroundings,
) -> Result<Value, StudyError> {
    let campaign = Campaign { name: name.into(), spec: spec.clone(), out: around.runs.join(name).into() };
    let note = |text: &str| around.watch.note(&format!("  {text}"));
    let watch = Watch { interrupt: around.watch.interrupt, note: &note, ..Watch::silent() };
    let done = job::run(&campaign, "validate", watch)?;
    let html = text(&done.report)?;
    let mut missing: Vec<String> = SECTIONS
        .into_iter()
        .filter(|id| !html.contains(&format!("<section id=\"{id}\"")))
        .map(str::to_string)
        .collect();
    if !html.trim_end().ends_with("</html>") {
        missing.push("its end".into());
    }
    let found = calibrated(&done, missing)?;
    serde_json::to_value(found).map_err(|e| StudyError::Result { task: name.into(), reason: e.to_string() })
}

fn calibrated(done: &job::Finished, report_missing: Vec<String>) -> Result<Calibrated, StudyError> {
    let r = &done.result;
    let excited = r.excite.as_ref().map(|d| (&d.folder, &d.result.identification));
    let designed = r.design.as_ref().map(|d| (&d.folder, &d.result.records));
    let passes = r.optimise.as_ref().map_or(&[][..], |d| &d.result.passes);
    let last = passes.last();
    let outputs = last.map_or(&[][..], |p| &p.models.outputs);
    let mut violations: Vec<(String, f64)> = Vec::new();
    for (m, violation) in passes.iter().flat_map(|p| &p.misses).filter_map(|m| Some((m, m.violation?))) {
        match violations.iter_mut().find(|(name, _)| *name == m.output) {
            Some((_, worst)) => *worst = worst.max(violation),
            None => violations.push((m.output.clone(), violation)),
        }
    }
    let v = r.validate.as_ref().map(|d| &d.result);
    let fixed = v.and_then(|v| v.static_on_record.as_ref());
    Ok(Calibrated {
        valid: done.valid,
        excited_lambda: excited.map(|(f, refs)| lambda_range(f, refs)).transpose()?.flatten(),
        designed_lambda: designed.map(|(f, refs)| lambda_range(f, refs)).transpose()?.flatten(),
        final_r2: outputs.iter().map(|o| (o.output.clone(), o.best().unseen_r2)).collect(),
        design_gain: gains(r, "identification"),
        design_against_rival: gains(r, "with one more"),
        passes: passes.len(),
        unusable_passes: passes.iter().filter(|p| !p.usable).count(),
        unconverged_passes: passes.iter().filter(|p| p.status != Status::Converged).count(),
        violations,
        promised_ratio: last.map(|p| p.promised_ratio),
        measured_ratio: last.map(|p| p.measured_ratio),
        static_ratio: fixed.map(|f| f.ratio),
        share_of_saving: fixed.and_then(|f| f.share_of_saving),
        lag_s: v.map(|v| v.lag_s),
        maps: v.map_or(Vec::new(), |v| v.scores.clone()),
        bed_s: r.bed_s() - r.loops_bed_s(),
        static_bed_s: v.map(|v| v.static_map.bed_s),
        validation_bed_s: r.excite.as_ref().map(|d| d.result.validation_bed_s),
        report_missing,
    })
}

/// R2 of the designed record less that of other identification data, by output.
fn gains(r: &ChainResult, base: &str) -> Vec<(String, Option<f64>)> {
    let Some(d) = r.design.as_ref().map(|d| &d.result) else { return Vec::new() };
    let of = |data: &str| d.gains.iter().find(|g| g.data.starts_with(data));
    let (Some(own), Some(other)) = (of("with the designed"), of(base)) else { return Vec::new() };
    let pairs = own.r2.iter().zip(&other.r2);
    pairs.map(|((name, a), (_, b))| (name.clone(), a.zip(*b).map(|(a, b)| a - b))).collect()
}

fn text(path: &Path) -> Result<String, StudyError> {
    std::fs::read_to_string(path)
        .map_err(|e| FilesError::Read { path: path.display().to_string(), reason: e.to_string() }.into())
}

/// Lambda that 1 % and 99 % of the samples of some records lie below; none where they have none.
fn lambda_range(folder: &Path, refs: &[RecordRef]) -> Result<Option<(f64, f64)>, StudyError> {
    let mut lambda = Vec::new();
    for r in refs {
        let record = dynocal_files::dataset::read_dataset(&folder.join(&r.file), &[], &[])?;
        lambda.extend_from_slice(record.values("lambda")?);
    }
    lambda.sort_by(f64::total_cmp);
    let at = |share: f64| lambda.get((share * (lambda.len().max(1) - 1) as f64) as usize).copied();
    Ok(at(0.01).zip(at(0.99)))
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
        out: around.runs.join(format!("{name}-{part}")).into(),
    };
    let quiet = Watch { interrupt: around.watch.interrupt, ..Watch::silent() };
    let run = |c: &Campaign| job::run(c, "validate", quiet);
    let (whole, broken) = (campaign("whole"), campaign("broken"));
    let first = run(&whole)?;
    let bytes = text(&first.summary)?;
    let again = run(&whole)?;

    // Interrupted as Ctrl-C does it, once the optimisation has begun.
    let asked = AtomicBool::new(false);
    let note = |text: &str| {
        if text.ends_with(": optimise") {
            asked.store(true, Ordering::Relaxed);
        }
    };
    let stop = || asked.load(Ordering::Relaxed) || around.watch.interrupted();
    let left = clean(&broken.out).and_then(|()| {
        match job::run(&broken, "validate", Watch { interrupt: &stop, note: &note, ..Watch::silent() }) {
            Err(ChainError::Interrupted) => Ok(true),
            Ok(_) => Ok(false),
            Err(e) => Err(e.into()),
        }
    })?;
    let kept = (0..STEPS.len())
        .filter(|k| dynocal_jobs::calibrate::store::step_folder(&broken.out, *k).join("step.json").exists())
        .count();
    let completed = run(&broken)?;
    Ok(json!({
        "steps": STEPS.len(),
        "resumed": again.result.resumed().len(),
        "resume_same_bytes": bytes == text(&again.summary)?,
        "interrupted": left,
        "steps_kept": kept,
        "steps_resumed": completed.result.resumed().len(),
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
