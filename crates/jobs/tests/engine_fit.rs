//! A fit to a map: constants of a known engine are found again, and what cannot be read is said.

use dynocal_files::{atomic, csv_io};
use dynocal_jobs::engine::fit::{Spec, run, store};
use dynocal_jobs::engine::{Engine, EngineJobError};
use dynocal_numerics::watch::Watch;
use dynocal_plant::driven::{Boundary, drive};
use dynocal_plant::engine::VirtualEngine;
use std::path::Path;

/// Boundary conditions over speed and load, with spark and cams as a user's bed records them.
fn boundaries() -> Vec<Boundary> {
    let mut all = Vec::new();
    for (k, speed_rpm) in [1500.0, 2000.0, 2500.0, 3000.0, 3500.0].into_iter().enumerate() {
        for (j, intake_kpa) in [35.0, 55.0, 75.0, 95.0, 125.0, 155.0].into_iter().enumerate() {
            all.push(Boundary {
                speed_rpm,
                charge_pa: 1e3 * f64::max(intake_kpa + 1.0, 103.0),
                charge_k: 305.0 + k as f64,
                intake_pa: 1e3 * intake_kpa,
                lambda: if j == 5 { 0.9 } else { 1.0 },
                ambient_pa: 101_325.0,
                ambient_k: 298.15,
                spark_deg: Some(30.0 - 5.0 * j as f64 + k as f64),
                cams_deg: Some([240.0 - k as f64, 245.0 + j as f64]),
            });
        }
    }
    all
}

/// A map of an engine that differs from `gtdi_2l` in known constants.
fn write_map(path: &Path, moved: impl Fn(&mut dynocal_plant::params::EngineParams)) {
    let mut p = Engine::named("gtdi_2l").unwrap().params;
    moved(&mut p);
    let mut e = VirtualEngine::new(&p).unwrap();
    let (b, y): (Vec<Boundary>, Vec<_>) =
        boundaries().into_iter().map(|b| (b, drive(&mut e, &b).unwrap())).unzip();
    let of = |f: &dyn Fn(usize) -> f64| -> Vec<f64> { (0..b.len()).map(f).collect() };
    // In the units of a bed.
    let columns = [
        ("speed", "rpm", of(&|k| b[k].speed_rpm)),
        ("torque", "Nm", of(&|k| y[k].torque_nm)),
        ("air", "kg/h", of(&|k| 3600.0 * y[k].air_kg_s)),
        ("lambda", "-", of(&|k| b[k].lambda)),
        ("p_before_throttle", "kPa", of(&|k| 1e-3 * b[k].charge_pa)),
        ("T_before_throttle", "degC", of(&|k| b[k].charge_k - 273.15)),
        ("map", "kPa", of(&|k| 1e-3 * b[k].intake_pa)),
        ("p_exhaust_manifold", "bar", of(&|k| 1e-5 * y[k].exhaust_pa)),
        ("egt", "degC", of(&|k| y[k].exhaust_k - 273.15)),
        ("spark", "deg", of(&|k| b[k].spark_deg.unwrap())),
        ("intake_cam", "deg", of(&|k| b[k].cams_deg.unwrap()[0])),
        ("exhaust_cam", "deg", of(&|k| b[k].cams_deg.unwrap()[1])),
    ];
    let columns: Vec<(&str, &str, &[f64])> = columns.iter().map(|(n, u, v)| (*n, *u, v.as_slice())).collect();
    csv_io::write_columns(path, &columns).unwrap();
}

#[test]
fn constants_of_a_known_engine_are_found_again() {
    let tmp = tempfile::tempdir().unwrap();
    let map = tmp.path().join("map.csv");
    write_map(&map, |p| {
        p.burn.efficiency = 0.915;
        p.friction.constant_pa = 70e3;
        p.exhaust_wall.as_mut().unwrap().port_w_k = 13.0;
        p.exhaust.turbine_m2 = 2.2e-4;
        p.intake_valve.flow_coefficient = 0.52;
    });
    let engine = Engine::named("gtdi_2l").unwrap();
    let out = tmp.path().join("run");
    let spec = Spec { map, evaluations: 30 };
    let (found, _) = store::fit(&engine, &spec, &out, Watch::silent()).unwrap();
    assert!(found.valid(), "{:?}", found.scores);
    // The truth is in reach: what is left is what a point that stands still may still move.
    for s in &found.scores {
        assert!(s.judged < 0.15 * s.asked && s.judged < 0.2 * s.before, "{s:?}");
    }
    let value = |key: &str| found.constants.iter().find(|c| c.key == key).unwrap().value;
    for (key, truth, within) in [
        ("burn.efficiency", 0.915, 0.02),
        ("exhaust_wall.port_w_k", 13.0, 0.2),
        ("exhaust.turbine_m2", 2.2e-4, 0.05),
        ("intake_valve.flow_coefficient", 0.52, 0.06),
    ] {
        assert!((value(key) / truth - 1.0).abs() < within, "{key}: {} of {truth}", value(key));
    }
    // The truth lies in the intervals, or nearly: what is left of a point that stands still is no independent error.
    for (key, truth) in [("exhaust_wall.port_w_k", 13.0), ("exhaust.turbine_m2", 2.2e-4)] {
        let c = found.constants.iter().find(|c| c.key == key).unwrap();
        let half = c.half_width.unwrap_or_else(|| panic!("{key} has no interval: {:?}", c.note));
        assert!(half > 0.0 && (c.value - truth).abs() < 3.0 * half + 0.02 * truth, "{c:?}");
    }
    // Two thirds of 30 rows; a condition of a matrix is 1 or more.
    assert_eq!(found.fitted_points, 20);
    assert!(found.condition.is_some_and(|c| c > 1.0 && c < 1e6), "{:?}", found.condition);
    // Cams were given: nothing about them is inferred.
    assert!(found.constants.iter().all(|c| !c.key.starts_with("cams.")));
    // What is written is an engine.
    let again = Engine::named(out.join("fitted.toml").to_str().unwrap()).unwrap();
    assert_eq!(Some(again.params), found.params);
    assert!(out.join("report.html").exists() && out.join("points.csv").exists());
}

#[test]
fn a_map_that_cannot_be_read_is_refused_with_its_reason() {
    let tmp = tempfile::tempdir().unwrap();
    let map = tmp.path().join("map.csv");
    let engine = Engine::named("gtdi_2l").unwrap();
    let spec = Spec { map: map.clone(), evaluations: 1 };
    let refused = |head: &str, row: &str, rows: usize| {
        let text = format!("{head}\n{}", format!("{row}\n").repeat(rows));
        atomic::write(&map, text.as_bytes()).unwrap();
        run(&engine, &spec, Watch::silent()).unwrap_err()
    };
    let head = "speed [rpm],torque [Nm],lambda [-],map [kPa]";
    let few = refused(head, "2000,60,1,50", 5);
    assert!(few.to_string().contains("rows 5: expected at least 30"), "{few}");
    let far = refused(head, "2000,60,1,5000", 40);
    assert!(far.to_string().contains("intake pressure"), "{far}");
    let unit = refused("speed [rpm],torque [kW],lambda [-],map [kPa]", "2000,60,1,50", 40);
    assert!(matches!(unit, EngineJobError::Unit { .. }), "{unit}");
    let missing = refused("speed [rpm],torque [Nm],map [kPa]", "2000,60,50", 40);
    assert!(matches!(missing, EngineJobError::Column { what: "lambda", .. }), "{missing}");
    // What is missing comes before how little there is.
    let both = refused("speed [rpm],torque [Nm],map [kPa]", "2000,60,50", 2);
    assert!(matches!(both, EngineJobError::Column { what: "lambda", .. }), "{both}");
    let wild = refused(head, "2000,60000,1,50", 40);
    assert!(wild.to_string().contains("torque in Nm"), "{wild}");
    let cold = refused(&format!("{head},T_before_throttle [K]"), "2000,60,1,50,31", 40);
    assert!(cold.to_string().contains("is the column in degC?"), "{cold}");
    let turned = refused(&format!("{head},intake_cam [deg],exhaust_cam [deg]"), "2000,60,1,50,999,250", 40);
    assert!(turned.to_string().contains("map.csv: line 2: intake_cam in deg 999"), "{turned}");
    // A folder in which nothing was fitted stays as it was.
    let out = tmp.path().join("run");
    assert!(store::fit(&engine, &spec, &out, Watch::silent()).is_err() && !out.exists());
}
