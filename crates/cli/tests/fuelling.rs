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

    injects_in_a_calibration(tmp.path());

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

/// The shortest calibration of the same bed, with its fuel by what was identified.
const CALIBRATION: &str = r#"
[plant]
parameters = "pfi_1_6l"

[plant.bed]
outputs = ["coolant"]

[excite]
record_s = 18.0
identification_records = 2
validation_records = 1
sweep_s = 4.0
ranges = { torque = [20.0, 70.0], speed = [1400.0, 2600.0], spark = [10.0, 30.0] }

[identify]
terms = 8
lags = 4

[design]
enabled = false

[optimise]
passes = 1
record_s = 18.0

[validate.static_map]
demand = [30.0, 60.0]
given = [2000.0]
search = { tolerance = 0.25 }

[validate.scenario]
demand = [30.0, 60.0]
given = [1600.0, 2400.0]
step = [30.0, 60.0]
points = 4
point_s = 4.0
steps = 2
step_s = 4.0

[fuelling]
file = "run/fuelling.json"
channels = { coolant = "coolant" }
"#;

/// Fuel by measured states holds lambda better than the table of the same map and than an ECU that is tuned on the plant; it leaves
/// with the maps; files and channels that do not fit are refused before anything runs.
fn injects_in_a_calibration(folder: &Path) {
    write(folder, "calibrate.toml", CALIBRATION);
    let o = dynocal(folder, &["calibrate", "calibrate.toml", "--out", "cal", "--json"]);
    assert!(o.code == 0 || o.code == 1, "{}{}", o.stdout, o.stderr);
    let summary = read(&folder.join("cal/summary.json"));
    let maps = summary["maps"].as_array().unwrap();
    let steps = maps.iter().filter(|m| m["scenario"].as_str().unwrap().contains("steps"));
    let integral = |name: &str| {
        let of = steps.clone().find(|m| m["map"] == name).unwrap_or_else(|| panic!("{name}"));
        let lambda = of["demands"].as_array().unwrap().iter().find(|d| d["output"] == "lambda").unwrap();
        lambda["integral_s"].as_f64().unwrap()
    };
    let own = integral("dynamic map");
    for rival in ["same map with its own fuel", "static map with lag", "static map with the fuel of an ECU"] {
        assert!(own < integral(rival), "{own} against {} of the {rival}", integral(rival));
    }
    assert!(summary["fuelled"]["ecu_bed_s"].as_f64().unwrap() > 0.0);
    assert!(summary["verdict"].as_str().unwrap().contains("with its own fuel it would leave"));
    assert!(summary["verdict"].as_str().unwrap().contains("Its fuel is given by measured states"));
    let o = dynocal(folder, &["export", "cal", "--to", "dcm", "--out", "maps"]);
    assert_eq!(o.code, 0, "{}{}", o.stdout, o.stderr);
    let dcm = std::fs::read_to_string(folder.join("maps/fuelling.dcm")).unwrap();
    assert!(dcm.contains("FUEL_CHARGE"));

    let said = |from: &str, to: &str| {
        write(folder, "calibrate.toml", &CALIBRATION.replace(from, to));
        let o = dynocal(folder, &["calibrate", "calibrate.toml", "--out", "bad"]);
        assert_eq!(o.code, 2, "{}{}", o.stdout, o.stderr);
        assert!(!folder.join("bad/steps/01-excite/ident01.csv").exists());
        o.stderr
    };
    let gone = said("run/fuelling.json", "run/fuel.json");
    assert!(gone.contains("run/fuel.json"), "{gone}");
    let interval = said("\n[plant]\n", "\nsample_time_s = 0.025\n[plant]\n");
    assert!(interval.contains("identified at 0.01 s") && interval.contains("0.025 s"), "{interval}");
    let channel = said("channels = { coolant = \"coolant\" }", "channels = { coolant = \"water\" }");
    assert!(channel.contains("fuelling.channels") && channel.contains("`water`"), "{channel}");
    let both = said("channels = { coolant = \"coolant\" }", "spec = \"plant.toml\"");
    assert!(both.contains("fuelling") && both.contains("one of them"), "{both}");
    // A spec drives the plant of the campaign: here one that shows no temperature of the coolant.
    let spec = CALIBRATION.replace(
        "file = \"run/fuelling.json\"\nchannels = { coolant = \"coolant\" }",
        "spec = \"plant.toml\"",
    );
    write(folder, "calibrate.toml", &spec.replace("outputs = [\"coolant\"]", ""));
    let o = dynocal(folder, &["calibrate", "calibrate.toml", "--out", "bad"]);
    assert!(o.code == 2 && o.stderr.contains("no output `coolant`"), "{}", o.stderr);
    let bed = said("parameters = \"pfi_1_6l\"", "name = \"bed\"");
    assert!(bed.contains("`fuelling`") && bed.contains("its ECU injects"), "{bed}");
    let lambda = said("channels = { coolant = \"coolant\" }", "channels = { lambda = \"torque\" }");
    assert!(lambda.contains("fuelling.channels.lambda") && lambda.contains("`torque`"), "{lambda}");
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
