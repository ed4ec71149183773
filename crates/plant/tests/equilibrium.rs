//! Equilibrium of burned gas, its energy, and the rates of nitric oxide.

use dynocal_plant::dissociation::{BurnedTable, FREEZE_K, frozen};
use dynocal_plant::equilibrium::*;
use dynocal_plant::nitric_oxide::{Zeldovich, ZeldovichTable, rate_constants};

fn close(found: f64, expected: f64, relative: f64, what: &str) {
    assert!((found / expected - 1.0).abs() < relative, "{what}: {found} against {expected}");
}

/// Mole fractions from Cantera 3.2 (`equilibrate("TP")`, gri30 thermodynamics, the same eleven species and atoms):
/// lambda, T \[K\], p \[Pa\], then CO2, H2O, N2, O2, CO, H2, OH, O, H, N, NO.
const CANTERA: [(f64, f64, f64, [f64; 11]); 5] = [
    (
        1.0,
        2500.0,
        30e5,
        [
            0.120886,
            0.121332,
            0.732864,
            0.00463281,
            0.0120167,
            0.0019481,
            0.00262981,
            0.000181121,
            0.00020412,
            4.61934e-8,
            0.00330517,
        ],
    ),
    (
        0.8,
        2500.0,
        30e5,
        [
            0.0827333,
            0.128034,
            0.694339,
            5.66862e-5,
            0.0743482,
            0.0185842,
            0.000898479,
            2.00348e-5,
            0.000630453,
            4.49628e-8,
            0.000355864,
        ],
    ),
    (
        1.2,
        2500.0,
        30e5,
        [
            0.108173,
            0.102816,
            0.741174,
            0.0300587,
            0.00422146,
            0.000648087,
            0.00386366,
            0.000461352,
            0.000117733,
            4.64545e-8,
            0.00846652,
        ],
    ),
    (
        1.0,
        2000.0,
        5e5,
        [
            0.131363,
            0.124784,
            0.738932,
            0.00107156,
            0.00238645,
            0.000495136,
            0.00040972,
            9.85288e-6,
            1.63019e-5,
            3.50777e-10,
            0.000531903,
        ],
    ),
    (
        1.0,
        3000.0,
        80e5,
        [
            0.0970752, 0.112264, 0.717645, 0.0115167, 0.0337436, 0.00527467, 0.00911407, 0.00136646,
            0.00129161, 1.33366e-6, 0.0107072,
        ],
    ),
];

#[test]
fn mole_fractions_agree_with_an_independent_program() {
    for (lambda, t_k, p_pa, expected) in CANTERA {
        let found = burned(lambda, t_k, p_pa).unwrap();
        for (i, (x, e)) in found.x.iter().zip(expected).enumerate() {
            close(*x, e, 2e-5, &format!("lambda {lambda}, {t_k} K, species {i}"));
        }
    }
}

#[test]
fn atoms_and_the_laws_of_mass_action_hold_over_the_whole_range() {
    for k in 0..=20 {
        let lambda = 0.6 + 0.07 * f64::from(k);
        for t_k in [1400.0, 1700.0, 2100.0, 2600.0, 3200.0] {
            for p_pa in [1e5, 20e5, 150e5] {
                let gas = burned(lambda, t_k, p_pa).unwrap_or_else(|| panic!("{lambda} {t_k} {p_pa}"));
                let x = &gas.x;
                close(x.iter().sum(), 1.0, 1e-10, "sum");
                let carbon = gas.moles * (x[CO2] + x[CO]);
                let hydrogen = gas.moles * (2.0 * x[H2O] + 2.0 * x[H2] + x[OH] + x[H]);
                close(carbon, FUEL.0, 1e-9, "carbon");
                close(hydrogen, FUEL.1, 1e-9, "hydrogen");
                // Two reactions that conserve moles: no pressure in them. O + OH = O2 + H and CO + H2O = CO2 + H2
                // must give one constant for each temperature, whatever lambda and pressure.
                let reference = burned(1.0, t_k, 30e5).unwrap().x;
                let shift = |y: &[f64; SPECIES]| y[CO2] * y[H2] / (y[CO] * y[H2O]);
                let swap = |y: &[f64; SPECIES]| y[O2] * y[H] / (y[O] * y[OH]);
                close(shift(x), shift(&reference), 1e-8, "water gas");
                close(swap(x), swap(&reference), 1e-8, "O + OH");
            }
        }
    }
}

#[test]
fn the_water_gas_constant_is_the_textbook_one() {
    // Heywood 4.9: K = x_CO x_H2O/(x_CO2 x_H2) = 3.5 at 1740 K.
    let x = burned(0.9, FREEZE_K, 10e5).unwrap().x;
    close(x[CO] * x[H2O] / (x[CO2] * x[H2]), 3.5, 0.03, "water gas at 1740 K");
}

#[test]
fn limits_of_temperature_and_mixture() {
    // Cold and lean: complete combustion; air left over.
    let lean = burned(1.5, 1300.0, 10e5).unwrap().x;
    let complete = frozen(1.5).unwrap().x;
    for i in [CO2, H2O, N2, O2] {
        close(lean[i], complete[i], 2e-3, "lean and cold");
    }
    assert!(lean[CO] < 1e-6 && lean[NO] < 1e-3);
    // Hotter and at less pressure: more dissociation (Le Chatelier).
    let x = |t: f64, p: f64| burned(1.0, t, p).unwrap().x;
    assert!(x(2600.0, 30e5)[CO] > x(2400.0, 30e5)[CO] && x(2600.0, 5e5)[CO] > x(2600.0, 30e5)[CO]);
}

#[test]
fn held_energy_is_that_of_equilibrium() {
    let table = BurnedTable::default();
    for lambda in [0.8, 1.0, 1.2] {
        let cold = frozen(lambda).unwrap();
        let products_kg = cold.mass_kg() * 15.7 * f64::min(lambda, 1.0) / (1.0 + 14.7 * lambda);
        let held = table.held(lambda, 1.0);
        for t_k in [2300.0, 2500.0, 2700.0] {
            let hot = burned(lambda, t_k, 30e5).unwrap();
            let expected = (hot.internal_energy_j(t_k) - cold.internal_energy_j(t_k)) / products_kg;
            // Held energy also takes off the heat capacity that vapour has too much, rich.
            let surplus = held.surplus_j_kg_k * (t_k - 1500.0);
            // The two-point exponential, less its value at 1500 K.
            let error = (held.at(t_k).0 + surplus - expected).abs();
            assert!(error < 0.03 * expected.abs() + 6e3, "{lambda}, {t_k} K: {error} J/kg of {expected}");
        }
        let h = 0.01;
        let slope = (held.at(2500.0 + h).0 - held.at(2500.0 - h).0) / (2.0 * h);
        close(held.at(2500.0).1, slope, 1e-6, "derivative");
        assert_eq!(held.at(1499.0), (0.0, 0.0));
        assert!(held.at(1500.0 + 1e-9).0.abs() < 1e-3, "continuous");
    }
    // Equilibrium at lambda 1, 2500 K, 30 bar holds 160 kJ/kg, six per cent of the heat of combustion (Cantera: 157).
    assert!((table.held(1.0, 1.0).at(2500.0).0 - 157e3).abs() < 8e3);
}

#[test]
fn rates_of_nitric_oxide() {
    // R1 = k1 [O][N2], with the published constant at 2500 K.
    let k1 = 1.47e13 * 2500f64.powf(0.3) * (-75_286.8 / (1.987_204 * 2500.0f64)).exp();
    close(rate_constants(2500.0)[0], k1, 1e-12, "k1");
    let gas = burned(1.0, 2500.0, 30e5).unwrap();
    let z = Zeldovich::of(&gas, 2500.0);
    close(z.r1, k1 * 0.000181121 * 0.732864, 1e-4, "R1 from the fractions of the independent program");
    // Independent: steady nitrogen atoms with forward and reverse rates written out, reverse from equilibrium.
    let [k1, k2, k3] = rate_constants(2500.0);
    let x = &gas.x;
    let [r1, r2, r3] = [
        k1 * x[NO] * x[N] / (x[O] * x[N2]),
        k2 * x[NO] * x[O] / (x[N] * x[O2]),
        k3 * x[NO] * x[H] / (x[N] * x[OH]),
    ];
    let reverse = [
        k1 * x[O] * x[N2] / (x[NO] * x[N]),
        k2 * x[N] * x[O2] / (x[NO] * x[O]),
        k3 * x[N] * x[OH] / (x[NO] * x[H]),
    ];
    assert!(r1 > 0.0 && r2 > 0.0 && r3 > 0.0);
    let c = 1e-6 * 30e5 / (R_J_MOL_K * 2500.0);
    for x_no in [0.0, 0.3 * x[NO], 0.9 * x[NO], 1.5 * x[NO]] {
        let n = (k1 * x[O] * x[N2] + reverse[1] * x_no * x[O] + reverse[2] * x_no * x[H])
            / (reverse[0] * x_no + k2 * x[O2] + k3 * x[OH]);
        let direct = c
            * (k1 * x[O] * x[N2] - reverse[0] * n * x_no + k2 * n * x[O2] - reverse[1] * x_no * x[O]
                + k3 * n * x[OH]
                - reverse[2] * x_no * x[H]);
        let found = z.rate(x_no, 2500.0, 30e5);
        assert!(
            (found - direct).abs() < 1e-6 * z.rate(0.0, 2500.0, 30e5),
            "{x_no}: {found} against {direct}"
        );
    }
    assert!(z.rate(z.x_equilibrium, 2500.0, 30e5).abs() < 1e-12);
    // Faster when hot, slower rich: factors between 2300 and 2700 K of more than ten.
    let rate = |lambda: f64, t: f64| Zeldovich::of(&burned(lambda, t, 30e5).unwrap(), t).rate(0.0, t, 30e5);
    assert!(rate(1.0, 2700.0) > 10.0 * rate(1.0, 2300.0) && rate(0.8, 2500.0) < 0.3 * rate(1.0, 2500.0));
    assert!(rate(1.1, 2500.0) > rate(1.0, 2500.0));
}

#[test]
fn a_step_never_passes_equilibrium_and_small_steps_converge() {
    let z = Zeldovich::of(&burned(1.05, 2600.0, 50e5).unwrap(), 2600.0);
    let long = z.advance(0.0, 2600.0, 50e5, 10.0);
    assert!(long <= z.x_equilibrium * (1.0 + 1e-12) && long > 0.99 * z.x_equilibrium);
    let run = |n: usize| (0..n).fold(0.0, |x, _| z.advance(x, 2600.0, 50e5, 1e-3 / n as f64));
    let (exact, coarse, fine) = (run(4000), run(10), run(20));
    assert!((fine - exact).abs() < 0.7 * (coarse - exact).abs() && (fine / exact - 1.0).abs() < 0.05);
}

#[test]
fn the_table_follows_the_mechanism() {
    let table = ZeldovichTable::default();
    for (lambda, t_k, p_pa) in
        [(0.92, 2437.0, 22e5), (1.0, 2610.0, 47e5), (1.13, 2333.0, 9e5), (0.78, 2222.0, 33e5)]
    {
        let z = Zeldovich::of(&burned(lambda, t_k, p_pa).unwrap(), t_k);
        let found = table.at(lambda, t_k, p_pa);
        // Between nodes around lambda 1 the fractions bend most.
        close(found.r1, z.r1, 0.15, "R1");
        close(found.x_equilibrium, z.x_equilibrium, 0.15, "equilibrium");
    }
    // No hole: every node came from an equilibrium.
    let node = table.at(1.0, 1700.0, 4e5);
    assert!(node.r1 > 1e-100 && node.x_equilibrium > 1e-9);
}
