//! `dynocal study benchmarks` at reduced length.

use assert_cmd::Command;
use serde_json::Value;

#[test]
fn reduced_length_runs_both_kinds_on_the_tanks() {
    let Some(data) = std::env::var_os("DYNOCAL_REFERENCE_DIR") else {
        println!("SKIPPED: DYNOCAL_REFERENCE_DIR is not set");
        return;
    };
    let tmp = tempfile::tempdir().unwrap();
    let mut command = Command::cargo_bin("dynocal").unwrap();
    command.current_dir(tmp.path()).env_remove("DYNOCAL_REFERENCE_DIR").arg("study").arg("benchmarks");
    let out = command.args(["--quick", "--out", "run", "--json", "--data"]).arg(&data).output().unwrap();
    let summary: Value = serde_json::from_slice(&out.stdout).unwrap();
    let checks = summary["checks"].as_array().unwrap();
    let ids: Vec<&str> = checks.iter().map(|c| c["id"].as_str().unwrap()).collect();
    assert_eq!(ids, ["cascaded_tanks-official_test", "cascaded_tanks_neural-official_test"]);
    for c in checks {
        // The level spreads by more than 2 V: a free run that says anything is below that, and above the best known.
        let rmse = c["measured"].as_f64().unwrap();
        assert!((0.19..2.0).contains(&rmse), "{c}");
    }
    let page = std::fs::read_to_string(tmp.path().join("run/report.html")).unwrap();
    assert!(page.contains("Cascaded tanks, polynomial"));
}

#[test]
fn data_that_are_nowhere_are_named() {
    let tmp = tempfile::tempdir().unwrap();
    let mut command = Command::cargo_bin("dynocal").unwrap();
    command.current_dir(tmp.path()).env_remove("DYNOCAL_REFERENCE_DIR");
    let out = command.args(["study", "benchmarks", "--quick", "--out", "run"]).output().unwrap();
    let text = String::from_utf8(out.stderr).unwrap();
    assert_eq!(out.status.code(), Some(2), "{text}");
    assert!(text.contains("DYNOCAL_REFERENCE_DIR") && text.contains("--data"), "{text}");
}
