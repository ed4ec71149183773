//! The whole engine: balances, motored and fired reference points, determinism.

use dynocal_plant::engine::VirtualEngine;
use dynocal_plant::error::PlantError;
use dynocal_plant::inputs::Inputs;
use dynocal_plant::params::EngineParams;
use dynocal_plant::statics::{self, SettleOptions, Target};

fn fired(inputs: Inputs, time_s: f64) -> VirtualEngine {
    let mut e = VirtualEngine::new(&EngineParams::thesis()).unwrap();
    e.set_inputs(inputs).unwrap();
    e.advance_time(time_s);
    e
}

/// Gas and liquid mass \[kg\] and sensible energy \[J\] of the whole engine.
fn contents(e: &VirtualEngine) -> (f64, f64) {
    let g = &e.state().gas;
    let gas: f64 = g.mass_kg.iter().flatten().sum();
    (gas + g.liquid_kg.iter().sum::<f64>(), g.energy_j.iter().sum())
}

#[test]
fn first_law_and_mass_over_fired_cycles() {
    for (speed, injection) in [(2000.0, 16.7), (1200.0, 9.0), (3000.0, 25.0)] {
        let mut e = fired(Inputs { speed_rpm: speed, injection_mg: injection, ..Inputs::default() }, 1.0);
        let ((m0, e0), l0) = (contents(&e), e.state().ledger);
        e.advance_angle(720.0);
        let ((m1, e1), l1) = (contents(&e), e.state().ledger);
        let burned = e.params().gas.lhv_j_kg * (l1.burned_kg - l0.burned_kg);
        let wall = l1.wall_heat_j - l0.wall_heat_j;
        let work = l1.work_j - l0.work_j;
        let residual = (e1 - e0) + work + wall + (l1.evaporation_j - l0.evaporation_j)
            - (l1.enthalpy_in_j - l0.enthalpy_in_j)
            - burned;
        assert!(burned > 500.0 && wall > 100.0 && work > 100.0);
        assert!(residual.abs() < 1e-12 * burned, "{speed} rpm: {residual:e} J of {burned} J");
        let drift = (m1 - m0) - (l1.mass_in_kg - l0.mass_in_kg) - (l1.injected_kg - l0.injected_kg);
        assert!(drift.abs() < 1e-17 * 50.0, "mass {drift:e} kg");
        // Exact up to the rounding of the running sum of the ledger.
        let injected = l1.injected_kg - l0.injected_kg;
        assert!((injected - 4e-6 * injection).abs() < 1e-12 * injected, "{injected:e} kg injected");
    }
}

#[test]
fn first_law_of_a_closed_fired_cylinder_with_wall_heat() {
    let mut p = EngineParams::thesis();
    p.intake_valve.lift_m = 0.0;
    p.exhaust_valve.lift_m = 0.0;
    let mut e = VirtualEngine::new(&p).unwrap();
    e.set_inputs(Inputs { injection_mg: 0.0, ..Inputs::default() }).unwrap();
    // Cylinder 3 is at its bottom dead centre before compression.
    e.set_volume(2, [3e-4, 2e-5, 3e-5], 340.0);
    let cylinders = |e: &VirtualEngine| e.state().gas.energy_j[..4].iter().sum::<f64>();
    let mut manifold_heat = 0.0;
    let start = cylinders(&e);
    let manifolds =
        |e: &VirtualEngine| e.state().gas.energy_j[4..].iter().sum::<f64>() - e.state().ledger.enthalpy_in_j;
    let m0 = manifolds(&e);
    e.advance_angle(720.0);
    manifold_heat -= manifolds(&e) - m0;
    let l = e.state().ledger;
    let burned = p.gas.lhv_j_kg * l.burned_kg;
    let residual = cylinders(&e) - start + l.work_j + (l.wall_heat_j - manifold_heat) - burned;
    assert!(burned > 700.0 && l.wall_heat_j > 50.0, "{burned} J burned, {} J to walls", l.wall_heat_j);
    assert!(residual.abs() < 1e-12 * burned, "{residual:e} J of {burned} J");
}

#[test]
fn the_burned_mass_is_the_burnable_mass() {
    let mut e = fired(Inputs::default(), 2.0);
    let before = e.state().ledger.burned_kg;
    e.advance_angle(720.0);
    let burned = e.state().ledger.burned_kg - before;
    let burnable: f64 = e.state().cylinders.iter().map(|c| c.burnable_kg).sum();
    // Midpoint rule at 1 deg on a burn of about 40 deg.
    assert!((burned / burnable - 1.0).abs() < 1e-4, "{burned:e} of {burnable:e}");
}

#[test]
fn motored_with_open_throttle() {
    for (speed, p_max, torque) in [(1000.0, 18.2, -7.1), (2000.0, 19.2, -10.3), (3000.0, 19.8, -14.3)] {
        let inputs = Inputs { speed_rpm: speed, throttle_deg: 90.0, injection_mg: 0.0, ..Inputs::default() };
        let e = fired(inputs, 6.0);
        let y = e.outputs();
        assert!((y.pmax_bar - p_max).abs() <= 0.05, "{speed} rpm: p_max {} bar", y.pmax_bar);
        assert!((y.torque_cycle_nm - torque).abs() <= 0.05, "{speed} rpm: {} Nm", y.torque_cycle_nm);
        for c in e.cycle_log() {
            assert!(c.peak_deg.abs() <= 1.0, "peak at {} deg", c.peak_deg);
        }
    }
}

#[test]
fn volumetric_efficiency_at_open_throttle() {
    // Speed, fuel for lambda 1 and efficiency of the specification's table.
    let rows = [
        (1000.0, 30.928, 0.7690, 12.0),
        (2000.0, 31.896, 0.7927, 16.0),
        (3000.0, 32.505, 0.8092, 20.0),
        (4000.0, 32.712, 0.8151, 22.0),
        (5000.0, 32.486, 0.8096, 24.0),
    ];
    for (speed_rpm, injection_mg, expected, spark_deg) in rows {
        let inputs = Inputs { speed_rpm, injection_mg, spark_deg, throttle_deg: 90.0, ..Inputs::default() };
        let y = fired(inputs, 4.0).outputs();
        assert!(
            (y.volumetric_efficiency - expected).abs() < 0.005,
            "{speed_rpm}: {}",
            y.volumetric_efficiency
        );
        assert!((y.lambda_cycle - 1.0).abs() < 0.01, "{speed_rpm}: lambda {}", y.lambda_cycle);
    }
}

#[test]
fn fuel_against_spark_has_one_minimum() {
    let mut e = VirtualEngine::new(&EngineParams::thesis()).unwrap();
    let target = Target { speed_rpm: 2000.0, torque_nm: 70.0, lambda: 1.0 };
    let rows = [(5.0, 18.82), (11.0, 17.29), (19.0, 16.76), (23.0, 16.85), (35.0, 17.80)];
    let fuel: Vec<f64> = rows
        .iter()
        .map(|(spark, _)| {
            statics::settle(&mut e, target, *spark, SettleOptions::default()).unwrap().inputs.injection_mg
        })
        .collect();
    for ((spark, expected), found) in rows.iter().zip(&fuel) {
        assert!((found / expected - 1.0).abs() < 0.005, "spark {spark}: {found} mg against {expected}");
    }
    assert!(fuel[0] > fuel[1] && fuel[1] > fuel[2] && fuel[2] < fuel[3] && fuel[3] < fuel[4]);
}

#[test]
fn same_inputs_same_bits_and_restore_continues() {
    let mut a = fired(Inputs::default(), 0.5);
    let mut b = fired(Inputs::default(), 0.5);
    // Mid-cycle, between events, and with a remainder of angle.
    a.advance_time(0.012_34);
    b.advance_time(0.012_34);
    assert_eq!(a.state(), b.state());
    let snapshot = a.snapshot();
    let mut c = VirtualEngine::new(&EngineParams::thesis()).unwrap();
    c.restore(&snapshot).unwrap();
    a.advance_time(0.3);
    c.advance_time(0.3);
    assert_eq!(a.state(), c.state());
    assert_eq!(a.outputs(), c.outputs());
}

#[test]
fn splitting_of_time_does_not_matter() {
    let mut whole = fired(Inputs::default(), 0.5);
    let mut parts = whole.clone();
    whole.advance_time(0.01);
    (0..10).for_each(|_| parts.advance_time(0.001));
    assert_eq!(whole.state().gas, parts.state().gas);
    // Boundaries off the grid: the remainder is carried, so the same steps are made.
    let mut whole = fired(Inputs { speed_rpm: 1730.0, ..Inputs::default() }, 0.5);
    let mut parts = whole.clone();
    whole.advance_time(0.013);
    (0..13).for_each(|_| parts.advance_time(0.001));
    assert_eq!(whole.state().gas, parts.state().gas);
    assert!((whole.state().remainder_deg - parts.state().remainder_deg).abs() < 1e-9);
}

#[test]
fn step_follows_speed_and_keeps_the_grid() {
    let mut e = fired(Inputs { speed_rpm: 1000.0, ..Inputs::default() }, 0.1);
    for speed_rpm in [4500.0, 1000.0, 2500.0, 800.0, 6000.0, 1400.0] {
        e.set_inputs(Inputs { speed_rpm, ..Inputs::default() }).unwrap();
        e.advance_time(0.0373);
        e.check_state().unwrap();
    }
    // The ring of work holds exactly the last cycle: its sum is the running sum.
    let ring: f64 = e.state().work_ring_j.iter().sum();
    assert!((ring - e.state().work_sum_j).abs() < 1e-9);
}

#[test]
fn torque_sensor_is_a_first_order_lag_of_the_cycle_mean() {
    let mut e = fired(Inputs::default(), 4.0);
    let y0 = e.outputs();
    assert!((y0.torque_nm - y0.torque_cycle_nm).abs() < 1e-3);
    e.set_inputs(Inputs { injection_mg: 13.0, ..Inputs::default() }).unwrap();
    // Independent lag on the sampled cycle mean (trapezoid at every 1 deg = 1/12000 s).
    let (mut lag, mut last) = (y0.torque_nm, y0.torque_cycle_nm);
    for _ in 0..6000 {
        e.advance_angle(1.0);
        let now = e.outputs().torque_cycle_nm;
        lag += (0.5 * (now + last) - lag) / 12_000.0 / 0.15;
        last = now;
    }
    assert!((e.outputs().torque_nm - lag).abs() < 0.02, "{} against {lag}", e.outputs().torque_nm);
    assert!(y0.torque_nm - lag > 5.0);
}

#[test]
fn errors_name_the_offender() {
    let mut e = VirtualEngine::new(&EngineParams::thesis()).unwrap();
    let before = e.state().clone();
    let wrong = Inputs { throttle_deg: f64::NAN, ..Inputs::default() };
    assert!(matches!(e.set_inputs(wrong), Err(PlantError::Input { name: "throttle", .. })));
    let wrong = Inputs { speed_rpm: 7000.0, ..Inputs::default() };
    let message = e.set_inputs(wrong).unwrap_err().to_string();
    assert!(message.contains("7000") && message.contains("6500"), "{message}");
    assert_eq!(&before, e.state());
    let mut p = EngineParams::thesis();
    p.geometry.compression_ratio = 0.9;
    assert!(matches!(VirtualEngine::new(&p), Err(PlantError::ParameterRange { .. })));
    assert!(EngineParams::from_toml("bore = 1").is_err());
}

#[test]
fn random_inputs_over_the_whole_box_stay_physical() {
    let mut rng = dynocal_numerics::rng::Rng64::new(20);
    let mut e = VirtualEngine::new(&EngineParams::thesis()).unwrap();
    let ((m0, e0), l0) = (contents(&e), e.state().ledger);
    for _ in 0..1200 {
        let inputs = Inputs {
            speed_rpm: rng.uniform_in(600.0, 6500.0),
            throttle_deg: rng.uniform_in(0.0, 90.0),
            spark_deg: rng.uniform_in(-10.0, 55.0),
            injection_mg: rng.uniform_in(0.0, 120.0),
            ..Inputs::default()
        };
        e.set_inputs(inputs).unwrap();
        e.advance_time(0.05);
        e.check_state().unwrap();
        let y = e.outputs();
        assert!(y.torque_nm.is_finite() && y.map_kpa > 1.0 && y.map_kpa < 130.0, "{inputs:?} {y:?}");
        assert!(
            y.lambda > 0.0 && y.lambda <= 9.99 && y.exhaust_k > 250.0 && y.exhaust_k < 2000.0,
            "{inputs:?} {y:?}"
        );
    }
    let ((m1, e1), l) = (contents(&e), e.state().ledger);
    let burned = e.params().gas.lhv_j_kg * l.burned_kg;
    let balance = e1 - e0 + l.work_j + l.wall_heat_j + l.evaporation_j - l.enthalpy_in_j - burned;
    assert!(balance.abs() < 1e-11 * burned, "energy error {balance:e} J of {burned:e} J");
    assert!((m1 - m0 - l.mass_in_kg - l.injected_kg + l0.mass_in_kg).abs() < 1e-11 * l.injected_kg);
}

#[test]
fn order_of_convergence_of_a_fired_point() {
    // Torque at 2000 rpm for steps of 2, 1, 0.5 deg against 0.125 deg: errors of the step-size study
    // of the specification (0.04, 0.001, 0.000 %) with a margin of a factor of two.
    let torque = |fixed: usize| {
        let mut p = EngineParams::thesis();
        p.stepping.cells_per_deg = 8;
        p.stepping.fixed_cells = fixed;
        let mut e = VirtualEngine::new(&p).unwrap();
        e.advance_time(5.0);
        e.outputs().torque_cycle_nm
    };
    let exact = torque(1);
    for (fixed, percent) in [(16, 0.1), (8, 0.003), (4, 0.001)] {
        let error = 100.0 * (torque(fixed) / exact - 1.0).abs();
        assert!(error < percent, "{} deg: {error} %", fixed as f64 / 8.0);
    }
}
