//! `dynocal study dynamic` at reduced length.

use assert_cmd::Command;
use serde_json::Value;

#[test]
fn fuel_by_an_identified_model_beats_every_rival_in_steps() {
    let tmp = tempfile::tempdir().unwrap();
    let mut command = Command::cargo_bin("dynocal").unwrap();
    let args = ["study", "dynamic", "--quick", "--out", "run", "--json"];
    let out = command.current_dir(tmp.path()).args(args).output().unwrap();
    let text = String::from_utf8_lossy(&out.stderr);
    let summary: Value = serde_json::from_slice(&out.stdout).unwrap_or_else(|e| panic!("{e}: {text}"));
    let checks = summary["checks"].as_array().unwrap();
    let of = |id: &str| checks.iter().find(|c| c["id"] == id).unwrap_or_else(|| panic!("{id}: {summary}"));
    // On fewer points than the study has: better than every rival; by how much is the study's matter.
    for id in ["1-steps-integral", "1-steps-spike"] {
        assert!(of(id)["measured"].as_f64().unwrap() < 1.0, "{}", of(id));
    }
    assert_eq!(of("failed")["measured"], 0.0, "{}", of("failed"));
    let held = checks.iter().all(|c| c["holds"] != false);
    assert_eq!(out.status.code(), Some(i32::from(!held)), "{text}");
    let page = std::fs::read_to_string(tmp.path().join("run/report.html")).unwrap();
    assert!(page.contains("identified air and film") && page.contains("ECU, extrapolated, film"));
}
