//! What nobody should type, run as processes with two seconds of processor time and 1 GB: exit code 0, 1 or 2 and never a panic, and
//! what is refused is refused with file, line and key.
#![cfg(target_os = "linux")]

use std::path::{Path, PathBuf};
use std::process::Command;

use dynocal_files::atomic;
use dynocal_numerics::rng::Rng64;
use toml::{Table, Value};

struct Outcome {
    code: Option<i32>,
    stdout: String,
    stderr: String,
}

/// Runs the program with bounds on processor time in s and address space in kB, set by the shell for the process alone.
fn bounded(folder: &Path, seconds: u32, kilobytes: u32, args: &[String]) -> Outcome {
    let limits = format!("ulimit -t {seconds}; ulimit -v {kilobytes}; exec \"$0\" \"$@\"");
    let program = assert_cmd::cargo::cargo_bin("dynocal");
    let out = Command::new("sh").arg("-c").arg(limits).arg(program).args(args).current_dir(folder).output();
    let out = out.unwrap();
    Outcome {
        code: out.status.code(),
        stdout: String::from_utf8_lossy(&out.stdout).into_owned(),
        stderr: String::from_utf8_lossy(&out.stderr).into_owned(),
    }
}

fn strings(args: &[&str]) -> Vec<String> {
    args.iter().map(|a| (*a).to_string()).collect()
}

/// What is wrong with the end of a run.
fn fault(o: &Outcome) -> Option<String> {
    let text = format!("{}{}", o.stdout, o.stderr);
    let said = match o.code {
        Some(0..=2) if o.stderr.contains("this is a bug") => "a panic",
        Some(0..=2) if o.stderr.len() > 200_000 => "a message without end",
        Some(2) if !o.stderr.contains("error: ") => "refused without a word",
        Some(0..=2) if longest_number(&text) > 40 => "a number of more than 40 digits",
        Some(0..=2) => return None,
        Some(_) => "another exit code",
        None => "killed: more time or memory than allowed, or aborted",
    };
    Some(format!("{said}: {:?} {:.400}", o.code, o.stderr))
}

fn longest_number(text: &str) -> usize {
    text.split(|c: char| !c.is_ascii_digit()).map(str::len).max().unwrap_or(0)
}

/// Where a value stands: keys and places.
fn ways(value: &Value, here: &str, out: &mut Vec<String>) {
    let inner: Vec<(String, &Value)> = match value {
        Value::Table(t) => t.iter().map(|(k, v)| (k.clone(), v)).collect(),
        Value::Array(a) => a.iter().enumerate().take(1).map(|(i, v)| (i.to_string(), v)).collect(),
        _ => Vec::new(),
    };
    for (step, v) in inner {
        let way = if here.is_empty() { step } else { format!("{here}/{step}") };
        out.push(way.clone());
        ways(v, &way, out);
    }
}

/// The table with another value at the end of a way; none: without it.
fn changed(root: &Table, way: &str, value: Option<Value>) -> Table {
    let mut all = root.clone();
    let (parent, last) = way.rsplit_once('/').unwrap_or(("", way));
    let mut here = Value::Table(all.clone());
    {
        let mut place = &mut here;
        for step in parent.split('/').filter(|s| !s.is_empty()) {
            place = match place {
                Value::Table(t) => t.get_mut(step).unwrap(),
                Value::Array(a) => &mut a[step.parse::<usize>().unwrap()],
                _ => panic!("{way}"),
            };
        }
        match (place, value) {
            (Value::Table(t), Some(v)) => drop(t.insert(last.into(), v)),
            (Value::Table(t), None) => drop(t.remove(last)),
            (Value::Array(a), Some(v)) => a[last.parse::<usize>().unwrap()] = v,
            (Value::Array(a), None) => drop(a.remove(last.parse().unwrap())),
            _ => panic!("{way}"),
        }
    }
    if let Value::Table(t) = here {
        all = t;
    }
    all
}

fn hostile(rng: &mut Rng64) -> Option<Value> {
    let values = [
        None,
        Some(Value::String("../\u{202e}".into())),
        Some(Value::String("x".repeat(200_000))),
        Some(Value::Boolean(true)),
        Some(Value::Array(Vec::new())),
        Some(Value::Table(Table::new())),
        Some(Value::Integer(0)),
        Some(Value::Integer(-1)),
        Some(Value::Integer(1 << 31)),
        Some(Value::Integer(i64::MAX)),
        Some(Value::Float(f64::NAN)),
        Some(Value::Float(1e308)),
        Some(Value::Float(1e-308)),
        Some(Value::Float(-1e308)),
    ];
    values[rng.below(values.len())].clone()
}

fn example(file: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../../examples").join(file)
}

/// A key of every spec at a time, a drawn value for it, under `--check`.
#[test]
fn no_value_of_a_spec_ends_a_check_without_a_word() {
    let tmp = tempfile::tempdir().unwrap();
    let furnace = example("gas_furnace/gas_furnace.csv.gz");
    std::fs::copy(&furnace, tmp.path().join("gas_furnace.csv.gz")).unwrap();
    // What the calibration of the boosted engine names.
    std::fs::copy(example("gtdi_2l/fuelling.toml"), tmp.path().join("fuelling.toml")).unwrap();
    let mut rng = Rng64::new(35);
    let (mut faults, mut refused, mut named) = (Vec::new(), 0, [0; 3]);
    let mut without = Vec::new();
    for (verb, file) in [
        ("identify", "gas_furnace/identify.toml"),
        ("signal", "design/signals.toml"),
        ("design", "design/spec.toml"),
        ("sequential", "sequential/spec.toml"),
        ("calibrate", "gtdi/calibrate.toml"),
        ("calibrate", "gtdi_2l/calibrate.toml"),
        ("map", "gtdi_2l/map.toml"),
        ("fuelling", "pfi_1_6l/fuelling.toml"),
    ] {
        let root: Table = std::fs::read_to_string(example(file)).unwrap().parse().unwrap();
        let mut all = Vec::new();
        ways(&Value::Table(root.clone()), "", &mut all);
        for way in all {
            let value = hostile(&mut rng);
            let Ok(text) = toml::to_string(&changed(&root, &way, value.clone())) else { continue };
            atomic::write(&tmp.path().join("spec.toml"), text.as_bytes()).unwrap();
            let args = strings(&[verb, "spec.toml", "--check", "--threads", "2"]);
            let o = bounded(tmp.path(), 2, 1_000_000, &args);
            let what = format!("{verb} {file}: {way} = {:.60}", format!("{value:?}"));
            if let Some(f) = fault(&o) {
                faults.push(format!("{what}: {f}"));
            }
            if o.code == Some(2) {
                refused += 1;
                let lines: Vec<&str> = o.stderr.lines().filter(|l| l.contains("spec.toml")).collect();
                let has = [
                    !lines.is_empty(),
                    lines.iter().any(|l| {
                        l.contains("spec.toml:")
                            && l.split("spec.toml:")
                                .nth(1)
                                .is_some_and(|r| r.starts_with(|c: char| c.is_ascii_digit()))
                    }),
                    lines.iter().any(|l| l.contains("`: found ")),
                ];
                has.iter().zip(&mut named).for_each(|(h, n)| *n += usize::from(*h));
                if has.contains(&false) {
                    without.push(format!("{what}: {has:?} {:.300}", o.stderr));
                }
            }
        }
    }
    println!("{refused} refused; file, line, key named: {named:?}\n{}", without.join("\n"));
    assert!(faults.is_empty(), "{}:\n{}", faults.len(), faults.join("\n"));
    assert!(refused > 50, "{refused}");
    // A key that is missing has no line, unless its table has one; a data file that a text names is a fault of that file.
    let share = |n: usize| n as f64 / refused as f64;
    assert!(
        share(named[0]) > 0.97 && share(named[1]) > 0.93 && share(named[2]) > 0.97,
        "{named:?} of {refused}"
    );
}

/// Numbers of the engine verbs: refused by name, or run to an end.
#[test]
fn no_number_of_an_engine_verb_ends_without_a_word() {
    let tmp = tempfile::tempdir().unwrap();
    let rows: String = (0..20).map(|t| format!("{},{}\n", 0.1 * f64::from(t), 10 + t % 2)).collect();
    atomic::write(&tmp.path().join("u.csv"), format!("time [s],throttle [deg]\n{rows}").as_bytes()).unwrap();
    let speeds: String = (0..20).map(|t| format!("{t},{}\n", 3 * (t % 5))).collect();
    atomic::write(&tmp.path().join("cycle.csv"), format!("time [s],speed [m/s]\n{speeds}").as_bytes())
        .unwrap();
    let small = ["--speed-rpm", "2000", "2000", "1"];
    let point = ["engine", "point", "--inj-mg", "16", "--throttle-deg", "15", "--spark-deg", "20"];
    let cases: Vec<(Vec<&str>, Vec<&str>)> = vec![
        (point.to_vec(), vec!["--speed-rpm", "--inj-mg", "--throttle-deg", "--spark-deg"]),
        (vec!["engine", "point", "--torque-nm", "50", "--spark-deg", "20"], vec!["--torque-nm", "--lambda"]),
        (
            vec!["engine", "sweep", "spark", "--from", "10", "--to", "20", "--points", "2"],
            vec!["--from", "--to", "--points"],
        ),
        (vec!["engine", "motored"], vec!["--speed-rpm", "--throttle-deg"]),
        (
            [&["engine", "map", "--torque-nm", "50", "50", "1"][..], &small].concat(),
            vec!["--max-map-kpa", "--max-egt-degc", "--max-pmax-bar", "--max-knock"],
        ),
        (vec!["engine", "transient", "u.csv"], vec!["--every-s", "--every-deg", "--seed"]),
        (vec!["engine", "cycle", "cycle.csv", "--seconds", "3"], vec!["--seconds", "--grade"]),
    ];
    let (mut faults, mut codes) = (Vec::new(), [0; 3]);
    for (base, flags) in cases {
        for flag in flags {
            for value in ["nan", "inf", "-1", "0", "1e308", "1e-308", "2147483648", ""] {
                // The value stands in place of that of the base.
                let place = base.iter().position(|a| *a == flag);
                let keep = |k: &usize| place.is_none_or(|p| *k != p && *k != p + 1);
                let mut args: Vec<String> =
                    (0..base.len()).filter(keep).map(|k| base[k].to_string()).collect();
                args.push(format!("{flag}={value}"));
                let o = bounded(tmp.path(), 60, 2_000_000, &args);
                if let Some(f) = fault(&o) {
                    faults.push(format!("{}: {f}", args.join(" ")));
                }
                if let Some(c @ 0..=2) = o.code {
                    codes[c as usize] += 1;
                }
            }
        }
    }
    println!("exit codes {codes:?}");
    assert!(faults.is_empty(), "{}:\n{}", faults.len(), faults.join("\n"));
}

/// Files of parameters and beds are named with line and key.
#[test]
fn files_of_engines_and_beds_are_named_with_line_and_key() {
    let tmp = tempfile::tempdir().unwrap();
    let put = |name: &str, text: &str| atomic::write(&tmp.path().join(name), text.as_bytes()).unwrap();
    let set = Path::new(env!("CARGO_MANIFEST_DIR")).join("../plant/parameters/thesis.toml");
    let text = std::fs::read_to_string(set).unwrap();
    let line = 1 + text.lines().position(|l| l.trim_start().starts_with("bore_m")).unwrap();
    let bore = text.lines().nth(line - 1).unwrap().to_string();
    for (value, part) in [("-1.0", "bore_m"), ("\"wide\"", "bore_m")] {
        put("engine.toml", &text.replace(&bore, &format!("bore_m = {value}")));
        let o = bounded(
            tmp.path(),
            10,
            2_000_000,
            &strings(&["engine", "motored", "--parameters", "engine.toml"]),
        );
        let said = &o.stderr;
        assert!(o.code == Some(2) && said.contains("engine.toml") && said.contains(part), "{said}");
        assert!(said.contains(&format!("line {line}")), "{line}: {said}");
    }
    put("u.csv", "time [s],throttle [deg]\n0,10\n1,11\n");
    for (bed, parts) in [
        ("real = true\n[dynamometer]\nmode = \"load\"\nrotor_kg_m2 = -1.0\n", ["line 4", "rotor_kg_m2"]),
        ("real = true\n\n[sensors.torque]\nnoize = 1.0\n", ["line 4", "noize"]),
        ("real = maybe\n", ["line 1", "maybe"]),
    ] {
        put("bed.toml", bed);
        let args = strings(&["engine", "transient", "u.csv", "--bed", "bed.toml"]);
        let o = bounded(tmp.path(), 10, 2_000_000, &args);
        let said = &o.stderr;
        assert!(o.code == Some(2) && said.contains("bed.toml"), "{said}");
        assert!(parts.iter().all(|p| said.contains(p)), "{parts:?}: {said}");
    }
}

/// What is longer than a machine takes is refused before it starts, with the bound.
#[test]
fn what_is_too_large_is_refused_with_its_bound() {
    let tmp = tempfile::tempdir().unwrap();
    let refused = |args: &[&str], parts: &[&str]| {
        let o = bounded(tmp.path(), 10, 2_000_000, &strings(args));
        assert_eq!(o.code, Some(2), "{args:?}: {:?} {}", o.code, o.stderr);
        assert!(parts.iter().all(|p| o.stderr.contains(p)), "{parts:?}: {}", o.stderr);
    };
    let signal = ["signal", "udrn", "--keys", "lo=0", "hi=1", "hold_s=1", "--sample-time-s", "0.1"];
    refused(&[&signal[..], &["--length-s", "1e9"]].concat(), &["--length-s", "samples"]);
    refused(&[&signal[..], &["--length-s", "10", "--threads", "65535"]].concat(), &["512"]);
    // Both of the options that are missing are named.
    refused(&signal[..6], &["--sample-time-s", "--length-s"]);
    let put = |name: &str, text: &str| atomic::write(&tmp.path().join(name), text.as_bytes()).unwrap();
    put("gap.csv", "time [s],speed [m/s]\n0,0\n1,3\n1e7,0\n");
    refused(&["engine", "cycle", "gap.csv"], &["gap.csv", "20000", "gap in the time stamps"]);
    put("gap.csv", "time [s],throttle [deg]\n0,10\n1,12\n1e9,10\n");
    refused(&["engine", "transient", "gap.csv"], &["gap.csv", "samples", "at most"]);
    put("long.csv", "time [s],throttle [deg]\n0,10\n1,12\n2,10\n");
    refused(&["engine", "transient", "long.csv", "--every-s", "1e-9"], &["long.csv", "at most"]);
    refused(&["engine", "transient", "long.csv", "--every-deg", "1e-6"], &["long.csv", "at most"]);
    put("long.toml", "[excite]\nrecord_s = 1e7\n");
    refused(&["calibrate", "long.toml", "--check"], &["long.toml:2", "`excite.record_s`", "6000"]);
}

/// A folder that cannot be written is known before anything is computed, and nothing is left.
#[test]
fn folders_that_cannot_be_written_are_known_at_once() {
    let tmp = tempfile::tempdir().unwrap();
    // A file where the folder should be: nobody may write there, whoever runs the test.
    atomic::write(&tmp.path().join("taken"), b"x").unwrap();
    let furnace = example("gas_furnace/identify.toml").display().to_string();
    let design = example("design/spec.toml").display().to_string();
    let calibrate = example("gtdi/calibrate.toml").display().to_string();
    let sequential = example("sequential/spec.toml").display().to_string();
    let map = example("gtdi_2l/map.toml").display().to_string();
    for args in [
        vec!["identify", &furnace],
        vec!["design", &design],
        vec!["calibrate", &calibrate],
        vec!["sequential", &sequential],
        vec!["map", &map],
    ] {
        let args = strings(&[&args[..], &["--out", "taken/run", "--threads", "2"]].concat());
        let o = bounded(tmp.path(), 3, 2_000_000, &args);
        assert_eq!(o.code, Some(2), "{args:?}: {}", o.stderr);
        assert!(o.stderr.contains("taken/run"), "{args:?}: {}", o.stderr);
    }
    let names: Vec<_> = std::fs::read_dir(tmp.path()).unwrap().map(|e| e.unwrap().file_name()).collect();
    assert_eq!(names, ["taken"]);
}

/// The stored spec is what was asked for, not where it goes.
#[test]
fn the_folder_changes_no_byte() {
    let tmp = tempfile::tempdir().unwrap();
    let furnace = example("gas_furnace/identify.toml").display().to_string();
    for out in ["a", "another/b"] {
        let o = bounded(tmp.path(), 60, 4_000_000, &strings(&["identify", &furnace, "--out", out]));
        assert_eq!(o.code, Some(0), "{}", o.stderr);
    }
    let read = |run: &str, file: &str| std::fs::read(tmp.path().join(run).join(file)).unwrap();
    for file in ["spec.json", "summary.json", "report.html"] {
        assert!(read("a", file) == read("another/b", file), "{file}");
    }
    assert!(!String::from_utf8(read("a", "spec.json")).unwrap().contains("\"out\""));
}
