//! `dynocal simulate`: stored models on new inputs.

use std::path::Path;

use assert_cmd::Command;

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

/// Steps of u and what y(t) = 0.5 y(t-1) + 2 u(t-1), from rest, answers; optionally without y.
fn record(with_output: bool) -> String {
    let u = |t: usize| [0.0, 1.0, -1.0, 2.0][(t / 7) % 4];
    let mut text = String::from(if with_output { "time [s],u [mg],y [Nm]\n" } else { "time [s],u [mg]\n" });
    let mut y = 0.0;
    for t in 0..120 {
        let row = if with_output {
            format!("{},{},{y}\n", t as f64 * 0.5, u(t))
        } else {
            format!("{},{}\n", t as f64 * 0.5, u(t))
        };
        text += &row;
        y = 0.5 * y + 2.0 * u(t);
    }
    text
}

const SPEC: &str = r#"
[data]
file = "bed.csv"
time = "time"

[[channels]]
column = "u"
role = "input"

[[channels]]
column = "y"
role = "output"

[model]
structure = { name = "arx", na = 1, nb = 1, nk = 1 }
estimator = { name = "ols" }
"#;

fn identified() -> tempfile::TempDir {
    let tmp = tempfile::tempdir().unwrap();
    write(tmp.path(), "spec.toml", SPEC);
    write(tmp.path(), "bed.csv", &record(true));
    let o = dynocal(tmp.path(), &["identify", "spec.toml", "--out", "id"]);
    assert!(o.code <= 1, "{}", o.stderr);
    tmp
}

const MODEL: &str = "id/steps/01-identify/model.json";

fn column(folder: &Path, file: &str, name: &str) -> Vec<f64> {
    let table = dynocal_files::csv_io::read(&folder.join(file)).unwrap();
    table.numbers(name, 0, table.rows()).unwrap().to_vec()
}

/// On the record of the identification the output is that of its free run, bit for bit.
#[test]
fn equals_the_free_run_of_identify() {
    let tmp = tempfile::tempdir().unwrap();
    let furnace = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../examples/gas_furnace");
    let spec = furnace.join("identify.toml");
    let o = dynocal(tmp.path(), &["identify", spec.to_str().unwrap(), "--out", "id", "--json"]);
    assert!(o.code <= 1, "{}", o.stderr);
    let summary: serde_json::Value = serde_json::from_str(&o.stdout).unwrap();
    let model = format!("id/{}", summary["models"][0]["file"].as_str().unwrap());
    for part in summary["records"].as_array().unwrap() {
        let file = format!("id/{}", part["file"].as_str().unwrap());
        let table = dynocal_files::csv_io::read(&tmp.path().join(&file)).unwrap();
        let names: Vec<&str> = table.columns.iter().map(|c| c.name.as_str()).collect();
        let free = names.iter().find(|n| n.contains("free")).unwrap_or_else(|| panic!("{names:?}"));
        // The same samples as a record of their own: input and measured output.
        let rows = table.rows();
        let (u, z) = (column(tmp.path(), &file, "gas_rate"), column(tmp.path(), &file, "co2_measured"));
        let mut text = String::from("gas_rate [cuft/min],co2 [%]\n");
        (0..rows).for_each(|t| text += &format!("{},{}\n", u[t], z[t]));
        write(tmp.path(), "part.csv", &text);
        let o = dynocal(
            tmp.path(),
            &[
                "simulate",
                "--model",
                &model,
                "--data",
                "part.csv",
                "--init-samples",
                "5",
                "--out",
                "sim",
                "--json",
            ],
        );
        assert_eq!(o.code, 0, "{}", o.stderr);
        let found: serde_json::Value = serde_json::from_str(&o.stdout).unwrap();
        let file = format!(
            "sim/{}",
            found["files"]
                .as_array()
                .unwrap()
                .iter()
                .map(|f| f.as_str().unwrap())
                .find(|f| f.ends_with(".csv"))
                .unwrap()
        );
        let expected = table.numbers(free, 0, rows).unwrap();
        let found = column(tmp.path(), &file, "co2");
        let differ: Vec<usize> =
            (0..rows).filter(|t| found[*t].to_bits() != expected[*t].to_bits()).collect();
        assert!(differ.is_empty(), "{} of {rows} samples differ, first {:?}", differ.len(), differ.first());
    }
}

/// Without measured outputs the model starts from rest and gives what the difference equation gives.
#[test]
fn new_inputs_need_no_outputs() {
    let tmp = identified();
    write(tmp.path(), "new.csv", &record(false));
    let o =
        dynocal(tmp.path(), &["simulate", "--model", MODEL, "--data", "new.csv", "--out", "sim", "--json"]);
    assert_eq!(o.code, 0, "{}", o.stderr);
    let found: serde_json::Value = serde_json::from_str(&o.stdout).unwrap();
    let output = &found["outputs"][0];
    assert!(output["rmse"].is_null() && output["samples"] == 120 && output["unit"] == "Nm", "{output}");
    let file = format!("sim/{}", found["files"][1].as_str().unwrap());
    let (y, truth) = (column(tmp.path(), &file, "y"), column(tmp.path(), "bed.csv", "y"));
    let worst = y.iter().zip(&truth).map(|(a, b)| (a - b).abs()).fold(0.0, f64::max);
    assert!(worst < 1e-9, "{worst}");
    let page = std::fs::read_to_string(tmp.path().join("sim/report.html")).unwrap();
    assert!(page.contains("Simulation") && page.trim_end().ends_with("</html>"));
    // The same from a spec, with the same bytes.
    write(
        tmp.path(),
        "sim.toml",
        &format!("models = [\"{MODEL}\"]\ndata = [\"new.csv\"]\nstart = \"rest\"\n"),
    );
    let o = dynocal(tmp.path(), &["simulate", "sim.toml", "--out", "again", "--json"]);
    assert_eq!(o.code, 0, "{}", o.stderr);
    let again = file.replace("sim/", "again/");
    let bytes = |f: &str| std::fs::read(tmp.path().join(f)).unwrap();
    assert_eq!(bytes(&file), bytes(&again));
}

#[test]
fn what_does_not_fit_is_said() {
    let tmp = identified();
    write(tmp.path(), "new.csv", &record(false));
    let refused = |args: &[&str], parts: &[&str]| {
        let o = dynocal(tmp.path(), &[&["simulate"], args].concat());
        assert_eq!((o.code, o.stdout.as_str()), (2, ""), "{}", o.stderr);
        for part in parts {
            assert!(o.stderr.contains(part) && !o.stderr.contains("bug in"), "no `{part}` in:\n{}", o.stderr);
        }
    };
    refused(&["--model", MODEL], &["--data"]);
    refused(&["--model", "none.json", "--data", "new.csv"], &["none.json"]);
    refused(&["--model", MODEL, "--data", "new.csv", "--start", "measured"], &["y"]);
    refused(&["--model", MODEL, "--model", MODEL, "--data", "new.csv"], &["one model for each output"]);
    write(tmp.path(), "other.csv", "time [s],v [mg]\n0,1\n0.5,1\n1.0,1\n");
    refused(&["--model", MODEL, "--data", "other.csv"], &["other.csv", "`u`"]);
    write(tmp.path(), "other.csv", "time [s],u [rpm]\n0,1\n0.5,1\n1.0,1\n");
    refused(&["--model", MODEL, "--data", "other.csv"], &["other.csv", "rpm", "mg"]);
    write(tmp.path(), "s.toml", "model = [\"a.json\"]\n");
    refused(&["s.toml"], &["s.toml:1", "did you mean `models`?"]);
    write(tmp.path(), "s.toml", "name = \"x\"\n");
    refused(&["s.toml"], &["`models`: found nothing", "`data`: found nothing"]);
}

/// A run that grows without end is a fault long before its numbers are no numbers.
#[test]
fn a_free_run_far_outside_is_not_valid() {
    let tmp = identified();
    let text = std::fs::read_to_string(tmp.path().join(MODEL)).unwrap();
    let mut model: serde_json::Value = serde_json::from_str(&text).unwrap();
    let parameters = model["parameters"].as_array_mut().unwrap();
    let pole = parameters.iter_mut().find(|p| p["name"].as_str().unwrap().contains("y(t-1)")).unwrap();
    pole["value"] = serde_json::json!(1.1);
    write(tmp.path(), "restless.json", &model.to_string());
    // Without a constant it rests at zero until the inputs move it.
    let parameters = model["parameters"].as_array_mut().unwrap();
    let constant = parameters.iter_mut().find(|p| p["name"] == "1").unwrap();
    constant["value"] = serde_json::json!(0.0);
    write(tmp.path(), "grows.json", &model.to_string());
    write(tmp.path(), "new.csv", &record(false));
    let o = dynocal(
        tmp.path(),
        &["simulate", "--model", "grows.json", "--data", "new.csv", "--out", "sim", "--json"],
    );
    assert_eq!(o.code, 1, "{}", o.stderr);
    assert!(o.stderr.contains("times its width"), "{}", o.stderr);
    let found: serde_json::Value = serde_json::from_str(&o.stdout).unwrap();
    assert!(found["valid"] == false && found["outputs"][0]["diverged_at"].is_null(), "{found}");
    let o =
        dynocal(tmp.path(), &["simulate", "--model", "restless.json", "--data", "new.csv", "--out", "none"]);
    assert!(o.code == 1 && o.stderr.contains("no rest to start from"), "{} {}", o.code, o.stderr);
}

/// A mean of networks is one model file: it simulates and is scored, its spread is said, and what needs one network refuses
/// it by name.
#[test]
fn a_mean_of_networks_is_one_model() {
    let tmp = tempfile::tempdir().unwrap();
    let net = SPEC.replace(
        "structure = { name = \"arx\", na = 1, nb = 1, nk = 1 }\nestimator = { name = \"ols\" }",
        "structure = { name = \"neural\", hidden = 2, input_lags = 1 }\n\
         estimator = { name = \"train\", starts = 4, mean = 3, max_evaluations = 20 }",
    );
    write(tmp.path(), "spec.toml", &net);
    write(tmp.path(), "bed.csv", &record(true));
    let o = dynocal(tmp.path(), &["identify", "spec.toml", "--out", "id"]);
    assert!(o.code <= 1, "{}", o.stderr);
    let page = std::fs::read_to_string(tmp.path().join("id/report.html")).unwrap();
    assert!(page.contains("mean of the 3 best networks"));
    let model: serde_json::Value =
        serde_json::from_slice(&std::fs::read(tmp.path().join(MODEL)).unwrap()).unwrap();
    let text = model.to_string();
    assert!(text.contains("mean_of_networks"), "{text}");
    // One hidden layer of two over u(t-1), y(t-1), three times.
    assert_eq!(text.matches("network 3: ").count(), 2 * 2 + 2 + 2 + 1);
    let o = dynocal(tmp.path(), &["simulate", "--model", MODEL, "--data", "bed.csv", "--out", "sim"]);
    assert!(o.code <= 1, "{}", o.stderr);
    let o = dynocal(tmp.path(), &["identify", "--model", MODEL, "--data", "bed.csv", "--out", "scored"]);
    assert!(o.code <= 1, "{}", o.stderr);
    // The free run of the program is that of the record that `identify` wrote.
    let found = column(tmp.path(), "sim/record-y.csv", "y");
    let free = column(tmp.path(), "id/steps/01-identify/estimation-record.csv", "y_free_run");
    assert_eq!(found, free);
    let o = dynocal(tmp.path(), &["export", MODEL, "--to", "c", "--out", "out"]);
    assert!(o.code == 2 && o.stderr.contains("mean of several networks"), "{}", o.stderr);
}
