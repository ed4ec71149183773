//! What other tools write: read as it is meant, or said to be left out.

#![allow(clippy::disallowed_methods)] // broken and foreign files are written as they are

use std::path::{Path, PathBuf};
use std::process::Command;

use dynocal_files::measurement::csv_dialect::CsvKeys;
use dynocal_files::measurement::{Raster, ReadKeys, Recording, csv_io, open, recording};
use dynocal_files::table::{Cells, Column, Table};

fn numbers(c: &Column) -> &[f64] {
    match &c.cells {
        Cells::Number(v) => v,
        Cells::Text(words) => panic!("`{}` holds words: {:?}", c.name, &words[..words.len().min(3)]),
    }
}

fn parse(text: &str) -> Table {
    csv_io::parse("a.csv", text.as_bytes()).unwrap()
}

fn column<'a>(table: &'a Table, name: &str) -> &'a Column {
    table
        .columns
        .iter()
        .find(|c| c.name == name)
        .unwrap_or_else(|| panic!("no `{name}`: {:?}", table.columns))
}

/// Columns between blanks: three numbers are three numbers, not one with thousands.
#[test]
fn columns_between_blanks() {
    let table = parse("time [s]   speed (rpm)  x\n0.0   1000  1\n0.1   1001  4\n12.5   1002  -9.5e-1\n");
    assert!(table.notes[0].contains("separator blanks"), "{:?}", table.notes);
    assert_eq!(numbers(column(&table, "time")), [0.0, 0.1, 12.5]);
    let speed = table.columns.iter().find(|c| c.name.starts_with("speed")).unwrap();
    assert_eq!(
        (numbers(speed), speed.unit.as_ref().unwrap().0.as_str()),
        (&[1000.0, 1001.0, 1002.0][..], "rpm")
    );
    assert_eq!(numbers(column(&table, "x")), [1.0, 4.0, -0.95]);
    // Blanks for thousands stay what they were, and a blank after the decimal point is none.
    let table = parse("a;b\n1 234,5;1\n12 234,5;2\n");
    assert_eq!(numbers(column(&table, "a")), [1234.5, 12234.5]);
    let keys = CsvKeys { separator: Some(' '), ..CsvKeys::default() };
    let table = csv_io::parse_with("a.csv", b"t y\n0 5\n1 6\n", &keys).unwrap();
    assert_eq!(numbers(column(&table, "y")), [5.0, 6.0]);
}

/// A row of words over columns of numbers holds units, also those that no table knows; a record that begins with words does not.
#[test]
fn a_row_of_unknown_units() {
    let table = parse("time,a,b\ns,furlong,Nm\n0.0,1,2\n0.1,3,4\n0.2,5,6\n");
    assert!(table.notes[0].contains("units in the line below"), "{:?}", table.notes);
    assert_eq!(numbers(column(&table, "a")), [1.0, 3.0, 5.0]);
    let unit = |name: &str| column(&table, name).unit.as_ref().unwrap().0.clone();
    assert_eq!((unit("a"), unit("b"), unit("time")), ("furlong".into(), "Nm".into(), "s".into()));
    // Stamps are numbers in other words; states keep their unit cell empty or `-`.
    let table = parse("Zeit;x;state\nhh:mm;Foo;-\n12:00:00;1,5;low\n12:00:01;2,5;high\n12:00:02;3,5;low\n");
    assert_eq!(numbers(column(&table, "Zeit")), [0.0, 1.0, 2.0]);
    assert_eq!(numbers(column(&table, "x")), [1.5, 2.5, 3.5]);
    for records in [
        "a,b\nlow,cold\n1,2\nhigh,3\n",
        "a,b\nNULL,n/a\n1,2\n3,4\n",
        "a,b\nx,y\n1,2\n",
        "a,b\nx,1\n1,2\n3,4\n",
    ] {
        assert_eq!(parse(records).rows(), records.lines().count() - 1, "{records}");
    }
}

/// Words for a missing value are gaps in a column of numbers, told with their number; among other words they are words.
#[test]
fn words_for_gaps() {
    let table = parse("t,a,b,c\n0,NULL,none,\n1,1.5,low,On\n2,#DIV/0!,none,Off\n3,#N/A,,On\n");
    let a = numbers(column(&table, "a"));
    assert_eq!(a[1], 1.5);
    assert!([0, 2, 3].iter().all(|k| a[*k].is_nan()), "{a:?}");
    assert!(table.notes.iter().any(|n| n == "column `a`: 3 cells are gaps (`NULL`)"), "{:?}", table.notes);
    let Cells::Text(b) = &column(&table, "b").cells else { panic!("numbers") };
    assert_eq!(b, &["none", "low", "none", ""]);
    // A switch that begins with an empty cell is one.
    let c = numbers(column(&table, "c"));
    assert!(c[0].is_nan() && c[1..] == [1.0, 0.0, 1.0], "{c:?}");
}

/// The index that a data frame writes before its columns has no name; separators at line ends make no column.
#[test]
fn columns_without_a_name() {
    let table = parse(",time,a\n0,0.0,5\n1,0.1,6\n");
    assert_eq!(numbers(column(&table, "column_1")), [0.0, 1.0]);
    assert!(table.notes.iter().any(|n| n.contains("column 1 has no name")), "{:?}", table.notes);
    let table = parse("time,a,,\n0,5,,\n1,6,,\n");
    assert_eq!(table.columns.len(), 2);
    assert!(table.notes.is_empty(), "{:?}", table.notes);
}

/// Files of asammdf, SciPy and h5py; says SKIPPED READER where they are missing.
fn made(folder: &Path) -> bool {
    let target = std::env::var_os("CARGO_TARGET_DIR")
        .map_or_else(|| Path::new(env!("CARGO_MANIFEST_DIR")).join("../../target"), PathBuf::from);
    let python = std::env::var_os("DYNOCAL_READERS_PYTHON")
        .map_or_else(|| target.join("readers/bin/python"), PathBuf::from);
    let there = |c: &mut Command| c.output().is_ok_and(|o| o.status.success());
    if !there(Command::new(&python).args(["-c", "import asammdf, scipy, h5py"])) {
        println!("SKIPPED READER: no Python with asammdf, scipy and h5py (run scripts/readers.sh)");
        return false;
    }
    let script = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/readers/make_odd.py");
    let out = Command::new(&python).args(["-W", "ignore"]).arg(script).arg(folder).output().unwrap();
    assert!(out.status.success(), "{}", String::from_utf8_lossy(&out.stderr));
    true
}

fn read(path: &Path) -> (Vec<String>, Recording) {
    let source = open(path, None, &ReadKeys::default()).unwrap();
    (source.notes().to_vec(), recording(source.as_ref()).unwrap())
}

fn of<'a>(rasters: &'a [Raster], name: &str) -> &'a Column {
    let all: Vec<&Column> = rasters.iter().flat_map(|r| &r.columns).collect();
    all.iter().find(|c| c.name == name).copied().unwrap_or_else(|| panic!("no `{name}`"))
}

#[test]
fn files_of_asammdf_with_odd_channels() {
    let tmp = tempfile::tempdir().unwrap();
    if !made(tmp.path()) {
        return;
    }
    let (_, all) = read(&tmp.path().join("names.mf4"));
    let names: Vec<&str> = all.rasters[0].columns.iter().map(|c| c.name.as_str()).collect();
    assert_eq!(names, ["Drehzahl [1/min]", "Öl Temperatur", "a,b;c\"d", "速度", "two\nlines"]);
    assert_eq!(of(&all.rasters, "Öl Temperatur").unit.as_ref().unwrap().0, "degC");
    let (_, all) = read(&tmp.path().join("empty.mf4"));
    assert_eq!(numbers(of(&all.rasters, "x")).len(), 500);
    // Nothing is read as something that it is not: each channel is what it was, or is named.
    let (notes, all) = read(&tmp.path().join("odd.mf4"));
    for left in ["half", "structure", "array"] {
        assert!(
            notes.iter().any(|n| n.starts_with(&format!("channel `{left}` is left out"))),
            "{left}: {notes:?}"
        );
        assert!(all.rasters.iter().flat_map(|r| &r.columns).all(|c| c.name != left), "{left}");
    }
    assert_eq!(numbers(of(&all.rasters, "x"))[499], 4.99);
    let Cells::Text(words) = &of(&all.rasters, "huge").cells else { panic!("numbers") };
    assert_eq!((words[0].as_str(), words[1].len()), ("on", 5000));
    let (_, all) = read(&tmp.path().join("old.mdf"));
    assert_eq!(of(&all.rasters, "y").unit.as_ref().unwrap().0, "degC");
}

/// Whole numbers and floats of every width: plain, deflated and transposed blocks give the same bits, and those that were written.
#[test]
fn blocks_of_every_kind_give_the_same_bits() {
    let tmp = tempfile::tempdir().unwrap();
    if !made(tmp.path()) {
        return;
    }
    let raw = |t: usize| t as i64 * 10 - 1;
    for compression in [0, 1, 2] {
        let (_, all) = read(&tmp.path().join(format!("kinds_{compression}.mf4")));
        for (name, wraps) in [("i1", 8), ("i2", 16), ("i4", 32), ("i8", 64)] {
            let signed = numbers(of(&all.rasters, &format!("c_{name}")));
            for (t, x) in signed.iter().enumerate().skip(1) {
                let want = (raw(t) << (64 - wraps)) >> (64 - wraps);
                assert!((*x - want as f64).abs() <= 1.0, "{compression}, {name}, row {t}: {x} {want}");
            }
        }
        let (_, plain) = read(&tmp.path().join("kinds_0.mf4"));
        for (a, b) in plain.rasters[0].columns.iter().zip(&all.rasters[0].columns) {
            assert_eq!(a.name, b.name);
            let bits = |c: &Column| numbers(c).iter().map(|x| x.to_bits()).collect::<Vec<_>>();
            assert_eq!(bits(a), bits(b), "{compression}, {}", a.name);
        }
    }
}

#[test]
fn files_of_scipy_and_h5py() {
    let tmp = tempfile::tempdir().unwrap();
    if !made(tmp.path()) {
        return;
    }
    let (notes, all) = read(&tmp.path().join("odd.mat"));
    for left in ["txt", "cells", "empty", "c"] {
        assert!(
            notes.iter().any(|n| n.starts_with(&format!("variable `{left}` is left out"))),
            "{left}: {notes:?}"
        );
    }
    assert_eq!(numbers(of(&all.rasters, "m_2"))[1], 4.0);
    // Rows of a table of plain HDF5 are rows, beside the vectors of that length.
    let (notes, all) = read(&tmp.path().join("plain.h5"));
    assert!(notes.iter().any(|n| n.contains("`names`")), "{notes:?}");
    assert_eq!(all.rasters.len(), 1);
    assert_eq!(
        (numbers(of(&all.rasters, "m_1"))[499], numbers(of(&all.rasters, "m_2"))[499]),
        (998.0, 999.0)
    );
    assert_eq!(numbers(of(&all.rasters, "x"))[1], 0.03);
}
