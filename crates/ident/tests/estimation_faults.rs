//! Data and optima that an estimator must speak about: missing samples, dependent regressors, records of different lengths,
//! models whose free run does not last.

use dynocal_ident::estimate::ols::Ols;
use dynocal_ident::estimate::sem::Sem;
use dynocal_ident::estimate::{Estimator, Fit};
use dynocal_ident::experiment::Experiment;
use dynocal_ident::model::poly::PolyNarx;
use dynocal_ident::model::{Model, Run};
use dynocal_numerics::rng::Rng64;

fn simulated(model: &PolyNarx, theta: &[f64], n: usize, std: f64, seed: u64) -> Experiment {
    let mut rng = Rng64::new(seed);
    let u: Vec<f64> = (0..n * model.n_inputs()).map(|_| rng.uniform_in(-1.0, 1.0)).collect();
    let (zeros, mut y) = (vec![0.0; n], vec![0.0; n]);
    model.simulate(theta, &Run { u: &u, y: &zeros, start: model.max_lag() }, &mut y);
    y.iter_mut().for_each(|v| *v += std * rng.normal());
    Experiment { name: format!("rec{seed}"), u, y, init_samples: 0, weights: Vec::new() }
}

fn arx() -> PolyNarx {
    PolyNarx::parse(&["u", "v"], "y", &["1", "u(t-1)", "v(t-2)", "y(t-1)"]).unwrap()
}

const TRUTH: [f64; 4] = [0.3, 1.0, -0.5, 0.7];

/// A missing output is a sample of no weight: simulation error gives the same bits either way, whatever stands there.
#[test]
fn missing_outputs_are_not_scored() {
    let model = arx();
    let mut gaps = simulated(&model, &TRUTH, 400, 0.2, 1);
    let mut weighed = gaps.clone();
    weighed.weights = vec![1.0; 400];
    for t in (50..60).chain([100, 399]) {
        gaps.y[t] = f64::NAN;
        weighed.y[t] = 0.0;
        weighed.weights[t] = 0.0;
    }
    let of = |e: &Experiment, start: &[f64]| {
        Sem::default().estimate(&model, std::slice::from_ref(e), Some(start), &|| false).unwrap()
    };
    let (a, b) = (of(&gaps, &TRUTH), of(&weighed, &TRUTH));
    assert_eq!((a.theta.clone(), a.history.len()), (b.theta, b.history.len()));
    assert_eq!((a.samples, b.samples), (398 - 12, 398));
    // The least-squares start finds its way as well, to the same minimum.
    let own = Sem::default().estimate(&model, std::slice::from_ref(&gaps), None, &|| false).unwrap();
    for k in 0..4 {
        assert!((own.theta[k] - a.theta[k]).abs() < 1e-5 * a.std_errors[k]);
    }
}

/// One step ahead, every row that reads a missing sample is left out: the same as least squares on the other rows.
#[test]
fn rows_with_missing_samples_are_left_out_of_least_squares() {
    let model = arx();
    let whole = [simulated(&model, &TRUTH, 300, 0.0, 1), simulated(&model, &TRUTH, 120, 0.0, 2)];
    let mut gaps = whole.clone();
    gaps[1].y[40] = f64::NAN;
    gaps[1].u[2 * 77 + 1] = f64::NAN;
    let fit = Ols::default().estimate(&model, &gaps, None, &|| false).unwrap();
    // y(40) is read at 40 and 41, v(77) at 79.
    assert_eq!(fit.samples, 298 + 118 - 3);
    for k in 0..4 {
        assert!((fit.theta[k] - TRUTH[k]).abs() < 1e-10, "{:?}", fit.theta);
    }
}

/// A free run needs every input: the record of many, the input and the sample are named.
#[test]
fn a_missing_input_in_one_experiment_of_many_is_named() {
    let model = arx();
    let mut data: Vec<Experiment> = (0..5).map(|i| simulated(&model, &TRUTH, 200, 0.1, i)).collect();
    data[3].u[2 * 55 + 1] = f64::NAN;
    let fault = Sem::default().estimate(&model, &data, None, &|| false).unwrap_err();
    assert_eq!(fault.to_string(), "rec3: channel `input 2`, sample 55: found NaN, expected a finite number");
    data[3].u[2 * 55 + 1] = 0.0;
    data[4].y[1] = f64::NAN;
    let fault = Sem::default().estimate(&model, &data, None, &|| false).unwrap_err();
    assert_eq!(fault.to_string(), "rec4: channel `output`, sample 1: found NaN, expected a finite number");
    data[4].y[1] = f64::INFINITY;
    assert!(Sem::default().estimate(&model, &data, None, &|| false).is_err());
}

#[test]
fn a_record_of_missing_outputs_leaves_too_few_rows() {
    let model = arx();
    let mut e = simulated(&model, &TRUTH, 30, 0.1, 7);
    e.y[3..].fill(f64::NAN);
    for estimator in [&Ols::default() as &dyn Estimator, &Sem::default()] {
        let fault =
            estimator.estimate(&model, std::slice::from_ref(&e), None, &|| false).unwrap_err().to_string();
        assert!(fault.starts_with("rec7: 1 usable samples, expected at least 4 (4 parameters"), "{fault}");
    }
}

/// Records of different lengths count by their samples: the fit of all is that of the records put one after another.
#[test]
fn records_of_different_lengths_are_weighed_by_their_samples() {
    let model = PolyNarx::parse(&["u"], "y", &["1", "u(t)"]).unwrap();
    let data: Vec<Experiment> = [13, 400, 50]
        .iter()
        .enumerate()
        .map(|(i, n)| simulated(&model, &[0.3, 1.0], *n, 0.2, i as u64))
        .collect();
    let joined = Experiment {
        name: "all".into(),
        u: data.iter().flat_map(|e| e.u.clone()).collect(),
        y: data.iter().flat_map(|e| e.y.clone()).collect(),
        init_samples: 0,
        weights: Vec::new(),
    };
    for estimator in [&Ols::default() as &dyn Estimator, &Sem::default()] {
        let a = estimator.estimate(&model, &data, None, &|| false).unwrap();
        let b = estimator.estimate(&model, std::slice::from_ref(&joined), None, &|| false).unwrap();
        assert_eq!(a.samples, 463);
        for k in 0..2 {
            assert!(
                (a.theta[k] - b.theta[k]).abs() < 1e-9
                    && (a.std_errors[k] / b.std_errors[k] - 1.0).abs() < 1e-9
            );
        }
    }
}

/// The warning gives the combination: c = 2 a - 0.5 b.
#[test]
fn dependent_regressors_are_named_as_combinations() {
    let model = PolyNarx::parse(&["a", "b", "c"], "y", &["a(t-1)", "b(t-1)", "c(t-1)"]).unwrap();
    let mut rng = Rng64::new(3);
    let n = 200;
    let mut u = vec![0.0; 3 * n];
    for row in u.chunks_exact_mut(3) {
        // c is the longest: the other two are taken before it only because of their share in it.
        (row[0], row[1]) = (rng.normal(), rng.normal());
        row[2] = 2.0 * row[0] - 0.5 * row[1];
    }
    let y = (0..n).map(|t| if t == 0 { 0.0 } else { u[3 * (t - 1)] + 0.1 * rng.normal() }).collect();
    let e = Experiment { name: "dep".into(), u, y, init_samples: 0, weights: Vec::new() };
    let check = |fit: Fit, what: &str| {
        let text = fit.warnings[0].replace(what, "the regressor of");
        let named = [
            "the regressor of `c(t-1)` equals 2 `a(t-1)` - 0.5 `b(t-1)`",
            "the regressor of `c(t-1)` equals -0.5 `b(t-1)` + 2 `a(t-1)`",
            "the regressor of `a(t-1)` equals 0.5 `c(t-1)` + 0.25 `b(t-1)`",
            "the regressor of `a(t-1)` equals 0.25 `b(t-1)` + 0.5 `c(t-1)`",
            "the regressor of `b(t-1)` equals 4 `a(t-1)` - 2 `c(t-1)`",
            "the regressor of `b(t-1)` equals -2 `c(t-1)` + 4 `a(t-1)`",
        ];
        assert!(text.contains("rank 2 of 3") && named.iter().any(|n| text.contains(n)), "{text}");
    };
    let fit = Ols::default().estimate(&model, std::slice::from_ref(&e), None, &|| false).unwrap();
    check(fit, "on these data the regressor of");
    // Sensitivities hold where they were taken.
    let fit = Sem::default().estimate(&model, std::slice::from_ref(&e), None, &|| false).unwrap();
    check(fit, "near this estimate the effect of");
}

/// A record that runs away: the best free run over it has a pole outside of the unit circle, and the fit says what comes
/// of that. The same with a stable system says nothing.
#[test]
fn an_unstable_optimum_is_told() {
    let model = PolyNarx::parse(&["u"], "y", &["u(t-1)", "y(t-1)"]).unwrap();
    for (pole, told) in [(1.01, true), (0.8, false)] {
        let e = simulated(&model, &[1.0, pole], 300, 0.1, 5);
        let fit = Sem::default().estimate(&model, std::slice::from_ref(&e), None, &|| false).unwrap();
        assert!((fit.theta[1] - pole).abs() < 0.01);
        let found = fit.warnings.iter().find(|w| w.contains("does not forget where it starts"));
        println!("{found:?}");
        assert_eq!(found.is_some(), told, "{:?}", fit.warnings);
        assert!(found.is_none_or(|w| w.contains("the tenth passage is") || w.contains("it diverges")));
    }
}
