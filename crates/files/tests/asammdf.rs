//! MDF beside asammdf, both ways. The readers are installed by `scripts/readers.sh`; where they are missing this says so.

#![allow(clippy::disallowed_methods)] // broken and foreign files are written as they are

use std::path::{Path, PathBuf};
use std::process::Command;

use dynocal_files::measurement::{Raster, ReadKeys, by_ending, open, recording};
use dynocal_files::table::{Cells, Column, UnitSource};
use serde_json::{Value, json};

/// Python with asammdf; says SKIPPED READER where there is none.
fn python() -> Option<PathBuf> {
    let target = std::env::var_os("CARGO_TARGET_DIR")
        .map_or_else(|| Path::new(env!("CARGO_MANIFEST_DIR")).join("../../target"), PathBuf::from);
    let python = std::env::var_os("DYNOCAL_READERS_PYTHON")
        .map_or_else(|| target.join("readers/bin/python"), PathBuf::from);
    let there =
        Command::new(&python).args(["-c", "import asammdf"]).output().is_ok_and(|o| o.status.success());
    if !there {
        println!("SKIPPED READER: no Python with asammdf (run scripts/readers.sh)");
    }
    there.then_some(python)
}

fn run(python: &Path, script: &str, arguments: &[&Path]) {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/readers").join(script);
    let out = Command::new("timeout").arg("300").arg(python).arg(path).args(arguments).output().unwrap();
    assert!(out.status.success(), "{script}: {}", String::from_utf8_lossy(&out.stderr));
    print!("{}", String::from_utf8_lossy(&out.stdout));
}

fn numbers(c: &Column) -> &[f64] {
    match &c.cells {
        Cells::Number(v) => v,
        Cells::Text(_) => panic!("`{}` holds words", c.name),
    }
}

/// Types x conversions x compression x invalid samples, 40 files: physical values to rounding, gaps exactly.
#[test]
fn files_of_asammdf_are_read() {
    let Some(python) = python() else { return };
    let tmp = tempfile::tempdir().unwrap();
    run(&python, "make_mdf.py", &[tmp.path()]);
    let wanted: Vec<Value> =
        serde_json::from_slice(&std::fs::read(tmp.path().join("wanted.json")).unwrap()).unwrap();
    assert_eq!(wanted.len(), 40);
    for want in &wanted {
        let file = want["file"].as_str().unwrap();
        let source = open(&tmp.path().join(file), None, &ReadKeys::default()).unwrap();
        let all = recording(source.as_ref()).unwrap().rasters;
        assert_eq!(all.len(), 2, "{file}");
        let list = |key: &str| -> Vec<f64> {
            want[key].as_array().unwrap().iter().map(|v| v.as_f64().unwrap_or(f64::NAN)).collect()
        };
        let same = |what: &str, got: &[f64], want: &[f64]| {
            assert_eq!(got.len(), want.len(), "{file}, {what}");
            for (k, (g, w)) in got.iter().zip(want).enumerate() {
                let close = (g.is_nan() && w.is_nan()) || (g - w).abs() <= 1e-12 * (1.0 + w.abs());
                assert!(close, "{file}, {what}, sample {k}: {g} {w}");
            }
        };
        let column = |name: &str| all.iter().flat_map(|r| &r.columns).find(|c| c.name == name).unwrap();
        same("time", &all[0].time_s, &list("time_s"));
        same("x", numbers(column("x")), &list("x"));
        same("y", numbers(column("y")), &list("y"));
        same("slow", numbers(column("slow")), &list("slow"));
        assert_eq!(column("x").unit, Some(("Nm".into(), UnitSource::Bracket)), "{file}");
    }
}

/// What we write asammdf reads: names, units, stamps, values, gaps, two rasters.
#[test]
fn own_files_are_read_by_asammdf() {
    let Some(python) = python() else { return };
    let tmp = tempfile::tempdir().unwrap();
    let column = |name: &str, unit: &str, v: Vec<f64>| Column {
        name: name.into(),
        unit: Some((unit.into(), UnitSource::Bracket)),
        cells: Cells::Number(v),
    };
    let wave = |n: i32, k: f64| (0..n).map(|t| (k * f64::from(t)).sin() * 100.0).collect::<Vec<_>>();
    let mut gaps = wave(70_000, 0.01);
    gaps.iter_mut().step_by(17).for_each(|x| *x = f64::NAN);
    let time = |n: i32, dt: f64| (0..n).map(|t| f64::from(t) * dt).collect::<Vec<_>>();
    let all = [
        Raster {
            name: "fast".into(),
            time_s: time(70_000, 0.01),
            columns: vec![column("torque", "Nm", wave(70_000, 0.3)), column("boost", "kPa", gaps)],
        },
        Raster {
            name: "slow".into(),
            time_s: time(50, 1.0),
            columns: vec![column("oil", "degC", wave(50, 0.05))],
        },
    ];
    let path = tmp.path().join("own.mf4");
    (by_ending(&path).and_then(|f| f.write).unwrap())(&path, &all).unwrap();
    let mut wanted = serde_json::Map::new();
    for r in &all {
        for c in &r.columns {
            let unit = c.unit.as_ref().unwrap().0.clone();
            wanted.insert(
                c.name.clone(),
                json!({ "unit": unit, "timestamps": r.time_s, "values": numbers(c) }),
            );
        }
    }
    let list = tmp.path().join("wanted.json");
    std::fs::write(&list, serde_json::to_vec(&wanted).unwrap()).unwrap();
    run(&python, "check_mdf.py", &[&path, &list]);
}

/// Formula, ranges to values, values and ranges to words, and records of two rasters between each other: numbers to rounding,
/// words exactly.
#[test]
fn conversions_to_words_and_unsorted_records_are_read() {
    let Some(python) = python() else { return };
    let tmp = tempfile::tempdir().unwrap();
    run(&python, "make_mdf_more.py", &[tmp.path()]);
    let wanted: Vec<Value> =
        serde_json::from_slice(&std::fs::read(tmp.path().join("wanted.json")).unwrap()).unwrap();
    assert_eq!(wanted.len(), 9);
    for want in &wanted {
        let file = want["file"].as_str().unwrap();
        let source = open(&tmp.path().join(file), None, &ReadKeys::default()).unwrap();
        assert!(source.notes().is_empty(), "{file}: {:?}", source.notes());
        let all = recording(source.as_ref()).unwrap();
        assert!(all.notes.is_empty(), "{file}: {:?}", all.notes);
        for (name, want) in want["channels"].as_object().unwrap() {
            let raster = all.rasters.iter().find(|r| r.columns.iter().any(|c| c.name == *name)).unwrap();
            let stamps = want["time_s"].as_array().unwrap();
            assert_eq!(raster.time_s.len(), stamps.len(), "{file}, {name}");
            assert!(raster.time_s.iter().zip(stamps).all(|(t, w)| Some(*t) == w.as_f64()), "{file}, {name}");
            let values = want["values"].as_array().unwrap();
            match &raster.columns.iter().find(|c| c.name == *name).unwrap().cells {
                Cells::Text(words) => {
                    assert!(words.iter().zip(values).all(|(g, w)| Some(g.as_str()) == w.as_str()), "{file}");
                }
                Cells::Number(v) => {
                    let close = |(g, w): (&f64, &Value)| {
                        w.as_f64().is_some_and(|w| (g - w).abs() <= 1e-12 * (1.0 + w.abs()))
                    };
                    assert!(v.iter().zip(values).all(close), "{file}, {name}");
                }
            }
        }
    }
}

/// Peak memory of this process in MB.
fn peak_mb() -> Option<f64> {
    let status = std::fs::read_to_string("/proc/self/status").ok()?;
    let line = status.lines().find(|l| l.starts_with("VmHWM"))?;
    line.split_whitespace().nth(1)?.parse::<f64>().ok().map(|kb| kb / 1024.0)
}

/// One of 15 channels of 128 MB takes less than 20 MB, plain and compressed: the length of the file does not count. (Where the
/// tests of this file run in one process, others may have taken the memory before; nextest gives each its own.)
#[test]
fn one_channel_is_read_in_little_memory() {
    let Some(python) = python() else { return };
    let tmp = tempfile::tempdir().unwrap();
    run(&python, "make_mdf_large.py", &[tmp.path()]);
    for name in ["large_0.mf4", "large_2.mf4"] {
        let path = tmp.path().join(name);
        let before = peak_mb();
        let source = open(&path, None, &ReadKeys::default()).unwrap();
        let channel = source.groups()[0].channels.iter().position(|c| c.name == "c7").unwrap();
        let mut row = 0u64;
        source
            .chunks(0, &[channel], &mut |chunk| {
                let Cells::Number(v) = &chunk[0] else { panic!("words") };
                for x in v {
                    assert_eq!(*x, (row % 14) as f64, "row {row}");
                    row += 1;
                }
                Ok(())
            })
            .unwrap();
        assert_eq!(row, 1_000_000);
        let Some((a, b)) = before.zip(peak_mb()) else { continue };
        println!("{name}: peak memory grew by {:.1} MB", b - a);
        assert!(b - a < 20.0, "{name}: peak memory grew by {:.1} MB", b - a);
    }
}
