//! Initial states of slow systems in short records.

mod common;

use dynocal_ident::estimate::Estimator;
use dynocal_ident::estimate::initial::{FreeStates, Initial};
use dynocal_ident::estimate::pem::Pem;
use dynocal_ident::estimate::sem::Sem;
use dynocal_ident::experiment::Experiment;
use dynocal_ident::model::linear::LinearModel;
use dynocal_ident::model::poly::PolyNarx;
use dynocal_ident::model::{Model, Run, literature};
use dynocal_numerics::rng::Rng64;

const GAIN: f64 = 0.5;
const POLE: f64 = 0.97;

/// `y = 0.5 q^-1 / (1 - 0.97 q^-1) u + e`, cut out of operation: the state at the first sample is far from rest, and
/// each record begins with the same step.
fn short_records(count: usize, n: usize, noise: f64, seed: u64) -> Vec<Experiment> {
    let mut rng = Rng64::stream(31, seed);
    (0..count)
        .map(|k| {
            let mut state = 8.0 + 2.0 * rng.normal();
            let (mut u, mut y) = (Vec::new(), Vec::new());
            let mut level = 1.0;
            for t in 0..n {
                y.push(state + noise * rng.normal());
                if t >= 15 && rng.uniform() < 0.2 {
                    level = -level;
                }
                u.push(level);
                state = POLE * state + GAIN * level;
            }
            Experiment { name: format!("record {k}"), u, y, init_samples: 0, weights: vec![] }
        })
        .collect()
}

/// A start at rest is far off; estimated states are not.
#[test]
fn estimated_states_remove_the_bias_of_output_error_models() {
    let model = LinearModel::oe(&["u"], "y", 1, 1, 1);
    let truth = [GAIN, -POLE];
    let runs = 30;
    let mut errors = [[0.0; 2]; 3];
    for seed in 0..runs {
        let data = short_records(8, 50, 0.5, seed);
        for (row, initial) in errors.iter_mut().zip([Initial::Rest, Initial::Measured, Initial::Estimated]) {
            let fit = Pem { initial, ..Pem::default() }.estimate(&model, &data, None, &|| false).unwrap();
            for k in 0..2 {
                row[k] += (fit.theta[k] - truth[k]) / fit.std_errors[k] / runs as f64;
            }
        }
    }
    println!(
        "mean errors in standard errors: zero {:?}, data {:?}, estimate {:?}",
        errors[0], errors[1], errors[2]
    );
    let bound = 4.0 / (runs as f64).sqrt();
    assert!(errors[2].iter().all(|e| e.abs() < bound), "estimated states: {:?}", errors[2]);
    assert!(errors[0].iter().any(|e| e.abs() > 3.0 * bound), "zero start: {:?}", errors[0]);
}

/// On one long record the choice hardly matters; ARX from data is ordinary least squares.
#[test]
fn data_start_of_arx_is_least_squares() {
    let data = short_records(3, 200, 0.5, 1);
    let arx = LinearModel::arx(&["u"], "y", 2, 2, 1);
    let narx = PolyNarx::arx(&["u".into()], "y", 2, 2, 1, false).unwrap();
    let ols = dynocal_ident::estimate::ols::Ols::default().estimate(&narx, &data, None, &|| false).unwrap();
    for initial in [Initial::Measured, Initial::Estimated] {
        let fit = Pem { initial, ..Pem::default() }.estimate(&arx, &data, None, &|| false).unwrap();
        let expected = [-ols.theta[2], -ols.theta[3], ols.theta[0], ols.theta[1]];
        for (found, expected) in fit.theta.iter().zip(expected) {
            assert!((found - expected).abs() < 1e-8, "{initial:?}: {found} against {expected}");
        }
        assert_eq!(fit.samples, ols.samples);
    }
}

/// Free run of any model: estimated initial outputs against measured ones.
#[test]
fn estimated_initial_outputs_of_a_free_run() {
    let model = PolyNarx::parse(&["u"], "y", &["u(t-1)", "y(t-1)"]).unwrap();
    let truth = [GAIN, POLE];
    let runs = 30;
    let (mut measured, mut estimated) = ([0.0; 2], [0.0; 2]);
    for seed in 0..runs {
        let data = short_records(8, 50, 0.5, seed);
        let sem = Sem::default().estimate(&model, &data, None, &|| false).unwrap();
        let free = FreeStates::default().estimate(&model, &data, None, &|| false).unwrap();
        assert_eq!(free.initial.len(), 8);
        for k in 0..2 {
            measured[k] += (sem.theta[k] - truth[k]) / sem.std_errors[k] / runs as f64;
            estimated[k] += (free.fit.theta[k] - truth[k]) / free.fit.std_errors[k] / runs as f64;
        }
        // The same as the output-error model with estimated states, scored from the second sample on in both.
        let oe = LinearModel::oe(&["u"], "y", 1, 1, 1);
        let pem = Pem { initial: Initial::Estimated, ..Pem::default() };
        let fit = pem.estimate(&oe, &data, None, &|| false).unwrap();
        assert!(
            (fit.theta[0] - free.fit.theta[0]).abs() < 1e-6
                && (fit.theta[1] + free.fit.theta[1]).abs() < 1e-6
        );
        // Each has its own covariance for coloured errors, which a few of many white records are taken for.
        for k in 0..if fit.residuals.coloured || free.fit.residuals.coloured { 0 } else { 2 } {
            assert!((fit.std_errors[k] / free.fit.std_errors[k] - 1.0).abs() < 0.05);
        }
    }
    println!("mean errors in standard errors: measured {measured:?}, estimated {estimated:?}");
    let bound = 4.0 / (runs as f64).sqrt();
    assert!(estimated.iter().all(|e| e.abs() < bound), "{estimated:?}");
}

/// df/dy of the one-step prediction against central differences.
#[test]
fn derivatives_with_respect_to_past_outputs() {
    let general =
        PolyNarx::parse(&["a"], "y", &["1", "a(t-1)*y(t-1)^2", "y(t-2)^3", "y(t-1)*y(t-3)*a(t)", "a(t-2)"])
            .unwrap();
    let chapter5 = literature::torque_5_3();
    let mut rng = Rng64::new(6);
    let cases: [(&dyn Model, Vec<f64>); 2] =
        [(&general, (0..5).map(|_| rng.normal()).collect()), (&chapter5.model, chapter5.theta.clone())];
    for (model, theta) in cases {
        let n = 3 * model.max_lag() + 5;
        let u: Vec<f64> = (0..n * model.n_inputs()).map(|_| rng.normal()).collect();
        let y: Vec<f64> = (0..n).map(|_| rng.normal()).collect();
        let mut found = vec![0.0; model.output_lag()];
        let t = n - 1;
        model.output_derivatives(&theta, &Run { u: &u, y: &y, start: model.max_lag() }, t, &mut found);
        for lag in 1..=model.output_lag() {
            let value = |d: f64| {
                let mut moved = y.clone();
                moved[t - lag] += d;
                let mut out = vec![0.0; n];
                model.predict(&theta, &Run { u: &u, y: &moved, start: model.max_lag() }, &mut out);
                out[t]
            };
            let difference = (value(1e-5) - value(-1e-5)) / 2e-5;
            assert!((found[lag - 1] - difference).abs() < 1e-6 * (1.0 + difference.abs()), "lag {lag}");
        }
    }
}
