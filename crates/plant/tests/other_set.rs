//! The set that differs in structure: it runs, it balances, and it is another engine than `gtdi_2l`.

use dynocal_plant::engine::VirtualEngine;
use dynocal_plant::full_load::{Barrier, LoadLimits, LoadPoint, LoadRequest, hold_load};
use dynocal_plant::heat::{HeatLaw, hohenberg};
use dynocal_plant::inputs::Inputs;
use dynocal_plant::params::EngineParams;

fn held(set: &str, speed_rpm: f64, torque_nm: f64) -> (VirtualEngine, LoadPoint) {
    let mut engine = VirtualEngine::new(&EngineParams::named(set).unwrap()).unwrap();
    let request = LoadRequest { speed_rpm, torque_nm, lambda: 1.0, limits: LoadLimits::default() };
    let point = hold_load(&mut engine, request).unwrap();
    (engine, point)
}

#[test]
fn it_differs_in_structure_and_not_only_in_size() {
    let other = EngineParams::named("other_1_8l").unwrap();
    let base = EngineParams::named("gtdi_2l").unwrap();
    assert_eq!((other.heat.law, base.heat.law), (HeatLaw::Hohenberg, HeatLaw::Woschni));
    assert!(other.burn.tail_share > 0.0 && base.burn.tail_share == 0.0);
    assert!(other.intake_valve.duration_deg != base.intake_valve.duration_deg);
    assert!(other.knock.unwrap().octane < base.knock.unwrap().octane);
    assert!(other.gas.afr_stoich < base.gas.afr_stoich && other.geometry.bore_m < base.geometry.bore_m);
    // The same inputs give another torque and another exhaust.
    let u = Inputs { throttle_deg: 16.0, injection_mg: 20.0, spark_deg: 18.0, ..Inputs::default() };
    let [a, b] = ["gtdi_2l", "other_1_8l"].map(|set| {
        let mut e = VirtualEngine::new(&EngineParams::named(set).unwrap()).unwrap();
        dynocal_plant::statics::steady(&mut e, u, 2.0, 0.6).unwrap()
    });
    assert!(b.burn_deg > 1.1 * a.burn_deg, "10 to 90 %: {} and {} deg", a.burn_deg, b.burn_deg);
    assert!((a.lambda / b.lambda - 1.0).abs() > 0.02, "lambda {} and {}", a.lambda, b.lambda);
    assert!((a.egt_k - b.egt_k).abs() > 5.0, "exhaust {} and {} K", a.egt_k, b.egt_k);
}

#[test]
fn part_load_and_boost_are_held_and_the_first_law_holds() {
    let (mut e, p) = held("other_1_8l", 2000.0, 60.0);
    assert!(p.reached && p.settled && (p.outputs.ca50_deg - 8.0).abs() < 0.5, "{p:?}");
    let contents = |e: &VirtualEngine| e.state().gas.energy_j.iter().sum::<f64>();
    let (e0, l0) = (contents(&e), e.state().ledger);
    e.advance_angle(720.0);
    let (e1, l) = (contents(&e), e.state().ledger);
    let burned = e.params().gas.lhv_j_kg * (l.burned_kg - l0.burned_kg);
    let off = e1 - e0
        + (l.work_j - l0.work_j)
        + (l.wall_heat_j - l0.wall_heat_j)
        + (l.evaporation_j - l0.evaporation_j)
        + (l.bound_j - l0.bound_j)
        + (l.turbine_j - l0.turbine_j)
        - (l.compressor_j - l0.compressor_j)
        - (l.enthalpy_in_j - l0.enthalpy_in_j)
        - burned;
    assert!(off.abs() < 1e-12 * burned, "{off} J of {burned} J");
    let (_, p) = held("other_1_8l", 2500.0, 200.0);
    assert!(p.reached && p.outputs.map_kpa > 101.0, "{p:?}");
    // 91 octane against 98, at the same mean effective pressure.
    let displacement = |set: &str| EngineParams::named(set).unwrap().displacement_m3();
    let (_, base) = held("gtdi_2l", 2500.0, 200.0 * displacement("gtdi_2l") / displacement("other_1_8l"));
    // Both may stand at the limit of knock: the spark that it leaves tells them apart.
    assert!(p.knock_limited && p.outputs.ca50_deg > base.outputs.ca50_deg + 2.0, "{p:?} and {base:?}");
}

/// At full load and 5500 rpm the wastegate has hardly any authority left: the controller goes on turning it, and nothing moves.
#[test]
fn full_load_at_high_speed_rests_although_the_wastegate_still_turns() {
    let (_, p) = held("other_1_8l", 5500.0, 1000.0);
    assert!(p.settled && !p.reached && p.barrier == Some(Barrier::Spent), "{p:?}");
    assert!(p.passed().is_none(), "{p:?}");
}

/// A motored cycle: the heat in the ledger is the integral of Hohenberg's coefficient over the surface.
#[test]
fn wall_heat_of_a_motored_cycle_is_that_of_the_correlation() {
    let mut p = EngineParams::named("other_1_8l").unwrap();
    p.stepping.fixed_cells = 1;
    let mut e = VirtualEngine::new(&p).unwrap();
    e.set_inputs(Inputs { injection_mg: 0.0, speed_rpm: 2000.0, ..Inputs::default() }).unwrap();
    e.advance_time(2.0);
    let g = &p.geometry;
    let (speed, step) = (g.mean_piston_speed_m_s(2000.0), 0.5);
    let before = e.state().ledger.cylinder_heat_j;
    let mut expected = 0.0;
    for _ in 0..1440 {
        e.advance_angle(step);
        for c in 0..4 {
            let gas = e.gas_state(c);
            let [h] = hohenberg(p.heat.scale, [gas.volume_m3], [gas.p_pa], [gas.t_k], speed);
            let phi = e.local_angle_deg(c).to_radians();
            expected += h * g.wall_area_m2(phi) * (gas.t_k - p.heat.wall_k) * step / (6.0 * 2000.0);
        }
    }
    let found = e.state().ledger.cylinder_heat_j - before;
    assert!((found / expected - 1.0).abs() < 0.01, "{found} J for {expected} J");
}
