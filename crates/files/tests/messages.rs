//! Every bad input has a message that names file, place, what was found and what was expected.

use std::path::{Path, PathBuf};

use dynocal_files::dataset::{ChannelSpec, Layout, Missing, STAMPS, Select, Time, datasets, read_table};
use dynocal_files::run_folder::{RunFolder, RunPlace};
use dynocal_files::table::{Cells, Table};
use dynocal_files::{FilesError, atomic, csv_io, json, spec};
use dynocal_ident::data::Role;

fn channel(column: &str, unit: Option<&str>, role: Role) -> ChannelSpec {
    ChannelSpec {
        column: column.into(),
        name: column.into(),
        unit: unit.map(Into::into),
        convert: false,
        role,
    }
}

fn layout(time: Time) -> Layout {
    Layout {
        channels: vec![channel("inj", Some("mg"), Role::Input), channel("torque", Some("Nm"), Role::Output)],
        time,
        trajectory: None,
        cut: None,
        init_samples: 0,
        missing: Missing::Refuse,
    }
}

fn sampled() -> Time {
    Time::Sampled { sample_time_s: 0.03 }
}

fn stamps() -> Time {
    Time::Column { column: "time".into(), unit: None }
}

fn message(csv: &str, time: Time) -> String {
    let table = csv_io::parse("bed.csv", csv.as_bytes()).unwrap();
    datasets(&table, &layout(time), &Select::All).unwrap_err().to_string()
}

#[test]
fn missing_file() {
    let e = read_table(Path::new("/nowhere/bed.csv"), None).unwrap_err().to_string();
    assert_eq!(e, "cannot read /nowhere/bed.csv: no such file or folder");
}

#[test]
fn empty_files() {
    let tmp = tempfile::tempdir().unwrap();
    for name in ["a.csv", "a.parquet"] {
        let path = tmp.path().join(name);
        std::fs::File::create(&path).unwrap();
        let e = read_table(&path, None).unwrap_err();
        assert!(matches!(e, FilesError::Empty { .. }), "{e}");
    }
    let e = csv_io::parse("a.csv", b"inj [mg],torque [Nm]\n").unwrap_err().to_string();
    assert_eq!(
        e,
        "a.csv, line 1: found the header (inj, torque) and no row of data below it, expected at least one"
    );
}

#[test]
fn what_is_no_text_is_no_table() {
    let refused = |bytes: &[u8]| csv_io::parse("a.csv", bytes).unwrap_err().to_string();
    let picture = refused(b"\x89PNG\r\n\x1a\n\0\0\0\rIHDR\n1,2\n3,4\n");
    assert_eq!(picture, "a.csv: found a PNG picture, expected a table in text (CSV)");
    assert!(refused(b"PK\x03\x04 sheet").contains("save it as CSV"));
    let dump: Vec<u8> = (0..2000u32).map(|k| (k * 7 % 31) as u8).collect();
    assert!(refused(&dump).contains("which no text has"), "{}", refused(&dump));
    // One odd byte in a word is no picture.
    let odd = b"u [mg],state\n1,on\x02\n3,off\n5,on\n";
    assert_eq!(csv_io::parse("a.csv", odd).unwrap().rows(), 3);
}

/// A table with more columns than anybody measures is refused before it is read, in time that grows with its length alone.
#[test]
fn a_hundred_thousand_columns_are_refused() {
    let names: Vec<String> = (0..100_000).map(|k| format!("c{k}")).collect();
    let text = format!("{}\n{}\n", names.join(","), vec!["1"; names.len()].join(","));
    let e = csv_io::parse("a.csv", text.as_bytes()).unwrap_err().to_string();
    assert!(e.contains("a.csv") && e.contains("found 100000 columns, expected at most 20000"), "{e}");
    let few = format!("{}\n{1}\n{1}\n", names[..20_000].join(","), vec!["1.5"; 20_000].join(","));
    assert_eq!(csv_io::parse("a.csv", few.as_bytes()).unwrap().columns.len(), 20_000);
}

#[test]
fn wrong_unit() {
    let e = message("inj [ms],torque [Nm]\n1,2\n", sampled());
    assert_eq!(e, "bed.csv, column `inj`: found unit `ms`, expected `mg`: time cannot become mass");
    let e = message("inj [g],torque [Nm]\n1,2\n", sampled());
    assert!(e.ends_with("(`convert = true` for this channel converts it)"), "{e}");
}

#[test]
fn no_unit_anywhere() {
    let table = csv_io::parse("bed.csv", b"inj,torque\n1,2\n").unwrap();
    let mut l = layout(sampled());
    l.channels[0].unit = None;
    let e = datasets(&table, &l, &Select::All).unwrap_err().to_string();
    assert!(e.starts_with("bed.csv, column `inj`: no unit in the header and none given"), "{e}");
}

#[test]
fn channel_not_found() {
    let e = message("inj [mg],torqe [Nm],speed [rpm]\n1,2,3\n", sampled());
    assert_eq!(e, "bed.csv: no column `torque` (did you mean `torqe`?); columns are: inj, torqe, speed");
}

#[test]
fn cell_that_is_no_finite_number() {
    let e = message("inj [mg],torque [Nm]\n1,2\n3,nan\n", sampled());
    assert_eq!(e, "bed.csv, line 3, column `torque`: found `NaN or an empty cell`, expected a finite number");
    let e = message("inj [mg],torque [Nm]\n1,2\n\"3\",4\nbad,5\n", sampled());
    assert_eq!(e, "bed.csv, line 4, column `inj`: found `bad`, expected a finite number");
    let e = message("inj [mg],torque [Nm]\n1,2\n3,-inf\n", sampled());
    assert_eq!(e, "bed.csv, line 3, column `torque`: found `-inf`, expected a finite number");
    // Beyond the largest double: not the infinity that a reader makes of it.
    let e = message("inj [mg],torque [Nm]\n1,2\n3,1e400\n", sampled());
    assert_eq!(e, "bed.csv, line 3, column `torque`: found `1e400`, expected a finite number");
}

#[test]
fn ragged_row_and_doubled_name() {
    let e = csv_io::parse("bed.csv", b"a,b\n1,2\n3\n").unwrap_err().to_string();
    assert_eq!(e, "bed.csv, line 3: found 1 cells, expected 2 as in the header");
    let e = csv_io::parse("bed.csv", b"a,b,a\n1,2,3\n").unwrap_err().to_string();
    assert_eq!(e, "bed.csv: the header names column `a` twice");
}

#[test]
fn time_stamps() {
    let e =
        message("time [s],inj [mg],torque [Nm]\n0,1,1\n0.03,1,1\n0.06,1,1\n0.10,1,1\n0.13,1,1\n", stamps());
    assert!(
        e.starts_with("bed.csv, line 5, time column `time`: interval 0.04")
            && e.contains("expected 0.03 s: time stamps must be uniform"),
        "{e}"
    );
    let e = message("time [s],inj [mg],torque [Nm]\n0,1,1\n0.03,1,1\n0.03,1,1\n0.06,1,1\n", stamps());
    assert_eq!(e, "bed.csv, line 4, time column `time`: time stamp 0.03 s is repeated");
    let e = message("time [mg],inj [mg],torque [Nm]\n0,1,1\n1,1,1\n", stamps());
    assert_eq!(e, "bed.csv, column `time`: found unit `mg`, expected `s` (or ms, min, h)");
}

#[test]
fn empty_cells_are_missing_samples_only_where_asked() {
    let text = "inj [mg],torque [Nm]\n1,2\n,3\n2,NA\n3,nan\n";
    let table = csv_io::parse("bed.csv", text.as_bytes()).unwrap();
    let e = datasets(&table, &layout(sampled()), &Select::All).unwrap_err().to_string();
    assert!(e.contains("bed.csv, line 3, column `inj`"), "{e}");
    let marked = Layout { missing: Missing::Mark, ..layout(sampled()) };
    let d = datasets(&table, &marked, &Select::All).unwrap();
    let missing =
        |name: &str| -> Vec<bool> { d[0].values(name).unwrap().iter().map(|v| v.is_nan()).collect() };
    assert_eq!(missing("inj"), [false, true, false, false]);
    assert_eq!(missing("torque"), [false, false, true, true]);
    // What is neither a number nor a word for "missing" stays a fault, and so does an infinite value.
    for (cell, line) in [("broken", 2), ("inf", 2)] {
        let text = format!("inj [mg],torque [Nm]\n{cell},2\n1,3\n");
        let table = csv_io::parse("bed.csv", text.as_bytes()).unwrap();
        let e = datasets(&table, &marked, &Select::All).unwrap_err().to_string();
        assert_eq!(
            e,
            format!("bed.csv, line {line}, column `inj`: found `{cell}`, expected a finite number")
        );
    }
    // Decimal commas survive in a column with words.
    let table = csv_io::parse("bed.csv", b"inj [mg];torque [Nm]\n1,5;2\nNA;3\n2,5;4\n").unwrap();
    let d = datasets(&table, &marked, &Select::All).unwrap();
    let inj = d[0].values("inj").unwrap();
    assert!(inj[0] == 1.5 && inj[1].is_nan() && inj[2] == 2.5, "{inj:?}");
}

#[test]
fn irregular_stamps_are_kept_as_a_channel_where_asked() {
    let irregular = Time::Stamps { column: "time".into(), unit: None };
    let text = "time [ms],inj [mg],torque [Nm]\n0,1,1\n30,1,1\n70,1,1\n100,1,1\n130,1,1\n";
    let table = csv_io::parse("bed.csv", text.as_bytes()).unwrap();
    let d = datasets(&table, &layout(irregular.clone()), &Select::All).unwrap();
    assert!(d[0].sample_time_s.is_nan());
    assert_eq!(d[0].values(STAMPS).unwrap(), [0.0, 0.03, 0.07, 0.1, 0.13]);
    assert_eq!(d[0].channel(STAMPS).unwrap().role, Role::Auxiliary);
    let e = message("time [s],inj [mg],torque [Nm]\n0,1,1\n2,1,1\n1,1,1\n", irregular);
    assert_eq!(
        e,
        "bed.csv, line 4, time column `time`: time stamp 1 s after 2 s, expected stamps that increase"
    );
}

#[test]
fn time_stamps_in_other_units_and_of_few_digits_are_read() {
    let table = csv_io::parse("t", b"time [ms],inj [mg],torque [Nm]\n0,1,1\n30,1,1\n60,1,1\n").unwrap();
    let d = datasets(&table, &layout(stamps()), &Select::All).unwrap();
    assert_eq!(d[0].sample_time_s, 0.03);
}

#[test]
fn split_selections() {
    let csv = "inj [mg],torque [Nm],run,part\n1,1,7,a\n2,2,7,a\n3,3,8,a\n4,4,8,b\n5,5,9,b\n";
    let table = csv_io::parse("bed.csv", csv.as_bytes()).unwrap();
    let mut l = layout(sampled());
    l.trajectory = Some("run".into());
    let by = |v: &str| Select::Values { column: "part".into(), values: vec![v.into()] };
    let a = datasets(&table, &l, &by("a")).unwrap();
    assert_eq!(a.iter().map(|d| d.name.as_str()).collect::<Vec<_>>(), ["run-7", "run-8"]);
    assert_eq!(a[1].values("inj").unwrap(), [3.0]);
    let e = datasets(&table, &l, &by("c")).unwrap_err().to_string();
    assert_eq!(e, "bed.csv: no row has `part` = `c`; values are: a, b");
    let e = datasets(&table, &l, &Select::Rows(vec![(0, 9)])).unwrap_err().to_string();
    assert_eq!(e, "bed.csv: rows 0..9 asked for, expected a range within 0..5 (zero-based, end excluded)");
    let e = datasets(&table, &l, &Select::Rows(vec![(1, 4)])).unwrap();
    assert_eq!(e.iter().map(|d| d.len()).collect::<Vec<_>>(), [1, 2]);
}

#[test]
fn semicolon_decimal_comma_bom_and_quotes() {
    let t = csv_io::parse("x", "\u{feff}\"inj [mg]\";torque_nm\r\n1,5;-2,25\r\n".as_bytes()).unwrap();
    assert_eq!(t.numbers("inj", 0, 1).unwrap(), [1.5]);
    assert_eq!(t.numbers("torque_nm", 0, 1).unwrap(), [-2.25]);
    assert_eq!(t.column("torque_nm").unwrap().unit.as_ref().unwrap().0, "Nm");
}

#[test]
fn unwritable_places() {
    let tmp = tempfile::tempdir().unwrap();
    let file = tmp.path().join("plain");
    atomic::write(&file, b"x").unwrap();
    let below = file.join("out/model.json");
    let e = atomic::write(&below, b"y").unwrap_err().to_string();
    assert_eq!(e, format!("cannot write {}: a part of the path is a file, not a folder", below.display()));
    assert_eq!(std::fs::read(&file).unwrap(), b"x");
}

#[cfg(target_os = "linux")]
#[test]
fn disk_full() {
    let e = atomic::write(Path::new("/dev/full"), &[0; 4096]).unwrap_err().to_string();
    assert_eq!(e, "cannot write /dev/full: the disk is full");
}

#[test]
fn a_failed_write_leaves_the_old_file_and_nothing_else() {
    let tmp = tempfile::tempdir().unwrap();
    let path = tmp.path().join("model.json");
    atomic::write(&path, b"old").unwrap();
    let e = atomic::write_with(&path, |w| {
        w.write_all(b"half")?;
        Err(std::io::Error::from(std::io::ErrorKind::StorageFull))
    });
    assert!(e.unwrap_err().to_string().ends_with("the disk is full"));
    assert_eq!(std::fs::read(&path).unwrap(), b"old");
    assert_eq!(std::fs::read_dir(tmp.path()).unwrap().count(), 1);
}

#[test]
fn numbers_survive_csv_to_the_last_bit() {
    let values: Vec<f64> =
        vec![0.1, 1.0 / 3.0, 6.02214076e23, -4.9e-324, f64::MAX, 1e-7, 123456.789, -0.0, 2.0_f64.sqrt()];
    let tmp = tempfile::tempdir().unwrap();
    let path = tmp.path().join("x.csv");
    csv_io::write_columns(&path, &[("a, b", "-", &values)]).unwrap();
    let table = csv_io::read(&path).unwrap();
    let Cells::Number(back) = &table.column("a, b").unwrap().cells else { panic!("text") };
    assert!(values.iter().zip(back).all(|(a, b)| a.to_bits() == b.to_bits()));
    let bits = |v: &[f64]| v.iter().map(|x| x.to_bits()).collect::<Vec<_>>();
    let path = tmp.path().join("x.json");
    json::write(&path, &values).unwrap();
    assert_eq!(bits(&json::read::<Vec<f64>>(&path).unwrap()), bits(&values));
}

#[test]
fn foreign_folder_is_left_alone() {
    let tmp = tempfile::tempdir().unwrap();
    atomic::write(&tmp.path().join("thesis.txt"), b"mine").unwrap();
    let e = RunFolder::open(tmp.path(), "identify", &1).unwrap_err().to_string();
    assert!(e.contains("is not empty") && e.contains("thesis.txt"), "{e}");
    let other = tmp.path().join("other");
    RunFolder::open(&other, "calibrate", &1).unwrap();
    let e = RunFolder::open(&other, "identify", &1).unwrap_err().to_string();
    assert!(e.contains("a run of `dynocal calibrate`"), "{e}");
}

#[test]
fn steps_run_again_exactly_when_inputs_or_files_change() {
    let tmp = tempfile::tempdir().unwrap();
    let go = |gain: f64| {
        let mut run = RunFolder::open(tmp.path(), "test", &gain).unwrap();
        let a = run
            .step("a", &gain, |dir| {
                atomic::write(&dir.join("x.txt"), format!("{gain}").as_bytes())?;
                Ok::<f64, FilesError>(gain * 0.1)
            })
            .unwrap();
        let b = run.step("b", &a.digest, |_| Ok::<f64, FilesError>(a.result + 1.0)).unwrap();
        assert_eq!(b.result, gain * 0.1 + 1.0);
        (a.resumed, b.resumed)
    };
    assert_eq!(go(0.3), (false, false));
    assert_eq!(go(0.3), (true, true));
    assert_eq!(go(0.4), (false, false));
    atomic::write(&tmp.path().join("steps/01-a/x.txt"), b"tampered").unwrap();
    assert_eq!(go(0.4), (false, true));
}

#[test]
fn digest_is_fnv1a() {
    // Published test vectors of 128-bit FNV-1a.
    assert_eq!(dynocal_files::run_folder::digest(b""), "6c62272e07bb014262b821756295c58d");
    assert_eq!(dynocal_files::run_folder::digest(b"a"), "d228cb696f1a8caf78912b704e4a8964");
    assert_eq!(dynocal_files::run_folder::digest(b"foobar"), "343e1662793c64bf6f0d3597ba446f18");
}

#[derive(serde::Deserialize)]
#[serde(deny_unknown_fields)]
struct Typed {
    gain: Option<f64>,
    channels: Option<Vec<TypedChannel>>,
    #[serde(default)]
    split: TypedSplit,
}

#[derive(serde::Deserialize)]
#[serde(deny_unknown_fields)]
struct TypedChannel {
    name: Option<String>,
}

#[derive(Default, serde::Deserialize)]
#[serde(deny_unknown_fields, default)]
struct TypedSplit {
    column: String,
}

#[test]
fn all_faults_of_a_spec_at_once() {
    let text = "gain = \"high\"\n\n[split]\ncolum = \"part\"\n\n[[channels]]\nname = \"a\"\n\n[[channels]]\nunit = \"mg\"\n";
    let e = spec::parse("s.toml", text, |t: &Typed, f| {
        f.required("gain", &t.gain, "gain, mg");
        f.required("length_s", &None::<f64>, "length, s");
        assert!(t.split.column.is_empty());
        for (k, c) in t.channels.iter().flatten().enumerate() {
            f.required(&format!("channels[{}].name", k + 1), &c.name, "name");
        }
        Some(())
    })
    .unwrap_err();
    let lines: Vec<String> = e.to_string().lines().map(str::to_string).collect();
    assert_eq!(lines[0], "s.toml has 5 faults");
    assert_eq!(lines[1], "  s.toml:1: `gain`: found the text \"high\", expected a number");
    assert_eq!(
        lines[2],
        "  s.toml:4: `split.colum`: found an unknown key, expected one of column (did you mean `column`?)"
    );
    assert!(lines[3].starts_with("  s.toml:9: `channels[2].name`: found nothing"), "{lines:?}");
    assert!(lines[4].starts_with("  s.toml:10: `channels[2].unit`: found an unknown key"), "{lines:?}");
    assert_eq!(lines[5], "  s.toml: `length_s`: found nothing, expected length, s");
}

#[test]
fn broken_toml_names_the_line() {
    let e = spec::parse("s.toml", "gain = 1\nsplit = [\n", |_: &Typed, _| Some(())).unwrap_err().to_string();
    assert!(e.contains("s.toml:") && e.contains("expected valid TOML"), "{e}");
}

fn reference(path: &str) -> Option<PathBuf> {
    let folder = std::env::var_os("DYNOCAL_REFERENCE_DIR");
    if folder.is_none() {
        println!("SKIPPED: DYNOCAL_REFERENCE_DIR is not set");
    }
    Some(PathBuf::from(folder?).join(path))
}

#[test]
fn real_engine_record_in_parquet() {
    let Some(path) = reference("data/engine/bosch_gengine1.parquet") else { return };
    let table: Table = read_table(&path, None).unwrap();
    // Counts stated by the source of the record.
    assert_eq!(table.rows(), 384_173);
    let l = Layout {
        channels: vec![
            channel("speed", Some("-"), Role::Input),
            channel("T_exhaust_manifold", Some("-"), Role::Output),
        ],
        time: Time::Sampled { sample_time_s: 0.1 },
        trajectory: Some("traj".into()),
        cut: None,
        init_samples: 5,
        missing: Missing::Refuse,
    };
    let by = |v: &str| Select::Values { column: "split".into(), values: vec![v.into()] };
    let (train, test) =
        (datasets(&table, &l, &by("train")).unwrap(), datasets(&table, &l, &by("test")).unwrap());
    assert_eq!((train.len(), test.len()), (20, 12));
    assert_eq!(train.iter().map(|d| d.len()).sum::<usize>(), 247_844);
    assert_eq!(test.iter().map(|d| d.len()).sum::<usize>(), 136_329);
    // Standard deviation of the test part as stated there.
    let y: Vec<f64> = test.iter().flat_map(|d| d.values("T_exhaust_manifold").unwrap().to_vec()).collect();
    let mean = y.iter().sum::<f64>() / y.len() as f64;
    let std = (y.iter().map(|v| (v - mean).powi(2)).sum::<f64>() / y.len() as f64).sqrt();
    assert!((std - 0.968).abs() < 1e-3, "{std}");
}

#[test]
fn parquet_round_trip_and_broken_bytes() {
    use dynocal_ident::data::{Channel, Dataset};
    let tmp = tempfile::tempdir().unwrap();
    let data = Dataset {
        name: "x".into(),
        sample_time_s: 0.03,
        channels: vec![Channel {
            name: "inj".into(),
            unit: "mg".into(),
            role: Role::Input,
            values: vec![0.1, 1.0 / 3.0, -7e-300],
        }],
        init_samples: 0,
        origin: String::new(),
    };
    let path = tmp.path().join("x.parquet");
    dynocal_files::parquet_io::write_dataset(&path, &data).unwrap();
    let back = dynocal_files::dataset::read_dataset(&path, &["inj"], &[]).unwrap();
    assert_eq!(back.channels, data.channels);
    assert_eq!(back.sample_time_s, 0.03);
    atomic::write(&path, b"PAR1 and then rubbish").unwrap();
    let e = read_table(&path, None).unwrap_err().to_string();
    assert!(e.contains("x.parquet: not a valid Parquet file"), "{e}");
}

/// Work that fails, or is killed, leaves what an earlier run found, with the spec that it found it for.
#[test]
fn an_earlier_result_stays_until_there_is_another() {
    let tmp = tempfile::tempdir().unwrap();
    let go = |gain: f64, fails: bool| {
        let mut run = RunFolder::open(tmp.path(), "test", &gain).unwrap();
        let work = |(), dir: &Path| {
            atomic::write(&dir.join("x.txt"), format!("{gain}").as_bytes())?;
            if fails { Err(FilesError::Busy { path: "x".into() }) } else { Ok(gain) }
        };
        run.step_after("a", &gain, || Ok(()), work).map(|d| d.resumed)
    };
    let step = tmp.path().join("steps/01-a");
    let found = || {
        (
            std::fs::read_to_string(step.join("x.txt")).unwrap(),
            json::read::<f64>(&tmp.path().join("spec.json")).unwrap(),
        )
    };
    assert!(!go(1.0, false).unwrap());
    assert!(go(2.0, true).is_err());
    assert_eq!(found(), ("1".into(), 1.0));
    assert!(go(1.0, false).unwrap(), "the earlier result is still one");
    // Killed half-way: the earlier result waits beside an unfinished one.
    std::fs::rename(&step, tmp.path().join("steps/.01-a.earlier")).unwrap();
    std::fs::create_dir(&step).unwrap();
    assert!(go(1.0, false).unwrap());
    assert!(!go(2.0, false).unwrap());
    assert_eq!(found(), ("2".into(), 2.0));
    assert_eq!(std::fs::read_dir(tmp.path().join("steps")).unwrap().count(), 1);
}

/// Two specs of one name do not share the folder that has it; a folder that somebody names is theirs to share.
#[test]
fn specs_of_one_name_have_folders_of_their_own() {
    let tmp = tempfile::tempdir().unwrap();
    let spec = |folder: &str| {
        let path = tmp.path().join(folder).join("bed.toml");
        std::fs::create_dir_all(path.parent().unwrap()).unwrap();
        atomic::write(&path, b"x = 1").unwrap();
        path
    };
    let (a, b) = (spec("a"), spec("b"));
    let out = tmp.path().join("runs/bed");
    let open =
        |from: &Path| RunFolder::open_at(&RunPlace::named_after(out.clone(), from), "test", &1).map(drop);
    open(&a).unwrap();
    open(&a).unwrap();
    let e = open(&b).unwrap_err().to_string();
    assert!(e.contains("holds the run of another spec of that name") && e.contains("a/bed.toml"), "{e}");
    RunFolder::open(&out, "test", &1).unwrap();
    // One that is no longer there has moved.
    open(&a).unwrap();
    std::fs::remove_file(&a).unwrap();
    open(&b).unwrap();
}

/// A result that was edited by hand is not taken for what the step found.
#[test]
fn an_edited_result_is_computed_again() {
    let tmp = tempfile::tempdir().unwrap();
    let go = || {
        let mut run = RunFolder::open(tmp.path(), "test", &1).unwrap();
        run.step("a", &1, |_| Ok::<f64, FilesError>(0.125)).unwrap()
    };
    assert_eq!((go().resumed, go().resumed), (false, true));
    let path = tmp.path().join("steps/01-a/step.json");
    let text = std::fs::read_to_string(&path).unwrap();
    assert!(text.contains("0.125"));
    atomic::write(&path, text.replace("0.125", "0.25").as_bytes()).unwrap();
    let again = go();
    assert_eq!((again.result, again.resumed), (0.125, false));
}

/// Stamps are no names: the first sample is not taken for a header.
#[test]
fn a_row_of_stamps_is_no_header() {
    let tmp = tempfile::tempdir().unwrap();
    for (first, second) in [
        ("2026-01-01T10:00:00.000Z", "2026-01-01T10:00:00.100Z"),
        ("10:00:00", "10:00:01"),
        ("01.02.2026", "02.02.2026"),
    ] {
        let path = tmp.path().join("bare.csv");
        atomic::write(&path, format!("{first},5,On\n{second},6,On\n{second},7,Off\n").as_bytes()).unwrap();
        let e = csv_io::read(&path).unwrap_err().to_string();
        assert!(e.contains("bare.csv, line 1") && e.contains(&format!("({first}, 5, On)")), "{e}");
    }
    let path = tmp.path().join("named.csv");
    atomic::write(&path, b"time,u1.5,p 2,T-3-4\n10:00:00,5,6,7\n10:00:01,6,7,8\n").unwrap();
    assert_eq!(csv_io::read(&path).unwrap().rows(), 2);
}
