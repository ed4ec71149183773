//! `dynocal show` and `dynocal convert`: what is in a file is said, and comes out the same in another format.

use std::path::Path;
use std::process::Output;

use assert_cmd::Command;
use dynocal_files::atomic;
use dynocal_files::dataset::read_table;
use dynocal_files::measurement::mat::MatValue;
use dynocal_files::measurement::{Raster, ReadKeys, by_ending, mat5, open, recording};
use dynocal_files::table::{Cells, Column, UnitSource};
use serde_json::Value;

fn dynocal(folder: &Path, args: &[&str]) -> Output {
    Command::cargo_bin("dynocal").unwrap().current_dir(folder).args(args).output().unwrap()
}

/// Standard output and standard error of a verb that ended with `code`.
fn said(folder: &Path, args: &[&str], code: i32) -> (String, String) {
    let done = dynocal(folder, args);
    let (out, err) = (String::from_utf8(done.stdout).unwrap(), String::from_utf8(done.stderr).unwrap());
    assert_eq!(done.status.code(), Some(code), "{args:?}: {out}{err}");
    (out, err)
}

fn column(name: &str, unit: &str, values: Vec<f64>) -> Column {
    let unit = (!unit.is_empty()).then(|| (unit.to_string(), UnitSource::Bracket));
    Column { name: name.into(), unit, cells: Cells::Number(values) }
}

/// A bed's record: 1001 rows every 0.01 s with a gap, and 11 rows every second.
fn record(path: &Path) {
    let time = |n: i32, dt: f64| (0..n).map(|k| f64::from(k) * dt).collect::<Vec<_>>();
    let mut torque: Vec<f64> = (0..1001).map(f64::from).collect();
    torque[500] = f64::NAN;
    let rasters = [
        Raster {
            name: "fast".into(),
            time_s: time(1001, 0.01),
            columns: vec![column("trq", "lbf ft", torque), column("count", "", time(1001, 1.0))],
        },
        Raster {
            name: "slow".into(),
            time_s: time(11, 1.0),
            columns: vec![column("oil", "degC", time(11, 1.0).iter().map(|t| 80.0 + t).collect())],
        },
    ];
    (by_ending(path).and_then(|f| f.write).unwrap())(path, &rasters).unwrap();
}

#[test]
fn a_file_is_shown() {
    let tmp = tempfile::tempdir().unwrap();
    record(&tmp.path().join("bed.mf4"));
    let (text, _) = said(tmp.path(), &["show", "bed.mf4", "--page", "bed.html"], 0);
    for part in ["bed.mf4 (mdf4)", "1001 rows, 0 s to 10 s", "every 0.01 s", "every 1 s", "lbf ft", "degC"] {
        assert!(text.contains(part), "no `{part}` in\n{text}");
    }
    let (json, _) = said(tmp.path(), &["show", "bed.mf4", "--json"], 0);
    let all: Value = serde_json::from_str(&json).unwrap();
    let torque = &all["groups"][0]["channels"][0];
    // 0 + .. + 1000 without 500, over 1000 values.
    let want = (1000.0 * 1001.0 / 2.0 - 500.0) / 1000.0;
    assert_eq!((torque["rows"].as_u64(), torque["gaps"].as_u64()), (Some(1001), Some(1)));
    assert_eq!((torque["min"].as_f64(), torque["max"].as_f64()), (Some(0.0), Some(1000.0)));
    assert!((torque["mean"].as_f64().unwrap() - want).abs() < 1e-9, "{torque}");
    let page = std::fs::read_to_string(tmp.path().join("bed.html")).unwrap();
    for part in ["<!doctype html>", "trq", "oil", "lbf ft"] {
        assert!(page.contains(part), "no `{part}` in the page");
    }
    // A stamp that goes back, a pause, words and a channel that is never there.
    atomic::write(
        &tmp.path().join("odd.csv"),
        b"time [ms];gear;none\n0;low;\n10;low;\n10;high;\n400;high;\n390;;\n",
    )
    .unwrap();
    let (text, _) = said(tmp.path(), &["show", "odd.csv", "--page", "odd.html"], 0);
    for part in ["longest interval 0.39 s", "2 stamps are not after the one before", "low, high", "separator"]
    {
        assert!(text.contains(part), "no `{part}` in\n{text}");
    }
}

/// A cell that is no number makes no states of a channel; an injection in ms is no time; stamps that begin anew have the interval
/// of each stretch.
#[test]
fn tables_of_points_and_faulty_cells_are_shown_as_what_they_are() {
    let tmp = tempfile::tempdir().unwrap();
    let file = |name: &str, text: &str| atomic::write(&tmp.path().join(name), text.as_bytes()).unwrap();
    file("points.csv", "speed [rpm],injection_time [ms]\n1000,2.5\n2000,\n3000,3.5\n");
    let (text, _) = said(tmp.path(), &["show", "points.csv"], 0);
    assert!(text.contains("3 rows, no time channel") && text.contains("injection_time"), "{text}");
    file("bad.csv", "time [s],torque [Nm]\n0,30\n0.1,x9\n0.2,50\n0.3,40\n0,20\n0.1,60\n");
    let (text, _) = said(tmp.path(), &["show", "bad.csv"], 0);
    for part in [
        "Nm; 1 no numbers: x9",
        "every 0.1 s on average where stamps go forward",
        "1 stamps are not after",
        "0 s to 0.3 s",
    ] {
        assert!(text.contains(part), "no `{part}` in\n{text}");
    }
    let row = text.lines().find(|l| l.contains("torque")).unwrap();
    assert!(row.contains("20.0") && row.contains("60.0") && row.contains("40.0"), "{row}");
}

#[test]
fn a_file_is_converted_and_comes_back() {
    let tmp = tempfile::tempdir().unwrap();
    record(&tmp.path().join("bed.mf4"));
    let flags = ["--unit", "torque=Nm", "--alias", "torque=Tq,trq", "--rule", "oil=line", "--quiet"];
    for to in ["all.csv", "all.csv.gz", "all.parquet"] {
        let (_, err) = said(tmp.path(), &[&["convert", "bed.mf4", to][..], &flags].concat(), 0);
        assert!(err.is_empty(), "{err}");
        let table = read_table(&tmp.path().join(to), None).unwrap();
        let torque = table.column("torque").unwrap();
        assert_eq!(torque.unit, Some(("Nm".into(), UnitSource::Bracket)), "{to}");
        let Cells::Number(v) = &torque.cells else { panic!("{to}: words") };
        assert!((v[1000] - 1355.8179483314004).abs() < 1e-9 && v[500].is_nan(), "{to}");
        // A unit that nobody said is not made up.
        assert_eq!(table.column("count").unwrap().unit, None, "{to}");
        // A line in time stays one on the finer raster.
        let Cells::Number(oil) = &table.column("oil").unwrap().cells else { panic!("{to}: words") };
        assert!(oil.iter().enumerate().all(|(k, x)| (x - 80.0 - 0.01 * k as f64).abs() < 1e-9), "{to}");
    }
    // Rasters stay where they can, and the chain back is the same file.
    for (from, to) in [("bed.mf4", "same.mat"), ("same.mat", "same.mf4")] {
        said(tmp.path(), &["convert", from, to], 0);
    }
    let of = |name: &str| {
        recording(open(&tmp.path().join(name), None, &ReadKeys::default()).unwrap().as_ref()).unwrap().rasters
    };
    let (first, last) = (of("bed.mf4"), of("same.mf4"));
    assert_eq!(first.len(), 2);
    for (a, b) in first.iter().zip(&last) {
        assert_eq!(a.time_s, b.time_s);
        for (c, d) in a.columns.iter().zip(&b.columns) {
            assert_eq!((&c.name, &c.unit, c.cells.len()), (&d.name, &d.unit, d.cells.len()));
            assert!((0..c.cells.len()).all(|k| c.cells.label(k) == d.cells.label(k)), "{}", c.name);
        }
    }
    // One slow channel on its own raster, and on a uniform axis.
    said(tmp.path(), &["convert", "bed.mf4", "oil.csv", "--channel", "oil"], 0);
    assert_eq!(read_table(&tmp.path().join("oil.csv"), None).unwrap().rows(), 11);
    let uniform =
        ["convert", "bed.mf4", "u.csv", "--sample-time-s", "0.5", "--merge", "mean", "--channel", "trq"];
    let (_, err) = said(tmp.path(), &uniform, 0);
    assert!(err.contains("common time: every 0.5 s") && err.contains("averaged"), "{err}");
    let table = read_table(&tmp.path().join("u.csv"), None).unwrap();
    // The mean of 51 .. 100.
    assert_eq!(table.numbers("trq", 2, 3).unwrap(), [75.5]);
}

#[test]
fn what_is_lost_or_refused_is_said() {
    let tmp = tempfile::tempdir().unwrap();
    record(&tmp.path().join("bed.mf4"));
    // Vectors of another length than the stamps have no place in time.
    let vector = |v: &[f64]| MatValue::Numbers { dims: vec![v.len(), 1], values: v.to_vec() };
    let variables = [
        ("time".to_string(), vector(&[0.0, 0.1, 0.2])),
        ("speed".to_string(), vector(&[800.0, 810.0, 820.0])),
        ("limits".to_string(), vector(&[500.0, 6500.0])),
    ];
    atomic::write(&tmp.path().join("m.mat"), &mat5::encode(&variables)).unwrap();
    atomic::write(&tmp.path().join("model.json"), b"{}").unwrap();
    std::fs::create_dir(tmp.path().join("run")).unwrap();
    atomic::write(&tmp.path().join("run/run.json"), b"{}").unwrap();
    let (_, err) = said(tmp.path(), &["convert", "m.mat", "m.csv"], 0);
    assert!(err.contains("has no time channel: its 1 channels (limits) are left out"), "{err}");
    let (text, _) = said(tmp.path(), &["show", "m.mat"], 0);
    assert!(text.contains("no time channel"), "{text}");
    let (_, err) = said(tmp.path(), &["convert", "bed.mf4", "all.csv", "--force"], 0);
    assert!(err.contains("11 rows held onto 1001"), "{err}");
    for (args, parts) in [
        (&["convert", "bed.mf4", "x.csv", "--unit", "trq=kPa"][..], &["torque cannot become pressure"][..]),
        (
            &["convert", "bed.mf4", "x.csv", "--channel", "tqr"],
            &["no column `tqr`; columns are: trq, count, oil"],
        ),
        (&["convert", "bed.mf4", "x.csv", "--unit", "trq"], &["--unit trq", "NAME=UNIT"]),
        (&["convert", "bed.mf4", "x.h5"], &["read, not written"]),
        (&["convert", "bed.mf4", "x.xyz"], &["x.xyz", ".mf4"]),
        (&["convert", "nowhere.mf4", "x.csv"], &["nowhere.mf4"]),
        (&["convert", "bed.mf4", "x.csv", "--rule", "oil=spline"], &["oil=spline", "hold, line"]),
        (&["show", "bed.mf4", "--csv", "separatr = ';'"], &["--csv", "separatr"]),
        (&["show", "bed.mf4", "--format", "mdf5"], &["mdf5", "mdf4"]),
        (&["convert", "bed.mf4", "./bed.mf4"], &["another file than the one that is read"]),
        (&["convert", "bed.mf4", "model.json"], &["model.json", "--force"]),
        (
            &["show", "model.json"],
            &["model.json", "hint: a measurement file is shown; a stored model is scored by"],
        ),
        (&["show", "run"], &["hint: a run folder: its page is run/report.html"]),
        (&["export", "nowhere", "--to", "c"], &["cannot read nowhere: no such file or folder"]),
    ] {
        let (_, err) = said(tmp.path(), args, 2);
        assert!(parts.iter().all(|p| err.contains(p)), "{parts:?} in {err}");
        assert!(!tmp.path().join("x.csv").exists(), "{args:?} wrote a file");
    }
}
