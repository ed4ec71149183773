//! Walls that are at rest with the gas or warm up, and a burn that feels where it burns.

use dynocal_ident::plant::Plant;
use dynocal_plant::bed::{BedSettings, EngineBed};
use dynocal_plant::combustion::{BurnModel, Charge};
use dynocal_plant::deviations::Deviations;
use dynocal_plant::engine::VirtualEngine;
use dynocal_plant::geometry::Geometry;
use dynocal_plant::inputs::Inputs;
use dynocal_plant::params::{Coolant, EngineParams};

/// `gtdi_2l` at a middle load, after `time_s`.
fn run(params: &EngineParams, d: Deviations, time_s: f64) -> VirtualEngine {
    let mut e = VirtualEngine::new(params).unwrap();
    e.set_inputs(Inputs { throttle_deg: 20.0, spark_deg: 20.0, injection_mg: 22.0, ..Inputs::default() })
        .unwrap();
    e.set_deviations(d);
    e.advance_time(time_s);
    e
}

/// Mean powers \[W\] over ten cycles: to the cylinder walls, from the exhaust manifold.
fn heats(e: &mut VirtualEngine) -> (f64, f64) {
    let (t, l) = (e.state().time_s, e.state().ledger);
    e.advance_angle(7200.0);
    let (h, m) = (e.state().time_s - t, e.state().ledger);
    ((m.cylinder_heat_j - l.cylinder_heat_j) / h, (m.exhaust_heat_j - l.exhaust_heat_j) / h)
}

#[test]
fn a_wall_of_the_manifold_at_its_resting_temperature_changes_nothing() {
    let params = EngineParams::named("gtdi_2l").unwrap();
    let wall = params.exhaust_wall.unwrap();
    let mut rest = run(&params, Deviations::default(), 3.0);
    let sinks = rest.exhaust_sinks().unwrap();
    let (_, lost_w) = heats(&mut rest);
    // What is left of the heat when the ports have theirs passes the manifold and leaves it to the air.
    let (both, ends) = sinks.joined();
    let gas_k = ends + lost_w / both;
    let through = sinks.manifold.0 * (gas_k - sinks.manifold.1);
    let wall_k = params.ambient.temperature_k + through / wall.ambient_w_k;
    let mut given = run(&params, Deviations { manifold_wall_k: Some(wall_k), ..Deviations::default() }, 3.0);
    let (_, again_w) = heats(&mut given);
    assert!((again_w / lost_w - 1.0).abs() < 2e-3, "{again_w} {lost_w} W");
    // Cold walls, of coolant and manifold, take more.
    let cold = Deviations { manifold_wall_k: Some(293.15), coolant_k: Some(293.15), ..Deviations::default() };
    let mut cold = run(&params, cold, 3.0);
    let (_, cold_w) = heats(&mut cold);
    assert!(cold_w > 1.15 * lost_w, "{cold_w} {lost_w} W");
    assert!(cold.outputs().egt_k < rest.outputs().egt_k - 20.0);
}

#[test]
fn cylinder_walls_at_rest_give_the_coolant_what_they_take() {
    let mut params = EngineParams::named("gtdi_2l").unwrap();
    let c = Coolant { temperature_k: 363.15, conductance_w_k: 250.0 };
    params.heat.coolant = Some(c);
    let mut e = run(&params, Deviations::default(), 3.0);
    let (heat_w, _) = heats(&mut e);
    let wall_k = c.temperature_k + heat_w / c.conductance_w_k;
    assert!((380.0..470.0).contains(&wall_k), "{wall_k} K");
    // An engine whose walls are held at that mean is the same, but for what they move within it.
    let held = Deviations { cylinder_wall_k: Some(wall_k), ..Deviations::default() };
    let other = run(&params, held, 3.3);
    let (a, b) = (e.outputs(), other.outputs());
    assert!(
        (a.torque_cycle_nm - b.torque_cycle_nm).abs() < 0.2,
        "{} {}",
        a.torque_cycle_nm,
        b.torque_cycle_nm
    );
    assert!((a.egt_k - b.egt_k).abs() < 0.5, "{} {}", a.egt_k, b.egt_k);
}

#[test]
fn a_restored_engine_with_walls_at_rest_continues_with_the_same_bits() {
    let params = EngineParams::named("twin_2l").unwrap();
    let mut e = run(&params, Deviations::default(), 0.37);
    let state = e.snapshot();
    e.advance_time(0.5);
    let mut other = VirtualEngine::new(&params).unwrap();
    other.restore(&state).unwrap();
    other.advance_time(0.5);
    assert_eq!(e.state(), other.state());
}

#[test]
fn the_manifold_of_a_cold_bed_warms_up_and_that_of_a_warm_one_is_at_rest() {
    let params = EngineParams::named("gtdi_2l").unwrap();
    let start = |start_k: f64| {
        let mut s = BedSettings::of_set("gtdi_2l", &params).unwrap();
        s.options.outputs = vec!["manifold_wall".into()];
        s.options.engine.warm_up.as_mut().unwrap().start_k = start_k;
        EngineBed::new(&params, s).unwrap()
    };
    let last = |bed: &mut EngineBed, seconds: usize| {
        let u: Vec<f64> = bed.variables().iter().take(4).map(|v| v.start).collect();
        let mut y = [0.0; 6];
        for _ in 0..seconds {
            bed.step(&u, 1.0, &mut y).unwrap();
        }
        y[5]
    };
    let mut cold = start(293.15);
    let (first, later) = (last(&mut cold, 1), last(&mut cold, 8));
    assert!(
        (293.0..320.0).contains(&first) && (first + 8.0..first + 20.0).contains(&later),
        "{first} {later} K"
    );
    // (Some 1.6 kW, 3.1 W/K below 800 K, into 920 J/K.)
    let mut warm = start(363.15);
    let (first, later) = (last(&mut warm, 1), last(&mut warm, 8));
    assert!(first > 500.0 && (later - first).abs() < 15.0, "{first} {later} K");
}

fn charge(spark_deg: f64) -> Charge {
    Charge {
        speed_rpm: 2000.0,
        spark_deg,
        wiebe_m: 2.0,
        duration_deg: None,
        trapped_kg: 280e-6,
        residual: 0.0,
        lambda: 1.0,
    }
}

#[test]
fn the_flame_develops_and_burns_with_the_power_of_the_volume() {
    let g = Geometry::thesis();
    let plain = BurnModel { late_weight: 0.0, early_weight: 0.0, ..BurnModel::thesis() };
    let felt = BurnModel { state_exponent: 0.6, ..plain.clone() };
    let volume = |deg: f64| g.volume_m3(deg.to_radians());
    for spark in [-5.0, 8.0, 19.0, 35.0] {
        let (a, b) = (plain.wiebe(&charge(spark), &g), felt.wiebe(&charge(spark), &g));
        let develops = a.angle_of_fraction_deg(0.1) + spark;
        let expected = develops * (volume(0.5 * develops - spark) / volume(-10.0)).powf(0.6);
        let ca10 = b.angle_of_fraction_deg(0.1);
        assert!((ca10 + spark - expected).abs() < 1e-9, "{spark}: {ca10}");
        // 50 % burned, had the main burn not been touched.
        let half = ca10 + a.angle_of_fraction_deg(0.5) - a.angle_of_fraction_deg(0.1);
        let burns = (volume(half) / volume(8.0)).powf(0.6);
        assert!((b.duration_deg / a.duration_deg - burns).abs() < 1e-12, "{spark}: {}", b.duration_deg);
    }
    // A spark that is 5.5 deg earlier comes to a charge that is less compressed: less than 5.5 deg are gained.
    let ca50 = |m: &BurnModel, spark: f64| m.wiebe(&charge(spark), &g).angle_of_fraction_deg(0.5);
    assert!((ca50(&plain, 20.0) - ca50(&plain, 25.5) - 5.5).abs() < 1e-9);
    let gained = ca50(&felt, 20.0) - ca50(&felt, 25.5);
    assert!(gained > 3.0 && gained < 5.0, "{gained}");
}
