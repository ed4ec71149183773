//! `dynocal study loops --quick`: all tasks run, and what does not depend on their length holds.

use assert_cmd::Command;
use serde_json::Value;

#[test]
fn the_reduced_study_runs_and_its_exact_checks_hold() {
    let tmp = tempfile::tempdir().unwrap();
    let run = || {
        let out = Command::cargo_bin("dynocal")
            .unwrap()
            .current_dir(tmp.path())
            .args(["study", "loops", "--quick", "--json", "--out", "run"])
            .output()
            .unwrap();
        // Statistics of two seeds may miss what is asked of twenty: 0 or 1, but never 2.
        assert!(matches!(out.status.code(), Some(0 | 1)), "{}", String::from_utf8_lossy(&out.stderr));
        String::from_utf8(out.stdout).unwrap()
    };
    let first = run();
    let summary: Value = serde_json::from_str(&first).unwrap();
    let checks = summary["checks"].as_array().unwrap();
    for id in ["black-box-prbs-rank", "black-box-design-rank", "black-box-lambda"] {
        let check = checks.iter().find(|c| c["id"] == id).unwrap();
        assert_eq!(check["holds"], true, "{check}");
    }
    // One number of every task.
    for id in [
        "black-box-nonlinear-udrn",
        "limits-affine",
        "pool-d",
        "robust-mean",
        "two-outputs-torque",
        "sequential-engine",
    ] {
        let check = checks.iter().find(|c| c["id"] == id).unwrap();
        assert!(check["measured"].is_number(), "{check}");
    }
    let report = std::fs::read_to_string(tmp.path().join("run/report.html")).unwrap();
    for id in ["black-box", "limits", "pools", "robust", "two-outputs", "sequential"] {
        assert!(report.contains(&format!("<section id=\"{id}\"")), "no section {id}");
    }
    assert_eq!(run(), first, "a second run takes the finished tasks over");
}
