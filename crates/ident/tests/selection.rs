//! Forward regression: recovers a known structure, its path obeys its defining identities.

use dynocal_ident::estimate::ols::Ols;
use dynocal_ident::estimate::sem::Sem;
use dynocal_ident::estimate::{Estimator, Minimised};
use dynocal_ident::experiment::Experiment;
use dynocal_ident::model::Model;
use dynocal_ident::model::poly::PolyNarx;
use dynocal_ident::select::frols::{Stop, frols};
use dynocal_ident::select::pool::{Pool, PoolSpec};
use dynocal_ident::select::prune::{best_on, prune};
use dynocal_ident::validate::{Kind, Seen, score};
use dynocal_numerics::rng::Rng64;

const TRUE_TERMS: [&str; 5] = ["u(t-1)", "u(t-1)*v(t-2)", "v(t-1)^2", "y(t-1)", "u(t-2)*y(t-1)"];
const THETA: [f64; 5] = [0.8, -0.6, 0.5, 0.4, 0.3];

fn names() -> Vec<String> {
    vec!["u".into(), "v".into()]
}

fn pool() -> PolyNarx {
    let lagged: Vec<(usize, usize)> = (0..2).flat_map(|i| (1..=4).map(move |lag| (i, lag))).collect();
    let spec = PoolSpec {
        lagged: lagged.clone(),
        cubic: vec![(0, 1), (1, 1)],
        output_lags: vec![1, 2],
        output_times: lagged,
    };
    PolyNarx::new(names(), "y".into(), spec.candidates()).unwrap()
}

/// Records of the true structure with equation noise.
fn data(noise: f64, seed: u64) -> Vec<Experiment> {
    (0..2)
        .map(|i| {
            let mut rng = Rng64::stream(seed, i);
            let n = 600;
            let u: Vec<f64> = (0..2 * n).map(|_| rng.uniform_in(-1.0, 1.0)).collect();
            let (a, b) = (|t: usize| u[2 * t], |t: usize| u[2 * t + 1]);
            let mut y = vec![0.0; n];
            for t in 2..n {
                y[t] = THETA[0] * a(t - 1)
                    + THETA[1] * a(t - 1) * b(t - 2)
                    + THETA[2] * b(t - 1) * b(t - 1)
                    + THETA[3] * y[t - 1]
                    + THETA[4] * a(t - 2) * y[t - 1]
                    + noise * rng.normal();
            }
            Experiment { name: format!("r{i}"), u, y, init_samples: 0, weights: Vec::new() }
        })
        .collect()
}

#[test]
fn the_true_structure_is_found_in_a_pool() {
    for seed in 0..5 {
        let selection = frols(&pool(), &data(0.02, seed), Stop::Terms(5)).unwrap();
        let mut found = selection.model.regressor_texts();
        found.sort();
        let mut expected = TRUE_TERMS.map(String::from).to_vec();
        expected.sort();
        assert_eq!(found, expected, "seed {seed}");
    }
}

#[test]
fn bic_keeps_the_true_terms_and_few_others() {
    let mut extra = 0;
    for seed in 0..10 {
        let selection = frols(&pool(), &data(0.05, seed), Stop::Bic { max_terms: 15 }).unwrap();
        let found = selection.model.regressor_texts();
        assert!(TRUE_TERMS.iter().all(|t| found.iter().any(|f| f == t)), "{found:?}");
        assert_eq!(found.len(), selection.terms);
        extra += found.len() - TRUE_TERMS.len();
    }
    // A wrong term enters when its chi-square exceeds ln 1200 = 7.1: probability 0.8 % for each of some 60 free
    // candidates, so about 5 in 10 selections, with a standard deviation of 2.
    assert!(extra <= 12, "{extra} extra terms in 10 selections");
}

/// The path's errors are those of least squares with its terms: an independent computation (QR).
#[test]
fn path_errors_equal_least_squares_with_the_same_terms() {
    let (pool, data) = (pool(), data(0.1, 3));
    let selection = frols(&pool, &data, Stop::Terms(20)).unwrap();
    let mean_square: f64 = {
        let scored: Vec<f64> = data.iter().flat_map(|e| e.y[pool.max_lag()..].to_vec()).collect();
        scored.iter().map(|v| v * v).sum::<f64>() / scored.len() as f64
    };
    for terms in [1, 2, 5, 10, 20] {
        let model = selection.first(&Pool::from(&pool), terms).unwrap();
        // The chosen terms may have shorter lags: score the same samples.
        let data: Vec<Experiment> =
            data.iter().map(|e| Experiment { init_samples: pool.max_lag(), ..e.clone() }).collect();
        let fit = Ols::default().estimate(&model, &data, None, &|| false).unwrap();
        let step = &selection.path[terms - 1];
        assert!((fit.mse - step.mse).abs() <= 1e-10 * fit.mse, "{terms}: {} {}", fit.mse, step.mse);
        assert!((1.0 - step.cumulative - step.mse / mean_square).abs() < 1e-10, "{terms}");
    }
    assert!(selection.path.windows(2).all(|w| w[1].mse <= w[0].mse));
    // Each step is the best single addition: checked by brute force for the first two.
    let best = |chosen: &[usize]| -> f64 {
        (0..pool.n_params())
            .filter(|k| !chosen.contains(k))
            .map(|k| {
                let terms: Vec<_> =
                    chosen.iter().chain([&k]).map(|&i| pool.regressors()[i].clone()).collect();
                let model = PolyNarx::new(names(), "y".into(), terms).unwrap();
                let data: Vec<Experiment> =
                    data.iter().map(|e| Experiment { init_samples: pool.max_lag(), ..e.clone() }).collect();
                Ols::default().estimate(&model, &data, None, &|| false).unwrap().mse
            })
            .fold(f64::INFINITY, f64::min)
    };
    let first = selection.path[0].candidate;
    assert!((best(&[]) - selection.path[0].mse).abs() < 1e-12);
    assert!((best(&[first]) - selection.path[1].mse).abs() < 1e-12);
}

#[test]
fn dependent_candidates_are_never_taken() {
    // The second input is a copy of the first: half of the pool is dependent.
    let data: Vec<Experiment> = data(0.05, 1)
        .into_iter()
        .map(|mut e| {
            (0..e.len()).for_each(|t| e.u[2 * t + 1] = e.u[2 * t]);
            e
        })
        .collect();
    let pool = PolyNarx::parse(&["u", "v"], "y", &["u(t-1)", "v(t-1)", "u(t-2)", "v(t-2)"]).unwrap();
    let selection = frols(&pool, &data, Stop::Terms(4)).unwrap();
    assert_eq!(selection.terms, 2);
}

/// From a model with many terms, elimination on the simulation error keeps the true ones and improves unseen data.
#[test]
fn pruning_removes_the_spurious_terms_of_an_output_error_system() {
    let truth = PolyNarx::parse(&["u", "v"], "y", &TRUE_TERMS).unwrap();
    let record = |seed: u64| -> Vec<Experiment> {
        let mut clean = data(0.0, seed);
        let mut rng = Rng64::new(100 + seed);
        clean.iter_mut().for_each(|e| e.y.iter_mut().for_each(|v| *v += 0.1 * rng.normal()));
        clean
    };
    let (ident, selection) = (record(1), record(2));
    // The true terms among 20 others.
    let others = pool()
        .regressors()
        .iter()
        .filter(|r| !truth.regressors().contains(r))
        .take(20)
        .cloned()
        .collect::<Vec<_>>();
    let all = truth.regressors().iter().cloned().chain(others).collect();
    let start = PolyNarx::new(names(), "y".into(), all).unwrap();
    let path = prune(&start, &ident, &Sem::default(), 4, &|| false).unwrap();
    assert_eq!(path.len(), 25 - 4 + 1);
    for (i, p) in path.iter().enumerate() {
        assert_eq!(p.model.n_params(), 25 - i);
        assert_eq!(p.removed.is_none(), i == 0);
        assert_eq!(p.fit.minimised, Minimised::FreeRun);
    }
    let five = &path[20].model;
    let mut found = five.regressor_texts();
    let mut expected = truth.regressor_texts();
    found.sort();
    expected.sort();
    assert_eq!(found, expected);
    let best = best_on(&path, &selection).unwrap();
    let error =
        |i: usize| score(&path[i].model, &path[i].fit.theta, &selection, Kind::FreeRun, Seen::Unseen).mse;
    assert!((0..path.len()).all(|i| error(best) <= error(i)));
    assert!(path[best].model.n_params() < 25 && path[best].model.n_params() >= 5);
}

/// Functions are candidates like any other: the friction of an axis is found among powers of its velocity.
#[test]
fn functions_are_selected_from_a_pool() {
    let texts = [
        "1",
        "x(t-1)",
        "x(t-2)",
        "u(t-1)",
        "u(t-1)^2",
        "tanh(20*x(t-1) - 20*x(t-2))",
        "abs(x(t-1))",
        "x(t-1)^3",
    ];
    let pool = PolyNarx::parse(&["u"], "x", &texts).unwrap();
    let mut rng = Rng64::stream(31, 0);
    let u: Vec<f64> = (0..1500).map(|_| rng.normal()).collect();
    let mut x = vec![0.0; u.len()];
    for t in 2..x.len() {
        let friction = (20.0_f64 * (x[t - 1] - x[t - 2])).tanh();
        x[t] = 1.5 * x[t - 1] - 0.6 * x[t - 2] + 0.5 * u[t - 1] - 0.4 * friction + 0.02 * rng.normal();
    }
    let record = Experiment { name: "axis".into(), u, y: x, init_samples: 2, weights: Vec::new() };
    let found = frols(&pool, &[record], Stop::Terms(4)).unwrap();
    let mut terms = found.model.regressor_texts();
    terms.sort();
    assert_eq!(terms, ["tanh(20*x(t-1) - 20*x(t-2))", "u(t-1)", "x(t-1)", "x(t-2)"]);
}
