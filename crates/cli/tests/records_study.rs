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
    let chosen = of("thesis-chosen-2");
    assert!(chosen["asked"].is_null() && chosen["measured"].as_f64().unwrap() > 0.0, "{chosen}");
    assert!(
        chosen["note"].as_str().unwrap().contains("error over that of as many random records"),
        "{chosen}"
    );
    let auto = of("thesis-design-auto");
    assert_eq!(auto["asked"], ">= 1");
    assert_eq!(auto["holds"], auto["measured"].as_f64().is_some_and(|m| m >= 1.0), "{auto}");
    // So short a record of a real bed leaves structure in every model.
    assert!(auto["note"].as_str().unwrap().ends_with("chosen levels in 2 of 2"), "{auto}");
    // What the study says of an arm is in its run.
    let run = std::fs::read_to_string(tmp.path().join("run/runs/thesis-1/design-auto/summary.json")).unwrap();
    let run: Value = serde_json::from_str(&run).unwrap();
    let choice = run["design"]["choice"].as_array().unwrap();
    assert_eq!(choice.len(), 3, "two outputs, and what was made of it: {choice:?}");
    assert!(choice.iter().all(Value::is_string));
    let page = std::fs::read_to_string(tmp.path().join("run/report.html")).unwrap();
    let told = "thesis, seed 1, lack of fit: torque: what the model leaves changes slowly";
    assert!(page.contains(told), "{choice:?}");
}
