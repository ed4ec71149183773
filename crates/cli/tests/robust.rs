//! What a shell does to a program: pipes that close, disks that are full, two runs in one folder, kills.

use std::fs::{self, File, OpenOptions};
use std::io::{BufRead, BufReader};
use std::path::Path;
use std::process::{Command, Stdio};

fn dynocal(folder: &Path) -> Command {
    let mut command = Command::new(assert_cmd::cargo::cargo_bin("dynocal"));
    command.current_dir(folder);
    command
}

const SIGNAL: &[&str] =
    &["signal", "udrn", "--keys", "lo=0", "hi=1", "hold_s=0.1", "--length-s", "10", "--sample-time-s", "0.1"];

/// `2>&1 | head -1`: the reader takes a line (or none) and goes; the run ends as if it had stayed.
#[cfg(unix)]
#[test]
fn a_reader_that_goes_away_ends_nothing() {
    let tmp = tempfile::tempdir().unwrap();
    let furnace = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../examples/gas_furnace/identify.toml");
    let furnace = furnace.to_str().unwrap().to_string();
    let identify = ["identify", &furnace, "--out", "furnace"].map(str::to_string).to_vec();
    let signal: Vec<String> = SIGNAL.iter().map(|s| (*s).to_string()).collect();
    let list = vec!["list".to_string()];
    let faulty = vec!["signal".to_string(), "no-such-signal".to_string()];
    for (args, code, lines) in [(identify, 0, 1), (signal, 0, 0), (list, 0, 1), (faulty, 2, 0)] {
        let (reader, writer) = std::io::pipe().unwrap();
        let mut child = dynocal(tmp.path())
            .args(&args)
            .stdout(Stdio::from(writer.try_clone().unwrap()))
            .stderr(Stdio::from(writer))
            .spawn()
            .unwrap();
        let mut reader = BufReader::new(reader);
        for _ in 0..lines {
            reader.read_line(&mut String::new()).unwrap();
        }
        drop(reader);
        assert_eq!(child.wait().unwrap().code(), Some(code), "{args:?}");
    }
}

/// A result that could not be printed was not given.
#[cfg(target_os = "linux")]
#[test]
fn a_full_standard_output_is_an_error() {
    let tmp = tempfile::tempdir().unwrap();
    let full = || OpenOptions::new().write(true).open("/dev/full").unwrap();
    for args in
        [&[SIGNAL, &["--json"]].concat()[..], SIGNAL, &["list", "--json"], &["--help"], &["--version"]]
    {
        let out = dynocal(tmp.path()).args(args).stdout(full()).output().unwrap();
        let stderr = String::from_utf8(out.stderr).unwrap();
        assert_eq!(out.status.code(), Some(2), "{args:?}: {stderr}");
        assert!(stderr.contains("cannot write to standard output"), "{args:?}: {stderr}");
    }
}

#[test]
fn threads_are_bounded() {
    let tmp = tempfile::tempdir().unwrap();
    for n in ["0", "65535", "100000", "-1"] {
        let out = dynocal(tmp.path()).args(SIGNAL).args(["--threads", n]).output().unwrap();
        assert_eq!(out.status.code(), Some(2), "--threads {n}");
    }
}

/// The folder is locked while a run works in it, and free when the process is gone, however it went.
#[test]
fn two_runs_do_not_share_a_folder() {
    let tmp = tempfile::tempdir().unwrap();
    let args = [SIGNAL, &["--out", "run"]].concat();
    assert_eq!(dynocal(tmp.path()).args(&args).output().unwrap().status.code(), Some(0));
    let held = File::options().append(true).open(tmp.path().join("run/log.txt")).unwrap();
    held.lock().unwrap();
    let before = fs::read(tmp.path().join("run/signal.csv")).unwrap();
    let out = dynocal(tmp.path()).args(&args).args(["--seed", "9"]).output().unwrap();
    let stderr = String::from_utf8(out.stderr).unwrap();
    assert!(out.status.code() == Some(2) && stderr.contains("another run works in this folder"), "{stderr}");
    assert_eq!(before, fs::read(tmp.path().join("run/signal.csv")).unwrap());
    drop(held);
    assert_eq!(dynocal(tmp.path()).args(&args).output().unwrap().status.code(), Some(0));
}

/// A killed run leaves files with temporary names; the next run in the folder removes them, and nothing else.
#[test]
fn stray_temporary_files_are_removed() {
    let tmp = tempfile::tempdir().unwrap();
    let args = [SIGNAL, &["--out", "run"]].concat();
    assert_eq!(dynocal(tmp.path()).args(&args).output().unwrap().status.code(), Some(0));
    fs::create_dir_all(tmp.path().join("run/steps/01-x")).unwrap();
    for name in [".signal.csv.AbC123.tmp", "steps/01-x/.step.json.q.tmp", "mine.tmp", ".hidden"] {
        dynocal_files::atomic::write(&tmp.path().join("run").join(name), b"x").unwrap();
    }
    assert_eq!(dynocal(tmp.path()).args(&args).output().unwrap().status.code(), Some(0));
    let there = |name: &str| tmp.path().join("run").join(name).exists();
    assert!(!there(".signal.csv.AbC123.tmp") && !there("steps/01-x/.step.json.q.tmp"));
    assert!(there("mine.tmp") && there(".hidden"));
}

/// `name` is the name of one folder below `runs`.
#[test]
fn names_do_not_lead_out_of_runs() {
    let tmp = tempfile::tempdir().unwrap();
    let inner = tmp.path().join("inner");
    fs::create_dir_all(&inner).unwrap();
    let absolute = tmp.path().join("absolute");
    for name in ["../out", absolute.to_str().unwrap(), "a/../../out", "", ".."] {
        let text = format!(
            "name = {name:?}\nlength_s = 20.0\nsample_time_s = 0.1\n[[channels]]\nname = \"a\"\nunit = \"-\"\n\
             signal = {{ name = \"udrn\", lo = 0.0, hi = 1.0, hold_s = 0.1 }}\n"
        );
        dynocal_files::atomic::write(&inner.join("s.toml"), text.as_bytes()).unwrap();
        let out = dynocal(&inner).args(["signal", "s.toml"]).output().unwrap();
        let stderr = String::from_utf8(out.stderr).unwrap();
        assert!(out.status.code() == Some(2) && stderr.contains("s.toml:1: `name`"), "{name}: {stderr}");
    }
    let names: Vec<_> = fs::read_dir(tmp.path()).unwrap().map(|e| e.unwrap().file_name()).collect();
    assert_eq!(names, ["inner"]);
}

/// `--check` reads spec and data, shows the plan with what it takes, and writes nothing.
#[test]
fn a_check_runs_nothing() {
    let tmp = tempfile::tempdir().unwrap();
    let examples = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../examples");
    for (verb, spec, parts) in [
        ("signal", "design/signals.toml", &["memory", "600 samples"][..]),
        ("identify", "gas_furnace/identify.toml", &["memory", "148 samples", "co2"]),
        ("design", "design/spec.toml", &["memory", "300 samples", "torque"]),
    ] {
        let spec = examples.join(spec);
        let out = dynocal(tmp.path()).args([verb, spec.to_str().unwrap(), "--check"]).output().unwrap();
        let text = String::from_utf8(out.stdout).unwrap();
        assert_eq!(out.status.code(), Some(0), "{verb}: {}", String::from_utf8_lossy(&out.stderr));
        assert!(parts.iter().all(|p| text.contains(p)), "{verb}: {text}");
        let out = dynocal(tmp.path()).args([verb, "none.toml", "--check"]).output().unwrap();
        assert_eq!(out.status.code(), Some(2), "{verb}");
    }
    assert_eq!(fs::read_dir(tmp.path()).unwrap().count(), 0, "nothing was written");
}

/// A file that is not what it should be leaves the model of an earlier run where it was.
#[test]
fn a_wrong_file_leaves_the_earlier_model() {
    let tmp = tempfile::tempdir().unwrap();
    let write = |name: &str, bad: Option<usize>| {
        let (mut text, mut y) = ("time [s],u [V],y [V]\n".to_string(), 0.0);
        for t in 0..200usize {
            let u = ((t * t * 7) % 13) as f64;
            let cell = if bad == Some(t) { "abc".into() } else { y.to_string() };
            text += &format!("{t},{u},{cell}\n");
            y = 0.5 * y + u;
        }
        dynocal_files::atomic::write(&tmp.path().join(name), text.as_bytes()).unwrap();
    };
    write("good.csv", None);
    write("bad.csv", Some(100));
    let spec = r#"
        out = "run"
        [data]
        file = "good.csv"
        time = "time"
        [[channels]]
        column = "u"
        role = "input"
        [[channels]]
        column = "y"
        role = "output"
        [model]
        structure = { name = "polynomial", regressors = ["u(t-1)", "y(t-1)"] }
        estimator = { name = "ols" }
    "#;
    dynocal_files::atomic::write(&tmp.path().join("spec.toml"), spec.as_bytes()).unwrap();
    let run = |more: &[&str]| {
        let mut command = assert_cmd::Command::cargo_bin("dynocal").unwrap();
        command.current_dir(tmp.path()).args(["identify", "spec.toml"]).args(more).output().unwrap()
    };
    let first = run(&[]);
    assert_ne!(first.status.code(), Some(2), "{}", String::from_utf8_lossy(&first.stderr));
    let model = tmp.path().join("run/steps/01-identify/model.json");
    let before = std::fs::read(&model).unwrap();
    let second = run(&["--data", "bad.csv"]);
    let text = String::from_utf8_lossy(&second.stderr).into_owned();
    assert_eq!(second.status.code(), Some(2), "{text}");
    assert!(text.contains("line 102") && text.contains("abc"), "{text}");
    assert_eq!(std::fs::read(&model).unwrap(), before);
}
