//! Score page, nested choice, sequential points, varying noise, sparse processes.

use dynocal_ident::model::response::choose::{Candidate, choose};
use dynocal_ident::model::response::gp::{GaussianProcess, GpModel, Mean, NoiseChoice};
use dynocal_ident::model::response::points::range;
use dynocal_ident::model::response::score::{FoldKind, Unseen, by_folds, folds, score_page, sensitivity};
use dynocal_ident::model::response::sequential::{Aim, Limit, expected_improvement, next_points};
use dynocal_ident::model::response::{Ask, Learn, Points, Prediction, Response, ResponseModel, learner};
use dynocal_numerics::rng::Rng64;

fn points(
    n: usize,
    d: usize,
    seed: u64,
    low: f64,
    high: f64,
    mut f: impl FnMut(&[f64], &mut Rng64) -> f64,
) -> Points {
    let mut rng = Rng64::new(seed);
    let x: Vec<f64> = (0..n * d).map(|_| rng.uniform_in(low, high)).collect();
    let y = x.chunks_exact(d).map(|x| f(x, &mut rng)).collect();
    Points { inputs: (0..d).map(|j| format!("x{j}")).collect(), output: "y".into(), x, y }
}

fn process(keys: &GaussianProcess, points: &Points) -> GpModel {
    match keys.learn(points, &|| false).unwrap().model {
        ResponseModel::GaussianProcess(model) => model,
        other => panic!("{}", other.describe()),
    }
}

fn kind(name: &str) -> Box<dyn Learn> {
    learner(name, &toml::Table::new()).unwrap()
}

#[test]
fn folds_hold_every_point_once() {
    let of = |n: usize| points(n, 1, 1, 0.0, 1.0, |x, _| x[0]);
    for how in [FoldKind::Shuffled, FoldKind::Interleaved, FoldKind::Blocks] {
        let parts = folds(&of(23), 5, how);
        let mut all = parts.concat();
        all.sort_unstable();
        assert_eq!(all, (0..23).collect::<Vec<_>>());
        assert!(parts.iter().all(|p| p.len() >= 4));
    }
    assert_eq!(folds(&of(6), 3, FoldKind::Blocks), [[0, 1], [2, 3], [4, 5]]);
}

#[test]
fn repeated_points_and_the_lines_of_a_grid_are_not_told_from_each_other_by_folds() {
    // Five loads at each of ten speeds, in that order: every fifth point is one load.
    let x: Vec<f64> = (0..50).flat_map(|i| [f64::from(i % 5), f64::from(i / 5)]).collect();
    let y = x.chunks(2).map(|x| (0.6 * x[0]).sin() + 0.1 * x[1]).collect();
    let grid = Points { inputs: vec!["load".into(), "speed".into()], output: "y".into(), x, y };
    for held in folds(&grid, 5, FoldKind::Shuffled) {
        let mut loads: Vec<f64> = held.iter().map(|i| grid.row(*i)[0]).collect();
        loads.dedup();
        assert!(loads.len() > 1, "a whole load is held out: {held:?}");
    }
    // The function is smooth: what is held out inside the grid is predicted far better than its range of 1.8.
    let learner = kind("gaussian_process");
    let rmse = |how| by_folds(&*learner, &grid, 5, how, &|| false).unwrap().rmse;
    assert!(rmse(FoldKind::Shuffled) < 0.1 * rmse(FoldKind::Interleaved));
    // Two levels of each input, fifteen points at each corner: a corner is not held out as a whole.
    let corners = points(60, 2, 12, 0.0, 1.0, |x, rng| x[0].round() - x[1].round() + 0.1 * rng.normal());
    let corners = Points { x: corners.x.iter().map(|x| x.round()).collect(), ..corners };
    let found = by_folds(&*kind("rbf"), &corners, 5, FoldKind::Shuffled, &|| false).unwrap();
    assert!(found.rmse < 0.15, "{found:?}");
    // Copies of a point stay together.
    let twice = grid.rows(&(0..50).chain(0..50).collect::<Vec<_>>());
    for held in folds(&twice, 7, FoldKind::Shuffled) {
        assert!(held.iter().all(|i| held.contains(&((i + 50) % 100))), "{held:?}");
    }
}

#[test]
fn a_tree_does_not_follow_noise_alone() {
    let held = |seed: u64| {
        let p = points(60, 2, seed, 0.0, 1.0, |_, rng| rng.normal());
        let learnt = kind("local_linear").learn(&p, &|| false).unwrap();
        let apart = points(500, 2, 1000 + seed, 0.0, 1.0, |_, rng| rng.normal());
        Unseen::on(&learnt.model, &apart).rmse
    };
    // A plane through 60 points of pure noise has an error of sqrt(1 + 3 / 60) = 1.025 on others.
    let mean = (0..10).map(held).sum::<f64>() / 10.0;
    assert!(mean < 1.1, "{mean}");
}

#[test]
fn what_cannot_be_learnt_from_is_refused_in_words() {
    let plane = |x: &[f64], _: &mut Rng64| x[0] + 2.0 * x[1];
    let mut p = points(30, 2, 9, 0.0, 1.0, plane);
    let said = |kind: &dyn Learn, p: &Points| kind.learn(p, &|| false).unwrap_err().to_string();
    let process = kind("gaussian_process");
    for i in 0..30 {
        p.x[2 * i + 1] = 3.0 - 2.0 * p.x[2 * i];
    }
    p.y = p.x.chunks(2).map(|x| x[0].sin()).collect();
    let text = said(&*process, &p);
    assert!(text.contains("input `x1` follows from the other inputs (`x0`)"), "{text}");
    // Scales that squares cannot hold.
    for scale in [1e-300, 1e300] {
        let mut p = points(30, 2, 9, 0.0, 1.0, plane);
        p.y.iter_mut().for_each(|y| *y *= scale);
        for name in ["gaussian_process", "local_linear", "rbf", "stepwise_polynomial"] {
            let text = said(&*kind(name), &p);
            assert!(text.contains("`y` spreads by") && text.contains("another unit"), "{name}: {text}");
        }
    }
    let many = learner("gaussian_process", &toml::from_str("starts = 2147483648").unwrap()).unwrap();
    let text = said(&*many, &points(30, 2, 9, 0.0, 1.0, plane));
    assert_eq!(text, "gaussian_process: starts is 2147483648, expected 1 to 1000");
    // A switch that only one fold has: the fold is named.
    let mut p = points(30, 2, 9, 0.0, 1.0, plane);
    (0..30).for_each(|i| p.x[2 * i + 1] = f64::from(u8::from(i == 4)));
    let text = by_folds(&*kind("rbf"), &p, 5, FoldKind::Shuffled, &|| false).unwrap_err().to_string();
    assert!(text.starts_with("without fold ") && text.contains("input `x1` is 0 at all 24 points"), "{text}");
}

#[test]
fn sensitivities_are_those_of_a_function_with_known_indices() {
    // f = x0 + 2 x1 + x1 x2 over [-1, 1]^3: variances 1/3, 4/3, 0 and 1/9 of the product.
    let p = points(150, 3, 1, -1.0, 1.0, |x, _| x[0] + 2.0 * x[1] + x[1] * x[2]);
    let model = kind("stepwise_polynomial").learn(&p, &|| false).unwrap().model;
    let total = 1.0 / 3.0 + 4.0 / 3.0 + 1.0 / 9.0;
    let expected = [[1.0 / 3.0, 1.0 / 3.0], [4.0 / 3.0, 4.0 / 3.0 + 1.0 / 9.0], [0.0, 1.0 / 9.0]];
    for (found, expected) in sensitivity(&model, &p, 3).iter().zip(&expected) {
        // 2048 draws, and the box of the points is a little smaller than the cube.
        assert!((found.main - expected[0] / total).abs() < 0.07, "{found:?}");
        assert!((found.total - expected[1] / total).abs() < 0.05, "{found:?}");
    }
}

#[test]
fn a_score_page_agrees_with_unseen_points() {
    let f = |x: &[f64], rng: &mut Rng64| (2.0 * x[0]).sin() + x[1] * x[1] + 0.05 * rng.normal();
    let (p, unseen) = (points(80, 2, 2, -1.0, 1.0, f), points(400, 2, 3, -1.0, 1.0, f));
    let (model, page) =
        score_page(&*kind("gaussian_process"), &p, Some(&unseen), 5, FoldKind::Interleaved, &|| false)
            .unwrap();
    let apart = page.unseen.unwrap();
    assert_eq!(apart, Unseen::on(&model, &unseen));
    for score in [&page.left_out, page.folds.as_ref().unwrap(), &apart] {
        assert!((0.04..0.09).contains(&score.rmse), "{score:?}");
        assert!(score.coverage > 0.85 && (0.6..1.8).contains(&score.variance_ratio), "{score:?}");
    }
    assert!((page.press - 80.0 * page.left_out.rmse.powi(2)).abs() < 1e-9);
    assert_eq!((page.intersections.len(), page.intersections[0].x.len()), (2, 41));
}

#[test]
fn the_simplest_within_one_standard_error_is_chosen_and_said() {
    let p = points(60, 2, 4, -1.0, 1.0, |x, rng| 1.0 + x[0] - x[1] + 0.1 * rng.normal());
    let candidates = || {
        let linear = learner("stepwise_polynomial", &toml::from_str("degree = 1").unwrap()).unwrap();
        vec![
            Candidate { name: "plane".into(), kind: linear },
            Candidate { name: "cubic".into(), kind: kind("stepwise_polynomial") },
            Candidate { name: "radial".into(), kind: kind("rbf") },
        ]
    };
    let (_, choice) = choose(&candidates(), &p, 5, FoldKind::Interleaved, &|| false).unwrap();
    assert_eq!(choice.chosen, 0, "{choice:?}");
    assert!(choice.words.starts_with("`y`: plane is taken"), "{}", choice.words);
    // The error of the whole procedure is about the noise.
    assert!((0.07..0.15).contains(&choice.nested_rmse), "{choice:?}");
    let curved = points(60, 2, 5, -1.0, 1.0, |x, rng| (3.0 * x[0]).sin() * x[1] + 0.02 * rng.normal());
    let (_, choice) = choose(&candidates(), &curved, 5, FoldKind::Interleaved, &|| false).unwrap();
    assert_ne!(choice.chosen, 0, "{choice:?}");
}

#[test]
fn integrated_variance_is_what_a_measurement_takes_off() {
    for mean in [Mean::Zero, Mean::Linear] {
        let p = points(30, 2, 6, 0.0, 1.0, |x, rng| (3.0 * x[0]).sin() + x[1] + 0.05 * rng.normal());
        let model = process(&GaussianProcess { mean, starts: 2, ..Default::default() }, &p);
        let reference = points(60, 2, 7, 0.0, 1.0, |_, _| 0.0).x;
        let candidates = points(8, 2, 8, -0.1, 1.1, |_, _| 0.0).x;
        let integrated = |model: &GpModel| -> f64 {
            let mut at = Prediction::new(2);
            let one = |x: &[f64]| {
                model.predict(x, Ask::Variance, &mut at);
                at.variance
            };
            reference.chunks_exact(2).map(one).sum::<f64>() / 60.0
        };
        let before = integrated(&model);
        let chosen = next_points(&model, Aim::IntegratedVariance, &candidates, &reference, &[], 0.0, 1);
        let drops: Vec<f64> = candidates
            .chunks_exact(2)
            .map(|x| {
                let mut more = model.clone();
                more.add(x, 0.0).unwrap();
                before - integrated(&more)
            })
            .collect();
        let best = (0..8).max_by(|a, b| drops[*a].total_cmp(&drops[*b])).unwrap();
        assert_eq!(chosen[0].candidate, best);
        assert!(
            (chosen[0].value - drops[best]).abs() < 1e-8 * before.max(1.0),
            "{} {}",
            chosen[0].value,
            drops[best]
        );
    }
}

#[test]
fn expected_improvement_is_the_mean_over_draws_and_limits_leave_out_candidates() {
    let mut rng = Rng64::new(9);
    let n = 200_000;
    let drawn = (0..n).map(|_| (0.3 - (0.5 + 0.8 * rng.normal())).max(0.0)).sum::<f64>() / f64::from(n);
    assert!((expected_improvement(0.3, 0.5, 0.8) - drawn).abs() < 0.005);
    // Torque rises with x0; the limited output crosses its limit at x0 = 0.5.
    let goal = points(25, 1, 10, 0.0, 1.0, |x, _| -x[0]);
    let limited = points(25, 1, 11, 0.0, 1.0, |x, rng| 10.0 * x[0] + 0.1 * rng.normal());
    let keys = GaussianProcess { starts: 1, ..Default::default() };
    let (goal, limited) = (process(&keys, &goal), process(&keys, &limited));
    let candidates: Vec<f64> = (0..101).map(|i| f64::from(i) / 100.0).collect();
    let limits = [Limit { model: &limited, upper: 5.0 }];
    let chosen = next_points(&goal, Aim::Spread, &candidates, &[], &limits, 0.95, 4);
    assert_eq!(chosen.len(), 4);
    assert!(chosen.iter().all(|c| c.probability >= 0.95 && candidates[c.candidate] < 0.5), "{chosen:?}");
    // No candidate twice.
    let places: std::collections::BTreeSet<usize> = chosen.iter().map(|c| c.candidate).collect();
    assert_eq!(places.len(), 4);
}

#[test]
fn a_varying_noise_is_found_within_a_tenth() {
    // Motorcycle-like: calm, then violent, then calming; the standard deviation is known.
    let std = |x: f64| 0.05 + 0.5 / (1.0 + (-12.0 * (x - 0.35)).exp()) * (1.0 - 0.6 * x);
    let mean = |x: f64| if x < 0.3 { 0.0 } else { -1.5 * (9.0 * (x - 0.3)).sin() * (-3.0 * (x - 0.3)).exp() };
    let mut shares = Vec::new();
    for seed in 0..3 {
        let p = points(400, 1, 20 + seed, 0.0, 1.0, |x, rng| mean(x[0]) + std(x[0]) * rng.normal());
        let model =
            process(&GaussianProcess { noise: NoiseChoice::Varying, starts: 1, ..Default::default() }, &p);
        let mut at = Prediction::new(1);
        let squares: f64 = (0..200)
            .map(|i| {
                let x = (f64::from(i) + 0.5) / 200.0;
                model.predict(&[x], Ask::Variance, &mut at);
                (at.noise.sqrt() - std(x)).powi(2)
            })
            .sum();
        let (low, high) = range((0..200).map(|i| std(f64::from(i) / 199.0)));
        shares.push((squares / 200.0).sqrt() / (high - low));
        let stored = serde_json::to_string(&model).unwrap();
        assert_eq!(serde_json::from_str::<GpModel>(&stored).unwrap(), model);
    }
    println!("{shares:?}");
    // 400 points and a curve of some six degrees of freedom: sqrt(6 / 800) = 9 % of the local value.
    assert!(shares.iter().sum::<f64>() / 3.0 < 0.1, "{shares:?}");
}

#[test]
fn a_sparse_process_is_near_the_exact_one_and_a_refusal_names_the_memory() {
    let f = |x: &[f64], rng: &mut Rng64| (4.0 * x[0]).sin() + x[1] * x[0] + 0.1 * rng.normal();
    let (p, test) = (points(700, 2, 30, 0.0, 1.0, f), points(300, 2, 31, 0.0, 1.0, f));
    let exact = GaussianProcess { starts: 1, ..Default::default() };
    let sparse = GaussianProcess { exact_points: 600, inducing_points: 60, ..exact.clone() };
    let a = Unseen::on(&exact.learn(&p, &|| false).unwrap().model, &test);
    let learnt = sparse.learn(&p, &|| false).unwrap();
    assert!(matches!(learnt.model, ResponseModel::SparseGaussianProcess(_)));
    let b = Unseen::on(&learnt.model, &test);
    assert!(b.rmse < 1.02 * a.rmse, "{} {}", b.rmse, a.rmse);
    assert!((0.9..0.99).contains(&b.coverage), "{b:?}");
    assert!((learnt.left_out.rmse() / 0.1 - 1.0).abs() < 0.15, "{}", learnt.left_out.rmse());
    let refused = GaussianProcess { inducing_points: 0, ..sparse }.learn(&p, &|| false).unwrap_err();
    // Three upper triangles of 700 x 700 doubles, whole on the diagonal of tiles.
    assert!(refused.to_string().contains("700 points would take 7 MiB"), "{refused}");
}

/// 95 % bands of local linear models over seeds: the splits are found with the same points, and must not make them narrow.
#[test]
fn bands_of_local_linear_models_hold_their_share_of_new_points() {
    let f = |x: &[f64], rng: &mut Rng64| {
        (3.0 * x[0]).sin()
            + x[1] * x[1] * (1.0 + x[0])
            + 0.5 * (2.0 * x[2]).cos() * x[1]
            + 0.05 * rng.normal()
    };
    let kind = kind("local_linear");
    let seeds = 12;
    let mean =
        |of: &dyn Fn(&Unseen) -> f64, all: &[Unseen]| all.iter().map(of).sum::<f64>() / all.len() as f64;
    let all: Vec<Unseen> = (0..seeds)
        .map(|seed| {
            let (p, test) =
                (points(120, 3, 700 + seed, 0.0, 1.0, f), points(400, 3, 800 + seed, 0.0, 1.0, f));
            Unseen::on(&kind.learn(&p, &|| false).unwrap().model, &test)
        })
        .collect();
    let (coverage, ratio) = (mean(&|u| u.coverage, &all), mean(&|u| u.variance_ratio, &all));
    // The share of one seed has a standard deviation of 2.7 %: three standard errors.
    assert!((coverage - 0.95).abs() < 0.024, "{coverage}");
    assert!((0.8..1.25).contains(&ratio), "{ratio}");
}
