//! A calibration that begins with the maps of an ECU: the start of its optimisation is the map, along the references of its record.

use std::path::{Path, PathBuf};

use assert_cmd::Command;
use dynocal_files::dataset::read_table;
use dynocal_files::{atomic, table::Table};

/// A curve over speed in other words and units than those of the problem, as an ECU's data set has it.
const DCM: &str = "KONSERVIERUNG_FORMAT 2.0\r\n\r\nKENNLINIE KL_ZW 3\r\n  EINHEIT_X \"1/min\"\r\n  EINHEIT_W \"deg\"\r\n  \
                   ST/X 1000.0 1800.0 4000.0\r\n  WERT 12.0 20.0 31.0\r\nEND\r\n";

/// What the curve says: straight lines between its points, its ends beyond them.
fn curve(speed: f64) -> f64 {
    let between = |(x0, y0): (f64, f64), (x1, y1): (f64, f64)| y0 + (y1 - y0) * (speed - x0) / (x1 - x0);
    match speed {
        s if s <= 1000.0 => 12.0,
        s if s <= 1800.0 => between((1000.0, 12.0), (1800.0, 20.0)),
        s if s <= 4000.0 => between((1800.0, 20.0), (4000.0, 31.0)),
        _ => 31.0,
    }
}

fn calibrate(folder: &Path, extra: &str) -> (i32, String) {
    let shortest = Path::new(env!("CARGO_MANIFEST_DIR")).join("../studies/src/shortest.toml");
    let spec = format!("{}\n[optimise.start_maps]\n{extra}\n", std::fs::read_to_string(shortest).unwrap());
    atomic::write(&folder.join("spec.toml"), spec.as_bytes()).unwrap();
    atomic::write(&folder.join("ecu.dcm"), DCM.as_bytes()).unwrap();
    let out = Command::cargo_bin("dynocal")
        .unwrap()
        .current_dir(folder)
        .args(["calibrate", "spec.toml", "--until", "optimise", "--out", "run"])
        .output()
        .unwrap();
    (out.status.code().unwrap(), String::from_utf8(out.stderr).unwrap())
}

/// Files below `folder` whose name has `part` in it.
fn files(folder: &Path, part: &str) -> Vec<PathBuf> {
    let mut all = Vec::new();
    for entry in std::fs::read_dir(folder).unwrap() {
        let path = entry.unwrap().path();
        if path.is_dir() {
            all.extend(files(&path, part));
        } else if path.file_name().is_some_and(|n| n.to_string_lossy().contains(part)) {
            all.push(path);
        }
    }
    all
}

fn column(table: &Table, name: &str) -> Vec<f64> {
    table.numbers(name, 0, table.rows()).unwrap().to_vec()
}

#[test]
fn the_start_record_is_the_map_of_the_ecu() {
    let tmp = tempfile::tempdir().unwrap();
    for (keys, says) in [
        ("files = ['ecu.dcm']\nmaps = { spark = 'KL_ZV' }", "KL_ZW"),
        ("files = ['ecu.dcm']\nmaps = { spark = 'KL_ZW' }\naxes = { KL_ZW_x = 'spede' }", "spede"),
        ("files = ['ecu.dcm']\nmaps = { sparc = 'KL_ZW' }", "sparc"),
        ("files = ['no.dcm']\nmaps = { spark = 'KL_ZW' }", "no.dcm"),
        // The axis has the name that its curve gives it, which is none of a channel.
        ("files = ['ecu.dcm']\nmaps = { spark = 'KL_ZW' }", "`KL_ZW_x`"),
    ] {
        let (code, said) = calibrate(tmp.path(), keys);
        assert!(code == 2 && said.contains(says), "{keys}: {code} {said}");
    }
    let good = "files = ['ecu.dcm']\nmaps = { spark = 'KL_ZW' }\naxes = { KL_ZW_x = 'speed' }";
    let (code, said) = calibrate(tmp.path(), good);
    assert!(code < 2, "{said}");
    let starts = files(&tmp.path().join("run"), "_start.csv");
    assert!(!starts.is_empty());
    for path in starts {
        let table = read_table(&path, None).unwrap();
        let (spark, speed) = (column(&table, "spark"), column(&table, "speed"));
        let least = speed.iter().copied().fold(f64::INFINITY, f64::min);
        let most = speed.iter().copied().fold(f64::NEG_INFINITY, f64::max);
        // Both pieces of the curve are driven.
        assert!(least < 1700.0 && most > 1900.0, "{least} to {most}");
        for (t, (found, n)) in spark.iter().zip(&speed).enumerate() {
            assert!((found - curve(*n)).abs() < 1e-9, "{}, row {t}: {found} {}", path.display(), curve(*n));
        }
    }
}
