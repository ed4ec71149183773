//! Closed-form checks of geometry, gas, orifice, Wiebe function and closed cycles.

use dynocal_plant::combustion::Wiebe;
use dynocal_plant::engine::VirtualEngine;
use dynocal_plant::gas::GasModel;
use dynocal_plant::geometry::Geometry;
use dynocal_plant::inputs::Inputs;
use dynocal_plant::orifice::{self, PsiTable};
use dynocal_plant::params::EngineParams;
use dynocal_plant::state::{CATALYST, EXHAUST};
use std::f64::consts::PI;

fn close(found: f64, expected: f64, relative: f64) {
    let error = (found - expected).abs();
    assert!(
        error <= relative * expected.abs(),
        "{found} against {expected}: {error:e}, allowed {relative:e} relative"
    );
}

/// Valves shut, no wall heat: what is left is piston work.
fn closed_params(gas: GasModel, step_cells: usize, cells_per_deg: usize) -> EngineParams {
    let mut p = EngineParams::thesis();
    p.gas = gas;
    p.intake_valve.lift_m = 0.0;
    p.exhaust_valve.lift_m = 0.0;
    p.heat.scale = 0.0;
    p.stepping.cells_per_deg = cells_per_deg;
    p.stepping.fixed_cells = step_cells;
    p
}

fn closed_engine(p: &EngineParams) -> VirtualEngine {
    let mut e = VirtualEngine::new(p).unwrap();
    e.set_inputs(Inputs { injection_mg: 0.0, ..Inputs::default() }).unwrap();
    e
}

#[test]
fn geometry_volumes_and_derivative() {
    let g = Geometry::thesis();
    let (top, bottom) = g.dead_centres_rad();
    close(g.volume_m3(top), g.clearance_m3(), 1e-8);
    let (r, l, e) = (0.5 * g.stroke_m, g.conrod_m, g.pin_offset_m);
    // True stroke of an offset slider-crank: difference of the stretched and folded positions.
    let stroke = ((l + r).powi(2) - e * e).sqrt() - ((l - r).powi(2) - e * e).sqrt();
    close(g.travel_m(bottom), stroke, 1e-12);
    close(g.volume_m3(bottom), g.clearance_m3() + g.displacement_m3(), 1e-4);
    // Reference numbers of the thesis engine (Table 3.2).
    close(4.0 * g.displacement_m3(), 0.002_001_194_520_336_698, 1e-12);
    close(g.clearance_m3(), 5.621_332_922_294_096e-5, 1e-12);
    let scale = g.dvolume_m3_per_rad(0.5 * PI);
    for i in 0..720 {
        let phi = (f64::from(i) + 0.3).to_radians();
        let h = 1e-3;
        // Fourth-order central difference.
        let fd = (8.0 * (g.volume_m3(phi + h) - g.volume_m3(phi - h))
            - (g.volume_m3(phi + 2.0 * h) - g.volume_m3(phi - 2.0 * h)))
            / (12.0 * h);
        assert!((fd - g.dvolume_m3_per_rad(phi)).abs() < 1e-8 * scale, "{i} deg");
    }
}

/// p V^gamma over a compression from BDC; returns the relative error of p_TDC/p_BDC.
fn compression_error(step_cells: usize) -> f64 {
    let mut e = closed_engine(&closed_params(GasModel::constant_gamma(1.4, 287.0), step_cells, 4));
    // Cylinder 3 (index 2) is at 540 deg, its bottom dead centre, when the engine starts.
    assert_eq!(e.local_angle_deg(2), 540.0);
    e.set_volume(2, [5e-4, 0.0, 0.0], 300.0);
    let start = e.gas_state(2);
    e.advance_angle(180.0);
    assert_eq!(e.local_angle_deg(2), 0.0);
    let end = e.gas_state(2);
    let ratio = end.p_pa / start.p_pa;
    close(ratio, 24.77, 2e-3);
    ratio / (start.volume_m3 / end.volume_m3).powf(1.4) - 1.0
}

#[test]
fn isentropic_compression_and_order() {
    let e: Vec<f64> = [8, 4, 2, 1].into_iter().map(|c| compression_error(c).abs()).collect();
    assert!(e[1] < 1e-4, "1 deg: {:e}", e[1]);
    for pair in e.windows(2) {
        let order = (pair[0] / pair[1]).log2();
        assert!(order > 1.9, "order {order}, errors {e:?}");
    }
}

fn entropy_is_kept(masses: [f64; 3]) {
    let p = closed_params(GasModel::gasoline(), 4, 4);
    let mut e = closed_engine(&p);
    e.set_volume(2, masses, 330.0);
    let (start, ()) = (e.gas_state(2), e.advance_angle(180.0));
    let end = e.gas_state(2);
    // s = integral of cv/T dT + R ln V with cv from the energy polynomials.
    let gas = &p.gas;
    let m = start.mass_kg;
    let thermal = |t_k: f64| -> f64 {
        let t = 1e-3 * t_k;
        (0..3)
            .map(|i| {
                let u = &gas.u_j_kg[i];
                let powers: f64 =
                    (2..7).map(|k| k as f64 * u[k] * t.powi(k as i32 - 1) / (k as f64 - 1.0)).sum();
                m[i] * 1e-3 * (u[1] * t.ln() + powers)
            })
            .sum()
    };
    let change =
        thermal(end.t_k) - thermal(start.t_k) + gas.mass_r_j_k(m) * (end.volume_m3 / start.volume_m3).ln();
    let scale = gas.heat_capacity_j_k(m, 300.0);
    assert!(change.abs() < 1e-4 * scale, "entropy change {change:e} J/K of {scale:e}");
    assert!(end.t_k > 650.0);
}

#[test]
fn variable_heat_capacity_keeps_entropy() {
    // Air with products, and products with fuel vapour: neither can burn.
    entropy_is_kept([3e-4, 0.0, 2e-4]);
    entropy_is_kept([0.0, 1e-5, 4e-4]);
}

#[test]
fn closed_adiabatic_cycle_returns() {
    // 1 bar at TDC, expanded and compressed back: net work is discretisation error only.
    let residual = |cells: usize| {
        let p = closed_params(GasModel::gasoline(), cells, 4);
        let mut e = closed_engine(&p);
        let start = e.gas_state(0);
        let m = 1e5 * start.volume_m3 / (p.gas.r_j_kg_k[0] * 600.0);
        e.set_volume(0, [m, 0.0, 0.0], 600.0);
        let (e0, w0) = (e.state().gas.energy_j[0], e.state().cylinders[0].work_j);
        assert_eq!(w0, 0.0);
        e.advance_angle(180.0);
        let down = e.state().cylinders[0].work_j;
        e.advance_angle(180.0);
        // The work counter restarts at 180 deg, so both strokes are added here.
        let work = down + e.state().cylinders[0].work_j;
        let first_law = e.state().gas.energy_j[0] - e0 + work;
        assert!(first_law.abs() < 2e-14, "first law {first_law:e} J");
        work.abs()
    };
    let w: Vec<f64> = [4, 2, 1].into_iter().map(residual).collect();
    assert!(w[0] < 1e-4, "work residual {:e} J at 1 deg", w[0]);
    assert!(w[0] / w[1] > 6.0 && w[1] / w[2] > 6.0, "third order expected: {w:?}");
}

#[test]
fn energy_polynomials_follow_nasa_heat_capacities() {
    // cp/R of N2 and O2 from the GRI-3.0 NASA-7 sets (low range to 1000 K, then high range).
    let n2 = [
        [3.298677, 0.0014082404, -3.963222e-06, 5.641515e-09, -2.444854e-12],
        [2.92664, 0.0014879768, -5.68476e-07, 1.0097038e-10, -6.753351e-15],
    ];
    let o2 = [
        [3.78245636, -0.00299673416, 9.84730201e-06, -9.68129509e-09, 3.24372837e-12],
        [3.28253784, 0.00148308754, -7.57966669e-07, 2.09470555e-10, -2.16717794e-14],
    ];
    let gas = GasModel::gasoline();
    for t in [300.0f64, 500.0, 800.0, 1200.0, 2000.0, 3000.0] {
        let cp_r = |s: &[[f64; 5]; 2]| -> f64 {
            s[usize::from(t > 1000.0)].iter().enumerate().map(|(k, c)| c * t.powi(k as i32)).sum()
        };
        let cv = gas.r_j_kg_k[0] * (0.79 * cp_r(&n2) + 0.21 * cp_r(&o2) - 1.0);
        // The degree-5 fit covers 230..3300 K to better than 0.75 %.
        close(gas.heat_capacity_j_k([1.0, 0.0, 0.0], t), cv, 7.5e-3);
    }
    for i in 0..3 {
        let mut m = [0.0; 3];
        m[i] = 1.0;
        assert!(gas.energy_j(m, 298.15).abs() < 1e-3, "u(298.15 K) = 0");
    }
}

#[test]
fn lambda_is_an_oxygen_balance() {
    let gas = GasModel::gasoline();
    close(gas.lambda(14.7, 1.0, 0.0), 1.0, 1e-15);
    close(gas.lambda(0.0, 0.0, 3.0), 1.0, 1e-14);
    // Burning any part of a mixture does not change its lambda.
    close(gas.lambda(20.0 - 0.4 * 14.7, 1.0 - 0.4, 0.4 * 15.7), gas.lambda(20.0, 1.0, 0.0), 1e-14);
    assert_eq!(gas.lambda(1.0, 0.0, 0.0), 9.99);
}

#[test]
fn orifice_formula_continuity_symmetry_and_fast_path() {
    let up = [2e5, 300.0, 287.0, 1.4];
    let down = [0.5e5, 350.0, 287.0, 1.4];
    let m = orifice::mass_flow_kg_s(1e-4, up, down);
    let formula = 1e-4 * 2e5 / (287.0f64 * 300.0).sqrt() * 1.4f64.sqrt() * (2.0f64 / 2.4).powf(2.4 / 0.8);
    close(m, formula, 1e-14);
    close(m, 4.667e-2, 1e-4);
    assert_eq!(orifice::mass_flow_kg_s(1e-4, down, up), -m);
    let table = PsiTable::default();
    for i in 0..=32 {
        let g = 1.13 + 0.01 * f64::from(i);
        let c = orifice::critical_ratio(g);
        close(orifice::psi(c * (1.0 + 1e-9), g), orifice::psi(c, g), 1e-12);
        let k = orifice::LINEAR_ABOVE;
        close(orifice::psi(k + 1e-12, g), orifice::psi(k, g), 1e-9);
        for j in 0..200 {
            let pr = (f64::from(j) + 0.5) / 200.0;
            // Near the end points the sub-critical formula loses digits by its difference of powers.
            assert!((table.psi(pr, g) - orifice::psi(pr, g)).abs() < 1e-10, "pr {pr} gamma {g}");
        }
    }
    assert_eq!(orifice::psi(1.0, 1.4), 0.0);
}

#[test]
fn blow_down_between_two_volumes() {
    let gamma = 1.4;
    let mut p = closed_params(GasModel::constant_gamma(gamma, 287.0), 0, 2);
    p.throttle.diameter0_m = 1e-12;
    p.throttle.slope_m_per_deg = 0.0;
    p.exhaust.turbine_m2 = 2e-4;
    p.exhaust.wastegate_discharge = 0.0;
    // A tailpipe of 1e-40 m2 passes less than the last digit.
    p.exhaust.tailpipe_m2 = 1e-40;
    p.exhaust_manifold.ua_w_k = 0.0;
    p.catalyst.ua_w_k = 0.0;
    let mut e = closed_engine(&p);
    let (v1, t1, p1) = (p.exhaust_manifold.volume_m3, 400.0, 4e5);
    e.set_volume(EXHAUST, [p1 * v1 / (287.0 * t1), 0.0, 0.0], t1);
    e.set_volume(CATALYST, [0.0, 0.0, 2e4 * p.catalyst.volume_m3 / (287.0 * 300.0)], 300.0);
    let sum = |e: &VirtualEngine| {
        let g = &e.state().gas;
        let mass: f64 = g.mass_kg.iter().map(|m| m[EXHAUST] + m[CATALYST]).sum();
        (mass, g.energy_j[EXHAUST] + g.energy_j[CATALYST])
    };
    let (m0, e0) = sum(&e);
    // Adiabatic discharge while choked: p/p0 = (1 + (g-1)/2 t/tau)^(-2g/(g-1)).
    let tau = v1 / (2e-4 * orifice::psi_choked(gamma) * (287.0 * t1).sqrt());
    for _ in 0..5 {
        e.advance_time(0.003);
        let x = 1.0 + 0.5 * (gamma - 1.0) * e.state().time_s / tau;
        let expected = p1 * x.powf(-2.0 * gamma / (gamma - 1.0));
        assert!(e.gas_state(CATALYST).p_pa < 0.5 * expected, "still choked");
        close(e.gas_state(EXHAUST).p_pa, expected, 1e-6);
    }
    e.advance_time(1.0);
    let (m1, e1) = sum(&e);
    // Energies are relative to m cv T.
    close(m1, m0, 1e-14);
    assert!((e1 - e0).abs() < 1e-14 * m0 * 717.5 * 400.0, "energy {:e}", e1 - e0);
    close(e.gas_state(EXHAUST).p_pa, e.gas_state(CATALYST).p_pa, 1e-9);
}

#[test]
fn otto_limit() {
    for (gamma, expected) in [(1.4, 0.6003), (1.3, 0.4973)] {
        let p = closed_params(GasModel::constant_gamma(gamma, 287.0), 1, 4);
        let mut e = closed_engine(&p);
        e.set_volume(2, [5e-4, 0.0, 0.0], 300.0);
        let work = |e: &VirtualEngine| e.state().cylinders[2].work_j;
        e.advance_angle(180.0);
        let compression = work(&e);
        let s = e.gas_state(2);
        let before = e.state().gas.energy_j[2];
        e.set_volume(2, s.mass_kg, s.t_k + 1500.0);
        let heat = e.state().gas.energy_j[2] - before;
        e.advance_angle(180.0);
        // The counter was cleared at the first event (540 deg), not in between.
        let efficiency = work(&e) / heat;
        assert!(compression < 0.0);
        close(efficiency, expected, 1e-3);
        close(efficiency, 1.0 - 9.9f64.powf(1.0 - gamma), 1e-3);
    }
}

#[test]
fn wiebe_anchor_points_and_integral() {
    for m in [1.0, 2.0, 2.5, 4.0] {
        let w = Wiebe::new(-12.0, 22.0, m);
        for x in [0.1, 0.5, 0.9] {
            assert!((w.burned(w.angle_of_fraction_deg(x)) - x).abs() < 1e-14);
        }
        close(w.angle_of_fraction_deg(0.9) - w.angle_of_fraction_deg(0.1), 22.0, 1e-14);
        // Midpoint sum of the rate at 0.01 deg against the function itself and against 1.
        let sum: f64 = (0..18_200).map(|i| 0.01 * w.rate_per_deg(-12.0 + 0.01 * (f64::from(i) + 0.5))).sum();
        close(sum, 1.0, 1e-6);
    }
    let w = Wiebe::new(0.0, 10.0, 2.0);
    close(w.a, 0.6102, 1e-4);
    close(w.angle_of_fraction_deg(0.5), 10.434, 1e-4);
}

#[test]
fn a_tail_burns_its_share_later_and_nothing_is_lost() {
    let plain = Wiebe::new(-12.0, 22.0, 2.0);
    let tailed = plain.with_tail(0.2);
    for x in [0.05, 0.1, 0.5, 0.9, 0.97] {
        assert!((tailed.burned(tailed.angle_of_fraction_deg(x)) - x).abs() < 1e-9, "{x}");
        assert!(tailed.angle_of_fraction_deg(x) > plain.angle_of_fraction_deg(x));
    }
    let sum: f64 = (0..30_000).map(|i| 0.01 * tailed.rate_per_deg(-12.0 + 0.01 * (f64::from(i) + 0.5))).sum();
    close(sum, 1.0, 1e-6);
    // Long after the main burn what is left is the tail's.
    let late = 40.0;
    assert!(1.0 - plain.burned(late) < 2e-3);
    close((1.0 - tailed.burned(late)) / 0.2, 1.0 - Wiebe::new(-12.0, 55.0, 2.0).burned(late), 0.05);
}
