//! Oscillations of known period are recognised, and quiet, damped and noisy loops are left alone.

use dynocal_ident::data::{Channel, Dataset, Role};
use dynocal_ident::pi::PiGains;
use dynocal_ident::plan::{Plan, PlanChannel, PlanDemand, PlanLoop};
use dynocal_ident::play::{Oscillation, Unwatched, oscillation, play};
use dynocal_numerics::rng::Rng64;

mod common;
use common::lag::Lag;

const DT: f64 = 0.03;

fn the_loop() -> PlanLoop {
    PlanLoop::closed("y", "u", PiGains { ki: 1.0, kp: 1.0 })
}

fn record(y: Vec<f64>, u: Vec<f64>, demand: Vec<f64>) -> Dataset {
    let channel = |name: &str, role, values| Channel { name: name.into(), unit: "-".into(), role, values };
    Dataset {
        name: "a".into(),
        sample_time_s: DT,
        channels: vec![
            channel("u", Role::Input, u),
            channel("y", Role::Output, y),
            channel("y_demand", Role::Auxiliary, demand),
        ],
        init_samples: 0,
        origin: "test".into(),
    }
}

fn found(y: Vec<f64>, u: Vec<f64>, demand: f64) -> Option<Oscillation> {
    let n = y.len();
    oscillation(&record(y, u, vec![demand; n]), &the_loop()).unwrap()
}

/// Sinusoids and triangles of drawn period, phase and amplitude, with noise of up to half their standard deviation.
#[test]
fn period_and_amplitude_of_known_oscillators_are_found() {
    let mut rng = Rng64::new(11);
    for k in 0..200 {
        let n = 400 + rng.below(800);
        // At least eight periods in what is left after settling, at least six samples a period.
        let period = rng.uniform_in(6.0, 0.75 * n as f64 / 8.0);
        let (amplitude, phase) = (rng.uniform_in(2.0, 20.0), rng.uniform_in(0.0, 6.0));
        let noise = rng.uniform_in(0.0, 0.5) * amplitude / 2f64.sqrt();
        let wave = |x: f64| {
            let sine = (std::f64::consts::TAU * x).sin();
            if k % 2 == 0 { sine } else { 2.0 / std::f64::consts::PI * sine.asin() }
        };
        let lag = rng.uniform_in(0.0, 0.4);
        let at = |t: usize, lag: f64| wave(t as f64 / period + phase - lag);
        let y = (0..n).map(|t| 50.0 + amplitude * at(t, 0.0) + noise * rng.normal()).collect();
        let u = (0..n).map(|t| 7.0 + 0.2 * amplitude * at(t, lag)).collect();
        let o = found(y, u, 50.0).unwrap_or_else(|| panic!("run {k}: period {period} of {n}, noise {noise}"));
        assert!((o.period_s / DT / period - 1.0).abs() < 0.03, "run {k}: {o:?}, period {period}");
        // Root mean square: a triangle has 1/3 of its peak squared, a sinusoid 1/2.
        let shape = if k % 2 == 0 { 0.5 } else { 1.0 / 3.0 };
        let expected = (2.0 * (shape * amplitude * amplitude + noise * noise)).sqrt();
        assert!((o.amplitude / expected - 1.0).abs() < 0.1, "run {k}: {o:?}, expected {expected}");
        assert!(o.from_s < 0.26 * n as f64 * DT && (o.to_s - n as f64 * DT).abs() < 1e-9);
    }
}

#[test]
fn noise_drift_decay_and_ripple_are_no_oscillation() {
    let mut rng = Rng64::new(12);
    let n = 800;
    for k in 0..200 {
        // White and correlated noise, the input following it: a loop does that all the time.
        let pole = [0.0, 0.6, 0.9, 0.97][k % 4];
        let mut state = 0.0;
        let y: Vec<f64> = (0..n)
            .map(|_| {
                state = pole * state + rng.normal();
                50.0 + 3.0 * state
            })
            .collect();
        let u = y.iter().map(|v| -0.5 * v).collect();
        assert_eq!(found(y, u, 50.0), None, "noise with pole {pole}, run {k}");
        // A step that settles, at decay ratios of up to 0.6 a period.
        let (period, ratio) = (rng.uniform_in(10.0, 60.0), rng.uniform_in(0.05, 0.6f64));
        let wave =
            |t: usize| ratio.powf(t as f64 / period) * (std::f64::consts::TAU * t as f64 / period).cos();
        let y = (0..n).map(|t| 50.0 + 20.0 * wave(t)).collect();
        let u = (0..n).map(|t| 2.0 * wave(t + 3)).collect();
        assert_eq!(found(y, u, 50.0), None, "decay {ratio}, period {period}");
        // A regular ripple of less than 2 % of the demand.
        let y = (0..n).map(|t| 50.0 + 0.9 * (t as f64 * 0.3).sin()).collect();
        let u = (0..n).map(|t| 0.1 * (t as f64 * 0.3).cos()).collect();
        assert_eq!(found(y, u, 50.0), None);
    }
    let still = vec![50.0; n];
    assert_eq!(found(still.clone(), still, 50.0), None);
}

/// The sampled loop itself: y(t+1) = a y + b u under P control has its pole at a - b kp, which leaves the unit circle at -1.
/// Beyond that gain the range of the input bounds an oscillation of two samples; far below it is quiet.
#[test]
fn a_loop_beyond_its_critical_gain_is_recognised() {
    let (a, b) = (0.9, 0.2);
    let critical = (1.0 + a) / b;
    let mut rng = Rng64::new(13);
    for _ in 0..50 {
        let share = rng.uniform_in(0.05, 2.0);
        if (share - 1.0).abs() < 0.15 {
            continue;
        }
        let n = 600;
        let gains = PiGains { ki: 0.5, kp: share * critical };
        let demand = PlanDemand { output: "y".into(), unit: "-".into(), values: vec![1.0; n] };
        let l = PlanLoop::closed("y", "u", gains);
        let plan =
            Plan::open_loop("p", DT, vec![PlanChannel::free("u", "-", vec![0.5; n]).within(-4.0, 5.0)])
                .with_loops(vec![demand], vec![l.clone()]);
        let record = play(&mut Lag::new(a, b), &plan, &mut Unwatched).unwrap().record;
        let o = oscillation(&record, &l).unwrap();
        assert_eq!(o.is_some(), share > 1.0, "at {share} of the critical gain: {o:?}");
        if let Some(o) = o {
            assert!((o.period_s - 2.0 * DT).abs() < 1e-9, "{o:?}");
        }
    }
}

/// Only stretches of constant demand are judged, and a channel that is not there is said.
#[test]
fn moving_demands_are_not_judged() {
    let n = 1000;
    let wave: Vec<f64> = (0..n).map(|t| 50.0 + 10.0 * (t as f64 * 0.2).sin()).collect();
    let moving = record(wave.clone(), wave.clone(), wave.clone());
    assert_eq!(oscillation(&moving, &the_loop()).unwrap(), None);
    let mut lacking = moving;
    lacking.channels.pop();
    assert!(oscillation(&lacking, &the_loop()).unwrap_err().to_string().contains("`y_demand`"));
}

/// Sensor noise alone, in many short stretches of constant demand, is no oscillation, although a proportional loop moves its input
/// with it.
#[test]
fn noise_in_short_stretches_is_left_alone() {
    let mut rng = Rng64::new(23);
    for _ in 0..500 {
        let hold = 60 + rng.below(60);
        let n = 8 * hold;
        let demand: Vec<f64> = (0..n).map(|t| 10.0 * (1 + (t / hold) % 2) as f64).collect();
        let e: Vec<f64> = (0..n).map(|_| 2.0 * rng.normal()).collect();
        let y: Vec<f64> = demand.iter().zip(&e).map(|(d, e)| d - e).collect();
        let seen = oscillation(&record(y, e, demand), &the_loop()).unwrap();
        assert!(seen.is_none(), "{seen:?}");
    }
}
