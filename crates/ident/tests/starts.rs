//! Where free runs start: rest, measured, estimated.

use dynocal_ident::experiment::Experiment;
use dynocal_ident::model::fitted::Fitted;
use dynocal_ident::model::initial::{Initial, free_run};
use dynocal_ident::model::linear::LinearModel;
use dynocal_ident::model::poly::PolyNarx;
use dynocal_ident::model::{Kind, Model};
use dynocal_numerics::rng::Rng64;
use dynocal_numerics::status::Status;

/// Slow poles at 0.99 and 0.97 with a gain of 33, noise of standard deviation 3.
fn noisy_output_error(seed: u64) -> (Fitted, Experiment, Vec<f64>) {
    let model = LinearModel::oe(&["u"], "y", 1, 2, 1);
    let fitted = Fitted::new(model, vec![0.01, -1.96, 0.9603]).unwrap();
    let mut rng = Rng64::new(seed);
    let mut u = Vec::new();
    while u.len() < 800 {
        let (hold, level) = (20 + rng.below(60), rng.uniform_in(-1.0, 1.0));
        u.extend(std::iter::repeat_n(level, hold));
    }
    u.truncate(800);
    let mut w = vec![0.0; 800];
    for t in 2..800 {
        w[t] = 0.01 * u[t - 1] + 1.96 * w[t - 1] - 0.9603 * w[t - 2];
    }
    // The record begins in the middle of a run.
    let (u, truth) = (u[200..].to_vec(), w[200..].to_vec());
    let y = truth.iter().map(|w| w + 3.0 * rng.normal()).collect();
    (fitted, Experiment { name: "oe".into(), u, y, init_samples: 0, weights: vec![] }, truth)
}

fn r2(truth: &[f64], found: &[f64], first: usize) -> f64 {
    let mean = truth[first..].iter().sum::<f64>() / (truth.len() - first) as f64;
    let spread: f64 = truth[first..].iter().map(|v| (v - mean).powi(2)).sum();
    let error: f64 = truth[first..].iter().zip(&found[first..]).map(|(a, b)| (a - b).powi(2)).sum();
    1.0 - error / spread
}

/// An output-error model knows one step ahead what it knows in free run, whatever the start; started from noisy outputs its
/// free run is useless, from estimated ones it is the truth but for the noise of two numbers.
#[test]
fn output_error_one_step_is_the_free_run() {
    for seed in 0..5 {
        let (fitted, e, truth) = noisy_output_error(seed);
        assert_eq!(fitted.initial(), Initial::Estimated);
        for rule in [Initial::Rest, Initial::Measured, Initial::Estimated] {
            let f = fitted.clone().starting(rule);
            let free = f.output(&e, Kind::FreeRun).unwrap();
            let first = f.first(&e);
            for kind in [Kind::OneStep, Kind::KStep(7)] {
                assert_eq!(f.output(&e, kind).unwrap()[first..], free[first..], "{rule:?}");
            }
        }
        let share = |rule| r2(&truth, &fitted.clone().starting(rule).output(&e, Kind::FreeRun).unwrap(), 3);
        assert!(share(Initial::Estimated) > 0.98, "{}", share(Initial::Estimated));
        assert!(share(Initial::Measured) < share(Initial::Estimated), "{}", share(Initial::Measured));
    }
}

/// The estimated start makes the sum of squares least: any other start of the same run is worse.
#[test]
fn estimated_outputs_are_a_minimum() {
    let model =
        PolyNarx::parse(&["u"], "y", &["u(t-1)", "y(t-1)", "y(t-2)", "u(t-1)*y(t-1)", "y(t-2)^3"]).unwrap();
    let theta = [0.4, 1.2, -0.4, 0.05, -0.02];
    let mut rng = Rng64::new(8);
    let n = 120;
    let u: Vec<f64> = (0..n).map(|_| rng.uniform_in(-1.0, 1.0)).collect();
    let mut y = vec![0.0; n];
    y[0] = 1.2;
    y[1] = 0.9;
    let zero = vec![0.0; n];
    let mut e = Experiment { name: "poly".into(), u, y: zero, init_samples: 0, weights: vec![] };
    e.y[..2].copy_from_slice(&y[..2]);
    let clean = free_run(&model, &theta, &e, 2, Initial::Measured).y;
    e.y = clean.iter().map(|v| v + 0.1 * rng.normal()).collect();
    let found = free_run(&model, &theta, &e, 2, Initial::Estimated);
    let cost = |states: &[f64]| -> f64 {
        let mut from = e.clone();
        from.y[..2].copy_from_slice(states);
        let run = free_run(&model, &theta, &from, 2, Initial::Measured).y;
        run[2..].iter().zip(&e.y[2..]).map(|(a, b)| (a - b).powi(2)).sum()
    };
    let best = cost(&found.states);
    assert!(best <= cost(&e.y[..2]));
    for k in 0..2 {
        for step in [-1e-3, 1e-3] {
            let mut moved = found.states.clone();
            moved[k] += step;
            assert!(cost(&moved) > best, "state {k}, step {step}: {} and {best}", cost(&moved));
        }
    }
}

/// Rest is an equilibrium: under constant inputs nothing moves; where zero is one, the run begins at zero.
#[test]
fn rest_stays_where_it_is() {
    let model = PolyNarx::parse(&["u"], "y", &["1", "u(t-2)", "y(t-1)", "u(t-1)*y(t-1)"]).unwrap();
    let theta = [2.0, 0.5, 0.7, -0.1];
    let e = Experiment {
        name: "still".into(),
        u: vec![1.5; 40],
        y: vec![3.0; 40],
        init_samples: 0,
        weights: vec![],
    };
    let run = free_run(&model, &theta, &e, 2, Initial::Rest);
    // y = 2 + 0.75 + 0.7 y - 0.15 y
    let level = 2.75 / 0.45;
    assert!(run.y.iter().all(|y| (y - level).abs() < 1e-9), "{:?}", &run.y[..3]);
    let without = PolyNarx::parse(&["u"], "y", &["u(t-1)", "y(t-1)"]).unwrap();
    let run = free_run(&without, &[1.0, 0.5], &e, 1, Initial::Rest);
    assert_eq!(run.y[..3], [0.0, 1.5, 2.25]);
    // Zero inputs would give zero, but these are not zero: neither with measured outputs nor without.
    let product = PolyNarx::parse(&["u"], "y", &["u(t-1)*u(t-2)", "y(t-1)"]).unwrap();
    for y in [3.0, f64::NAN] {
        let e = Experiment { y: vec![y; 40], ..e.clone() };
        let run = free_run(&product, &[1.0, 0.5], &e, 1, Initial::Rest);
        assert!(run.y.iter().all(|y| (y - 4.5).abs() < 1e-9), "{:?}", &run.y[..3]);
    }
    // No rest to start from: a growing model.
    let growing = PolyNarx::parse(&["u"], "y", &["1", "y(t-1)"]).unwrap();
    let run = free_run(&growing, &[1.0, 1.2], &e, 1, Initial::Rest);
    assert!(run.status == Status::Infeasible && run.y[0].is_nan() && growing.max_lag() == 1);
}
