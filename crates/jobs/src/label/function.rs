//! Labels of any function that a spec describes: nodes, labels, channels, what it is compared with.

mod axes;
pub mod build;
pub mod coarse;
mod judge;
mod moves;
mod outside;
pub mod page;
mod record;
mod said;
pub mod spec;
pub mod work;

use dynocal_export::characteristic::{Axis, Characteristic};
use dynocal_export::format;
use dynocal_export::package::Package;
use dynocal_files::atomic;
use dynocal_files::run_folder::RunFolder;
use dynocal_label::ve::judge::Decision;
use dynocal_numerics::interval::Interval;
use dynocal_numerics::watch::Watch;

use super::result::LabelJobError;
pub use spec::Job;
pub use work::Fitted;

/// Fits, judges, and writes `LABELS.dcm`, `report.html` and `summary.json` into the run folder; labels that explain unseen samples worse
/// than their base are not written.
///
/// # Errors
/// [`LabelJobError`].
pub fn run(job: &Job, watch: Watch) -> Result<(Fitted, RunFolder), LabelJobError> {
    let folder = RunFolder::open_at(&job.out, "label", job)?;
    let mut found = work::fit(job, watch)?;
    if found.valid && found.decision == Decision::Change {
        let package =
            Package { name: "LABELS".into(), characteristics: characteristics(&found), ..Package::default() };
        for file in format::write(&package, "dcm", &format::Keys::default())? {
            atomic::write(&folder.path().join(&file.name), &file.bytes)?;
            found.files.push(file.name);
        }
    }
    found.files.push("report.html".into());
    page::write(&found, folder.path())?;
    folder.write_summary(&found)?;
    Ok((found, folder))
}

fn characteristics(found: &Fitted) -> Vec<Characteristic> {
    let mut from = 0;
    let mut out = Vec::new();
    for (number, l) in found.labels.iter().enumerate() {
        // Breakpoints that were fitted leave as axes of the labels on them.
        if found.fitted_axes.iter().any(|a| a.label == number) {
            from += l.len();
            continue;
        }
        // The calibration tools list both axes of a map in one way.
        let shared = l.axes.iter().any(|a| found.shared.contains(&a.name));
        let axis = |a: &dynocal_label::label::Axis| Axis {
            name: a.name.clone(),
            description: String::new(),
            unit: a.unit.clone(),
            input: a.name.clone(),
            points: a.points.clone(),
            shared,
        };
        let bounded = l.lower.is_finite() && l.upper.is_finite();
        out.push(Characteristic {
            name: l.name.clone(),
            description: String::new(),
            unit: l.unit.clone(),
            axes: l.axes.iter().map(axis).collect(),
            values: found.fit.values[from..from + l.len()].to_vec(),
            limits: bounded.then(|| Interval::new(l.lower, l.upper)),
        });
        from += l.len();
    }
    out
}
