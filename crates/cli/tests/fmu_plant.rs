//! An FMU that others wrote answers the rounds of `dynocal sequential`: what is identified and designed on it is its own equation.

use std::path::{Path, PathBuf};
use std::process::Command as Process;

use assert_cmd::Command;
use dynocal_files::atomic;
use serde_json::Value;

/// Compiles the reference's unit with FMPy; says SKIPPED where either is missing.
fn made(folder: &Path) -> Option<PathBuf> {
    let Ok(reference) = std::env::var("DYNOCAL_REFERENCE_DIR") else {
        println!("SKIPPED: DYNOCAL_REFERENCE_DIR is not set");
        return None;
    };
    let target = std::env::var_os("CARGO_TARGET_DIR")
        .map_or_else(|| Path::new(env!("CARGO_MANIFEST_DIR")).join("../../target"), PathBuf::from);
    let python = std::env::var_os("DYNOCAL_READERS_PYTHON")
        .map_or_else(|| target.join("readers/bin/python"), PathBuf::from);
    if !Process::new(&python).args(["-c", "import fmpy"]).output().is_ok_and(|o| o.status.success()) {
        println!("SKIPPED READER: no Python with fmpy (run scripts/readers.sh)");
        return None;
    }
    // The script runs in its own folder, where a relative path would lead nowhere.
    let tools = std::fs::canonicalize(python.parent()?).ok()?;
    // FMPy brings the CMake that it compiles with.
    let path = format!("{}:{}", tools.display(), std::env::var("PATH").unwrap_or_default());
    let done = Process::new(tools.join("python"))
        .env("PATH", path)
        .current_dir(Path::new(&reference).join("formats/fmu"))
        .arg("make_fmu.py")
        .arg(folder)
        .output()
        .unwrap();
    assert!(done.status.success(), "{}", String::from_utf8_lossy(&done.stderr));
    Some(folder.join("InjMap_fmi2.fmu"))
}

/// Within one cell of the unit's map its answer is y(t) = a y(t-1) + (1 - a) f(u(t-1)) with a = exp(-dt/tau) and f bilinear.
const SPEC: &str = r#"
sample_time_s = 0.1
first_s = 6.0
record_s = 6.0
rounds = 2
held_out_s = 12.0

[plant]
name = "fmu"
file = "InjMap_fmi2.fmu"

[plant.fmu]
parameters = { tau = 0.2 }

[[channels]]
name = "speed"
unit = "rpm"
lower = 1000.0
upper = 2000.0
hold_s = 0.3

[[channels]]
name = "torque"
unit = "Nm"
lower = 50.0
upper = 150.0
hold_s = 0.3

[[outputs]]
name = "inj"
model = { name = "poly_arx", na = 1, nb = 1, degree = 2 }

[search]
evaluations = 60
"#;

fn sequential(folder: &Path, spec: &str) -> (i32, String, String) {
    atomic::write(&folder.join("spec.toml"), spec.as_bytes()).unwrap();
    let out = Command::cargo_bin("dynocal")
        .unwrap()
        .current_dir(folder)
        .args(["sequential", "spec.toml", "--out", "run", "--json"])
        .output()
        .unwrap();
    let text = |b: Vec<u8>| String::from_utf8(b).unwrap();
    (out.status.code().unwrap(), text(out.stdout), text(out.stderr))
}

#[test]
fn rounds_of_design_find_the_equation_of_the_unit() {
    let tmp = tempfile::tempdir().unwrap();
    if made(tmp.path()).is_none() {
        return;
    }
    let (code, out, err) = sequential(tmp.path(), SPEC);
    assert!(code < 2, "{err}");
    assert!(serde_json::from_str::<Value>(&out).is_ok(), "{out}");
    let text = std::fs::read_to_string(tmp.path().join("run/model.json")).unwrap();
    let model: Value = serde_json::from_str(&text).unwrap();
    let parameters = model["parameters"].as_array().unwrap();
    let pole =
        parameters.iter().find(|p| p["name"] == "inj(t-1)").unwrap_or_else(|| panic!("{parameters:?}"));
    let (found, want) = (pole["value"].as_f64().unwrap(), (-0.1f64 / 0.2).exp());
    println!("pole {found}, exp(-dt/tau) {want}");
    assert!((found - want).abs() < 1e-6, "{found} {want}");
    for record in ["first", "held_out", "round01", "round02"] {
        let rows = rows(&tmp.path().join(format!("run/{record}.csv")));
        assert!(rows.len() > 50, "{record}");
        for (k, pair) in rows.windows(2).enumerate() {
            let [.., y] = pair[1];
            let [_, speed, torque, before] = pair[0];
            let share = (speed - 1000.0) / 1000.0;
            let (low, high) = (12.5 - 0.5 * share, 31.0 - 0.5 * share);
            let target = low + (torque - 50.0) / 100.0 * (high - low);
            let wanted = want * before + (1.0 - want) * target;
            // The unit looks its map up in 32 bits.
            assert!((y - wanted).abs() < 1e-5, "{record}, row {k}: {y} {wanted}");
        }
    }
}

/// The unit behind a scalar of `dynocal label`.
const NODE: &str = r#"
data = ["drive.csv"]
target = "inj"

[[labels]]
name = "GAIN"
unit = "-"
base = [1.0]

[[nodes]]
name = "speed"
op = "channel"
channel = "speed"

[[nodes]]
name = "wanted"
op = "channel"
channel = "torque"

[[nodes]]
name = "gain"
op = "label"
label = "GAIN"

[[nodes]]
name = "torque"
op = "multiply"
in = ["wanted", "gain"]

[[nodes]]
name = "inj"
op = "model"
file = "InjMap_fmi2.fmu"
in = ["speed", "torque"]
"#;

/// A factor before the unit, planted by its own equation, comes back through it.
#[test]
fn a_unit_is_a_node_of_a_function() {
    let tmp = tempfile::tempdir().unwrap();
    if made(tmp.path()).is_none() {
        return;
    }
    let (gain, a, n) = (1.1, (-0.1f64 / 0.1).exp(), 400);
    let state = |k: usize| (1200.0 + 100.0 * ((k / 40) % 6) as f64, 60.0 + 5.0 * ((k / 7) % 12) as f64);
    // The unit starts settled at 2000 rpm and 100 Nm.
    let (mut y, mut text) = (21.25, String::from("time [s],speed [rpm],torque [Nm],inj [mg]\n"));
    for k in 0..n {
        let (speed, torque) = state(k);
        text += &format!("{},{speed},{torque},{y}\n", 0.1 * k as f64);
        let share = (speed - 1000.0) / 1000.0;
        let (low, high) = (12.5 - 0.5 * share, 31.0 - 0.5 * share);
        y = a * y + (1.0 - a) * (low + (gain * torque - 50.0) / 100.0 * (high - low));
    }
    atomic::write(&tmp.path().join("drive.csv"), text.as_bytes()).unwrap();
    atomic::write(&tmp.path().join("node.toml"), NODE.as_bytes()).unwrap();
    let out = Command::cargo_bin("dynocal")
        .unwrap()
        .current_dir(tmp.path())
        .args(["label", "node.toml", "--out", "label"])
        .output()
        .unwrap();
    let err = String::from_utf8_lossy(&out.stderr).into_owned();
    assert_eq!(out.status.code(), Some(0), "{err}");
    let text = std::fs::read_to_string(tmp.path().join("label/summary.json")).unwrap();
    let summary: Value = serde_json::from_str(&text).unwrap();
    let found = summary["fit"]["values"][0].as_f64().unwrap();
    println!("gain {found}, planted {gain}");
    // The unit looks its map up in 32 bits.
    assert!((found - gain).abs() < 1e-4, "{found}");
}

/// Rows of time, speed, torque, injected mass.
fn rows(path: &Path) -> Vec<[f64; 4]> {
    let text = std::fs::read_to_string(path).unwrap();
    let mut lines = text.lines();
    assert_eq!(lines.next(), Some("time [s],speed [rpm],torque [Nm],inj [mg]"));
    let row = |line: &str| {
        let cells: Vec<f64> = line.split(',').map(|c| c.parse().unwrap()).collect();
        cells.try_into().unwrap()
    };
    lines.map(row).collect()
}

#[test]
fn faults_of_the_plant_are_named() {
    let tmp = tempfile::tempdir().unwrap();
    for (from, to, part) in [
        ("file = \"InjMap_fmi2.fmu\"\n", "", "plant.file"),
        ("InjMap_fmi2.fmu", "nowhere.fmu", "nowhere.fmu: cannot be read"),
        ("parameters = { tau", "parametres = { tau", "plant.fmu"),
        ("[plant.fmu]", "torque_noise_nm = 1.0\n[plant.fmu]", "name, file and fmu alone"),
    ] {
        let (code, _, err) = sequential(tmp.path(), &SPEC.replacen(from, to, 1));
        assert!(code == 2 && err.contains(part), "{to}: {err}");
    }
    if made(tmp.path()).is_none() {
        return;
    }
    let (code, _, err) = sequential(tmp.path(), &SPEC.replacen("tau = 0.2", "tow = 0.2", 1));
    assert!(code == 2 && err.contains("no parameter `tow`; there are: tau"), "{err}");
    let (code, _, err) = sequential(tmp.path(), &SPEC.replacen("unit = \"Nm\"", "unit = \"kPa\"", 1));
    assert!(code == 2 && err.contains("kPa"), "{err}");
}
