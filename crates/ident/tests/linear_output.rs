//! Outputs and scores of linear models against the errors they minimise, the NARX form and the definition; estimates
//! under feedback.

mod common;

use common::systems::{System, random_system, simulate, simulate_with_reference};
use dynocal_ident::estimate::Estimator;
use dynocal_ident::estimate::initial::Initial;
use dynocal_ident::estimate::iv::Iv;
use dynocal_ident::estimate::ols::Ols;
use dynocal_ident::estimate::pem::Pem;
use dynocal_ident::experiment::Experiment;
use dynocal_ident::linear::{LinearFit, fit_linear};
use dynocal_ident::model::linear::{LinearModel, PredictionErrors};
use dynocal_ident::model::poly::PolyNarx;
use dynocal_ident::validate::{self, Kind};

/// One-step residuals are the prediction errors, from rest and from measured values; k-step errors are sums of k of them;
/// without noise every output is the measured one.
#[test]
fn predictions_are_the_errors_that_the_fit_minimises() {
    for case in 0..42 {
        let (s, mut e) = random_system(case);
        let n = e.len();
        let mut eps = vec![0.0; n];
        for initial in [Initial::Rest, Initial::Measured] {
            e.init_samples = if initial == Initial::Measured { 7 } else { 0 };
            let fit = Pem { initial, max_evaluations: 3, ..Pem::default() };
            let mut found = fit_linear(&s.model, std::slice::from_ref(&e), &fit, &|| false).unwrap();
            found.fit.theta.clone_from(&s.theta);
            let first = found.first(&e);
            let start = if initial == Initial::Measured { first } else { 0 };
            PredictionErrors::from_measured(&s.model, &e.u, &e.y, start).errors(&s.theta, &mut eps);
            let size = e.y.iter().fold(1.0, |m: f64, v| m.max(v.abs()));
            let general = s.model.na > 0 && s.model.orders.iter().any(|o| o.nf > 0);
            if general && initial == Initial::Measured {
                continue;
            }
            for (found, expected) in found.residuals(&e).iter().zip(&eps[first..]) {
                assert!(
                    (found - expected).abs() < 1e-9 * size,
                    "case {case} {initial:?}: {found} {expected}"
                );
            }
            let h = s.model.noise_response(&s.theta, 4);
            let ahead = found.output(&e, Kind::KStep(4));
            for t in first + 4..n {
                let error: f64 = (0..4).map(|j| h[j] * eps[t - j]).sum();
                assert!(
                    (e.y[t] - ahead[t] - error).abs() < 1e-9 * size,
                    "case {case} {initial:?} sample {t}"
                );
            }
        }
        let quiet = System { noise_std: 0.0, ..s.clone() };
        if s.model.n_inputs() > 0 {
            let e = simulate(&quiet, 200, 1);
            let found = LinearFit {
                model: s.model.clone(),
                initial: Initial::Rest,
                fit: Pem { max_evaluations: 2, ..Pem::default() }
                    .estimate(&s.model, &[random_system(case).1], None, &|| false)
                    .unwrap(),
                recovered: vec![],
            };
            let found = LinearFit {
                fit: dynocal_ident::estimate::Fit { theta: s.theta.clone(), ..found.fit },
                ..found
            };
            for kind in [Kind::OneStep, Kind::KStep(3), Kind::FreeRun] {
                let size = e.y.iter().fold(1.0, |m: f64, v| m.max(v.abs()));
                for (y, expected) in found.output(&e, kind).iter().zip(&e.y) {
                    assert!((y - expected).abs() < 1e-8 * size, "case {case} {kind:?}");
                }
            }
        }
    }
}

/// ARX from measured values: k-step and free run are those of the NARX form.
#[test]
fn arx_agrees_with_its_narx_form() {
    let s = System {
        model: LinearModel::arx(&["u"], "y", 2, 2, 1),
        theta: vec![-1.5, 0.7, 1.0, 0.5],
        noise_std: 0.5,
        feedback: 0.0,
    };
    let e = simulate(&s, 300, 2);
    let options = Pem { initial: Initial::Measured, ..Pem::default() };
    let found = fit_linear(&s.model, std::slice::from_ref(&e), &options, &|| false).unwrap();
    let narx = PolyNarx::arx(&["u".into()], "y", 2, 2, 1, false).unwrap();
    let t = &found.fit.theta;
    let theta = [t[2], t[3], -t[0], -t[1]];
    for kind in [Kind::OneStep, Kind::KStep(1), Kind::KStep(7), Kind::FreeRun] {
        let expected = validate::output(&narx, &theta, &e, kind);
        for (a, b) in found.output(&e, kind).iter().zip(&expected) {
            assert!((a - b).abs() < 1e-10, "{kind:?}: {a} {b}");
        }
    }
    let again: LinearFit = serde_json::from_str(&serde_json::to_string(&found).unwrap()).unwrap();
    assert_eq!(again.output(&e, Kind::FreeRun), found.output(&e, Kind::FreeRun));
    let gain = found.model.static_gain(t, 0);
    assert!((gain - (t[2] + t[3]) / (1.0 + t[0] + t[1])).abs() < 1e-12);
}

/// ARMAX under feedback, 100 records: the prediction-error fit with the right noise model and instruments from the
/// external reference are unbiased, least squares is not.
#[test]
fn estimates_in_closed_loop() {
    let s = System {
        model: LinearModel::armax(&["u"], "y", 2, 2, 2, 1),
        theta: vec![-1.5, 0.7, 1.0, 0.5, -1.0, 0.2],
        noise_std: 0.5,
        feedback: 0.3,
    };
    let narx = PolyNarx::arx(&["u".into()], "y", 2, 2, 1, false).unwrap();
    let runs = 100;
    let order = |t: &[f64]| [-t[2], -t[3], t[0], t[1]];
    let mut errors = vec![Vec::new(); 3];
    for seed in 0..runs {
        let (e, r) = simulate_with_reference(&s, 1500, 500 + seed);
        let data: [Experiment; 1] = [e];
        let pem = Pem::default().estimate(&s.model, &data, None, &|| false).unwrap();
        let iv = Iv::default().estimate_with(&narx, &data, Some(&[&r[..]])).unwrap();
        let ols = Ols::default().estimate(&narx, &data, None, &|| false).unwrap();
        for (all, theta) in errors.iter_mut().zip([&pem.theta[..4], &order(&iv.theta), &order(&ols.theta)]) {
            all.push((0..4).map(|k| theta[k] - s.theta[k]).collect::<Vec<f64>>());
        }
    }
    let moments = |all: &[Vec<f64>], k: usize| {
        let n = all.len() as f64;
        let mean = all.iter().map(|e| e[k]).sum::<f64>() / n;
        (mean, (all.iter().map(|e| (e[k] - mean).powi(2)).sum::<f64>() / (n - 1.0) / n).sqrt())
    };
    for k in 0..4 {
        let [pem, iv, ols] = [0, 1, 2].map(|i| moments(&errors[i], k));
        println!(
            "{k}: PEM {:.5} +- {:.5}, IV {:.5} +- {:.5}, OLS {:.5} +- {:.5}",
            pem.0, pem.1, iv.0, iv.1, ols.0, ols.1
        );
        assert!(pem.0.abs() < 4.0 * pem.1, "PEM, parameter {k}: {pem:?}");
        assert!(iv.0.abs() < 4.0 * iv.1, "IV, parameter {k}: {iv:?}");
    }
    let (bias, error) = moments(&errors[2], 0);
    assert!(bias.abs() > 10.0 * error, "least squares: {bias} +- {error}");
}
