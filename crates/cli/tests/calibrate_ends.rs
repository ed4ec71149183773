//! How a calibration ends before its last step, and what it rounds: poor models, limits of `[[abort]]`, passes that agree.

use std::path::{Path, PathBuf};

use assert_cmd::Command;
use dynocal_files::atomic;
use serde_json::Value;

struct Outcome {
    code: i32,
    stderr: String,
}

fn dynocal(folder: &Path, args: &[&str]) -> Outcome {
    let out = Command::cargo_bin("dynocal").unwrap().current_dir(folder).args(args).output().unwrap();
    Outcome { code: out.status.code().unwrap(), stderr: String::from_utf8(out.stderr).unwrap() }
}

fn text(path: &Path) -> String {
    std::fs::read_to_string(path).unwrap_or_else(|e| panic!("{}: {e}", path.display()))
}

fn json(path: &Path) -> Value {
    serde_json::from_str(&text(path)).unwrap()
}

/// The shortest calibration with other text in it.
fn shortest(folder: &Path, name: &str, changes: &[(&str, &str)]) -> PathBuf {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("../studies/src/shortest.toml");
    let mut spec = text(&path);
    for (from, to) in changes {
        assert!(spec.contains(from), "{from}");
        spec = spec.replacen(from, to, 1);
    }
    let path = folder.join(name);
    atomic::write(&path, spec.as_bytes()).unwrap();
    path
}

/// A record whose torque is turned upside down.
fn mirrored(from: &Path, to: &Path) {
    let before = text(from);
    let header = before.lines().next().unwrap();
    let at = header.split(',').position(|c| c.split(' ').next() == Some("torque")).expect(header);
    let changed = before.lines().enumerate().map(|(k, l)| {
        let mut cells: Vec<String> = l.split(',').map(str::to_string).collect();
        if let Some(v) = cells[at].parse::<f64>().ok().filter(|_| k > 0) {
            cells[at] = (100.0 - v).to_string();
        }
        cells.join(",")
    });
    let changed = changed.collect::<Vec<_>>().join("\n") + "\n";
    atomic::write(to, changed.as_bytes()).unwrap();
}

/// No optimum is sought on a model that says less than the mean of its output, with its number on the page and exit 1; whoever forces it
/// gets it.
#[test]
fn a_model_too_poor_is_refused_unless_forced() {
    let tmp = tempfile::tempdir().unwrap();
    let first = shortest(tmp.path(), "first.toml", &[]);
    let out =
        dynocal(tmp.path(), &["calibrate", first.to_str().unwrap(), "--until", "excite", "--out", "first"]);
    assert_eq!(out.code, 0, "{}", out.stderr);
    let excited = tmp.path().join("first/steps/01-excite");
    for name in ["ident01", "ident02"] {
        mirrored(&excited.join(format!("{name}.csv")), &tmp.path().join(format!("{name}.csv")));
    }
    std::fs::copy(excited.join("val01.csv"), tmp.path().join("val01.csv")).unwrap();
    let given = "[excite]\nidentification_files = [\"ident01.csv\", \"ident02.csv\"]\nvalidation_files = [\"val01.csv\"]\n";
    let given = [("[excite]\n", given), ("[design]\n", "[design]\nenabled = false\n")];
    let poor = shortest(tmp.path(), "poor.toml", &given);
    let out = dynocal(tmp.path(), &["calibrate", poor.to_str().unwrap(), "--out", "poor"]);
    let said = "No optimum is sought on these models: the torque model is worse than the mean of its output: free-run R2 -";
    assert!(out.code == 1 && out.stderr.contains(said), "{} {}", out.code, out.stderr);
    let summary = json(&tmp.path().join("poor/summary.json"));
    assert_eq!(summary["valid"], Value::Bool(false));
    assert_eq!(summary["steps"].as_array().unwrap().len(), 3, "{}", summary["steps"]);
    assert!(text(&tmp.path().join("poor/report.html")).contains("No optimum is sought"));

    let forced = [given[0], given[1], ("[optimise]\n", "[optimise]\nforce = true\n")];
    let forced = shortest(tmp.path(), "forced.toml", &forced);
    let out =
        dynocal(tmp.path(), &["calibrate", forced.to_str().unwrap(), "--until", "optimise", "--out", "poor"]);
    assert!(!out.stderr.contains("No optimum is sought"), "{}", out.stderr);
    assert!(tmp.path().join("poor/steps/04-optimise").exists(), "{}", out.stderr);

    // What a forced run left behind is no result of the run that is refused.
    let stale = tmp.path().join("poor/steps/05-invert");
    std::fs::create_dir_all(&stale).unwrap();
    atomic::write(&stale.join("dynamic_map.json"), b"{}").unwrap();
    let again = dynocal(tmp.path(), &["calibrate", poor.to_str().unwrap(), "--out", "poor"]);
    assert!(again.code == 1 && again.stderr.matches("No optimum is sought").count() == 2, "{}", again.stderr);
    let taken = dynocal(tmp.path(), &["export", "poor", "--to", "csv", "--out", "taken"]);
    assert!(!taken.stderr.contains("dynamic_map"), "{}", taken.stderr);
    let left: Vec<_> = std::fs::read_dir(tmp.path().join("taken")).into_iter().flatten().flatten().collect();
    assert!(left.iter().all(|f| !f.file_name().to_string_lossy().contains("map")), "{left:?}");
}

/// A record ends before an output passes its limit; what was measured is kept, and the next start with a wider limit goes on.
#[test]
fn a_record_that_breaks_a_limit_is_stopped_kept_and_resumed() {
    let tmp = tempfile::tempdir().unwrap();
    let abort = |upper: f64| {
        // Given gains: the records come first.
        let loops = "[[loops]]\noutput = \"torque\"\ninput = \"throttle\"\ngains = { ki = 0.3, kp = 0.2 }\n\n\
                     [[loops]]\noutput = \"lambda\"\ninput = \"inj\"\ngains = { ki = -40.0, kp = -8.0 }\n\n";
        let table = format!(
            "{loops}[[abort]]\noutput = \"torque\"\nunit = \"Nm\"\nupper = {upper:?}\nmargin = 2.0\n\n[excite]\n"
        );
        shortest(tmp.path(), "spec.toml", &[("[excite]\n", &table)])
    };
    let spec = abort(70.0);
    let args = ["calibrate", spec.to_str().unwrap(), "--until", "excite", "--out", "run"];
    let out = dynocal(tmp.path(), &args);
    let said = out.stderr.split_once("begins beyond a limit of [[abort]]: torque is ");
    let (value, rest) = said.and_then(|s| s.1.split_once(" Nm at its first point, ")).expect(&out.stderr);
    // Whatever it is there: it is beyond, and the limit is that of the spec.
    assert!(out.code != 0 && value.parse::<f64>().unwrap() > 70.0, "{}", out.stderr);
    assert!(rest.starts_with("allowed is at most 70.00 Nm."), "{rest}");
    abort(88.0);
    let out = dynocal(tmp.path(), &args);
    assert!(out.code != 0 && out.stderr.contains(".stopped.csv"), "{} {}", out.code, out.stderr);
    let excite = tmp.path().join("run/steps/01-excite");
    let kept: Vec<PathBuf> = std::fs::read_dir(&excite)
        .unwrap()
        .map(|e| e.unwrap().path())
        .filter(|p| p.to_string_lossy().ends_with(".stopped.csv"))
        .collect();
    assert!(!kept.is_empty(), "{}", out.stderr);
    let record = dynocal_files::csv_io::read(&kept[0]).unwrap();
    let torque = record.numbers("torque", 0, record.rows()).unwrap();
    assert!(!torque.is_empty() && torque.iter().all(|t| *t <= 88.0), "{torque:?}");
    abort(400.0);
    let out = dynocal(tmp.path(), &args);
    assert_eq!(out.code, 0, "{}", out.stderr);
}

/// Passes end where promise and measurement agree; tables are multiples of their steps as they are compared and delivered.
#[test]
fn passes_end_when_they_agree_and_tables_keep_their_steps() {
    let tmp = tempfile::tempdir().unwrap();
    let invert = "[invert.shape]\nresolution = { inj = 0.25, throttle = 0.5 }\nlag_resolution_s = 0.02\n\n[validate.static_map]\n";
    let spec = |passes: &str| {
        shortest(tmp.path(), "spec.toml", &[("passes = 1\n", passes), ("[validate.static_map]\n", invert)])
    };
    let path = spec("passes = 3\nwithin_points = 100.0\n");
    let args = ["calibrate", path.to_str().unwrap(), "--until", "invert", "--out", "run"];
    let out = dynocal(tmp.path(), &args);
    assert!(out.code < 2, "{}", out.stderr);
    let summary = json(&tmp.path().join("run/summary.json"));
    let passes = summary["passes"].as_array().unwrap();
    let usable: Vec<bool> = passes.iter().map(|p| p["usable"].as_bool().unwrap()).collect();
    // Not before one may be used, and not after.
    let until = usable.iter().position(|u| *u).map_or(3, |k| k + 1);
    assert_eq!(passes.len(), until, "{usable:?}");
    if passes.len() < 3 {
        let page = text(&tmp.path().join("run/report.html"));
        assert!(page.contains(&format!("The last of 3 passes was number {until}")));
    }
    let invert = json(&tmp.path().join("run/steps/05-invert/step.json"));
    let map = &invert["result"]["dynamic"];
    for (actuator, step) in [(0, 0.25), (2, 0.5)] {
        let base = map["actuators"][actuator]["base"].as_array().unwrap();
        let off = |v: &Value| (v.as_f64().unwrap() / step - (v.as_f64().unwrap() / step).round()).abs();
        assert!(!base.is_empty() && base.iter().all(|v| off(v) < 1e-6), "{base:?}");
        assert!(map["steps"]["rounding"][actuator].as_f64().unwrap() > 0.0, "{}", map["steps"]);
    }
    assert_eq!(map["ports"]["actuators"][2]["name"], "throttle");

    let wrong = shortest(
        tmp.path(),
        "wrong.toml",
        &[(
            "[validate.static_map]\n",
            "[invert.shape]\nresolution = { injection = 0.25 }\n\n[validate.static_map]\n",
        )],
    );
    let out = dynocal(tmp.path(), &["calibrate", wrong.to_str().unwrap(), "--check"]);
    assert!(out.code == 2 && out.stderr.contains("invert.shape.resolution.injection"), "{}", out.stderr);
}

/// A network competes with the polynomials on the record that chooses, over the same lags.
#[test]
fn networks_compete_where_they_are_asked_for() {
    let tmp = tempfile::tempdir().unwrap();
    let spec = |family: &str| {
        let families = format!("[identify]\nfamilies = [\"{family}\"]\n");
        shortest(tmp.path(), "spec.toml", &[("[identify]\n", &families)])
    };
    let path = spec("neutral");
    let out = dynocal(tmp.path(), &["calibrate", path.to_str().unwrap(), "--check"]);
    assert!(out.code == 2 && out.stderr.contains("identify.families"), "{}", out.stderr);
    assert!(out.stderr.contains("neural"), "{}", out.stderr);
    spec("neural");
    let out =
        dynocal(tmp.path(), &["calibrate", path.to_str().unwrap(), "--until", "identify", "--out", "run"]);
    assert!(out.code < 2, "{}", out.stderr);
    let summary = json(&tmp.path().join("run/summary.json"));
    for of in summary["models"].as_array().unwrap() {
        let candidates = of["candidates"].as_array().unwrap();
        let r2 = |c: &Value| c["unseen_r2"].as_f64().unwrap_or(f64::NEG_INFINITY);
        let neural = candidates.iter().find(|c| c["name"].as_str().unwrap().contains("neural")).unwrap();
        assert!(candidates.len() > 1 && r2(neural) > 0.5, "{of}");
    }
}

/// An optimum that the plant does not follow is learned on it, and the start that it is compared with alike: the nearest records count,
/// nothing is repeated that is near enough, what is promised stays, and the bed's time is that of all records.
#[test]
fn an_optimum_that_the_plant_does_not_follow_is_learned() {
    let tmp = tempfile::tempdir().unwrap();
    let spec = |name: &str, keys: &str| shortest(tmp.path(), name, &[("[optimise]\n", keys)]);
    let plain = spec("plain.toml", "[optimise]\n");
    let learned = spec("learned.toml", "[optimise]\ntrials = 2\n");
    let run = |path: &Path, out: &str| {
        let args = ["calibrate", path.to_str().unwrap(), "--until", "optimise", "--out", out];
        let done = dynocal(tmp.path(), &args);
        assert!(done.code < 2, "{}", done.stderr);
        let step = json(&tmp.path().join(out).join("steps/04-optimise/step.json"));
        step["result"].clone()
    };
    let (before, after) = (run(&plain, "plain"), run(&learned, "learned"));
    let pass = |r: &Value| r["passes"][0].clone();
    let trials = |r: &Value| pass(r)["learned"]["trials"].as_array().unwrap().clone();
    assert!(trials(&before).is_empty());
    let trials = trials(&after);
    let share = |of: &str, t: &Value| t[of]["share"].as_f64().unwrap();
    assert!((2..=3).contains(&trials.len()), "{trials:?}");
    // The first one is the optimum that is played without learning, too.
    assert_eq!(trials[0]["optimum"]["misses"], pass(&before)["misses"]);
    assert!(trials[..trials.len() - 1].iter().all(|t| share("optimum", t) > 1.0), "{trials:?}");
    for (k, of) in ["start", "optimum"].into_iter().enumerate() {
        let least = trials.iter().min_by(|a, b| share(of, a).total_cmp(&share(of, b))).unwrap();
        assert!(share(of, least) < 0.8 * share(of, &trials[0]), "{of}: {trials:?}");
        assert_eq!(pass(&after)["records"][k]["name"], least[of]["record"]["name"]);
        if of == "optimum" {
            assert_eq!(pass(&after)["misses"], least[of]["misses"]);
        }
    }
    assert_eq!(pass(&after)["promised"], pass(&before)["promised"]);
    let bed = |r: &Value| r["bed_s"].as_f64().unwrap();
    assert!((bed(&after) - bed(&before) * trials.len() as f64).abs() < 1e-9);
    let page = text(&tmp.path().join("learned/report.html"));
    assert!(page.contains("Optima that the plant did not follow") && page.contains("pass 1, learned in "));
}
