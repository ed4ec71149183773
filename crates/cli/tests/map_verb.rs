//! `dynocal map`: a small day on the virtual engine, from the command line to maps.

use std::path::Path;

use assert_cmd::Command;
use dynocal_files::atomic;
use serde_json::Value;

struct Outcome {
    code: i32,
    stdout: String,
    stderr: String,
}

fn dynocal(folder: &Path, args: &[&str]) -> Outcome {
    let out = Command::cargo_bin("dynocal").unwrap().current_dir(folder).args(args).output().unwrap();
    Outcome {
        code: out.status.code().unwrap(),
        stdout: String::from_utf8(out.stdout).unwrap(),
        stderr: String::from_utf8(out.stderr).unwrap(),
    }
}

/// Spark of the engine of the thesis, with the gains of its eq. (6.1) halved.
const SPEC: &str = r#"
title = "Spark"
sample_time_s = 0.03

[axes]
torque = [30.0, 50.0, 70.0]
speed = [1500.0, 2000.0, 2500.0]

[held]
lambda = 1.0

[problem]
minimise = [{ channel = "fuel", weight = 1.0 }]
[[problem.derive]]
name = "fuel"
unit = "kg/h"
factor = 3e-5
cylinders = 4
powers = { inj = 1, speed = 1 }
[[problem.inputs]]
name = "throttle"
unit = "deg"
lower = 1.0
upper = 60.0
[[problem.inputs]]
name = "inj"
unit = "mg"
lower = 2.0
upper = 40.0
[[problem.inputs]]
name = "spark"
unit = "deg"
lower = 5.0
upper = 40.0
[[problem.given]]
name = "speed"
unit = "rpm"
lower = 1400.0
upper = 2600.0
[[problem.demands]]
output = "torque"
unit = "Nm"
lower = 25.0
upper = 75.0
[[problem.demands]]
output = "lambda"
unit = "-"
lower = 0.9
upper = 1.1

[[loops]]
output = "torque"
input = "throttle"
gains = { ki = 0.075, kp = 0.0035 }
[[loops]]
output = "lambda"
input = "inj"
gains = { ki = -10.0, kp = -0.75 }

[bed]
points = 34
block = 13
[bed.refine]
share = 0.25
batch = 4

[optimise.whole]
steps = { spark = 10.0 }

[verify]
points = 3
"#;

fn map(folder: &Path, text: &str, more: &[&str]) -> Outcome {
    let spec = folder.join("spec.toml");
    atomic::write(&spec, text.as_bytes()).unwrap();
    dynocal(folder, &[&["map", spec.to_str().unwrap(), "--out", "run"], more].concat())
}

#[test]
fn a_day_ends_in_maps_that_are_exported_and_the_page_says_what_they_are_worth() {
    let tmp = tempfile::tempdir().unwrap();
    let o = map(tmp.path(), SPEC, &["--json"]);
    let found: Value = serde_json::from_str(&o.stdout).unwrap_or_else(|e| panic!("{e}: {}", o.stderr));
    // The exit code is the verdict.
    assert_eq!(o.code == 0, found["valid"] == true, "{}", found["verdict"]);
    assert_eq!(found["cells"].as_array().unwrap().len(), 9);
    assert_eq!(found["verb"], "map");
    // Points that follow the optimum were taken, and the whole map was one program.
    assert!(!found["rounds"].as_array().unwrap().is_empty(), "{found}");
    assert_eq!(found["whole"][0], serde_json::json!("converged"), "{}", found["whole"]);
    // Together cells cost more than each alone, and the page says how much.
    let cost = found["checks"].as_array().unwrap().iter().find(|c| c["id"] == "whole-cost").unwrap();
    assert!(cost["measured"].as_f64().unwrap() > -1e-3, "{cost}");
    let spark = |c: &Value| c["optimum"]["x"][2].as_f64().unwrap();
    let cells = found["cells"].as_array().unwrap();
    for (k, c) in cells.iter().enumerate().filter(|(_, c)| c["state"] == "optimal") {
        for j in [k + 1, k + 3].into_iter().filter(|j| *j < 9 && (j - k == 3 || k % 3 < 2)) {
            if cells[j]["state"] == "optimal" {
                assert!((spark(c) - spark(&cells[j])).abs() <= 10.0 + 1e-4, "{k} {j}");
            }
        }
    }
    // Bed time: more than settling alone, less than what the estimate calls the most.
    let bed = found["bed"]["points_s"].as_f64().unwrap();
    assert!((26.0 * 4.0..33.0 * 41.0).contains(&bed), "{bed}");
    let page = std::fs::read_to_string(tmp.path().join("run/report.html")).unwrap();
    assert!(page.contains(found["verdict"].as_str().unwrap()));
    let o = dynocal(tmp.path(), &["export", "run", "--to", "dcm", "--out", "ecu"]);
    assert_eq!(o.code, 0, "{}", o.stderr);
}

#[test]
fn a_plan_is_shown_without_running_and_faults_are_named() {
    let tmp = tempfile::tempdir().unwrap();
    let o = map(tmp.path(), SPEC, &["--check"]);
    assert_eq!(o.code, 0, "{}", o.stderr);
    let shown = format!("{}{}", o.stdout, o.stderr);
    assert!(shown.contains("torque (3)") && !tmp.path().join("run/points.csv").exists(), "{shown}");
    let faults = [
        ("share = 0.25", "share = 1.5", "bed.refine.share"),
        ("{ spark = 10.0 }", "{ sprak = 10.0 }", "sprak"),
        ("{ spark = 10.0 }", "{ spark = 10.0 }\nresidence = [1.0, 2.0]", "9 numbers"),
        ("torque = [30.0, 50.0, 70.0]", "torque = [30.0, 30.0, 70.0]", "axes.torque"),
        ("speed = [1500.0", "speed = [500.0", "axes.speed"),
        ("points = 34", "points = 3", "bed.points"),
        (
            "points = 34",
            "points = 25",
            "at least 26: points to learn from, repeats and verification together",
        ),
    ];
    for (from, to, says) in faults {
        let o = map(tmp.path(), &SPEC.replace(from, to), &[]);
        assert!(o.code == 2 && o.stderr.contains(says), "{to}: {} {}", o.code, o.stderr);
    }
    // What the plant lacks is said before it is run.
    let limit = |output: &str, unit: &str| {
        format!("{SPEC}\n[[problem.limits]]\noutput = \"{output}\"\nunit = \"{unit}\"\nupper = 900.0\n")
    };
    for (spec, says) in [
        (limit("heat", "K"), "no output `heat` in K; there are: "),
        (limit("egt", "degC"), "no output `egt` in degC; there are: "),
        (format!("{SPEC}\n[optimise.front]\nagainst = \"soot\"\n"), "`soot`"),
        (SPEC.replace("[bed]", "[bed]\nslow = \"oli\""), "`oli`"),
    ] {
        let o = map(tmp.path(), &spec, &["--check"]);
        assert!(o.code == 2 && o.stderr.contains(says), "{says}: {} {}", o.code, o.stderr);
    }
    // In a cell, where the speed is given, fuel is a multiple of the injected mass: there is nothing to trade.
    let o = map(tmp.path(), &format!("{SPEC}\n[optimise.front]\nagainst = \"inj\"\n"), &["--check"]);
    assert!(
        o.code == 2 && o.stderr.contains("`inj`, which is a multiple of `fuel` in every cell"),
        "{}",
        o.stderr
    );
}

#[test]
fn a_day_that_waits_for_a_bed_says_its_state_as_json_and_check_reads_what_is_there() {
    let tmp = tempfile::tempdir().unwrap();
    let spec = format!("{SPEC}\n[plant]\nname = \"bed\"\n");
    let o = map(tmp.path(), &spec, &["--json"]);
    assert_eq!(o.code, 1, "{}", o.stderr);
    let state: serde_json::Value = serde_json::from_str(&o.stdout).unwrap();
    assert_eq!((state["state"].as_str(), state["verb"].as_str()), (Some("waiting"), Some("map")));
    let plan = std::fs::read_to_string(tmp.path().join(state["plan"].as_str().unwrap())).unwrap();
    assert_eq!(state["points"].as_u64().unwrap() as usize, plan.lines().count() - 1);
    let measured = tmp.path().join(state["measured"].as_str().unwrap());
    atomic::write(&measured, b"point,throttle [deg],inj [mg],spark [deg],speed [rpm],torque [Nm],lambda [-]\n1,20,15,abc,2000,50,1\n").unwrap();
    let o = map(tmp.path(), &spec, &["--check"]);
    assert!(
        o.code == 2 && o.stderr.contains("points01.csv, line 2") && o.stderr.contains("abc"),
        "{}",
        o.stderr
    );
    // The first point as it was planned; elsewhere it is the record of another plan.
    let head: Vec<&str> = plan.lines().next().unwrap().split(',').collect();
    let row: Vec<&str> = plan.lines().nth(1).unwrap().split(',').collect();
    let asked = |name: &str| row[head.iter().position(|h| h.starts_with(name)).unwrap()];
    let given = |spark: &str| {
        let (speed, torque) = (asked("speed"), asked("torque"));
        format!(
            "point,throttle [deg],inj [mg],spark [deg],speed [rpm],torque [Nm],lambda [-]\n1,20,15,{spark},{speed},{torque},1\n"
        )
    };
    atomic::write(&measured, given("37.5").as_bytes()).unwrap();
    let o = map(tmp.path(), &spec, &["--check"]);
    assert!(o.code == 2 && o.stderr.contains("1 of 1 measured points were set elsewhere"), "{}", o.stderr);
    atomic::write(&measured, given(asked("spark")).as_bytes()).unwrap();
    let o = map(tmp.path(), &spec, &["--check"]);
    assert!(o.code == 0 && o.stdout.contains("points01.csv: 1 points"), "{} {}", o.stdout, o.stderr);
}
