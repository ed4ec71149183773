//! Extended least squares against the truth of simulated systems and against the prediction-error fit of the linear case.

mod common;

use common::systems::{System, simulate};
use dynocal_ident::estimate::Estimator;
use dynocal_ident::estimate::els::Els;
use dynocal_ident::estimate::ols::Ols;
use dynocal_ident::estimate::pem::Pem;
use dynocal_ident::experiment::Experiment;
use dynocal_ident::model::linear::LinearModel;
use dynocal_ident::model::narmax::Narmax;
use dynocal_ident::model::poly::PolyNarx;
use dynocal_ident::validate::{Kind, Seen, score_form};
use dynocal_numerics::rng::Rng64;
use dynocal_numerics::status::Status;

const PLANT: [&str; 4] = ["u(t-1)", "y(t-1)", "u(t-1)*y(t-1)", "u(t-2)^2"];
const TRUTH: [f64; 6] = [0.8, 0.6, 0.15, 0.3, 0.7, 0.2];
const NOISE: f64 = 0.3;

/// `y = 0.8 u1 + 0.6 y1 + 0.15 u1 y1 + 0.3 u2^2 + e + 0.7 e1 + 0.2 u1 e2`, indices are lags.
fn record(n: usize, seed: u64) -> Experiment {
    let mut rng = Rng64::stream(51, seed);
    let u: Vec<f64> = (0..n).map(|_| rng.uniform_in(-1.0, 1.0)).collect();
    let e: Vec<f64> = (0..n).map(|_| NOISE * rng.normal()).collect();
    let mut y = vec![0.0; n];
    for t in 2..n {
        y[t] = 0.8 * u[t - 1]
            + 0.6 * y[t - 1]
            + 0.15 * u[t - 1] * y[t - 1]
            + 0.3 * u[t - 2] * u[t - 2]
            + e[t]
            + 0.7 * e[t - 1]
            + 0.2 * u[t - 1] * e[t - 2];
    }
    Experiment { name: "narmax".into(), u, y, init_samples: 0, weights: vec![] }
}

fn narmax() -> Narmax {
    let terms: Vec<&str> = PLANT.iter().copied().chain(["e(t-1)", "u(t-1)*e(t-2)"]).collect();
    Narmax::parse(&["u"], "y", &terms).unwrap()
}

/// Over many records: least squares is biased in the output coefficient by many standard errors of the mean, extended
/// least squares in nothing, and its stated standard errors are the observed spread.
#[test]
fn coloured_equation_noise_biases_least_squares_only() {
    let (model, plain) = (narmax(), PolyNarx::parse(&["u"], "y", &PLANT).unwrap());
    let runs = 60_usize;
    let (mut ols, mut els, mut scaled) = (vec![], vec![], vec![]);
    for seed in 0..runs as u64 {
        let data = [record(1000, seed)];
        let fit = Els::default().estimate(&model, &data, &|| false).unwrap();
        assert_eq!(fit.status, Status::Converged);
        ols.push(Ols::default().estimate(&plain, &data, None, &|| false).unwrap().theta[1] - TRUTH[1]);
        els.push((0..6).map(|k| fit.theta[k] - TRUTH[k]).collect::<Vec<_>>());
        scaled.push((0..6).map(|k| (fit.theta[k] - TRUTH[k]) / fit.std_errors[k]).collect::<Vec<_>>());
    }
    let moments = |v: &[f64]| {
        let n = v.len() as f64;
        let mean = v.iter().sum::<f64>() / n;
        (mean, (v.iter().map(|x| (x - mean).powi(2)).sum::<f64>() / (n - 1.0) / n).sqrt())
    };
    let (bias, error) = moments(&ols);
    println!("OLS y(t-1): mean error {bias:.4} +- {error:.4}");
    assert!(bias > 10.0 * error, "least squares: mean error {bias} +- {error}");
    for k in 0..6 {
        let (bias, error) = moments(&els.iter().map(|e| e[k]).collect::<Vec<_>>());
        println!("ELS {}: mean error {bias:.5} +- {error:.5}", model.regressor_texts()[k]);
        assert!(bias.abs() < 4.0 * error, "term {k}: mean error {bias} +- {error}");
        let square = scaled.iter().map(|s| s[k] * s[k]).sum::<f64>() / runs as f64;
        // Chi-square of 60: 1 +- 0.18; extended least squares is a little wider than maximum likelihood.
        assert!(
            (0.4..2.0).contains(&square),
            "term {k}: mean square {square} in units of the standard error"
        );
    }
}

/// One step uses the innovations and comes down to the noise; the free run has none of them.
#[test]
fn scores_of_one_step_k_steps_and_free_run() {
    let model = narmax();
    let data = [record(4000, 99)];
    let score =
        |data: &[Experiment], kind| score_form(&model, &TRUTH, data, kind, Seen::Unseen).unwrap().unwrap();
    let mse = |kind| score(&data, kind).mse;
    let one = mse(Kind::OneStep);
    assert!((one / (NOISE * NOISE) - 1.0).abs() < 0.1, "{one}");
    let (two, ten, free) = (mse(Kind::KStep(2)), mse(Kind::KStep(10)), mse(Kind::FreeRun));
    assert!((mse(Kind::KStep(1)) - one).abs() < 1e-12);
    assert!(one < two && two < ten && (ten / free - 1.0).abs() < 0.05, "{one} {two} {ten} {free}");
    // Without noise all of them are exact.
    let mut quiet = data[0].clone();
    for t in 2..quiet.len() {
        let (u, y) = (&quiet.u, &quiet.y);
        quiet.y[t] = 0.8 * u[t - 1] + 0.6 * y[t - 1] + 0.15 * u[t - 1] * y[t - 1] + 0.3 * u[t - 2] * u[t - 2];
    }
    for kind in [Kind::OneStep, Kind::KStep(5), Kind::FreeRun] {
        assert!(score(std::slice::from_ref(&quiet), kind).error_max < 1e-12);
    }
}

/// In the linear case it is close to maximum likelihood (the same estimate to well within the standard errors).
#[test]
fn linear_case_is_an_armax_model() {
    let s = System {
        model: LinearModel::armax(&["u"], "y", 2, 2, 1, 1),
        theta: vec![-1.2, 0.5, 1.0, 0.4, 0.6],
        noise_std: 0.5,
        feedback: 0.0,
    };
    let data = [simulate(&s, 4000, 3)];
    let pem = Pem::default().estimate(&s.model, &data, None, &|| false).unwrap();
    let model = Narmax::parse(&["u"], "y", &["y(t-1)", "y(t-2)", "u(t-1)", "u(t-2)", "e(t-1)"]).unwrap();
    let els = Els::default().estimate(&model, &data, &|| false).unwrap();
    let expected = [-pem.theta[0], -pem.theta[1], pem.theta[2], pem.theta[3], pem.theta[4]];
    for k in 0..5 {
        let off = (els.theta[k] - expected[k]).abs() / pem.std_errors[k];
        assert!(off < 1.0, "{}: {off} standard errors from maximum likelihood", els.names[k]);
        let ratio = els.std_errors[k] / pem.std_errors[k];
        assert!(ratio > 0.95 && ratio < 2.0, "{}: {ratio} of the least possible", els.names[k]);
    }
}

#[test]
fn structures_are_checked_and_saved() {
    let model = narmax();
    let text = serde_json::to_string(&model).unwrap();
    assert_eq!(serde_json::from_str::<Narmax>(&text).unwrap(), model);
    assert_eq!(model.inputs(), ["u"]);
    for (inputs, terms) in [(["e"], ["y(t-1)"]), (["u"], ["e(t)"]), (["u"], ["v(t-1)"])] {
        assert!(Narmax::parse(&inputs, "y", &terms).is_err(), "{inputs:?} {terms:?}");
    }
    let mut short = record(6, 0);
    assert!(Els::default().estimate(&model, &[short.clone()], &|| false).is_err());
    short = record(100, 0);
    short.y[50] = f64::NAN;
    let fault = Els::default().estimate(&model, &[short], &|| false).unwrap_err().to_string();
    assert!(fault.contains("channel `y`, sample 50"), "{fault}");
}
