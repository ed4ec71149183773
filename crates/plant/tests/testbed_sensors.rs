//! Every sensor of a bed, with what was planted found again: lag, scatter and step of the converter from a record, transport from
//! the flow, an hour's drift from repeat points. True values stay beside the measured ones.

use dynocal_ident::plant::{Causality, Plant, variable_index};
use dynocal_numerics::rng::Rng64;
use dynocal_plant::bed::{BedSettings, EngineBed};
use dynocal_plant::params::EngineParams;
use dynocal_plant::testbed::sensor::SensorSettings;
use std::collections::BTreeMap;

/// What an engineer reads on a bed, with the lag that is planted \[s\].
const CHANNELS: [(&str, f64); 18] = [
    ("torque", 0.15),
    ("lambda", 0.08),
    ("lambda_post", 0.12),
    ("map", 0.02),
    ("air", 0.05),
    ("boost", 0.03),
    ("exhaust", 0.04),
    ("egt", 0.9),
    ("coolant", 4.0),
    ("oil", 6.0),
    ("knock", 0.06),
    ("pmax", 0.10),
    ("imep", 0.07),
    ("ca50", 0.09),
    ("fuel", 0.5),
    ("turbo_speed", 0.05),
    ("no", 1.2),
    ("hc", 1.5),
];
const TICK_S: f64 = 0.01;

/// The real bed of `gtdi_2l` with these outputs and sensors, walls and oil from `start_k` on.
fn gtdi(outputs: &[&str], sensors: BTreeMap<String, SensorSettings>, start_k: f64, tick_s: f64) -> EngineBed {
    let p = EngineParams::named("gtdi_2l").unwrap();
    let mut set = BedSettings::of_set("gtdi_2l", &p).unwrap();
    let o = &mut set.options;
    o.outputs = outputs.iter().map(|n| (*n).to_owned()).collect();
    (o.sensors, o.tick_s) = (sensors, tick_s);
    o.engine.warm_up.as_mut().unwrap().start_k = start_k;
    EngineBed::new(&p, set).unwrap()
}

/// Names beyond the five outputs that every bed has.
fn beyond_standard() -> Vec<&'static str> {
    let standard = ["torque", "lambda", "map", "egt", "fuel"];
    CHANNELS.iter().map(|c| c.0).filter(|n| !standard.contains(n)).collect()
}

/// Fuel, spark and throttle jump about their start; a row a sample of [`TICK_S`], the outputs in the order of `names`.
fn record(bed: &mut EngineBed, names: &[&str], n: usize) -> Vec<Vec<f64>> {
    let u0: Vec<f64> =
        bed.variables().iter().filter(|v| v.causality == Causality::Input).map(|v| v.start).collect();
    let m = bed.variables().iter().filter(|v| v.causality == Causality::Output).count();
    let places: Vec<usize> =
        names.iter().map(|name| variable_index(bed, Causality::Output, name).unwrap()).collect();
    let (mut u, mut y, mut rng) = (u0.clone(), vec![0.0; m], Rng64::new(11));
    bed.reset(5);
    (0..n)
        .map(|_| {
            if rng.uniform() < 0.02 {
                u[0] = u0[0] * rng.uniform_in(0.85, 1.3);
                u[1] = u0[1] + rng.uniform_in(-8.0, 4.0);
                u[2] = u0[2] + rng.uniform_in(-1.0, 4.0);
            }
            bed.step(&u, TICK_S, &mut y).unwrap();
            places.iter().map(|k| y[*k]).collect()
        })
        .collect()
}

/// `z` behind a lag of `tau_s`, from its first value on.
fn lagged(z: &[f64], tau_s: f64) -> Vec<f64> {
    let keep = (-TICK_S / tau_s).exp();
    let mut y = z[0];
    z.iter()
        .map(|z| {
            y = z + (y - z) * keep;
            y
        })
        .collect()
}

/// Root mean square of the difference, after the first second: the start of a lag is not in the record.
fn apart(a: &[f64], b: &[f64], skip: usize) -> f64 {
    let d: f64 = a.iter().zip(b).skip(skip).map(|(a, b)| (a - b).powi(2)).sum();
    (d / (a.len() - skip) as f64).sqrt()
}

/// The lag \[s\] between a true and a measured record: golden section of the squares over its logarithm.
fn found_lag_s(z: &[f64], y: &[f64], skip: usize) -> f64 {
    let cost = |log: f64| apart(&lagged(z, log.exp()), y, skip);
    let (mut a, mut b) = (0.005f64.ln(), 20f64.ln());
    let golden = 0.5 * (5f64.sqrt() - 1.0);
    for _ in 0..60 {
        let (c, d) = (b - golden * (b - a), a + golden * (b - a));
        if cost(c) < cost(d) { b = d } else { a = c }
    }
    (0.5 * (a + b)).exp()
}

#[test]
fn lag_scatter_and_step_that_were_planted_in_each_sensor_are_found_again() {
    let names: Vec<&str> = CHANNELS.iter().map(|c| c.0).collect();
    let n = 2000;
    let cold_k = 313.0;
    let mut ideal = gtdi(&beyond_standard(), BTreeMap::new(), cold_k, TICK_S);
    let truth = record(&mut ideal, &names, n);
    let column = |rows: &[Vec<f64>], k: usize| -> Vec<f64> { rows.iter().map(|r| r[k]).collect() };
    // Scatter of a hundredth of what the quantity does in the record, steps of a third of that.
    let planted: Vec<SensorSettings> = CHANNELS
        .iter()
        .enumerate()
        .map(|(k, (name, lag_s))| {
            let z = column(&truth, k);
            let mean = z.iter().sum::<f64>() / n as f64;
            let span = (z.iter().map(|z| (z - mean).powi(2)).sum::<f64>() / n as f64).sqrt();
            assert!(span > 0.0, "{name} does not move: nothing could be found from it");
            let noise = 0.01 * span;
            SensorSettings { lag_s: *lag_s, noise, quantum: 0.3 * noise, ..Default::default() }
        })
        .collect();
    let sensors = names.iter().map(|n| (*n).to_owned()).zip(planted.iter().copied()).collect();
    let mut real = gtdi(&beyond_standard(), sensors, cold_k, TICK_S);
    let measured = record(&mut real, &names, n);
    for (k, (name, lag_s)) in CHANNELS.iter().enumerate() {
        let (z, y, s) = (column(&truth, k), column(&measured, k), planted[k]);
        // Five time constants: what the sensor stood at before the record is forgotten. Slow ones begin at rest on their ramp.
        let skip = if *lag_s < 2.0 { (5.0 * lag_s / TICK_S) as usize } else { 0 };
        let found = found_lag_s(&z, &y, skip);
        assert!((found / lag_s - 1.0).abs() < 0.05, "{name}: {found} s for {lag_s} s");
        let rest = apart(&lagged(&z, *lag_s), &y, skip);
        let scatter = s.noise.hypot(s.quantum / 12f64.sqrt());
        // Four standard errors of a standard deviation.
        let within = 4.0 / (2.0 * (n - skip) as f64).sqrt();
        assert!((rest / scatter - 1.0).abs() < within, "{name}: {rest} for {scatter}");
        let steps = y.iter().map(|y| y / s.quantum).map(|m| (m - m.round()).abs()).fold(0.0, f64::max);
        assert!(steps < 1e-6, "{name}: readings are no multiples of {}", s.quantum);
    }
}

/// The delay of gas on its way is its mass over the flow, before the catalyst and behind it, at a light and at a high load.
#[test]
fn transport_to_the_lambda_sensors_follows_the_flow() {
    let contents = [("lambda", 1.5), ("lambda_post", 4.0)];
    let sensors: BTreeMap<String, SensorSettings> = contents
        .iter()
        .map(|(n, g)| ((*n).to_owned(), SensorSettings { transport_g: *g, ..Default::default() }))
        .collect();
    let outputs = ["lambda_post", "air"];
    let (mut ideal, mut real) =
        (gtdi(&outputs, BTreeMap::new(), 363.15, 2e-3), gtdi(&outputs, sensors, 363.15, 2e-3));
    let names = ["lambda", "lambda_post", "air", "fuel"];
    let places = names.map(|n| variable_index(&ideal, Causality::Output, n).unwrap());
    let mut delays = Vec::new();
    for (speed, throttle, fuel) in [(1200.0, 9.0, 12.0), (3500.0, 20.0, 25.0)] {
        let run = |bed: &mut EngineBed| -> Vec<[f64; 4]> {
            let mut y = vec![0.0; 7];
            bed.reset(2);
            let mut u = [fuel, 20.0, throttle, speed];
            (0..4000)
                .map(|k| {
                    // Rich and lean by turns, once the point is at rest.
                    u[0] = if (k / 250) % 2 == 0 { 1.05 * fuel } else { 0.93 * fuel };
                    bed.step(&u, 2e-3, &mut y).unwrap();
                    places.map(|p| y[p])
                })
                .collect()
        };
        let (z, y) = (run(&mut ideal), run(&mut real));
        let tail = &z[2000..];
        let flow = tail.iter().map(|r| r[2] + r[3] / 3.6).sum::<f64>() / tail.len() as f64;
        for (k, (name, grams)) in contents.iter().enumerate() {
            let cost = |late: usize| -> f64 {
                (2000..4000).map(|t| (y[t][k] - z[t - late][k]).powi(2)).sum::<f64>()
            };
            let best = (0..1000).min_by(|a, b| cost(*a).total_cmp(&cost(*b))).unwrap();
            let (found_s, expected_s) = (2e-3 * best as f64, grams / flow);
            let near = (found_s - expected_s).abs() < 0.05 * expected_s + 4e-3;
            assert!(near, "{name} at {speed} rpm: {found_s} s, {grams} g at {flow} g/s are {expected_s} s");
            delays.push(found_s);
        }
    }
    assert!(delays[0] > 2.0 * delays[2] && delays[1] > 2.0 * delays[3], "less flow, more delay: {delays:?}");
}

/// Least squares of pairs (x, y) through the origin.
fn slope(pairs: impl Iterator<Item = (f64, f64)>) -> f64 {
    let (xy, xx) = pairs.fold((0.0, 0.0), |(a, b), (x, y)| (a + x * y, b + x * x));
    xy / xx
}

/// An hour on the whole bed from a cold start: a point is visited every five minutes. Warm-up ends and the engine is the same
/// again; the sensors drift as was planted, which the repeats tell, and the true values do not.
#[test]
fn repeat_points_of_an_hour_tell_the_drift_of_the_sensors_from_the_engine() {
    let drifts = [
        ("torque", 1.0),
        ("map", 0.4),
        ("egt", 4.0),
        ("fuel", 0.05),
        ("air", 0.1),
        ("boost", 0.5),
        ("exhaust", 0.5),
        ("imep", 0.05),
    ];
    let (drift_s, every_s, hold_s, dt_s) = (600.0, 300.0, 10.0, 0.1);
    let sensors = drifts
        .iter()
        .map(|(n, drift)| ((*n).to_owned(), SensorSettings { drift: *drift, drift_s, ..Default::default() }))
        .collect();
    let mut bed = gtdi(&["air", "boost", "exhaust", "imep"], sensors, 293.15, 0.02);
    let places = drifts.map(|d| variable_index(&bed, Causality::Output, d.0).unwrap());
    bed.reset(7);
    let (repeat, between) = ([14.0, 18.0, 10.0, 1500.0], [20.0, 16.0, 16.0, 1200.0]);
    let mut y = vec![0.0; 9];
    // Drift of each channel and true torque at each visit.
    let (mut found, mut torque) = (Vec::new(), Vec::new());
    for _ in 0..12 {
        let mut sums = [0.0; 8];
        let mut true_nm = 0.0;
        let count = (hold_s / dt_s) as usize;
        for k in 0..2 * count {
            bed.step(&repeat, dt_s, &mut y).unwrap();
            if k >= count {
                let t = bed.engine().outputs();
                let truth = [
                    t.torque_nm,
                    t.map_kpa,
                    t.egt_k,
                    t.fuel_kg_h,
                    t.air_g_s,
                    t.boost_kpa,
                    t.exhaust_kpa,
                    t.imep_bar,
                ];
                for (s, (p, t)) in sums.iter_mut().zip(places.iter().zip(truth)) {
                    *s += (y[*p] - t) / count as f64;
                }
                true_nm += t.torque_nm / count as f64;
            }
        }
        let scaled: Vec<f64> = sums.iter().zip(drifts).map(|(s, (_, drift))| s / drift).collect();
        found.push(scaled);
        torque.push(true_nm);
        for _ in 0..((every_s - 2.0 * hold_s) / dt_s) as usize {
            bed.step(&between, dt_s, &mut y).unwrap();
        }
    }
    assert!((bed.time_s() - 3600.0).abs() < 1.0);
    // Cold oil costs torque at first; the last half hour is one and the same point.
    let last = &torque[6..];
    let spread = last.iter().fold(f64::MIN, |a, b| a.max(*b)) - last.iter().fold(f64::MAX, |a, b| a.min(*b));
    assert!(torque[11] - torque[0] > 2.0 && spread < 0.5, "true torque {torque:?}");
    // The first visit, after 15 s: hardly any drift yet. Later ones: the memory and the size that were planted.
    let keep = (-every_s / drift_s).exp();
    let first = found[0].iter().map(|d| d * d).sum::<f64>() / 8.0;
    assert!(first < 0.2, "{:?}", found[0]);
    let pairs = || found.windows(2).flat_map(|w| w[0].iter().copied().zip(w[1].iter().copied()));
    let memory = slope(pairs());
    assert!((memory - keep).abs() < 0.25, "from visit to visit {memory} is left, planted {keep}");
    let step = pairs().map(|(a, b)| (b - keep * a).powi(2)).sum::<f64>() / pairs().count() as f64;
    // 88 independent squares: three of their standard errors.
    let share = step / (1.0 - keep * keep);
    assert!((share - 1.0).abs() < 3.0 * (2.0f64 / 88.0).sqrt(), "variance over the planted one: {share}");
}

/// One key starts everything cold; without it catalyst and walls start at their own temperatures, as before.
#[test]
fn a_cold_start_needs_one_key() {
    use dynocal_plant::error::PlantError;
    use dynocal_plant::testbed::settings::BedOptions;
    use dynocal_plant::testbed::state::BedState;
    let p = EngineParams::named("gtdi_2l").unwrap();
    let options = |text: &str| BedOptions::from_table("gtdi_2l", &toml::from_str(text).unwrap());
    let built = |text: &str| -> Result<BedState, PlantError> {
        let set = BedSettings { options: options(text)?, ..BedSettings::of_set("gtdi_2l", &p).unwrap() };
        EngineBed::new(&p, set).map(|bed| bed.bed_state().clone())
    };
    let one = built("real = true\n[engine]\nstart_k = 268.15").unwrap();
    let two = built("real = true\n[engine.warm_up]\nstart_k = 268.15\n[engine.catalyst]\nstart_k = 268.15")
        .unwrap();
    assert_eq!(one, two);
    assert_eq!(one.catalyst.unwrap().brick_k[0], 268.15);
    let (before, real) =
        (built("real = true\n[engine.warm_up]\nstart_k = 268.15").unwrap(), built("real = true").unwrap());
    assert_eq!((before.thermal, before.catalyst), (one.thermal, real.catalyst));
    let refused = built("real = false\n[engine]\nstart_k = 268.15").unwrap_err().to_string();
    assert!(refused.contains("bed.engine.start_k") && refused.contains("warm_up"), "{refused}");
    assert!(built("real = true\n[engine]\nstart_k = 20").is_err());
}
