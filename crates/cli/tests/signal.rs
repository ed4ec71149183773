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

/// A long one is Parquet: its samples are those of a short one with the same seed, as far as that goes.
#[test]
fn a_long_signal_is_parquet() {
    let tmp = tempfile::tempdir().unwrap();
    let long = ["prbs", "--keys", "lo=0", "hi=1", "order=17", "hold_s=0.1", "--unit", "-"];
    let long =
        [&long[..], &["--length-s", "10000.1", "--sample-time-s", "0.1", "--out", "run", "--json"]].concat();
    let o = signal(tmp.path(), &long);
    assert_eq!(o.code, 0, "{}", o.stderr);
    let summary: serde_json::Value = serde_json::from_str(&o.stdout).unwrap();
    assert_eq!(summary["files"][0], "signal.parquet");
    let run = tmp.path().join("run");
    assert!(!run.join("signal.csv").exists());
    let table = dynocal_files::dataset::read_table(&run.join("signal.parquet"), None).unwrap();
    assert_eq!((table.rows(), table.columns.len()), (100_001, 2));
    assert!(table.numbers("time", 100_000, 100_001).unwrap()[0] == 100_000.0 * 0.1);
}

#[test]
fn a_signal_is_written_with_its_numbers_and_is_the_same_for_the_same_seed() {
    let tmp = tempfile::tempdir().unwrap();
    let o = signal(tmp.path(), &[&APRBS[..], &["--json", "--seed", "4"]].concat());
    assert_eq!(o.code, 0, "{}", o.stderr);
    let summary: serde_json::Value = serde_json::from_str(&o.stdout).unwrap();
    let a = &summary["analyses"][0];
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
    // A hold between samples is rounded, and said.
    let rbs = [
        "rbs",
        "--length-s",
        "20",
        "--sample-time-s",
        "0.1",
        "--keys",
        "lo=0",
        "hi=1",
        "hold_s=0.25",
        "--out",
        "rbs",
    ];
    let o = signal(tmp.path(), &rbs);
    assert!(o.code == 0 && o.stderr.contains("held for 3 of them"), "{}", o.stderr);
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

/// The example with several channels: all of them in one file, with correlation and coverage of every pair.
#[test]
fn several_channels_come_from_a_spec_with_their_correlation() {
    let tmp = tempfile::tempdir().unwrap();
    let spec = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../examples/design/signals.toml");
    let o = signal(tmp.path(), &[spec.to_str().unwrap(), "--out", "run", "--json"]);
    assert_eq!(o.code, 0, "{}", o.stderr);
    let summary: serde_json::Value = serde_json::from_str(&o.stdout).unwrap();
    let table = dynocal_files::csv_io::read(&tmp.path().join("run/signal.csv")).unwrap();
    let of = |name: &str| table.numbers(name, 0, 600).unwrap().to_vec();
    assert!(of("throttle").iter().all(|v| [10.0, 15.0, 20.0, 25.0, 30.0].contains(v)));
    assert!(of("spark").iter().all(|v| [10.0, 30.0].contains(v)));
    assert_eq!(table.column("speed").unwrap().unit.as_ref().unwrap().0, "rpm");
    // Thesis eq. 2.45 by its definition.
    let correlation = |a: &[f64], b: &[f64]| {
        let n = a.len() as f64;
        let (ma, mb) = (a.iter().sum::<f64>() / n, b.iter().sum::<f64>() / n);
        let sum = |x: &[f64], mx: f64, y: &[f64], my: f64| -> f64 {
            x.iter().zip(y).map(|(x, y)| (x - mx) * (y - my)).sum()
        };
        sum(a, ma, b, mb) / (sum(a, ma, a, ma) * sum(b, mb, b, mb)).sqrt()
    };
    for c in summary["correlations"].as_array().unwrap() {
        let (a, b) = (c["a"].as_str().unwrap(), c["b"].as_str().unwrap());
        assert!((c["r"].as_f64().unwrap() - correlation(&of(a), &of(b))).abs() < 1e-12, "{c}");
    }
    assert_eq!(summary["pairs"].as_array().unwrap().len(), 3);
    let report = std::fs::read_to_string(tmp.path().join("run/report.html")).unwrap();
    for part in ["Channels together", "coverage", "speed (multisine)", "Power spectral density"] {
        assert!(report.contains(part), "no {part}");
    }
    // Two channels that are the same are told apart by nothing.
    let twice = "length_s = 20.0\nsample_time_s = 0.1\nchannels = [\n\
        { name = \"a\", unit = \"-\", signal = { name = \"staircase\", lo = 0.0, hi = 1.0, hold_s = 0.5 } },\n\
        { name = \"b\", unit = \"-\", signal = { name = \"staircase\", lo = 0.0, hi = 5.0, hold_s = 0.5 } },\n]\n";
    let path = tmp.path().join("twice.toml");
    dynocal_files::atomic::write(&path, twice.as_bytes()).unwrap();
    let o = signal(tmp.path(), &["twice.toml", "--out", "twice"]);
    assert!(o.code == 0 && o.stderr.contains("`a` and `b` move together (correlation 1.00"), "{}", o.stderr);
}

#[test]
fn faults_of_a_spec_are_named() {
    let tmp = tempfile::tempdir().unwrap();
    let refused = |text: &str, parts: &[&str]| {
        dynocal_files::atomic::write(&tmp.path().join("s.toml"), text.as_bytes()).unwrap();
        let o = signal(tmp.path(), &["s.toml", "--out", "run"]);
        assert_eq!((o.code, o.stdout.as_str()), (2, ""), "{}", o.stderr);
        for part in parts {
            assert!(o.stderr.contains(part) && !o.stderr.contains("bug in"), "no `{part}` in:\n{}", o.stderr);
        }
    };
    let whole = "length_s = 20.0\nsample_time_s = 0.1\n[[channels]]\nname = \"a\"\nunit = \"-\"\n\
        signal = { name = \"udrn\", lo = 0.0, hi = 1.0, hold_s = 0.1 }\n";
    refused(&whole.replace("udrn", "udrm"), &["s.toml:6: `channels[1].signal.name`", "did you mean `udrn`?"]);
    refused(&whole.replace("hold_s", "holds"), &["`channels[1].signal`", "holds"]);
    refused(&whole.replace("unit = \"-\"\n", ""), &["`channels[1].unit`: found nothing"]);
    refused(&whole.replace("length_s = 20.0\n", ""), &["`length_s`: found nothing"]);
    refused(&whole.replace("20.0", "0.1"), &["`length_s`: found 1 samples"]);
    refused("length_s = 20.0\nsample_time_s = 0.1\n", &["`channels`: found nothing"]);
    let o = signal(tmp.path(), &["udrn", "--length-s", "3"]);
    assert!(o.code == 2 && o.stderr.contains("--sample-time-s is missing"), "{}", o.stderr);
}
