//! `dynocal label`: the fuel table of a planted car, from its log to its tune.

use std::path::Path;

use assert_cmd::Command;
use dynocal_files::measurement::mlg::Raw;
use dynocal_files::measurement::mlg_write::{Written, write};
use dynocal_numerics::rng::Rng64;

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

const RPM: [f64; 6] = [800.0, 1400.0, 2000.0, 2800.0, 3600.0, 5000.0];
const LOAD: [f64; 5] = [20.0, 36.0, 50.0, 70.0, 100.0];

fn tune(ve: &[f64]) -> String {
    let column = |v: &[f64]| v.iter().map(|x| format!("         {x:.1} \n")).collect::<String>();
    let rows: String = ve
        .chunks(6)
        .map(|r| format!("         {} \n", r.iter().map(|v| format!("{v:.1}")).collect::<Vec<_>>().join(" ")))
        .collect();
    format!(
        "<?xml version=\"1.0\" encoding=\"ISO-8859-1\"?>\n<msq xmlns=\"http://www.msefi.com/:msq\">\n<versionInfo fileFormat=\"5.0\" signature=\"planted 1\"/>\n<page>\n\
<constant cols=\"6\" digits=\"0\" name=\"veTable\" rows=\"5\" units=\"%\">\n{rows}      </constant>\n\
<constant cols=\"1\" digits=\"0\" name=\"rpmBins\" rows=\"6\" units=\"RPM\">\n{}      </constant>\n\
<constant cols=\"1\" digits=\"0\" name=\"fuelLoadBins\" rows=\"5\" units=\"kPa\">\n{}      </constant>\n</page>\n</msq>\n",
        column(&RPM),
        column(&LOAD)
    )
}

/// Table of the car, at any state, by bilinear interpolation of its own.
fn look_up(ve: &[f64], rpm: f64, load: f64) -> f64 {
    let find = |p: &[f64], x: f64| {
        let i = (1..p.len() - 1).filter(|k| x >= p[*k]).count();
        (i, ((x - p[i]) / (p[i + 1] - p[i])).clamp(0.0, 1.0))
    };
    let ((i, s), (j, t)) = (find(&RPM, rpm), find(&LOAD, load));
    let at = |i: usize, j: usize| ve[j * 6 + i];
    (1.0 - t) * ((1.0 - s) * at(i, j) + s * at(i + 1, j))
        + t * ((1.0 - s) * at(i, j + 1) + s * at(i + 1, j + 1))
}

/// A drive of ten minutes: what the ECU has as a table, what the engine breathes early and late.
fn drive(path: &Path, table: &[f64], early: &[f64], late: &[f64], seed: u64) {
    let mut rng = Rng64::new(seed);
    let n = 9000;
    let time_s: Vec<f64> = (0..n).map(|k| 0.066 * f64::from(k)).collect();
    let (mut a, mut b, mut state) = (0.0, 0.0, 1.0);
    let mut c: Vec<Vec<f64>> = vec![Vec::new(); 4];
    for k in 0..n {
        a = 0.99 * a + 0.14 * rng.normal();
        b = 0.985 * b + 0.17 * rng.normal();
        let (rpm, load) =
            ((2200.0 + 700.0 * a).clamp(700.0, 5500.0).round(), (50.0 + 16.0 * b).clamp(18.0, 100.0).round());
        let ve = look_up(table, rpm, load).floor();
        let truth = look_up(if k < n / 2 { early } else { late }, rpm, load);
        state += (truth / ve - state) * (1.0 - (-0.066f64 / 0.2).exp());
        for (v, x) in c.iter_mut().zip([rpm, load, ve, state + 0.01 * rng.normal()]) {
            v.push(x);
        }
    }
    let field = |name: &str, unit: &str, raw, scale, values: Vec<f64>| Written {
        name: name.into(),
        unit: unit.into(),
        raw,
        scale,
        digits: 3,
        values,
    };
    let same = |v: f64| vec![v; n as usize];
    let fields = [
        field("Time", "s", Raw::Float, 1.0, time_s.clone()),
        field("RPM", "rpm", Raw::Unsigned(2), 1.0, c[0].clone()),
        field("FuelLoad", "kPa", Raw::Unsigned(2), 1.0, c[1].clone()),
        field("VE1", "%", Raw::Unsigned(1), 1.0, c[2].clone()),
        field("Lambda", "", Raw::Float, 1.0, c[3].clone()),
        field("Gammae", "%", Raw::Unsigned(2), 1.0, same(100.0)),
        field("PW", "ms", Raw::Unsigned(2), 0.001, same(3.0)),
        field("CLT", "C", Raw::Float, 1.0, same(90.0)),
    ];
    write(path, &time_s, &fields, Some(tune(table).as_bytes())).unwrap();
}

fn truth() -> Vec<f64> {
    (0..30).map(|k| 45.0 + 3.0 * f64::from(k % 6) + 6.0 * f64::from(k / 6)).collect()
}

fn wrong(share: f64) -> Vec<f64> {
    truth().iter().enumerate().map(|(k, v)| (v * (1.0 + share * (0.3 * k as f64).sin())).round()).collect()
}

#[test]
fn a_wrong_table_is_mended_in_the_tune_and_nothing_else() {
    let tmp = tempfile::tempdir().unwrap();
    drive(&tmp.path().join("a.mlg"), &wrong(0.15), &truth(), &truth(), 1);
    let o = dynocal(tmp.path(), &["label", "ve", "a.mlg", "--out", "out"]);
    assert_eq!(o.code, 0, "{}{}", o.stdout, o.stderr);
    assert!(o.stdout.starts_with("Take the new `veTable`"), "{}", o.stdout);
    assert!(o.stderr.contains("no definition of the ECU"), "{}", o.stderr);
    let out = tmp.path().join("out");
    let changed = std::fs::read_to_string(out.join("tune.msq")).unwrap();
    let before = tune(&wrong(0.15));
    let body =
        |text: &str| text[text.find("<constant").unwrap()..text.find("</constant>").unwrap()].to_string();
    // Outside of the values of the named label every byte is as it was.
    let (a, b) = (body(&before), body(&changed));
    assert_eq!(before.replace(&a, ""), changed.replace(&b, ""));
    let values: Vec<f64> = b.split_whitespace().filter_map(|w| w.parse().ok()).collect();
    assert_eq!(values.len(), 30);
    let summary: serde_json::Value =
        serde_json::from_str(&std::fs::read_to_string(out.join("summary.json")).unwrap()).unwrap();
    assert_eq!((summary["valid"].as_bool(), summary["verb"].as_str()), (Some(true), Some("label")));
    let verdicts = summary["found"]["table"]["verdicts"].as_array().unwrap();
    let told: Vec<usize> = (0..30).filter(|k| verdicts[*k] == "determined").collect();
    // The ECU's own look-up is cut to whole numbers, which the log shows: the table in use is half a count lower on average.
    let near = told.iter().filter(|k| (values[**k] - truth()[**k]).abs() <= 1.0).count();
    assert!(told.len() >= 12 && near as f64 >= 0.95 * told.len() as f64, "{near} of {}", told.len());
    assert!(std::fs::read_to_string(out.join("veTable.table")).unwrap().contains("zValues"));
    let page = std::fs::read_to_string(out.join("report.html")).unwrap();
    for part in ["Take the new", "Difference", "Half width of the 95 % interval", "What is left"] {
        assert!(page.contains(part), "{part}");
    }
}

#[test]
fn a_true_table_stays_and_a_contradicted_one_is_refused() {
    let tmp = tempfile::tempdir().unwrap();
    drive(&tmp.path().join("true.mlg"), &truth(), &truth(), &truth(), 2);
    let o = dynocal(tmp.path(), &["label", "ve", "true.mlg", "--out", "kept"]);
    assert_eq!(o.code, 0, "{}{}", o.stdout, o.stderr);
    assert!(o.stdout.starts_with("Leave `veTable` as it is"), "{}", o.stdout);
    assert!(!tmp.path().join("kept/tune.msq").exists());
    // Early the engine breathes 12 % more than the table says, late as it says: what early samples teach is wrong late.
    let more: Vec<f64> = truth().iter().map(|v| 1.12 * v).collect();
    drive(&tmp.path().join("turn.mlg"), &truth(), &more, &truth(), 3);
    let o = dynocal(tmp.path(), &["label", "ve", "turn.mlg", "--train", "0.5", "--out", "refused"]);
    assert_eq!(o.code, 1, "{}{}", o.stdout, o.stderr);
    assert!(o.stdout.contains("is refused") && o.stderr.contains("drift"), "{}{}", o.stdout, o.stderr);
    assert!(!tmp.path().join("refused/tune.msq").exists());
}

/// A tune whose loads are another quantity: all samples lie beyond its edge, which is said with the numbers of both.
#[test]
fn a_log_outside_of_the_table_is_refused_with_its_numbers() {
    let tmp = tempfile::tempdir().unwrap();
    drive(&tmp.path().join("a.mlg"), &truth(), &truth(), &truth(), 1);
    let column = |v: &[f64]| v.iter().map(|x| format!("         {x:.1} \n")).collect::<String>();
    let far: Vec<f64> = LOAD.iter().map(|l| l + 200.0).collect();
    let text = tune(&truth()).replace(&column(&LOAD), &column(&far));
    dynocal_files::atomic::write(&tmp.path().join("far.msq"), text.as_bytes()).unwrap();
    let o = dynocal(tmp.path(), &["label", "ve", "a.mlg", "--tune", "far.msq", "--out", "out"]);
    assert_eq!(o.code, 2, "{}{}", o.stdout, o.stderr);
    for part in ["a.mlg: 100 % of 9000 samples", "`veTable`", "loads of [", "[220, 300]", "at most 90 %"] {
        assert!(o.stderr.contains(part), "{part} is not in: {}", o.stderr);
    }
    assert!(!tmp.path().join("out/tune.msq").exists() && !tmp.path().join("out/summary.json").exists());
}

#[test]
fn bad_input_is_named() {
    let tmp = tempfile::tempdir().unwrap();
    drive(&tmp.path().join("a.mlg"), &truth(), &truth(), &truth(), 4);
    let refused = |args: &[&str], words: &[&str]| {
        let o = dynocal(tmp.path(), args);
        assert_eq!(o.code, 2, "{}{}", o.stdout, o.stderr);
        words.iter().for_each(|w| assert!(o.stderr.contains(w), "{w}: {}", o.stderr));
    };
    refused(&["label", "ve", "none.mlg"], &["none.mlg"]);
    refused(&["label", "ve", "a.mlg", "--train", "3"], &["--train", "found 3", "0.2 to 0.9"]);
    refused(&["label", "ve", "a.mlg", "--target", "14.7"], &["--target", "lambda from 0.5 to 1.5"]);
    dynocal_files::atomic::write(&tmp.path().join("b.csv"), b"Time [s],RPM [rpm]\n0,800\n1,810\n").unwrap();
    refused(&["label", "ve", "b.csv"], &["b.csv", "fuelload"]);
    dynocal_files::atomic::write(&tmp.path().join("bad.msq"), b"<msq><constant").unwrap();
    refused(&["label", "ve", "a.mlg", "--tune", "bad.msq"], &["bad.msq", "line 1"]);
    let other = tune(&truth()).replace("veTable", "veTabel");
    dynocal_files::atomic::write(&tmp.path().join("other.msq"), other.as_bytes()).unwrap();
    refused(&["label", "ve", "a.mlg", "--tune", "other.msq"], &["veTable", "did you mean `veTabel`"]);
}

const FILM: &str = r#"
data = ["film.csv"]
target = "out"
train = 0.6

[[labels]]
name = "X"
unit = "-"
base = [0.1]
least = 0.0
greatest = 0.9

[[labels]]
name = "TAU"
unit = "s"
base = [0.3]
least = 0.01

[[nodes]]
name = "fuel"
op = "channel"
channel = "fuel"

[[nodes]]
name = "x"
op = "label"
label = "X"

[[nodes]]
name = "tau"
op = "label"
label = "TAU"

[[nodes]]
name = "film"
op = "film"
in = ["fuel", "x", "tau"]
"#;

/// Fuel in steps, of which 30 % reaches the cylinder through a film of 0.7 s; `late` instead of 30 % in the second half.
fn film(folder: &Path, late: f64) {
    let mut rng = Rng64::new(9);
    let (dt, mut m, mut text) = (0.05, 0.3 * 10.0 * 0.7, String::from("time [s],fuel [mg],out [mg]\n"));
    let mut before = 10.0;
    for k in 0..1200 {
        let fuel = if (k / 60) % 2 == 0 { 10.0 } else { 18.0 };
        let share = if k < 600 { 0.3 } else { late };
        let keep = (-dt / 0.7f64).exp();
        if k > 0 {
            m = m * keep + share * before * 0.7 * (1.0 - keep);
        }
        before = fuel;
        text += &format!(
            "{},{fuel},{}\n",
            dt * f64::from(k),
            (1.0 - share) * fuel + m / 0.7 + 0.05 * rng.normal()
        );
    }
    dynocal_files::atomic::write(&folder.join("film.csv"), text.as_bytes()).unwrap();
    dynocal_files::atomic::write(&folder.join("film.toml"), FILM.as_bytes()).unwrap();
}

#[test]
fn a_function_of_a_spec_gives_its_labels_back() {
    let tmp = tempfile::tempdir().unwrap();
    film(tmp.path(), 0.3);
    let o = dynocal(tmp.path(), &["label", "film.toml", "--out", "out"]);
    assert_eq!(o.code, 0, "{}{}", o.stdout, o.stderr);
    let summary: serde_json::Value =
        serde_json::from_str(&std::fs::read_to_string(tmp.path().join("out/summary.json")).unwrap()).unwrap();
    for (k, truth) in [0.3, 0.7].into_iter().enumerate() {
        let value = summary["fit"]["values"][k].as_f64().unwrap();
        let half = summary["half_width"][k].as_f64().unwrap();
        assert!(
            (value - truth).abs() < 0.1 * truth && (value - truth).abs() < 2.0 * half,
            "{value} +- {half}"
        );
    }
    let dcm = std::fs::read_dir(tmp.path().join("out"))
        .unwrap()
        .any(|f| f.unwrap().file_name().to_string_lossy().ends_with(".dcm"));
    assert!(dcm, "{}", o.stdout);
    // Later there is no film: labels that were fitted to one are refused.
    film(tmp.path(), 0.0);
    let o = dynocal(tmp.path(), &["label", "film.toml", "--out", "other"]);
    assert_eq!(o.code, 1, "{}{}", o.stdout, o.stderr);
    assert!(o.stdout.contains("are refused"), "{}", o.stdout);
}

#[test]
fn faults_of_a_function_are_named_with_line_and_key() {
    let tmp = tempfile::tempdir().unwrap();
    film(tmp.path(), 0.3);
    let refused = |from: &str, to: &str, words: &[&str]| {
        dynocal_files::atomic::write(&tmp.path().join("bad.toml"), FILM.replace(from, to).as_bytes())
            .unwrap();
        let o = dynocal(tmp.path(), &["label", "bad.toml", "--out", "bad"]);
        assert_eq!(o.code, 2, "{}{}", o.stdout, o.stderr);
        words.iter().for_each(|w| assert!(o.stderr.contains(w), "{w}: {}", o.stderr));
    };
    refused("op = \"film\"", "op = \"filmm\"", &["bad.toml:", "nodes[3].op", "did you mean `film`"]);
    refused("[\"fuel\", \"x\", \"tau\"]", "[\"fuel\", \"x\"]", &["nodes[3].in", "3: fuel"]);
    refused(
        "label = \"TAU\"",
        "label = \"TUA\"",
        &["has 1 fault", "nodes[2].label", "expected one of X, TAU"],
    );
    refused("greatest = 0.9", "greatest = -1.0", &["labels[0]", "a value below `greatest`"]);
    refused("target = \"out\"", "target = \"uot\"", &["film.csv", "`uot`"]);
    refused("base = [0.3]", "base = [0.3, 1.0]", &["labels[1]", "found 2 values"]);
}

/// The shipped example: a drive of the virtual engine, the air charge and the torque structure of it.
#[test]
fn the_shipped_example_is_calibrated() {
    let shipped = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../examples/labels_gtdi");
    let dir = tempfile::tempdir().unwrap();
    for name in ["inputs.csv", "bed.toml", "air_charge.toml", "torque.toml"] {
        std::fs::copy(shipped.join(name), dir.path().join(name)).unwrap();
    }
    let drive =
        "engine transient inputs.csv --bed bed.toml --parameters gtdi_2l --every-s 0.05 --csv drive.csv";
    let driven = dynocal(dir.path(), &drive.split(' ').collect::<Vec<_>>());
    assert_eq!(driven.code, 0, "{}", driven.stderr);
    for spec in ["air_charge.toml", "torque.toml"] {
        let found = dynocal(dir.path(), &["label", spec, "--out", spec.trim_end_matches(".toml")]);
        assert_eq!(found.code, 0, "{spec}: {}{}", found.stdout, found.stderr);
        assert!(found.stdout.starts_with("The labels may be used"), "{}", found.stdout);
    }
    let dcm = std::fs::read_to_string(dir.path().join("torque/LABELS.dcm")).unwrap();
    assert!(dcm.contains("TORQUE_OPT") && dcm.contains("SENSOR_LAG"), "{dcm}");
}
