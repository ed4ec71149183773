//! `dynocal study limits` at reduced length.

use assert_cmd::Command;
use serde_json::Value;

#[test]
fn reduced_length_identifies_and_limits() {
    let Some(data) = std::env::var_os("DYNOCAL_REFERENCE_DIR") else {
        println!("SKIPPED: DYNOCAL_REFERENCE_DIR is not set");
        return;
    };
    let tmp = tempfile::tempdir().unwrap();
    let mut command = Command::cargo_bin("dynocal").unwrap();
    command.current_dir(tmp.path()).env_remove("DYNOCAL_REFERENCE_DIR").args(["study", "limits"]);
    let out = command.args(["--quick", "--out", "run", "--json", "--data"]).arg(&data).output().unwrap();
    let text = String::from_utf8_lossy(&out.stderr);
    let summary: Value = serde_json::from_slice(&out.stdout).unwrap_or_else(|e| panic!("{e}: {text}"));
    let checks = summary["checks"].as_array().unwrap();
    let of = |id: &str| checks.iter().find(|c| c["id"] == id).unwrap_or_else(|| panic!("{id}: {summary}"));
    // Reduced length proves that everything runs: the limit need not be solved on models of a minute each.
    let solved = of("solved")["measured"].as_f64().unwrap_or_else(|| panic!("{text}"));
    for id in ["kept", "price-monotone"] {
        assert!(of(id)["measured"].is_number(), "{}", of(id));
        assert!(solved > 0.0 || of(id)["holds"] == true, "{}", of(id));
    }
    let held = checks.iter().all(|c| c["holds"] != false);
    assert_eq!(out.status.code(), Some(i32::from(!held)), "{text}");
    // Models of a minute each; that they say something is all that is asked.
    assert!(of("model-torque")["measured"].as_f64().unwrap() > 50.0, "{}", of("model-torque"));
    let page = std::fs::read_to_string(tmp.path().join("run/report.html")).unwrap();
    assert!(page.contains("What less nitric oxide costs"));
}

#[test]
fn a_cycle_that_is_nowhere_is_named() {
    let tmp = tempfile::tempdir().unwrap();
    let mut command = Command::cargo_bin("dynocal").unwrap();
    command.current_dir(tmp.path()).env_remove("DYNOCAL_REFERENCE_DIR");
    let out = command.args(["study", "limits", "--quick", "--out", "run"]).output().unwrap();
    let text = String::from_utf8(out.stderr).unwrap();
    assert_eq!(out.status.code(), Some(2), "{text}");
    assert!(text.contains("--data") && text.contains("drive_cycles"), "{text}");
}
