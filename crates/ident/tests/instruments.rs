//! Instrumental variables against numpy (the stored values of the reference data) and the truth; recursive least
//! squares against batch least squares.

mod common;

use common::{dataset, reference};
use dynocal_ident::data::Role;
use dynocal_ident::estimate::iv::Iv;
use dynocal_ident::estimate::ols::Ols;
use dynocal_ident::estimate::rls::{OnlineModel, Rls};
use dynocal_ident::estimate::{Estimator, estimator};
use dynocal_ident::experiment::Experiment;
use dynocal_ident::model::poly::PolyNarx;
use dynocal_ident::model::{Model, Run};
use dynocal_numerics::linalg::least_squares;
use dynocal_numerics::rng::Rng64;

/// y on u and the external reference r of a stored case.
fn case(name: &str) -> Option<(Experiment, Vec<f64>)> {
    let path = reference(&format!("estimation_inputs/lin_{name}.csv"))?;
    let d = dataset(
        &path,
        1.0,
        &[("u", "u", Role::Input), ("y", "y", Role::Output), ("r", "r", Role::Auxiliary)],
    );
    let take = |c: &str| d.values(c).unwrap().to_vec();
    let e = Experiment { name: name.into(), u: take("u"), y: take("y"), init_samples: 0, weights: vec![] };
    Some((e, take("r")))
}

/// Our order is B, then y(t-1).. with the sign turned.
fn as_reference(theta: &[f64], na: usize) -> Vec<f64> {
    let nb = theta.len() - na;
    theta[nb..].iter().map(|v| -v).chain(theta[..nb].iter().copied()).collect()
}

#[test]
fn stored_cases_agree_with_the_reference() {
    let Some(path) = reference("estimation_fuel_reference.json") else { return };
    let json: serde_json::Value = serde_json::from_str(&std::fs::read_to_string(path).unwrap()).unwrap();
    let numbers = |case: &str, key: &str| -> Vec<f64> {
        json["part2"][case][key].as_array().unwrap().iter().map(|v| v.as_f64().unwrap()).collect()
    };
    for (name, na, nb, nk) in
        [("arx1", 2, 2, 1), ("arx2", 3, 2, 3), ("armax1", 2, 2, 1), ("armax2", 1, 2, 2), ("cl_arx", 2, 2, 1)]
    {
        let Some((e, r)) = case(name) else { return };
        let model = PolyNarx::arx(&["u".into()], "y", na, nb, nk, false).unwrap();
        let closed = name == "cl_arx";
        let drive = [&r[..]];
        let drive = closed.then_some(&drive[..]);
        for (four_step, key) in [(false, "iv"), (true, "iv4")] {
            let iv = Iv { four_step, ..Iv::default() };
            let fit = iv.estimate_with(&model, std::slice::from_ref(&e), drive).unwrap();
            let (expected, truth) = (numbers(name, key), numbers(name, "truth"));
            let (found, std) = (as_reference(&fit.theta, na), as_reference(&fit.std_errors, na));
            let off = |other: &[f64]| {
                (0..na + nb).map(|k| (found[k] - other[k]).abs() / std[k].abs()).fold(0.0, f64::max)
            };
            println!("{name} {key}: {:.1e} standard errors from the reference", off(&expected));
            // The reference starts its simulations at rest, ours from the measured outputs, and it does not say how
            // its noise filters start.
            assert!(off(&expected) < 0.1, "{name} {key}: {found:?} against {expected:?}");
            // The white-noise covariance is that of the four-step estimate only.
            assert!(!four_step || off(&truth[..na + nb]) < 4.0, "{name} {key}: {found:?}");
        }
    }
}

/// ARMAX in closed loop: least squares is biased, the external reference gives instruments that are not.
#[test]
fn closed_loop_with_coloured_noise() {
    let model = PolyNarx::arx(&["u".into()], "y", 2, 2, 1, false).unwrap();
    let truth = [1.0, 0.5, 1.5, -0.7]; // b0, b1, -a1, -a2
    let (mut biased, runs) = (0_u64, 6);
    for seed in 0..runs {
        let (e, r) = closed_loop(4000, seed);
        let worst = |fit: &dynocal_ident::estimate::Fit| {
            (0..4).map(|k| (fit.theta[k] - truth[k]).abs() / fit.std_errors[k]).fold(0.0, f64::max)
        };
        let data = [e];
        let ols = Ols::default().estimate(&model, &data, None, &|| false).unwrap();
        biased += u64::from(worst(&ols) > 6.0);
        let iv = Iv::default().estimate_with(&model, &data, Some(&[&r[..]])).unwrap();
        assert!(worst(&iv) < 4.0, "seed {seed}: {:?} off by {}", iv.theta, worst(&iv));
    }
    assert_eq!(biased, runs, "the case must be one that least squares gets wrong");
}

/// `A y = B u + C e` with A = 1 - 1.5 q^-1 + 0.7 q^-2, B = q^-1 + 0.5 q^-2, C = 1 - q^-1 + 0.2 q^-2, u = r - 0.3 y.
fn closed_loop(n: usize, seed: u64) -> (Experiment, Vec<f64>) {
    let mut rng = Rng64::stream(21, seed);
    let (mut u, mut y, mut r, mut e) = (vec![0.0; n], vec![0.0; n], vec![1.0; n], vec![0.0; n]);
    for t in 2..n {
        r[t] = if rng.uniform() < 0.2 { -r[t - 1] } else { r[t - 1] };
        e[t] = 0.5 * rng.normal();
        y[t] = 1.5 * y[t - 1] - 0.7 * y[t - 2] + u[t - 1] + 0.5 * u[t - 2] + e[t] - e[t - 1] + 0.2 * e[t - 2];
        u[t] = r[t] - 0.3 * y[t];
    }
    (Experiment { name: "loop".into(), u, y, init_samples: 0, weights: vec![] }, r)
}

/// A polynomial model with output noise: the bias of least squares is gone.
#[test]
fn polynomial_models_with_output_noise() {
    let model = PolyNarx::parse(&["u"], "y", &["1", "u(t-1)", "u(t-2)^2", "y(t-1)"]).unwrap();
    let truth = [0.2, 1.0, -0.5, 0.7];
    let mut rng = Rng64::new(4);
    let n = 4000;
    let u: Vec<f64> = (0..n).map(|_| rng.uniform_in(-1.0, 1.0)).collect();
    let mut y = vec![0.0; n];
    model.simulate(&truth, &Run { u: &u, y: &vec![0.0; n], start: 2 }, &mut y);
    y.iter_mut().for_each(|v| *v += 0.3 * rng.normal());
    let data = [Experiment { name: "noisy".into(), u, y, init_samples: 0, weights: vec![] }];
    let ols = Ols::default().estimate(&model, &data, None, &|| false).unwrap();
    let iv = Iv::default().estimate(&model, &data, None, &|| false).unwrap();
    assert!((ols.theta[3] - truth[3]).abs() > 10.0 * ols.std_errors[3]);
    for k in 0..4 {
        assert!((iv.theta[k] - truth[k]).abs() < 4.0 * iv.std_errors[k], "{:?}", iv.theta);
    }
}

#[test]
fn a_reference_of_the_wrong_length_is_named() {
    let (e, r) = closed_loop(100, 0);
    let model = PolyNarx::arx(&["u".into()], "y", 2, 2, 1, false).unwrap();
    let fault = Iv::default().estimate_with(&model, &[e], Some(&[&r[..99]])).unwrap_err();
    assert!(fault.to_string().contains("`reference` has 99 samples"), "{fault}");
}

/// Without forgetting it is batch least squares with the start as a prior, sample by sample.
#[test]
fn recursive_least_squares_is_batch_least_squares() {
    let (p, n, prior) = (4, 60, 25.0);
    let mut rng = Rng64::new(8);
    let phi: Vec<f64> = (0..n * p).map(|j| (1.0 + (j % p) as f64) * rng.normal()).collect();
    let y: Vec<f64> = (0..n).map(|_| rng.normal()).collect();
    let mut rls = Rls::new(&vec![0.0; p], 1.0 / prior, 1.0);
    for t in 0..n {
        let before = rls.theta().to_vec();
        let error = rls.update(&phi[t * p..(t + 1) * p], y[t]);
        let expected: f64 = y[t] - (0..p).map(|k| phi[t * p + k] * before[k]).sum::<f64>();
        assert!((error - expected).abs() < 1e-14);
        let batch = least_squares(&phi[..(t + 1) * p], t + 1, p, &y[..=t], prior).unwrap();
        for k in 0..p {
            assert!((rls.theta()[k] - batch.x[k]).abs() < 1e-11, "sample {t}, parameter {k}");
        }
    }
    // P is the inverse of Phi'Phi + prior I.
    let covariance = rls.covariance();
    for i in 0..p {
        for j in 0..p {
            let information = |a: usize, b: usize| -> f64 {
                (0..n).map(|t| phi[t * p + a] * phi[t * p + b]).sum::<f64>()
                    + if a == b { prior } else { 0.0 }
            };
            let product: f64 = (0..p).map(|k| covariance[i * p + k] * information(k, j)).sum();
            assert!((product - f64::from(u8::from(i == j))).abs() < 1e-11);
        }
    }
}

/// With forgetting it is least squares with exponential weights.
#[test]
fn forgetting_is_exponential_weighting() {
    let (n, lambda, prior): (usize, f64, f64) = (80, 0.95, 0.01);
    let mut rng = Rng64::new(12);
    let phi: Vec<f64> = (0..2 * n).map(|_| rng.normal()).collect();
    let y: Vec<f64> = (0..n).map(|_| rng.normal()).collect();
    let mut rls = Rls::new(&[0.0, 0.0], 1.0 / prior, lambda);
    (0..n).for_each(|t| {
        rls.update(&phi[2 * t..2 * t + 2], y[t]);
    });
    let root = |t: usize| lambda.powf((n - 1 - t) as f64 / 2.0);
    let weighted: Vec<f64> = (0..2 * n).map(|j| root(j / 2) * phi[j]).collect();
    let target: Vec<f64> = (0..n).map(|t| root(t) * y[t]).collect();
    let batch = least_squares(&weighted, n, 2, &target, prior * lambda.powi(n as i32)).unwrap();
    for k in 0..2 {
        assert!((rls.theta()[k] - batch.x[k]).abs() < 1e-11);
    }
}

/// As an estimator over a record: with a wide start it is least squares with its standard errors, in any units; with
/// forgetting the last samples decide, and the standard errors are those of the samples that are remembered.
#[test]
fn the_estimator_rls_follows_the_last_samples() {
    let model = PolyNarx::parse(&["u"], "y", &["u(t-1)", "y(t-1)"]).unwrap();
    let n = 4000;
    let mut rng = Rng64::new(21);
    let u: Vec<f64> = (0..n).map(|_| 1e4 * rng.normal()).collect();
    let noise: Vec<f64> = (0..n).map(|_| 0.1 * rng.normal()).collect();
    // The gain changes in the middle of the record.
    let record = |after: f64| {
        let mut y = vec![0.0; n];
        for t in 1..n {
            let gain = if t < n / 2 { 1e-4 } else { after };
            y[t] = 0.5 * y[t - 1] + gain * u[t - 1] + noise[t];
        }
        [Experiment { name: "a".into(), u: u.clone(), y, init_samples: 0, weights: vec![] }]
    };
    let fit = |name: &str, keys: &str, data: &[Experiment]| {
        estimator(name, &toml::from_str(keys).unwrap())
            .unwrap()
            .estimate(&model, data, None, &|| false)
            .unwrap()
    };
    let same = record(1e-4);
    let (batch, wide) = (fit("ols", "", &same), fit("rls", "variance = 1e12", &same));
    for k in 0..2 {
        let off = (wide.theta[k] - batch.theta[k]) / batch.std_errors[k];
        assert!(off.abs() < 1e-3, "parameter {k}: {off} standard errors");
        assert!((wide.std_errors[k] / batch.std_errors[k] - 1.0).abs() < 1e-6, "parameter {k}");
    }
    let data = record(3e-4);
    let (all, last) = (fit("rls", "", &data), fit("rls", "forgetting = 0.99", &data));
    assert!((all.theta[0] - 2e-4).abs() < 0.3e-4, "{}", all.theta[0]);
    assert!(
        (last.theta[0] - 3e-4).abs() < 4.0 * last.std_errors[0],
        "{} {}",
        last.theta[0],
        last.std_errors[0]
    );
    // 100 samples are remembered.
    let expected = 0.1 / (100.0_f64.sqrt() * 1e4);
    assert!((last.std_errors[0] / expected - 1.0).abs() < 0.3, "{} {expected}", last.std_errors[0]);
    for (keys, part) in
        [("forgetting = 0.0", "`forgetting`"), ("variance = -1.0", "`variance`"), ("lambda = 1", "lambda")]
    {
        let fault = estimator("rls", &toml::from_str(keys).unwrap()).err().unwrap().to_string();
        assert!(fault.contains(part), "{fault}");
    }
}

/// A gain that drifts from 1 to 3: with forgetting it is followed, without it is averaged. Then the excitation stops,
/// and P stays bounded.
#[test]
fn a_drifting_parameter_is_tracked() {
    let n = 3000;
    let mut rng = Rng64::new(5);
    let gain = |t: usize| 1.0 + 2.0 * t as f64 / n as f64;
    let (mut quick, mut slow) = (Rls::new(&[0.0], 1e4, 0.98), Rls::new(&[0.0], 1e4, 1.0));
    let mut error = 0.0_f64;
    for t in 0..n {
        let x = rng.normal();
        let y = gain(t) * x + 0.05 * rng.normal();
        quick.update(&[x], y);
        slow.update(&[x], y);
        if t > 500 {
            error = error.max((quick.theta()[0] - gain(t)).abs());
        }
    }
    // Lag of about 50 samples at 2/3000 a sample, and the noise of as many.
    assert!(error < 0.1, "{error}");
    assert!((slow.theta()[0] - gain(n)).abs() > 0.5);
    let before = quick.theta()[0];
    (0..100_000).for_each(|_| {
        quick.update(&[0.0], 0.0);
    });
    assert_eq!(quick.theta()[0], before);
    assert!(quick.covariance()[0] <= 1e7 * 1.000_001);
    assert!(quick.update(&[f64::NAN], 1.0).is_nan() && quick.theta()[0] == before);
}

/// On the regressors of a polynomial model, sample by sample: without forgetting it ends at least squares, whatever is
/// missing is left out, and after a reset a changed plant is found.
#[test]
fn a_model_is_identified_online() {
    let model = PolyNarx::parse(&["u"], "y", &["1", "u(t-1)", "u(t-3)^2", "y(t-2)"]).unwrap();
    let (truth, n) = ([0.2, 1.0, -0.5, 0.6], 500);
    let mut rng = Rng64::new(2);
    let plant = |gain: f64, rng: &mut Rng64, seen: &mut dyn FnMut(f64, f64)| {
        let (mut u, mut y) = (vec![0.0; n], vec![0.0; n]);
        for t in 0..n {
            u[t] = rng.uniform_in(-1.0, 1.0);
            if t >= 3 {
                y[t] =
                    truth[0] + gain * truth[1] * u[t - 1] + truth[2] * u[t - 3].powi(2) + truth[3] * y[t - 2];
                y[t] += 0.1 * rng.normal();
            }
            seen(u[t], y[t]);
        }
        (u, y)
    };
    let mut online = OnlineModel::new(&model, &[0.0; 4], 1e8, 1.0).unwrap();
    let (u, y) = plant(1.0, &mut rng, &mut |u, y| {
        online.update(&[u], y);
    });
    let data = [Experiment { name: "online".into(), u, y, init_samples: 0, weights: vec![] }];
    let ols = Ols::default().estimate(&model, &data, None, &|| false).unwrap();
    for k in 0..4 {
        assert!((online.rls().theta()[k] - ols.theta[k]).abs() < 1e-7, "{k}");
        let stated = (ols.noise_variance * online.rls().covariance()[k * 4 + k]).sqrt();
        assert!((stated / ols.std_errors[k] - 1.0).abs() < 1e-5, "{k}");
    }
    let before = online.rls().theta().to_vec();
    assert!(online.update(&[0.3], f64::NAN).is_nan() && online.rls().theta() == before);
    // Twice the gain: a reset lets it be followed, without one the past weighs as much as the present.
    let mut stubborn = OnlineModel::new(&model, &before, 1e-5, 1.0).unwrap();
    online.reset(1e4);
    plant(2.0, &mut rng, &mut |u, y| {
        online.update(&[u], y);
        stubborn.update(&[u], y);
    });
    assert!((online.rls().theta()[1] - 2.0).abs() < 0.05, "{:?}", online.rls().theta());
    assert!((stubborn.rls().theta()[1] - 2.0).abs() > 0.3, "{:?}", stubborn.rls().theta());
    assert!(OnlineModel::new(&model, &[0.0; 3], 1.0, 1.0).is_err());
}
