//! Every export is read by a reader that nobody here wrote.

#![allow(clippy::disallowed_methods)] // files of tests are written as they are

mod common;

use common::{cdf_schema, python, run, save};
use dynocal_export::evaluate::Machine;
use dynocal_export::format::read;
use dynocal_export::package::Package;
use dynocal_export::program::Shape;

/// The package as the checks in Python compare with.
fn expected(package: &Package, folder: &std::path::Path) -> std::path::PathBuf {
    save(package, "json", folder);
    folder.join(format!("{}.json", package.name))
}

/// Inputs and outputs of the evaluator as text, one sample a line.
fn record(package: &Package, samples: usize, folder: &std::path::Path) -> std::path::PathBuf {
    let p = package.program.as_ref().unwrap();
    let mut machine = Machine::<f64>::new(package).unwrap();
    let mut text = String::new();
    for t in 0..samples {
        let time = t as f64 * p.sample_time_s;
        let wave = |(k, i): (usize, &dynocal_export::program::Input)| {
            i.start + 0.2 * i.start.abs().max(1.0) * (1.3 * time + k as f64).sin()
        };
        let u: Vec<f64> = p.inputs.iter().enumerate().map(wave).collect();
        let y = machine.step(&u);
        let row: Vec<String> = u.iter().chain(&y).map(|x| format!("{x:?}")).collect();
        text.push_str(&format!("{}\n", row.join(" ")));
    }
    let path = folder.join(format!("{}_record.txt", package.name));
    std::fs::write(&path, text).unwrap();
    path
}

#[test]
fn dcm_by_dcm_reader() {
    let Some(python) = python(&["dcmReader"]) else { return };
    let tmp = tempfile::tempdir().unwrap();
    let package = common::maps();
    run(&python, "check_dcm.py", &[&save(&package, "dcm", tmp.path()), &expected(&package, tmp.path())]);
}

#[test]
fn cdfx_by_the_schema_of_asam() {
    let (Some(python), Some(schema)) = (python(&["lxml"]), cdf_schema()) else { return };
    let tmp = tempfile::tempdir().unwrap();
    let package = common::maps();
    run(
        &python,
        "check_cdfx.py",
        &[&save(&package, "cdfx", tmp.path()), &expected(&package, tmp.path()), &schema],
    );
}

/// Files of other writers than ours: all categories of the schema, their encodings and namespaces. What comes in is compared
/// value by value, what does not is named.
#[test]
fn cdfx_of_other_tools() {
    let (Some(python), Some(schema)) = (python(&["lxml"]), cdf_schema()) else { return };
    let tmp = tempfile::tempdir().unwrap();
    run(&python, "make_cdfx.py", &[tmp.path(), &schema]);
    let common = ["Scalar", "Block", "Curve", "Map"];
    let more = [
        "Fixed",
        "NoCategory",
        "Depends",
        "Struct.gain",
        "Struct.inner.list",
        "Array[0]",
        "Array[1]",
        "History",
    ];
    let words = "it holds words";
    let left = [
        ("Text", words),
        ("Flag", words),
        ("State", words),
        ("States", words),
        ("Rescale", "rescale and curve axes are not read"),
        ("OnRescale", "rescale and curve axes are not read"),
        ("Variants", "it has variants, of which none is chosen"),
    ];
    let cases =
        [("latin.cdfx", true), ("utf16.cdfx", true), ("labelled.cdfx", false), ("namespace.cdfx", false)];
    for (name, all) in cases {
        let bytes = std::fs::read(tmp.path().join(name)).unwrap();
        let package = read(name, &bytes).unwrap_or_else(|e| panic!("{name}: {e}"));
        let names: Vec<&str> = package.characteristics.iter().map(|c| c.name.as_str()).collect();
        let wanted: Vec<&str> = common.into_iter().chain(more.into_iter().filter(|_| all)).collect();
        assert_eq!(names, wanted, "{name}");
        let said: Vec<String> = left.iter().filter(|_| all).map(|(n, why)| format!("`{n}`: {why}")).collect();
        assert_eq!(package.left_out, said, "{name}");
        let get = |n: &str| package.characteristics.iter().find(|c| c.name == n).unwrap();
        let (scalar, curve, map) = (get("Scalar"), get("Curve"), get("Map"));
        assert_eq!(
            (scalar.values.as_slice(), scalar.unit.as_str()),
            ([-1.5e-3].as_slice(), "\u{b0}KW"),
            "{name}"
        );
        assert_eq!(get("Block").values, [1.0, 2.0, 3.0, 4.0], "{name}");
        assert_eq!(
            (curve.axes[0].points.as_slice(), curve.axes[0].unit.as_str()),
            ([-40.0, 20.0, 90.0].as_slice(), "\u{b0}C")
        );
        assert_eq!(map.values, [1.0, 2.0, 3.0, 4.0, 5.0, 6.0], "{name}");
        let axis = |k: usize| (map.axes[k].points.clone(), map.axes[k].unit.as_str(), map.axes[k].shared);
        assert_eq!(axis(0), (vec![800.0, 1600.0, 3200.0], "1/min", true), "{name}");
        // The unit of the second stands where it is used.
        assert_eq!(axis(1), (vec![0.2, 0.9], "g/s", true), "{name}");
        assert_eq!(curve.description, "about Curve", "{name}");
        if all {
            assert_eq!((get("Struct.gain").values[0], get("Array[1]").values[0]), (2.5, 11.0), "{name}");
            assert_eq!(get("Struct.inner.list").values, [7.0, 8.0], "{name}");
            assert_eq!(get("NoCategory").axes[0].points, [800.0, 1600.0, 3200.0], "{name}");
        }
    }
    // A size that is not that of the values.
    let text = std::fs::read_to_string(tmp.path().join("labelled.cdfx")).unwrap();
    let fault = read("x.cdfx", text.replace("<V>4</V>", "<V>5</V>").as_bytes()).unwrap_err().to_string();
    assert!(fault.contains("`Block`") && fault.contains("expected 5 as SW-ARRAYSIZE says"), "{fault}");
}

#[test]
fn a2l_by_pya2ldb_and_a2lfile() {
    let tmp = tempfile::tempdir().unwrap();
    let package = common::dynamic_map();
    let path = save(&package, "a2l", tmp.path());
    let (file, log) = a2lfile::load(&path, None, true).unwrap();
    assert!(log.is_empty(), "{log:?}");
    let faults = file.check();
    assert!(faults.is_empty(), "{faults:?}");
    let entries = dynocal_export::format::a2l::read("x.a2l", &std::fs::read(&path).unwrap()).unwrap();
    let map = entries.iter().find(|e| e.name == "INJ_MAP").unwrap();
    assert_eq!((map.kind.as_str(), map.unit.as_str(), map.axes[0].points), ("MAP", "mg", 3));
    let Some(python) = python(&["pya2l"]) else { return };
    run(&python, "check_a2l.py", &[&path, &expected(&package, tmp.path())]);
}

#[test]
fn mat_by_scipy() {
    let Some(python) = python(&["scipy"]) else { return };
    let tmp = tempfile::tempdir().unwrap();
    let package = common::maps();
    run(&python, "check_mat.py", &[&save(&package, "mat", tmp.path()), &expected(&package, tmp.path())]);
}

#[test]
fn python_file_runs() {
    let Some(python) = python(&["numpy"]) else { return };
    for package in [
        common::dynamic_map(),
        common::network(Shape::Tanh),
        common::network(Shape::Softplus),
        common::network(Shape::Matern52),
    ] {
        let tmp = tempfile::tempdir().unwrap();
        let path = save(&package, "python", tmp.path());
        run(
            &python,
            "check_python.py",
            &[&path, &record(&package, 2000, tmp.path()), std::path::Path::new(&package.name)],
        );
    }
}

#[test]
fn onnx_by_onnxruntime() {
    let Some(python) = python(&["onnx", "onnxruntime"]) else { return };
    for shape in common::ACTIVATIONS {
        let package = common::network(shape);
        let tmp = tempfile::tempdir().unwrap();
        save(&package, "onnx", tmp.path());
        let record = record(&package, 300, tmp.path());
        run(&python, "check_onnx.py", &[tmp.path(), &record, &expected(&package, tmp.path())]);
    }
}

#[test]
fn fmu_by_fmpy() {
    let Some(python) = python(&["fmpy"]) else { return };
    for (package, format) in [
        (common::dynamic_map(), "fmu2"),
        (common::dynamic_map(), "fmu3"),
        (common::network(Shape::Tanh), "fmu2"),
        (common::network(Shape::Tanh), "fmu3"),
    ] {
        let tmp = tempfile::tempdir().unwrap();
        let path = save(&package, format, tmp.path());
        run(
            &python,
            "check_fmu.py",
            &[&path, &record(&package, 1000, tmp.path()), &expected(&package, tmp.path())],
        );
    }
}

#[test]
fn planted_faults_of_an_fmu() {
    let Some(python) = python(&["fmpy"]) else { return };
    let tmp = tempfile::tempdir().unwrap();
    run(&python, "check_planted_fmu.py", &[&save(&common::dynamic_map(), "fmu2", tmp.path())]);
}
