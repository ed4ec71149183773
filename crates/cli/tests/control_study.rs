//! `dynocal study control` at reduced length.

use assert_cmd::Command;
use serde_json::Value;

#[test]
fn loops_about_the_engine_have_figures_and_tests_for_control() {
    let tmp = tempfile::tempdir().unwrap();
    let mut command = Command::cargo_bin("dynocal").unwrap();
    let args = ["study", "control", "--quick", "--out", "run", "--json"];
    let out = command.current_dir(tmp.path()).args(args).output().unwrap();
    let text = String::from_utf8_lossy(&out.stderr);
    let summary: Value = serde_json::from_slice(&out.stdout).unwrap_or_else(|e| panic!("{e}: {text}"));
    let checks = summary["checks"].as_array().unwrap();
    let of = |id: &str| checks.iter().find(|c| c["id"] == id).unwrap_or_else(|| panic!("{id}: {summary}"));
    assert_eq!(of("failed")["measured"], 0.0, "{}", of("failed"));
    // The predictor is nearer to the undelayed loop than the same PI without it; by how much is the study's matter.
    let share = |id: &str| of(id)["measured"].as_f64().unwrap();
    assert!(share("smith-5") < share("smith-5-same-pi"), "{}", of("smith-5"));
    assert!(share("test-for-control") < 100.0, "{}", of("test-for-control"));
    let held = checks.iter().all(|c| c["holds"] != false);
    assert_eq!(out.status.code(), Some(i32::from(!held)), "{text}");
    let page = std::fs::read_to_string(tmp.path().join("run/report.html")).unwrap();
    for part in ["Figure 7.22", "Figure 7.24", "Figure 7.26", "Figures 7.29 and 7.30"] {
        assert!(page.contains(part), "{part}");
    }
}
