//! A car of known table and sensor, as a log.

use dynocal_label::label::{Axis, Label};
use dynocal_label::ve::Log;
use dynocal_numerics::rng::Rng64;

/// A car whose table is true, or wrong by a smooth factor, with a sensor of known delay and lag.
pub(crate) fn planted(seed: u64, wrong: f64) -> (Label, Vec<f64>, Log) {
    planted_with(seed, wrong, false)
}

/// The same; the ECU may cut its look-ups to whole numbers, as real ones do.
pub(crate) fn planted_with(seed: u64, wrong: f64, cut: bool) -> (Label, Vec<f64>, Log) {
    let mut rng = Rng64::new(seed);
    let x: Vec<f64> = (0..12).map(|k| 600.0 + 450.0 * f64::from(k)).collect();
    let y: Vec<f64> = (0..10).map(|k| 20.0 + 9.0 * f64::from(k)).collect();
    let mut truth = Vec::new();
    let mut base = Vec::new();
    for (j, load) in y.iter().enumerate() {
        for (i, rpm) in x.iter().enumerate() {
            let ve: f64 = 40.0 + 0.3 * load + 10.0 * (rpm / 2500.0).sin();
            let ve = ve.round();
            truth.push(ve);
            base.push((ve * (1.0 + wrong * (0.5 * i as f64).sin() * (0.4 * j as f64).cos())).round());
        }
    }
    let mut label =
        Label::new("veTable", "%", vec![Axis::new("RPM", "rpm", &x), Axis::new("MAP", "kPa", &y)], &base);
    (label.lower, label.upper, label.step) = (0.0, 255.0, Some(1.0));
    let n = 12_000;
    let dt = 0.0667;
    let time_s: Vec<f64> = (0..n).map(|k| dt * k as f64).collect();
    let (mut a, mut b) = (0.0, 0.0);
    let (mut speed, mut load) = (Vec::new(), Vec::new());
    for _ in 0..n {
        a = 0.995 * a + 0.1 * rng.normal();
        b = 0.99 * b + 0.14 * rng.normal();
        speed.push(2500.0 + 1000.0 * a);
        load.push((55.0 + 20.0 * b).clamp(22.0, 100.0));
    }
    let whole = |v: f64| if cut { v.floor() } else { v };
    let ve: Vec<f64> = (0..n).map(|k| whole(label.value(&base, &[speed[k], load[k]]))).collect();
    let real: Vec<f64> = (0..n).map(|k| label.value(&truth, &[speed[k], load[k]]) / ve[k]).collect();
    // 0.2 s and 0.15 s at the reference flow, then a lag of 0.25 s, then noise that is correlated.
    let mut lambda = vec![1.0; n];
    let (mut state, mut e) = (1.0, 0.0);
    for k in 0..n {
        let late = 0.2 + 0.15 * 100_000.0 / (speed[k] * load[k]).max(10_000.0);
        let s = ((time_s[k] - late) / dt).max(0.0);
        let i = (s as usize).min(n - 2);
        let inflow = real[i] + (s - i as f64) * (real[i + 1] - real[i]);
        let keep = (-dt / 0.25f64).exp();
        state = keep * state + (1.0 - keep) * inflow;
        e = 0.7 * e + 0.714 * 0.01 * rng.normal();
        lambda[k] = state + e;
    }
    let log = Log {
        name: "planted".into(),
        speed_rpm: speed,
        load,
        ve,
        enrichment: vec![1.0; n],
        lambda,
        target: vec![1.0; n],
        pulse_ms: vec![3.0; n],
        coolant_c: Some(vec![90.0; n]),
        throttle_rate: None,
        enriching: None,
        time_s,
    };
    (label, truth, log)
}
