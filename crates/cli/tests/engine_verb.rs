//! `dynocal engine`.

use std::path::Path;

use assert_cmd::Command;

fn engine(folder: &Path, args: &[&str]) -> (i32, String, String) {
    let mut command = Command::cargo_bin("dynocal").unwrap();
    let out = command.current_dir(folder).arg("engine").args(args).output().unwrap();
    let text = |bytes| String::from_utf8(bytes).unwrap();
    (out.status.code().unwrap(), text(out.stdout), text(out.stderr))
}

/// The value of a quantity in the table of one point.
fn value(table: &str, name: &str) -> f64 {
    let line = table.lines().find(|l| l.split_whitespace().next() == Some(name)).unwrap();
    line.split_whitespace().nth(1).unwrap().parse().unwrap()
}

#[test]
fn a_point_at_a_torque_with_best_spark() {
    let tmp = tempfile::tempdir().unwrap();
    let args = ["point", "--torque-nm", "70", "--csv", "p.csv", "--report", "p.html"];
    let (code, stdout, stderr) = engine(tmp.path(), &args);
    assert_eq!(code, 0, "{stderr}");
    // Reference table: 18.95 deg, 16.754 mg.
    assert!((value(&stdout, "spark") - 18.95).abs() < 0.7 && (value(&stdout, "inj") - 16.754).abs() < 0.08);
    let table = dynocal_files::csv_io::read(&tmp.path().join("p.csv")).unwrap();
    assert!((table.numbers("torque", 0, 1).unwrap()[0] - 70.0).abs() < 0.05);
    let page = std::fs::read_to_string(tmp.path().join("p.html")).unwrap();
    assert!(page.contains("p-V diagram") && page.trim_end().ends_with("</html>"));
}

#[test]
fn a_sweep_of_spark_has_its_maximum_inside() {
    let tmp = tempfile::tempdir().unwrap();
    let args = ["sweep", "spark", "--from", "-5", "--to", "45", "--points", "6", "--csv", "s.csv"];
    let (code, stdout, stderr) = engine(tmp.path(), &args);
    assert_eq!(code, 0, "{stderr}");
    assert_eq!(stdout.lines().count(), 7, "{stdout}");
    let table = dynocal_files::csv_io::read(&tmp.path().join("s.csv")).unwrap();
    let torque = table.numbers("torque", 0, 6).unwrap();
    assert_eq!(table.numbers("spark", 0, 6).unwrap(), [-5.0, 5.0, 15.0, 25.0, 35.0, 45.0]);
    assert!(torque[2].min(torque[3]) > torque[1].max(torque[4]), "{torque:?}");
    assert!(torque[1] > torque[0] && torque[4] > torque[5], "{torque:?}");
}

#[test]
fn motored_needs_torque_and_faults_are_named() {
    let tmp = tempfile::tempdir().unwrap();
    let (code, stdout, _) = engine(tmp.path(), &["motored", "--speed-rpm", "2000"]);
    // Case 8 of the specification: -10.3 Nm, 19.2 bar.
    assert_eq!(code, 0);
    assert!((value(&stdout, "torque") + 10.3).abs() < 0.06 && (value(&stdout, "pmax") - 19.2).abs() < 0.06);
    let (code, _, stderr) = engine(tmp.path(), &["point", "--speed-rpm", "9000"]);
    assert!(code == 2 && stderr.contains("9000") && stderr.contains("6500"), "{stderr}");
    let (code, _, stderr) = engine(tmp.path(), &["point", "--torque-nm", "500"]);
    assert!(code == 2 && stderr.contains("500 Nm") && stderr.contains("the throttle is open"), "{stderr}");
    // What no engine burns is refused by its name, and a mixture richer than enrichment may make it is held.
    for lambda in ["0", "nan", "-1", "3"] {
        let (code, _, stderr) =
            engine(tmp.path(), &["point", "--torque-nm", "100", &format!("--lambda={lambda}")]);
        assert!(code == 2 && stderr.contains("lambda") && stderr.contains("0.5 to 2"), "{lambda}: {stderr}");
    }
    let (code, _, stderr) = engine(tmp.path(), &["point", "--torque-nm", "nan"]);
    assert!(code == 2 && stderr.contains("torque"), "{stderr}");
    let (code, stdout, stderr) =
        engine(tmp.path(), &["point", "--parameters", "gtdi_2l", "--torque-nm", "200", "--lambda", "0.7"]);
    assert!(code == 0 && (value(&stdout, "lambda") - 0.7).abs() < 0.01, "{stdout} {stderr}");
}

/// The spark of least fuel would knock: the point is held as a map holds it.
#[test]
fn a_point_that_knocks_has_a_later_spark() {
    let tmp = tempfile::tempdir().unwrap();
    let args = ["point", "--parameters", "twin_2l", "--speed-rpm", "1500", "--torque-nm", "130"];
    let (code, stdout, stderr) = engine(tmp.path(), &args);
    assert_eq!(code, 0, "{stderr}");
    assert!(value(&stdout, "knock") < 1.05 && value(&stdout, "ca50") > 10.0, "{stdout}");
}

#[test]
fn a_boosted_point_is_held_and_a_map_leaves_out_what_is_out_of_reach() {
    let tmp = tempfile::tempdir().unwrap();
    let (code, stdout, stderr) =
        engine(tmp.path(), &["point", "--parameters", "gtdi_2l", "--torque-nm", "200"]);
    assert_eq!(code, 0, "{stderr}");
    assert!((value(&stdout, "torque") - 200.0).abs() < 1.0, "{stdout}");
    // Above atmospheric pressure: the wastegate did it.
    assert!(value(&stdout, "map") > 101.0 && value(&stdout, "throttle") > 89.0, "{stdout}");
    let map = ["map", "--speed-rpm", "2000", "2000", "1", "--torque-nm", "60", "400", "2", "--csv", "m.csv"];
    let (code, _, stderr) = engine(tmp.path(), &map);
    assert_eq!(code, 1, "{stderr}");
    assert!(stderr.contains("2000 rpm, 400 Nm is out of reach"), "{stderr}");
    assert!(stderr.contains("the throttle is open"), "{stderr}");
    // Where the mixture cools the exhaust no further the load gives way, and that is said.
    let hot = ["map", "--speed-rpm", "2000", "2000", "1", "--torque-nm", "100", "100", "1"];
    let hot: Vec<&str> =
        hot.into_iter().chain(["--parameters", "gtdi_2l", "--max-egt-degc", "500"]).collect();
    let (code, _, stderr) = engine(tmp.path(), &hot);
    assert!(code == 1 && stderr.contains("100 Nm is out of reach"), "{stderr}");
    assert!(stderr.contains("the mixture stands at its richest"), "{stderr}");
    let (code, _, stderr) = engine(tmp.path(), &["map", "--max-map-kpa", "nan"]);
    assert!(code == 2 && stderr.contains("--max-map-kpa"), "{stderr}");
    let table = dynocal_files::csv_io::read(&tmp.path().join("m.csv")).unwrap();
    assert_eq!(table.rows(), 1);
    assert!((table.numbers("torque", 0, 1).unwrap()[0] - 60.0).abs() < 1.0);
}

/// The page of a map: contours over all points that were held, the line of full load where more was asked, nothing drawn
/// of what is the same everywhere; that of a sweep shows the sweep.
#[test]
fn pages_show_the_map_with_its_full_load_and_the_whole_sweep() {
    let tmp = tempfile::tempdir().unwrap();
    let map =
        ["map", "--speed-rpm", "2000", "4000", "2", "--torque-nm", "60", "180", "3", "--report", "m.html"];
    let (code, _, stderr) = engine(tmp.path(), &map);
    assert_eq!(code, 1, "{stderr}");
    let data = |file: &str| -> serde_json::Value {
        let page = std::fs::read_to_string(tmp.path().join(file)).unwrap();
        let from = page.find("id=\"data\">").unwrap() + 10;
        let end = page[from..].find("</script>").unwrap();
        serde_json::from_str(&page[from..from + end]).unwrap()
    };
    let plots = data("m.html");
    let maps: Vec<_> = plots.as_array().unwrap().iter().filter(|p| p["kind"] == "heat").collect();
    assert!(!maps.is_empty() && maps.iter().all(|m| m["contours"] == true));
    for m in &maps {
        let full = &m["overlays"][0];
        assert_eq!(full["label"], "full load");
        // 180 Nm are out of reach of this engine at both speeds; what was held is what the warnings say.
        for (k, speed) in [2000.0, 4000.0].into_iter().enumerate() {
            assert_eq!(full["x"][k].as_f64(), Some(speed));
            let held = full["y"][k].as_f64().unwrap();
            assert!(
                stderr.contains(&format!("{speed} rpm, 180 Nm is out of reach ({held:.1} Nm were held)"))
            );
        }
        // Of three rows the last is empty, and no map is the same everywhere.
        let z = m["zs"].as_array().unwrap();
        assert!(z[4].is_null() && z[5].is_null() && z[0] != z[1]);
    }
    let page = std::fs::read_to_string(tmp.path().join("m.html")).unwrap();
    assert!(page.contains("This engine has no model of: NO, Knock integral."), "zeros nobody computed");
    let hint = page.find("Drag over a plot").unwrap();
    assert!(hint < page.find("<section").unwrap(), "the hint stands before the plots");

    let sweep = ["sweep", "spark", "--from", "5", "--to", "35", "--points", "4", "--report", "s.html"];
    let (code, _, stderr) = engine(tmp.path(), &sweep);
    assert_eq!(code, 0, "{stderr}");
    let plots = data("s.html");
    let torque = plots.as_array().unwrap().iter().find(|p| p["y"]["label"] == "torque").unwrap();
    assert_eq!(torque["series"][0]["x"], serde_json::json!([5, 15, 25, 35]));
}

#[test]
fn a_cycle_is_driven_and_its_file_is_read_in_the_units_it_says() {
    let tmp = tempfile::tempdir().unwrap();
    let write = |name: &str, text: &str| {
        dynocal_files::atomic::write(&tmp.path().join(name), text.as_bytes()).unwrap()
    };
    write("short.csv", "time [s],speed [km/h]\n0,0\n2,0\n10,36\n16,36\n22,0\n24,0\n");
    let args = ["cycle", "short.csv", "--csv", "drive.csv", "--report", "drive.html"];
    let (code, stdout, stderr) = engine(tmp.path(), &args);
    assert_eq!(code, 0, "{stderr}");
    // The polygon's own distance: 40 + 60 + 30 m.
    let number = |name: &str| -> f64 {
        let line = stdout.lines().find(|l| l.starts_with(name)).unwrap();
        line[name.len()..].split_whitespace().next().unwrap().parse().unwrap()
    };
    assert!((number("distance") - 0.130).abs() < 0.004, "{stdout}");
    let table = dynocal_files::csv_io::read(&tmp.path().join("drive.csv")).unwrap();
    let fuel = table.numbers("fuel", 0, table.rows()).unwrap();
    // The table's fuel flow every 0.2 s sums up to the total within its sampling.
    let sum_g: f64 = fuel.iter().map(|kg_h| kg_h / 3.6 * 0.2).sum();
    assert!((sum_g / number("fuel  ") - 1.0).abs() < 0.03, "{sum_g}\n{stdout}");
    let page = std::fs::read_to_string(tmp.path().join("drive.html")).unwrap();
    assert!(page.contains("Where the engine runs") && page.trim_end().ends_with("</html>"));

    write("knots.csv", "time_s,speed [kn]\n0,0\n1,1\n");
    let (code, _, stderr) = engine(tmp.path(), &["cycle", "knots.csv"]);
    assert!(code == 2 && stderr.contains("speed is in kn") && stderr.contains("km/h"), "{stderr}");
    write("back.csv", "time_s,speed_mps\n0,0\n2,1\n1,1\n");
    let (code, _, stderr) = engine(tmp.path(), &["cycle", "back.csv"]);
    assert!(code == 2 && stderr.contains("back.csv: row 3"), "{stderr}");
}

#[test]
fn a_transient_from_a_file_on_a_bed() {
    let tmp = tempfile::tempdir().unwrap();
    let write = |name: &str, text: &str| {
        dynocal_files::atomic::write(&tmp.path().join(name), text.as_bytes()).unwrap()
    };
    write("u.csv", "time_s,throttle_deg,inj [mg]\n0,15.85,16.754\n0.5,20,20\n1.0,25,24\n");
    write(
        "bed.toml",
        "real = true\noutputs = [\"pmax\", \"throttle_angle\"]\n[[limits]]\nwhat = \"pmax\"\nmax = 36.0\n",
    );
    let args = [
        "transient",
        "u.csv",
        "--bed",
        "bed.toml",
        "--every-s",
        "0.02",
        "--csv",
        "y.csv",
        "--report",
        "y.html",
    ];
    let (code, stdout, stderr) = engine(tmp.path(), &args);
    assert_eq!(code, 0, "{stderr}");
    assert!(stdout.contains("throttle_angle") && stdout.contains("pmax"), "{stdout}");
    // 1.5 s in samples of 20 ms; the last row holds as long as the one before it.
    let table = dynocal_files::csv_io::read(&tmp.path().join("y.csv")).unwrap();
    assert_eq!(table.rows(), 75);
    let column = |name: &str| table.numbers(name, 0, 75).unwrap().to_vec();
    let (time, throttle, angle) = (column("time"), column("throttle"), column("throttle_angle"));
    assert!((time[74] - 1.5).abs() < 1e-9 && throttle[24] == 15.85 && throttle[25] == 20.0);
    // The actuator's lag of 50 ms, exact for a held command.
    let lag = 20.0 - (20.0 - 15.85) * (-0.02f64 / 0.05).exp();
    assert!((angle[25] - lag).abs() < 1e-9, "{} {lag}", angle[25]);
    assert!(column("torque")[74] > column("torque")[0] + 20.0);
    let page = std::fs::read_to_string(tmp.path().join("y.html")).unwrap();
    assert!(page.contains("throttle_angle") && page.trim_end().ends_with("</html>"));
    // The same again is the same file; by crank angle there is a row a cycle.
    let before = std::fs::read(tmp.path().join("y.csv")).unwrap();
    assert_eq!(engine(tmp.path(), &args).0, 0);
    assert_eq!(std::fs::read(tmp.path().join("y.csv")).unwrap(), before);
    let args = ["transient", "u.csv", "--every-deg", "720", "--csv", "c.csv"];
    assert_eq!(engine(tmp.path(), &args).0, 0);
    let table = dynocal_files::csv_io::read(&tmp.path().join("c.csv")).unwrap();
    assert_eq!(table.rows(), 25, "1.5 s at 2000 rpm are 25 cycles");
    // Faults name file, column, key.
    write("bad.csv", "time_s,gas\n0,1\n1,2\n");
    let (code, _, stderr) = engine(tmp.path(), &["transient", "bad.csv"]);
    assert!(code == 2 && stderr.contains("gas") && stderr.contains("throttle"), "{stderr}");
    write("bad.csv", "time_s,speed [rpm]\n0,2000\n1,9000\n");
    let (code, _, stderr) = engine(tmp.path(), &["transient", "bad.csv"]);
    assert!(code == 2 && stderr.contains("9000") && stderr.contains("speed"), "{stderr}");
    write("bad.csv", "time_s,inj [mg]\n0,900\n1,20\n");
    let (code, _, stderr) = engine(tmp.path(), &["transient", "bad.csv"]);
    assert!(code == 2 && stderr.contains("bad.csv: line 2: inj = 900 mg"), "{stderr}");
    write("bad.csv", "time_s,throttle [deg],throttle_deg\n0,16,20\n1,16,20\n");
    let (code, _, stderr) = engine(tmp.path(), &["transient", "bad.csv"]);
    assert!(code == 2 && stderr.contains("`throttle` and `throttle_deg` are both"), "{stderr}");
    write("bad.csv", "time_s,speed [rpm]\n0,2000\n1,9000\n");
    write("soft.toml", "saturate = true\n");
    let (code, stdout, _) = engine(tmp.path(), &["transient", "bad.csv", "--bed", "soft.toml"]);
    assert!(code == 0 && stdout.contains("speed saturated"), "{stdout}");
    write("odd.toml", "dynamometer.mode = \"sideways\"\n");
    let (code, _, stderr) = engine(tmp.path(), &["transient", "u.csv", "--bed", "odd.toml"]);
    assert!(code == 2 && stderr.contains("sideways"), "{stderr}");
}

#[test]
fn the_example_of_a_bed_runs() {
    let tmp = tempfile::tempdir().unwrap();
    let at = |name: &str| {
        let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../examples/testbed").join(name);
        path.to_str().unwrap().to_owned()
    };
    let (inputs, bed) = (at("inputs.csv"), at("bed.toml"));
    let (code, stdout, stderr) =
        engine(tmp.path(), &["transient", &inputs, "--bed", &bed, "--every-s", "0.05", "--csv", "y.csv"]);
    assert_eq!(code, 0, "{stderr}");
    assert!(stdout.contains("pmax"), "{stdout}");
    let table = dynocal_files::csv_io::read(&tmp.path().join("y.csv")).unwrap();
    let n = table.rows();
    let column = |name: &str| table.numbers(name, 0, n).unwrap().to_vec();
    let (speed, coolant, torque) = (column("engine_speed"), column("coolant"), column("torque"));
    assert!(speed.iter().all(|v| (600.0..=6500.0).contains(v)));
    assert!(coolant[n - 1] > coolant[0] + 1.0, "warms up");
    // Readings are multiples of the converter's step.
    assert!(torque.iter().all(|t| ((t / 0.1).round() - t / 0.1).abs() < 1e-6));
}

/// A settled point says by which inputs it is held, and they hold it; a spark that is given is kept where boost is needed.
#[test]
fn a_point_can_be_held_again_by_its_inputs() {
    let tmp = tempfile::tempdir().unwrap();
    let boosted = ["point", "--parameters", "gtdi_2l", "--torque-nm", "220"];
    let (code, stdout, stderr) = engine(tmp.path(), &boosted);
    assert_eq!(code, 0, "{stderr}");
    let again = stdout.lines().find_map(|l| l.split_once("dynocal engine ")).expect("the command").1;
    let args: Vec<&str> = again.split_whitespace().collect();
    assert!(args.contains(&"--wastegate-mm") && args.contains(&"--intake-cam-deg"), "{again}");
    let (code, held, stderr) = engine(tmp.path(), &args);
    assert_eq!(code, 0, "{stderr}");
    for (name, most) in [("torque", 0.2), ("map", 0.2), ("lambda", 0.001), ("egt", 1.0)] {
        assert!((value(&held, name) - value(&stdout, name)).abs() <= most, "{name}: {stdout} {held}");
    }
    let spark = ["--spark-deg", "2"];
    let (code, stdout, stderr) = engine(tmp.path(), &[&boosted[..], &spark[..]].concat());
    assert_eq!(code, 0, "{stderr}");
    assert!(value(&stdout, "spark") == 2.0 && (value(&stdout, "torque") - 220.0).abs() < 1.0, "{stdout}");
    assert!(value(&stdout, "boost") > 110.0, "{stdout}");
}

/// What an engine does not have is no zero, cannot be moved, limited or recorded.
#[test]
fn what_an_engine_lacks_is_absent() {
    let tmp = tempfile::tempdir().unwrap();
    let (code, stdout, _) = engine(tmp.path(), &["point", "--torque-nm", "40"]);
    let shown = |name: &str| {
        let line = stdout.lines().find(|l| l.split_whitespace().next() == Some(name)).unwrap();
        line.split_whitespace().nth(1).unwrap().to_owned()
    };
    assert_eq!(code, 0);
    for name in ["knock", "no", "co", "hc", "turbo", "wastegate", "egr"] {
        assert_eq!(shown(name), "-", "{name}");
    }
    for (option, lacked) in [("--wastegate-mm", "turbocharger"), ("--egr-mm", "recirculation")] {
        let (code, _, stderr) = engine(tmp.path(), &["point", option, "3"]);
        assert!(code == 2 && stderr.contains(lacked), "{stderr}");
    }
    let sweep = ["sweep", "wastegate", "--from", "0", "--to", "9", "--parameters", "pfi_1_6l"];
    let (code, _, stderr) = engine(tmp.path(), &sweep);
    assert!(code == 2 && stderr.contains("turbocharger"), "{stderr}");
    let write = |name: &str, text: &str| {
        dynocal_files::atomic::write(&tmp.path().join(name), text.as_bytes()).unwrap()
    };
    write("u.csv", "time_s,throttle_deg\n0,16\n1,16\n");
    for (bed, key) in
        [("[[limits]]\nwhat = \"knock\"\nmax = 1.0\n", "bed.limits"), ("outputs = [\"no\"]\n", "bed.outputs")]
    {
        write("bed.toml", bed);
        let (code, _, stderr) = engine(tmp.path(), &["transient", "u.csv", "--bed", "bed.toml"]);
        assert!(code == 2 && stderr.contains(key) && stderr.contains("`thesis` has no"), "{stderr}");
        let known = ["transient", "u.csv", "--bed", "bed.toml", "--parameters", "gtdi_2l"];
        let (code, _, stderr) = engine(tmp.path(), &known);
        assert_eq!(code, 0, "{stderr}");
    }
}

/// What nothing computes or moves, and what stands there twice, is refused with its key.
#[test]
fn beds_that_promise_what_is_not_there_are_refused() {
    let tmp = tempfile::tempdir().unwrap();
    let write = |name: &str, text: &str| {
        dynocal_files::atomic::write(&tmp.path().join(name), text.as_bytes()).unwrap()
    };
    write("u.csv", "time_s,throttle_deg\n0,16\n1,16\n");
    let limit = |what: &str, action: &str| {
        format!("[[limits]]\nwhat = \"{what}\"\nmax = 2000.0\naction = \"{action}\"\n")
    };
    for (bed, part) in [
        ("outputs = [\"conversion\"]\n".to_owned(), "`engine.catalyst`"),
        (limit("oil", "report"), "`engine.warm_up`"),
        (limit("coolant", "report"), "`engine.warm_up`"),
        (limit("pmax", "open_wastegate"), "turbocharger"),
        ("outputs = [\"pmax\", \"pmax\"]\n".to_owned(), "every name once"),
        ("inputs = [\"wiebe_m\", \"wiebe_m\"]\n".to_owned(), "every name once"),
    ] {
        write("bed.toml", &bed);
        let (code, _, stderr) = engine(tmp.path(), &["transient", "u.csv", "--bed", "bed.toml"]);
        assert!(code == 2 && stderr.contains(part), "{bed}: {stderr}");
    }
    // A temperature that stands still can be read, and what is always there may be named.
    write("bed.toml", "outputs = [\"coolant\", \"map\"]\n");
    let (code, _, stderr) = engine(tmp.path(), &["transient", "u.csv", "--bed", "bed.toml"]);
    assert_eq!(code, 0, "{stderr}");
}

/// A cut that lasts is shown with its length: the throttle stays where the limit is passed as soon as fuel is back.
#[test]
fn a_trip_is_shown_until_it_ends() {
    let tmp = tempfile::tempdir().unwrap();
    let write = |name: &str, text: &str| {
        dynocal_files::atomic::write(&tmp.path().join(name), text.as_bytes()).unwrap()
    };
    // Intake pressure does not fall without fuel: this trip ends with the throttle.
    write("u.csv", "time_s,throttle_deg\n0,16\n1,40\n6,10\n8,10\n");
    write("bed.toml", "[[limits]]\nwhat = \"map\"\nmax = 70.0\naction = \"retard_spark\"\n");
    let (code, stdout, stderr) = engine(tmp.path(), &["transient", "u.csv", "--bed", "bed.toml"]);
    assert_eq!(code, 0, "{stderr}");
    let line = stdout.lines().find(|l| l.contains("map trip")).unwrap();
    let numbers: Vec<f64> = line.split_whitespace().filter_map(|w| w.parse().ok()).collect();
    assert!(numbers[0] < 2.0 && numbers[1] > 6.4 && numbers[1] < 7.5 && numbers[2] == 1.0, "{line}");
}

/// No power, no consumption per power; torques below zero can be asked of a map, and not of full load.
#[test]
fn consumption_of_no_power_is_no_number() {
    let tmp = tempfile::tempdir().unwrap();
    let (code, stdout, stderr) = engine(tmp.path(), &["point", "--torque-nm", "0"]);
    let bsfc = stdout.lines().find(|l| l.starts_with("bsfc")).unwrap();
    assert!(code == 0 && bsfc.split_whitespace().nth(1) == Some("-"), "{stdout} {stderr}");
    let args = ["map", "--speed-rpm", "2000", "2000", "1", "--torque-nm", "-5", "40", "2", "--csv", "m.csv"];
    let (code, _, stderr) = engine(tmp.path(), &args);
    assert_eq!(code, 0, "{stderr}");
    let table = std::fs::read_to_string(tmp.path().join("m.csv")).unwrap();
    let mut lines = table.lines();
    let column = lines.next().unwrap().split(',').position(|c| c.starts_with("bsfc")).unwrap();
    let bsfc: Vec<f64> =
        lines.map(|l| l.split(',').nth(column).unwrap().parse().unwrap_or(f64::NAN)).collect();
    assert!(bsfc[0].is_nan() && bsfc[1] > 200.0 && bsfc[1] < 1000.0, "{bsfc:?}");
    let (code, _, stderr) = engine(tmp.path(), &["full-load", "--torque-nm", "-50"]);
    assert!(code == 2 && stderr.contains("-50") && stderr.contains("more than 0 Nm"), "{stderr}");
}

/// A point that a map would not hold says so.
#[test]
fn a_point_past_a_limit_says_so() {
    let tmp = tempfile::tempdir().unwrap();
    let at = |args: &[&str]| {
        let (code, stdout, stderr) =
            engine(tmp.path(), &[&["point", "--parameters", "gtdi_2l"], args].concat());
        assert_eq!(code, 0, "{stderr}");
        (stdout, stderr)
    };
    let (stdout, stderr) = at(&["--speed-rpm", "6400", "--torque-nm", "140"]);
    assert!(value(&stdout, "egt") > 949.85 && stderr.contains("exhaust temperature"), "{stdout} {stderr}");
    let (_, stderr) = at(&["--torque-nm", "250", "--spark-deg", "25"]);
    assert!(stderr.contains("warning") && stderr.contains("knock 2"), "{stderr}");
    let (_, stderr) = at(&["--torque-nm", "60"]);
    assert!(!stderr.contains("warning"), "{stderr}");
}
