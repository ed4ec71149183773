//! Residual tests, validation pools, cross-validation, stability and k-step prediction against what theory says.

use dynocal_ident::estimate::Estimator;
use dynocal_ident::estimate::ols::Ols;
use dynocal_ident::experiment::Experiment;
use dynocal_ident::model::poly::PolyNarx;
use dynocal_ident::validate::cross::{Blocks, cross_validate, folds};
use dynocal_ident::validate::spread::{ScorePool, Spread, score_pool};
use dynocal_ident::validate::stability::{Trials, free_run_stability};
use dynocal_ident::validate::{
    Kind, Reference, Seen, autocorrelation, cross_correlation, independence, nonlinear_tests, output, score,
    score_in_band, score_values, whiteness,
};
use dynocal_numerics::rng::Rng64;

fn normals(n: usize, rng: &mut Rng64) -> Vec<f64> {
    (0..n).map(|_| rng.normal()).collect()
}

/// AR(1) with coefficient a.
fn coloured(n: usize, a: f64, rng: &mut Rng64) -> Vec<f64> {
    let mut last = 0.0;
    (0..n)
        .map(|_| {
            last = a * last + rng.normal();
            last
        })
        .collect()
}

fn experiment(name: &str, u: Vec<f64>, y: Vec<f64>) -> Experiment {
    Experiment { name: name.into(), u, y, init_samples: 0, weights: Vec::new() }
}

/// y(t) = 0.9 y(t-1) + 0.5 u(t-1) + e(t).
fn arx(n: usize, noise: f64, seed: u64) -> Experiment {
    let mut rng = Rng64::new(seed);
    let u = normals(n, &mut rng);
    let mut y = vec![0.0; n];
    (1..n).for_each(|t| y[t] = 0.9 * y[t - 1] + 0.5 * u[t - 1] + noise * rng.normal());
    experiment(&format!("arx{seed}"), u, y)
}

fn arx_model() -> PolyNarx {
    PolyNarx::parse(&["u"], "y", &["u(t-1)", "y(t-1)"]).unwrap()
}

#[test]
fn k_step_prediction_of_a_known_system() {
    let (e, model, theta) = (arx(20_000, 0.3, 1), arx_model(), [0.5, 0.9]);
    for k in [1, 2, 5, 20] {
        let predicted = output(&model, &theta, &e, Kind::KStep(k));
        for t in 30..200 {
            // y(t|t-k) = 0.9^k y(t-k) + sum_j 0.9^j 0.5 u(t-1-j)
            let inputs: f64 = (0..k).map(|j| 0.9f64.powi(j as i32) * 0.5 * e.u[t - 1 - j]).sum();
            let expected = 0.9f64.powi(k as i32) * e.y[t - k] + inputs;
            assert!((predicted[t] - expected).abs() < 1e-12, "{k} {t}");
        }
        // Error variance s2 (1 - a^2k) / (1 - a^2); neighbouring errors are correlated over k samples.
        let mse = score(&model, &theta, std::slice::from_ref(&e), Kind::KStep(k), Seen::Unseen).mse;
        let expected = 0.09 * (1.0 - 0.9f64.powi(2 * k as i32)) / (1.0 - 0.81);
        let deviation = (2.0 * k.min(19) as f64 / 20_000.0).sqrt();
        assert!((mse / expected - 1.0).abs() < 4.0 * deviation, "{k}: {mse} {expected}");
    }
    // What was measured after t - k is not looked at.
    let mut later = e.clone();
    later.y[101..].fill(1e6);
    let (a, b) = (output(&model, &theta, &e, Kind::KStep(5)), output(&model, &theta, &later, Kind::KStep(5)));
    assert_eq!(a[..=105], b[..=105]);
    assert_ne!(a[106], b[106]);
    assert_eq!(serde_json::to_string(&Kind::KStep(5)).unwrap(), r#"{"k_step":5}"#);
}

#[test]
fn share_inside_a_band_and_missing_samples() {
    let z = [1.0, f64::NAN, 2.0, 3.0, 4.0];
    let zhat = [1.2, 7.0, 2.0, 3.5, 4.1];
    let s = score_in_band(&z, &zhat, 0.2, Kind::FreeRun, Seen::Unseen, Reference::Noisy);
    assert_eq!((s.samples, s.inside.unwrap().share, s.error_max), (4, 0.75, 0.5));
    assert!((s.mse - (0.04 + 0.25 + 0.01) / 4.0).abs() < 1e-12);
    let bad = score_in_band(&z, &[f64::NAN; 5], 0.2, Kind::FreeRun, Seen::Unseen, Reference::Noisy);
    assert_eq!(bad.inside.unwrap().share, 0.0);
    assert!(!bad.status.is_success());
    assert_eq!(score_values(&z, &zhat, Kind::FreeRun, Seen::Unseen, Reference::Noisy).inside, None);
}

/// Share of `runs` in which a test rejects at 5 %.
fn rejected(runs: u64, p_value: impl Fn(&mut Rng64) -> f64) -> f64 {
    (0..runs).filter(|k| p_value(&mut Rng64::stream(7, *k)) < 0.05).count() as f64 / runs as f64
}

#[test]
fn tests_of_residuals_reject_at_their_level_and_see_what_is_there() {
    // 400 runs: 5 % with a standard deviation of 1.1 %.
    let nominal = 0.015..0.09;
    let white = rejected(400, |rng| whiteness(&normals(500, rng), 20, 0).p_value);
    assert!(nominal.contains(&white), "{white}");
    // A strongly coloured input does not matter when the residuals are white.
    let free = rejected(400, |rng| independence(&normals(500, rng), &coloured(500, 0.9, rng), 15).p_value);
    assert!(nominal.contains(&free), "{free}");
    let mut rng = Rng64::new(3);
    let moving: Vec<f64> = normals(501, &mut rng).windows(2).map(|w| w[1] + 0.4 * w[0]).collect();
    assert!(whiteness(&moving, 20, 0).p_value < 1e-6);
    assert_eq!(whiteness(&moving, 20, 3).degrees, 17);
    let u = coloured(2000, 0.5, &mut rng);
    let e: Vec<f64> = (0..2000).map(|t| rng.normal() + if t >= 3 { 0.3 * u[t - 3] } else { 0.0 }).collect();
    assert!(independence(&e, &u, 10).p_value < 1e-6);
    assert!(independence(&e, &vec![1.0; 2000], 10).p_value.is_nan());
}

/// Two independent coloured series: the bound of white ones would be left by most lags.
#[test]
fn bounds_of_cross_correlations_know_the_colour_of_both_series() {
    let (mut inside_95, mut inside_99, mut naive, mut all) = (0, 0, 0, 0);
    for k in 0..200 {
        let mut rng = Rng64::stream(11, k);
        let (e, u) = (coloured(2000, 0.9, &mut rng), coloured(2000, 0.9, &mut rng));
        let r = cross_correlation(&e, &u, 60);
        let within = |bound: f64| r.values.iter().filter(|v| v.abs() <= bound).count();
        inside_95 += within(r.bound);
        inside_99 += within(r.bound_99);
        naive += within(1.96 / 2000f64.sqrt());
        all += r.values.len();
    }
    let share = |n: usize| n as f64 / all as f64;
    println!(
        "inside 95 %: {:.3}, 99 %: {:.3}, bound of white series: {:.3}",
        share(inside_95),
        share(inside_99),
        share(naive)
    );
    // Lags of one run are correlated: some 20 x 200 independent values, and the estimate of the bound.
    assert!((0.93..0.97).contains(&share(inside_95)) && (0.975..0.998).contains(&share(inside_99)));
    assert!(share(naive) < 0.6);
    let white = autocorrelation(&normals(1000, &mut Rng64::new(1)), 10);
    assert!((white.bound_99 / white.bound - 2.576 / 1.96).abs() < 1e-12);
}

#[test]
fn squares_left_in_the_residuals_are_seen_by_the_nonlinear_tests_only() {
    let mut rng = Rng64::new(13);
    let u = normals(4000, &mut rng);
    let e: Vec<f64> =
        (0..4000).map(|t| rng.normal() + if t >= 2 { 0.3 * u[t - 2].powi(2) } else { 0.0 }).collect();
    assert!(cross_correlation(&e, &u, 20).share_outside < 0.2);
    let tests = nonlinear_tests(&e, &u, 20);
    let named = |name: &str| &tests.iter().find(|t| t.name == name).unwrap().correlation;
    let seen = named("u^2,e");
    assert!(seen.values[2] > 3.0 * seen.bound_99, "{:?}", seen.values);
    let clean = nonlinear_tests(&normals(4000, &mut rng), &u, 20);
    assert!(clean.iter().all(|t| t.correlation.share_outside < 0.25), "{clean:?}");
}

#[test]
fn intervals_of_a_pool_cover_the_mean_as_often_as_they_say() {
    let covered = (0..2000)
        .filter(|k| {
            let s = Spread::of(&normals(5, &mut Rng64::stream(17, *k)), 0.95);
            s.low <= 0.0 && 0.0 <= s.high
        })
        .count();
    // 95 % with a standard deviation of 0.5 %.
    assert!((1860..1940).contains(&covered), "{covered}");
    let one = Spread::of(&[2.0, f64::NAN], 0.95);
    assert_eq!((one.count, one.mean), (1, 2.0));
    assert!(one.low.is_nan());
    let stored = serde_json::to_string(&one).unwrap();
    assert!(serde_json::from_str::<Spread>(&stored).unwrap().low.is_nan());
}

#[test]
fn a_pool_of_records_scores_each_and_leaves_diverged_ones_out() {
    let records: Vec<Experiment> = (0..4).map(|k| arx(400, 0.2, 20 + k)).collect();
    let (model, theta) = (arx_model(), [0.5, 0.9]);
    let pool = score_pool(&model, &theta, &records, Kind::OneStep, Seen::Unseen, 0.9);
    let rmse: Vec<f64> = pool.records.iter().map(|r| r.1.rmse).collect();
    let mean = rmse.iter().sum::<f64>() / 4.0;
    let std = (rmse.iter().map(|v| (v - mean).powi(2)).sum::<f64>() / 3.0).sqrt();
    assert!((pool.rmse.mean - mean).abs() < 1e-15 && (pool.rmse.std - std).abs() < 1e-15);
    // t(0.95; 3) = 2.353363
    assert!((pool.rmse.high - mean - 2.353_363 * std / 2.0).abs() < 1e-6 * std);
    let mut scores = pool.records.clone();
    scores[2].1 = score(&model, &[0.5, 5.0], &records[2..3], Kind::FreeRun, Seen::Unseen);
    let with = ScorePool::of(scores, 0.9);
    assert_eq!((with.diverged, with.rmse.count), (1, 3));
}

#[test]
fn blocks_of_cross_validation_share_no_sample_with_the_fit() {
    // Outputs are sample numbers, so that parts can be told.
    let tagged = |name: &str, n: usize, from: f64| {
        experiment(name, vec![0.0; n], (0..n).map(|t| from + t as f64).collect())
    };
    let data = [tagged("a", 103, 0.0), tagged("b", 57, 1000.0)];
    let (lag, blocks) = (3, Blocks { folds: 4, gap: 5, ..Blocks::default() });
    let mut times_scored = std::collections::BTreeMap::<i64, usize>::new();
    for (fitted, scored) in folds(&data, lag, &blocks).unwrap() {
        for s in &scored {
            assert_eq!((s.init_samples, s.u.len()), (lag, s.y.len()));
            s.y[lag..].iter().for_each(|v| *times_scored.entry(*v as i64).or_default() += 1);
            // No sample of the fit within the gap of what is scored.
            let near = |v: &f64| s.y[lag..].iter().any(|z| (z - v).abs() <= blocks.gap as f64);
            assert!(!fitted.iter().any(|f| f.y.iter().any(near)));
        }
        assert!(fitted.iter().map(|f| f.y.len()).sum::<usize>() >= 160 * 3 / 4 - 4 * 5 - 4 * lag);
    }
    assert!(times_scored.values().all(|n| *n == 1));
    assert_eq!(times_scored.len(), 103 + 57 - 2 * lag);
    let error = folds(&[tagged("short", 6, 0.0)], 3, &blocks).unwrap_err().to_string();
    assert!(error.contains("short: 3 usable samples, expected at least 4"), "{error}");
}

#[test]
fn cross_validation_refits_in_every_fold() {
    let data = [arx(600, 0.2, 31), arx(500, 0.2, 32)];
    let (model, blocks) = (arx_model(), Blocks { folds: 5, ..Blocks::default() });
    let found = cross_validate(&model, &data, &Ols::default(), &blocks, &|| false).unwrap();
    assert_eq!((found.folds, found.one_step.records.len(), found.failed.len()), (5, 5, 0));
    for (k, (fitted, scored)) in folds(&data, 1, &blocks).unwrap().iter().enumerate() {
        let fit = Ols::default().estimate(&model, fitted, None, &|| false).unwrap();
        let by_hand = score(&model, &fit.theta, scored, Kind::FreeRun, Seen::Unseen);
        assert_eq!(found.free_run.records[k].1, by_hand);
    }
    // The one-step error is the noise: 0.2 with a standard deviation of 0.2 / sqrt(2 1100).
    assert!((found.one_step.rmse.mean - 0.2).abs() < 4.0 * 0.2 / 2200f64.sqrt());
    assert!((found.parameters[1].mean - 0.9).abs() < 0.02);
    let none = cross_validate(&model, &data, &Ols::default(), &blocks, &|| true).unwrap();
    assert_eq!((none.failed.len(), none.free_run.rmse.count), (5, 0));
}

#[test]
fn stability_of_free_runs_on_random_inputs() {
    let data = [arx(500, 0.0, 41)];
    let model = arx_model();
    let of = |theta: &[f64]| free_run_stability(&model, theta, &data, &data, &Trials::default()).unwrap();
    let stable = of(&[0.5, 0.9]);
    assert_eq!((stable.share_diverged, stable.runs, stable.records_excursion), (0.0, 200, 0.0));
    assert_eq!(stable, of(&[0.5, 0.9]));
    let unstable = of(&[0.5, 1.05]);
    assert_eq!(
        (unstable.share_diverged, unstable.diverged_records.as_slice()),
        (1.0, &["arx41".to_string()][..])
    );
    // A gain of two on an input within its range: the largest excursion is known up to how near the levels come to it.
    let fir = PolyNarx::parse(&["u"], "y", &["u(t-1)"]).unwrap();
    let mut rng = Rng64::new(43);
    let u: Vec<f64> = (0..1000).map(|_| rng.uniform_in(-1.0, 1.0)).collect();
    let e = experiment("gain", u.clone(), [&[0.0], &u[..999]].concat());
    let found = free_run_stability(&fir, &[2.0], std::slice::from_ref(&e), &[], &Trials::default()).unwrap();
    assert!((0.49..=0.5).contains(&found.largest_excursion), "{}", found.largest_excursion);
    // Stable for inputs that change at every sample, not for those that are held.
    let cubic = PolyNarx::parse(&["u"], "y", &["u(t-1)", "y(t-1)", "y(t-1)^3"]).unwrap();
    let quiet: Vec<f64> = (0..500).map(|_| rng.uniform_in(-0.35, 0.35)).collect();
    let run = dynocal_ident::model::Run { u: &quiet, y: &vec![0.0; 500], start: 1 };
    let mut y = vec![0.0; 500];
    use dynocal_ident::model::Model;
    assert!(cubic.simulate(&[1.0, 0.5, 0.25], &run, &mut y).is_success());
    let record = [experiment("cubic", quiet, y)];
    let some = free_run_stability(&cubic, &[1.0, 0.5, 0.25], &record, &record, &Trials::default()).unwrap();
    assert!(some.diverged_records.is_empty());
    // Any input held beyond 0.272, the most that 0.5 y - 0.25 y^3 can balance, drives it away: 22 % of the levels.
    assert!(some.share_diverged > 0.5, "{}", some.share_diverged);
    let wrong =
        free_run_stability(&model, &[0.5, 0.9], &[], &data, &Trials::default()).unwrap_err().to_string();
    assert!(wrong.contains("no record gives the limits"), "{wrong}");
}
