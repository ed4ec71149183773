//! `dynocal identify` on records whose right answer is known.

use std::path::Path;

use assert_cmd::Command;
use dynocal_files::atomic;
use serde_json::Value;

const HEAD: &str = r#"
[data]
file = "bed.csv"
sample_time_s = 0.1
init_samples = 2

[[channels]]
column = "u"
unit = "mg"
role = "input"

[[channels]]
column = "y"
unit = "Nm"
role = "output"
"#;

const ROWS: &str = "[split]\nestimation_rows = [[0, 200]]\ntest_rows = [[200, 300]]\n";
const ARX: &str = "[model]\nstructure = { name = \"arx\", na = 1, nb = 1 }\nestimator = { name = \"ols\" }\n";

/// A fixed sequence in -1..1 that excites.
fn u(t: usize) -> f64 {
    ((t * t * 7919) % 101) as f64 / 50.0 - 1.0
}

/// y(t) = 0.5 + 0.8 y(t-1) + 2 u(t-1).
fn rows(n: usize) -> Vec<(f64, f64)> {
    let mut out: Vec<(f64, f64)> = Vec::new();
    for t in 0..n {
        let y = out.last().map_or(0.0, |(u, y)| 0.5 + 0.8 * y + 2.0 * u);
        out.push((u(t), y));
    }
    out
}

fn csv(head: &str, rows: &[(f64, f64)]) -> String {
    rows.iter().fold(format!("{head}\n"), |text, (u, y)| text + &format!("{u},{y}\n"))
}

fn record(n: usize) -> String {
    csv("u [mg],y [Nm]", &rows(n))
}

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

    fn json(&self, file: &str) -> Value {
        dynocal_files::json::read(&self.folder.path().join("run").join(file)).unwrap()
    }

    fn report(&self) -> String {
        std::fs::read_to_string(self.folder.path().join("run/report.html")).unwrap()
    }
}

fn identify(spec: &str, files: &[(&str, String)]) -> Outcome {
    let folder = tempfile::tempdir().unwrap();
    atomic::write(&folder.path().join("spec.toml"), spec.as_bytes()).unwrap();
    for (name, text) in files {
        atomic::write(&folder.path().join(name), text.as_bytes()).unwrap();
    }
    run(folder, &["identify", "spec.toml", "--out", "run", "--json"])
}

fn run(folder: tempfile::TempDir, args: &[&str]) -> Outcome {
    let out = Command::cargo_bin("dynocal").unwrap().current_dir(folder.path()).args(args).output().unwrap();
    Outcome {
        folder,
        code: out.status.code().unwrap(),
        stdout: String::from_utf8(out.stdout).unwrap(),
        stderr: String::from_utf8(out.stderr).unwrap(),
    }
}

/// The message of a spec or record that cannot be used.
fn refused(spec: &str, files: &[(&str, String)]) -> String {
    let o = identify(spec, files);
    assert_eq!((o.code, o.stdout.as_str()), (2, ""), "{}", o.stderr);
    assert!(o.stderr.contains("error: ") && !o.stderr.contains("panicked"), "{}", o.stderr);
    for word in ["usize", "u64", "f64", "tuple", "struct ", "enum", "sequence"] {
        assert!(!o.stderr.contains(word), "`{word}` in {}", o.stderr);
    }
    o.stderr
}

fn has(text: &str, part: &str) {
    assert!(text.contains(part), "no `{part}` in:\n{text}");
}

fn score<'a>(summary: &'a Value, output: &str, part: &str, kind: &Value) -> &'a Value {
    let all = summary["scores"].as_array().unwrap();
    let mine = |s: &&Value| s["output"] == output && s["part"] == part && s["kind"] == *kind;
    all.iter().find(mine).unwrap_or_else(|| panic!("no {output} {part} {kind}: {all:?}"))
}

fn rmse(summary: &Value, output: &str, part: &str) -> f64 {
    score(summary, output, part, &"free_run".into())["rmse"].as_f64().unwrap()
}

#[test]
fn outputs_that_drive_each_other_are_one_set() {
    // a(t) = 0.5 a(t-1) + 0.2 b(t-1) + u(t-1),  b(t) = 0.3 a(t-2) - 0.4 b(t-1)
    let (mut a, mut b) = (vec![0.0, 0.0], vec![0.5, 0.1]);
    for t in 2..300 {
        a.push(0.5 * a[t - 1] + 0.2 * b[t - 1] + u(t - 1));
        b.push(0.3 * a[t - 2] - 0.4 * b[t - 1]);
    }
    let text = (0..300).fold("u,a,b\n".to_string(), |s, t| s + &format!("{},{},{}\n", u(t), a[t], b[t]));
    let channels = ["u", "a", "b"].map(|c| {
        let role = if c == "u" { "input" } else { "output" };
        format!("[[channels]]\ncolumn = \"{c}\"\nunit = \"-\"\nrole = \"{role}\"\n")
    });
    let spec = format!(
        "[data]\nfile = \"bed.csv\"\nsample_time_s = 1.0\ninit_samples = 3\n{}{ROWS}[model]\ntargets = [\"a\", \"b\"]\n\
         structure = {{ name = \"polynomial\", regressors = [\"a(t-1)\", \"b(t-1)\", \"u(t-1)\"] }}\n\
         structures.b = {{ name = \"polynomial\", regressors = [\"a(t-2)\", \"y(t-1)\"] }}\n\
         estimator = {{ name = \"ols\" }}\n[validate]\nk_steps = [1, 5]\nband = {{ a = 0.5 }}\n",
        channels.concat()
    );
    let o = identify(&spec, &[("bed.csv", text)]);
    assert_eq!(o.code, 0, "{}", o.stderr);
    let s = o.summary();
    for target in ["a", "b"] {
        assert!(rmse(&s, target, "test") < 1e-9);
        let ahead = score(&s, target, "test", &serde_json::json!({"k_step": 5}));
        assert!(ahead["rmse"].as_f64().unwrap() < 1e-9);
    }
    // The values of the target alone are the parameters; `y` in the text is the target.
    let model = o.json("steps/01-identify/model-b.json");
    assert_eq!(model["structure"]["kind"], "polynomial");
    assert_eq!(model["structure"]["regressors"], serde_json::json!(["a(t-2)", "b(t-1)"]));
    assert!((model["parameters"][1]["value"].as_f64().unwrap() + 0.4).abs() < 1e-9);
    assert_eq!(score(&s, "a", "test", &"free_run".into())["in_band_percent"], 100.0);
    let page = o.report();
    has(&page, "5 steps");
    has(&page, "Autocorrelation");
    // An output of the same sample leaves no order to compute in.
    let looped = spec.replace("\"a(t-1)\", \"b(t-1)\", \"u(t-1)\"", "\"a(t-1)\", \"b(t)\", \"u(t-1)\"");
    let o = refused(
        &looped,
        &[(
            "bed.csv",
            (0..300).fold("u,a,b\n".into(), |s: String, t| s + &format!("{},{},{}\n", u(t), a[t], b[t])),
        )],
    );
    has(&o, "uses the output `b` of the same sample");
}

#[test]
fn linear_model_with_noise_is_stored_and_scored() {
    // ARMAX: y(t) = 0.8 y(t-1) + 2 u(t-1) + e(t) + 0.6 e(t-1), e from a generator of its own.
    let mut rng = dynocal_numerics::rng::Rng64::stream(5, 0);
    let (mut text, mut y, mut before) = (String::from("u [mg],y [Nm]\n"), 0.0, 0.0);
    for t in 0..1500 {
        let e = 0.3 * rng.normal();
        if t > 0 {
            y = 0.8 * y + 2.0 * u(t - 1) + e + 0.6 * before;
        }
        before = e;
        text += &format!("{},{y}\n", u(t));
    }
    let split = "[split]\nestimation_rows = [[0, 1000]]\ntest_rows = [[1000, 1500]]\n";
    let model =
        "[model]\nstructure = { name = \"armax\", na = 1, nb = 1, nc = 1 }\nestimator = { name = \"pem\" }\n";
    let steps = "[validate]\nk_steps = [2]\n";
    let o = identify(&format!("{HEAD}{split}{model}{steps}"), &[("bed.csv", text.clone())]);
    let s = o.summary();
    let file = o.json("steps/01-identify/model.json");
    assert_eq!((&file["structure"]["kind"], &file["structure"]["nc"]), (&"linear".into(), &1.into()));
    for (p, truth) in file["parameters"].as_array().unwrap().iter().zip([-0.8, 2.0, 0.6]) {
        let (value, error) = (p["value"].as_f64().unwrap(), p["std_error"].as_f64().unwrap());
        assert!((value - truth).abs() < 4.0 * error && error < 0.1, "{p} {truth}");
    }
    // One step: e remains, standard deviation 0.3. Free run: (1 + 0.6 q)/(1 - 0.8 q) e, variance 0.09 (1 + 1.4^2/0.36).
    let one = score(&s, "y", "test", &"one_step".into())["rmse"].as_f64().unwrap();
    let free = rmse(&s, "y", "test");
    assert!((one - 0.3).abs() < 0.04, "{one}");
    let expected = (0.09_f64 * (1.0 + 1.96 / 0.36)).sqrt();
    assert!((free - expected).abs() < 0.25 * expected, "{free} {expected}");
    // Two steps: e(t) + 1.4 e(t-1).
    let kind = serde_json::json!({ "k_step": 2 });
    let two = score(&s, "y", "test", &kind)["rmse"].as_f64().unwrap();
    assert!((two / (0.3 * (1.0 + 1.96_f64).sqrt()) - 1.0).abs() < 0.12, "{two}");
    // The same system as a polynomial with innovations: the same numbers, by another estimator.
    let terms = r#"["y(t-1)", "u(t-1)", "e(t-1)"]"#;
    let narmax = format!(
        "[model]\nstructure = {{ name = \"narmax\", regressors = {terms} }}\nestimator = {{ name = \"els\" }}\n"
    );
    let o = identify(&format!("{HEAD}{split}{narmax}{steps}"), &[("bed.csv", text.clone())]);
    let other = o.summary();
    let stored = o.json("steps/01-identify/model.json");
    assert_eq!(stored["structure"]["kind"], "narmax");
    for (p, truth) in stored["parameters"].as_array().unwrap().iter().zip([0.8, 2.0, 0.6]) {
        let (value, error) = (p["value"].as_f64().unwrap(), p["std_error"].as_f64().unwrap());
        assert!((value - truth).abs() < 4.0 * error && error < 0.1, "{p} {truth}");
    }
    for kind in ["one_step".into(), kind, "free_run".into()] {
        let of = |s: &Value| score(s, "y", "test", &kind)["rmse"].as_f64().unwrap();
        assert!((of(&other) / of(&s) - 1.0).abs() < 0.03, "{kind}: {} {}", of(&other), of(&s));
    }
    let wrong = format!("{HEAD}{split}{}", narmax.replace("els", "ols"));
    has(
        &refused(&wrong, &[("bed.csv", text.clone())]),
        "for the structure `narmax` one of the estimators els; `ols` fits polynomial, arx",
    );
    // The estimator and the structure have to agree.
    let wrong = format!("{HEAD}{split}{}", model.replace("pem", "ols"));
    has(
        &refused(&wrong, &[("bed.csv", text.clone())]),
        "for the structure `armax` one of the estimators pem",
    );
    let wrong = format!("{HEAD}{split}{}", model.replace("armax\", na = 1, nb = 1, nc = 1", "poly_arx\""));
    has(
        &refused(&wrong, &[("bed.csv", text)]),
        "for the structure `poly_arx` one of the estimators ols, rls, iv, sem, train; `pem` fits linear_arx, armax",
    );
}

#[test]
fn shares_blocks_and_test_files() {
    let shares = "[split]\nfractions = [0.7, 0.15, 0.15]\n";
    let o = identify(&format!("{HEAD}{shares}{ARX}"), &[("bed.csv", record(400))]);
    let s = o.summary();
    let samples = |part: &str| score(&s, "y", part, &"one_step".into())["samples"].as_u64().unwrap();
    assert_eq!([samples("estimation"), samples("selection"), samples("test")], [278, 58, 58]);
    let o = identify(&format!("{HEAD}{shares}blocks = 20\n{ARX}"), &[("bed.csv", record(400))]);
    let s = o.summary();
    let records = score(&s, "y", "estimation", &"one_step".into())["records"].as_u64().unwrap();
    assert!(records > 2 && rmse(&s, "y", "test") < 1e-9);
    let test = "[[test]]\nname = \"other\"\nfile = \"other.csv\"\ninit_samples = 10\ncolumns = { u = \"uVal\", y = \"yVal\" }\n";
    let other = csv("uVal [mg],yVal [Nm]", &rows(90));
    let o = identify(&format!("{HEAD}{test}{ARX}"), &[("bed.csv", record(300)), ("other.csv", other)]);
    let s = o.summary();
    assert_eq!(score(&s, "y", "other", &"free_run".into())["samples"], 80);
    assert!(rmse(&s, "y", "other") < 1e-9);
    has(
        &refused(&format!("{HEAD}[split]\nfractions = [0.7, 0.7]\n{ARX}"), &[]),
        "shares from 0 to 1 with sum 1",
    );
}

#[test]
fn several_files_are_several_experiments() {
    let two = HEAD.replace("file = \"bed.csv\"", "files = [\"a.csv\", \"b.csv\"]");
    let spec = format!("{two}{ARX}");
    let o = identify(&spec, &[("a.csv", record(100)), ("b.csv", record(80))]);
    let s = o.summary();
    assert_eq!(score(&s, "y", "estimation", &"one_step".into())["records"], 2);
    has(&o.stdout, "estimation-b-record.csv");
    // Another unit, another sample time, a missing channel, NaN in one of them: named with the file.
    let ms = two.replace("unit = \"mg\"\n", "");
    let e = refused(
        &format!("{ms}{ARX}"),
        &[("a.csv", record(100)), ("b.csv", record(80).replace("[mg]", "[g]"))],
    );
    has(&e, "b-record: channel `u` is in `g`, in a-record it is in `mg`");
    let e = refused(&spec, &[("a.csv", record(100)), ("b.csv", record(80).replace("y [Nm]", "w [Nm]"))]);
    has(&e, "b.csv: no column `y`");
    let e = refused(&spec, &[("a.csv", record(100)), ("b.csv", record(80).replacen("-1,0\n", "-1,\n", 1))]);
    has(&e, "b.csv, line 2, column `y`");
    let timed = |dt: f64, n: usize| {
        let lines = rows(n).into_iter().enumerate().map(|(k, (u, y))| format!("{},{u},{y}\n", k as f64 * dt));
        format!("time [s],u [mg],y [Nm]\n{}", lines.collect::<String>())
    };
    let spec = spec.replace("sample_time_s = 0.1", "time = \"time\"");
    let e = refused(&spec, &[("a.csv", timed(0.1, 100)), ("b.csv", timed(0.2, 80))]);
    has(&e, "b-record: sample time 0.2 s, expected 0.1 s as in a-record");
}

#[test]
fn faults_of_a_spec_in_words_for_engineers() {
    let data = [("bed.csv", record(300))];
    let spec = format!("{HEAD}{ROWS}{ARX}");
    let with = |from: &str, to: &str| {
        assert!(spec.contains(from), "{from}");
        refused(&spec.replace(from, to), &data)
    };
    has(
        &with("sample_time_s = 0.1", "sample_time_s = \"fast\""),
        "found the text \"fast\", expected a number",
    );
    has(
        &with("init_samples = 2", "init_samples = -2"),
        "`data.init_samples`: found -2, expected a whole number, 0 or more",
    );
    has(&with("[[0, 200]]", "[[0]]"), "expected a list of 2 values");
    has(&with("na = 1", "na = 1.5"), "expected a whole number, 0 or more");
    has(&with("na = 1", "na = \"two\""), "found the text \"two\"");
    has(&with("role = \"input\"", "role = \"driver\""), "expected one of input, output, auxiliary");
    has(&with("[split]", "[[split]]"), "spec.toml");
    has(&with("[model]", "[model]\ntargets = [\"y\", \"y\"]"), "each target once");
    has(&with("[model]", "[model]\ntarget = \"x\""), "`model.target`: found `x`, expected one of u, y");
    has(&with("\"arx\"", "\"arxx\""), "did you mean `arx`?");
    let e = refused(&format!("{spec}[validate]\nfolds = 1\nband = {{ z = 1.0 }}\n"), &data);
    has(&e, "`validate.folds`: found 1");
    has(&e, "`validate.band`: found `z`, expected one of y");
}

#[test]
fn records_that_cannot_tell_the_parameters() {
    // More parameters than samples.
    let many = ARX.replace("na = 1, nb = 1", "na = 30, nb = 60");
    let e = refused(&format!("{HEAD}{many}"), &[("bed.csv", record(100))]);
    has(&e, "(91 parameters)");
    // Two inputs that are the same: the terms that cannot be told apart are named.
    let twice = csv("u [mg],y [Nm]", &rows(300)).lines().enumerate().fold(String::new(), |s, (k, l)| {
        let v = l.split(',').next().unwrap();
        s + &if k == 0 { format!("{l},v [mg]\n") } else { format!("{l},{v}\n") }
    });
    let head = format!("{HEAD}[[channels]]\ncolumn = \"v\"\nunit = \"mg\"\nrole = \"input\"\n");
    let o = identify(&format!("{head}{ROWS}{ARX}"), &[("bed.csv", twice)]);
    assert!(o.code < 2, "{}", o.stderr);
    has(&o.stderr, "u(t-1)");
    has(&o.stderr, "v(t-1)");
    assert_eq!(o.summary()["models"][0]["rank"], 3);
    assert!(!Path::new("run").exists());
}

#[test]
fn preparation_is_noted_and_scores_are_in_the_channels_own_unit() {
    // A level of 300 Nm on top, and three spikes in the estimation rows.
    let spiked: Vec<(f64, f64)> = rows(300)
        .into_iter()
        .enumerate()
        .map(|(t, (u, y))| (u, y + 300.0 + if [40, 90, 150].contains(&t) { 500.0 } else { 0.0 }))
        .collect();
    let steps = "[[prepare]]\nstep = \"hampel\"\nchannels = [\"y\"]\nhalf_width = 10\nn_sigma = 6.0\naction = \"mark\"\n\
                 [[prepare]]\nstep = \"offset\"\n";
    let spec = format!("{HEAD}{ROWS}{steps}{ARX}");
    let o = identify(&spec, &[("bed.csv", csv("u [mg],y [Nm]", &spiked))]);
    let s = o.summary();
    let found = score(&s, "y", "test", &"free_run".into());
    assert_eq!(found["unit"], "Nm");
    assert!(found["rmse"].as_f64().unwrap() < 1e-8, "{found}");
    let notes = s["preparation"][0]["notes"].as_array().unwrap();
    assert_eq!((&notes[0]["step"], &notes[1]["step"]), (&"hampel".into(), &"offset".into()));
    // Exactly the planted samples are marked, and what was subtracted from the test record is what the estimation gave.
    let runs = &notes[0]["changes"][0]["effect"]["runs"];
    let from: Vec<u64> = runs.as_array().unwrap().iter().map(|g| g["from"].as_u64().unwrap()).collect();
    assert_eq!(from, [40, 90, 150]);
    let level = |part: usize| {
        let changes = s["preparation"][part]["notes"][1]["changes"].as_array().unwrap();
        changes.iter().find(|c| c["channel"] == "y").unwrap()["effect"]["level"].as_f64().unwrap()
    };
    assert!(level(0) > 250.0 && level(0) == level(1));
    let model = o.json("steps/01-identify/model.json");
    assert_eq!(model["preparation"].as_array().unwrap().len(), 2);
    let page = o.report();
    has(&page, "1. hampel");
    has(&page, "2. offset");
    let e = refused(&spec.replace("\"hampel\"", "\"hampl\""), &[]);
    has(&e, "`prepare[1].step`: found `hampl`");
    has(&e, "did you mean `hampel`?");
}

#[test]
fn missing_cells_are_left_out_where_the_spec_says_so() {
    let text: String = record(300)
        .lines()
        .enumerate()
        .map(|(k, l)| {
            let (u, y) = l.split_once(',').unwrap();
            match k {
                30 | 31 | 77 => format!("{u},\n"),
                120 | 160 => format!(",{y}\n"),
                _ => format!("{l}\n"),
            }
        })
        .collect();
    let marked = HEAD.replace("init_samples = 2\n", "init_samples = 2\nmissing = \"mark\"\n");
    let o = identify(&format!("{marked}{ROWS}{ARX}"), &[("bed.csv", text.clone())]);
    let s = o.summary();
    for (p, truth) in s["models"][0]["parameters"].as_array().unwrap().iter().zip([0.5, 2.0, 0.8]) {
        assert!((p["value"].as_f64().unwrap() - truth).abs() < 1e-9, "{p} {truth}");
    }
    has(&o.stderr, "5 missing samples bridged");
    assert!(rmse(&s, "y", "test") < 1e-9);
    // Not without being asked, and not where a channel has nothing at all.
    let e = refused(&format!("{HEAD}{ROWS}{ARX}"), &[("bed.csv", text)]);
    has(&e, "bed.csv, line 121, column `u`");
    let empty = record(300).lines().enumerate().fold(String::new(), |s, (k, l)| {
        let y = l.split_once(',').unwrap().1;
        s + &if k == 0 { format!("{l}\n") } else { format!("NaN,{y}\n") }
    });
    let e = refused(&format!("{marked}{ROWS}{ARX}"), &[("bed.csv", empty)]);
    has(&e, "channel `u` is missing in all 200 samples");
    // A gap longer than the model remembers is named.
    let gap = record(300).lines().enumerate().fold(String::new(), |s, (k, l)| {
        let u = l.split_once(',').unwrap().0;
        s + &if (100..140).contains(&k) { format!("{u},\n") } else { format!("{l}\n") }
    });
    let o = identify(&format!("{marked}{ROWS}{ARX}"), &[("bed.csv", gap)]);
    has(&o.stderr, "a gap of 40 samples in `y` is longer than the longest lag (1)");
}

#[test]
fn irregular_stamps_need_a_step_that_resamples() {
    // A ramp is a ramp at any sample time.
    let mut text = String::from("time [s],u [mg],y [Nm]\n");
    for k in 0..400 {
        let t = 0.1 * f64::from(k) + if k % 3 == 1 { 0.04 } else { 0.0 };
        text += &format!("{t},{},{}\n", (0.9 * t).sin() + (2.3 * t).cos(), 3.0 * t);
    }
    let timed = HEAD.replace("sample_time_s = 0.1", "time = \"time\"");
    let e = refused(&format!("{timed}{ARX}"), &[("bed.csv", text.clone())]);
    has(&e, "time column `time`: interval");
    let step = "[[prepare]]\nstep = \"resample\"\nsample_time_s = 0.05\n";
    let o = identify(&format!("{timed}{step}{ARX}"), &[("bed.csv", text)]);
    let s = o.summary();
    let samples = score(&s, "y", "estimation", &"one_step".into())["samples"].as_u64().unwrap();
    assert!((790..=800).contains(&samples), "{samples}");
    assert_eq!(o.json("steps/01-identify/model.json")["sample_time_s"], 0.05);
}

#[test]
fn a_saved_model_scores_another_record() {
    // Another record: the same system under smaller inputs. Half of the first one is known as a part of it.
    let mut y = 0.0;
    let answer = |t| {
        let row = (0.7 * u(t), y);
        y = 0.5 + 0.8 * y + 2.0 * row.0;
        row
    };
    let other = csv("u [mg],y [Nm]", &(0..120).map(answer).collect::<Vec<_>>());
    let part = csv("u [mg],y [Nm]", &rows(120));
    let files = [("bed.csv", record(300)), ("other.csv", other), ("part.csv", part)];
    let o = identify(&format!("{HEAD}{ROWS}{ARX}"), &files);
    assert_eq!(o.code, 0, "{}", o.stderr);
    let model = "run/steps/01-identify/model.json";
    let o = run(o.folder, &["identify", "--model", model, "--data", "part.csv", "--out", "part", "--json"]);
    assert_eq!(score(&o.summary(), "y", "record", &"free_run".into())["data"], "identification");
    let args = ["identify", "--model", model, "--data", "other.csv", "--out", "again", "--json"];
    let o = run(o.folder, &args);
    let s = o.summary();
    let found = score(&s, "y", "record", &"free_run".into());
    assert!(found["rmse"].as_f64().unwrap() < 1e-9 && found["data"] == "unseen" && found["samples"] == 119);
    assert_eq!(s["models"][0]["status"], Value::Null);
    // The file that estimated it is not unseen under another name either.
    std::fs::copy(o.folder.path().join("bed.csv"), o.folder.path().join("copy.csv")).unwrap();
    let o = run(o.folder, &["identify", "--model", model, "--data", "copy.csv", "--out", "own", "--json"]);
    let s = o.summary();
    assert_eq!(score(&s, "y", "record", &"free_run".into())["data"], "identification");
    has(&s["warnings"].to_string(), "the model was estimated from this file");
    // With a spec, its layout is used; another sample time is another system.
    let o = run(o.folder, &["identify", "spec.toml", "--model", model, "--out", "third", "--json"]);
    assert_eq!(score(&o.summary(), "y", "test", &"free_run".into())["samples"], 98);
    let spec = std::fs::read_to_string(o.folder.path().join("spec.toml")).unwrap();
    let other = spec.replace("sample_time_s = 0.1", "sample_time_s = 0.2");
    atomic::write(&o.folder.path().join("spec.toml"), other.as_bytes()).unwrap();
    let o = run(o.folder, &["identify", "spec.toml", "--model", model, "--out", "fourth"]);
    has(&o.stderr, "sample time 0.2 s, expected 0.1 s as in the model of `y`");
}
