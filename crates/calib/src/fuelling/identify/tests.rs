use super::*;
use crate::fuelling::FuelPolicy;
use dynocal_numerics::rng::Rng64;

const DT: f64 = 0.01;

/// What the record is made with, by the model itself.
fn truth() -> Fuelling {
    let points: Vec<[f64; 3]> = (0..60)
        .map(|k| (1000.0 + 400.0 * f64::from(k % 6), 25.0 + 7.0 * f64::from(k / 6)))
        .map(|(n, p): (f64, f64)| [n, p, 0.3 * p * (0.8 + 1e-4 * n - 2e-8 * n * n) - 1.0])
        .collect();
    let charge = Charge::fit(&points).unwrap();
    let area = vec![0.0, 100.0, 500.0, 100.0];
    let filling = Filling {
        upstream_kpa: 101.325,
        throttle_deg: 30.0,
        area,
        gain: 1.4,
        throttle_lag_s: 0.06,
        correction_per_s: 0.0,
    };
    let timing = Timing {
        charge_s: 0.01,
        charge_cycles: 0.6,
        transport_cycles: 1.1,
        transport_fuel: 9.0,
        sensor_lag_s: 0.08,
    };
    let film = Film { share: 0.25, tau_s: 0.4 };
    Fuelling { sample_time_s: DT, charge, filling, film, timing, rms: 0.0, pressure_rms_kpa: 0.0 }
}

/// Speed, throttle, injection, pressure, lambda.
type Channels = [Vec<f64>; 5];

fn record(f: &Fuelling, holds: usize) -> Channels {
    let mut rng = Rng64::stream(3, 0);
    let (mut speed, mut throttle, mut injection) = (Vec::new(), Vec::new(), Vec::new());
    for _ in 0..holds {
        let (n, a, q) =
            (1200.0 + 1600.0 * rng.uniform(), 8.0 + 14.0 * rng.uniform(), 8.0 + 8.0 * rng.uniform());
        for _ in 0..300 {
            speed.push(n);
            throttle.push(a);
            injection.push(q);
        }
    }
    let mut r = TransientRecord {
        sample_time_s: DT,
        speed_rpm: &speed,
        throttle_deg: &throttle,
        injection: &injection,
        map_kpa: &vec![50.0; speed.len()],
        lambda: &vec![1.0; speed.len()],
        upstream_kpa: 101.325,
    };
    let p = pressure(&r, &f.charge, &f.filling);
    let shown = shown(&r, &f.charge, &f.filling);
    r.map_kpa = &shown;
    let lambda: Vec<f64> =
        richness(&r, &f.charge, f.film, &f.timing, &p).iter().map(|phi| 1.0 / phi).collect();
    [speed, throttle, injection, shown, lambda]
}

fn view(c: &Channels) -> TransientRecord<'_> {
    TransientRecord {
        sample_time_s: DT,
        speed_rpm: &c[0],
        throttle_deg: &c[1],
        injection: &c[2],
        map_kpa: &c[3],
        lambda: &c[4],
        upstream_kpa: 101.325,
    }
}

#[test]
fn a_record_of_the_model_gives_the_model_back() {
    let truth = truth();
    let channels = record(&truth, 60);
    let found = identify(&view(&channels), &|| false).unwrap();
    let near = |a: f64, b: f64, share: f64, what: &str| {
        assert!((a / b - 1.0).abs() < share, "{what}: {a}, planted {b}")
    };
    near(found.film.share, truth.film.share, 0.03, "share");
    near(found.film.tau_s, truth.film.tau_s, 0.03, "tau");
    near(found.filling.gain, truth.filling.gain, 0.03, "gain");
    near(found.filling.throttle_lag_s, truth.filling.throttle_lag_s, 0.05, "throttle");
    near(found.timing.sensor_lag_s, truth.timing.sensor_lag_s, 0.03, "sensor");
    near(found.timing.ahead_s(2000.0), truth.timing.ahead_s(2000.0), 0.05, "ahead");
    for (n, p) in [(1400.0, 40.0), (2500.0, 60.0)] {
        near(found.charge.at(n, p), truth.charge.at(n, p), 2e-3, "charge");
    }
    assert!(found.rms < 1e-3, "{}", found.rms);
}

/// Where nothing moves, the policy gives the fuel of lambda; where the throttle jumps, the mixture in the cylinder stays.
#[test]
fn the_policy_holds_the_mixture_of_its_own_model() {
    let truth = truth();
    let mut policy = FuelPolicy::new(truth.clone(), 60.0);
    let (speed, n) = (2000.0, 600);
    let throttle: Vec<f64> = (0..n).map(|t| if t < 200 { 11.0 } else { 19.0 }).collect();
    let speeds = vec![speed; n];
    let zeros = vec![0.0; n];
    let r = TransientRecord {
        sample_time_s: DT,
        speed_rpm: &speeds,
        throttle_deg: &throttle,
        injection: &zeros,
        map_kpa: &vec![40.0; n],
        lambda: &vec![1.0; n],
        upstream_kpa: 101.325,
    };
    // At rest at the first throttle, whatever it began with.
    let p = pressure(&r, &truth.charge, &truth.filling);
    let injection: Vec<f64> = (0..n).map(|t| policy.step(speed, throttle[t], 40.0, 1.0)).collect();
    let r = TransientRecord { injection: &injection, ..r };
    let fast = Timing { transport_cycles: 0.0, transport_fuel: 0.0, sensor_lag_s: 1e-9, ..truth.timing };
    let phi = richness(&r, &truth.charge, truth.film, &fast, &p);
    // Not the first second: the film of the record begins with another injection. And not what was injected before the step
    // and meets its air after it: that nobody can know.
    let known = 200 - (truth.timing.ahead_s(speed) / DT).ceil() as usize;
    let held = phi[100..known].iter().chain(&phi[200..n - 20]);
    let worst = held.map(|v| (v - 1.0).abs()).fold(0.0, f64::max);
    assert!(worst < 5e-3, "{worst}");
    // What there was to follow.
    let steady = |p: f64| truth.charge.at(speed, p);
    assert!((steady(p[n - 1]) / steady(p[199]) - 1.0).abs() > 0.2);
}

#[test]
fn what_says_too_little_is_refused() {
    let truth = truth();
    let channels = record(&truth, 8);
    let e = identify(&view(&channels), &|| false).unwrap_err();
    assert!(matches!(e, FuellingError::Rests { found: 8, .. }), "{e}");
    let channels = record(&truth, 30);
    let short = TransientRecord { lambda: &channels[4][..50], ..view(&channels) };
    let e = identify(&short, &|| false).unwrap_err().to_string();
    assert!(e.contains("`lambda` has 50 samples"), "{e}");
    let slow = TransientRecord { sample_time_s: 0.1, ..view(&channels) };
    assert!(identify(&slow, &|| false).unwrap_err().to_string().contains("0.05 s at most"));
    let low = TransientRecord { upstream_kpa: 30.0, ..view(&channels) };
    assert!(identify(&low, &|| false).unwrap_err().to_string().contains("before the throttle"));
    assert!(matches!(identify(&view(&channels), &|| true), Err(FuellingError::Interrupted)));
}
