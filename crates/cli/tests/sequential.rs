//! `dynocal sequential`: rounds of design and measurement on the virtual engine.

use std::path::Path;

use assert_cmd::Command;
use dynocal_files::atomic;

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

/// Two rounds of six seconds, linear in two inputs.
const SPEC: &str = r#"
sample_time_s = 0.1
first_s = 6.0
record_s = 6.0
rounds = 2
held_out_s = 12.0

[plant]
parameters = "thesis"

[[channels]]
name = "throttle"
unit = "deg"
lower = 10.0
upper = 16.0
hold_s = 0.5

[[channels]]
name = "spark"
unit = "deg"
lower = 12.0
upper = 28.0
hold_s = 0.3

[[outputs]]
name = "torque"
model = { name = "arx", na = 1, nb = 2 }

[search]
evaluations = 60
"#;

fn campaign(folder: &Path, text: &str, out: &str) -> Outcome {
    let spec = folder.join("spec.toml");
    atomic::write(&spec, text.as_bytes()).unwrap();
    dynocal(folder, &["sequential", spec.to_str().unwrap(), "--out", out, "--json"])
}

#[test]
fn rounds_teach_and_are_set_beside_random_records() {
    let tmp = tempfile::tempdir().unwrap();
    let o = campaign(tmp.path(), SPEC, "run");
    assert_eq!(o.code, 0, "{}", o.stderr);
    let found: serde_json::Value = serde_json::from_str(&o.stdout).unwrap();
    let output = &found["outputs"][0];
    for key in ["rmse_first", "rmse_designed", "rmse_random"] {
        assert!(output[key].as_f64().unwrap() > 0.0, "{output}");
    }
    assert_eq!(found["rounds"].as_array().unwrap().len(), 2);
    // Three times the data: the volume of the confidence region is smaller, as the product of the standard errors says.
    let volume = |key: &str| -> f64 {
        output["parameters"].as_array().unwrap().iter().map(|p| p[key].as_f64().unwrap().ln()).sum()
    };
    assert!(volume("std_error") < volume("std_error_first"), "{}", output["parameters"]);
    // 6 s before, the rounds, and one settling of 3 s.
    assert_eq!(found["bed_s"].as_f64(), Some(21.0));
    let record = dynocal_files::csv_io::read(&tmp.path().join("run/round01.csv")).unwrap();
    let throttle = record.numbers("throttle", 0, record.rows()).unwrap();
    assert!(record.rows() == 60 && throttle.iter().all(|v| (10.0..=16.0).contains(v)));
    let page = std::fs::read_to_string(tmp.path().join("run/report.html")).unwrap();
    assert!(page.contains("class=\"verdict\"") && page.trim_end().ends_with("</html>"));
    // The model is a model of the house.
    let o = dynocal(
        tmp.path(),
        &["simulate", "--model", "run/model.json", "--data", "run/held_out.csv", "--out", "sim", "--json"],
    );
    assert_eq!(o.code, 0, "{}", o.stderr);
    let again: serde_json::Value = serde_json::from_str(&o.stdout).unwrap();
    assert!(again["outputs"][0]["rmse"].as_f64().unwrap() > 0.0);
    // The same seed gives the same bytes, whatever the threads; another seed other records.
    let bytes = |out: &str, file: &str| std::fs::read(tmp.path().join(out).join(file)).unwrap();
    let spec = tmp.path().join("spec.toml");
    let spec = spec.to_str().unwrap();
    dynocal(tmp.path(), &["sequential", spec, "--out", "one", "--threads", "1", "--quiet"]);
    dynocal(tmp.path(), &["sequential", spec, "--out", "other", "--seed", "2", "--quiet"]);
    for file in ["report.html", "round02.csv", "model.json"] {
        assert_eq!(bytes("run", file), bytes("one", file), "{file}");
    }
    assert_ne!(bytes("run", "round02.csv"), bytes("other", "round02.csv"));
}

#[test]
fn the_stop_rule_ends_a_test_that_teaches_nothing_more() {
    let tmp = tempfile::tempdir().unwrap();
    // Every record is worth less than all of the present error.
    let o = campaign(
        tmp.path(),
        &format!("stop_below = 1.0\n{}", SPEC.replace("rounds = 2", "rounds = 9")),
        "run",
    );
    let found: serde_json::Value = serde_json::from_str(&o.stdout).unwrap();
    assert_eq!(found["stopped"], true, "{}", found["rounds"]);
    let rounds = found["rounds"].as_array().unwrap();
    assert!(rounds.len() < 9 && rounds.last().unwrap()["measured"] == false, "{}", found["rounds"]);
}

#[test]
fn robust_and_separate_campaigns_run() {
    let tmp = tempfile::tempdir().unwrap();
    let robust = format!("course = \"separate\"\n{SPEC}\n[robust]\ndraws = 3\nworst = 0.34\n");
    let o = campaign(tmp.path(), &robust.replace("evaluations = 60", "evaluations = 20"), "run");
    assert_eq!(o.code, 0, "{}", o.stderr);
    let plain = SPEC.replace("evaluations = 60", "evaluations = 20");
    let o = campaign(tmp.path(), &format!("course = \"separate\"\n{plain}"), "plain");
    assert_eq!(o.code, 0, "{}", o.stderr);
    let wrong = robust.replace("worst = 0.34", "worst = 1.5");
    let o = campaign(tmp.path(), &wrong, "wrong");
    assert!(o.code == 2 && o.stderr.contains("`robust.worst`: found 1.5"), "{}", o.stderr);
}

#[test]
fn faults_are_named_all_at_once() {
    let tmp = tempfile::tempdir().unwrap();
    let text = r#"
record_s = 6.0
rounds = 0
criterion = "dd"
[plant]
name = "bed"
[[channels]]
name = "throttle"
unit = "deg"
lower = 10.0
[[outputs]]
name = "torque"
model = { name = "arxx" }
lower = 3.0
[search]
starts = 0
"#;
    let o = campaign(tmp.path(), text, "run");
    assert_eq!((o.code, o.stdout.as_str()), (2, ""));
    for part in [
        "`sample_time_s`",
        "`rounds`: found 0, expected 1 to 1000",
        "`criterion`",
        "`plant.name`: found `bed`",
        "`channels[1].upper`",
        "did you mean `arx`?",
        "`outputs[1].upper`",
        "`search.starts`: found 0",
    ] {
        assert!(o.stderr.contains(part), "no {part} in\n{}", o.stderr);
    }
    assert!(!tmp.path().join("run").exists());
    for (from, to, part) in [
        ("name = \"spark\"", "name = \"sparks\"", "the plant has no input `sparks`"),
        ("name = \"torque\"", "name = \"torqe\"", "the plant has no output `torqe`"),
        ("unit = \"deg\"\nlower = 12.0", "unit = \"%\"\nlower = 12.0", "channel `spark` is given in `%`"),
        (
            "model = { name = \"arx\", na = 1, nb = 2 }",
            "model = { name = \"oe\" }",
            "`oe` cannot be designed for",
        ),
    ] {
        let o = campaign(tmp.path(), &SPEC.replace(from, to), "wrong");
        assert!(o.code == 2 && o.stderr.contains(part), "no {part} in\n{}", o.stderr);
    }
}
