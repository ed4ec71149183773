//! `dynocal study chapter6` at reduced length.

use assert_cmd::Command;
use serde_json::Value;

#[test]
fn reduced_length_makes_the_published_map_and_quicker_ones() {
    let tmp = tempfile::tempdir().unwrap();
    let mut command = Command::cargo_bin("dynocal").unwrap();
    command.current_dir(tmp.path()).args(["study", "chapter6", "--quick", "--out", "run", "--json"]);
    let out = command.output().unwrap();
    let text = String::from_utf8_lossy(&out.stderr);
    let summary: Value = serde_json::from_slice(&out.stdout).unwrap_or_else(|e| panic!("{e}: {text}"));
    let checks = summary["checks"].as_array().unwrap();
    let of = |id: &str| checks.iter().find(|c| c["id"] == id).unwrap_or_else(|| panic!("{id}: {summary}"));
    let held = checks.iter().all(|c| c["holds"] != false);
    assert_eq!(out.status.code(), Some(i32::from(!held)), "{text}");
    // What must be so at any length: the map's sparks give more work for the fuel, and the maps agree.
    assert_eq!(of("economy-ratio")["holds"], true, "{}", of("economy-ratio"));
    assert_eq!(of("random-better")["holds"], true, "{}", of("random-better"));
    for way in ["settled", "bracketed", "scattered", "ramped"] {
        for what in ["fuel", "torque", "unreached"] {
            let c = of(&format!("{way}-{what}"));
            assert_eq!(c["holds"], true, "{c}");
        }
    }
    let page = std::fs::read_to_string(tmp.path().join("run/report.html")).unwrap();
    assert!(page.contains("4 of 4 points on their demands"), "points");
}
