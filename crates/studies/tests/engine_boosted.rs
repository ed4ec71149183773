//! Level F1 as a whole engine: balances, turbocharger at rest, cams, recirculation, misfire, knock, full load.

use dynocal_plant::end_gas::KnockModel;
use dynocal_plant::engine::VirtualEngine;
use dynocal_plant::error::PlantError;
use dynocal_plant::full_load::{LoadLimits, LoadPoint, LoadRequest, hold_load};
use dynocal_plant::inputs::Inputs;
use dynocal_plant::params::EngineParams;
use dynocal_plant::statics::steady;

fn params() -> EngineParams {
    EngineParams::named("gtdi_2l").unwrap()
}

fn held(speed_rpm: f64, torque_nm: f64) -> (VirtualEngine, LoadPoint) {
    let mut engine = VirtualEngine::new(&params()).unwrap();
    let request = LoadRequest { speed_rpm, torque_nm, lambda: 1.0, limits: LoadLimits::default() };
    let point = hold_load(&mut engine, request).unwrap();
    (engine, point)
}

fn contents(e: &VirtualEngine) -> (f64, f64) {
    let g = &e.state().gas;
    let gas: f64 = g.mass_kg.iter().flatten().sum();
    (gas + g.liquid_kg.iter().sum::<f64>(), g.energy_j.iter().sum())
}

/// First law and mass from `before` to the engine's state, relative to the heat of combustion and to the air.
fn balance(e: &VirtualEngine, before: &VirtualEngine) -> (f64, f64) {
    let ((m0, e0), l0) = (contents(before), before.state().ledger);
    let ((m1, e1), l) = (contents(e), e.state().ledger);
    let burned = e.params().gas.lhv_j_kg * (l.burned_kg - l0.burned_kg);
    let energy = e1 - e0
        + (l.work_j - l0.work_j)
        + (l.wall_heat_j - l0.wall_heat_j)
        + (l.evaporation_j - l0.evaporation_j)
        + (l.bound_j - l0.bound_j)
        + (l.turbine_j - l0.turbine_j)
        - (l.compressor_j - l0.compressor_j)
        - (l.enthalpy_in_j - l0.enthalpy_in_j)
        - burned;
    let mass = m1 - m0 - (l.mass_in_kg - l0.mass_in_kg) - (l.injected_kg - l0.injected_kg);
    (energy.abs() / burned, mass.abs() / m0)
}

#[test]
fn first_law_and_mass_over_boosted_cycles() {
    // Stoichiometric and rich, with recirculation: every heat, work and bound energy must be on the sheet.
    for (speed_rpm, wastegate_mm, injection_mg, egr_mm) in
        [(2000.0, 10.0, 60.0, 0.0), (3000.0, 18.0, 90.0, 5.0), (1500.0, 28.0, 20.0, 8.0)]
    {
        let mut e = VirtualEngine::new(&params()).unwrap();
        let throttle_deg = if wastegate_mm < 20.0 { 90.0 } else { 16.0 };
        let u = Inputs {
            speed_rpm,
            wastegate_mm,
            injection_mg,
            egr_mm,
            throttle_deg,
            spark_deg: 5.0,
            ..Inputs::default()
        };
        e.set_inputs(u).unwrap();
        e.advance_time(2.0);
        let before = e.clone();
        e.advance_angle(720.0);
        let (energy, mass) = balance(&e, &before);
        assert!(energy < 1e-12, "{speed_rpm} rpm: energy {energy:e} of the heat of combustion");
        assert!(mass < 1e-13, "{speed_rpm} rpm: mass {mass:e}");
        let l = e.state().ledger;
        assert!(l.turbine_j > before.state().ledger.turbine_j && l.compressor_j > 0.0);
    }
}

#[test]
fn shaft_power_balances_at_steady_state() {
    let (mut e, p) = held(2500.0, 250.0);
    assert!(p.reached && p.settled, "{p:?}");
    let turbo = e.params().turbocharger.unwrap();
    let (l0, w0, t0) = (e.state().ledger, e.state().gas.shaft_rad_s, e.state().time_s);
    e.advance_angle(720.0 * 20.0);
    let (l, w, dt) = (e.state().ledger, e.state().gas.shaft_rad_s, e.state().time_s - t0);
    let (turbine, compressor) = (l.turbine_j - l0.turbine_j, l.compressor_j - l0.compressor_j);
    let friction = turbo.friction_w_s2 * w * w * dt;
    let kinetic = 0.5 * turbo.inertia_kg_m2 * (w * w - w0 * w0);
    let off = turbo.mechanical_efficiency * turbine - compressor - friction - kinetic;
    // Friction is taken at the mean speed of a pulsating shaft.
    assert!(off.abs() < 2e-4 * compressor, "{off} J of {compressor} J");
    assert!(kinetic.abs() < 0.01 * compressor, "not at rest: {kinetic} J");
}

#[test]
fn boost_follows_the_wastegate() {
    let mut e = VirtualEngine::new(&params()).unwrap();
    let u = Inputs {
        speed_rpm: 2500.0,
        throttle_deg: 90.0,
        spark_deg: 6.0,
        injection_mg: 45.0,
        ..Inputs::default()
    };
    let mut before: Option<(f64, f64)> = None;
    for wastegate_mm in [28.0, 24.0, 20.0] {
        let y = steady(&mut e, Inputs { wastegate_mm, ..u }, 4.0, 0.5).unwrap();
        if let Some((boost, speed)) = before {
            assert!(y.boost_kpa > boost + 2.0 && y.turbo_rpm > speed, "{wastegate_mm} mm: {y:?}");
        }
        assert!(y.boost_kpa > 101.0 && y.exhaust_kpa > 101.325 && y.surge == 0.0);
        before = Some((y.boost_kpa, y.turbo_rpm));
    }
}

#[test]
fn cams_act_between_the_nodes_of_the_grid() {
    let mut e = VirtualEngine::new(&EngineParams::thesis()).unwrap();
    let mut air = |mop: f64| {
        let u = Inputs { intake_mop_deg_btdc: mop, injection_mg: 0.0, ..Inputs::default() };
        steady(&mut e, u, 2.0, 0.6).unwrap().map_kpa
    };
    let (a, b) = (air(231.0), air(231.25));
    let (quarter, half) = (air(231.0625), air(231.125));
    assert!((b - a).abs() > 1e-4, "{a} {b}");
    // Linear to a few per cent over a quarter of a degree.
    assert!((half - 0.5 * (a + b)).abs() < 0.05 * (b - a).abs(), "{a} {quarter} {half} {b}");
    assert!((quarter - (0.75 * a + 0.25 * b)).abs() < 0.05 * (b - a).abs(), "{a} {quarter} {half} {b}");
}

#[test]
fn more_overlap_keeps_more_residual_gas_at_part_load() {
    let mut e = VirtualEngine::new(&params()).unwrap();
    let mut residual = Vec::new();
    for intake_mop_deg_btdc in [231.0, 241.0, 251.0, 261.0] {
        let u = Inputs { intake_mop_deg_btdc, throttle_deg: 12.0, injection_mg: 12.0, ..Inputs::default() };
        residual.push(steady(&mut e, u, 3.0, 0.5).unwrap().residual);
    }
    assert!(residual.windows(2).all(|w| w[1] > w[0]), "{residual:?}");
    assert!(residual[0] > 0.03 && residual[3] < 0.45, "{residual:?}");
}

#[test]
fn recirculation_slows_the_burn_and_lowers_nitric_oxide() {
    let (mut e, p) = held(2000.0, 70.0);
    let mut last: Option<dynocal_plant::outputs::Outputs> = None;
    for egr_mm in [0.0, 4.0, 6.0, 8.0] {
        let mut u = Inputs { egr_mm, ..p.inputs };
        let mut y = steady(&mut e, u, 2.0, 0.6).unwrap();
        for _ in 0..3 {
            // Lambda 1: fuel follows the air, which recirculated gas displaces a little.
            u.injection_mg = 1e3 * y.air_g_s * 0.06 / 4.0 / 14.7;
            y = steady(&mut e, u, 1.0, 0.6).unwrap();
        }
        assert!((y.lambda - 1.0).abs() < 0.02, "{y:?}");
        if let Some(b) = last {
            assert!(y.egr_rate > b.egr_rate + 0.02 && y.residual > b.residual + 0.02, "{y:?}");
            assert!(y.burn_deg > 1.02 * b.burn_deg, "burn {} after {}", y.burn_deg, b.burn_deg);
            assert!(y.no_ppm < 0.8 * b.no_ppm, "NO {} after {}", y.no_ppm, b.no_ppm);
            assert!(y.map_kpa > b.map_kpa);
        }
        last = Some(y);
    }
    // Composition of the intake manifold: what recirculates is burned gas of the exhaust manifold.
    let (intake, rate) = (e.gas_state(5).mass_kg, last.unwrap().egr_rate);
    let burned = intake[2] / intake.iter().sum::<f64>();
    assert!((burned / rate - 1.0).abs() < 0.1, "{burned} in the manifold, {rate} through the valve");
}

#[test]
fn an_engine_without_the_path_refuses_recirculation() {
    let mut e = VirtualEngine::new(&EngineParams::thesis()).unwrap();
    let wrong = e.set_inputs(Inputs { egr_mm: 5.0, ..Inputs::default() });
    assert!(matches!(wrong, Err(PlantError::Input { name: "egr", high: 0.0, .. })));
}

#[test]
fn lean_limit_and_dilution_limit_put_the_flame_out() {
    let b = params().burn;
    // By definition half of the cycles burn at the limits.
    assert!((b.stability(b.lean_limit_lambda, 0.0) - 0.5).abs() < 1e-3);
    let limit = b.dilution.unwrap().limit;
    assert!((b.dilution_share(limit) - 0.5).abs() < 1e-12);
    assert!(b.stability(1.0, 0.1) > 0.999 && b.stability(2.5, 0.1) < 1e-3 && b.stability(1.0, 0.6) < 1e-3);
    let (mut e, p) = held(2000.0, 70.0);
    let mut burn = Vec::new();
    let mut at = |lambda: f64| {
        let u = Inputs { injection_mg: p.inputs.injection_mg / lambda, spark_deg: 30.0, ..p.inputs };
        let y = steady(&mut e, u, 2.5, 0.6).unwrap();
        burn.push(y.burn_deg);
        (y.imep_bar / u.injection_mg, y.hc_ppm)
    };
    let (lean, very, out) = (at(1.3), at(1.65), at(2.2));
    // Work per fuel collapses and unburned fuel leaves.
    assert!(very.0 < 0.85 * lean.0 && out.0 < 0.1 * lean.0, "{lean:?} {very:?} {out:?}");
    assert!(very.1 > 3.0 * lean.1 && out.1 > 10.0 * lean.1, "{lean:?} {very:?} {out:?}");
    assert!(burn[1] > 1.2 * burn[0], "{burn:?}");
}

#[test]
fn mixture_moves_exhaust_temperature_and_emissions_as_in_class() {
    let (mut e, p) = held(2000.0, 70.0);
    let mut rows = Vec::new();
    for lambda in [0.7, 0.8, 0.9, 1.0, 1.1, 1.2, 1.3] {
        let u = Inputs { injection_mg: p.inputs.injection_mg / lambda, ..p.inputs };
        rows.push((lambda, steady(&mut e, u, 2.5, 0.6).unwrap()));
    }
    let y = |k: usize| rows[k].1;
    // Exhaust coolest at the ends, hottest at lambda 1.
    assert!((0..3).all(|k| y(k + 1).egt_k > y(k).egt_k), "{rows:?}");
    assert!((3..6).all(|k| y(k + 1).egt_k < y(k).egt_k), "{rows:?}");
    // NO peaks on the lean side of 1, CO only rises rich.
    let peak = (0..7).max_by(|a, b| y(*a).no_ppm.total_cmp(&y(*b).no_ppm)).unwrap();
    assert!((3..=4).contains(&peak) && y(2).no_ppm < 0.5 * y(3).no_ppm && y(6).no_ppm < 0.3 * y(4).no_ppm);
    assert!((0..3).all(|k| y(k).co_pct > y(k + 1).co_pct + 1.0) && y(4).co_pct < 1.0);
    // Class: about 4 % CO at lambda 0.9, 8 % at 0.8 (water-gas equilibrium).
    assert!(
        (y(2).co_pct - 4.0).abs() < 1.0 && (y(1).co_pct - 7.5).abs() < 1.5,
        "{} {}",
        y(2).co_pct,
        y(1).co_pct
    );
}

fn knock_of_next_cycle(e: &mut VirtualEngine) -> f64 {
    e.advance_angle(2.0 * 720.0);
    e.cycle_log()[0].knock
}

#[test]
fn the_knock_integral_is_the_quadrature_of_its_formula() {
    let (mut e, p) = held(2000.0, 250.0);
    let cooled = knock_of_next_cycle(&mut e.clone());
    // The same cycle with an isentropic end gas.
    let mut params = e.params().clone();
    params.knock.as_mut().unwrap().wall_share = 0.0;
    let state = e.snapshot();
    e = VirtualEngine::new(&params).unwrap();
    e.restore(&state).unwrap();
    let isentropic = knock_of_next_cycle(&mut e.clone());
    // Walls of 440 K take 10 to 30 K from gas of 800 to 900 K, at 0.5 to 0.7 % of the rate for a kelvin.
    assert!((0.75..0.97).contains(&(cooled / isentropic)), "{cooled} against {isentropic}");
    let model = params.knock.unwrap();
    let c = 0;
    // From intake closing of the first cylinder: 615 deg.
    while !(615.0..617.0).contains(&e.local_angle_deg(c)) {
        e.advance_angle(1.0);
    }
    let (start, gas) = (e.gas_state(c), e.params().gas.clone());
    let r = gas.mass_r_j_k(start.mass_kg);
    let step_deg = 0.5;
    let dt_s = step_deg / (6.0 * p.inputs.speed_rpm);
    let (mut t_u, mut sum) = (start.t_k, 0.0);
    let (mut p_before, mut delay_before) = (start.p_pa, model.delay_s(start.p_pa, start.t_k));
    loop {
        e.advance_angle(step_deg);
        let now = e.gas_state(c);
        // Isentrope with the heat capacity of the polynomials, second order in the step.
        let kappa = |t: f64| r / (gas.heat_capacity_j_k(start.mass_kg, t) + r);
        let ln = (now.p_pa / p_before).ln();
        let middle = t_u * (0.5 * kappa(t_u) * ln).exp();
        t_u *= (kappa(middle) * ln).exp();
        let delay = model.delay_s(now.p_pa, t_u);
        let angle = e.local_angle_deg(c);
        let phi = if angle > 360.0 { angle - 720.0 } else { angle };
        // Up to 90 % burned: a part of the last step.
        let ca90 = e.state().cylinders[c].wiebe.angle_of_fraction_deg(0.9);
        let part = if phi < 0.0 { 1.0 } else { ((ca90 - phi) / step_deg + 1.0).clamp(0.0, 1.0) };
        sum += 0.5 * part * dt_s * (1.0 / delay + 1.0 / delay_before);
        (p_before, delay_before) = (now.p_pa, delay);
        if part < 1.0 {
            break;
        }
    }
    let found = e.state().cylinders[c].end_gas.knock;
    assert!((found / sum - 1.0).abs() < 0.02, "{found} against {sum}");
    assert!(found > 0.3, "{found}");
}

#[test]
fn the_ignition_delay_is_that_of_the_publication() {
    // Douaud and Eyzat: 17.68 ms (ON/100)^3.402 p^-1.7 exp(3800/T), p in atm.
    let k = KnockModel {
        octane: 95.0,
        delay_factor: 1.0,
        wall_share: 0.0,
        oxygen_exponent: 0.0,
        fuel_exponent: 0.0,
    };
    let expected = 17.68e-3 * 0.95f64.powf(3.402) * 30f64.powf(-1.7) * (3800.0f64 / 800.0).exp();
    assert!((k.delay_s(30.0 * 101_325.0, 800.0) / expected - 1.0).abs() < 1e-12);
    // More octane, less pressure, less temperature: later.
    let higher = KnockModel { octane: 98.0, ..k };
    assert!(higher.delay_s(3e6, 800.0) > k.delay_s(3e6, 800.0));
    assert!(k.delay_s(2e6, 800.0) > k.delay_s(3e6, 800.0) && k.delay_s(3e6, 760.0) > k.delay_s(3e6, 800.0));
}

#[test]
fn more_spark_knocks_more() {
    // The controller stands at the limit there, so a little more passes it.
    let (e, p) = held(3000.0, 340.0);
    assert!(p.knock_limited && (p.outputs.knock - 1.0).abs() < 0.03, "{p:?}");
    let mut last = 0.0;
    for advance in [-3.0, -1.5, 1.5, 3.0] {
        // Four cycles: before the boost answers to the cooler exhaust.
        let mut e = e.clone();
        e.set_inputs(Inputs { spark_deg: p.inputs.spark_deg + advance, ..p.inputs }).unwrap();
        e.advance_angle(4.0 * 720.0);
        let knock = e.outputs().knock;
        assert!(knock > last && ((knock - 1.0) * advance > 0.0), "{advance} deg: {knock} after {last}");
        last = knock;
    }
}

#[test]
fn a_boosted_state_is_saved_whole_and_continues() {
    let (mut e, _) = held(2500.0, 200.0);
    e.advance_angle(333.0);
    let mut numbers = Vec::new();
    e.state().to_numbers(&mut numbers);
    let mut other = VirtualEngine::new(&params()).unwrap();
    let mut state = other.snapshot();
    assert!(state.load_numbers(&numbers));
    other.restore(&state).unwrap();
    e.advance_time(0.4);
    other.advance_time(0.4);
    assert_eq!(e.state(), other.state());
}

#[test]
fn order_of_convergence_with_all_parts() {
    let torque = |fixed: usize| {
        let mut p = params();
        p.stepping.cells_per_deg = 4;
        p.stepping.fixed_cells = fixed;
        let mut e = VirtualEngine::new(&p).unwrap();
        let u = Inputs { throttle_deg: 30.0, injection_mg: 30.0, spark_deg: 12.0, ..Inputs::default() };
        steady(&mut e, u, 4.0, 0.6).unwrap().torque_nm
    };
    let exact = torque(1);
    let (two, one) = ((torque(8) - exact).abs(), (torque(4) - exact).abs());
    assert!(one < 3e-4 * exact.abs() && two < 2e-3 * exact.abs(), "{two} and {one} of {exact}");
}

#[test]
fn spark_off_best_costs_what_a_real_engine_loses() {
    let (_, p) = held(2000.0, 70.0);
    let sweep = dynocal_studies::engine::class_values::spark_sweep(&params(), &p).unwrap();
    for loss in sweep.loss_pct {
        assert!(
            (0.7..=1.5).contains(&loss),
            "{:?} % lost 5.5 deg off {} deg",
            sweep.loss_pct,
            sweep.best_deg
        );
    }
    // Regression of Crossley and Cook, another engine: within 2.5 % of torque up to 8.25 deg either way.
    for k in 3..=9 {
        let off = (sweep.ratio[k] - sweep.published[k]).abs();
        assert!(off < 0.025, "{} deg: {} against {}", sweep.off_deg[k], sweep.ratio[k], sweep.published[k]);
    }
}

#[test]
fn random_inputs_over_the_whole_box_keep_the_balances() {
    for (params, seed) in [(params(), 3), (EngineParams::thesis(), 4)] {
        let run = dynocal_studies::engine::class_values::random_box(&params, 40.0, 0.05, seed).unwrap();
        assert!(run.energy_error < 1e-10 && run.mass_error < 1e-10, "{run:?}");
        assert!(run.least_mass_kg > -1e-12 && run.pmax_bar < 400.0, "{run:?}");
    }
}

#[test]
fn full_load_is_that_of_its_class() {
    // Case 14: 366 Nm to 4500 rpm below 240 kPa. At 1750 rpm knock leaves less: 336 Nm on the measured engine of the class,
    // about 300 at 1500 and 230 at 1250 rpm, where the surge line ends it.
    for (speed, least) in
        [(1250.0, 218.5), (1500.0, 285.0), (1750.0, 336.0), (3000.0, 362.3), (4500.0, 362.3)]
    {
        let (_, p) = held(speed, 366.0);
        let y = p.outputs;
        assert!(y.torque_nm > least && y.torque_nm < 369.7 && p.settled, "{speed} rpm: {p:?}");
        assert!(y.map_kpa < 240.5 && y.pmax_bar < 111.0 && y.knock < 1.03, "{speed} rpm: {y:?}");
        assert!(y.egt_k < 1233.0 && y.turbo_rpm < 200e3 && y.surge < 0.01, "{speed} rpm: {y:?}");
    }
    // Measured island: 237 to 242 g/kWh at 9 to 15 bar, 2500 to 4000 rpm; full load costs more.
    let (_, p) = held(3000.0, 223.0);
    assert!((230.0..=248.0).contains(&p.outputs.bsfc_g_kwh), "{:?}", p.outputs);
    let (_, full) = held(3000.0, 366.0);
    assert!(full.outputs.bsfc_g_kwh > 1.1 * p.outputs.bsfc_g_kwh, "{:?}", full.outputs);
}
