//! The engine as an FMU in FMPy: valid, equal to the program, its state saved and restored. (The FMU of a map drives it in the tests
//! of the program.)

#![allow(clippy::disallowed_methods)] // files of tests are written as they are

use std::fmt::Write;
use std::path::{Path, PathBuf};
use std::process::Command;

use dynocal_engine_fmu::description::{IDENTIFIER, xml};
use dynocal_engine_fmu::engine::{Engine, Setup};
use dynocal_export::format::fmu::{Version, archive, binary_path};
use dynocal_ident::plant::{Causality, Plant};
use dynocal_plant::plants::{PlantSpec, find};

const DT_S: f64 = 0.03;
const SAMPLES: usize = 2000;

fn python() -> Option<PathBuf> {
    let target = std::env::var_os("CARGO_TARGET_DIR")
        .map_or_else(|| Path::new(env!("CARGO_MANIFEST_DIR")).join("../../target"), PathBuf::from);
    let python = std::env::var_os("DYNOCAL_READERS_PYTHON")
        .map_or_else(|| target.join("readers/bin/python"), PathBuf::from);
    let there = Command::new(&python).args(["-c", "import fmpy"]).output().is_ok_and(|o| o.status.success());
    if !there {
        println!("SKIPPED READER: no Python with fmpy (run scripts/readers.sh)");
    }
    there.then_some(python)
}

/// The engine's FMU around the library that cargo built for this test.
fn engine_fmu(folder: &Path, version: Version) -> PathBuf {
    let spec = PlantSpec::default();
    let engine = Engine::new(Setup::new(spec.clone()).unwrap()).unwrap();
    let name = format!("{}dynocal_engine_fmu{}", std::env::consts::DLL_PREFIX, std::env::consts::DLL_SUFFIX);
    let library = std::env::current_exe().unwrap().with_file_name(name);
    let number = if version == Version::Two { 2 } else { 3 };
    let files = vec![
        ("modelDescription.xml".to_string(), xml(&engine, number, "a test", DT_S).into_bytes()),
        (binary_path(IDENTIFIER, version), std::fs::read(&library).unwrap()),
        ("resources/plant.toml".into(), toml::to_string(&spec).unwrap().into_bytes()),
    ];
    let path = folder.join(format!("engine_{number}.fmu"));
    std::fs::write(&path, archive(&files).unwrap()).unwrap();
    path
}

fn plant() -> Box<dyn Plant> {
    let spec = PlantSpec::default();
    let mut plant = (find(&spec.name).unwrap().make.unwrap())(&spec, true).unwrap();
    plant.reset(0);
    plant
}

/// Inputs about their start, in a range that the engine takes.
fn inputs(plant: &dyn Plant, t: usize) -> Vec<f64> {
    let time = t as f64 * DT_S;
    let of = plant.variables().iter().filter(|v| v.causality == Causality::Input);
    of.enumerate()
        .map(|(k, v)| (v.start * (1.0 + 0.05 * (0.9 * time + k as f64).sin())).clamp(v.min, v.max))
        .collect()
}

fn save(folder: &Path, name: &str, rows: &[Vec<f64>]) -> PathBuf {
    let mut text = String::new();
    for row in rows {
        let cells: Vec<String> = row.iter().map(|x| format!("{x:?}")).collect();
        writeln!(text, "{}", cells.join(" ")).unwrap();
    }
    let path = folder.join(name);
    std::fs::write(&path, text).unwrap();
    path
}

fn run(python: &Path, script: &str, arguments: &[&Path]) {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/readers").join(script);
    let out = Command::new("timeout").arg("600").arg(python).arg(path).args(arguments).output().unwrap();
    let text = String::from_utf8_lossy(&out.stdout).into_owned();
    assert!(out.status.success(), "{script}: {text}{}", String::from_utf8_lossy(&out.stderr));
    print!("{text}");
}

#[test]
fn sixty_seconds_equal_the_program() {
    let Some(python) = python() else { return };
    let tmp = tempfile::tempdir().unwrap();
    let mut plant = plant();
    let outputs = plant.variables().iter().filter(|v| v.causality == Causality::Output).count();
    let mut y = vec![0.0; outputs];
    let rows: Vec<Vec<f64>> = (0..SAMPLES)
        .map(|t| {
            let mut u = inputs(plant.as_ref(), t);
            plant.step(&u, DT_S, &mut y).unwrap();
            u.extend_from_slice(&y);
            u
        })
        .collect();
    let record = save(tmp.path(), "record.txt", &rows);
    for version in [Version::Two, Version::Three] {
        run(&python, "check_engine.py", &[&engine_fmu(tmp.path(), version), &record]);
    }
}
