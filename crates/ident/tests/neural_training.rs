//! Training: divisions, stages, starts, studies of sizes, ensembles, each on records whose right answer is known.

use dynocal_ident::estimate::EstimateError;
use dynocal_ident::estimate::train::{Division, Start, Train, bagged, best, layer_sizes, mean_free_run};
use dynocal_ident::experiment::Experiment;
use dynocal_ident::model::Model;
use dynocal_ident::model::neural::{Activation, Layout, NeuralNarx};
use dynocal_ident::validate::{Kind, output};
use dynocal_numerics::rng::Rng64;

const NOISE: f64 = 0.05;

/// y(t) = 0.6 y(t-1) + tanh(2 u(t-1)) with white noise on the output, levels held for eight samples.
fn record(n: usize, noise: f64, seed: u64) -> Experiment {
    let mut rng = Rng64::new(seed);
    let (mut u, mut x) = (vec![0.0; n], vec![0.0; n]);
    for t in 1..n {
        u[t] = if t % 8 == 0 { rng.uniform_in(-1.0, 1.0) } else { u[t - 1] };
        x[t] = 0.6 * x[t - 1] + (2.0 * u[t - 1]).tanh();
    }
    let y = x.iter().map(|v| v + noise * rng.normal()).collect();
    Experiment { name: "record".into(), u, y, init_samples: 0, weights: Vec::new() }
}

fn network(hidden: &[usize], direct: bool, activation: Activation, data: &[Experiment]) -> NeuralNarx {
    let layout =
        Layout { hidden: hidden.to_vec(), activation, direct, input_lags: vec![[1, 1]], output_lags: 1 };
    NeuralNarx::with_layout(&["u"], "y", layout).unwrap().scaled_to(data).unwrap()
}

fn mse(a: &[f64], b: &[f64]) -> f64 {
    a.iter().zip(b).map(|(a, b)| (a - b).powi(2)).sum::<f64>() / a.len() as f64
}

/// 70/15/15 in each arrangement: the fit holds 70 % of the samples, and the errors on the others are the noise alone.
#[test]
fn samples_that_are_not_fitted_show_the_noise_alone() {
    let data = [record(2001, NOISE, 1)];
    let net = network(&[4], false, Activation::Tanh, &data);
    for division in [Division::End, Division::Blocks, Division::Random] {
        let options = Train { starts: 3, division, test: 0.15, ..Train::default() };
        let found = options.train(&net, &data, &[], None, &|| false).unwrap();
        assert_eq!(found.fit.samples, 1400, "{division:?}");
        // Mean of 300 squares: standard error 8 % of the variance; four of them, and the choice of the best.
        for score in [found.scores[found.best], found.test_scores[found.best]] {
            let ratio = score / NOISE.powi(2);
            assert!((0.6..1.4).contains(&ratio), "{division:?}: {ratio}");
        }
    }
}

/// On a linear system the direct path alone is the whole truth, from the first point of the search on.
#[test]
fn a_linear_start_is_exact_on_a_linear_system() {
    let mut e = record(400, 0.0, 2);
    e.y[0] = 0.3;
    for t in 1..e.len() {
        e.y[t] = 0.8 * e.y[t - 1] - 0.5 * e.u[t - 1] + 0.1;
    }
    let data = [e];
    let net = network(&[5], true, Activation::Tanh, &data);
    let options = Train { starts: 2, start: Start::Linear, ..Train::default() };
    let found = options.train(&net, &data, &[], None, &|| false).unwrap();
    let spread = mse(&data[0].y, &vec![0.0; 400]);
    assert!(found.scores.iter().all(|s| *s < 1e-16 * spread), "{:?} of {spread}", found.scores);
    let without = network(&[5], false, Activation::Tanh, &data);
    let error = options.train(&without, &data, &[], None, &|| false).unwrap_err();
    assert!(matches!(error, EstimateError::NoLinearPath { .. }), "{error}");
}

/// A start whose free run overflows: no whole run to begin with, but subrecords of growing length lead to one.
#[test]
fn stages_survive_a_start_that_diverges() {
    let data = [record(3000, 0.0, 3)];
    let net = network(&[6], true, Activation::Softplus, &data);
    let mut start = net.random_start(&mut Rng64::new(5));
    // The last parameter is the direct path from y(t-1).
    *start.last_mut().unwrap() = 1.5;
    let whole = Train { starts: 1, ..Train::default() };
    let error = whole.train(&net, &data, &[], Some(&start), &|| false).unwrap_err();
    assert!(matches!(error, EstimateError::Unstable { .. }), "{error}");
    let stages = Train { horizons: vec![1, 20], ..whole };
    let found = stages.train(&net, &data, &[], Some(&start), &|| false).unwrap();
    let spread = mse(&data[0].y, &vec![0.0; 3000]);
    assert!(found.scores[0] < 1e-3 * spread, "{} of {spread}", found.scores[0]);
}

/// Each start gives the same bytes alone and among others.
#[test]
fn starts_do_not_see_each_other() {
    let data = [record(300, NOISE, 4)];
    let net = network(&[3, 2], false, Activation::Sigmoid, &data);
    let options = Train { starts: 3, start: Start::OneStep, max_evaluations: 20, ..Train::default() };
    let all = options.train(&net, &data, &[], None, &|| false).unwrap();
    let again = options.train(&net, &data, &[], None, &|| false).unwrap();
    assert_eq!((&all.thetas, &all.scores), (&again.thetas, &again.scores));
    for i in 0..3 {
        let start = net.random_start(&mut Rng64::stream(options.seed, i as u64));
        let alone = Train { starts: 1, ..options.clone() };
        let alone = alone.train(&net, &data, &[], Some(&start), &|| false).unwrap();
        assert_eq!((&alone.thetas[0], alone.scores[0]), (&all.thetas[i], all.scores[i]), "start {i}");
    }
}

/// The square of a mean is at most the mean of the squares.
#[test]
fn the_mean_of_free_runs_is_no_worse_than_its_members_on_average() {
    let data = [record(500, NOISE, 6)];
    let unseen = record(500, 0.0, 7);
    let net = network(&[5], false, Activation::Tanh, &data);
    let options = Train { starts: 4, max_evaluations: 30, ..Train::default() };
    let found = options.train(&net, &data, &[], None, &|| false).unwrap();
    let members = best(&found, 3);
    assert_eq!((members.len(), members[0]), (3, found.thetas[found.best].as_slice()));
    let single: Vec<f64> =
        members.iter().map(|m| mse(&unseen.y, &output(&net, m, &unseen, Kind::FreeRun))).collect();
    let together = mse(&unseen.y, &mean_free_run(&net, &members, &unseen));
    assert!(together <= single.iter().sum::<f64>() / 3.0, "{together} of {single:?}");
    assert_eq!(mean_free_run(&net, &members[..1], &unseen), output(&net, members[0], &unseen, Kind::FreeRun));
    // Each bag is the training with its own seed.
    let bags = bagged(&options, 2, &net, &data, &|| false).unwrap();
    let second = Train { seed: 1, ..options }.train(&net, &data, &[], None, &|| false).unwrap();
    assert_eq!(bags, [found.fit.theta, second.fit.theta]);
}

/// Two neurons cannot hold what six can: the study shows it on all three kinds of samples.
#[test]
fn the_study_of_sizes_tells_a_small_network_from_a_sufficient_one() {
    let mut e = record(1200, 0.0, 8);
    for t in 1..e.len() {
        e.y[t] = 0.5 * e.y[t - 1] + (6.0 * e.u[t - 1]).sin();
    }
    let data = [e];
    let build = |hidden: &[usize]| -> Result<Box<dyn Model>, EstimateError> {
        Ok(Box::new(network(hidden, false, Activation::Tanh, &data)))
    };
    let options =
        Train { starts: 2, division: Division::Random, test: 0.15, max_evaluations: 60, ..Train::default() };
    let sizes = [vec![2], vec![6]];
    let rows = layer_sizes(&options, &sizes, 2, &build, &data, &|| false).unwrap();
    assert_eq!((rows[0].params, rows[1].params, rows[0].trainings), (9, 25, 2));
    for (small, large) in
        [(rows[0].fit, rows[1].fit), (rows[0].selection, rows[1].selection), (rows[0].test, rows[1].test)]
    {
        assert!(large < 0.2 * small, "{large} of {small}");
    }
}
