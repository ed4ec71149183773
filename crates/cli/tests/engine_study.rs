//! `dynocal study engine` at reduced length.

use std::path::Path;

use assert_cmd::Command;
use serde_json::Value;

/// Points at 2000 rpm of the reference table.
fn reference() -> String {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../tests/reference/virtual_engine_points.json");
    path.display().to_string()
}

fn study(folder: &Path, args: &[&str]) -> (i32, String, String) {
    let mut command = Command::cargo_bin("dynocal").unwrap();
    command.current_dir(folder).env_remove("DYNOCAL_REFERENCE_DIR").args(["study", "engine", "--quick"]);
    let out = command.args(args).output().unwrap();
    let text = |bytes| String::from_utf8(bytes).unwrap();
    (out.status.code().unwrap(), text(out.stdout), text(out.stderr))
}

fn check<'a>(summary: &'a Value, id: &str) -> &'a Value {
    summary["checks"].as_array().unwrap().iter().find(|c| c["id"] == id).unwrap()
}

#[test]
fn checks_with_a_reference_and_an_honest_word_without() {
    let tmp = tempfile::tempdir().unwrap();
    let file = reference();
    let (code, stdout, stderr) = study(tmp.path(), &["--out", "run", "--json", "--reference", &file]);
    let summary: Value = serde_json::from_str(&stdout).unwrap();
    // The exit code is that of the checks: some class values are missed, and the study says so.
    let missed = |s: &Value| s["checks"].as_array().unwrap().iter().any(|c| c["holds"] == false);
    assert_eq!(code, i32::from(missed(&summary)), "{stderr}");
    // The reduced map and the reference share the points at 2000 rpm and some of these torques.
    let all: Value = serde_json::from_str(&std::fs::read_to_string(&file).unwrap()).unwrap();
    let shared = |r: &&Value| [0.0, 30.0, 70.0, 100.0].contains(&r["torque_Nm"].as_f64().unwrap());
    let n = all["static_reference"].as_array().unwrap().iter().filter(shared).count();
    assert_eq!(check(&summary, "reference")["asked"], format!(">= {n}"));
    assert!(n >= 2);
    assert_eq!(check(&summary, "reference")["holds"], true);
    assert_eq!(check(&summary, "spark-fuel")["holds"], true);
    let page = std::fs::read_to_string(tmp.path().join("run/report.html")).unwrap();
    assert!(page.contains("Thesis and prototype") && page.trim_end().ends_with("</html>"));

    // A reference that differs by more than the tolerance fails the study: the comparison is not a formality.
    let mut wrong: Value = serde_json::from_str(&std::fs::read_to_string(&file).unwrap()).unwrap();
    for row in wrong["static_reference"].as_array_mut().unwrap() {
        row["inj_mg"] = (row["inj_mg"].as_f64().unwrap() * 1.01).into();
    }
    dynocal_files::atomic::write(&tmp.path().join("wrong.json"), wrong.to_string().as_bytes()).unwrap();
    let (code, stdout, _) = study(tmp.path(), &["--out", "run", "--json", "--reference", "wrong.json"]);
    let summary: Value = serde_json::from_str(&stdout).unwrap();
    assert_eq!((code, &check(&summary, "reference-fuel")["holds"]), (1, &Value::Bool(false)));

    // Without one, nothing is claimed about it; the other tasks are taken over from the run above.
    let (code, stdout, _) = study(tmp.path(), &["--out", "run", "--json"]);
    let summary: Value = serde_json::from_str(&stdout).unwrap();
    assert_eq!((code, &check(&summary, "reference")["holds"]), (i32::from(missed(&summary)), &Value::Null));
    assert!(check(&summary, "reference")["note"].as_str().unwrap().contains("not compared"));
}

#[test]
fn a_reference_that_cannot_be_read_is_named() {
    let tmp = tempfile::tempdir().unwrap();
    let (code, _, stderr) = study(tmp.path(), &["--out", "run", "--reference", "nowhere.json"]);
    assert!(code == 2 && stderr.contains("nowhere.json"), "{stderr}");
    dynocal_files::atomic::write(
        &tmp.path().join("odd.json"),
        b"{\"static_reference\": [{\"speed_rpm\": 1000}]}",
    )
    .unwrap();
    let (code, _, stderr) = study(tmp.path(), &["--out", "run", "--reference", "odd.json"]);
    assert!(code == 2 && stderr.contains("odd.json") && stderr.contains("torque_Nm"), "{stderr}");
}
