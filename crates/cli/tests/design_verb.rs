//! What a user sees of `dynocal design`: a plan within its limits, its report, and messages that say what is wrong.

use std::path::{Path, PathBuf};

use assert_cmd::Command;
use dynocal_files::{atomic, csv_io};
use serde_json::Value;

struct Outcome {
    folder: tempfile::TempDir,
    code: i32,
    stdout: String,
    stderr: String,
}

impl Outcome {
    fn summary(&self) -> Value {
        assert!(self.code < 2, "{}", self.stderr);
        serde_json::from_str(&self.stdout).unwrap()
    }

    fn column(&self, file: &str, name: &str) -> Vec<f64> {
        let table = csv_io::read(&self.folder.path().join("run").join(file)).unwrap();
        table.numbers(name, 0, table.rows()).unwrap().to_vec()
    }
}

fn design_at(spec: &Path, more: &[&str]) -> Outcome {
    let folder = tempfile::tempdir().unwrap();
    let mut command = Command::cargo_bin("dynocal").unwrap();
    command.current_dir(folder.path()).arg("design").arg(spec).args(["--out", "run", "--json"]).args(more);
    let out = command.output().unwrap();
    let text = |b: Vec<u8>| String::from_utf8(b).unwrap();
    Outcome { folder, code: out.status.code().unwrap(), stdout: text(out.stdout), stderr: text(out.stderr) }
}

fn design(spec: &str, files: &[(&str, &str)]) -> Outcome {
    let place = tempfile::tempdir().unwrap();
    for (name, text) in files {
        atomic::write(&place.path().join(name), text.as_bytes()).unwrap();
    }
    let path = place.path().join("spec.toml");
    atomic::write(&path, spec.as_bytes()).unwrap();
    design_at(&path, &[])
}

fn refused(spec: &str, files: &[(&str, &str)], parts: &[&str]) {
    let o = design(spec, files);
    assert_eq!((o.code, o.stdout.as_str()), (2, ""), "{}", o.stderr);
    // What is found wrong once the folder is open leaves its log there, and no result.
    let result = o.folder.path().join("run/summary.json");
    assert!(!o.stderr.contains("bug in dynocal") && !result.exists(), "{}", o.stderr);
    for part in parts {
        assert!(o.stderr.contains(part), "no `{part}` in:\n{}", o.stderr);
    }
}

/// The box of thesis eq. (4.16) with its torque model and few evaluations.
const TORQUE: &str = r#"
certificate = false
length_s = 10.0
sample_time_s = 0.1
convention = "trim"
rivals = 5
channels = [
  { name = "fpw", unit = "us", lower = 2000.0, upper = 6000.0 },
  { name = "abv", unit = "-", lower = 0.4, upper = 0.6 },
  { name = "speed", unit = "rpm", lower = 1000.0, upper = 2000.0 },
]
search = { name = "local", starts = 2, evaluations = 150 }
[[models]]
literature = "torque_4_17"
criterion = "d"
"#;

fn torque(from: &str, to: &str) -> String {
    assert!(TORQUE.contains(from), "{from}");
    TORQUE.replacen(from, to, 1)
}

#[test]
fn the_example_keeps_all_its_limits_and_beats_random_signals() {
    let spec = PathBuf::from(env!("CARGO_MANIFEST_DIR")).join("../../examples/design/spec.toml");
    let o = design_at(&spec, &[]);
    assert_eq!(o.code, 0, "{}", o.stderr);
    let s = o.summary();
    let (fpw, abv) = (o.column("design.csv", "fpw"), o.column("design.csv", "abv"));
    let speed = o.column("design.csv", "speed");
    assert_eq!((fpw.len(), fpw[0], fpw[299]), (300, 3000.0, 3000.0));
    assert!(
        fpw.chunks(2).all(|h| h[0] == h[1]) && fpw.windows(2).all(|w| (w[1] - w[0]).abs() <= 1500.0 + 1e-9)
    );
    assert!(abv.iter().all(|v| [0.4, 0.45, 0.5, 0.55, 0.6].contains(v)));
    assert!(speed[0] == 1500.0 && speed.windows(2).all(|w| (w[1] - w[0]).abs() <= 40.0 + 1e-9));
    for t in 0..300 {
        // The triangle: right of 4500 and below the line from (4500, 900) to (6100, 1400).
        let line = 900.0 + (fpw[t] - 4500.0) * 500.0 / 1600.0;
        assert!(fpw[t] <= 4500.0 || speed[t] >= line - 1e-6, "smoke at {t}: {} {}", fpw[t], speed[t]);
        let inside = abv[t] < 0.44 && 1700.0 + 1e-6 < speed[t] && speed[t] < 1900.0 - 1e-6;
        assert!(!inside, "resonance at {t}: {} {}", abv[t], speed[t]);
    }
    let torque = o.column("predicted.csv", "torque");
    assert!(torque.iter().all(|y| (-7.0 - 1e-3..=37.0 + 1e-3).contains(y)));
    let safety = &s["safety"][0];
    assert_eq!(safety["margin"]["basis"], "given");
    assert!(safety["least_distance"][0].as_f64().unwrap() >= 3.0 - 1e-3);
    assert_eq!((&s["information"][0]["rank"], &s["information"][0]["parameters"]), (&23.into(), &23.into()));
    for e in s["efficiencies"].as_array().unwrap() {
        // The best of the random signals, not only the median.
        assert!(e["d_percent"][2].as_f64().unwrap() < 60.0, "{e}");
        // Every rival that was drawn keeps the limits of the torque, and bed time is that of the best: information adds up over
        // samples, so that it needs 300 / share of them.
        assert_eq!(e["signals"], 20, "{e}");
        let best = e["i_percent"][2].as_f64().unwrap() / 100.0;
        let samples = e["same_error_samples"].as_f64().unwrap();
        assert!((samples * best - 300.0).abs() < 1e-6 && samples > 300.0, "{e}");
    }
    // A bound is below every design, hence also below this one, and the efficiency follows from both.
    let (bound, value) =
        (s["certificate"]["bound"].as_f64().unwrap(), s["criteria"][0]["value"].as_f64().unwrap());
    let percent = s["certificate"]["efficiency_percent"].as_f64().unwrap();
    assert!(
        bound < value && (percent - 100.0 * ((bound - value) / 23.0).exp()).abs() < 1e-6,
        "{bound} {percent}"
    );
    let page = std::fs::read_to_string(o.folder.path().join("run/report.html")).unwrap();
    for part in [
        "Certificate",
        "What the design is worth",
        "Predicted outputs",
        "margin as given",
        "resonance",
        "Convergence",
    ] {
        assert!(page.contains(part), "no {part}");
    }
}

#[test]
fn the_same_seed_gives_the_same_bytes_for_any_number_of_threads() {
    let place = tempfile::tempdir().unwrap();
    let path = place.path().join("spec.toml");
    atomic::write(&path, TORQUE.as_bytes()).unwrap();
    let bytes = |more: &[&str]| {
        let o = design_at(&path, more);
        assert!(o.code < 2, "{}", o.stderr);
        (std::fs::read(o.folder.path().join("run/design.csv")).unwrap(), o.stdout)
    };
    let one = bytes(&["--threads", "1"]);
    assert_eq!(one, bytes(&["--threads", "4"]));
    assert_ne!(one.0, bytes(&["--seed", "9"]).0);
}

/// y(t) = 0.6 y(t-1) + b u(t-1) + c u(t-1)^2 through a model file, with earlier and held-out records of a true system
/// that has a cube as well.
fn record(n: usize, salt: usize) -> String {
    let mut text = "time [s],u [mg],y [Nm]\n".to_string();
    let (mut y, mut before) = (0.0, 0.0f64);
    for t in 0..n {
        let u = (((t / 3 + salt) * (t / 3 + salt) * 7919) % 101) as f64 / 50.0 - 1.0;
        y = 0.6 * y + 2.0 * before + 0.5 * before * before + 0.3 * before.powi(3);
        before = u;
        text += &format!("{},{u},{y}\n", 0.1 * t as f64);
    }
    text
}

const IDENTIFY: &str = r#"
[data]
file = "bed.csv"
time = "time"
init_samples = 2
[[channels]]
column = "u"
role = "input"
[[channels]]
column = "y"
role = "output"
[split]
estimation_rows = [[0, 400]]
test_rows = [[400, 600]]
[model]
structure = { name = "polynomial", regressors = ["1", "u(t-1)", "u(t-1)^2", "y(t-1)"] }
estimator = { name = "ols" }
"#;

#[test]
fn a_model_of_identify_is_designed_for_with_margins_from_unseen_records() {
    let place = tempfile::tempdir().unwrap();
    let write = |name: &str, text: &str| atomic::write(&place.path().join(name), text.as_bytes()).unwrap();
    write("bed.csv", &record(600, 0));
    write("unseen.csv", &record(700, 31));
    write("identify.toml", IDENTIFY);
    let identify = Command::cargo_bin("dynocal")
        .unwrap()
        .current_dir(place.path())
        .args(["identify", "identify.toml", "--out", "model", "--quiet"])
        .output()
        .unwrap();
    assert!(identify.status.code().unwrap() < 2, "{}", String::from_utf8_lossy(&identify.stderr));
    let spec = |held_out: &str| {
        format!(
            "length_s = 12.0\nsample_time_s = 0.1\nrivals = 4\n\
             channels = [{{ name = \"u\", unit = \"mg\", lower = -1.0, upper = 1.0, hold_s = 0.3 }}]\n\
             search = {{ name = \"local\", starts = 2, evaluations = 200 }}\n\
             [objective]\nlength_s = 20.0\nsignals.u = {{ name = \"aprbs\", hold_s = 0.5 }}\n\
             [[models]]\nfile = \"model/steps/01-identify/model.json\"\nnoise_std = 0.1\ncriterion = \"i\"\n\
             prior = [\"bed.csv\"]\n{held_out}\nlimits = {{ lower = -4.0, upper = 5.0, rate = 0.1 }}\n"
        )
    };
    write("known.toml", &spec("held_out = [\"unseen.csv\"]"));
    write("blind.toml", &spec(""));
    let known = design_at(&place.path().join("known.toml"), &[]);
    let s = known.summary();
    let margin = &s["safety"][0]["margin"];
    assert_eq!((&margin["basis"], &margin["blocks"]), (&"quantile".into(), &34.into()));
    let value = margin["value"].as_f64().unwrap();
    assert!(value > 0.0 && value < 0.5, "{margin}");
    let y = known.column("predicted.csv", "y");
    let kept = margin["kept"].as_f64().unwrap() - 1e-3;
    assert!(y.iter().all(|y| (-4.0 + kept..=5.0 - kept).contains(y)), "{kept}");
    assert!(s["safety"][0]["outside"][0].as_f64().unwrap() > 0.0);
    // Without unseen records the margin is a share of the range, and the report says so.
    let blind = design_at(&place.path().join("blind.toml"), &[]);
    let b = blind.summary();
    assert_eq!(b["safety"][0]["margin"]["basis"], "range");
    assert!((b["safety"][0]["margin"]["value"].as_f64().unwrap() - 1.8).abs() < 1e-12);
    assert!(blind.stderr.contains("nothing is known about the error of `y`"), "{}", blind.stderr);
    // What was measured already counts: less is won than without it.
    assert!(s["information"][0]["bounds"][1][2].as_f64().unwrap() < 0.1);
}

#[test]
fn typing_errors_are_named_with_line_and_nearest_name() {
    refused(
        &torque("lower = 2000.0", "lowr = 2000.0"),
        &[],
        &["`channels[1].lowr`", "did you mean `lower`?"],
    );
    refused(
        &torque("criterion = \"d\"", "criterion = \"dd\""),
        &[],
        &["`models[1].criterion`", "one of d, a, wa"],
    );
    refused(&torque("torque_4_17", "torque_4_71"), &[], &["did you mean `torque_4_17`?"]);
    refused(&torque("\"local\"", "\"locale\""), &[], &["did you mean `local`?"]);
    refused(&torque("starts = 2", "window = 3, starts = 2"), &[], &["window"]);
    refused(&torque("length_s = 10.0\n", ""), &[], &["`length_s`: found nothing"]);
    refused(&torque("unit = \"us\", ", ""), &[], &["`channels[1].unit`: found nothing"]);
    refused(&torque("\"speed\", unit", "\"abv\", unit"), &[], &["`abv` twice"]);
    refused("", &[], &["empty", "spec in TOML"]);
    let region = "\n[[regions]]\nforbidden = { fpw = [0.0, 1.0], abw = [0.0, 1.0] }\n";
    refused(&(TORQUE.to_string() + region), &[], &["`regions[1]`", "`abw`", "did you mean `abv`?"]);
    refused(&(TORQUE.to_string() + "[[regions]]\nname = \"r\"\n"), &[], &["0 of the keys inside, outside"]);
}

#[test]
fn limits_that_exclude_every_signal_are_explained() {
    let fpw = "lower = 2000.0, upper = 6000.0";
    refused(
        &torque(fpw, "lower = 6500.0, upper = 6000.0"),
        &[],
        &["fpw lower bound 6500", "conflict by 500"],
    );
    refused(
        &torque(fpw, &format!("{fpw}, hold_s = 20.0")),
        &[],
        &["hold of 200 samples", "record of 100 samples"],
    );
    let ends = format!("{fpw}, start = 2000.0, end = 6000.0, rate_per_s = 100.0");
    refused(
        &torque(fpw, &ends),
        &[],
        &["start 2000 and end 6000", "rate limit 10 per sample", "conflict by 3010"],
    );
    refused(&torque(fpw, &format!("{fpw}, levels = [7000.0]")), &[], &["level 7000", "conflict by 1000"]);
    refused(&torque(fpw, "lower = 2000.0, upper = nan"), &[], &["fpw: bound", "NaN", "finite"]);
    let sums = "\n[[regions]]\nname = \"sum\"\nsum = { fpw = 1.0, speed = 1.0 }\nat_most = 2500.0\n";
    refused(&(TORQUE.to_string() + sums), &[], &["region `sum`", "fpw 2000 to 6000", "conflict by 500"]);
    let limits = "\nlimits = { lower = -10.0, upper = 40.0, margin = 26.0 }\n";
    refused(&(TORQUE.to_string() + limits), &[], &["`models[1].limits.margin`: found 26, expected 0 to 25"]);
    // An output limit that no input can keep: the best there is, with the output, the distance and the time.
    let far = "\nlimits = { lower = 500.0, upper = 600.0, margin = 1.0 }\n";
    let o = design(&(TORQUE.to_string() + far), &[]);
    assert_eq!(o.code, 1, "{}", o.stderr);
    assert_eq!(o.summary()["status"], "infeasible");
    assert!(o.stderr.contains("the prediction of `torque` passes a limit by"), "{}", o.stderr);
}

#[test]
fn models_and_signals_that_cannot_serve_are_refused_in_words() {
    // An objective signal outside the limits.
    let csv = "fpw [us],abv [-],speed [rpm]\n3000,0.5,1500\n3000,0.5,1500\n9000,0.5,1500\n";
    let objective = TORQUE.to_string() + "\n[objective]\nfile = \"u0.csv\"\n";
    refused(
        &objective,
        &[("u0.csv", csv)],
        &["objective signal: found fpw = 9000 us at sample 2, expected 2000 to 6000 us"],
    );
    refused(&objective, &[], &["u0.csv"]);
    refused(&objective, &[("u0.csv", &csv.replace("9000", "inf"))], &["u0.csv", "inf"]);
    // No noise: information without end.
    refused(
        &torque("criterion = \"d\"", "criterion = \"d\"\nnoise_std = 0.0"),
        &[],
        &["noise_std", "positive"],
    );
    // A record too short for the parameters: which combinations are not seen, in regressor names.
    refused(
        &torque("length_s = 10.0", "length_s = 2.0"),
        &[],
        &["torque: singular: rank 10 of 23; not seen:", "fpw(t-10)", "hint: leave out regressors"],
    );
    // Two levels make squares and constants alike.
    let levels = "lower = 2000.0, upper = 6000.0, levels = [2000.0, 6000.0]";
    let two = torque("lower = 2000.0, upper = 6000.0", levels);
    let o = design(&two, &[]);
    assert_eq!(o.code, 1, "{}", o.stderr);
    assert!(o.stderr.contains("sees 22 of 23 parameters of `torque`"), "{}", o.stderr);
    refused(
        &torque("sample_time_s = 0.1", "sample_time_s = 0.2"),
        &[],
        &["expected 0.1 s, that of the model"],
    );
    refused(&torque("\"abv\"", "\"valve\""), &[], &["`abv` as well, which the model needs"]);
    // An unstable model, as a file.
    let model = r#"{"schema": "dynocal/model", "schema_version": 2,
        "structure": {"kind": "polynomial", "inputs": ["fpw", "abv", "speed"], "output": "torque",
            "regressors": ["fpw(t-1)", "torque(t-1)"]},
        "inputs": [{"name": "fpw", "unit": "us"}, {"name": "abv", "unit": "-"}, {"name": "speed", "unit": "rpm"}],
        "output": {"name": "torque", "unit": "Nm"}, "sample_time_s": 0.1,
        "parameters": [{"name": "fpw(t-1)", "value": 0.01, "std_error": null}, {"name": "torque(t-1)", "value": 1.02, "std_error": null}],
        "estimator": "ols", "noise_variance": 1.0, "origin": "test"}"#;
    let unstable = torque("literature = \"torque_4_17\"", "file = \"model.json\"");
    refused(&unstable, &[("model.json", model)], &["torque is unstable", "free run grows from"]);
    refused(
        &unstable,
        &[("model.json", &model.replace("1.0, \"origin\"", "null, \"origin\""))],
        &["noise_std (in Nm)"],
    );
    let zero = model.replace("\"noise_variance\": 1.0", "\"noise_variance\": 0.0");
    refused(
        &unstable,
        &[("model.json", &zero)],
        &["torque: noise variance: found 0, expected a positive number"],
    );
}

/// A unit is no weight: with efficiencies the design does not depend on how large the noise of one of two models is.
#[test]
fn models_count_alike_by_their_efficiencies() {
    let both = |noise: f64, efficiencies: bool| {
        let second = "\n[[models]]\nliterature = \"lambda_4_53\"\nnoise_std = 0.2\ncriterion = \"i\"\n";
        let spec = TORQUE
            .replace("criterion = \"d\"", &format!("noise_std = {noise:?}\ncriterion = \"i\""))
            .replace("certificate = false", &format!("efficiencies = {efficiencies}"))
            .replace("starts = 2, evaluations = 150", "starts = 1, evaluations = 60");
        let o = design(&(spec + second), &[]);
        (o.column("design.csv", "fpw"), o.summary())
    };
    // A power of two, so that nothing is rounded.
    let (a, summary) = both(2.0, true);
    assert_eq!(a, both(8.0, true).0);
    assert_ne!(both(2.0, false).0, both(8.0, false).0);
    // Together they are the weighted sum that is minimised, and of a size.
    let lines = summary["criteria"].as_array().unwrap();
    let parts: Vec<f64> =
        lines.iter().map(|c| c["weight"].as_f64().unwrap() * c["value"].as_f64().unwrap()).collect();
    assert_eq!(parts.len(), 2);
    assert!(parts.iter().all(|p| 0.01 < *p && *p < 2.0), "{parts:?}");
    assert!((parts.iter().sum::<f64>() / summary["value"].as_f64().unwrap() - 1.0).abs() < 1e-9);
}
