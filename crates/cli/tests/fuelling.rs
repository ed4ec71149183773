//! `dynocal fuelling`: fuel by measured states, identified on a plant and again from the files that this left.

use std::path::Path;

use assert_cmd::Command;
use serde_json::Value;

struct Outcome {
    code: i32,
    stdout: String,
    stderr: String,
}

fn dynocal(folder: &Path, args: &[&str]) -> Outcome {
    let out = Command::cargo_bin("dynocal").unwrap().current_dir(folder).args(args).output().unwrap();
    let text = |bytes| String::from_utf8(bytes).unwrap();
    Outcome { code: out.status.code().unwrap(), stdout: text(out.stdout), stderr: text(out.stderr) }
}

fn write(folder: &Path, name: &str, text: &str) {
    dynocal_files::atomic::write(&folder.join(name), text.as_bytes()).unwrap();
}

fn read(path: &Path) -> Value {
    serde_json::from_str(&std::fs::read_to_string(path).unwrap()).unwrap()
}

const PLANT: &str = r#"
[plant]
parameters = "pfi_1_6l"

[plant.bed]
outputs = ["coolant"]

[channels]
coolant = "coolant"

[test]
throttle_deg = [6.0, 30.0]
speed_rpm = [1200.0, 2800.0]
hold_s = [3.0, 4.0]
record_s = 84.0
unseen_s = 30.0
"#;

const FILES: &str = r#"
identification = ["run/record-1.csv", "run/record-2.csv"]
unseen = ["run/unseen.csv"]
channels = { coolant = "coolant" }
"#;

/// On the plant it wins against an ECU that was tuned on the same records; its files give the same model again; the tables that
/// leave are those of the model.
#[test]
fn identified_on_a_plant_and_again_from_its_files() {
    let tmp = tempfile::tempdir().unwrap();
    write(tmp.path(), "plant.toml", PLANT);
    let o = dynocal(tmp.path(), &["fuelling", "plant.toml", "--out", "run", "--json"]);
    assert_eq!(o.code, 0, "{}{}", o.stdout, o.stderr);
    let driven = read(&tmp.path().join("run/summary.json"));
    let of = |d: &Value, key: &str| d[key].as_f64().unwrap();
    let all = driven["driven"].as_array().unwrap();
    let rivals = all.iter().filter(|d| d["rival"] == true);
    let best = rivals.map(|d| of(d, "mean")).fold(f64::INFINITY, f64::min);
    assert!(all.iter().filter(|d| d["rival"] == true).count() == 4 && of(&all[0], "mean") < best, "{all:?}");
    // The film of the engine has a share of 0.3 that evaporates in some tenths of a second (its parameter file); cylinders that
    // differ and scatter are on this bed.
    let found = read(&tmp.path().join("run/fuelling.json"));
    let film = |v: &Value, key: &str| v["fuelling"]["film"][key].as_f64().unwrap();
    assert!((0.1..0.5).contains(&film(&found, "share")), "{}", film(&found, "share"));

    write(tmp.path(), "files.toml", FILES);
    let o = dynocal(tmp.path(), &["fuelling", "files.toml", "--out", "again"]);
    assert_eq!(o.code, 0, "{}{}", o.stdout, o.stderr);
    assert!(o.stdout.starts_with("The air and film model carries over"), "{}", o.stdout);
    let again = read(&tmp.path().join("again/fuelling.json"));
    for key in ["share", "tau_s"] {
        let (a, b) = (film(&found, key), film(&again, key));
        assert!((a / b - 1.0).abs() < 1e-3, "{key}: {a} on the plant, {b} from its files");
    }
    let o = dynocal(
        tmp.path(),
        &["export", "again/fuelling.json", "--to", "dcm", "--to", "json", "--out", "out"],
    );
    assert_eq!(o.code, 0, "{}{}", o.stdout, o.stderr);
    assert!(
        o.stderr.contains("FUEL_CHARGE loses at most") || o.stdout.contains("FUEL_CHARGE loses at most"),
        "{}{}",
        o.stdout,
        o.stderr
    );
    let dcm = std::fs::read_to_string(tmp.path().join("out/fuelling.dcm")).unwrap();
    for name in ["FUEL_CHARGE", "FUEL_THROTTLE_FLOW", "FILM_SHARE", "FILM_TAU", "LAMBDA_LAG"] {
        assert!(dcm.contains(name), "{name}");
    }

    // A record judges nothing that was identified from it.
    write(tmp.path(), "twice.toml", &FILES.replace("run/unseen.csv", "run/record-2.csv"));
    let o = dynocal(tmp.path(), &["fuelling", "twice.toml", "--out", "twice"]);
    assert!(o.code == 2 && o.stderr.contains("`record-2` is, in whole or in part"), "{}", o.stderr);

    // What must not be used does not leave.
    let mut bad = again.clone();
    bad["valid"] = Value::Bool(false);
    write(tmp.path(), "bad.json", &bad.to_string());
    let o = dynocal(tmp.path(), &["export", "bad.json", "--to", "dcm", "--out", "out2"]);
    assert!(o.code == 2 && o.stderr.contains("must not be used"), "{}", o.stderr);
}

#[test]
fn what_is_missing_is_named() {
    let tmp = tempfile::tempdir().unwrap();
    let said = |spec: &str| {
        write(tmp.path(), "spec.toml", spec);
        let o = dynocal(tmp.path(), &["fuelling", "spec.toml", "--out", "run"]);
        assert_eq!(o.code, 2, "{}{}", o.stdout, o.stderr);
        assert!(!tmp.path().join("run/summary.json").exists());
        o.stderr
    };
    let nothing = said("seed = 1\n");
    assert!(nothing.contains("identification") && nothing.contains("unseen"), "{nothing}");
    let narrow = said(&PLANT.replace("[6.0, 30.0]", "[30.0, 6.0]"));
    assert!(narrow.contains("test.throttle_deg") && narrow.contains("increase"), "{narrow}");
    let axis = said(&PLANT.replace("[test]", "[tables]\nspeed_rpm = [2000.0, 1000.0]\n\n[test]"));
    assert!(axis.contains("tables.speed_rpm"), "{axis}");
    let channel = said(&PLANT.replace("coolant = \"coolant\"", "coolant = \"warmth\""));
    assert!(channel.contains("no output `warmth`") && channel.contains("coolant"), "{channel}");
    let held = said(&PLANT.replace("unseen_s = 30.0", "unseen_s = 30.0\nheld = { sparks = 20.0 }"));
    assert!(held.contains("no input `sparks`") && held.contains("spark"), "{held}");
    write(
        tmp.path(),
        "short.csv",
        "time [s],speed [rpm],throttle [deg],inj [mg],map [kPa]\n0,2000,10,8,40\n0.01,2000,10,8,40\n",
    );
    let short = said("identification = [\"short.csv\"]\nunseen = [\"short.csv\"]\n");
    assert!(short.contains("short.csv") && short.contains("lambda"), "{short}");
}
