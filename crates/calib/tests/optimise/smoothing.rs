//! Weights on increments by a share of the objective.

use dynocal_calib::optimise::model::OutputModel;
use dynocal_calib::optimise::{OptimiseOptions, Optimum, optimise_models};
use dynocal_calib::problem::CalibrationProblem;
use dynocal_ident::data::{Channel, Dataset, Role};
use dynocal_ident::model::poly::PolyNarx;

const N: usize = 60;

/// Two burners heat; the second is cheaper. Increments of `a` have a weight where one is given.
fn problem(weights: Option<[f64; 2]>) -> CalibrationProblem {
    let mut p: CalibrationProblem = toml::from_str(
        r#"
        inputs = [{ name = "a", unit = "kW", lower = 0.0, upper = 9.0 }, { name = "b", unit = "kW", lower = 0.0, upper = 5.0 }]
        demands = [{ output = "heat", unit = "kW", lower = 0.0, upper = 11.0 }]
        minimise = [{ channel = "a", weight = 2.0 }, { channel = "b", weight = 1.0 }]
        "#,
    )
    .unwrap();
    for (input, w) in p.inputs.iter_mut().zip(weights.into_iter().flatten()) {
        input.increment_weight = Some(w);
    }
    p
}

fn start() -> (Dataset, Vec<f64>) {
    let a: Vec<f64> = (0..N).map(|t| 4.0 + (0.7 * t as f64).sin()).collect();
    let channel =
        |name: &str, role, values: Vec<f64>| Channel { name: name.into(), unit: "kW".into(), role, values };
    let record = Dataset {
        name: "start".into(),
        sample_time_s: 1.0,
        channels: vec![
            channel("a", Role::Input, a.clone()),
            channel("b", Role::Input, vec![1.0; N]),
            channel("heat", Role::Output, vec![5.0; N]),
        ],
        init_samples: 0,
        origin: "test".into(),
    };
    (record, a)
}

fn solve(problem: &CalibrationProblem, smoothing: f64) -> Optimum {
    let heat = PolyNarx::parse(&["a", "b"], "heat", &["a(t-1)", "b(t-1)", "heat(t-1)"]).unwrap();
    let model = OutputModel::plain("heat", &heat, &[0.5, 0.5, 0.5], &["a", "b"]);
    let options = OptimiseOptions { smoothing, ..OptimiseOptions::default() };
    let found = optimise_models(problem, &[model], &start().0, &options, &|| false).unwrap();
    assert!(found.status.is_success());
    found
}

/// The weights are the share of the start's objective over the mean square increment of the start; an input that stands still
/// there counts as moving by a thousandth of its range; given weights stay.
#[test]
fn a_share_of_the_objective_is_these_weights() {
    let (_, a) = start();
    let square = a.windows(2).map(|w| (w[1] - w[0]).powi(2)).sum::<f64>() / (N - 1) as f64;
    // All samples but the first (one lag) and the last (nothing answers to it) are decided.
    let mean_a = a[1..N - 1].iter().sum::<f64>() / (N - 2) as f64;
    let share = 0.03;
    let objective = 2.0 * mean_a + 1.0;
    let weights = [share * objective / square, share * objective / (5e-3_f64).powi(2)];
    let difference = |p: &Optimum, q: &Optimum| {
        let pairs = p.inputs.iter().zip(&q.inputs).flat_map(|(x, y)| x.values.iter().zip(&y.values));
        pairs.fold(0.0_f64, |most, (x, y)| most.max((x - y).abs()))
    };
    let by_share = solve(&problem(None), share);
    assert!(difference(&by_share, &solve(&problem(Some(weights)), 0.0)) < 1e-6);
    assert!(difference(&by_share, &solve(&problem(None), 0.0)) > 0.1, "without weights it moves");
    let given = problem(Some([0.2, 0.3]));
    assert_eq!(difference(&solve(&given, share), &solve(&given, 0.0)), 0.0);
}
