//! Huber's cost against planted outliers; several outputs with a weighting or the determinant of their errors.

use dynocal_ident::estimate::cost::{CostKind, HUBER_THRESHOLD};
use dynocal_ident::estimate::ols::Ols;
use dynocal_ident::estimate::sem::Sem;
use dynocal_ident::estimate::several::{SeveralFit, Weighting, estimate_several};
use dynocal_ident::estimate::{Estimator, Fit, estimator};
use dynocal_ident::experiment::Experiment;
use dynocal_ident::model::poly::PolyNarx;
use dynocal_ident::model::{Model, Run};
use dynocal_numerics::rng::Rng64;

fn simulated(model: &PolyNarx, theta: &[f64], n: usize, std: f64, seed: u64) -> Experiment {
    let mut rng = Rng64::new(seed);
    let u: Vec<f64> = (0..n * model.n_inputs()).map(|_| rng.uniform_in(-1.0, 1.0)).collect();
    let (zeros, mut y) = (vec![0.0; n], vec![0.0; n]);
    model.simulate(theta, &Run { u: &u, y: &zeros, start: model.max_lag() }, &mut y);
    y[model.max_lag()..].iter_mut().for_each(|v| *v += std * rng.normal());
    Experiment { name: format!("sim{seed}"), u, y, init_samples: 0, weights: Vec::new() }
}

/// One sample in twenty is off by 6, twenty times the noise, always upwards.
fn with_outliers(e: &Experiment, from: usize) -> Experiment {
    let mut bad = e.clone();
    bad.y.iter_mut().skip(from).step_by(20).for_each(|v| *v += 6.0);
    bad
}

fn fit(estimator: &dyn Estimator, model: &PolyNarx, e: &Experiment) -> Fit {
    estimator.estimate(model, std::slice::from_ref(e), None, &|| false).unwrap()
}

/// Largest distance of two estimates in standard errors of the first.
fn distance(clean: &Fit, other: &Fit) -> f64 {
    let each = clean.theta.iter().zip(&other.theta).zip(&clean.std_errors);
    each.map(|((a, b), s)| (a - b).abs() / s).fold(0.0, f64::max)
}

/// Robust fits stay within a few standard errors of the fit of the clean record; squares do not.
#[test]
fn planted_outliers_move_squares_and_not_huber() {
    let dynamic = PolyNarx::parse(&["u"], "y", &["1", "u(t-1)", "u(t-2)^2", "y(t-1)"]).unwrap();
    let direct = PolyNarx::parse(&["u"], "y", &["1", "u(t-1)", "u(t-2)^2", "u(t-3)"]).unwrap();
    let truth = [0.2, 1.0, -0.5, 0.7];
    let cases: [(&PolyNarx, &dyn Estimator, &dyn Estimator); 2] = [
        (&dynamic, &Sem::default(), &Sem { cost: CostKind::Huber, ..Sem::default() }),
        (&direct, &Ols::default(), &Ols { cost: CostKind::Huber, ..Ols::default() }),
    ];
    for (model, squares, huber) in cases {
        let e = simulated(model, &truth, 1000, 0.3, 4);
        let bad = with_outliers(&e, 10);
        let clean = fit(squares, model, &e);
        let (moved, kept) =
            (distance(&clean, &fit(squares, model, &bad)), distance(&clean, &fit(huber, model, &bad)));
        println!("squares {moved:.1}, Huber {kept:.1} standard errors from the clean fit");
        // Squares take the mean of the outliers into the constant, 0.05 x 20 standard deviations of the noise; Huber's cost
        // about a tenth of that, since no outlier counts more than 1.345 of them.
        assert!(moved > 5.0 && kept < 0.3 * moved, "{moved} {kept}");
        let told = fit(huber, model, &bad).warnings;
        assert!(told.iter().any(|w| w.contains("beyond Huber's threshold")), "{told:?}");
        // Clean normal errors: nearly as good as squares, and nothing to tell.
        let same = fit(huber, model, &e);
        assert!(distance(&clean, &same) < 1.0, "{}", distance(&clean, &same));
        assert!(!same.warnings.iter().any(|w| w.contains("Huber")), "{:?}", same.warnings);
    }
}

/// Where the search ends, the cost with its scale (1.4826 times the median error there) has no slope: central differences.
#[test]
fn hubers_fit_is_a_minimum_of_hubers_cost() {
    let model = PolyNarx::parse(&["u"], "y", &["1", "u(t-1)", "u(t-1)^2", "y(t-1)"]).unwrap();
    let e = with_outliers(&simulated(&model, &[0.2, 1.0, -0.5, 0.7], 500, 0.3, 9), 7);
    let huber = Sem { cost: CostKind::Huber, cost_tolerance: 1e-15, ..Sem::default() };
    let found = fit(&huber, &model, &e);
    let errors = |theta: &[f64]| -> Vec<f64> {
        let mut y = vec![0.0; e.len()];
        model.simulate(theta, &e.run(&model), &mut y);
        (1..e.len()).map(|t| y[t] - e.y[t]).collect()
    };
    let mut sizes: Vec<f64> = errors(&found.theta).iter().map(|v| v.abs()).collect();
    sizes.sort_by(f64::total_cmp);
    let c = HUBER_THRESHOLD * 1.4826 * sizes[sizes.len() / 2];
    let rho = |v: f64| if v.abs() <= c { v * v } else { 2.0 * c * v.abs() - c * c };
    let cost = |theta: &[f64]| errors(theta).into_iter().map(rho).sum::<f64>();
    let slope = |theta: &[f64], k: usize| {
        let h = 1e-4 * found.std_errors[k];
        let at = |sign: f64| {
            let mut moved = theta.to_vec();
            moved[k] += sign * h;
            cost(&moved)
        };
        (at(1.0) - at(-1.0)) / 2e-4
    };
    for k in 0..4 {
        let mut away = found.theta.clone();
        away[k] += found.std_errors[k];
        let (here, there) = (slope(&found.theta, k), slope(&away, k));
        // The scale rests to 1e-4 only.
        assert!(
            here.abs() < 2e-3 * there.abs(),
            "parameter {k}: slope {here}, one standard error away {there}"
        );
    }
}

#[test]
fn a_threshold_that_no_error_reaches_gives_squares() {
    let model = PolyNarx::parse(&["u"], "y", &["1", "u(t-1)", "y(t-1)"]).unwrap();
    let e = simulated(&model, &[0.2, 1.0, 0.7], 400, 0.3, 2);
    for name in ["sem", "ols"] {
        let build = |text: &str| estimator(name, &toml::from_str(text).unwrap()).unwrap();
        let (a, b) = (
            fit(build("").as_ref(), &model, &e),
            fit(build("cost = \"huber\"\nthreshold = 50.0").as_ref(), &model, &e),
        );
        for k in 0..3 {
            assert!((a.theta[k] - b.theta[k]).abs() < 1e-5 * a.std_errors[k], "{name} {k}");
            assert!((a.std_errors[k] / b.std_errors[k] - 1.0).abs() < 1e-6, "{name} {k}");
        }
        let keys = toml::from_str("cost = \"absolute\"").unwrap();
        assert!(estimator(name, &keys).err().unwrap().to_string().contains("huber"));
    }
}

/// Two outputs of different inputs whose noises go together.
struct Pair {
    models: [PolyNarx; 2],
    truth: [[f64; 2]; 2],
    correlation: f64,
    n: usize,
}

impl Pair {
    fn new(correlation: f64) -> Self {
        let models = [
            PolyNarx::parse(&["u"], "y", &["u(t-1)", "y(t-1)"]).unwrap(),
            PolyNarx::parse(&["v"], "z", &["v(t-1)", "z(t-1)"]).unwrap(),
        ];
        Self { models, truth: [[1.0, 0.8], [0.5, 0.6]], correlation, n: 400 }
    }

    fn draw(&self, seed: u64) -> [Experiment; 2] {
        let mut rng = Rng64::stream(31, seed);
        let common: Vec<f64> = (0..self.n).map(|_| rng.normal()).collect();
        let (shared, own) = (self.correlation.sqrt(), (1.0 - self.correlation).sqrt());
        std::array::from_fn(|i| {
            // The same inputs in every draw: only the noise is new.
            let mut e = simulated(&self.models[i], &self.truth[i], self.n, 0.0, 100 + i as u64);
            for (y, c) in e.y.iter_mut().zip(&common).skip(1) {
                *y += 0.3 * (shared * c + own * rng.normal());
            }
            e
        })
    }

    fn fit(&self, records: &[Experiment; 2], weighting: &Weighting) -> SeveralFit {
        let models: [&dyn Model; 2] = [&self.models[0], &self.models[1]];
        let data = [std::slice::from_ref(&records[0]), std::slice::from_ref(&records[1])];
        estimate_several(&models, &data, weighting, &Sem::default(), &|| false).unwrap()
    }
}

/// Noises with a correlation of 0.95 and inputs that have nothing to do with each other: the spread falls towards
/// sqrt(1 - 0.95^2) = 0.31 of that of single fits (Zellner 1962), and the stated errors with it.
#[test]
fn outputs_with_common_noise_help_each_other() {
    let pair = Pair::new(0.95);
    let draws = 200;
    let (mut single, mut joint, mut stated) = ([0.0; 4], [0.0; 4], [0.0; 4]);
    for d in 0..draws {
        let records = pair.draw(d);
        let both = pair.fit(&records, &Weighting::Determinant);
        for i in 0..2 {
            let alone = fit(&Sem::default(), &pair.models[i], &records[i]);
            for k in 0..2 {
                single[2 * i + k] += (alone.theta[k] - pair.truth[i][k]).powi(2) / draws as f64;
                joint[2 * i + k] += (both.fits[i].theta[k] - pair.truth[i][k]).powi(2) / draws as f64;
                stated[2 * i + k] += both.fits[i].std_errors[k] / draws as f64;
            }
        }
    }
    for k in 0..4 {
        let (gain, honest) = ((joint[k] / single[k]).sqrt(), stated[k] / joint[k].sqrt());
        println!("parameter {k}: spread {gain:.3} of that of single fits, stated / observed {honest:.3}");
        assert!(gain < 0.31 * 1.25, "{gain}");
        assert!((honest - 1.0).abs() < 4.0 / (2.0 * draws as f64).sqrt(), "{honest}");
    }
}

/// The determinant has no slope where the searches end, and has only fallen.
#[test]
fn the_determinant_is_made_small() {
    let pair = Pair::new(0.7);
    let records = pair.draw(3);
    let found = pair.fit(&records, &Weighting::Determinant);
    assert!(found.log_det.windows(2).all(|w| w[1] <= w[0] + 1e-12), "{:?}", found.log_det);
    let log_det = |theta: &[Vec<f64>; 2]| {
        let errors: [Vec<f64>; 2] = std::array::from_fn(|i| {
            let mut y = vec![0.0; pair.n];
            pair.models[i].simulate(&theta[i], &records[i].run(&pair.models[i]), &mut y);
            y.iter().zip(&records[i].y).map(|(a, b)| a - b).collect()
        });
        let s = |i: usize, j: usize| {
            (1..pair.n).map(|t| errors[i][t] * errors[j][t]).sum::<f64>() / (pair.n - 1) as f64
        };
        (s(0, 0) * s(1, 1) - s(0, 1).powi(2)).ln()
    };
    let theta = [found.fits[0].theta.clone(), found.fits[1].theta.clone()];
    assert!((log_det(&theta) - found.log_det[found.log_det.len() - 1]).abs() < 1e-10);
    for i in 0..2 {
        for k in 0..2 {
            let step = found.fits[i].std_errors[k];
            let slope = |centre: f64| {
                let at = |sign: f64| {
                    let mut moved = theta.clone();
                    moved[i][k] += (centre + 1e-3 * sign) * step;
                    log_det(&moved)
                };
                (at(1.0) - at(-1.0)) / 2e-3
            };
            assert!(slope(0.0).abs() < 1e-3 * slope(1.0).abs(), "{i} {k}: {} {}", slope(0.0), slope(1.0));
        }
    }
}

/// A diagonal weighting separates: the single fits. A matrix that is none is refused.
#[test]
fn a_diagonal_weighting_gives_the_single_fits() {
    let pair = Pair::new(0.7);
    let records = pair.draw(5);
    let found = pair.fit(&records, &Weighting::Matrix(vec![3.0, 0.0, 0.0, 0.2]));
    for i in 0..2 {
        let alone = fit(&Sem::default(), &pair.models[i], &records[i]);
        for k in 0..2 {
            assert!((alone.theta[k] - found.fits[i].theta[k]).abs() < 1e-5 * alone.std_errors[k]);
            assert!((alone.std_errors[k] / found.fits[i].std_errors[k] - 1.0).abs() < 0.01);
        }
    }
    let models: [&dyn Model; 2] = [&pair.models[0], &pair.models[1]];
    let data = [std::slice::from_ref(&records[0]), std::slice::from_ref(&records[1])];
    let bad = Weighting::Matrix(vec![1.0, 2.0, 2.0, 1.0]);
    assert!(estimate_several(&models, &data, &bad, &Sem::default(), &|| false).is_err());
    let mut short = records[1].clone();
    short.y.pop();
    short.u.pop();
    let data = [std::slice::from_ref(&records[0]), std::slice::from_ref(&short)];
    let fault =
        estimate_several(&models, &data, &Weighting::Determinant, &Sem::default(), &|| false).unwrap_err();
    assert_eq!(fault.to_string(), "sim100: channel `output of model 2` has 399 samples, the others have 400");
}
