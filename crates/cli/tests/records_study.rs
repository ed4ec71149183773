//! `dynocal study records` at reduced length.

use assert_cmd::Command;
use serde_json::Value;

#[test]
fn records_count_by_the_minutes_that_random_levels_need() {
    let tmp = tempfile::tempdir().unwrap();
    let mut command = Command::cargo_bin("dynocal").unwrap();
    command.current_dir(tmp.path()).args(["study", "records", "--quick", "--out", "run", "--json"]);
    let out = command.output().unwrap();
    let text = String::from_utf8_lossy(&out.stderr);
    let summary: Value = serde_json::from_slice(&out.stdout).unwrap_or_else(|e| panic!("{e}: {text}"));
    let checks = summary["checks"].as_array().unwrap();
    let of = |id: &str| checks.iter().find(|c| c["id"] == id).unwrap_or_else(|| panic!("{id}: {summary}"));
    assert_eq!(of("failed")["measured"], 0.0, "{}", of("failed"));
    // Records of random levels are what is counted in, and have no row.
    assert_eq!(checks.len(), 3, "{summary}");
    for id in ["thesis-chosen-2", "thesis-design-auto"] {
        assert_eq!(of(id)["asked"], ">= 1");
        assert!(of(id)["holds"].is_boolean(), "{}", of(id));
    }
    // What the study says of an arm is in its run.
    let run = std::fs::read_to_string(tmp.path().join("run/runs/thesis-1/design-auto/summary.json")).unwrap();
    let run: Value = serde_json::from_str(&run).unwrap();
    let choice = run["design"]["choice"].as_array().unwrap();
    assert_eq!(choice.len(), 3, "two outputs, and what was made of it: {choice:?}");
    assert!(choice.iter().all(Value::is_string));
    let page = std::fs::read_to_string(tmp.path().join("run/report.html")).unwrap();
    assert!(page.contains("Minutes of random levels") && page.contains("lack of fit"));
}
