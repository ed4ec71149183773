//! Training: divisions, stages, starts, studies of sizes, ensembles, each on records whose right answer is known.

use dynocal_ident::estimate::EstimateError;
use dynocal_ident::estimate::estimator;
use dynocal_ident::estimate::train::{Division, Start, Train, bagged, best, layer_sizes, mean_free_run};
use dynocal_ident::experiment::Experiment;
use dynocal_ident::model::Model;
use dynocal_ident::model::fitted::Fitted;
use dynocal_ident::model::form::{AnyForm, Form};
use dynocal_ident::model::initial::{Initial, free_run};
use dynocal_ident::model::neural::{Activation, Layout, MeanOfNetworks, NeuralNarx};
use dynocal_ident::model::poly::PolyNarx;
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

/// A fit of the mean by the keys of a spec, with the training that gives its members.
fn mean_by_keys(keys: &str, net: &NeuralNarx, data: &[Experiment]) -> Result<Fitted, EstimateError> {
    let keys: toml::Table = keys.parse().unwrap();
    let fit = estimator("train", &keys).unwrap().estimate(net, data, None, &|| false)?;
    let form = fit.learnt.map_or_else(|| AnyForm::from(net.clone()), |l| l.form);
    Ok(Fitted::new(form, fit.theta)?)
}

/// One step, k steps and free run from every start: what the members give, averaged; the same after the way through a file.
#[test]
fn the_mean_computes_what_its_members_compute_averaged() {
    let data = [record(400, NOISE, 21)];
    let net = network(&[3], false, Activation::Tanh, &data);
    let keys = "starts = 5\nmean = 3\nmax_evaluations = 20";
    let fitted = mean_by_keys(keys, &net, &data).unwrap();
    let train = Train { starts: 5, max_evaluations: 20, ..Train::default() };
    let found = train.train(&net, &data, &[], None, &|| false).unwrap();
    let members = best(&found, 3);
    assert_eq!(fitted.theta(), members.concat());
    let unseen = record(300, NOISE, 22);
    let averaged = |of: &dyn Fn(&[f64]) -> Vec<f64>| -> Vec<f64> {
        let each: Vec<Vec<f64>> = members.iter().map(|m| of(m)).collect();
        (0..unseen.len()).map(|t| each.iter().map(|y| y[t]).sum::<f64>() / 3.0).collect()
    };
    let close = |a: &[f64], b: &[f64], what: &str| {
        assert!(a.iter().zip(b).all(|(a, b)| (a - b).abs() < 1e-14), "{what}");
    };
    let text = serde_json::to_string(fitted.any()).unwrap();
    let again =
        Fitted::new(serde_json::from_str::<AnyForm>(&text).unwrap(), fitted.theta().to_vec()).unwrap();
    for model in [fitted, again] {
        for kind in [Kind::OneStep, Kind::KStep(4), Kind::FreeRun] {
            let y = model.output(&unseen, kind).unwrap();
            close(&y, &averaged(&|m| output(&net, m, &unseen, kind)), &format!("{kind:?}"));
        }
        // From rest and from estimated outputs every member starts at its own.
        for rule in [Initial::Rest, Initial::Estimated] {
            let y = model.clone().starting(rule).output(&unseen, Kind::FreeRun).unwrap();
            close(&y, &averaged(&|m| free_run(&net, m, &unseen, 1, rule).y), rule.key());
        }
    }
    // The best alone is what it was without the key.
    let alone = mean_by_keys("starts = 5\nmax_evaluations = 20", &net, &data).unwrap();
    assert!(alone.form().is_a::<NeuralNarx>().is_some());
    assert_eq!(alone.theta(), found.fit.theta);
}

/// Trained on little and noisy data the mean is no worse than its median member over the seeds together, on records without
/// noise; on each of them no worse than its members' mean square (which is Jensen's inequality). A single mean can lose to the
/// median: one bad member of five weighs a fifth.
#[test]
fn the_mean_is_no_worse_than_its_median_member() {
    let (mut means, mut medians) = (0.0, 0.0);
    for seed in 0..12 {
        let data = [record(160, 0.2, 100 + seed)];
        let unseen = record(600, 0.0, 200 + seed);
        let net = network(&[6], false, Activation::Tanh, &data);
        let keys = format!("starts = 7\nmean = 5\nmax_evaluations = 40\nseed = {seed}");
        let fitted = mean_by_keys(&keys, &net, &data).unwrap();
        let form: &MeanOfNetworks = fitted.form().is_a().unwrap();
        let score = |y: &[f64]| mse(&unseen.y, y);
        let mut each: Vec<f64> =
            form.each(fitted.theta()).map(|m| score(&output(&net, m, &unseen, Kind::FreeRun))).collect();
        assert_eq!(each.len(), 5);
        each.sort_by(f64::total_cmp);
        let mean = score(&fitted.output(&unseen, Kind::FreeRun).unwrap());
        assert!(mean <= each.iter().sum::<f64>() / 5.0, "seed {seed}: mean {mean}, members {each:?}");
        means += mean;
        medians += each[2];
    }
    println!("mean square over 12 seeds: means {:.5}, median members {:.5}", means / 12.0, medians / 12.0);
    assert!(means <= medians, "means {means}, median members {medians}");
}

#[test]
fn a_mean_that_cannot_be_made_is_refused_by_its_key() {
    let data = [record(200, NOISE, 31)];
    let net = network(&[2], false, Activation::Tanh, &data);
    let polynomial = PolyNarx::parse(&["u"], "y", &["u(t-1)", "y(t-1)"]).unwrap();
    let refused = |keys: &str, model: &dyn Form| {
        let keys: toml::Table = keys.parse().unwrap();
        estimator("train", &keys).unwrap().estimate(model, &data, None, &|| false).unwrap_err().to_string()
    };
    assert_eq!(refused("mean = 0", &net), "train: found mean = 0, expected 1 (the best start alone) or more");
    assert_eq!(
        refused("starts = 4\nmean = 5", &net),
        "train: found mean = 5, expected at most the number of starts, 4"
    );
    assert_eq!(
        refused("mean = 3", &polynomial),
        "train: found mean = 3, expected 1: the mean of several is for networks, not for the form polynomial"
    );
    assert_eq!(refused("starts = 500\nmean = 500", &net), "train: found mean = 500, expected at most 64");
}

/// A fit of a mean says what it is worth beside its members; a warm start and cross-validation go through it.
#[test]
fn the_mean_says_how_far_its_members_lie_apart() {
    let data = [record(300, NOISE, 41)];
    let net = network(&[3], false, Activation::Tanh, &data);
    let keys: toml::Table = "starts = 4\nmean = 2\nmax_evaluations = 15".parse().unwrap();
    let train = estimator("train", &keys).unwrap();
    let first = train.estimate(&net, &data, None, &|| false).unwrap();
    assert!(first.notes.iter().any(|n| n.contains("mean of the 2 best networks")), "{:?}", first.notes);
    let warm = train.estimate_selecting(&net, &data, &[], Some(&first.theta), &|| false).unwrap();
    assert_eq!(warm.starts.len(), 5);
    let blocks = dynocal_ident::validate::cross::Blocks { folds: 3, ..Default::default() };
    let folds =
        dynocal_ident::validate::cross::cross_validate(&net, &data, train.as_ref(), &blocks, &|| false)
            .unwrap();
    assert!(folds.failed.is_empty() && folds.parameters.is_empty(), "{:?}", folds.failed);
}
