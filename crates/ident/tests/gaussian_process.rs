//! Exact Gaussian processes against scikit-learn's numbers, differences, refits and invariances.

#[path = "common/response.rs"]
mod common;

use dynocal_ident::model::response::gp::likelihood::{Problem, Work};
use dynocal_ident::model::response::gp::{
    GaussianProcess, GpModel, Kernel, KernelChoice, Mean, OutputChoice,
};
use dynocal_ident::model::response::{
    Ask, Learn, Learnt, Points, PointsError, Prediction, Response, ResponseError, ResponseModel,
};
use dynocal_numerics::rng::Rng64;

/// Reference values and their origin: tests/reference/README.md.
const REFERENCE: &str = include_str!("../../../tests/reference/gaussian_process.json");

/// The same sets by a second implementation: tests/reference/README.md.
const SECOND: &str = include_str!("../../../tests/reference/gprx.json");

fn numbers(value: &serde_json::Value) -> Vec<f64> {
    value.as_array().unwrap().iter().map(|v| v.as_f64().unwrap()).collect()
}

fn transposed(x: &[f64], d: usize) -> Vec<f64> {
    (0..d).flat_map(|j| x.iter().skip(j).step_by(d).copied().collect::<Vec<f64>>()).collect()
}

/// Smooth function of d inputs with noise.
fn case(n: usize, d: usize, noise: f64, seed: u64) -> Points {
    let mut rng = Rng64::new(seed);
    let x: Vec<f64> = (0..n * d).map(|_| rng.uniform()).collect();
    let y = x
        .chunks_exact(d)
        .map(|x| {
            let smooth: f64 = x.iter().enumerate().map(|(j, v)| ((j + 1) as f64 * v).sin()).sum();
            smooth + x[0] * x[d - 1] + noise * rng.normal()
        })
        .collect();
    Points { inputs: (0..d).map(|j| format!("x{j}")).collect(), output: "y".into(), x, y }
}

fn learn(keys: &GaussianProcess, points: &Points) -> (Learnt, GpModel) {
    let learnt = keys.learn(points, &|| false).unwrap();
    let ResponseModel::GaussianProcess(model) = learnt.model.clone() else {
        panic!("not a Gaussian process")
    };
    (learnt, model)
}

#[test]
fn likelihood_gradient_and_prediction_are_those_of_scikit_learn() {
    let reference: serde_json::Value = serde_json::from_str(REFERENCE).unwrap();
    for case in reference["cases"].as_array().unwrap() {
        let kernel: Kernel = serde_json::from_value(case["kernel"].clone()).unwrap();
        let (x, y) = (numbers(&case["x"]), numbers(&case["y"]));
        let lengths = numbers(&case["length_scale"]);
        let (signal, noise) =
            (case["signal_variance"].as_f64().unwrap(), case["noise_variance"].as_f64().unwrap());
        let d = lengths.len();
        let columns = transposed(&x, d);
        let problem = Problem { kernel, columns: &columns, y: &y, basis: &[], noise_shape: &[] };
        let logs: Vec<f64> = lengths.iter().map(|l| l.ln()).collect();
        let mut work = Work::new(y.len());
        let at = problem.likelihood(&logs, noise / signal, Some(signal), true, &mut work).unwrap();
        let expected = case["log_marginal_likelihood"].as_f64().unwrap();
        assert!((at.value - expected).abs() <= 1e-9 * expected.abs(), "{kernel:?}: {} {expected}", at.value);
        // Theirs: signal variance at constant noise variance, lengths, noise variance.
        let theirs = numbers(&case["gradient"]);
        let mut ours = vec![at.gradient[d + 1] - at.gradient[d]];
        ours.extend_from_slice(&at.gradient[..d]);
        ours.push(at.gradient[d]);
        for (a, b) in ours.iter().zip(&theirs) {
            assert!((a - b).abs() <= 1e-8 * (1.0 + b.abs()), "{kernel:?}: {ours:?} {theirs:?}");
        }
    }
}

#[test]
fn likelihood_prediction_and_leave_one_out_are_those_of_gprx() {
    let sets: serde_json::Value = serde_json::from_str(REFERENCE).unwrap();
    let second: serde_json::Value = serde_json::from_str(SECOND).unwrap();
    let pairs = sets["cases"].as_array().unwrap().iter().zip(second["cases"].as_array().unwrap());
    assert_eq!(pairs.len(), 6);
    for (set, other) in pairs {
        let kernel: Kernel = serde_json::from_value(set["kernel"].clone()).unwrap();
        let (x, y, lengths) = (numbers(&set["x"]), numbers(&set["y"]), numbers(&set["length_scale"]));
        let number = |key: &str| set[key].as_f64().unwrap();
        let (signal, noise, d) = (number("signal_variance"), number("noise_variance"), lengths.len());
        let columns = transposed(&x, d);
        let problem = Problem { kernel, columns: &columns, y: &y, basis: &[], noise_shape: &[] };
        let (logs, ratio): (Vec<f64>, f64) = (lengths.iter().map(|l| l.ln()).collect(), noise / signal);
        let mut work = Work::new(y.len());
        let near = |ours: f64, theirs: f64| {
            assert!((ours - theirs).abs() <= 1e-9 * (1.0 + theirs.abs()), "{kernel:?}: {ours} {theirs}");
        };
        let value = problem.likelihood(&logs, ratio, Some(signal), false, &mut work).unwrap().value;
        near(value, -other["neg_log_marginal_likelihood"].as_f64().unwrap());
        let left = problem.leave_one_out(&logs, ratio, signal, &mut work).unwrap();
        let (means, variances) = (numbers(&other["loo_mean"]), numbers(&other["loo_variance"]));
        for i in 0..y.len() {
            near(y[i] - left.residuals[i], means[i]);
            near(left.variance[i], variances[i]);
        }
        let factors = problem.factors(&logs, ratio, &mut Work::new(y.len())).unwrap();
        let (means, variances) = (numbers(&other["mean"]), numbers(&other["variance"]));
        for (i, at) in numbers(&other["at"]).chunks(d).enumerate() {
            let distance = |point: &[f64]| -> f64 {
                point.iter().zip(at).zip(&lengths).map(|((a, b), l)| ((a - b) / l).powi(2)).sum()
            };
            let k: Vec<f64> = x.chunks(d).map(|p| kernel.correlation(distance(p)).value).collect();
            near(factors.mean(&[], &k), means[i]);
            let relative = factors.variance(&[], &k, &mut vec![0.0; y.len()], &mut []);
            near(signal * (ratio + relative), variances[i]);
        }
    }
}

#[test]
fn gradients_of_the_likelihood_are_those_of_differences() {
    for kernel in Kernel::ALL {
        for mean in [Mean::Zero, Mean::Constant, Mean::Linear, Mean::Quadratic] {
            for given in [None, Some(0.7)] {
                let p = case(40, 3, 0.1, 3);
                let columns = transposed(&p.x, 3);
                let q = mean.count(3);
                let mut basis = vec![0.0; 40 * q];
                for i in 0..40 {
                    mean.values(p.row(i), &mut basis[i * q..(i + 1) * q]);
                }
                let shape: Vec<f64> = (0..40).map(|i| 0.5 + f64::from(i) / 20.0).collect();
                let problem =
                    Problem { kernel, columns: &columns, y: &p.y, basis: &basis, noise_shape: &shape };
                let mut work = Work::new(40);
                let mut at = |t: &[f64], gradient: bool| {
                    let s2 = given.map(|s: f64| s * t[4].exp());
                    problem.likelihood(&t[..3], t[3].exp(), s2, gradient, &mut work).unwrap()
                };
                let theta = [-0.4, 0.3, 0.8, -2.5, 0.0];
                let gradient = at(&theta, true).gradient;
                for k in 0..if given.is_some() { 5 } else { 4 } {
                    let h = 1e-5;
                    let (mut up, mut down) = (theta, theta);
                    up[k] += h;
                    down[k] -= h;
                    let difference = (at(&up, false).value - at(&down, false).value) / (2.0 * h);
                    assert!(
                        (gradient[k] - difference).abs() <= 1e-6 * (1.0 + difference.abs()),
                        "{kernel:?} {mean:?} {k}: {} {difference}",
                        gradient[k]
                    );
                }
            }
        }
    }
}

#[test]
fn leave_one_out_is_that_of_as_many_refits() {
    for (kernel, mean) in [
        (Kernel::SquaredExponential, Mean::Zero),
        (Kernel::Matern52, Mean::Constant),
        (Kernel::Matern32, Mean::Quadratic),
    ] {
        let (n, d) = (25, 2);
        let p = case(n, d, 0.1, 8);
        let q = mean.count(d);
        let logs = [-0.5, 0.2];
        let of = |rows: &[usize]| {
            let part = p.rows(rows);
            let mut basis = vec![0.0; rows.len() * q];
            for i in 0..rows.len() {
                mean.values(part.row(i), &mut basis[i * q..(i + 1) * q]);
            }
            (transposed(&part.x, d), basis, part.y)
        };
        let all: Vec<usize> = (0..n).collect();
        let (columns, basis, y) = of(&all);
        let problem = Problem { kernel, columns: &columns, y: &y, basis: &basis, noise_shape: &[] };
        let left = problem.leave_one_out(&logs, 0.05, 1.3, &mut Work::new(n)).unwrap();
        for out in 0..n {
            let rest: Vec<usize> = (0..n).filter(|i| *i != out).collect();
            let (columns, basis, y) = of(&rest);
            let problem = Problem { kernel, columns: &columns, y: &y, basis: &basis, noise_shape: &[] };
            let factors = problem.factors(&logs, 0.05, &mut Work::new(n - 1)).unwrap();
            let mut h = vec![0.0; q];
            mean.values(p.row(out), &mut h);
            let k: Vec<f64> = rest
                .iter()
                .map(|i| {
                    let of = |j: usize| ((p.row(out)[j] - p.row(*i)[j]) / logs[j].exp()).powi(2);
                    kernel.correlation((0..d).map(of).sum()).value
                })
                .collect();
            let mean_out = factors.mean(&h, &k);
            let relative = factors.variance(&h, &k, &mut vec![0.0; n - 1], &mut vec![0.0; q]);
            let variance = 1.3 * (0.05 + relative);
            assert!((left.residuals[out] - (p.y[out] - mean_out)).abs() < 1e-9, "{kernel:?} {mean:?} {out}");
            assert!((left.variance[out] - variance).abs() < 1e-9, "{kernel:?} {mean:?} {out}");
        }
    }
}

#[test]
fn gradients_and_hessians_of_predictions_are_those_of_differences() {
    for (kernel, mean) in [
        (KernelChoice::SquaredExponential, Mean::Constant),
        (KernelChoice::Matern32, Mean::Linear),
        (KernelChoice::Matern52, Mean::Quadratic),
        (KernelChoice::Matern52, Mean::Zero),
    ] {
        let d = 3;
        let (_, model) =
            learn(&GaussianProcess { kernel, mean, starts: 1, ..Default::default() }, &case(60, d, 0.05, 5));
        common::check_response(&model, &[0.31, 0.62, 0.47], 2e-5, 1e-4, 2e-5, 0.0);
    }
}

#[test]
fn order_scale_and_offset_of_the_inputs_change_nothing() {
    let p = case(70, 3, 0.05, 9);
    let (_, model) = learn(&GaussianProcess::default(), &p);
    let turned = Points {
        inputs: [2, 0, 1].iter().map(|j| p.inputs[*j].clone()).collect(),
        output: "y".into(),
        x: p.x.chunks_exact(3).flat_map(|x| [1e4 * x[2] - 7.0, x[0] + 300.0, 1e-3 * x[1]]).collect(),
        y: p.y.iter().map(|y| 50.0 * y - 1000.0).collect(),
    };
    let (_, other) = learn(&GaussianProcess::default(), &turned);
    let (mut a, mut b) = (Prediction::new(3), Prediction::new(3));
    for x in case(20, 3, 0.0, 10).x.chunks_exact(3) {
        model.predict(x, Ask::Variance, &mut a);
        other.predict(&[1e4 * x[2] - 7.0, x[0] + 300.0, 1e-3 * x[1]], Ask::Variance, &mut b);
        assert!((50.0 * a.mean - 1000.0 - b.mean).abs() < 2e-3, "{} {}", 50.0 * a.mean - 1000.0, b.mean);
        assert!(
            (2500.0 * a.variance - b.variance).abs() < 1e-2 * b.variance,
            "{} {}",
            a.variance,
            b.variance
        );
    }
}

#[test]
fn a_point_that_is_added_gives_the_model_of_all_points() {
    let p = case(50, 2, 0.05, 12);
    for mean in [Mean::Zero, Mean::Linear] {
        let (_, mut model) = learn(&GaussianProcess { mean, starts: 1, ..Default::default() }, &p);
        let more = case(5, 2, 0.05, 13);
        for i in 0..5 {
            model.add(more.row(i), more.y[i]).unwrap();
        }
        // What is stored is rebuilt from all points at once.
        let rebuilt: GpModel = serde_json::from_str(&serde_json::to_string(&model).unwrap()).unwrap();
        assert_eq!(rebuilt.points(), 55);
        let (mut a, mut b) = (Prediction::new(2), Prediction::new(2));
        for x in case(20, 2, 0.0, 14).x.chunks_exact(2) {
            model.predict(x, Ask::Gradient, &mut a);
            rebuilt.predict(x, Ask::Gradient, &mut b);
            assert!((a.mean - b.mean).abs() < 1e-7 && (a.variance - b.variance).abs() < 1e-7);
            assert!(a.gradient.iter().zip(&b.gradient).all(|(a, b)| (a - b).abs() < 1e-6));
        }
    }
}

#[test]
fn equal_seeds_give_equal_bytes_for_any_number_of_threads() {
    let p = case(60, 3, 0.05, 20);
    let run = |threads: usize| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        let learnt = pool.install(|| GaussianProcess::default().learn(&p, &|| false).unwrap());
        serde_json::to_string(&learnt).unwrap()
    };
    assert_eq!(run(1), run(3));
}

#[test]
fn faults_of_the_points_are_named() {
    let mut p = case(30, 2, 0.1, 1);
    (0..30).for_each(|i| p.x[2 * i + 1] = 4.0);
    let error = GaussianProcess::default().learn(&p, &|| false).unwrap_err();
    assert!(error.to_string().contains("`x1` is 4 at all 30 points"), "{error}");
    p.x[7] = f64::NAN;
    let error = GaussianProcess::default().learn(&p, &|| false).unwrap_err();
    assert!(
        matches!(error, ResponseError::Points(PointsError::NotFinite { ref channel, row: 4, .. }) if channel == "x1")
    );
    let few = case(4, 2, 0.1, 1);
    assert!(GaussianProcess::default().learn(&few, &|| false).unwrap_err().to_string().contains("4 points"));
    let mut doubled = case(30, 2, 0.1, 1);
    doubled.x.extend_from_within(..6);
    doubled.y.extend([doubled.y[0], 1.0, 2.0]);
    let (learnt, _) = learn(&GaussianProcess { starts: 1, ..Default::default() }, &doubled);
    assert!(learnt.notes.iter().any(|n| n.contains("6 points lie at 3 repeated")), "{:?}", learnt.notes);
    let warnings = doubled.warnings(&learnt.left_out);
    assert!(warnings.iter().any(|n| n.contains("row 31 repeats inputs and output")), "{warnings:?}");
}

/// A process of the logarithm is the process of logarithms, turned back: mean, first-order variance, formula, covariances, sparse too.
#[test]
fn a_process_of_the_logarithm_is_that_of_logarithms() {
    let mut p = case(60, 2, 0.05, 21);
    p.y.iter_mut().for_each(|y| *y = y.exp());
    let logs = Points { y: p.y.iter().map(|y| y.ln()).collect(), ..p.clone() };
    for exact_points in [3000, 40] {
        let plain = GaussianProcess { starts: 1, exact_points, ..Default::default() };
        let of_log = GaussianProcess { transform: OutputChoice::Log, ..plain.clone() };
        let a = of_log.learn(&p, &|| false).unwrap();
        let b = plain.learn(&logs, &|| false).unwrap();
        let (mut at, mut of) = (Prediction::new(2), Prediction::new(2));
        for x in case(20, 2, 0.0, 22).x.chunks_exact(2) {
            a.model.predict(x, Ask::Variance, &mut at);
            b.model.predict(x, Ask::Variance, &mut of);
            let y = of.mean.exp();
            assert!((at.mean / y - 1.0).abs() < 1e-12);
            assert!((at.variance - y * y * of.variance).abs() < 1e-9 * at.variance.max(1e-9));
            assert!((a.model.formulas()[0].value(x) / y - 1.0).abs() < 1e-9);
        }
        let shown = p.y[7] - a.left_out.residuals[7];
        assert!((shown.ln() - (logs.y[7] - b.left_out.residuals[7])).abs() < 1e-9);
        if let (ResponseModel::GaussianProcess(a), ResponseModel::GaussianProcess(b)) = (a.model, b.model) {
            let (x, r) = ([0.3, -0.2], [0.1, 0.4]);
            a.predict(&x, Ask::Mean, &mut at);
            a.predict(&r, Ask::Mean, &mut of);
            let expected = at.mean * of.mean * b.covariances(&x, &r)[0];
            assert!((a.covariances(&x, &r)[0] / expected - 1.0).abs() < 1e-9);
        }
    }
    p.y[3] = -1.0;
    let of_log = GaussianProcess { transform: OutputChoice::Log, ..Default::default() };
    assert!(matches!(of_log.learn(&p, &|| false), Err(ResponseError::Domain { .. })));
}
