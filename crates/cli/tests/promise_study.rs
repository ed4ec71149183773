//! `dynocal study promise` at reduced length.

use assert_cmd::Command;
use serde_json::Value;

#[test]
fn every_calibration_is_judged_by_what_was_measured() {
    let tmp = tempfile::tempdir().unwrap();
    let mut command = Command::cargo_bin("dynocal").unwrap();
    command.current_dir(tmp.path()).args(["study", "promise", "--quick", "--out", "run", "--json"]);
    let out = command.output().unwrap();
    let text = String::from_utf8_lossy(&out.stderr);
    let summary: Value = serde_json::from_slice(&out.stdout).unwrap_or_else(|e| panic!("{e}: {text}"));
    let checks = summary["checks"].as_array().unwrap();
    let of = |id: &str| checks.iter().find(|c| c["id"] == id).unwrap_or_else(|| panic!("{id}: {summary}"));
    // The map of so short a run must not be used, and then nothing can be said of what beats it.
    assert_eq!(of("failed")["measured"], 0.0, "{}", of("failed"));
    assert_eq!(
        (&of("thesis-usable")["measured"], &of("thesis-usable")["holds"]),
        (&0.0.into(), &false.into())
    );
    assert_eq!(
        (&of("thesis-beaten")["measured"], &of("thesis-beaten")["holds"]),
        (&Value::Null, &false.into())
    );
    assert_eq!(out.status.code(), Some(1), "{text}");
    // Promise and bed time are those of the run, gains left out.
    let run = std::fs::read_to_string(tmp.path().join("run/runs/thesis-1/summary.json")).unwrap();
    let run: Value = serde_json::from_str(&run).unwrap();
    let (pass, bed) = (&run["passes"][0], &run["bed"]);
    let gap = 100.0 * (pass["measured_ratio"].as_f64().unwrap() - pass["promised_ratio"].as_f64().unwrap());
    assert_eq!(of("thesis-promise")["measured"], if gap.abs() <= 1.0 { 1.0 } else { 0.0 });
    assert!(of("thesis-promise")["note"].as_str().unwrap().ends_with(&format!("{gap:+.2}")), "{gap}");
    let part = |key: &str| bed[key].as_f64().unwrap();
    assert!(
        (of("thesis-bed-time")["measured"].as_f64().unwrap() - (part("total_s") - part("loops_s"))).abs()
            < 1e-9
    );
    assert!(part("loops_s") > 0.0);
    let page = std::fs::read_to_string(tmp.path().join("run/report.html")).unwrap();
    assert!(page.contains("usable is the map by its own verdict") && page.contains("thesis"));
}
