//! The run folder of identified fuelling.

use std::path::Path;

use dynocal_calib::fuelling::Fuelling;
use dynocal_files::json;
use dynocal_files::run_folder::RunFolder;

use super::page;
use super::records::Record;
use super::result::{Fuelled, FuellingJobError, Seen};
use super::stored::{FUELLING_FILE, FUELLING_SCHEMA, FUELLING_VERSION};
use crate::kept;

/// Rows of the table of the throttle.
const THROTTLE_STEPS: usize = 20;

/// Writes the model, what was driven, the page and the summary. A model that must not be used is written too and says so of itself:
/// it is not exported.
///
/// # Errors
/// [`FuellingJobError::Files`], [`FuellingJobError::Page`].
pub fn write(folder: &RunFolder, found: &Fuelled) -> Result<(), FuellingJobError> {
    let path = folder.path();
    json::write_versioned(&path.join(FUELLING_FILE), FUELLING_SCHEMA, FUELLING_VERSION, &found.stored())?;
    let mut files = vec!["report.html".to_string(), FUELLING_FILE.into()];
    // Records that were read from files stay there.
    if !found.driven.is_empty() {
        for shown in &found.records {
            files.push(record(path, &shown.record)?);
        }
    }
    page::write(found, path)?;
    folder.write_summary(&Fuelled { files, ..found.clone() })?;
    Ok(())
}

/// Throttle angle and choked flow, as fuel at lambda 1 per s and cylinder, over what was seen.
pub(crate) fn throttle(f: &Fuelling, seen: &Seen) -> Vec<[f64; 2]> {
    let [low, high] = seen.throttle_deg;
    let angle = |k: usize| low + (high - low) * k as f64 / THROTTLE_STEPS as f64;
    let flow = |k: usize| f.filling.inflow(angle(k), 0.0, f.filling.upstream_kpa);
    (0..=THROTTLE_STEPS).map(|k| [angle(k), flow(k)]).collect()
}

/// What was driven, sample by sample.
fn record(folder: &Path, r: &Record) -> Result<String, FuellingJobError> {
    let time: Vec<f64> = (0..r.lambda.len()).map(|t| t as f64 * r.sample_time_s).collect();
    let mut columns: Vec<(&str, &str, &[f64])> = vec![
        ("time", "s", &time),
        ("speed", "rpm", &r.speed_rpm),
        ("throttle", "deg", &r.throttle_deg),
        ("inj", &r.injection_unit, &r.injection),
        ("map", "kPa", &r.map_kpa),
        ("lambda", "-", &r.lambda),
    ];
    if let Some(boost) = &r.boost_kpa {
        columns.push(("boost", "kPa", boost));
    }
    if let Some(coolant) = &r.coolant_c {
        columns.push(("coolant", "degC", coolant));
    }
    if let Some([intake, exhaust]) = &r.cams_deg {
        columns.extend([("intake_cam", "deg", intake.as_slice()), ("exhaust_cam", "deg", exhaust)]);
    }
    let stem: String =
        r.name.chars().map(|c| if c.is_alphanumeric() || "-_.".contains(c) { c } else { '_' }).collect();
    Ok(kept::write_columns(folder, &stem, &columns)?)
}
