//! An FMU that others wrote, as a plant: the closed form of its answer, states, refusals.

#![allow(clippy::disallowed_methods)] // broken files are written as they are

mod common;

use std::path::Path;

use common::made;
use dynocal_fmu::{FmuPlant, FmuSettings};
use dynocal_ident::plant::Plant;
use dynocal_numerics::interval::Interval;

#[test]
fn answers_as_its_closed_form_says() {
    let tmp = tempfile::tempdir().unwrap();
    let Some(paths) = made(tmp.path()) else { return };
    let settings = FmuSettings {
        parameters: [("tau".into(), 0.2)].into(),
        ranges: [("speed".into(), Interval::new(800.0, 5000.0))].into(),
    };
    for path in paths {
        let mut plant = FmuPlant::open(&path, &settings).unwrap();
        let names: Vec<&str> = plant.variables().iter().map(|v| v.name.as_str()).collect();
        assert_eq!(names, ["speed", "torque", "inj"]);
        // The map at 2000 rpm and 100 Nm, where the unit starts.
        assert!((plant.variables()[2].start - 21.25).abs() < 1e-6, "{:?}", plant.variables()[2]);
        assert_eq!((plant.variables()[0].min, plant.variables()[2].unit.as_str()), (800.0, "mg"));
        let (dt, mut y) = (0.02, [0.0]);
        let go = |plant: &mut FmuPlant, u: [f64; 2], n: usize, y: &mut [f64; 1]| {
            (0..n).for_each(|_| plant.step(&u, dt, y).unwrap());
        };
        plant.reset(0);
        go(&mut plant, [1000.0, 50.0], 200, &mut y);
        assert!((y[0] - 12.5).abs() < 1e-7, "{}", y[0]);
        let from = y[0];
        go(&mut plant, [4000.0, 150.0], 10, &mut y);
        let want = 33.0 + (from - 33.0) * (-0.2f64 / 0.2).exp();
        assert!((y[0] - want).abs() < 1e-9, "{} {want}", y[0]);
        // A saved state continues to the last bit, although this unit cannot serialise its own.
        let state = plant.save();
        go(&mut plant, [2000.0, 100.0], 7, &mut y);
        let first = y[0];
        go(&mut plant, [1500.0, 80.0], 3, &mut y);
        plant.restore(&state).unwrap();
        go(&mut plant, [2000.0, 100.0], 7, &mut y);
        assert_eq!(y[0].to_bits(), first.to_bits());
        // What it shows is what the last step gave, also after a restored state, and the start value after a reset.
        let mut shown = [f64::NAN];
        plant.outputs(&mut shown).unwrap();
        assert_eq!(shown, y);
        plant.restore(&state).unwrap();
        plant.outputs(&mut shown).unwrap();
        assert!((shown[0] - want).abs() < 1e-9, "{} {want}", shown[0]);
        plant.reset(0);
        plant.outputs(&mut shown).unwrap();
        assert_eq!(shown[0], plant.variables()[2].start);
        assert!(plant.outputs(&mut [0.0, 0.0]).is_err());
        let e = plant.step(&[100.0, 50.0], dt, &mut y).unwrap_err().to_string();
        assert!(e.contains("`speed` = 100") && e.contains("800 to 5000"), "{e}");
    }
}

#[test]
fn what_is_no_fmu_is_refused() {
    let tmp = tempfile::tempdir().unwrap();
    let path = tmp.path().join("x.fmu");
    let message = |p: &Path| FmuPlant::open(p, &FmuSettings::default()).err().unwrap().to_string();
    assert!(message(&path).contains("cannot be read"));
    std::fs::write(&path, b"hello").unwrap();
    assert!(message(&path).contains("is no FMU (a zip archive)"));
    let Some(paths) = made(tmp.path()) else { return };
    let wrong = FmuSettings { parameters: [("tow".into(), 1.0)].into(), ..FmuSettings::default() };
    let e = FmuPlant::open(&paths[0], &wrong).err().unwrap().to_string();
    assert!(e.contains("no parameter `tow`; there are: tau"), "{e}");
    let wrong =
        FmuSettings { ranges: [("sped".into(), Interval::new(0.0, 1.0))].into(), ..FmuSettings::default() };
    let e = FmuPlant::open(&paths[0], &wrong).err().unwrap().to_string();
    assert!(e.contains("no input or output `sped`; there are: speed, torque, inj"), "{e}");
}
