//! Polynomials, local linear models, radial basis functions and means: derivatives, left-out residuals, known answers.

#[path = "common/response.rs"]
mod common;

use dynocal_ident::model::response::mean_of::MeanOf;
use dynocal_ident::model::response::polynomial::influence::Influence;
use dynocal_ident::model::response::polynomial::{Heredity, Polynomial, TransformChoice};
use dynocal_ident::model::response::rbf::Rbf;
use dynocal_ident::model::response::transform::Transform;
use dynocal_ident::model::response::{
    Ask, Learn, Learnt, Points, Prediction, RESPONSES, Response, ResponseModel, learner,
};
use dynocal_numerics::linalg::least_squares;
use dynocal_numerics::rng::Rng64;

fn names(d: usize) -> Vec<String> {
    (0..d).map(|j| ["speed", "load", "spark", "cam"][j].to_string()).collect()
}

fn points(n: usize, d: usize, seed: u64, noise: f64, f: impl Fn(&[f64]) -> f64) -> Points {
    let mut rng = Rng64::new(seed);
    let x: Vec<f64> = (0..n * d).map(|_| rng.uniform_in(-1.0, 1.0)).collect();
    let y = x.chunks_exact(d).map(|x| f(x) + noise * rng.normal()).collect();
    Points { inputs: names(d), output: "torque".into(), x, y }
}

fn smooth(x: &[f64]) -> f64 {
    5.0 + (1.5 * x[0]).sin() + x[1] * x[2] + 0.5 * x[2] * x[2] - 0.3 * x[0] * x[1]
}

fn learn(kind: &dyn Learn, points: &Points) -> Learnt {
    kind.learn(points, &|| false).unwrap()
}

fn keys(text: &str) -> toml::Table {
    toml::from_str(text).unwrap()
}

/// Every row of the table, and its options.
fn all_kinds() -> Vec<Box<dyn Learn>> {
    let texts = [
        ("stepwise_polynomial", ""),
        ("stepwise_polynomial", "transform = \"log\""),
        ("stepwise_polynomial", "transform = \"box_cox\"\ndegree = 2\nheredity = \"weak\""),
        (
            "stepwise_polynomial",
            "transform = \"logit\"\nlow = 0.0\nhigh = 20.0\nstepwise = false\ndegree = 2",
        ),
        ("gaussian_process", "starts = 1"),
        ("gaussian_process", "starts = 1\nkernel = \"matern52\"\nmean = \"linear\""),
        ("gaussian_process", "starts = 1\ntransform = \"log\""),
        ("local_linear", ""),
        ("local_linear", "quadratic = true\nmost = 4\nsteepness = [4.0]"),
        ("rbf", ""),
        ("mean_of", "models = [{ kind = \"stepwise_polynomial\" }, { kind = \"rbf\" }]"),
        ("best_of", "models = [{ kind = \"stepwise_polynomial\" }, { kind = \"rbf\" }]\nfolds = 3"),
    ];
    // A new row of the table must be added to the list.
    for member in RESPONSES {
        assert!(texts.iter().any(|(name, _)| *name == member.doc.name), "{} is not tested", member.doc.name);
    }
    texts.iter().map(|(name, text)| learner(name, &keys(text)).unwrap()).collect()
}

#[test]
fn derivatives_of_every_kind_are_those_of_differences() {
    let p = points(90, 3, 4, 0.02, smooth);
    for kind in all_kinds() {
        let learnt = learn(&*kind, &p);
        for x in [[0.2, -0.4, 0.33], [-0.7, 0.1, 0.8]] {
            // The mean of a process with a very large signal variance has rounding of 1e-7, which asks for a longer step;
            // a steep split asks for a short one.
            let process = matches!(learnt.model, ResponseModel::GaussianProcess(_));
            let (step, second) = if process { (1e-3, 1e-3) } else { (2e-5, 1e-4) };
            // n terms of the size of the signal's variance are subtracted from each other.
            let rounding = match &learnt.model {
                ResponseModel::GaussianProcess(m) => {
                    let variance = m.hyperparameters().signal_variance * p.output_range().powi(2);
                    f64::EPSILON * p.len() as f64 * variance
                }
                _ => 0.0,
            };
            common::check_response(&learnt.model, &x, step, 1e-4, second, rounding);
        }
    }
}

/// Where the first inputs stand still, derivatives with respect to the others are the same to the last bit.
#[test]
fn inputs_that_stand_still_change_no_derivative_of_the_others() {
    let positive = |x: &[f64]| smooth(x).abs() + 2.0;
    let points = points(40, 3, 5, 0.02, positive);
    let warped = learner("gaussian_process", &keys("transform = \"log\"\nwarp = \"asinh\"")).unwrap();
    for kind in all_kinds().into_iter().chain([warped]) {
        let model = learn(&*kind, &points).model;
        for first in 0..=3 {
            let (mut all, mut some) = (Prediction::new(3), Prediction::of_moving(3, first));
            for x in [[0.2, -0.4, 0.7], [-0.9, 0.1, 0.3]] {
                model.predict(&x, Ask::Hessian, &mut all);
                model.predict(&x, Ask::Hessian, &mut some);
                let (of, what) = ((some.mean, some.variance), model.describe());
                assert_eq!((all.mean, all.variance), of, "{what}");
                assert_eq!(all.gradient, some.gradient, "{what}");
                assert_eq!(all.variance_gradient, some.variance_gradient, "{what}");
                for at in (0..9).filter(|at| at / 3 >= first && at % 3 >= first) {
                    assert_eq!(all.hessian[at], some.hessian[at], "{what}");
                    assert_eq!(all.variance_hessian[at], some.variance_hessian[at], "{what}");
                }
            }
        }
    }
}

#[test]
fn every_kind_is_stored_whole_and_predicts_within_its_left_out_error() {
    let p = points(90, 3, 4, 0.02, smooth);
    let mut at = Prediction::new(3);
    for kind in all_kinds() {
        let learnt = learn(&*kind, &p);
        let again: ResponseModel =
            serde_json::from_str(&serde_json::to_string(&learnt.model).unwrap()).unwrap();
        assert_eq!(again, learnt.model);
        let test = points(200, 3, 5, 0.0, smooth);
        let squares: f64 = (0..200)
            .map(|i| {
                again.predict(test.row(i), Ask::Mean, &mut at);
                (at.mean - test.y[i]).powi(2)
            })
            .sum();
        let rmse = (squares / 200.0).sqrt();
        assert!(
            rmse < 2.0 * learnt.left_out.rmse(),
            "{}: {rmse} {}",
            again.describe(),
            learnt.left_out.rmse()
        );
        assert!(rmse < 0.12, "{}: {rmse}", again.describe());
    }
}

#[test]
fn press_is_that_of_the_hat_matrix_and_of_refits() {
    let p = points(40, 3, 6, 0.1, smooth);
    let full = Polynomial { degree: 2, stepwise: false, ..Default::default() };
    let learnt = learn(&full, &p);
    // Hat matrix of the raw second-degree regressors, from the normal equations of each refit by QR.
    let regressors = |x: &[f64]| {
        let mut r = vec![1.0, x[0], x[1], x[2]];
        (0..3).for_each(|i| (i..3).for_each(|j| r.push(x[i] * x[j])));
        r
    };
    for out in 0..40 {
        let rest: Vec<usize> = (0..40).filter(|i| *i != out).collect();
        let a: Vec<f64> = rest.iter().flat_map(|i| regressors(p.row(*i))).collect();
        let b: Vec<f64> = rest.iter().map(|i| p.y[*i]).collect();
        let fit = least_squares(&a, 39, 10, &b, 0.0).unwrap();
        let predicted: f64 = regressors(p.row(out)).iter().zip(&fit.x).map(|(r, w)| r * w).sum();
        assert!((learnt.left_out.residuals[out] - (p.y[out] - predicted)).abs() < 1e-9);
    }
    let ResponseModel::Polynomial(model) = &learnt.model else { panic!() };
    // Trace of the hat matrix.
    assert!((model.influence.leverage.iter().sum::<f64>() - 10.0).abs() < 1e-10);
}

#[test]
fn stepwise_finds_the_terms_that_are_there_and_keeps_heredity() {
    let truth = |x: &[f64]| 1.0 + 2.0 * x[0] - x[1] + 3.0 * x[0] * x[1] + 1.5 * x[2] * x[2];
    let p = points(120, 3, 7, 0.05, truth);
    for heredity in [Heredity::Strong, Heredity::Weak, Heredity::None] {
        let learnt = learn(&Polynomial { heredity, ..Default::default() }, &p);
        let ResponseModel::Polynomial(model) = &learnt.model else { panic!() };
        let terms = model.terms(&p.inputs);
        for needed in ["1", "speed", "load", "speed*load", "spark^2"] {
            assert!(terms.contains(&needed.to_string()), "{heredity:?}: {terms:?}");
        }
        assert!(terms.len() < 14, "{heredity:?}: {terms:?}");
        if heredity == Heredity::Strong {
            assert!(terms.contains(&"spark".to_string()), "{terms:?}");
        }
    }
}

#[test]
fn the_power_of_a_transformed_output_is_found() {
    for (power, f) in [(0.0, (|m: f64| m.exp()) as fn(f64) -> f64), (0.5, |m: f64| (1.0 + 0.5 * m).powi(2))] {
        let p = points(200, 2, 9, 0.0, |x| x[0] + 0.5 * x[1]);
        let mut rng = Rng64::new(10);
        let y = p.y.iter().map(|m| f(m + 0.1 * rng.normal())).collect();
        let p = Points { y, ..p };
        let learnt =
            learn(&Polynomial { transform: TransformChoice::BoxCox, degree: 2, ..Default::default() }, &p);
        let ResponseModel::Polynomial(model) = &learnt.model else { panic!() };
        let Transform::BoxCox { power: found } = model.transform() else { panic!() };
        assert!((found - power).abs() < 0.35, "{found} instead of {power}");
    }
    let negative = points(30, 2, 9, 0.0, |x| x[0]);
    let error = Polynomial { transform: TransformChoice::Log, ..Default::default() }
        .learn(&negative, &|| false)
        .unwrap_err();
    assert!(error.to_string().contains("`transform` is for positive outputs"), "{error}");
}

#[test]
fn outliers_are_named_and_studentised_residuals_are_those_of_refits() {
    let mut p = points(50, 2, 11, 0.1, |x| x[0] - 2.0 * x[1]);
    p.y[17] += 2.0;
    let learnt = learn(&Polynomial { degree: 1, stepwise: false, ..Default::default() }, &p);
    let ResponseModel::Polynomial(model) = &learnt.model else { panic!() };
    assert_eq!(model.influence.outliers, [17]);
    assert!(learnt.notes.iter().any(|n| n.contains("row 18 lies")), "{:?}", learnt.notes);
    let regressors = |x: &[f64]| vec![1.0, x[0], x[1]];
    for out in [0, 17, 33] {
        let rest: Vec<usize> = (0..50).filter(|i| *i != out).collect();
        let a: Vec<f64> = rest.iter().flat_map(|i| regressors(p.row(*i))).collect();
        let b: Vec<f64> = rest.iter().map(|i| p.y[*i]).collect();
        let fit = least_squares(&a, 49, 3, &b, 0.0).unwrap();
        let s = (fit.residual_sum_squares / 46.0).sqrt();
        // t_i = e_(i) sqrt(1 - h_i) / s_(i).
        let left: f64 = p.y[out] - regressors(p.row(out)).iter().zip(&fit.x).map(|(r, w)| r * w).sum::<f64>();
        let t = left * (1.0 - model.influence.leverage[out]).sqrt() / s;
        assert!((t - model.influence.studentised[out]).abs() < 1e-9, "{t}");
    }
}

#[test]
fn influence_names_about_one_set_in_twenty_without_outliers() {
    let sets = 400;
    let mut named = 0;
    for seed in 0..sets {
        let p = points(40, 2, 1000 + seed, 0.1, |x| x[0] - 2.0 * x[1]);
        let learnt = learn(&Polynomial { degree: 1, stepwise: false, ..Default::default() }, &p);
        let ResponseModel::Polynomial(model) = &learnt.model else { panic!() };
        named += usize::from(!model.influence.outliers.is_empty());
        let again: &Influence = &model.influence;
        assert_eq!(again.leverage.len(), 40);
    }
    // 5 % of 400 with four standard errors.
    assert!((3..=38).contains(&named), "{named} of {sets}");
}

#[test]
fn local_linear_models_follow_a_hyperbola() {
    // The demonstration of the method: y = 1/(0.1 + u), 15 points; at most 0.05 of the range.
    let f = |u: f64| 1.0 / (0.1 + u);
    let x: Vec<f64> = (0..15).map(|i| f64::from(i) / 14.0).collect();
    let y = x.iter().map(|u| f(*u)).collect();
    let p = Points { inputs: vec!["u".into()], output: "y".into(), x, y };
    let learnt = learn(&*learner("local_linear", &toml::Table::new()).unwrap(), &p);
    let mut at = Prediction::new(1);
    let squares: f64 = (0..1000)
        .map(|i| {
            let u = f64::from(i) / 999.0;
            learnt.model.predict(&[u], Ask::Mean, &mut at);
            (at.mean - f(u)).powi(2)
        })
        .sum();
    let share = (squares / 1000.0).sqrt() / (f(0.0) - f(1.0));
    println!("{}: RMSE over range {share:.4}", learnt.model.describe());
    assert!(share <= 0.05, "{share}");
}

#[test]
fn an_oblique_kink_is_split_along_its_direction() {
    // Two planes that meet along x0 + x1 = 0.
    let p = points(300, 2, 12, 0.01, |x| (x[0] + x[1]).abs());
    let learnt = learn(&*learner("local_linear", &toml::Table::new()).unwrap(), &p);
    let ResponseModel::LocalLinear(model) = &learnt.model else { panic!() };
    let normal: Vec<f64> =
        model.tree.splits[0].normal.iter().zip(&model.scaling.std).map(|(v, s)| v / s).collect();
    let cosine = (normal[0] + normal[1]).abs() / (2.0f64.sqrt() * normal[0].hypot(normal[1]));
    assert!(cosine > 0.99, "{normal:?}");
    assert!(learnt.left_out.rmse() < 0.04, "{}", learnt.left_out.rmse());
}

#[test]
fn local_validities_sum_to_one_and_the_sum_of_local_models_is_the_model() {
    let p = points(150, 3, 13, 0.02, smooth);
    let learnt = learn(&*learner("local_linear", &keys("most = 6")).unwrap(), &p);
    let ResponseModel::LocalLinear(model) = &learnt.model else { panic!() };
    let mut at = Prediction::new(3);
    for i in 0..20 {
        let x = p.row(i);
        let z: Vec<f64> = (0..3).map(|j| (x[j] - model.scaling.mean[j]) / model.scaling.std[j]).collect();
        let (mut sum, mut y) = (0.0, 0.0);
        for (l, leaf) in model.tree.leaves.iter().enumerate() {
            let side = |(split, side): &(usize, bool)| {
                let psi = model.tree.splits[*split].psi(&z);
                if *side { psi } else { 1.0 - psi }
            };
            let validity: f64 = leaf.path.iter().map(side).product();
            let w = model.local(l);
            sum += validity;
            y += validity * (w[0] + w[1] * z[0] + w[2] * z[1] + w[3] * z[2]);
        }
        model.predict(x, Ask::Mean, &mut at);
        assert!((sum - 1.0).abs() < 1e-12);
        assert!((model.scaling.output_mean + model.scaling.output_std * y - at.mean).abs() < 1e-10);
    }
}

#[test]
fn a_mean_spreads_where_its_members_disagree() {
    let p = points(60, 2, 14, 0.05, |x| (3.0 * x[0]).sin() + x[1]);
    let members: Vec<Box<dyn Learn>> =
        vec![Box::new(Polynomial { degree: 1, ..Default::default() }), Box::new(Rbf::default())];
    let learnt = learn(&MeanOf { members }, &p);
    let ResponseModel::MeanOf(model) = &learnt.model else { panic!() };
    let (mut at, mut a, mut b) = (Prediction::new(2), Prediction::new(2), Prediction::new(2));
    model.predict(&[0.5, 0.1], Ask::Variance, &mut at);
    model.models[0].predict(&[0.5, 0.1], Ask::Variance, &mut a);
    model.models[1].predict(&[0.5, 0.1], Ask::Variance, &mut b);
    assert!((at.mean - 0.5 * (a.mean + b.mean)).abs() < 1e-12);
    let variance = 0.5 * (a.variance + b.variance) + 0.25 * (a.mean - b.mean).powi(2);
    assert!((at.variance - variance).abs() < 1e-12);
}

#[test]
fn wrong_keys_are_named() {
    for (kind, text, expected) in [
        ("stepwise_polynomial", "degre = 2", "degre"),
        ("gaussian_proces", "", "did you mean `gaussian_process`"),
        ("mean_of", "models = []", "empty"),
        ("mean_of", "models = [{ degree = 2 }]", "kind"),
        ("local_linear", "most = -3", "-3"),
    ] {
        let error = learner(kind, &keys(text)).err().unwrap().to_string();
        assert!(error.contains(expected), "{error}");
    }
}
