//! The day: files, journals, run folders.

use dynocal_calib::steady::grid::CellState;
use dynocal_files::run_folder::RunFolder;
use dynocal_jobs::export::{self, ExportSpec};
use dynocal_jobs::map::{MapError, Mapped, job, store, work};
use dynocal_jobs::place::Overrides;
use dynocal_numerics::watch::Watch;

use super::engine::{Bench, DAY, Fault, best, fuel, run_with, text};

/// What a bed writes for a plan: the engine in closed form at every row, its loops holding torque.
fn played(plan: &str, skip: usize, begin_s: usize) -> String {
    let mut lines = plan.lines();
    let head = lines.next().unwrap();
    assert_eq!(head, "point,purpose,torque [Nm],speed [rpm],spark [-],cam [-]");
    let mut out = String::from(
        "point,time [s],load [kg/h],spark [-],cam [-],speed [rpm],torque [Nm],knock [-],heat [K],fuel [kg/h]\n",
    );
    for (row, line) in lines.enumerate().skip(skip) {
        let cells: Vec<&str> = line.split(',').collect();
        let [torque, speed, spark, cam] = [2, 3, 4, 5].map(|k: usize| cells[k].parse::<f64>().unwrap());
        let load = fuel(torque, speed, spark, cam, 0.0);
        let knock = 0.2 + 0.006 * torque + 0.6 * spark;
        let heat = 500.0 + 3.0 * torque - 100.0 * spark + 150.0 * cam;
        let time = begin_s + 20 * row;
        out += &format!("{},{time},{load},{spark},{cam},{speed},{torque},{knock},{heat},{load}\n", cells[0]);
    }
    out
}

fn write(path: &std::path::Path, text: String) {
    dynocal_files::atomic::write(path, text.as_bytes()).unwrap();
}

/// A bed that is driven through files alone: the plan, batches that follow the optimum, the verification; every call goes on.
#[test]
fn a_bed_measures_the_day_from_files() {
    let tmp = tempfile::tempdir().unwrap();
    let out = tmp.path().join("run");
    let over = Overrides { seed: Some(1), out: Some(out.clone()) };
    let spec = format!("{}[plant]\nname = \"bed\"\n", text(&format!("{DAY}[bed.sweep]\npass_s = 20.0\n")));
    let job = job::parse("map.toml", &spec, &over).unwrap();
    let mut asked = Vec::new();
    let found = loop {
        match dynocal_jobs::map::run(&job, Watch::silent()) {
            Ok((found, _)) => break found,
            Err(MapError::NeedsMeasurement { plan, measured, channels, .. }) => {
                assert!(asked.len() < 12 && channels.contains("heat [K]"), "{asked:?} {channels}");
                let plan = std::fs::read_to_string(&plan).unwrap();
                // The bed could not measure the first point of the first plan.
                let skip = usize::from(asked.is_empty());
                write(std::path::Path::new(&measured), played(&plan, skip, 2000 * asked.len()));
                asked.push(
                    std::path::Path::new(&measured).file_stem().unwrap().to_string_lossy().into_owned(),
                );
            }
            Err(e) => panic!("{e}"),
        }
    };
    assert!(asked.len() > 2 && asked[0] == "points01" && asked[asked.len() - 1] == "verify", "{asked:?}");
    assert!(found.valid, "{} {:?}", found.verdict, found.warnings);
    assert_eq!(found.points.iter().filter(|p| !p.point.usable).count(), 1);
    // Lines of the maps were asked for, and files cannot go along them.
    let said = found.warnings.iter().any(|w| w.contains("`bed.sweep` was asked for") && w.contains("`load`"));
    assert!(found.sweeps.is_none() && said, "{:?}", found.warnings);
    for c in found.cells.iter().filter(|c| c.state == CellState::Optimal) {
        let (least, ..) = best(c.at[0], c.at[1], 0.0);
        let got = fuel(c.at[0], c.at[1], c.optimum.x[2], c.optimum.x[3], 0.0);
        assert!(got <= 1.01 * least, "{:?}: {got} against {least}", c.at);
    }
    // Records that do not fit are refused with what is wrong.
    let first = out.join("measured/points01.csv");
    let good = std::fs::read_to_string(&first).unwrap();
    let wrong = |text: String| {
        write(&first, text);
        dynocal_jobs::map::run(&job, Watch::silent()).map(|_| ()).unwrap_err().to_string()
    };
    let e = wrong(good.replacen("\n2,", "\n99,", 1));
    assert!(e.contains("points01.csv, line 2") && e.contains("99"), "{e}");
    // What can be said without running the day, `--check` says.
    let e = work::given(&job).unwrap_err().to_string();
    assert!(e.contains("points01.csv, line 2") && e.contains("99"), "{e}");
    let with = |column: &str, value: &'static str| {
        let k = good.lines().next().unwrap().split(',').position(|h| h == column).unwrap();
        let row = move |(row, line): (usize, &str)| {
            let mut cells: Vec<&str> = line.split(',').collect();
            if row == 3 {
                cells[k] = value;
            }
            cells.join(",")
        };
        good.lines().enumerate().map(row).collect::<Vec<_>>().join("\n")
    };
    let e = wrong(with("heat [K]", "6e300"));
    assert!(e.contains("points01.csv, line 4, column `heat`: found 6e300"), "{e}");
    // What no loop of the spec sets, no demand comes near to, and no sensor reads: points that cannot be used.
    let all = good.lines().count() - 1;
    for (column, value) in [
        ("load [kg/h]", "400"),
        ("torque [Nm]", "-9999"),
        ("speed [rpm]", "0"),
        ("heat [K]", "-999"),
        ("heat [K]", "NaN"),
    ] {
        write(&first, with(column, value));
        let given = &work::given(&job).unwrap()[0];
        assert_eq!((given.points, given.usable), (all, all - 1), "{column} {value}");
    }
    write(&first, good.clone());
    let given = work::given(&job).unwrap();
    assert_eq!(given.len(), asked.len(), "{given:?}");
    assert!(given.iter().all(|g| g.usable == g.points), "{given:?}");
    let twice = out.join("measured/points01.txt");
    write(&twice, good.clone());
    let e = work::given(&job).unwrap_err().to_string();
    assert!(e.contains("are all called like the plan `points01`"), "{e}");
    std::fs::remove_file(&twice).unwrap();
    let e = wrong(good.replacen("heat [K]", "heat [degC]", 1).replacen("knock", "nock", 1));
    assert!(e.contains("knock"), "{e}");
    // Another unit of time is another unit: 20 min apart, and the next file begins before this one ends.
    let e = wrong(good.replacen("time [s]", "time [min]", 1));
    assert!(e.contains("points02.csv") && e.contains("go on from file to file"), "{e}");
    // Spark that was never set as asked: the record of another plan, or a scale.
    let halved = |line: &str| -> String {
        let cells: Vec<&str> = line.split(',').collect();
        let spark: f64 = cells[3].parse().unwrap_or(f64::NAN);
        if spark.is_finite() {
            line.replacen(cells[3], &(0.5 * spark).to_string(), 1)
        } else {
            line.to_string()
        }
    };
    let e = wrong(good.lines().map(halved).collect::<Vec<_>>().join("\n"));
    assert!(e.contains("set elsewhere than planned") && e.contains("`spark`"), "{e}");
    // A verification that stood still verifies nothing.
    write(&first, good.clone());
    let verify = out.join("measured/verify.csv");
    let rows = std::fs::read_to_string(&verify).unwrap();
    let kept: Vec<&str> = rows.lines().nth(1).unwrap().splitn(3, ',').collect();
    let still = |(k, line): (usize, &str)| match k {
        0 => line.to_string(),
        _ => format!("{},{},{}", line.split(',').next().unwrap(), line.split(',').nth(1).unwrap(), kept[2]),
    };
    write(&verify, rows.lines().enumerate().map(still).collect::<Vec<_>>().join("\n"));
    let e = dynocal_jobs::map::run(&job, Watch::silent()).map(|_| ()).unwrap_err().to_string();
    assert!(e.contains("verify.csv") && e.contains("set elsewhere than planned"), "{e}");
    let two_rows: Vec<&str> = good.lines().take(3).collect();
    let e = wrong(two_rows.join("\n").replace("point,", "number,"));
    assert!(e.contains("2 rows, expected"), "{e}");
}

#[test]
fn equal_seeds_give_equal_days_and_other_seeds_other_ones() {
    let day = |seed| {
        serde_json::to_string(&run_with(DAY, seed, Bench::new(1.0, Fault::None)).unwrap().points).unwrap()
    };
    let one = day(5);
    assert_eq!(one, day(5));
    assert_ne!(one, day(6));
}

/// Ctrl-C after a dozen points, then the same again: the day is the one that was never interrupted.
#[test]
fn an_interrupted_day_goes_on_where_it_stopped() {
    let read = |seed| job::parse("map.toml", &text(DAY), &Overrides { seed: Some(seed), out: None }).unwrap();
    let said = |m: &Mapped| serde_json::to_string(&(&m.points, &m.cells, &m.verified)).unwrap();
    let bench = || Bench::new(0.0, Fault::None);
    let whole = said(&work::run_on(&read(1), &mut bench(), Watch::silent()).unwrap());
    let tmp = tempfile::tempdir().unwrap();
    let file = tmp.path().join("day.jsonl");
    let lines = || std::fs::read_to_string(&file).map_or(0, |t| t.lines().count());
    let stop = || lines() > 12;
    let early = Watch { interrupt: &stop, ..Watch::silent() };
    let e = work::run_on_in(&read(1), &mut bench(), Some(tmp.path()), early).unwrap_err();
    assert!(matches!(e, MapError::Interrupted), "{e}");
    assert_eq!(lines(), 13, "a head and twelve points");
    let go_on = |seed| {
        let notes = std::sync::Mutex::new(Vec::new());
        let note = |n: &str| notes.lock().unwrap().push(n.to_string());
        let watch = Watch { note: &note, ..Watch::silent() };
        let found = work::run_on_in(&read(seed), &mut bench(), Some(tmp.path()), watch).unwrap();
        (said(&found), notes.into_inner().unwrap().join("\n"))
    };
    let (found, notes) = go_on(1);
    assert!(notes.contains("12 points are those of the earlier run"), "{notes}");
    assert!(found == whole, "the same day");
    // A line that was cut off is measured again.
    let text = std::fs::read_to_string(&file).unwrap();
    let points = text.lines().count() - 1;
    write(&file, text[..text.len() - 30].to_string());
    let (found, notes) = go_on(1);
    assert!(notes.contains(&format!("{} points are those", points - 1)) && found == whole, "{notes}");
    // Nothing of another seed is taken, and nothing of it is lost.
    let aside = tmp.path().join("day-1.jsonl");
    assert!(!aside.exists(), "a broken line is no point");
    let (text, points) = (std::fs::read_to_string(&file).unwrap(), lines() - 1);
    let (found, notes) = go_on(2);
    assert!(!notes.contains("earlier run") && found != whole, "{notes}");
    assert!(notes.contains(&format!("{points} points and lines of an earlier day")), "{notes}");
    assert_eq!(std::fs::read_to_string(&aside).unwrap(), text);
    // Its own seed takes it up again; what cannot be read as text is kept as well.
    let (found, notes) = go_on(1);
    assert!(found == whole && !notes.contains("not taken over"), "{notes}");
    // Another choice of points with the same seed, interrupted, goes on with its own points, though a longer day stands aside.
    write(&file, text.clone());
    let other = job::parse(
        "map.toml",
        &self::text(&DAY.replace("block = 10", "block = 9")),
        &Overrides { seed: Some(1), out: None },
    );
    let (other, stop) = (other.unwrap(), || lines() > 20 && tmp.path().join("day-2.jsonl").exists());
    let early = Watch { interrupt: &stop, ..Watch::silent() };
    assert!(work::run_on_in(&other, &mut bench(), Some(tmp.path()), early).is_err());
    let (measured, notes) = (lines() - 1, std::sync::Mutex::new(Vec::new()));
    let note = |n: &str| notes.lock().unwrap().push(n.to_string());
    work::run_on_in(&other, &mut bench(), Some(tmp.path()), Watch { note: &note, ..Watch::silent() })
        .unwrap();
    let notes = notes.into_inner().unwrap().join("\n");
    assert!(notes.contains(&format!("{measured} points are those of the earlier run")), "{measured} {notes}");
    std::fs::remove_file(tmp.path().join("day-2.jsonl")).unwrap();
    let mut bytes = text.into_bytes();
    let middle = (bytes.len() / 2..).find(|k| bytes[*k].is_ascii_digit()).unwrap();
    bytes[middle] = 0xff;
    std::fs::remove_file(&aside).unwrap();
    dynocal_files::atomic::write(&file, &bytes).unwrap();
    let (found, notes) = go_on(1);
    assert!(found == whole && notes.contains("behind a line that cannot be read"), "{notes}");
    assert_eq!(std::fs::read(&aside).unwrap(), bytes);
}

/// Ctrl-C among the lines, wherever: the day with its lines, whose rests count, is the one that was never interrupted.
#[test]
fn an_interrupted_day_goes_on_within_its_lines() {
    let text = text(&format!("{DAY}[bed.sweep]\npass_s = 4.0\nrest_s = 4.0\n"));
    let read = job::parse("map.toml", &text, &Overrides { seed: Some(1), out: None }).unwrap();
    let said =
        |m: &Mapped| serde_json::to_string(&(&m.points, &m.sweeps, &m.cells, &m.verified, &m.bed)).unwrap();
    let bench = || Bench::new(0.0, Fault::None);
    let lines = |folder: &std::path::Path| {
        std::fs::read_to_string(folder.join("day.jsonl")).map_or(0, |t| t.lines().count())
    };
    let first = tempfile::tempdir().unwrap();
    let found = work::run_on_in(&read, &mut bench(), Some(first.path()), Watch::silent()).unwrap();
    let (whole, all, verified) = (said(&found), lines(first.path()), found.verified.len());
    let swept = found.sweeps.unwrap().planned;
    // Of a head, points, lines and verification points: among the lines that come first, at the end of them all, in the verification.
    for stop_after in [all - verified - swept, all - verified - 2, all - 1] {
        let tmp = tempfile::tempdir().unwrap();
        let stop = || lines(tmp.path()) >= stop_after;
        let early = Watch { interrupt: &stop, ..Watch::silent() };
        let e = work::run_on_in(&read, &mut bench(), Some(tmp.path()), early).unwrap_err();
        assert!(matches!(e, MapError::Interrupted), "{e}");
        assert!(lines(tmp.path()) < all, "{stop_after} of {all}");
        let found = work::run_on_in(&read, &mut bench(), Some(tmp.path()), Watch::silent()).unwrap();
        assert!(said(&found) == whole, "stopped after {stop_after} of {all} lines of the record");
    }
}

/// A bed on which every setting gives the same point: copies are no knowledge.
#[test]
fn points_that_are_all_the_same_are_refused_with_their_numbers() {
    let tmp = tempfile::tempdir().unwrap();
    let over = Overrides { seed: Some(1), out: Some(tmp.path().join("run")) };
    let job = job::parse("map.toml", &format!("{}[plant]\nname = \"bed\"\n", text(DAY)), &over).unwrap();
    let Err(MapError::NeedsMeasurement { plan, measured, .. }) =
        dynocal_jobs::map::run(&job, Watch::silent())
    else {
        panic!("a bed has to measure first")
    };
    let good = played(&std::fs::read_to_string(plan).unwrap(), 0, 0);
    // A record under another name is said to be there.
    let other = std::path::Path::new(&measured).with_file_name("Points1.csv");
    write(&other, good.clone());
    let e = dynocal_jobs::map::run(&job, Watch::silent()).map(|_| ()).unwrap_err().to_string();
    assert!(e.contains("wait to be measured") && e.contains("like no plan: `Points1.csv`"), "{e}");
    let first: Vec<&str> = good.lines().nth(1).unwrap().splitn(3, ',').collect();
    let copy = |(k, line): (usize, &str)| match k {
        0 => line.to_string(),
        _ => format!("{k},{},{}", line.split(',').nth(1).unwrap(), first[2]),
    };
    write(std::path::Path::new(&measured), good.lines().enumerate().map(copy).collect::<Vec<_>>().join("\n"));
    let e = dynocal_jobs::map::run(&job, Watch::silent()).map(|_| ()).unwrap_err().to_string();
    assert!(e.contains("points01.csv") && e.contains("set elsewhere than planned"), "{e}");
}

#[test]
fn the_run_folder_holds_maps_that_leave_in_the_formats_of_ecus() {
    let tmp = tempfile::tempdir().unwrap();
    let out = tmp.path().join("run");
    let overrides = Overrides { seed: Some(1), out: Some(out.clone()) };
    let job = job::parse("map.toml", &text(DAY), &overrides).unwrap();
    let found = work::run_on(&job, &mut Bench::new(0.5, Fault::None), Watch::silent()).unwrap();
    let folder = RunFolder::open(&job.out, dynocal_jobs::map::KIND, &job.spec).unwrap();
    let found = store::write(&folder, &job, found).unwrap();
    assert!(found.files.iter().all(|f| out.join(f).is_file()), "{:?}", found.files);
    let page = std::fs::read_to_string(out.join("report.html")).unwrap();
    assert!(page.contains("keep limits and promise"));
    for (format, ending) in [("dcm", "dcm"), ("cdfx", "cdfx"), ("c", "c"), ("csv", "csv")] {
        let to = tmp.path().join(format);
        let spec = ExportSpec { to: vec![format.into()], ..ExportSpec::default() };
        let exported = export::run(&out, &to, &spec).unwrap();
        assert!(
            exported.files.iter().any(|f| f.extension().is_some_and(|e| e == ending)),
            "{format}: {:?}",
            exported.files
        );
    }
    // Maps of another spec do not outlive it, whatever becomes of its day.
    let other = tmp.path().join("other");
    let copy = Overrides { seed: Some(1), out: Some(other.clone()) };
    let (first, stalls) =
        (job::parse("map.toml", &text(DAY), &copy).unwrap(), Overrides { seed: Some(2), ..copy });
    let folder = RunFolder::open(&first.out, dynocal_jobs::map::KIND, &first.spec).unwrap();
    let found = store::write(&folder, &first, found).unwrap();
    drop(folder);
    let second = job::parse("map.toml", &text(DAY), &stalls).unwrap();
    assert!(dynocal_jobs::map::run(&second, Watch::silent()).is_err());
    assert!(!other.join("summary.json").exists() && !other.join("steps/01-map/static_map.json").exists());
    let (maps, _) = export::characteristics(&out).unwrap();
    let spark = maps.iter().find(|m| m.name == "SPARK_MAP").unwrap();
    let expected: Vec<f64> = found.cells.iter().map(|c| c.optimum.x[2].clamp(0.0, 1.0)).collect();
    assert_eq!(spark.values.len(), 9);
    // Cells lie with the speed fast, and so does the map of the export.
    assert!(
        spark.values.iter().zip(&expected).all(|(a, b)| (a - b).abs() < 1e-9),
        "{:?} {expected:?}",
        spark.values
    );
}
