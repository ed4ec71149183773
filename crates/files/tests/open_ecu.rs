//! Logs of open ECUs: against what the tool that wrote them exported, and through our own writer.

use std::io::Read;
use std::path::{Path, PathBuf};

use dynocal_files::measurement::mlg::{Mlg, Raw};
use dynocal_files::measurement::mlg_write::{Written, write};
use dynocal_files::measurement::{ReadKeys, Source, open, recording};
use dynocal_files::table::Cells;

fn folder() -> Option<PathBuf> {
    let dir = std::env::var("DYNOCAL_REFERENCE_DIR").ok();
    if dir.is_none() {
        println!("SKIPPED: DYNOCAL_REFERENCE_DIR is not set");
    }
    dir.map(|d| Path::new(&d).join("data/open_ecu"))
}

fn values(log: &Mlg) -> Vec<Vec<f64>> {
    let channels: Vec<usize> = (1..=log.fields.len()).collect();
    let mut out: Vec<Vec<f64>> = vec![Vec::new(); channels.len()];
    log.chunks(0, &channels, &mut |chunk| {
        for (v, c) in out.iter_mut().zip(chunk) {
            let Cells::Number(c) = c else { panic!("numbers") };
            v.extend_from_slice(c);
        }
        Ok(())
    })
    .unwrap();
    out
}

/// Every number that the tool printed, to its last digit.
#[test]
fn a_log_is_what_the_tool_printed_of_it() {
    let Some(folder) = folder() else { return };
    let mut compared = 0;
    for stem in ["2025-12-08_15.52.00", "2025-12-02_10.54.12"] {
        let log = Mlg::open(&folder.join(format!("{stem}.mlg"))).unwrap();
        let columns = values(&log);
        let packed = std::fs::read(folder.join(format!("{stem}.csv.gz"))).unwrap();
        let mut text = String::new();
        flate2::read::MultiGzDecoder::new(&packed[..]).read_to_string(&mut text).unwrap();
        let mut lines = text.lines();
        let names: Vec<&str> = lines.next().unwrap().split(';').map(|n| n.trim_matches('"')).collect();
        lines.next();
        for (field, name) in log.fields.iter().zip(&names) {
            assert!(field.name == *name || (name.is_empty() && field.name.starts_with("field ")), "{name}");
        }
        let rows: Vec<&str> = lines.collect();
        assert_eq!(rows.len() as u64, log.groups()[0].rows, "{stem}: one record a row");
        for (k, row) in rows.iter().enumerate() {
            let cells: Vec<&str> = row.split(';').collect();
            assert_eq!(cells.len(), columns.len(), "{stem}, row {k}");
            for (c, cell) in cells.iter().enumerate() {
                let digits = cell.split_once('.').map_or(0, |(_, after)| after.len());
                // The tool prints 0 where a record of before the trigger has no number.
                let ours = if columns[c][k].is_nan() { 0.0 } else { columns[c][k] };
                let printed = cell.parse::<f64>().unwrap();
                // Half a last digit, and the error of single precision where the value lies between two.
                let most = 0.5 * 10f64.powi(-(digits as i32)) + 1e-7 * ours.abs();
                assert!((ours - printed).abs() <= most, "{stem}, row {k}, {}: {ours} {cell}", names[c]);
                compared += 1;
            }
        }
    }
    println!("{compared} numbers compared");
    assert!(compared > 250_000, "{compared}");
}

#[test]
fn the_small_files_of_another_reader_are_read_as_it_reads_them() {
    let Some(folder) = folder() else { return };
    for (name, records) in [("short", true), ("markers", true)] {
        let log = Mlg::open(&folder.join(format!("formats/{name}.mlg"))).unwrap();
        let text = std::fs::read_to_string(folder.join(format!("formats/{name}.json"))).unwrap();
        let other: serde_json::Value = serde_json::from_str(&text).unwrap();
        let rows: Vec<&serde_json::Value> =
            other["records"].as_array().unwrap().iter().filter(|r| r.get("RPM").is_some()).collect();
        let columns = values(&log);
        assert_eq!(records, !rows.is_empty());
        assert_eq!(rows.len() as u64, log.groups()[0].rows, "{name}");
        for (k, row) in rows.iter().enumerate() {
            for (f, column) in log.fields.iter().zip(&columns) {
                // It gives raw values.
                let theirs = (row[&f.name].as_f64().unwrap() + f.offset) * f.scale;
                let near = (column[k] - theirs).abs() <= 1e-6 * theirs.abs().max(1.0);
                assert!(
                    near || log.fields.iter().filter(|g| g.name == f.name).count() > 1,
                    "{name} {k} {}",
                    f.name
                );
            }
        }
    }
    let blank = Mlg::open(&folder.join("formats/blank.mlg")).unwrap();
    assert_eq!(blank.groups()[0].rows, 0);
}

#[test]
fn time_runs_forward_and_the_tune_is_whole() {
    let Some(folder) = folder() else { return };
    for name in ["2025-12-02_10.08.37", "2025-12-02_10.58.15o", "2026-02-28_17.53.41"] {
        let path = folder.join(format!("{name}.mlg"));
        let log = Mlg::open(&path).unwrap();
        let tune = log.tune().expect("a tune");
        assert!(tune.starts_with(b"<?xml") && tune.ends_with(b"</msq>\r\n"), "{name}");
        assert!(log.info().contains("speeduino 202501"), "{}", log.info());
        let r = recording(&log).unwrap().rasters.remove(0);
        assert!(r.time_s.windows(2).all(|w| w[1] >= w[0]), "{name}");
        // Its own clock says the same over the whole drive, to its own resolution.
        let Cells::Number(own) = &r.columns.iter().find(|c| c.name == "Time").unwrap().cells else {
            panic!()
        };
        let from = own.iter().position(|t| *t < 1.0 && t.is_finite()).unwrap();
        let (last, n) = (own.len() - 1, own.len() as f64);
        let (ours, theirs) = (r.time_s[last] - r.time_s[from], own[last] - own[from]);
        println!("{name}: {n} records, {ours:.3} s, by its own clock {theirs:.3} s");
        assert!((ours - theirs).abs() < 1e-3 * theirs, "{name}: {ours} {theirs}");
    }
}

#[test]
fn what_is_written_is_read_again() {
    let tmp = tempfile::tempdir().unwrap();
    let path = tmp.path().join("own.mlg");
    let n = 300;
    let time_s: Vec<f64> = (0..n).map(|k| 0.0667 * f64::from(k)).collect();
    let field = |name: &str, raw, scale, values: Vec<f64>| Written {
        name: name.into(),
        unit: "%".into(),
        raw,
        scale,
        digits: 1,
        values,
    };
    let wave: Vec<f64> = (0..n).map(|k| f64::from(k % 200) * 0.5).collect();
    let signed: Vec<f64> = (0..n).map(|k| f64::from(k) - 150.0).collect();
    let fields = [
        field("half", Raw::Unsigned(1), 0.5, wave.clone()),
        field("signed", Raw::Signed(2), 1.0, signed.clone()),
        field("real", Raw::Float, 1.0, wave.clone()),
    ];
    write(&path, &time_s, &fields, Some(b"<?xml version=\"1.0\"?><msq></msq>\n")).unwrap();
    let log = Mlg::open(&path).unwrap();
    assert_eq!(log.tune().unwrap(), b"<?xml version=\"1.0\"?><msq></msq>\n");
    assert_eq!(values(&log), [wave.clone(), signed, wave]);
    let r = recording(&log).unwrap().rasters.remove(0);
    for (a, b) in r.time_s.iter().zip(&time_s) {
        assert!((a - b).abs() < 1e-5, "{a} {b}");
    }
}

#[test]
fn a_text_log_is_read_with_words_and_markers() {
    let tmp = tempfile::tempdir().unwrap();
    let path = tmp.path().join("own.msl");
    let text = "\"Speeduino 2025.01\"\n\"Capture Date\"\n#\nTime\tRPM\tFan\tAFR\ns\trpm\t\tO2\n\
                0.10\t800\tOn\t25.5\nMARK 000 - here\n0.20\t810\tOff\tNaN\n";
    dynocal_files::atomic::write(&path, text.as_bytes()).unwrap();
    let source = open(&path, None, &ReadKeys::default()).unwrap();
    let r = recording(source.as_ref()).unwrap().rasters.remove(0);
    assert_eq!(r.time_s, [0.1, 0.2]);
    assert_eq!(r.columns[1].cells, Cells::Number(vec![1.0, 0.0]));
    assert!(source.notes()[0].contains("1 shorter"), "{:?}", source.notes());
    dynocal_files::atomic::write(&path, b"Time\tRPM\n0\t1\n").unwrap();
    let message = open(&path, None, &ReadKeys::default()).err().unwrap().to_string();
    assert!(message.contains("expected units"), "{message}");
}
