//! Exact Gaussian processes against scikit-learn's numbers, differences, refits and invariances.

#[path = "common/response.rs"]
mod common;

use dynocal_ident::model::response::gp::likelihood::{Problem, Work};
use dynocal_ident::model::response::gp::{
    GaussianProcess, GpModel, Kernel, KernelChoice, Mean, OutputChoice,
};
use dynocal_ident::model::response::warp::{Warp, WarpChoice};
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

/// Engine-like inputs: two sizes and an angle that goes to zero.
fn sizes(n: usize, seed: u64) -> Points {
    let mut rng = Rng64::new(seed);
    let x: Vec<f64> = (0..n)
        .flat_map(|_| [rng.uniform_in(5.0, 90.0), rng.uniform_in(800.0, 5000.0), rng.uniform_in(0.0, 35.0)])
        .collect();
    let f = |x: &[f64]| {
        (20.0 + x[0]).ln() + (1000.0 / x[1]).powi(2) * (1.0 + (x[2] / 30.0).powi(2)) + 40.0 / x[0]
    };
    let y = x.chunks_exact(3).map(f).collect();
    Points { inputs: ["load", "speed", "spark"].map(String::from).to_vec(), output: "y".into(), x, y }
}

#[test]
fn derivatives_of_a_warp_are_those_of_differences_on_both_sides_of_zero() {
    let p = sizes(40, 30);
    for choice in [WarpChoice::Sqrt, WarpChoice::Asinh] {
        let warp = Warp::of(choice, &p);
        // An angle that goes to zero is no size.
        assert_eq!(warp.scales[2] == 0.0, choice == WarpChoice::Sqrt);
        for x in [-30.0, -1.0, 0.0, 0.5, 2.0, 60.0] {
            let h = 1e-4;
            let [up, at, down] = [x + h, x, x - h].map(|x| warp.at(0, x));
            assert!(up[0] > at[0] && at[1] > 0.0, "{choice:?} {x}");
            assert!(((up[0] - down[0]) / (2.0 * h) / at[1] - 1.0).abs() < 1e-6, "{choice:?} {x}");
            assert!(((up[1] - down[1]) / (2.0 * h) - at[2]).abs() < 1e-6 * at[1].max(1.0), "{choice:?} {x}");
        }
    }
    let low = p.column(0).fold(f64::INFINITY, f64::min);
    let warp = Warp::of(WarpChoice::Sqrt, &p);
    assert!((warp.at(0, low)[0] / low.sqrt() - 1.0).abs() < 0.006);
}

/// A process over warped inputs is the process over inputs that were warped before, with the derivatives of its own inputs; exact and sparse,
/// stored and read, and as a formula. It keeps what it says below all points a number.
#[test]
fn a_process_over_warped_inputs_is_that_over_inputs_that_were_warped() {
    let p = sizes(70, 31);
    for (warp, exact_points) in [(WarpChoice::Sqrt, 3000), (WarpChoice::Asinh, 3000), (WarpChoice::Sqrt, 40)]
    {
        let keys = GaussianProcess { warp, starts: 1, exact_points, ..Default::default() };
        let before = Warp::of(warp, &p);
        let warped = |x: &[f64]| x.iter().enumerate().map(|(j, x)| before.at(j, *x)[0]).collect::<Vec<_>>();
        let beside = Points { x: p.x.chunks_exact(3).flat_map(warped).collect(), ..p.clone() };
        let a = keys.learn(&p, &|| false).unwrap();
        let b = GaussianProcess { warp: WarpChoice::None, ..keys }.learn(&beside, &|| false).unwrap();
        let read: ResponseModel = serde_json::from_str(&serde_json::to_string(&a.model).unwrap()).unwrap();
        let (mut at, mut of, mut again) = (Prediction::new(3), Prediction::new(3), Prediction::new(3));
        for x in sizes(20, 32).x.chunks_exact(3).chain([[-5.0, 100.0, -3.0].as_slice()]) {
            a.model.predict(x, Ask::Variance, &mut at);
            b.model.predict(&warped(x), Ask::Variance, &mut of);
            read.predict(x, Ask::Variance, &mut again);
            assert!((at.mean - of.mean).abs() < 1e-9 && (at.variance - of.variance).abs() < 1e-9);
            assert!((at.mean - again.mean).abs() < 1e-9 && (at.variance - again.variance).abs() < 1e-9);
            assert!((a.model.formulas()[0].value(x) - at.mean).abs() < 1e-7 * (1.0 + at.mean.abs()));
        }
        assert_eq!(a.left_out.residuals.len(), 70);
        if let ResponseModel::GaussianProcess(a) = &a.model {
            let moderate = Points {
                x: p.x.iter().enumerate().map(|(at, x)| x / [50.0, 2500.0, 20.0][at % 3]).collect(),
                ..p.clone()
            };
            let (_, model) = learn(&GaussianProcess { warp, starts: 1, ..Default::default() }, &moderate);
            common::check_response(&model, &[0.7, 0.9, 0.6], 2e-5, 1e-4, 2e-5, 0.0);
            assert!(a.describe().contains("of the inputs"), "{}", a.describe());
        }
    }
}

/// With the logarithm of the output, and sparse: derivatives, covariances to first order, a point that is added, and a file that is read.
#[test]
fn warps_stand_beside_all_else_that_a_process_has() {
    let small = |n: usize, seed: u64| {
        let p = sizes(n, seed);
        let x = p.x.iter().enumerate().map(|(at, x)| x / [50.0, 2500.0, 20.0][at % 3]).collect();
        let mut rng = Rng64::new(seed);
        Points { x, y: p.y.iter().map(|y| (0.1 * y + 0.02 * rng.normal()).exp()).collect(), ..p }
    };
    let p = small(70, 35);
    for warp in [WarpChoice::Sqrt, WarpChoice::Asinh] {
        let keys = GaussianProcess { warp, transform: OutputChoice::Log, starts: 1, ..Default::default() };
        let (_, mut model) = learn(&keys, &p);
        common::check_response(&model, &[0.7, 0.9, 0.6], 2e-5, 1e-4, 2e-5, 0.0);
        let sparse = GaussianProcess { exact_points: 40, inducing_points: 20, ..keys.clone() }
            .learn(&p, &|| false)
            .unwrap();
        assert!(matches!(sparse.model, ResponseModel::SparseGaussianProcess(_)));
        common::check_response(&sparse.model, &[0.7, 0.9, 0.6], 2e-5, 1e-4, 2e-5, 0.0);
        // The covariance of a place with itself is its variance.
        let (x, mut at) = ([0.7, 0.9, 0.6], Prediction::new(3));
        model.predict(&x, Ask::Variance, &mut at);
        assert!((model.covariances(&x, &x)[0] / at.variance - 1.0).abs() < 1e-6);
        let more = small(3, 36);
        (0..3).for_each(|i| model.add(more.row(i), more.y[i]).unwrap());
        let text = serde_json::to_string(&model).unwrap();
        let read: GpModel = serde_json::from_str(&text).unwrap();
        let mut again = Prediction::new(3);
        model.predict(&x, Ask::Variance, &mut at);
        read.predict(&x, Ask::Variance, &mut again);
        assert!((at.mean / again.mean - 1.0).abs() < 1e-7 && (at.variance - again.variance).abs() < 1e-7);
        // A length is what it would be over inputs that are not warped, where the warp is at its mean.
        assert!(model.lengths().iter().all(|l| *l > 0.0 && l.is_finite()));
        let wrong = text.replacen("\"scales\":[", "\"scales\":[-1.0,", 1);
        let error = serde_json::from_str::<GpModel>(&wrong).unwrap_err().to_string();
        assert!(error.contains("scales of a warp"), "{error}");
        let long = text.replacen("\"scales\":[", "\"scales\":[1.0,", 1);
        assert!(serde_json::from_str::<GpModel>(&long).is_err());
    }
    // Nothing to warp: the process without one.
    let mut around = case(40, 2, 0.05, 37);
    around.x.iter_mut().for_each(|x| *x -= 0.5);
    let of = |warp| learn(&GaussianProcess { warp, starts: 1, ..Default::default() }, &around).1;
    assert_eq!(of(WarpChoice::Sqrt), of(WarpChoice::None));
}

/// Where a response changes faster at small inputs, a warp tells points that it has not seen better, in the mean of some seeds.
#[test]
fn a_warp_pays_where_small_inputs_matter_more() {
    let error = |warp: WarpChoice, seed: u64| {
        let (_, model) = learn(&GaussianProcess { warp, ..Default::default() }, &sizes(60, seed));
        let (unseen, mut at) = (sizes(200, seed + 100), Prediction::new(3));
        let each = (0..200).map(|i| {
            model.predict(unseen.row(i), Ask::Mean, &mut at);
            (at.mean - unseen.y[i]).powi(2)
        });
        (each.sum::<f64>() / 200.0).sqrt()
    };
    let mean = |warp: WarpChoice| ((40..46).map(|seed| error(warp, seed).ln()).sum::<f64>() / 6.0).exp();
    let [plain, sqrt, asinh] = [WarpChoice::None, WarpChoice::Sqrt, WarpChoice::Asinh].map(mean);
    println!("root mean square errors: {plain:.5}, {sqrt:.5}, {asinh:.5}");
    assert!(sqrt < plain && asinh < plain, "{plain} {sqrt} {asinh}");
}
