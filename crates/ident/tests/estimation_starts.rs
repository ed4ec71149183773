//! Starts that compete, and free runs that start at rest or from estimated outputs.

use dynocal_ident::estimate::pem::Pem;
use dynocal_ident::estimate::sem::Sem;
use dynocal_ident::estimate::train::Train;
use dynocal_ident::estimate::{EstimateError, Estimator};
use dynocal_ident::experiment::Experiment;
use dynocal_ident::model::initial::Initial;
use dynocal_ident::model::linear::LinearModel;
use dynocal_ident::model::poly::PolyNarx;
use dynocal_ident::model::{Model, Run};
use dynocal_numerics::rng::Rng64;

const TRUTH: [f64; 4] = [1.0, 0.6, 0.2, -0.05];

fn model() -> PolyNarx {
    PolyNarx::parse(&["u"], "y", &["u(t-1)", "y(t-1)", "u(t-1)*y(t-1)", "y(t-1)^3"]).unwrap()
}

/// A record from rest; `noise` on the output.
fn record(n: usize, noise: f64, seed: u64) -> Experiment {
    let mut rng = Rng64::stream(31, seed);
    let u: Vec<f64> = (0..n).map(|_| rng.uniform_in(-1.0, 1.0)).collect();
    let (zero, mut y) = (vec![0.0; n], vec![0.0; n]);
    model().simulate(&TRUTH, &Run { u: &u, y: &zero, start: 1 }, &mut y);
    y.iter_mut().for_each(|v| *v += noise * rng.normal());
    Experiment { name: "rest".into(), u, y, init_samples: 0, weights: vec![] }
}

/// A start from elsewhere (a part of the records) may be useless on all of them: then the estimator's own one wins, and the fit
/// is that without it. In place of the own start it would be refused, or lead astray.
#[test]
fn a_useless_start_loses_against_the_own_one() {
    let (model, data) = (model(), [record(600, 0.05, 1)]);
    let cold = Sem::default().estimate(&model, &data, None, &|| false).unwrap();
    let diverging = [1.0, 1.8, 0.2, 0.3];
    assert!(matches!(
        Sem::default().estimate(&model, &data, Some(&diverging), &|| false),
        Err(EstimateError::Unstable { .. })
    ));
    let competing =
        Sem::default().estimate_selecting(&model, &data, &[], Some(&diverging), &|| false).unwrap();
    assert_eq!(competing.theta, cold.theta);
    // A good one is taken: its search is at its end at once, beside the own one.
    let warm = Sem::default().estimate_selecting(&model, &data, &[], Some(&cold.theta), &|| false).unwrap();
    assert!(warm.evaluations < 2 * cold.evaluations && warm.mse <= cold.mse * (1.0 + 1e-9));
    let train = Train { starts: 1, selection: 0.0, ..Train::default() };
    let trained = train.estimate_selecting(&model, &data, &[], Some(&diverging), &|| false).unwrap();
    assert!(trained.mse <= cold.mse * (1.0 + 1e-6), "{} {}", trained.mse, cold.mse);
    // Prediction errors: an unstable F as a start.
    let oe = LinearModel::oe(&["u"], "y", 1, 1, 1);
    let cold = Pem::default().estimate(&oe, &data, None, &|| false).unwrap();
    let found =
        Estimator::estimate_selecting(&Pem::default(), &oe, &data, &[], Some(&[50.0, -1.4]), &|| false)
            .unwrap();
    assert!(found.mse <= cold.mse * (1.0 + 1e-9));
}

/// Ends compete, not starts: with a start beside its own one an estimator is never worse than from either alone. Two modes
/// seen by a model of one, so that the errors have several minima.
#[test]
fn the_better_end_counts_whatever_start_it_came_from() {
    let model = PolyNarx::parse(&["u"], "y", &["u(t-1)", "u(t-2)", "y(t-1)", "y(t-2)"]).unwrap();
    let oe = LinearModel::oe(&["u"], "y", 2, 2, 1);
    for seed in 0..12 {
        let mut rng = Rng64::stream(33, seed);
        let n = 400;
        let u: Vec<f64> = (0..n).map(|_| rng.uniform_in(-1.0, 1.0)).collect();
        let (mut fast, mut slow, mut y) = (vec![0.0; n], vec![0.0; n], vec![0.0; n]);
        for t in 2..n {
            fast[t] = 1.2 * fast[t - 1] - 0.8 * fast[t - 2] + u[t - 1];
            slow[t] = 0.98 * slow[t - 1] + 0.2 * u[t - 1];
            y[t] = fast[t] + slow[t] + 0.3 * rng.normal();
        }
        let data = [Experiment { name: "two".into(), u, y, init_samples: 0, weights: vec![] }];
        let sem = Sem::default();
        let cold = sem.estimate(&model, &data, None, &|| false).unwrap();
        for theta in [[0.2, 0.0, 0.9, 0.0], [1.0, 0.0, 1.0, -0.7], [0.5, 0.3, 0.5, 0.3]] {
            let own = sem.estimate(&model, &data, Some(&theta), &|| false).unwrap();
            let found = sem.estimate_selecting(&model, &data, &[], Some(&theta), &|| false).unwrap();
            let best = cold.mse.min(own.mse);
            assert!(found.mse <= best * (1.0 + 1e-9), "{seed}: {} of {best}", found.mse);
            // The same for prediction errors: B, then F.
            let theta = [theta[0], theta[1], -theta[2], -theta[3]];
            let pem = Pem::default();
            let cold = pem.estimate(&oe, &data, None, &|| false).unwrap();
            let own = pem.estimate(&oe, &data, Some(&theta), &|| false).unwrap();
            let found =
                Estimator::estimate_selecting(&pem, &oe, &data, &[], Some(&theta), &|| false).unwrap();
            let best = cold.mse.min(own.mse);
            assert!(found.mse <= best * (1.0 + 1e-6), "{seed}: {} of {best}", found.mse);
        }
    }
}

/// Short records that begin at rest, with noise on every sample and a slow pole: the noise of a measured start is carried
/// through the whole record and pulls the pole towards zero; at rest, or with the start estimated, nothing does.
#[test]
fn rest_and_estimated_starts_are_nearer_to_the_truth() {
    let model = PolyNarx::parse(&["u"], "y", &["u(t-1)", "y(t-1)"]).unwrap();
    let truth = [1.0, 0.9];
    let short = |seed: u64| {
        let mut rng = Rng64::stream(32, seed);
        let u: Vec<f64> = (0..10).map(|_| rng.uniform_in(-1.0, 1.0)).collect();
        let (zero, mut y) = ([0.0; 10], vec![0.0; 10]);
        model.simulate(&truth, &Run { u: &u, y: &zero, start: 1 }, &mut y);
        y.iter_mut().for_each(|v| *v += rng.normal());
        Experiment { name: "short".into(), u, y, init_samples: 0, weights: vec![] }
    };
    let mut distance = [0.0; 3];
    for draw in 0..30 {
        let data: Vec<Experiment> = (0..40).map(|k| short(40 * draw + k)).collect();
        for (d, initial) in distance.iter_mut().zip([Initial::Measured, Initial::Rest, Initial::Estimated]) {
            let fit = Sem { initial, ..Sem::default() }.estimate(&model, &data, None, &|| false).unwrap();
            *d += (fit.theta[1] - truth[1]).powi(2) / 30.0;
        }
    }
    let [measured, rest, estimated] = distance.map(f64::sqrt);
    println!("error of the pole: measured {measured:.3}, rest {rest:.3}, estimated {estimated:.3}");
    assert!(rest < 0.5 * measured && estimated < measured, "{measured} {rest} {estimated}");
}

#[test]
fn a_start_that_cannot_be_is_refused() {
    let data = [record(100, 0.05, 2)];
    let constant = PolyNarx::parse(&["u"], "y", &["1", "u(t-1)", "y(t-1)"]).unwrap();
    let fault =
        |e: &dyn Estimator, m: &PolyNarx| e.estimate(m, &data, None, &|| false).unwrap_err().to_string();
    let rest = Sem { initial: Initial::Rest, ..Sem::default() };
    assert!(
        fault(&rest, &constant)
            .contains("initial = \"rest\" does not go with a model that is not at rest at zero")
    );
    let train = Train { initial: Initial::Estimated, ..Train::default() };
    assert!(fault(&train, &model()).contains("initial = \"estimated\" does not go with"));
    let ridge = Sem { initial: Initial::Estimated, ridge: 1e-6, ..Sem::default() };
    assert!(fault(&ridge, &model()).contains("ridge"));
}
