//! Scores and residual correlations against values by hand, and k-step prediction against its two limits.

use dynocal_ident::experiment::Experiment;
use dynocal_ident::model::Model;
use dynocal_ident::model::poly::PolyNarx;
use dynocal_ident::validate::{
    Kind, Reference, Seen, autocorrelation, cross_correlation, output, score, score_noise_free, score_values,
};
use dynocal_numerics::rng::Rng64;
use dynocal_numerics::status::Status;

#[test]
fn scores_by_hand() {
    // Mean 3, spread 10; errors 0, 1, -1, 0, 2.
    let s = score_values(
        &[1., 2., 3., 4., 5.],
        &[1., 1., 4., 4., 3.],
        Kind::FreeRun,
        Seen::Unseen,
        Reference::Noisy,
    );
    assert_eq!((s.samples, s.mse, s.r2, s.error_max, s.error_95), (5, 1.2, 0.4, 2.0, 2.0));
    assert!((s.rmse - 1.2f64.sqrt()).abs() < 1e-15);
    assert!((s.nrmse_fit - (1.0 - 0.6f64.sqrt())).abs() < 1e-15);
    // 95 of 100 absolute errors 1..100 are at most 95.
    let z: Vec<f64> = (1..=100).map(f64::from).collect();
    let s = score_values(&z, &vec![0.0; 100], Kind::OneStep, Seen::Identification, Reference::NoiseFree);
    assert_eq!((s.error_95, s.error_max, s.kind), (95.0, 100.0, Kind::OneStep));
    let bad = score_values(&[1.0, 2.0], &[1.0, f64::NAN], Kind::FreeRun, Seen::Unseen, Reference::Noisy);
    assert_eq!(bad.status, Status::Diverged);
    assert!(bad.r2.is_nan());
    // A stored score of a diverged run is read back as such.
    let stored = serde_json::to_string(&bad).unwrap();
    let read: dynocal_ident::validate::Score = serde_json::from_str(&stored).unwrap();
    assert!(read.mse.is_nan() && read.r2.is_nan() && read.status == Status::Diverged, "{stored}");
    let stored = serde_json::to_string(&s).unwrap();
    assert_eq!(serde_json::from_str::<dynocal_ident::validate::Score>(&stored).unwrap(), s);
}

fn example() -> (PolyNarx, [f64; 4], Experiment) {
    let model = PolyNarx::parse(&["u"], "y", &["u(t-3)", "y(t-1)", "y(t-2)", "u(t-1)*y(t-1)"]).unwrap();
    let mut rng = Rng64::new(2);
    let u: Vec<f64> = (0..80).map(|_| rng.uniform_in(-1.0, 1.0)).collect();
    let y: Vec<f64> = (0..80).map(|_| rng.uniform_in(-1.0, 1.0)).collect();
    (
        model,
        [1.0, 0.6, -0.3, 0.2],
        Experiment { name: "e".into(), u, y, init_samples: 5, weights: Vec::new() },
    )
}

/// One step ahead is prediction, very many steps are the free run, and two steps are prediction of prediction.
#[test]
fn k_step_prediction_joins_prediction_and_free_run() {
    let (model, theta, e) = example();
    let of = |kind| output(&model, &theta, &e, kind);
    assert_eq!(of(Kind::KStep(1)), of(Kind::OneStep));
    assert_eq!(of(Kind::KStep(500)), of(Kind::FreeRun));
    let (one, two) = (of(Kind::OneStep), of(Kind::KStep(2)));
    for t in 6..80 {
        let last = one[t - 1];
        let expected =
            theta[0] * e.u[t - 3] + theta[1] * last + theta[2] * e.y[t - 2] + theta[3] * e.u[t - 1] * last;
        assert!((two[t] - expected).abs() < 1e-14);
    }
}

#[test]
fn scores_leave_the_initialisation_out_and_pool_experiments() {
    let (model, theta, e) = example();
    let s = score(&model, &theta, &[e.clone(), e.clone()], Kind::FreeRun, Seen::Unseen);
    assert_eq!((s.samples, s.reference), (150, Reference::Noisy));
    let y = output(&model, &theta, &e, Kind::FreeRun);
    let by_hand = score_values(&e.y[5..], &y[5..], Kind::FreeRun, Seen::Unseen, Reference::Noisy);
    assert!((s.r2 - by_hand.r2).abs() < 1e-12 && (s.mse - by_hand.mse).abs() < 1e-12);
    let exact =
        score_noise_free(&model, &theta, std::slice::from_ref(&e), &[&y], Kind::FreeRun, Seen::Unseen);
    assert_eq!((exact.mse, exact.r2, exact.reference), (0.0, 1.0, Reference::NoiseFree));
    // Longer lags than the record's own initialisation take more samples out.
    let long = PolyNarx::parse(&["u"], "y", &["u(t-9)"]).unwrap();
    assert_eq!(score(&long, &[1.0], &[e], Kind::OneStep, Seen::Unseen).samples, 71);
    assert_eq!(long.max_lag(), 9);
}

#[test]
fn correlations_of_white_and_of_shifted_series() {
    let mut rng = Rng64::new(4);
    let e: Vec<f64> = (0..4000).map(|_| rng.normal()).collect();
    let white = autocorrelation(&e, 100);
    assert_eq!(white.lags.len(), 101);
    assert!((white.values[0] - 1.0).abs() < 1e-12);
    assert!((white.bound - 1.96 / 4000f64.sqrt()).abs() < 1e-15);
    // 5 % of 100 with a standard deviation of 2.2 %.
    assert!(white.share_outside < 0.12, "{}", white.share_outside);
    // u ahead of e by 7 samples: one value near one at lag 7.
    let mut u = e[7..].to_vec();
    u.extend([0.0; 7]);
    let shifted = cross_correlation(&e, &u, 20);
    for (lag, v) in shifted.lags.iter().zip(&shifted.values) {
        assert!(if *lag == 7 { *v > 0.99 } else { v.abs() < 0.08 }, "lag {lag}: {v}");
    }
    // A moving average of two has the autocorrelation 1/2 at lag 1.
    let coloured: Vec<f64> = e.windows(2).map(|w| w[0] + w[1]).collect();
    let r = autocorrelation(&coloured, 5);
    assert!((r.values[1] - 0.5).abs() < 0.05 && r.values[2..].iter().all(|v| v.abs() < 0.08));
}
