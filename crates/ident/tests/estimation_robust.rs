//! Estimation with data that are too short, dependent, constant or lead to unstable models; and what the
//! covariance promises.

use dynocal_ident::data::{Channel, DataError, Dataset, Role};
use dynocal_ident::estimate::ols::Ols;
use dynocal_ident::estimate::sem::Sem;
use dynocal_ident::estimate::{ESTIMATORS, EstimateError, Estimator, Fits, estimator};
use dynocal_ident::experiment::{Experiment, experiments};
use dynocal_ident::model::poly::PolyNarx;
use dynocal_ident::model::{Model, Run};
use dynocal_numerics::rng::Rng64;
use dynocal_numerics::status::Status;

fn channel(name: &str, role: Role, values: Vec<f64>) -> Channel {
    Channel { name: name.into(), unit: "-".into(), role, values }
}

fn noise(n: usize, seed: u64) -> Vec<f64> {
    let mut rng = Rng64::new(seed);
    (0..n).map(|_| rng.normal()).collect()
}

fn record(u: Vec<f64>, v: Vec<f64>, y: Vec<f64>) -> Dataset {
    Dataset {
        name: "bed07".into(),
        sample_time_s: 0.03,
        channels: vec![
            channel("u", Role::Input, u),
            channel("v", Role::Input, v),
            channel("y", Role::Output, y),
        ],
        init_samples: 0,
        origin: "test".into(),
    }
}

fn names() -> Vec<String> {
    vec!["u".into(), "v".into()]
}

fn simulated(model: &PolyNarx, theta: &[f64], n: usize, std: f64, seed: u64) -> Experiment {
    let mut rng = Rng64::new(seed);
    let u: Vec<f64> = (0..n * model.n_inputs()).map(|_| rng.uniform_in(-1.0, 1.0)).collect();
    let (zeros, mut y) = (vec![0.0; n], vec![0.0; n]);
    model.simulate(theta, &Run { u: &u, y: &zeros, start: model.max_lag() }, &mut y);
    y.iter_mut().for_each(|v| *v += std * rng.normal());
    Experiment { name: format!("sim{seed}"), u, y, init_samples: 0, weights: Vec::new() }
}

#[test]
fn a_constant_input_is_refused_by_name() {
    let fault = experiments(&[record(noise(50, 1), vec![7.5; 50], noise(50, 2))], &names(), "y").unwrap_err();
    assert_eq!(
        fault.to_string(),
        "bed07: input `v` is constant (7.5) over all 50 samples: it excites nothing; remove it from the inputs or \
         record a test that moves it"
    );
    // It may rest in one record when it moves in another.
    let moving = record(noise(50, 1), noise(50, 3), noise(50, 2));
    let resting = record(noise(50, 1), vec![7.5; 50], noise(50, 2));
    assert_eq!(experiments(&[resting, moving], &names(), "y").unwrap().len(), 2);
}

#[test]
fn unlike_sample_times_and_bad_samples_are_refused() {
    let a = record(noise(50, 1), noise(50, 3), noise(50, 2));
    let slow = Dataset { sample_time_s: 0.1, ..a.clone() };
    let message = experiments(&[a.clone(), slow], &names(), "y").unwrap_err().to_string();
    assert_eq!(message, "bed07: sample time 0.1 s, expected 0.03 s as in bed07");
    let mut broken = a;
    broken.channels[1].values[17] = f64::NAN;
    let fault = experiments(&[broken], &names(), "y").unwrap_err();
    assert!(matches!(fault, DataError::NonFinite { ref channel, sample: 17, .. } if channel == "v"));
}

#[test]
fn fewer_samples_than_parameters_are_refused() {
    let model = PolyNarx::arx(&names(), "y", 2, 3, 1, true).unwrap();
    let short = experiments(&[record(noise(11, 1), noise(11, 3), noise(11, 2))], &names(), "y").unwrap();
    for e in [&Ols::default() as &dyn Estimator, &Sem::default()] {
        let fault = e.estimate(&model, &short, None, &|| false).unwrap_err();
        assert_eq!(fault.to_string(), "bed07: 8 usable samples, expected at least 9 (9 parameters)");
    }
    let shorter = experiments(&[record(noise(3, 1), noise(3, 3), noise(3, 2))], &names(), "y").unwrap();
    let fault = Ols::default().estimate(&model, &shorter, None, &|| false).unwrap_err();
    assert!(matches!(fault, EstimateError::Data(DataError::TooShort { found: 3, expected: 4, .. })));
}

#[test]
fn dependent_regressors_are_named_and_the_rest_is_estimated() {
    let model = PolyNarx::parse(&["u", "v"], "y", &["u(t-1)", "v(t-1)", "y(t-1)"]).unwrap();
    let mut e = simulated(&model, &[1.0, 0.5, 0.3], 300, 0.0, 5);
    // v becomes twice u: y keeps depending on u alone, with 1 + 2 * 0.5 in place of 1.
    (0..e.len()).for_each(|t| e.u[2 * t + 1] = 2.0 * e.u[2 * t]);
    let (zeros, u) = (vec![0.0; e.len()], e.u.clone());
    model.simulate(&[1.0, 0.5, 0.3], &Run { u: &u, y: &zeros, start: 1 }, &mut e.y);
    for estimator in [&Ols::default() as &dyn Estimator, &Sem::default()] {
        let fit = estimator.estimate(&model, std::slice::from_ref(&e), None, &|| false).unwrap();
        assert_eq!(fit.rank, 2);
        assert!(
            fit.warnings[0].contains("rank 2 of 3") && fit.warnings[0].contains("(t-1)`"),
            "{:?}",
            fit.warnings
        );
        assert!((fit.theta[0] + 2.0 * fit.theta[1] - 2.0).abs() < 1e-8, "{:?}", fit.theta);
        assert_eq!(fit.std_errors.iter().filter(|v| v.is_nan()).count(), 1);
        let stored = serde_json::to_string(&fit).unwrap();
        let read: dynocal_ident::estimate::Fit = serde_json::from_str(&stored).unwrap();
        assert_eq!(read.theta, fit.theta);
        assert_eq!(read.std_errors.iter().filter(|v| v.is_nan()).count(), 1);
    }
}

/// Both estimators find the truth without noise; simulation error beats least squares with output noise.
#[test]
fn every_estimator_finds_the_truth_without_noise() {
    let model =
        PolyNarx::parse(&["u"], "y", &["1", "u(t-1)", "u(t-2)^2", "y(t-1)", "y(t-1)*u(t-1)"]).unwrap();
    let truth = [0.2, 1.0, -0.5, 0.6, 0.2];
    let data = [simulated(&model, &truth, 400, 0.0, 1), simulated(&model, &truth, 300, 0.0, 2)];
    for member in ESTIMATORS {
        let found = (member.build)(&toml::Table::new()).unwrap().estimate(&model, &data, None, &|| false);
        if member.fits != Fits::Narx {
            // What it does not fit it refuses by name, as its row says.
            let fault = found.unwrap_err().to_string();
            assert!(fault.contains(member.doc.name) && fault.contains("form `polynomial`"), "{fault}");
            continue;
        }
        let fit = found.unwrap();
        assert_eq!(fit.status, Status::Converged, "{}", member.doc.name);
        assert_eq!(fit.estimator, member.doc.name);
        for (found, expected) in fit.theta.iter().zip(truth) {
            assert!((found - expected).abs() < 1e-9, "{}: {found} {expected}", member.doc.name);
        }
    }
    let noisy = [simulated(&model, &truth, 2000, 0.2, 3)];
    let ols = Ols::default().estimate(&model, &noisy, None, &|| false).unwrap();
    let sem = Sem::default().estimate(&model, &noisy, None, &|| false).unwrap();
    // Output noise biases least squares beyond its standard errors, and simulation error not at all.
    let off = |fit: &dynocal_ident::estimate::Fit| {
        let each = fit.theta.iter().zip(truth).zip(&fit.std_errors).map(|((a, b), s)| (a - b).abs() / s);
        each.fold(0.0, f64::max)
    };
    assert!(off(&sem) < 4.0 && off(&ols) > 4.0, "{} {}", off(&sem), off(&ols));
    assert!((sem.noise_variance.sqrt() - 0.2).abs() < 0.02);
}

/// Standard errors are the spread of estimates over noise (300 draws; the spread is known to 4 %).
#[test]
fn standard_errors_are_the_spread_over_noise() {
    let model = PolyNarx::parse(&["u"], "y", &["1", "u(t-1)", "u(t-1)^2", "y(t-1)"]).unwrap();
    let truth = [0.2, 1.0, -0.5, 0.7];
    let clean = simulated(&model, &truth, 400, 0.0, 1);
    let draws = 300;
    let (mut sum, mut square, mut promised) = ([0.0; 4], [0.0; 4], [0.0; 4]);
    let mut rng = Rng64::new(77);
    for _ in 0..draws {
        let mut e = clean.clone();
        e.y[1..].iter_mut().for_each(|v| *v += 0.3 * rng.normal());
        let fit = Sem::default().estimate(&model, &[e], None, &|| false).unwrap();
        for k in 0..4 {
            sum[k] += fit.theta[k];
            square[k] += (fit.theta[k] - truth[k]).powi(2);
            promised[k] += fit.std_errors[k];
        }
    }
    let n = f64::from(draws);
    for k in 0..4 {
        let (mean, spread, promised) = (sum[k] / n, (square[k] / n).sqrt(), promised[k] / n);
        assert!((spread / promised - 1.0).abs() < 0.17, "theta {k}: spread {spread}, promised {promised}");
        assert!((mean - truth[k]).abs() < 4.0 * spread / n.sqrt(), "theta {k}: biased to {mean}");
    }
}

/// Least squares on output noise over a slow nonlinear system gives an unstable free run; the search must survive.
#[test]
fn an_unstable_start_is_repaired_and_said() {
    // The true system is stable; the record is short and its output term multiplied by a large input at the end.
    let model =
        PolyNarx::parse(&["u"], "y", &["1", "u(t-1)", "y(t-1)", "u(t-1)*y(t-1)", "y(t-1)^3"]).unwrap();
    let mut rng = Rng64::new(3);
    let n = 400;
    let u: Vec<f64> = (0..n).map(|_| rng.uniform_in(-1.0, 1.0)).collect();
    // Not of the model class: least squares extrapolates the cubic term and its free run runs away.
    let mut y = vec![0.0; n];
    for t in 1..n {
        y[t] = 0.98 * y[t - 1] + 0.3 * u[t - 1] + 0.02 * (3.0 * y[t - 1]).sin();
    }
    y.iter_mut().for_each(|v| *v += 0.02 * rng.normal());
    let mut e = Experiment { name: "slow".into(), u, y, init_samples: 0, weights: Vec::new() };
    // A drift in the record makes the fitted pole leave the unit circle.
    e.y.iter_mut().enumerate().for_each(|(t, v)| *v += (0.02 * t as f64).exp() * 0.01);
    let ols = Ols::default().estimate(&model, std::slice::from_ref(&e), None, &|| false).unwrap();
    let mut free = vec![0.0; n];
    assert_eq!(model.simulate(&ols.theta, &e.run(&model), &mut free), Status::Diverged, "{:?}", ols.theta);
    let sem = Sem::default().estimate(&model, std::slice::from_ref(&e), None, &|| false).unwrap();
    assert!(
        sem.warnings[0].contains("diverges") && sem.warnings[0].contains("output terms times"),
        "{:?}",
        sem.warnings
    );
    let mean = e.y.iter().sum::<f64>() / n as f64;
    let variance = e.y.iter().map(|v| (v - mean).powi(2)).sum::<f64>() / n as f64;
    assert!(sem.mse < variance, "{} of {variance}", sem.mse);
}

#[test]
fn a_given_unstable_start_is_an_error_that_names_the_model() {
    let model = PolyNarx::parse(&["u"], "y", &["u(t-1)", "y(t-1)^2"]).unwrap();
    let e = simulated(&model, &[0.3, 0.1], 200, 0.0, 1);
    let fault = Sem::default().estimate(&model, &[e], Some(&[5.0, 3.0]), &|| false).unwrap_err();
    let text = fault.to_string();
    assert!(text.contains("`u(t-1) + y(t-1)^2`") && text.contains("diverges on sim1 from sample"), "{text}");
    let e = simulated(&model, &[0.3, 0.1], 200, 0.0, 1);
    let fault = Sem::default().estimate(&model, &[e], Some(&[5.0]), &|| false).unwrap_err();
    assert_eq!(fault.to_string(), "start point has 1 entries, the model has 2 parameters");
}

#[test]
fn weights_of_zero_take_samples_out() {
    let model = PolyNarx::parse(&["u"], "y", &["u(t-1)", "u(t-2)"]).unwrap();
    let mut e = simulated(&model, &[1.0, 0.5], 200, 0.0, 1);
    e.y[100..].iter_mut().for_each(|v| *v = 99.0);
    e.weights = (0..200).map(|t| if t < 100 { 1.0 } else { 0.0 }).collect();
    for estimator in [&Ols::default() as &dyn Estimator, &Sem::default()] {
        let fit = estimator.estimate(&model, std::slice::from_ref(&e), None, &|| false).unwrap();
        assert!((fit.theta[0] - 1.0).abs() < 1e-9 && (fit.theta[1] - 0.5).abs() < 1e-9, "{:?}", fit.theta);
    }
}

/// Ridge against its closed form for one regressor: sum(x y) / (sum x^2 + ridge n rms^2) = ls / (1 + ridge).
#[test]
fn ridge_shrinks_by_its_closed_form_in_any_unit() {
    let model = PolyNarx::parse(&["u"], "y", &["u(t-1)"]).unwrap();
    for unit in [1.0, 1e6] {
        let mut e = simulated(&model, &[2.0], 300, 0.1, 4);
        e.u.iter_mut().for_each(|v| *v *= unit);
        let plain = Ols::default().estimate(&model, std::slice::from_ref(&e), None, &|| false).unwrap();
        let ridge = Ols { ridge: 0.25, ..Ols::default() }
            .estimate(&model, std::slice::from_ref(&e), None, &|| false)
            .unwrap();
        assert!((ridge.theta[0] * 1.25 / plain.theta[0] - 1.0).abs() < 1e-12);
        // Without output terms simulation is prediction, so both estimators solve the same problem.
        let sem = Sem { ridge: 0.25, ..Sem::default() };
        let sem = sem.estimate(&model, std::slice::from_ref(&e), None, &|| false).unwrap();
        assert!((sem.theta[0] / ridge.theta[0] - 1.0).abs() < 1e-9);
        assert!((sem.mse / ridge.mse - 1.0).abs() < 1e-9);
    }
}

#[test]
fn unknown_estimators_and_keys_are_refused() {
    assert!(estimator("semm", &toml::Table::new()).err().unwrap().to_string().contains("did you mean `sem`"));
    let keys = toml::from_str("max_evaluation = 5").unwrap();
    assert!(estimator("sem", &keys).err().unwrap().to_string().contains("max_evaluation"));
}

#[test]
fn an_interrupted_search_returns_its_best_point() {
    let model = PolyNarx::parse(&["u"], "y", &["1", "u(t-1)", "y(t-1)"]).unwrap();
    let e = simulated(&model, &[0.1, 1.0, 0.8], 300, 0.3, 1);
    let fit = Sem::default().estimate(&model, &[e], None, &|| true).unwrap();
    assert_eq!(fit.status, Status::Interrupted);
    assert!(fit.mse.is_finite());
}
