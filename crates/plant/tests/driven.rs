//! An engine driven at boundary conditions: what it answers is what the engine does that runs freely.

use dynocal_plant::driven::{Answer, BEST_CA50_DEG, Boundary, drive, retard};
use dynocal_plant::engine::VirtualEngine;
use dynocal_plant::inputs::Inputs;
use dynocal_plant::params::EngineParams;
use dynocal_plant::statics::steady;

fn at(speed_rpm: f64, charge_kpa: f64, intake_kpa: f64) -> Boundary {
    Boundary {
        speed_rpm,
        charge_pa: 1e3 * charge_kpa,
        charge_k: 310.0,
        intake_pa: 1e3 * intake_kpa,
        lambda: 1.0,
        ambient_pa: 101_325.0,
        ambient_k: 298.15,
        spark_deg: None,
        cams_deg: None,
    }
}

fn driven(set: &str, at: &Boundary) -> Answer {
    let mut e = VirtualEngine::new(&EngineParams::named(set).unwrap()).unwrap();
    drive(&mut e, at).unwrap()
}

#[test]
fn a_throttled_point_is_that_of_the_free_engine() {
    // No turbocharger: the free engine finds its intake pressure by itself, the driven one is given it.
    let free = Inputs { injection_mg: 16.75, throttle_deg: 15.85, ..Inputs::default() };
    let mut e = VirtualEngine::new(&EngineParams::thesis()).unwrap();
    let y = steady(&mut e, free, 6.0, 1.2).unwrap();
    let boundary = Boundary {
        charge_k: 298.15,
        intake_pa: 1e3 * y.map_kpa,
        lambda: y.lambda,
        spark_deg: Some(free.spark_deg),
        cams_deg: Some([free.intake_mop_deg_btdc, free.exhaust_mop_deg_atdc]),
        ..at(2000.0, 101.325, 50.0)
    };
    let d = driven("thesis", &boundary);
    assert!(d.settled && d.turbo_rpm == 0.0);
    // The reservoir holds the pressure that pulses behind a closed throttle: 1.5 % less air here, and less to heat the walls with.
    assert!((d.air_kg_s / (1e-3 * y.air_g_s) - 1.0).abs() < 0.02, "{} {} g/s", 1e3 * d.air_kg_s, y.air_g_s);
    assert!((d.torque_nm - y.torque_nm).abs() < 2.0, "{} {} Nm", d.torque_nm, y.torque_nm);
    assert!((d.exhaust_k - y.egt_k).abs() < 10.0, "{} {} K", d.exhaust_k, y.egt_k);
}

#[test]
fn the_wastegate_that_is_found_makes_the_boost_that_was_given() {
    let given = at(3000.0, 150.0, 149.0);
    let d = driven("gtdi_2l", &given);
    assert!(d.settled && d.surplus.abs() < 0.01 && d.wastegate_mm > 0.0 && d.wastegate_mm < 28.0, "{d:?}");
    let mut e = VirtualEngine::new(&EngineParams::named("gtdi_2l").unwrap()).unwrap();
    let mut u = Inputs { throttle_deg: 90.0, ..d.inputs };
    // Fuel follows the air while the shaft finds its speed.
    for _ in 0..30 {
        let y = steady(&mut e, u, 0.5, 0.2).unwrap();
        u.injection_mg = 1e3 * y.air_g_s * 120.0 / 3000.0 / 4.0 / e.params().gas.afr_stoich;
    }
    let y = steady(&mut e, u, 1.0, 1.0).unwrap();
    // Nothing holds the shaft here: boost amplifies every small difference of the balance.
    assert!((y.map_kpa - 149.0).abs() < 6.0, "{} kPa", y.map_kpa);
    assert!((y.exhaust_kpa / (1e-3 * d.exhaust_pa) - 1.0).abs() < 0.04, "{} {}", y.exhaust_kpa, d.exhaust_pa);
}

#[test]
fn spark_is_best_spark_less_the_table() {
    let d = driven("gtdi_2l", &at(2000.0, 150.0, 149.0));
    let p = EngineParams::named("gtdi_2l").unwrap();
    let bmep_bar = 4e-5 * std::f64::consts::PI * d.torque_nm / p.displacement_m3();
    assert!((d.retard_deg - retard::deg(2000.0, bmep_bar)).abs() < 0.05, "{d:?}");
    // With that retard taken away the charge burns at the best angle.
    let mut e = VirtualEngine::new(&p).unwrap();
    let advanced = Boundary { spark_deg: Some(d.spark_deg + d.retard_deg), ..at(2000.0, 150.0, 149.0) };
    let best = drive(&mut e, &advanced).unwrap();
    assert!((e.outputs().ca50_deg - BEST_CA50_DEG).abs() < 0.5, "{}", e.outputs().ca50_deg);
    assert!(best.torque_nm > d.torque_nm);
}

#[test]
fn boost_beyond_the_turbine_is_said() {
    let d = driven("gtdi_2l", &at(1250.0, 260.0, 258.0));
    assert!(d.wastegate_mm == 0.0 && d.surplus < -0.02, "{d:?}");
    // And what is less than the open wastegate makes.
    let d = driven("gtdi_2l", &at(5000.0, 102.0, 101.0));
    assert!(d.wastegate_mm == 28.0 && d.surplus > 0.02, "{d:?}");
}
