//! `dynocal export`: a model that `identify` stored is taken away, and the C computes.

use std::path::Path;
use std::process::Output;

use assert_cmd::Command;
use dynocal_files::atomic;

fn dynocal(folder: &Path, args: &[&str]) -> Output {
    Command::cargo_bin("dynocal").unwrap().current_dir(folder).args(args).output().unwrap()
}

/// y(t) = 0.5 + 0.8 y(t-1) + 2 u(t-1), without noise.
fn record() -> String {
    let u = |t: usize| ((t * t * 7919) % 101) as f64 / 50.0 - 1.0;
    let mut y = 0.0;
    let mut text = String::from("u [mg],y [Nm]\n");
    for t in 0..300 {
        text.push_str(&format!("{},{y}\n", u(t)));
        y = 0.5 + 0.8 * y + 2.0 * u(t);
    }
    text
}

const SPEC: &str = "[data]\nfile = 'bed.csv'\nsample_time_s = 0.1\n\
    [[channels]]\ncolumn = 'u'\nunit = 'mg'\nrole = 'input'\n\
    [[channels]]\ncolumn = 'y'\nunit = 'Nm'\nrole = 'output'\n\
    [split]\nestimation_rows = [[0, 200]]\ntest_rows = [[200, 300]]\n\
    [model]\nstructure = { name = 'arx', na = 1, nb = 1 }\nestimator = { name = 'ols' }\n";

#[test]
fn a_stored_model_leaves_and_its_c_computes() {
    let tmp = tempfile::tempdir().unwrap();
    atomic::write(&tmp.path().join("bed.csv"), record().as_bytes()).unwrap();
    atomic::write(&tmp.path().join("spec.toml"), SPEC.as_bytes()).unwrap();
    let done = dynocal(tmp.path(), &["identify", "spec.toml", "--out", "run"]);
    assert!(done.status.code().unwrap() < 2, "{}", String::from_utf8_lossy(&done.stderr));
    let done = dynocal(
        tmp.path(),
        &["export", "run", "--to", "c", "fmu2", "json", "--precision", "double", "--out", "out"],
    );
    let said = String::from_utf8_lossy(&done.stderr);
    assert!(done.status.success(), "{said}");
    let files: Vec<String> = String::from_utf8(done.stdout).unwrap().lines().map(String::from).collect();
    for ending in ["y_model.c", "y_model.h", "y_model.json", ".fmu"] {
        assert!(files.iter().any(|f| f.ends_with(ending)), "{ending} in {files:?}");
    }
    assert!(files.iter().all(|f| tmp.path().join(f).is_file()));
    let c = std::fs::read_to_string(tmp.path().join("out/y_model.c")).unwrap();
    for part in ["Run: run", "Spec digest: ", "Data digest: ", "Learnt with u from "] {
        assert!(c.contains(part), "no `{part}` in\n{c}");
    }
    let built = std::process::Command::new("cc")
        .current_dir(tmp.path().join("out"))
        .args([
            "-std=c99",
            "-pedantic",
            "-Wall",
            "-Wextra",
            "-Werror",
            "-ffp-contract=off",
            "-c",
            "y_model.c",
        ])
        .output();
    match built {
        Ok(o) => assert!(o.status.success(), "{}", String::from_utf8_lossy(&o.stderr)),
        Err(_) => println!("SKIPPED READER: no cc"),
    }
}

/// `[export]` of the spec does what the verb does.
#[test]
fn a_spec_exports_when_its_run_is_done() {
    let tmp = tempfile::tempdir().unwrap();
    atomic::write(&tmp.path().join("bed.csv"), record().as_bytes()).unwrap();
    let put = |keys: &str| {
        atomic::write(&tmp.path().join("spec.toml"), format!("{SPEC}[export]\n{keys}").as_bytes()).unwrap();
    };
    put("to = ['c', 'json']\nprecision = 'double'\n");
    let done = dynocal(tmp.path(), &["identify", "spec.toml", "--out", "run"]);
    let said = String::from_utf8_lossy(&done.stderr);
    assert!(done.status.code().unwrap() < 2 && said.contains("exported run/export/y_model.c"), "{said}");
    let verb =
        dynocal(tmp.path(), &["export", "run", "--to", "c", "json", "--precision", "double", "--out", "out"]);
    assert!(verb.status.success());
    for file in ["y_model.c", "y_model.h", "y_model.json"] {
        let read = |folder: &str| std::fs::read(tmp.path().join(folder).join(file)).unwrap();
        assert_eq!(read("run/export"), read("out"), "{file}");
    }
    for (keys, part) in [
        ("to = ['cdf']\n", "did you mean `cdfx`?"),
        ("to = []\n", "`export.to`: found nothing"),
        ("to = ['c']\nprecison = 'double'\n", "did you mean `precision`?"),
    ] {
        put(keys);
        let done = dynocal(tmp.path(), &["identify", "spec.toml", "--out", "run2"]);
        let said = String::from_utf8_lossy(&done.stderr);
        assert!(done.status.code() == Some(2) && said.contains(part), "{said}");
    }
}

#[test]
fn faults_are_named() {
    let tmp = tempfile::tempdir().unwrap();
    for (args, parts) in [
        (&["export", "nowhere.json", "--to", "c"][..], &["nowhere.json"][..]),
        (&["export", ".", "--to", "c"], &["expected a finished run"]),
        (&["export", "x.json", "--to", "cdf"], &["cdf", "cdfx"]),
    ] {
        let done = dynocal(tmp.path(), args);
        let said = String::from_utf8_lossy(&done.stderr);
        assert_eq!(done.status.code(), Some(2), "{said}");
        assert!(parts.iter().all(|p| said.contains(p)), "{parts:?} in {said}");
    }
}
