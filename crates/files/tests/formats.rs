//! Measurement formats: files that others wrote are read with their known numbers, own files come back equal.

#![allow(clippy::disallowed_methods)] // broken and foreign files are written as they are

use std::path::{Path, PathBuf};

use dynocal_files::measurement::merge::{self, Keys, Rule};
use dynocal_files::measurement::{
    ChannelInfo, GroupInfo, Raster, ReadKeys, Source, TakeChunk, by_ending, open, recording, recording_of,
    table,
};
use dynocal_files::table::{Cells, Column, UnitSource};
use dynocal_files::{FilesError, csv_io, units};

fn reference(name: &str) -> Option<PathBuf> {
    match std::env::var("DYNOCAL_REFERENCE_DIR") {
        Ok(dir) => Some(Path::new(&dir).join("formats").join(name)),
        Err(_) => {
            println!("SKIPPED: DYNOCAL_REFERENCE_DIR is not set");
            None
        }
    }
}

fn opened(path: &Path) -> Box<dyn Source> {
    open(path, None, &ReadKeys::default()).unwrap()
}

fn numbers(c: &Column) -> &[f64] {
    match &c.cells {
        Cells::Number(v) => v,
        Cells::Text(_) => panic!("`{}` holds words", c.name),
    }
}

/// Numbers of `make_mdf_mat.py`, which wrote the file with asammdf.
#[test]
fn mdf4_of_asammdf() {
    let Some(path) = reference("tiny.mf4") else { return };
    let source = opened(&path);
    let all = recording(source.as_ref()).unwrap().rasters;
    assert_eq!(all.len(), 2);
    let column = |name: &str| all.iter().flat_map(|r| &r.columns).find(|c| c.name == name).unwrap();
    let speed: Vec<f64> = (0..50).map(|k| f64::from(800 + 5 * k) * 0.5 + 100.0).collect();
    assert_eq!(numbers(column("speed")), speed);
    assert_eq!(column("speed").unit, Some(("rpm".into(), UnitSource::Bracket)));
    let Cells::Text(gear) = &column("gear_state").cells else { panic!("states are words") };
    assert_eq!([&gear[0], &gear[2], &gear[6]], ["neutral", "drive", "unknown"]);
    assert!(all[0].time_s.iter().enumerate().all(|(k, t)| (t - 0.02 * k as f64).abs() < 1e-12));
    // The slow raster is held on the fast one.
    let merged = merge::merge("tiny.mf4", &all, &Keys::default()).unwrap();
    assert_eq!(merged.rows(), 50);
    assert!(merged.notes.iter().any(|n| n.contains("10 rows held onto 50")), "{:?}", merged.notes);
}

/// `scipy.io.savemat` and `h5py` wrote the same struct.
#[test]
fn mat_of_scipy_and_h5py() {
    use dynocal_files::measurement::mat::MatValue;
    let (Some(v5), Some(v73)) = (reference("tiny.mat"), reference("tiny_v73.mat")) else { return };
    for variables in [
        dynocal_files::measurement::mat5::read(&v5).unwrap(),
        dynocal_files::measurement::mat73::read(&v73).unwrap(),
    ] {
        let (name, map) = &variables[0];
        assert_eq!(name, "INJ_MAP");
        assert_eq!(map.field("bp_x").and_then(MatValue::as_vector).unwrap(), [1000.0, 2000.0, 4000.0]);
        let table = MatValue::Numbers { dims: vec![2, 3], values: vec![12.5, 31.0, 12.0, 30.5, 13.25, 33.0] };
        assert_eq!(map.field("table").unwrap(), &table);
    }
}

/// What is written is read back to the same bits, gaps included.
#[test]
fn own_files_come_back() {
    let tmp = tempfile::tempdir().unwrap();
    let column = |name: &str, unit: &str, v: &[f64]| Column {
        name: name.into(),
        unit: Some((unit.into(), UnitSource::Bracket)),
        cells: Cells::Number(v.to_vec()),
    };
    let raster = Raster {
        name: "fast".into(),
        time_s: vec![0.0, 0.01, 0.02, 0.03],
        columns: vec![
            column("torque", "Nm", &[1.0, -2.5, f64::NAN, 1e-300]),
            column("speed", "rpm", &[800.0, 801.0, 802.5, 0.1 + 0.2]),
        ],
    };
    for name in ["a.csv", "a.csv.gz", "a.parquet", "a.mf4", "a.mat"] {
        let path = tmp.path().join(name);
        let write = by_ending(&path).and_then(|f| f.write).unwrap();
        write(&path, std::slice::from_ref(&raster)).unwrap();
        let back = recording(opened(&path).as_ref()).unwrap().rasters;
        assert_eq!(back.len(), 1, "{name}");
        assert_eq!(back[0].time_s, raster.time_s, "{name}");
        for (a, b) in back[0].columns.iter().zip(&raster.columns) {
            assert_eq!((&a.name, &a.unit), (&b.name, &b.unit), "{name}");
            let bits = |c| {
                numbers(c).iter().map(|x: &f64| if x.is_nan() { 0 } else { x.to_bits() }).collect::<Vec<_>>()
            };
            assert_eq!(bits(a), bits(b), "{name}");
        }
        let first = std::fs::read(&path).unwrap();
        write(&path, std::slice::from_ref(&raster)).unwrap();
        assert_eq!(std::fs::read(&path).unwrap(), first, "{name}: equal data, equal bytes");
    }
}

/// Two rasters keep their stamps; merging follows the stated rule.
#[test]
fn rules_of_merging() {
    let raster = |name: &str, time_s: Vec<f64>, v: Vec<f64>| Raster {
        name: name.into(),
        time_s,
        columns: vec![Column { name: name.into(), unit: None, cells: Cells::Number(v) }],
    };
    // A line in time: every rule has an answer in closed form.
    let fast =
        raster("fast", (0..11).map(|k| f64::from(k) * 0.1).collect(), (0..11).map(f64::from).collect());
    let slow = raster("slow", vec![0.05, 0.45, 0.85], vec![0.5, 4.5, 8.5]);
    let at = |rule| {
        let keys = Keys { rule, raster: Some("fast".into()), ..Default::default() };
        numbers(&merge::merge("m", &[fast.clone(), slow.clone()], &keys).unwrap().columns[2]).to_vec()
    };
    let line = at(Rule::Line);
    assert!(line[0].is_nan() && line[9].is_nan());
    assert!((1..9).all(|k| (line[k] - k as f64).abs() < 1e-12), "{line:?}");
    let hold = at(Rule::Hold);
    assert_eq!(hold[1..5], [0.5; 4]);
    assert_eq!(hold[5..9], [4.5; 4]);
    assert!(at(Rule::Event).iter().all(|x| x.is_nan()));
    let down = Keys { rule: Rule::Mean, raster: Some("slow".into()), ..Default::default() };
    let mean = merge::merge("m", &[fast.clone(), slow.clone()], &down).unwrap();
    assert_eq!(numbers(&mean.columns[1]), [0.0, 2.5, 6.5]);
    // Stamps that differ by less than the tolerance are one instant.
    let late = raster("late", slow.time_s.iter().map(|t| t + 4e-7).collect(), vec![1.0, 2.0, 3.0]);
    let keys = Keys { rule: Rule::Event, ..Default::default() };
    let both = merge::merge("m", &[slow.clone(), late], &keys).unwrap();
    assert_eq!(numbers(&both.columns[2]), [1.0, 2.0, 3.0]);
    let uniform = Keys { rule: Rule::Line, sample_time_s: Some(0.2), ..Default::default() };
    assert_eq!(merge::merge("m", &[fast, slow], &uniform).unwrap().rows(), 5);
}

/// (name of the habit, bytes, wanted column `b` and its unit)
#[test]
fn dialects() {
    let utf16: Vec<u8> = "\u{feff}a;b\n1;2,5\n2;3,5\n".encode_utf16().flat_map(u16::to_le_bytes).collect();
    type Case<'a> = (&'a str, Vec<u8>, &'a [f64], Option<&'a str>);
    let cases: Vec<Case> = vec![
        ("plain", b"a,b\n1,2.5\n2,3.5\n".to_vec(), &[2.5, 3.5], None),
        ("decimal comma", b"a;b\n1;2,5\n2;3,5\n".to_vec(), &[2.5, 3.5], None),
        ("utf-16", utf16, &[2.5, 3.5], None),
        ("thousands", b"a;b\n1;1.002,5\n2;1.003,5\n".to_vec(), &[1002.5, 1003.5], None),
        ("american thousands", b"a,b\n1,\"1,002.5\"\n2,\"12,003.5\"\n".to_vec(), &[1002.5, 12003.5], None),
        ("latin-1 unit", b"a;b [\xb0C]\n1;20\n2;21\n".to_vec(), &[20.0, 21.0], Some("degC")),
        ("units below", b"a\tb\ns\tpsi\n1\t20\n2\t21\n".to_vec(), &[20.0, 21.0], Some("psi")),
        ("preamble", b"Logger 7\nuser: x\n\na,b\n1,2.5\n2,3.5\n".to_vec(), &[2.5, 3.5], None),
        ("switch", b"a,b\n1,On\n2,Off\n".to_vec(), &[1.0, 0.0], None),
        ("quoted name", b"a,\"b\"\n1,2.5\n2,3.5\n".to_vec(), &[2.5, 3.5], None),
        ("clock", b"a;b\n1;12:00:00,5\n2;12:00:01,0\n".to_vec(), &[0.0, 0.5], Some("s")),
    ];
    for (name, bytes, want, unit) in cases {
        let table = csv_io::parse("a.csv", &bytes).unwrap_or_else(|e| panic!("{name}: {e}"));
        assert_eq!(table.numbers("b", 0, 2).unwrap(), want, "{name}: {:?}", table.notes);
        assert_eq!(table.column("b").unwrap().unit.as_ref().map(|u| u.0.as_str()), unit, "{name}");
        // What is not plain is told.
        let told = table.notes.first().is_some_and(|n| n.starts_with("read as "));
        assert_eq!(told, !["plain", "switch", "quoted name"].contains(&name), "{name}: {:?}", table.notes);
    }
}

/// A key wins over the guess; a ragged row is named by its line, preamble counted.
#[test]
fn keys_fix_the_dialect() {
    let keys = dynocal_files::measurement::csv_dialect::CsvKeys {
        thousands: Some(",".into()),
        decimal: Some('.'),
        ..Default::default()
    };
    let table = csv_io::parse_with("a.csv", b"a;b\n1;1,002\n2;1,003\n", &keys).unwrap();
    assert_eq!(table.numbers("b", 0, 2).unwrap(), [1002.0, 1003.0]);
    let ragged = csv_io::parse("a.csv", b"made by x\na,b\n1,2\n1,2\n3\n").unwrap_err().to_string();
    assert!(ragged.contains("line 5: found 1 cells, expected 2"), "{ragged}");
    let windows = b"made by x\r\na,b\r\n1,2\r\n1,2\r\n3\r\n";
    let ragged = csv_io::parse("a.csv", windows).unwrap_err().to_string();
    assert!(ragged.contains("line 5: found 1 cells, expected 2"), "{ragged}");
}

/// Every unit converts to every other of its dimension and back, and to none of another dimension.
#[test]
fn conversions_close() {
    let names = ["ms", "h", "lbf ft", "psi", "degF", "degC", "g/s", "lb/h", "mph", "hp", "%", "rpm", "deg"];
    for a in names {
        for b in names {
            let same = units::dimension(a) == units::dimension(b);
            let there = units::conversion(a, b);
            assert_eq!(there.is_some(), same, "{a} to {b}");
            if let (Some((s, o)), Some((r, p))) = (there, units::conversion(b, a)) {
                let x = 17.0;
                assert!(((x * s + o) * r + p - x).abs() < 1e-10, "{a} {b}");
            }
        }
    }
    let (s, o) = units::conversion("degF", "degC").unwrap();
    assert!((212.0 * s + o - 100.0).abs() < 1e-9 && (32.0 * s + o).abs() < 1e-9);
    assert_eq!(units::conversion("1/min", "rpm"), Some((1.0, 0.0)));
}

/// A file is known by its first bytes even under a foreign name.
#[test]
fn first_bytes_tell_the_format() {
    let Some(path) = reference("tiny.mf4") else { return };
    let tmp = tempfile::tempdir().unwrap();
    let hidden = tmp.path().join("record.bin");
    std::fs::copy(&path, &hidden).unwrap();
    let source = opened(&hidden);
    assert_eq!(table(source.as_ref(), 0, &[0]).unwrap().rows(), 50);
    let foreign = tmp.path().join("x.bin");
    std::fs::write(&foreign, b"hello").unwrap();
    let e = open(&foreign, None, &ReadKeys::default()).err().unwrap().to_string();
    assert!(e.contains("format not known") && e.contains(".mf4"), "{e}");
}

/// A file of three groups: one raster, one table without time, one raster that never got a sample.
struct Groups(Vec<GroupInfo>);

impl Groups {
    fn new() -> Self {
        let channel = |name: &str, unit: &str| ChannelInfo {
            name: name.into(),
            unit: (!unit.is_empty()).then(|| unit.into()),
            comment: String::new(),
            text: false,
        };
        let group = |name: &str, channels: Vec<ChannelInfo>, time, rows| GroupInfo {
            name: name.into(),
            channels,
            time,
            rows,
        };
        Self(vec![
            group("fast", vec![channel("clock", "ms"), channel("speed", "rpm")], Some(0), 3),
            group("limits", vec![channel("speed", "rpm"), channel("torque", "Nm")], None, 2),
            group("", vec![channel("time", "s"), channel("speed", "rpm"), channel("oil", "degC")], None, 0),
            group("slow", vec![channel("time", "s"), channel("speed", "rpm")], Some(0), 2),
        ])
    }
}

impl Source for Groups {
    fn file(&self) -> &str {
        "a.mf4"
    }

    fn groups(&self) -> &[GroupInfo] {
        &self.0
    }

    fn notes(&self) -> &[String] {
        &[]
    }

    fn chunks(&self, group: usize, channels: &[usize], take: &mut TakeChunk<'_>) -> Result<(), FilesError> {
        let rows = self.0[group].rows as usize;
        let values = |c: &usize| Cells::Number((0..rows).map(|r| (10 * group + c + r) as f64).collect());
        take(&channels.iter().map(values).collect::<Vec<_>>())
    }
}

/// What has no place in time is named, group by group, and so is a channel that gets another name.
#[test]
fn what_is_left_out_is_said() {
    let found = recording(&Groups::new()).unwrap();
    let names = |r: &Raster| r.columns.iter().map(|c| c.name.clone()).collect::<Vec<_>>();
    assert_eq!(found.rasters.iter().map(names).collect::<Vec<_>>(), [["speed"], ["speed@4"]]);
    assert_eq!(found.rasters[0].time_s, [0.0, 0.001, 0.002]);
    let said = [
        "group 2 `limits` has no time channel: its 2 channels (speed, torque) are left out",
        "group 3 holds no rows: its 3 channels (time, speed, oil) are left out",
        "channel `speed` of group 4 is called `speed@4`",
    ];
    assert_eq!(found.notes, said);
    // The same where a job reads the file as one table.
    let table = merge::whole(&Groups::new(), &Keys::default()).unwrap();
    assert!(said.iter().all(|s| table.notes.iter().any(|n| n == s)), "{:?}", table.notes);
    let one = recording_of(&Groups::new(), &|name| name == "speed@4").unwrap();
    assert_eq!(one.rasters.len(), 1);
    assert_eq!(numbers(&one.rasters[0].columns[0]), [31.0, 32.0]);
}

/// A megabyte of gzip, a variable of a MAT file or the rows that a Parquet file states may stand for any size: they are
/// refused above a stated bound, before that much is held.
#[test]
fn what_inflates_beyond_the_bound_is_refused() {
    use flate2::{Compression, write::GzEncoder};
    use std::io::Write;
    let tmp = tempfile::tempdir().unwrap();
    let path = tmp.path().join("bomb.csv.gz");
    let mut gz = GzEncoder::new(std::fs::File::create(&path).unwrap(), Compression::fast());
    gz.write_all(b"time [s],torque [Nm]\n").unwrap();
    let lines = "0,0\n".repeat(250_000);
    for _ in 0..1001 {
        gz.write_all(lines.as_bytes()).unwrap();
    }
    gz.finish().unwrap();
    assert!(std::fs::metadata(&path).unwrap().len() < 20_000_000);
    let error = csv_io::read(&path).unwrap_err().to_string();
    assert!(error.contains("bomb.csv.gz") && error.contains("at most 1000 MB"), "{error}");
}

/// A file of fewer rows than it states is not read as if it were whole without a word.
#[test]
fn lost_rows_of_mdf_are_told() {
    let tmp = tempfile::tempdir().unwrap();
    let path = tmp.path().join("short.mf4");
    let column = Column {
        name: "torque".into(),
        unit: Some(("Nm".into(), UnitSource::Bracket)),
        cells: Cells::Number((0..100).map(f64::from).collect()),
    };
    let time_s = (0..100).map(|t| 0.01 * f64::from(t)).collect();
    let raster = Raster { name: "fast".into(), time_s, columns: vec![column] };
    (by_ending(&path).and_then(|f| f.write).unwrap())(&path, &[raster]).unwrap();
    assert!(recording(opened(&path).as_ref()).is_ok());
    // The number of samples stands behind the head, six links and the record number of the channel group.
    let mut bytes = std::fs::read(&path).unwrap();
    let group = bytes.windows(4).position(|w| w == b"##CG").unwrap();
    let place = group + 24 + 6 * 8 + 8;
    assert_eq!(bytes[place..place + 8], 100u64.to_le_bytes());
    bytes[place..place + 8].copy_from_slice(&140u64.to_le_bytes());
    dynocal_files::atomic::write(&path, &bytes).unwrap();
    let source = opened(&path);
    let told = source.notes().join("; ");
    assert!(told.contains("states 140 samples and holds 100"), "{told}");
    assert_eq!(recording(source.as_ref()).unwrap().rasters[0].time_s.len(), 100);
}
