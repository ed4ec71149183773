//! `dynocal calibrate`, its steps and `report`, end to end on the shortest calibration.

use std::io::{BufRead, BufReader};
use std::path::{Path, PathBuf};
use std::process::Stdio;

use assert_cmd::Command;
use dynocal_files::atomic;

/// The shortest calibration that still does every step.
fn shortest() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../studies/src/shortest.toml")
}

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

fn written(folder: &Path, spec: &str) -> PathBuf {
    let path = folder.join("spec.toml");
    atomic::write(&path, spec.as_bytes()).unwrap();
    path
}

fn text(path: &Path) -> String {
    std::fs::read_to_string(path).unwrap_or_else(|e| panic!("{}: {e}", path.display()))
}

#[test]
fn equal_bytes_for_any_number_of_threads_resume_and_report() {
    let tmp = tempfile::tempdir().unwrap();
    let spec = shortest();
    let spec = spec.to_str().unwrap();
    let one = dynocal(tmp.path(), &["calibrate", spec, "--out", "one", "--threads", "1"]);
    assert!(one.code == 0 || one.code == 1, "{}", one.stderr);
    assert!(one.stdout.trim_end().ends_with("one/report.html"), "{}", one.stdout);
    let lines: Vec<&str> = one.stderr.lines().filter(|l| l.starts_with("step ")).collect();
    assert_eq!(lines.len(), 7, "{}", one.stderr);
    let two = dynocal(tmp.path(), &["calibrate", spec, "--out", "two", "--threads", "2", "--json"]);
    assert_eq!(one.code, two.code);
    for file in ["summary.json", "report.html"] {
        assert_eq!(
            text(&tmp.path().join("one").join(file)),
            text(&tmp.path().join("two").join(file)),
            "{file}"
        );
    }
    // With --json standard output is the summary and nothing else.
    let summary: serde_json::Value = serde_json::from_str(&two.stdout).unwrap();
    assert_eq!(two.stdout, text(&tmp.path().join("two/summary.json")));
    assert_eq!(summary["schema"], "dynocal/summary");
    assert_eq!(summary["valid"].as_bool(), Some(one.code == 0));
    assert_eq!(summary["steps"].as_array().unwrap().len(), 6);
    // Bed times follow from the spec: records of 18, 9 and 18 s with 3 s before each.
    assert_eq!(summary["bed"]["identification_s"].as_f64(), Some(42.0));
    let loops_s = summary["bed"]["loops_s"].as_f64().unwrap();
    assert_eq!(loops_s, summary["loops"]["used_s"].as_f64().unwrap());
    // Five by five points at rest of 3.5 s, which are 117 samples of 0.03 s, after 3 s.
    let at_rest_s = summary["bed"]["at_rest_s"].as_f64().unwrap();
    assert!((at_rest_s - (25.0 * 117.0 * 0.03 + 3.0)).abs() < 1e-9, "{at_rest_s}");
    let total_s = summary["bed"]["total_s"].as_f64().unwrap();
    assert!((total_s - (loops_s + 42.0 + 12.0 + 42.0 + at_rest_s)).abs() < 1e-9, "{total_s}");
    // The price of causality: with preview, without it, as it is delivered.
    let [preview, delivered] =
        ["preview", "delivered"].map(|k| summary["causality"][k].as_f64().unwrap_or(f64::NAN));
    assert!(preview > 0.0 && delivered > 0.0, "{}", summary["causality"]);
    assert!(summary.to_string().len() > 1000 && !two.stdout.contains("elapsed"));

    let before = text(&tmp.path().join("one/summary.json"));
    let again = dynocal(tmp.path(), &["calibrate", spec, "--out", "one"]);
    assert_eq!(again.stderr.matches("taken from the earlier run").count(), 6, "{}", again.stderr);
    assert_eq!(text(&tmp.path().join("one/summary.json")), before);

    // A step that is asked for alone takes nothing from a finished run.
    let step = dynocal(tmp.path(), &["calibrate", spec, "--out", "one", "--until", "identify"]);
    assert_eq!(step.code, one.code, "{}", step.stderr);
    assert_eq!(text(&tmp.path().join("one/summary.json")), before);

    let report = tmp.path().join("one/report.html");
    let page = text(&report);
    std::fs::remove_file(&report).unwrap();
    let rebuilt = dynocal(tmp.path(), &["report", "one"]);
    assert_eq!(rebuilt.code, one.code);
    assert_eq!(text(&report), page);
    assert_eq!(text(&tmp.path().join("one/summary.json")), before);
}

#[test]
fn steps_run_one_at_a_time_in_one_folder() {
    let tmp = tempfile::tempdir().unwrap();
    let spec = shortest();
    let spec = spec.to_str().unwrap();
    let excite = dynocal(tmp.path(), &["calibrate", spec, "--until", "excite", "--out", "run"]);
    assert_eq!(excite.code, 0, "{}", excite.stderr);
    assert!(excite.stdout.contains("run/steps/01-excite/ident01.csv"), "{}", excite.stdout);
    assert!(!tmp.path().join("run/steps/02-identify").exists());
    let model = dynocal(tmp.path(), &["calibrate", spec, "--until", "identify", "--out", "run"]);
    assert!(model.stdout.contains("run/steps/02-identify/torque_model.json"), "{}", model.stdout);
    assert_eq!(model.stderr.matches("taken from the earlier run").count(), 1, "{}", model.stderr);
    // Another seed changes every record: nothing may be taken over.
    let other = dynocal(tmp.path(), &["calibrate", spec, "--until", "excite", "--out", "run", "--seed", "7"]);
    assert_eq!(other.stderr.matches("taken from the earlier run").count(), 0, "{}", other.stderr);
}

#[test]
fn ctrl_c_keeps_finished_steps_and_the_next_start_goes_on() {
    let tmp = tempfile::tempdir().unwrap();
    let spec = shortest();
    let mut child = std::process::Command::new(assert_cmd::cargo::cargo_bin("dynocal"))
        .current_dir(tmp.path())
        .args(["calibrate", spec.to_str().unwrap(), "--out", "run"])
        .stdout(Stdio::null())
        .stderr(Stdio::piped())
        .spawn()
        .unwrap();
    let mut lines = BufReader::new(child.stderr.take().unwrap()).lines();
    let begun = lines.by_ref().map(Result::unwrap).find(|l| l.starts_with("step 2 of 7"));
    assert!(begun.is_some());
    let sent = std::process::Command::new("kill").args(["-INT", &child.id().to_string()]).status().unwrap();
    assert!(sent.success());
    let rest: Vec<String> = lines.map(Result::unwrap).collect();
    assert_eq!(child.wait().unwrap().code(), Some(2), "{rest:?}");
    assert!(rest.iter().any(|l| l.contains("finished steps are kept")), "{rest:?}");
    let next = dynocal(tmp.path(), &["calibrate", spec.to_str().unwrap(), "--out", "run"]);
    assert!(next.code == 0 || next.code == 1, "{}", next.stderr);
    assert!(next.stderr.contains("taken from the earlier run"), "{}", next.stderr);
    assert!(tmp.path().join("run/report.html").exists());
}

#[test]
fn faults_of_a_spec_are_named_all_at_once() {
    let tmp = tempfile::tempdir().unwrap();
    let spec = written(
        tmp.path(),
        "sed = 3\n[plant]\nname = \"virtual_engin\"\n[excite]\nranges = { torque = [90.0, 10.0] }\nhold_s = -1.0\n[optimise]\npasses = 0\n",
    );
    let out = dynocal(tmp.path(), &["calibrate", spec.to_str().unwrap()]);
    assert_eq!(out.code, 2);
    assert_eq!(out.stdout, "");
    for part in [
        "has 5 faults",
        "spec.toml:1: `sed`",
        "did you mean `seed`?",
        "did you mean `virtual_engine`?",
        "`excite.ranges.torque`: found (90.0, 10.0), expected two numbers, lower before upper",
        "`excite.hold_s`: found -1, expected a positive number, s",
        "`optimise.passes`: found 0, expected a whole number from 1 to 100",
    ] {
        assert!(out.stderr.contains(part), "{part}\n{}", out.stderr);
    }
    assert!(!tmp.path().join("runs").exists());
}

/// A whole campaign through files alone: every plan that waits is named, whether it is open or closed loop, and played by
/// `engine transient`; the loops get their gains from plans of their own.
#[test]
fn a_real_bed_is_driven_through_files_alone() {
    let tmp = tempfile::tempdir().unwrap();
    let spec = format!("{}\n[plant]\nname = \"bed\"\n", text(&shortest()));
    let spec = written(tmp.path(), &spec);
    let start = "[excite]\nstart = { inj = 12.0, throttle = 12.0 }\n";
    atomic::write(&spec, text(&spec).replace("[excite]\n", start).as_bytes()).unwrap();
    // Files that are there before the first run are no foreign run.
    std::fs::create_dir_all(tmp.path().join("run/measured")).unwrap();
    let mut plans = Vec::new();
    for _ in 0..8 {
        let out = dynocal(tmp.path(), &["calibrate", spec.to_str().unwrap(), "--out", "run"]);
        let waiting: Vec<(String, String)> = out
            .stderr
            .lines()
            .filter_map(|l| l.trim().split_once(" -> "))
            .map(|(plan, measured)| (plan.to_string(), measured.to_string()))
            .collect();
        if waiting.is_empty() {
            // The maps are compared by stepping a plant, which a bed is not: the run ends with the map.
            assert!(out.code == 0 || out.code == 1, "{}", out.stderr);
            assert!(tmp.path().join("run/steps/05-invert/dynamic_map.json").exists(), "{}", out.stderr);
            break;
        }
        assert_eq!(out.code, 1, "{}", out.stderr);
        for (plan, measured) in waiting {
            let (file, mode) = plan.split_once(" (").unwrap();
            plans.push(plan.clone());
            assert!(mode.contains("loop"), "{plan}");
            let played = dynocal(tmp.path(), &["engine", "transient", file, "--csv", &measured]);
            assert_eq!(played.code, 0, "{plan}: {}{}", played.stdout, played.stderr);
        }
    }
    assert!(tmp.path().join("run/report.html").exists(), "{plans:?}");
    let of = |name: &str| plans.iter().filter(|p| p.contains(name)).count();
    // Each plan is asked for once, those of a step together: two tests of loops, three records, the design, two a pass.
    assert_eq!((of("gains0"), of("ident0"), of("val0"), of("pass1")), (2, 2, 1, 2), "{plans:?}");
    assert!(plans.iter().filter(|p| p.contains("gains0")).all(|p| p.contains("(open loop)")), "{plans:?}");
    assert!(plans.iter().any(|p| p.contains("ident01") && p.contains("closed loop: torque by throttle")));
}

/// A bed whose sensor of lambda has an offset of twice its demands' range: nothing in a single sample is wrong, the mean is.
#[test]
fn records_of_a_bed_that_do_not_follow_are_a_fault() {
    let tmp = tempfile::tempdir().unwrap();
    let gains = "[[loops]]\noutput = \"torque\"\ninput = \"throttle\"\ngains = { ki = 0.3, kp = 0.2 }\n\
                 [[loops]]\noutput = \"lambda\"\ninput = \"inj\"\ngains = { ki = -40.0, kp = -8.0 }\n";
    let spec = format!(
        "{gains}[excite]\nrecord_s = 9.0\nidentification_records = 2\nvalidation_records = 1\nsweep_s = 4.0\n\
         start = {{ inj = 12.0, throttle = 12.0 }}\n[identify]\nterms = 6\n[plant]\nname = \"bed\"\n"
    );
    let spec = written(tmp.path(), &spec);
    let args = ["calibrate", spec.to_str().unwrap(), "--until", "excite", "--out", "run"];
    let out = dynocal(tmp.path(), &args);
    for (plan, measured) in out.stderr.lines().filter_map(|l| l.trim().split_once(" -> ")) {
        let file = plan.split_once(" (").unwrap().0;
        let played = dynocal(tmp.path(), &["engine", "transient", file, "--csv", measured]);
        assert_eq!(played.code, 0, "{plan}: {}{}", played.stdout, played.stderr);
        offset(&tmp.path().join(measured), "lambda", 0.4);
    }
    let out = dynocal(tmp.path(), &args);
    let said = "The records do not follow the demand of lambda";
    assert!(out.code == 1 && out.stderr.contains(said), "{:?} {}", out.code, out.stderr);
}

/// Adds `by` to a column of a CSV.
fn offset(path: &Path, column: &str, by: f64) {
    let before = text(path);
    let header = before.lines().next().unwrap();
    let at = header.split(',').position(|c| c.split(' ').next() == Some(column)).expect(header);
    let changed = before.lines().enumerate().map(|(k, l)| {
        let mut cells: Vec<String> = l.split(',').map(str::to_string).collect();
        if let Some(v) = cells[at].parse::<f64>().ok().filter(|_| k > 0) {
            cells[at] = (v + by).to_string();
        }
        cells.join(",")
    });
    let changed = changed.collect::<Vec<_>>().join("\n") + "\n";
    atomic::write(path, changed.as_bytes()).unwrap();
}

/// A record in which a loop swings is refused with its period and amplitude; without gains the loops are identified, and
/// the same record is quiet.
#[test]
fn oscillating_loops_are_refused_and_identified_ones_are_quiet() {
    let tmp = tempfile::tempdir().unwrap();
    let spec = "[plant]\nparameters = \"pfi_1_6l\"\n[excite]\nrecord_s = 24.0\nhold_s = 6.0\nlevels = 3\n\
                identification_records = 2\nvalidation_records = 1\n\
                ranges = { torque = [15.0, 25.0], speed = [1050.0, 1150.0], lambda = [0.98, 1.02], spark = [15.0, 25.0] }\n\
                [identify]\nterms = 8\n";
    let gains = "[[loops]]\noutput = \"torque\"\ninput = \"throttle\"\ngains = { ki = 0.3, kp = 0.2 }\n\
                 [[loops]]\noutput = \"lambda\"\ninput = \"inj\"\ngains = { ki = -40.0, kp = -8.0 }\n";
    let path = written(tmp.path(), &format!("{spec}{gains}"));
    let until = |path: &Path, out: &str| {
        dynocal(tmp.path(), &["calibrate", path.to_str().unwrap(), "--until", "excite", "--out", out])
    };
    let swinging = until(&path, "swinging");
    assert_eq!(swinging.code, 2, "{}{}", swinging.stdout, swinging.stderr);
    for part in ["is refused", "by `throttle` oscillates", "period", "[[loops]]", ".refused.csv"] {
        assert!(swinging.stderr.contains(part), "{part}: {}", swinging.stderr);
    }
    let path = written(tmp.path(), spec);
    let quiet = until(&path, "quiet");
    assert_eq!(quiet.code, 0, "{}", quiet.stderr);
    assert!(quiet.stderr.contains("gains of the loops: torque by throttle: ki"), "{}", quiet.stderr);
    let summary: serde_json::Value =
        serde_json::from_str(&text(&tmp.path().join("quiet/summary.json"))).unwrap();
    let points = summary["loops"]["points"].as_array().unwrap();
    assert_eq!(points.len(), 4);
    for p in points.iter().flat_map(|p| p["loops"].as_array().unwrap()) {
        assert!(p["sensitivity"].as_f64().unwrap() <= 2.0, "{p}");
    }
    // Some of the loops with gains, others without: they could not be found together.
    let half = gains.replace("gains = { ki = -40.0, kp = -8.0 }\n", "");
    let out = until(&written(tmp.path(), &format!("{spec}{half}")), "half");
    assert!(out.code == 2 && out.stderr.contains("gains for all loops or for none"), "{}", out.stderr);
}

#[test]
fn folders_of_others_are_left_alone() {
    let tmp = tempfile::tempdir().unwrap();
    std::fs::create_dir(tmp.path().join("mine")).unwrap();
    atomic::write(&tmp.path().join("mine/notes.txt"), b"keep").unwrap();
    let out = dynocal(tmp.path(), &["calibrate", shortest().to_str().unwrap(), "--out", "mine"]);
    assert_eq!(out.code, 2);
    assert!(out.stderr.contains("notes.txt") && out.stderr.contains("--out"), "{}", out.stderr);
    let report = dynocal(tmp.path(), &["report", "mine"]);
    assert_eq!(report.code, 2);
    assert!(report.stderr.contains("run.json"), "{}", report.stderr);
}

#[test]
fn plants_and_studies_are_listed() {
    let tmp = tempfile::tempdir().unwrap();
    let plants = dynocal(tmp.path(), &["list", "plants"]);
    assert!(
        plants.stdout.contains("virtual_engine") && plants.stdout.contains(".torque_noise_nm"),
        "{}",
        plants.stdout
    );
    assert!(dynocal(tmp.path(), &["list", "studies"]).stdout.contains("chain"));
}

/// One river: what `identify` and `design` wrote is what `calibrate` starts from, and nothing of it is done again.
#[test]
fn stored_models_and_a_designed_record_are_where_a_calibration_starts() {
    let tmp = tempfile::tempdir().unwrap();
    let run = |args: &[&str]| {
        let o = dynocal(tmp.path(), args);
        assert!(o.code == 0 || o.code == 1, "{args:?}\n{}", o.stderr);
        o
    };
    let spec = shortest();
    run(&["calibrate", spec.to_str().unwrap(), "--until", "identify", "--out", "first"]);
    // The specs that the calibration wrote are specs of `dynocal identify`.
    for output in ["torque", "lambda"] {
        run(&["identify", &format!("first/steps/02-identify/{output}-1.toml"), "--out", output]);
    }
    let design = written(tmp.path(), DESIGN);
    run(&["design", design.to_str().unwrap(), "--out", "design"]);
    let played = run(&["engine", "transient", "design/design.plan.csv", "--csv", "designed.csv"]);
    assert_eq!(played.code, 0, "{}{}", played.stdout, played.stderr);

    let shortest = text(&shortest());
    let from_files = shortest
        .replace(
            "[excite]\n",
            &format!("[excite]\n{}\n{}\n", files("identification", "ident"), files("validation", "val")),
        )
        .replace(
            "[identify]\n",
            "[identify]\nfiles = { torque = \"torque/steps/01-identify/model.json\", lambda = \"lambda/steps/01-identify/model.json\" }\n",
        )
        .replace("[design]\n", "[design]\nrecord = \"designed.csv\"\n");
    let spec = written(tmp.path(), &from_files);
    run(&["calibrate", spec.to_str().unwrap(), "--out", "second"]);
    let model =
        |file: &str| -> serde_json::Value { serde_json::from_str(&text(&tmp.path().join(file))).unwrap() };
    for output in ["torque", "lambda"] {
        let (stored, taken) = (
            model(&format!("{output}/steps/01-identify/model.json")),
            model(&format!("second/steps/02-identify/{output}_model.json")),
        );
        assert_eq!(stored["parameters"], taken["parameters"], "{output}");
        // No estimate was made: no spec of `identify` was written.
        assert!(!tmp.path().join(format!("second/steps/02-identify/{output}-1.toml")).exists());
    }
    assert!(!tmp.path().join("second/steps/03-design/design.toml").exists());
    let column = |file: &str| -> Vec<f64> {
        let table = dynocal_files::csv_io::read(&tmp.path().join(file)).unwrap();
        table.numbers("torque", 0, table.rows()).unwrap().to_vec()
    };
    assert_eq!(column("designed.csv"), column("second/steps/03-design/design01.csv"));
    let summary = model("second/summary.json");
    // Nothing was measured for the identification; what the optimum and the maps need still is.
    assert_eq!(summary["bed"]["identification_s"].as_f64(), Some(0.0), "{}", summary["bed"]);
    assert!(summary["bed"]["total_s"].as_f64().unwrap() > 0.0);
    assert!(text(&tmp.path().join("second/report.html")).trim_end().ends_with("</html>"));
}

fn files(kind: &str, name: &str) -> String {
    let count = if name == "ident" { 2 } else { 1 };
    let list: Vec<String> =
        (1..=count).map(|k| format!("\"first/steps/01-excite/{name}{k:02}.csv\"")).collect();
    format!("{kind}_files = [{}]", list.join(", "))
}

/// Small movements about a point where open loop is safe.
const DESIGN: &str = r#"
length_s = 9.0
sample_time_s = 0.03
rivals = 2
certificate = false

[[channels]]
name = "inj"
unit = "mg"
lower = 11.0
upper = 13.0
hold_s = 0.6

[[channels]]
name = "spark"
unit = "deg"
lower = 15.0
upper = 25.0
hold_s = 0.6

[[channels]]
name = "throttle"
unit = "deg"
lower = 11.0
upper = 13.0
hold_s = 0.6

[[channels]]
name = "speed"
unit = "rpm"
lower = 1900.0
upper = 2100.0
hold_s = 1.5
shape = "linear"

[[models]]
file = "torque/steps/01-identify/model.json"
criterion = "d"

[[models]]
file = "lambda/steps/01-identify/model.json"
criterion = "d"

[search]
starts = 1
evaluations = 20
"#;

/// Demands that no engine meets are said, and what follows from them is not valid.
#[test]
fn demands_out_of_reach_are_said() {
    let tmp = tempfile::tempdir().unwrap();
    let gains = "[[loops]]\noutput = \"torque\"\ninput = \"throttle\"\ngains = { ki = 0.3, kp = 0.2 }\n\
                 [[loops]]\noutput = \"lambda\"\ninput = \"inj\"\ngains = { ki = -40.0, kp = -8.0 }\n";
    for (range, output) in [("torque = [900.0, 1000.0]", "torque"), ("lambda = [0.01, 0.02]", "lambda")] {
        let spec = format!(
            "[excite]\nrecord_s = 9.0\nidentification_records = 2\nvalidation_records = 1\nsweep_s = 4.0\nranges = {{ {range} }}\n[identify]\nterms = 6\n{gains}"
        );
        let spec = written(tmp.path(), &spec);
        let out =
            dynocal(tmp.path(), &["calibrate", spec.to_str().unwrap(), "--until", "excite", "--out", output]);
        let said = format!("The records do not follow the demand of {output}");
        assert!(out.code == 1 && out.stderr.contains(&said), "{range}: {:?} {}", out.code, out.stderr);
        let summary: serde_json::Value =
            serde_json::from_str(&text(&tmp.path().join(output).join("summary.json"))).unwrap();
        assert_eq!(summary["valid"], serde_json::json!(false));
    }
    // A point of the engine that cannot be held is no point.
    let point = dynocal(
        tmp.path(),
        &["engine", "point", "--torque-nm", "50", "--lambda", "0.01", "--spark-deg", "20"],
    );
    assert!(point.code != 0 && !point.stderr.is_empty(), "{}", point.stdout);
}

/// A pass that must not be used reads so wherever it stands: page, summary, exit code.
#[test]
fn a_pass_that_must_not_be_used_is_not_valid_on_the_page() {
    let tmp = tempfile::tempdir().unwrap();
    // One iteration meets no demand.
    let spec = text(&shortest()).replace("[optimise]\n", "[optimise]\nmax_iterations = 1\n");
    let spec = written(tmp.path(), &spec);
    let run =
        dynocal(tmp.path(), &["calibrate", spec.to_str().unwrap(), "--out", "run", "--until", "optimise"]);
    assert_eq!(run.code, 1, "{}", run.stderr);
    let folder = tmp.path().join("run");
    let summary: serde_json::Value = serde_json::from_str(&text(&folder.join("summary.json"))).unwrap();
    assert_eq!((&summary["passes"][0]["usable"], &summary["valid"]), (&false.into(), &false.into()));
    let reason = summary["passes"][0]["reason"].as_str().unwrap();
    assert!(!reason.is_empty());
    let page = text(&folder.join("report.html"));
    for part in ["not valid", "last pass, which must not be used", "no: its "] {
        assert!(page.contains(part), "no `{part}` on the page; reason: {reason}");
    }
}

/// What is metered is believed, and a fuel error of 3 % shows: injectors that give more than they are told, on a bed with a
/// meter; and a bed without one says that its fuel is that of the inputs.
#[test]
fn an_error_of_the_injectors_shows_in_the_metered_fuel() {
    let tmp = tempfile::tempdir().unwrap();
    let spec = format!("{}\n[plant.bed.engine]\ninjector_error = 0.03\n", text(&shortest()));
    let spec = written(tmp.path(), &spec);
    let run = dynocal(tmp.path(), &["calibrate", spec.to_str().unwrap(), "--out", "run"]);
    assert!(run.code < 2, "{}", run.stderr);
    let folder = tmp.path().join("run");
    let summary: serde_json::Value = serde_json::from_str(&text(&folder.join("summary.json"))).unwrap();
    let pass = &summary["passes"][0];
    let error = pass["meters"][0]["error"].as_f64().unwrap();
    assert!(pass["meters"][0]["channel"] == "fuel" && (error - 0.03).abs() < 1e-9, "{error}");
    let said = format!("{}", summary["warnings"]);
    assert!(said.contains("The meter of fuel reads +3.0 % in the mean beside"), "{said}");
    // Measured is what the meter said: 3 % more than the recorded inputs give.
    let table = dynocal_files::csv_io::read(&folder.join("steps/04-optimise/pass1_optimum.csv")).unwrap();
    let column = |name: &str| table.numbers(name, 0, table.rows()).unwrap().to_vec();
    let metered = column("fuel_measured");
    let (inj, speed) = (column("inj"), column("speed"));
    for t in 1..metered.len() {
        assert!((metered[t] / (1.03 * 1.2e-4 * inj[t - 1] * speed[t - 1]) - 1.0).abs() < 1e-9, "{t}");
    }
    // The rival's points are compared by the same meter.
    let validated = text(&folder.join("steps/06-validate/step.json"));
    let validated: serde_json::Value = serde_json::from_str(&validated).unwrap();
    let points = validated["result"]["static_map"]["points"].as_array().unwrap();
    assert!(!points.is_empty());
    for p in points {
        let [fuel, inj, speed] =
            [&p["objective"], &p["actuators"][0], &p["given"]].map(|v| v.as_f64().unwrap());
        // The loops trim while the point is averaged: what is metered lags what is injected by a sample.
        assert!((fuel / (1.03 * 1.2e-4 * inj * speed) - 1.0).abs() < 1e-3, "{p}");
    }
}

/// What the first records leave decides about the next one, levels are chosen beside what was measured, and larger models compete.
#[test]
fn the_lack_of_fit_decides_about_the_next_record() {
    let tmp = tempfile::tempdir().unwrap();
    let spec = text(&shortest())
        .replace("criterion = \"d\"", "criterion = \"auto\"")
        .replace("[excite]\n", "[excite]\nsignal = \"informative\"\n")
        .replace("terms = 8", "terms = 8\ndoublings = 1");
    let spec = written(tmp.path(), &spec);
    let spec = spec.to_str().unwrap();
    let run = |out: &str, threads: &str| {
        let o = dynocal(
            tmp.path(),
            &["calibrate", spec, "--until", "design", "--out", out, "--threads", threads],
        );
        assert!(o.code < 2, "{}", o.stderr);
    };
    run("one", "1");
    run("two", "2");
    let summary: serde_json::Value =
        serde_json::from_str(&text(&tmp.path().join("one/summary.json"))).unwrap();
    let choice = summary["design"]["choice"].as_array().unwrap();
    assert_eq!(choice.len(), 3, "{choice:?}");
    let says =
        |k: usize, part: &str| assert!(choice[k].as_str().unwrap().contains(part), "{part}: {choice:?}");
    // No sensor of the ideal bed has noise: whatever is left is structure.
    says(0, "torque: what the model leaves changes slowly");
    says(1, "structure is missing, or a sensor drifts");
    says(2, "levels of the record are those that tell most");
    // Sizes compete for the torque.
    let first = &summary["models"][0]["candidates"];
    let sizes: Vec<u64> =
        first.as_array().unwrap().iter().map(|c| c["parameters"].as_u64().unwrap()).collect();
    assert!(sizes.iter().max() > sizes.iter().min(), "{sizes:?}");
    let page = text(&tmp.path().join("one/report.html"));
    assert!(page.contains("What the first records leave decided about it"));
    for file in ["summary.json", "report.html", "steps/03-design/design01.csv", "steps/01-excite/ident02.csv"]
    {
        assert_eq!(
            text(&tmp.path().join("one").join(file)),
            text(&tmp.path().join("two").join(file)),
            "{file}"
        );
    }
    // Levels are chosen, and a further record knows what was measured before it.
    let drawn = text(&shortest()).replace("criterion = \"d\"", "criterion = \"auto\"");
    let drawn = written(tmp.path(), &drawn);
    let o =
        dynocal(tmp.path(), &["calibrate", drawn.to_str().unwrap(), "--until", "design", "--out", "drawn"]);
    assert!(o.code < 2, "{}", o.stderr);
    for file in ["steps/01-excite/ident01.csv", "steps/03-design/design01.csv"] {
        let record = |out: &str| text(&tmp.path().join(out).join(file));
        assert_ne!(record("one"), record("drawn"), "{file}");
    }
    // Both records and the third one hold other levels of the spark.
    let column = |file: &str| -> Vec<f64> {
        let table = dynocal_files::csv_io::read(&tmp.path().join("one").join(file)).unwrap();
        table.numbers("spark", 0, table.rows()).unwrap().to_vec()
    };
    let (a, b) = (column("steps/01-excite/ident01.csv"), column("steps/01-excite/ident02.csv"));
    let c = column("steps/03-design/design01.csv");
    assert!(a != b && b != c && a != c);
}
