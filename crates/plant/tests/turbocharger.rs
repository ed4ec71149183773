//! The compressor and the turbine by themselves: against a measured map, and what must hold of any.

use dynocal_plant::params::EngineParams;
use dynocal_plant::turbocharger::{BYPASS, Turbocharger};

const AMBIENT: (f64, f64) = (101_325.0, 293.0);
const RHO: f64 = 101_325.0 / (287.06 * 293.0);

fn turbo() -> Turbocharger {
    EngineParams::named("gtdi_2l").unwrap().turbocharger.unwrap()
}

fn rad_s(rpm: f64) -> f64 {
    rpm * std::f64::consts::PI / 30.0
}

fn at(t: &Turbocharger, w: f64, ratio: f64) -> dynocal_plant::turbocharger::Compressor {
    t.compressor(w, ratio * AMBIENT.0, AMBIENT.0, AMBIENT.1, RHO)
}

#[test]
fn flow_falls_with_pressure_and_chokes() {
    let t = turbo();
    for rpm in [30e3, 90e3, 150e3, 190e3] {
        let w = rad_s(rpm);
        let mut last = f64::INFINITY;
        for k in 0..400 {
            let c = at(&t, w, 1.0 + 0.01 * f64::from(k));
            assert!(c.flow_kg_s <= last + 1e-15 && c.flow_kg_s >= 0.0 && c.power_w >= 0.0, "{rpm}: {c:?}");
            assert!((0.0..=1.0).contains(&c.share) && c.surge == (c.share < 0.5), "{rpm}: {c:?}");
            last = c.flow_kg_s;
        }
        assert_eq!(last, 0.0, "{rpm} rpm cannot make a ratio of 5");
    }
    // A tip faster than sound: no more flow however low the pressure behind it; a slow wheel lets the engine draw.
    let (high, low) = (at(&t, rad_s(150e3), 1.0), at(&t, rad_s(150e3), 1.4));
    assert!((high.flow_kg_s / low.flow_kg_s - 1.0).abs() < 1e-12, "{high:?} {low:?}");
    assert!(at(&t, rad_s(10e3), 0.97).flow_kg_s > 2.0 * at(&t, rad_s(10e3), 1.0).flow_kg_s);
}

#[test]
fn above_the_surge_line_the_wheel_keeps_its_flow_and_the_shaft_its_load() {
    let t = turbo();
    let w = rad_s(120e3);
    let top = (100..400).map(|k| 0.01 * f64::from(k)).find(|r| at(&t, w, *r).share < 1.0).unwrap();
    let (below, above) = (at(&t, w, top - 0.02), at(&t, w, top + 0.02));
    let surge = t.surge_flow_kg_s(w, AMBIENT.1, RHO);
    assert!(above.flow_kg_s < surge && below.flow_kg_s > surge, "{above:?} {below:?} {surge}");
    // Little flow goes on, but the power is that of the surge flow, and of the same size as just below.
    let far = at(&t, w, top * (1.0 + 6.0 * BYPASS));
    assert!(
        far.surge
            && far.flow_kg_s == 0.0
            && far.power_w == above.power_w
            && far.power_w > 0.5 * below.power_w,
        "{far:?}"
    );
}

#[test]
fn the_turbine_chokes_later_than_an_orifice() {
    let t = turbo();
    // The published form: sqrt(1 - (1/PI)^k) of the choked flow.
    for ratio in [1.2f64, 1.5, 2.0, 3.0] {
        let expected = (1.0 - ratio.powf(-t.turbine_exponent)).sqrt();
        assert!((t.turbine_share(1.0 / ratio) - expected).abs() < 1e-12);
    }
    assert!(t.turbine_share(0.999) < 0.02 && t.turbine_share(1.0) == 0.0);
    assert!(t.turbine_share(0.2) > 0.93 && t.turbine_share(0.5) < 0.82);
    // The flap stands still below its preload and is open above it.
    assert_eq!(t.flap_lift(0.99 * t.flap_preload_pa), 0.0);
    assert_eq!(t.flap_lift(t.flap_preload_pa + 1.01 * t.flap_range_pa), 1.0);
}

/// The measured map of a compressor of 56 mm (34 points, 293 K, 101.3 kPa), with the constants of the set and that wheel's
/// choke flow and surge line.
#[test]
fn the_form_meets_a_measured_map() {
    let Some(folder) = std::env::var_os("DYNOCAL_REFERENCE_DIR") else {
        println!("SKIPPED: DYNOCAL_REFERENCE_DIR is not set");
        return;
    };
    let file = std::path::Path::new(&folder).join("data/engine_maps/turbo_stationary/compressor.csv");
    let text = std::fs::read_to_string(&file).unwrap();
    let rows: Vec<Vec<f64>> =
        text.lines().skip(1).map(|l| l.split(',').map(|v| v.trim().parse().unwrap()).collect()).collect();
    assert_eq!(rows.len(), 34);
    // Its own surge line: flow at the left end of each line over that at choke.
    let t = Turbocharger {
        compressor_m: 0.056,
        flow_coefficient: 0.0755,
        surge_share: [0.36, -0.37, 0.36],
        ..turbo()
    };
    let (mut off, mut efficiency) = (0.0, 0.0);
    for r in &rows {
        let [flow, ratio, speed, eta] = r[..] else { panic!("four columns") };
        let w = rad_s(speed);
        let u = 0.5 * t.compressor_m * w;
        let head = 1006.0 * AMBIENT.1 * (ratio.powf(0.2865) - 1.0);
        let choke = t.flow_coefficient * RHO * t.compressor_m * t.compressor_m * u;
        // A line is flat at the top and steep at choke: the nearer of its two distances counts.
        let flow_off = (at(&t, w, ratio).flow_kg_s - flow).abs() / choke;
        let ratio_there = (100..400).map(|k| 0.01 * f64::from(k)).find(|q| at(&t, w, *q).flow_kg_s < flow);
        let ratio_off = ratio_there.map_or(1.0, |q| (q - ratio).abs() / ratio);
        off += flow_off.min(ratio_off).powi(2) / 34.0;
        let [w0, w1] = t.work_coefficient;
        let found = head / (u * u * (w0 - w1 * flow / choke));
        efficiency += (found - eta).powi(2) / 34.0;
    }
    assert!(off.sqrt() < 0.04, "lines: {}", off.sqrt());
    assert!(efficiency.sqrt() < 0.04, "efficiency: {}", efficiency.sqrt());
}

#[test]
fn the_intercooler_takes_less_at_high_flow() {
    let plain = turbo();
    assert_eq!(plain.cooler_w_k, 0.0);
    assert_eq!((plain.cooled_share(0.01), plain.cooled_share(0.2)), (plain.cooling, plain.cooling));
    let t = Turbocharger { cooling: 0.9, cooler_w_k: 200.0, ..plain };
    assert!((t.cooled_share(1e-4) - 0.9).abs() < 1e-12, "all that meets it");
    // One transfer unit: UA = m' c_p.
    let one = t.cooled_share(200.0 / 1006.0);
    assert!((one - 0.9 * (1.0 - (-1.0f64).exp())).abs() < 1e-12, "{one}");
    let mut last = 1.0;
    for k in 1..40 {
        let share = t.cooled_share(0.005 * f64::from(k));
        assert!(share < last && share > 0.0, "{share}");
        last = share;
    }
}
