//! The bed keeps the plant contract.

use dynocal_ident::plant::{Causality, Plant, PlantError, variable_index};
use dynocal_plant::bed::{BedSettings, EngineBed, LimitSettings};
use dynocal_plant::params::EngineParams;
use dynocal_plant::sensors::NoiseLevels;
use dynocal_plant::testbed::settings::BedOptions;

const START: [f64; 4] = [16.754, 18.95, 15.85, 2000.0];

fn bed(noise: NoiseLevels, limits: Vec<LimitSettings>) -> EngineBed {
    let options = BedOptions { limits, ..BedOptions::default() };
    EngineBed::new(&EngineParams::thesis(), BedSettings { noise, options, ..BedSettings::default() }).unwrap()
}

fn record(bed: &mut EngineBed, n: usize) -> Vec<[f64; 5]> {
    (0..n)
        .map(|i| {
            let mut y = [0.0; 5];
            let u = [START[0] + (i % 5) as f64 - 2.0, START[1], START[2] + (i % 3) as f64, START[3]];
            bed.step(&u, 0.03, &mut y).unwrap();
            y
        })
        .collect()
}

#[test]
fn starts_settled_and_names_its_variables() {
    let mut b = bed(NoiseLevels::default(), Vec::new());
    let names: Vec<&str> = b.variables().iter().map(|v| v.name.as_str()).collect();
    assert_eq!(names, ["inj", "spark", "throttle", "speed", "torque", "lambda", "map", "egt", "fuel"]);
    assert_eq!(variable_index(&b, Causality::Output, "lambda").unwrap(), 1);
    let mut y = [0.0; 5];
    b.step(&START, 0.03, &mut y).unwrap();
    assert!((y[0] - 70.0).abs() < 0.1 && (y[1] - 1.0).abs() < 0.001, "{y:?}");
    // Thesis eq. 7.11.
    assert!((y[4] - 1.2e-4 * START[0] * START[3]).abs() < 1e-12);
    assert!((b.time_s() - 0.03).abs() < 1e-15);
}

#[test]
fn noise_does_not_touch_the_engine_and_has_its_levels() {
    let levels = NoiseLevels { torque_nm: 1.0, lambda: 0.01 };
    let (mut clean, mut noisy) = (bed(NoiseLevels::default(), Vec::new()), bed(levels, Vec::new()));
    clean.reset(1);
    noisy.reset(1);
    let n = 1500;
    let (a, b) = (record(&mut clean, n), record(&mut noisy, n));
    assert_eq!(clean.engine().state(), noisy.engine().state());
    for (channel, level) in [(0, 1.0), (1, 0.01)] {
        let e: Vec<f64> = a.iter().zip(&b).map(|(a, b)| (b[channel] - a[channel]) / level).collect();
        let mean = e.iter().sum::<f64>() / n as f64;
        let variance = e.iter().map(|x| (x - mean).powi(2)).sum::<f64>() / n as f64;
        let neighbour = e.windows(2).map(|w| w[0] * w[1]).sum::<f64>() / n as f64;
        // Five standard errors of mean, variance and lag-one correlation of white noise.
        let limit = 5.0 / (n as f64).sqrt();
        assert!(mean.abs() < limit && (variance - 1.0).abs() < 1.5 * limit && neighbour.abs() < limit);
    }
    assert!(a.iter().zip(&b).all(|(a, b)| a[2..] == b[2..]));
    noisy.reset(2);
    let other = record(&mut noisy, 10);
    assert!(other.iter().zip(&b).all(|(x, y)| x[0] != y[0]), "another seed, other noise");
    noisy.reset(1);
    assert_eq!(record(&mut noisy, 10), b[..10]);
}

#[test]
fn save_and_restore_continue_exactly() {
    let levels = NoiseLevels { torque_nm: 1.0, lambda: 0.01 };
    let mut a = bed(levels, Vec::new());
    a.reset(u64::MAX - 5);
    record(&mut a, 7);
    let saved = a.save();
    let mut b = bed(levels, Vec::new());
    b.restore(&saved).unwrap();
    assert_eq!(record(&mut a, 9), record(&mut b, 9));
    assert_eq!(a.time_s(), b.time_s());
    assert_eq!(a.save(), b.save());
    let mut short = saved;
    short.0.pop();
    assert!(matches!(b.restore(&short), Err(PlantError::Call(_))));
}

#[test]
fn refuses_bad_inputs_and_keeps_its_state() {
    let mut b = bed(NoiseLevels::default(), Vec::new());
    let before = b.save();
    let mut y = [0.0; 5];
    let refused = b.step(&[130.0, 19.0, 15.0, 2000.0], 0.03, &mut y);
    assert!(matches!(refused, Err(PlantError::OutOfRange { ref name, .. }) if name == "inj"));
    let refused = b.step(&[15.0, f64::NAN, 15.0, 2000.0], 0.03, &mut y);
    assert!(matches!(refused, Err(PlantError::NonFinite { ref name, .. }) if name == "spark"));
    assert!(matches!(b.step(&START[..3], 0.03, &mut y), Err(PlantError::Call(_))));
    assert!(matches!(b.step(&START, 0.0, &mut y), Err(PlantError::Call(_))));
    assert_eq!(before, b.save());
}

#[test]
fn a_touched_limit_is_reported_once() {
    let limit = LimitSettings::report("torque", -50.0, 60.0);
    let mut b = bed(NoiseLevels::default(), vec![limit]);
    let mut y = [0.0; 5];
    for _ in 0..5 {
        b.step(&START, 0.03, &mut y).unwrap();
    }
    let events = b.take_events();
    assert_eq!(events.len(), 1);
    assert!(events[0].what == "torque" && events[0].limit == 60.0 && events[0].value > 60.0);
    assert!(b.take_events().is_empty());
}

#[test]
fn lambda_is_the_mean_over_the_sample() {
    // Three samples of 0.01 s average to one of 0.03 s (same engine, same inputs).
    let (mut long, mut short) =
        (bed(NoiseLevels::default(), Vec::new()), bed(NoiseLevels::default(), Vec::new()));
    let u = [START[0] - 4.0, START[1], START[2], START[3]];
    let (mut y, mut z) = ([0.0; 5], [0.0; 5]);
    for _ in 0..20 {
        long.step(&u, 0.03, &mut y).unwrap();
        let mut mean = 0.0;
        for _ in 0..3 {
            short.step(&u, 0.01, &mut z).unwrap();
            mean += z[1] / 3.0;
        }
        assert!((mean - y[1]).abs() < 1e-9, "{mean} {}", y[1]);
        assert!((y[0] - z[0]).abs() < 1e-9);
    }
}
