//! `dynocal new`: what it writes from a measurement file passes `--check` and runs, as it stands.

use std::fmt::Write;
use std::path::Path;

use assert_cmd::Command;
use dynocal_files::atomic;

fn dynocal(folder: &Path, args: &[&str]) -> (i32, String, String) {
    let done = Command::cargo_bin("dynocal").unwrap().current_dir(folder).args(args).output().unwrap();
    let text = |b: Vec<u8>| String::from_utf8(b).unwrap();
    (done.status.code().unwrap(), text(done.stdout), text(done.stderr))
}

fn ok(folder: &Path, args: &[&str]) -> String {
    let (code, out, err) = dynocal(folder, args);
    assert_eq!(code, 0, "{args:?}: {out}{err}");
    err
}

/// First-order answers to two inputs that jump, with what a table of a bed may hold beside them.
fn record(stamps: impl Fn(usize) -> f64) -> String {
    let mut text =
        String::from("Time [s],throttle [deg],Spark Adv (deg),speed [rpm],torque [Nm],state,idle\n");
    let (mut y, mut u, mut s) = (40.0, 12.0, 20.0);
    for k in 0..400 {
        y += 0.2 * (3.0 * u + 0.2 * s - 0.01 * (1500.0 + k as f64) - y);
        u = if k % 23 < 11 { 12.0 } else { 16.0 };
        s = if k % 37 < 20 { 15.0 } else { 25.0 };
        let word = if k < 100 { "warm" } else { "hot" };
        writeln!(text, "{:.4},{u},{s},{},{y:.6},{word},0", stamps(k), 1500 + k).unwrap();
    }
    text
}

fn written(folder: &Path, name: &str, text: &str) {
    atomic::write(&folder.join(name), text.as_bytes()).unwrap();
}

#[test]
fn an_identification_runs_from_a_file_alone() {
    let tmp = tempfile::tempdir().unwrap();
    written(tmp.path(), "bed.csv", &record(|k| 0.1 * k as f64));
    let said = ok(tmp.path(), &["new", "identify", "--from", "bed.csv", "--output", "torque"]);
    let spec = std::fs::read_to_string(tmp.path().join("bed.toml")).unwrap();
    for part in [
        "time = \"Time\"",
        "column = \"throttle\"\nunit = \"deg\"\nrole = \"input\"",
        "name = \"Spark_Adv\"",
        "column = \"torque\"\nunit = \"Nm\"\nrole = \"output\"",
        "Left out, `state`: words, e.g. `warm`",
        "Left out, `idle`: constant, 0",
    ] {
        assert!(spec.contains(part), "{part}\n{spec}");
    }
    assert!(!said.contains("--output"), "{said}");
    ok(tmp.path(), &["identify", "bed.toml", "--check"]);
    let (code, out, err) = dynocal(tmp.path(), &["identify", "bed.toml"]);
    assert!(code < 2, "{out}{err}");
    assert!(tmp.path().join("runs/bed/report.html").exists());
    // A model that is the linear one itself is not told to give way to it.
    assert!(!out.contains("take the linear model"), "{out}");
    // The nonlinear model of its comment runs in place of the linear one.
    let line = spec.lines().find_map(|l| l.strip_prefix("# select = ")).unwrap();
    let lines = spec
        .lines()
        .map(|l| if l.starts_with("structure = ") { format!("select = {line}") } else { l.into() });
    written(tmp.path(), "pool.toml", &lines.collect::<Vec<String>>().join("\n"));
    let (code, out, err) = dynocal(tmp.path(), &["identify", "pool.toml"]);
    assert!(code < 2, "{out}{err}");
    // Stamps in other units, by name or in brackets.
    for (name, head) in [("t_ms.csv", "t_ms,"), ("brackets.csv", "Time [ms],")] {
        written(tmp.path(), name, &record(|k| 100.0 * k as f64).replacen("Time [s],", head, 1));
        ok(tmp.path(), &["new", "identify", "--from", name, "--output", "torque", "--force"]);
        let plan = dynocal(tmp.path(), &["identify", &name.replace("csv", "toml"), "--check"]);
        assert!(plan.0 == 0 && plan.1.contains("280 samples"), "{plan:?}");
    }
    // One cell that is no number leaves a channel out, and that is said.
    let torn = record(|k| 0.1 * k as f64).replacen(",1507,", ",15o7,", 1);
    assert!(torn.contains("15o7"));
    written(tmp.path(), "torn.csv", &torn);
    let (code, _, err) =
        dynocal(tmp.path(), &["new", "identify", "--from", "torn.csv", "--output", "torque"]);
    assert!(
        code == 0 && err.contains("is left out: 1 of its ") && err.contains("the first `15o7` in line 9"),
        "{err}"
    );
    // A spec is a user's work: it is not written over.
    let (code, _, err) = dynocal(tmp.path(), &["new", "identify", "--from", "bed.csv"]);
    assert!(code == 2 && err.contains("--force"), "{err}");

    // From its model and the file a design, beside the first spec without a name of its own, and from the file a campaign on a bed.
    let model = "runs/bed/steps/01-identify/model.json";
    ok(tmp.path(), &["new", "design", "--from", "bed.csv", "--model", model]);
    ok(tmp.path(), &["design", "bed-design.toml", "--check"]);
    let design = ["new", "design", "--from", "bed.csv", "--to", "specs/next.toml", "--model", model];
    std::fs::create_dir(tmp.path().join("specs")).unwrap();
    ok(tmp.path(), &design);
    ok(tmp.path(), &["design", "specs/next.toml", "--check"]);
    let (code, out, err) = dynocal(tmp.path(), &["design", "specs/next.toml"]);
    assert!(code < 2 && tmp.path().join("runs/next/design.csv").exists(), "{out}{err}");
    let (code, _, err) = dynocal(tmp.path(), &["new", "design", "--from", "bed.csv", "--to", "no.toml"]);
    assert!(code == 2 && err.contains("--model"), "{err}");

    ok(tmp.path(), &["new", "calibrate", "--from", "bed.csv", "--to", "bed2.toml", "--output", "torque"]);
    let spec = std::fs::read_to_string(tmp.path().join("bed2.toml")).unwrap();
    assert!(spec.contains("output = \"torque\"\ninput = \"throttle\""), "{spec}");
    ok(tmp.path(), &["calibrate", "bed2.toml", "--check"]);
    let (code, out, err) = dynocal(tmp.path(), &["calibrate", "bed2.toml"]);
    assert!(code == 1 && err.contains("to be run on the bed"), "{out}{err}");
}

/// Files as they come: stamps that jitter, a pause, empty cells, no time at all, steady points.
#[test]
fn files_as_they_come_are_taken_or_refused_with_the_flag_that_helps() {
    let tmp = tempfile::tempdir().unwrap();
    let folder = tmp.path();
    let uneven = |k: usize| 0.1 * k as f64 + if k % 7 == 3 { 0.02 } else { 0.0 };
    written(folder, "uneven.csv", &record(uneven));
    written(folder, "pause.csv", &record(|k| 0.1 * k as f64 + if k < 200 { 0.0 } else { 60.0 }));
    let gaps: String = record(|k| 0.1 * k as f64).replace(",1600,", ",,").replace(",1630,", ",,");
    written(folder, "gaps.csv", &gaps);
    for (name, part) in [
        ("uneven", "step = \"resample\"\nsample_time_s = 0.1"),
        ("pause", "cut = { gap_s = 2.0"),
        ("gaps", "missing = \"mark\""),
    ] {
        ok(folder, &["new", "identify", "--from", &format!("{name}.csv"), "--output", "torque"]);
        let spec = std::fs::read_to_string(folder.join(format!("{name}.toml"))).unwrap();
        assert!(spec.contains(part), "{name}: {spec}");
        ok(folder, &["identify", &format!("{name}.toml"), "--check"]);
        let (code, out, err) = dynocal(folder, &["identify", &format!("{name}.toml")]);
        assert!(code < 2, "{name}: {out}{err}");
    }
    let table: String = (0..40).map(|k| format!("{},{},{}\n", k % 7, k % 5, (k % 7) * (k % 5))).collect();
    written(folder, "points.csv", &format!("speed [rpm],load [%],egt [K]\n{table}"));
    let (code, _, err) = dynocal(folder, &["new", "identify", "--from", "points.csv"]);
    assert!(code == 2 && err.contains("--sample-time-s") && err.contains("--steady"), "{err}");
    ok(folder, &["new", "identify", "--from", "points.csv", "--steady"]);
    ok(folder, &["identify", "points.toml", "--check"]);
    assert!(dynocal(folder, &["identify", "points.toml"]).0 < 2);
    let (code, _, err) = dynocal(
        folder,
        &["new", "identify", "--from", "points.csv", "--steady", "--force", "--output", "egd"],
    );
    assert!(code == 2 && err.contains("egt"), "{err}");
    // What is wanted and cannot be had is named with its first cell; stamps twice with what makes them one.
    let bad = record(|k| 0.1 * k as f64).replacen(",warm", "o,warm", 1);
    written(folder, "bad.csv", &bad);
    let (code, _, err) = dynocal(folder, &["new", "identify", "--from", "bad.csv", "--output", "torque"]);
    assert!(
        code == 2 && err.contains("1 of its 400 cells are no numbers") && err.contains("in line 2"),
        "{err}"
    );
    written(folder, "twice.csv", &record(|k| 0.1 * (k - k % 20 / 19) as f64));
    let (code, _, err) = dynocal(folder, &["new", "identify", "--from", "twice.csv", "--output", "torque"]);
    assert!(code == 2 && err.contains("20 stamps that repeat") && err.contains("dynocal convert"), "{err}");
    assert!(!folder.join("bad.toml").exists() && !folder.join("twice.toml").exists());
}

/// Limits near the edges of what was identified leave the plan the room between them: the band, which grows where the plan
/// leaves the records, ends near a limit and does not drive the plan into the middle.
#[test]
fn a_first_design_uses_the_room_between_its_limits() {
    let tmp = tempfile::tempdir().unwrap();
    let mut state = 5_u64;
    let mut draw = |low: f64, high: f64| {
        state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        low + (high - low) * ((state >> 11) as f64 / (1_u64 << 53) as f64)
    };
    let (mut pedal, mut angle, mut x1, mut x2) = (0.0, 0.0, 0.0_f64, 0.0);
    let (mut text, mut range) =
        (String::from("Time [s],Pedal [%],Angle [deg],Torque [Nm]\n"), (f64::MAX, f64::MIN));
    for k in 0..1500 {
        if k % 15 == 0 {
            pedal = draw(0.0, 100.0);
        }
        if k % 22 == 0 {
            angle = draw(-10.0, 30.0);
        }
        x1 = 0.85 * x1 + 0.15 * (0.02 * pedal + 0.0004 * pedal * pedal + 0.01 * angle);
        x2 = 0.7 * x2 + 0.3 * (0.05 * angle - 0.01 * x1 * angle);
        let y = 20.0 + 8.0 * x1 + 4.0 * x2 + draw(-0.25, 0.25);
        range = (range.0.min(y), range.1.max(y));
        text += &format!("{:.1},{pedal:.4},{angle:.4},{y:.4}\n", 0.1 * f64::from(k));
    }
    written(tmp.path(), "bench.csv", &text);
    ok(tmp.path(), &["new", "identify", "--from", "bench.csv"]);
    let spec = std::fs::read_to_string(tmp.path().join("bench.toml")).unwrap();
    let pool = "select = { name = \"forward\", pool = { ny = 4, nu = 4, degree = 2 } }";
    let lines = spec.lines().map(|l| if l.starts_with("structure = ") { pool } else { l });
    written(tmp.path(), "bench.toml", &lines.collect::<Vec<&str>>().join("\n"));
    assert!(dynocal(tmp.path(), &["identify", "bench.toml"]).0 < 2);
    ok(
        tmp.path(),
        &["new", "design", "--from", "bench.csv", "--model", "runs/bench/steps/01-identify/model.json"],
    );
    let spec = std::fs::read_to_string(tmp.path().join("bench-design.toml")).unwrap();
    let limits = format!("limits = {{ lower = {:.1}, upper = {:.1}, margin = 2.0 }}", range.0, range.1);
    let lines = spec.lines().map(|l| if l.starts_with("# limits = ") { limits.as_str() } else { l });
    written(tmp.path(), "bench-design.toml", &lines.collect::<Vec<&str>>().join("\n"));
    let (code, out, err) = dynocal(tmp.path(), &["design", "bench-design.toml", "--json"]);
    assert!(code < 2, "{out}{err}");
    let summary: serde_json::Value = serde_json::from_str(&out).unwrap();
    let line = &summary["safety"][0];
    let (band, width) = (line["least_distance_of_band"][0].as_f64().unwrap(), range.1 - range.0);
    let predicted = (line["predicted"][0].as_f64().unwrap(), line["predicted"][1].as_f64().unwrap());
    println!(
        "band to limit {band:.2} of {width:.2} Nm, predicted {predicted:?}, rounds {}",
        summary["rounds"]
    );
    assert!((0.0..0.15 * width).contains(&band), "band to limit {band} of {width}: {line}");
    assert!(predicted.1 - predicted.0 > 0.4 * width, "{predicted:?} of {range:?}");
}

/// Points of a steady table: torque by the throttle, spark free.
#[test]
fn a_steady_calibration_begins_with_a_table_of_points() {
    let tmp = tempfile::tempdir().unwrap();
    let mut text =
        String::from("point,speed [rpm],throttle [deg],inj [mg],spark [deg],torque [Nm],lambda [-]\n");
    for k in 0..60_u32 {
        let (n, a, s) = (1000 + 50 * k, 10.0 + f64::from(k * 7 % 30), 15.0 + f64::from(k * 11 % 20));
        let torque = 2.0 * a + 0.3 * s;
        writeln!(
            text,
            "{},{n},{a},{:.2},{s},{torque:.2},{:.3}",
            k + 1,
            0.4 * torque,
            0.99 + 0.0005 * f64::from(k % 40)
        )
        .unwrap();
    }
    written(tmp.path(), "points.csv", &text);
    let flags = ["new", "map", "--from", "points.csv", "--output", "torque", "--output", "lambda"];
    let said = ok(tmp.path(), &flags);
    assert!(said.contains("`spark` is optimised in every cell"), "{said}");
    // The numbers of the points are none that moves.
    assert!(said.contains("`throttle`, `inj`, `spark` are taken as inputs that may move"), "{said}");
    let spec = std::fs::read_to_string(tmp.path().join("points-map.toml")).unwrap();
    for part in
        ["[axes]", "lambda = 0.99", "output = \"torque\"\ninput = \"throttle\"", "# [optimise.resolution]"]
    {
        assert!(spec.contains(part), "{part}\n{spec}");
    }
    ok(tmp.path(), &["map", "points-map.toml", "--check"]);
    let (code, out, err) = dynocal(tmp.path(), &["map", "points-map.toml"]);
    assert!(code == 1 && err.contains("wait to be measured on the bed"), "{out}{err}");
    // The lines that are commented out can be taken as they are.
    let taken = spec.replace("# [optimise.resolution]\n# spark", "[optimise.resolution]\nspark");
    assert_ne!(taken, spec);
    written(tmp.path(), "taken.toml", &taken);
    ok(tmp.path(), &["map", "taken.toml", "--check"]);
    // Each demand takes an input: one has to be left.
    let few = [
        "new",
        "map",
        "--from",
        "points.csv",
        "--steady",
        "--output",
        "torque",
        "--input",
        "throttle",
        "--to",
        "few.toml",
    ];
    let (code, _, err) = dynocal(tmp.path(), &few);
    assert!(code == 2 && err.contains("one input more than demands") || err.contains("speed"), "{err}");
}
