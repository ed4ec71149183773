//! What a user sees of `dynocal signal`: the file, its analysis, messages.

use std::path::Path;

use assert_cmd::Command;

struct Outcome {
    code: i32,
    stdout: String,
    stderr: String,
}

fn signal(folder: &Path, args: &[&str]) -> Outcome {
    let out =
        Command::cargo_bin("dynocal").unwrap().current_dir(folder).arg("signal").args(args).output().unwrap();
    Outcome {
        code: out.status.code().unwrap(),
        stdout: String::from_utf8(out.stdout).unwrap(),
        stderr: String::from_utf8(out.stderr).unwrap(),
    }
}

const APRBS: [&str; 15] = [
    "aprbs",
    "--keys",
    "lo=10",
    "hi=90",
    "hold_s=0.5",
    "--length-s",
    "60",
    "--sample-time-s",
    "0.1",
    "--channel",
    "torque",
    "--unit",
    "Nm",
    "--out",
    "run",
];

#[test]
fn a_signal_is_written_with_its_numbers_and_is_the_same_for_the_same_seed() {
    let tmp = tempfile::tempdir().unwrap();
    let o = signal(tmp.path(), &[&APRBS[..], &["--json", "--seed", "4"]].concat());
    assert_eq!(o.code, 0, "{}", o.stderr);
    let summary: serde_json::Value = serde_json::from_str(&o.stdout).unwrap();
    let a = &summary["analysis"];
    assert_eq!((&a["samples"], &a["minimum"], &a["maximum"]), (&600.into(), &10.0.into(), &90.0.into()));
    let table = dynocal_files::csv_io::read(&tmp.path().join("run/signal.csv")).unwrap();
    let torque = table.column("torque").unwrap();
    assert_eq!(torque.unit.as_ref().unwrap().0, "Nm");
    let u = table.numbers("torque", 0, 600).unwrap();
    assert!(u.iter().all(|v| [10.0, 30.0, 50.0, 70.0, 90.0].contains(v)));
    assert!(u.chunks(5).all(|held| held.iter().all(|v| *v == held[0])));
    let mean = u.iter().sum::<f64>() / 600.0;
    assert!((a["mean"].as_f64().unwrap() - mean).abs() < 1e-12);
    // Five levels in twenty cells.
    assert_eq!(a["coverage"], 0.25);
    let report = std::fs::read_to_string(tmp.path().join("run/report.html")).unwrap();
    for part in ["Autocorrelation", "Power spectral density", "Amplitude density", "</html>"] {
        assert!(report.contains(part), "no {part}");
    }
    let bytes = |folder: &str| std::fs::read(tmp.path().join(folder).join("signal.csv")).unwrap();
    let again = |folder: &str, seed: &str| {
        let o = signal(tmp.path(), &[&APRBS[..14], &[folder, "--seed", seed, "--quiet"]].concat());
        assert_eq!((o.code, o.stdout.as_str(), o.stderr.as_str()), (0, "", ""));
        bytes(folder)
    };
    assert_eq!(bytes("run"), again("same", "4"));
    assert_ne!(bytes("run"), again("other", "5"));
}

#[test]
fn requests_that_cannot_be_met_are_refused_in_words() {
    let tmp = tempfile::tempdir().unwrap();
    let refused = |args: &[&str], part: &str| {
        let o = signal(tmp.path(), args);
        assert_eq!((o.code, o.stdout.as_str()), (2, ""), "{}", o.stderr);
        assert!(o.stderr.contains(part) && !o.stderr.contains("bug"), "no `{part}` in:\n{}", o.stderr);
    };
    let with = |keys: &[&'static str], length: &'static str, dt: &'static str| -> Vec<&'static str> {
        [&["udrn", "--keys"], keys, &["--length-s", length, "--sample-time-s", dt]].concat()
    };
    refused(&with(&["lo=0", "hi"], "10", "0.1"), "--keys hi: expected KEY=VALUE");
    refused(&with(&["lo=0", "lo=1"], "10", "0.1"), "given twice");
    refused(&with(&["lo=0", "hi=1", "hold_s=0.1", "colour=3"], "10", "0.1"), "colour");
    refused(&with(&["lo=3", "hi=1", "hold_s=0.1"], "10", "0.1"), "expected finite values with lo < hi");
    refused(&with(&["lo=0", "hi=1", "hold_s=0.1"], "10", "0"), "--sample-time-s 0: expected a positive");
    refused(
        &with(&["lo=0", "hi=1", "hold_s=0.1"], "0.1", "0.1"),
        "--length-s 0.1: expected 2 to 1e7 samples",
    );
    refused(&with(&["lo=0", "hi=1", "hold_s=0.1"], "1e12", "0.1"), "--length-s");
    refused(&["aprb", "--length-s", "1", "--sample-time-s", "0.1"], "aprbs");
}
