//! Parameter sets from TOML: the embedded ones and what the loader says about faulty files.

use dynocal_plant::combustion::BurnModel;
use dynocal_plant::engine::VirtualEngine;
use dynocal_plant::error::PlantError;
use dynocal_plant::gas::GasModel;
use dynocal_plant::geometry::Geometry;
use dynocal_plant::heat::HeatLaw;
use dynocal_plant::params::*;

/// The constants of the specification, typed from it a second time.
fn specified() -> EngineParams {
    let valve = |duration_deg, lift_m, head_m| Valve {
        duration_deg,
        lift_m,
        head_m,
        count: 2.0,
        flow_coefficient: 0.60,
        lift_slope: 5.6,
    };
    EngineParams {
        geometry: Geometry::thesis(),
        gas: GasModel::gasoline(),
        ambient: Ambient { pressure_pa: 101_325.0, temperature_k: 298.15 },
        throttle: Throttle { diameter0_m: 0.0027, slope_m_per_deg: 0.000_455, discharge: 0.90 },
        intake_valve: valve(248.0, 0.0086, 0.0325),
        exhaust_valve: valve(240.0, 0.0084, 0.0285),
        charge_pipe_m3: 0.006,
        intake_manifold: Manifold { volume_m3: 0.0045, ua_w_k: 4.0, wall_k: 318.0 },
        exhaust_manifold: Manifold { volume_m3: 0.002, ua_w_k: 10.0, wall_k: 550.0 },
        exhaust_wall: None,
        catalyst: Manifold { volume_m3: 0.005, ua_w_k: 8.0, wall_k: 600.0 },
        exhaust: Exhaust { turbine_m2: 330e-6, wastegate_discharge: 0.65, tailpipe_m2: 900e-6 },
        port: None,
        turbocharger: None,
        egr: None,
        knock: None,
        burned_energy: None,
        emissions: None,
        cams: None,
        injection: Injection { rate_kg_s: 0.01, evaporation_s: 0.002, charge_share: 0.8 },
        burn: BurnModel::thesis(),
        heat: HeatTransfer { scale: 0.90, wall_k: 440.0, coolant: None, law: HeatLaw::Woschni },
        friction: Friction {
            constant_pa: 8000.0,
            peak_share: 0.004,
            linear_pa_s_m: 5000.0,
            quadratic_pa_s2_m2: 90.0,
            boundary_pa: 0.0,
        },
        torque_lag_s: 0.15,
        stepping: Stepping { cells_per_deg: 2, fixed_cells: 0, max_step_s: 85e-6 },
    }
}

#[test]
fn the_thesis_set_is_that_of_the_specification() {
    assert_eq!(EngineParams::thesis(), specified());
}

#[test]
fn every_embedded_set_is_an_engine_and_survives_a_round_trip() {
    for set in PARAMETER_SETS {
        let p = EngineParams::from_toml(set.text).unwrap_or_else(|e| panic!("{}: {e}", set.doc.name));
        assert_eq!(EngineParams::from_toml(&p.to_toml()).unwrap(), p, "{}", set.doc.name);
        VirtualEngine::new(&p).unwrap();
        assert!(!set.doc.what.is_empty());
    }
    let error = EngineParams::named("v8").unwrap_err().to_string();
    assert!(error.contains("v8") && error.contains("thesis"), "{error}");
}

/// The thesis file with one line changed.
fn changed(from: &str, to: &str) -> Result<EngineParams, PlantError> {
    let text = PARAMETER_SETS[0].text;
    assert_eq!(text.matches(from).count(), 1, "{from}");
    EngineParams::from_toml(&text.replace(from, to))
}

#[test]
fn faulty_files_are_refused_with_key_and_line() {
    let text = PARAMETER_SETS[0].text;
    let line = |key: &str| 1 + text.lines().position(|l| l.starts_with(key)).unwrap();
    let error = changed("compression_ratio = 9.9", "compression_ratio = 0.9").unwrap_err().to_string();
    let at = line("compression_ratio");
    assert!(error.contains("geometry.compression_ratio") && error.contains("0.9"), "{error}");
    assert!(error.contains(&format!("line {at}:")) && error.contains("3 to 30"), "{error}");
    // The same key in two tables: the line is that of the table meant.
    let error = changed("head_m = 0.0285", "head_m = nan").unwrap_err().to_string();
    let at = 1 + text.lines().position(|l| l.starts_with("head_m = 0.0285")).unwrap();
    assert!(error.contains("exhaust_valve.head_m") && error.contains(&format!("line {at}:")), "{error}");
    let error = changed("bore_m = 0.0875", "boer_m = 0.0875").unwrap_err().to_string();
    assert!(error.contains("boer_m") && error.contains(&format!("line {}", line("bore_m"))), "{error}");
    let error = changed("stroke_m = 0.0832", "").unwrap_err().to_string();
    assert!(error.contains("stroke_m"), "{error}");
    let error = changed("stroke_m = 0.0832", "stroke_m = \"long\"").unwrap_err().to_string();
    assert!(error.contains("line"), "{error}");
    assert!(changed("cells_per_deg = 2", "cells_per_deg = 3").is_err());
    assert!(changed("fixed_cells = 0", "fixed_cells = 3").is_err());
}

/// The files say that the delay of knock is the published one: no set multiplies it, and the constants are those of the page.
#[test]
fn the_delay_of_knock_is_the_published_one_in_every_set() {
    let mut sets = 0;
    for set in PARAMETER_SETS {
        let Some(knock) = EngineParams::named(set.doc.name).unwrap().knock else { continue };
        sets += 1;
        assert_eq!(knock.delay_factor, 1.0, "{}", set.doc.name);
        let published =
            17.68e-3 * (knock.octane / 100.0).powf(3.402) * 30f64.powf(-1.7) * (3800.0f64 / 900.0).exp();
        assert!((knock.delay_s(30.0 * 101_325.0, 900.0) / published - 1.0).abs() < 1e-12);
    }
    assert!(sets >= 3);
}

/// Towards no load the cams go from part load to the positions of light load, above part load to those of full load.
#[test]
fn cams_pass_from_light_over_part_to_full_load() {
    let cams = EngineParams::named("gtdi_2l").unwrap().cams.unwrap();
    let light = cams.light.clone().unwrap();
    let at = |kpa: f64| cams.at(2000.0, kpa);
    assert_eq!(at(20.0), (light.intake_deg[2], light.exhaust_deg[2]));
    assert_eq!(at(light.load_kpa), at(20.0));
    assert_eq!(at(cams.part_load_kpa), (cams.intake_part_deg[2], cams.exhaust_part_deg[2]));
    assert_eq!(at(300.0), (cams.intake_full_deg[2], cams.exhaust_full_deg[2]));
    let middle = at(0.5 * (light.load_kpa + cams.part_load_kpa)).0;
    assert!((middle - 0.5 * (light.intake_deg[2] + cams.intake_part_deg[2])).abs() < 1e-12);
    // Without them the positions of part load hold down to no load.
    let without = dynocal_plant::cams::CamSchedule { light: None, ..cams.clone() };
    assert_eq!(without.at(2000.0, 20.0), at(cams.part_load_kpa));
    // A light load that is no less than part load is refused.
    let turned = dynocal_plant::cams::LightLoad { load_kpa: cams.part_load_kpa, ..light };
    assert!(!dynocal_plant::cams::CamSchedule { light: Some(turned), ..cams }.fits());
}

/// Boundary lubrication is e (1 + 500 rpm/N) on top of Chen and Flynn, and nothing where it is not given.
#[test]
fn boundary_lubrication_weighs_low_speed() {
    let mut friction = specified().friction;
    let plain = friction.fmep_pa(50e5, 5.0, 1000.0);
    assert_eq!(plain, 8000.0 + 0.004 * 50e5 + 5.0 * (5000.0 + 5.0 * 90.0));
    friction.boundary_pa = 10e3;
    assert_eq!(friction.fmep_pa(50e5, 5.0, 1000.0), plain + 15e3);
    assert_eq!(friction.fmep_pa(50e5, 5.0, 500.0), plain + 20e3);
}

/// Whatever the seed, a perturbed engine is one.
#[test]
fn every_perturbed_set_is_an_engine() {
    for set in PARAMETER_SETS {
        let base = EngineParams::named(set.doc.name).unwrap();
        for seed in 0..500 {
            let found = perturb::perturbed(&base, seed);
            assert!(found.is_ok(), "{} {seed}: {}", set.doc.name, found.unwrap_err());
        }
    }
}
