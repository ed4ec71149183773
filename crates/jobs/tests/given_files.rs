//! Files that a campaign is given are opened, and compared with it, before anything runs.

use dynocal_files::atomic;
use dynocal_jobs::calibrate::job;
use std::path::Path;

/// A record of the thesis' channels; `torque` is the head of its column, `dt_s` the distance of its rows.
fn record(path: &Path, torque: &str, dt_s: f64) {
    record_about(path, torque, dt_s, 40.0);
}

fn record_about(path: &Path, torque: &str, dt_s: f64, mean_nm: f64) {
    let mut text = format!("time [s],inj [mg],spark [deg],throttle [deg],speed [rpm],{torque},lambda [-]\n");
    for t in 0..400 {
        let u = f64::from(t);
        text.push_str(&format!(
            "{:.4},{:.3},{:.2},{:.3},2000,{:.3},{:.4}\n",
            u * dt_s,
            12.0 + (0.1 * u).sin(),
            15.0,
            11.0 + (0.07 * u).cos(),
            mean_nm + 3.0 * (0.05 * u).sin(),
            1.0
        ));
    }
    atomic::write(path, text.as_bytes()).unwrap();
}

/// What is said of a spec in `folder` whose records are `files`; empty where they fit.
fn said(folder: &Path, files: &str) -> String {
    let spec = folder.join("spec.toml");
    let text = format!("[excite]\nidentification_files = [{files}]\nvalidation_files = [\"unseen.csv\"]\n");
    atomic::write(&spec, text.as_bytes()).unwrap();
    let campaign = job::read(&spec, None, None).unwrap();
    job::check_given(&campaign).err().map(|e| e.to_string()).unwrap_or_default()
}

#[test]
fn records_are_relative_to_the_spec_and_must_fit() {
    let tmp = tempfile::tempdir().unwrap();
    let folder = tmp.path();
    record(&folder.join("good.csv"), "torque [Nm]", 0.03);
    record_about(&folder.join("unseen.csv"), "torque [Nm]", 0.03, 50.0);
    record(&folder.join("feet.csv"), "torque [lb ft]", 0.03);
    record(&folder.join("wrong.csv"), "torque [kPa]", 0.03);
    record(&folder.join("slow.csv"), "torque [Nm]", 0.04);
    record(&folder.join("other.csv"), "moment [Nm]", 0.03);
    // The test does not stand in that folder: the paths are those of the spec.
    assert_eq!(said(folder, "\"good.csv\""), "");
    assert_eq!(said(folder, "\"good.csv\", \"feet.csv\""), "", "lb ft converts to Nm");
    for (files, parts) in [
        ("\"gone.csv\"", vec!["gone.csv"]),
        ("\"wrong.csv\"", vec!["excite.identification_files", "wrong.csv", "`torque` is in kPa", "Nm"]),
        ("\"slow.csv\"", vec!["excite.identification_files", "slow.csv", "0.04 s", "0.03 s"]),
        ("\"good.csv\", \"other.csv\"", vec!["other.csv", "torque"]),
    ] {
        let text = said(folder, files);
        assert!(parts.iter().all(|p| text.contains(p)), "{files}: {text}");
    }
}

/// A copy under another name is the same record.
#[test]
fn what_identifies_is_not_called_unseen() {
    let tmp = tempfile::tempdir().unwrap();
    let folder = tmp.path();
    record(&folder.join("good.csv"), "torque [Nm]", 0.03);
    record(&folder.join("unseen.csv"), "torque [Nm]", 0.03);
    let text = said(folder, "\"good.csv\"");
    assert!(text.contains("excite.validation_files") && text.contains("the same samples as"), "{text}");
}
