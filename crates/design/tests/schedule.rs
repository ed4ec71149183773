//! Margins keep their promise under structural mismatch: a linear model of a curved system.

use dynocal_design::schedule::{Basis, Schedule, block_scores, margin};
use dynocal_ident::estimate;
use dynocal_ident::experiment::Experiment;
use dynocal_ident::model::poly::PolyNarx;
use dynocal_ident::validate::boundary::{BoundaryKeys, Space, learn};
use dynocal_numerics::rng::Rng64;

const BLOCK: usize = 25;

/// y(t) = 0.7 y(t-1) + u(t-1) + 0.5 u(t-1)^2 - 0.2 u(t-1)^3 with white noise, levels of 5 samples within +- size.
fn record(seed: u64, n: usize, size: f64) -> Experiment {
    let mut g = Rng64::new(seed);
    let (mut u, mut x, mut y) = (vec![0.0; n], vec![0.0; n], vec![0.0; n]);
    for t in 0..n {
        u[t] = if t % 5 == 0 { g.uniform_in(-size, size) } else { u[t - 1] };
        if t > 0 {
            let v: f64 = u[t - 1];
            x[t] = 0.7 * x[t - 1] + v + 0.5 * v * v - 0.2 * v * v * v;
        }
        y[t] = x[t] + 0.05 * g.normal();
    }
    Experiment { name: format!("record {seed}"), u, y, init_samples: 1, weights: vec![] }
}

fn structure(regressors: &[&str]) -> PolyNarx {
    PolyNarx::parse(&["u"], "y", regressors).unwrap()
}

fn fitted(model: &PolyNarx, data: &[Experiment]) -> Vec<f64> {
    estimate::estimator("ols", &toml::Table::new())
        .unwrap()
        .estimate(model, data, None, &|| false)
        .unwrap()
        .theta
}

const LINEAR: [&str; 3] = ["1", "u(t-1)", "y(t-1)"];
const CURVED: [&str; 5] = ["1", "u(t-1)", "u(t-1)^2", "u(t-1)^3", "y(t-1)"];

/// Share of new blocks whose error passes the margin, over many campaigns, with its standard error.
fn observed(held_out: usize, rate: f64, seeds: u64) -> (f64, f64) {
    let model = structure(&LINEAR);
    let shares: Vec<f64> = (0..seeds)
        .map(|s| {
            let at = 1000 * (s + 1);
            let theta = fitted(&model, &[record(at, 300, 1.0)]);
            let scores =
                block_scores(&model, &theta, &[record(at + 1, 1 + held_out * BLOCK, 1.0)], BLOCK, None);
            assert_eq!(scores.len(), held_out);
            let q = margin(&scores, rate).unwrap();
            let new = block_scores(&model, &theta, &[record(at + 2, 1 + 40 * BLOCK, 1.0)], BLOCK, None);
            new.iter().filter(|s| **s > q.value).count() as f64 / new.len() as f64
        })
        .collect();
    let n = shares.len() as f64;
    let mean = shares.iter().sum::<f64>() / n;
    let variance = shares.iter().map(|s| (s - mean).powi(2)).sum::<f64>() / (n - 1.0);
    (mean, (variance / n).sqrt())
}

#[test]
fn the_observed_rate_of_violations_stays_below_the_stated_one() {
    for (held_out, rate) in [(3, 0.1), (8, 0.1), (20, 0.1), (40, 0.1), (25, 0.05), (6, 0.05)] {
        let (share, error) = observed(held_out, rate, 200);
        assert!(share <= rate + 2.0 * error, "{held_out} blocks, {rate}: {share} +- {error}");
        // And the quantile is not idle: with enough blocks it is used up to half.
        assert!(held_out < 20 || share > 0.4 * rate, "{held_out} blocks, {rate}: {share}");
    }
}

#[test]
fn the_margin_shrinks_with_the_error_and_with_the_number_of_blocks() {
    let schedule = Schedule { rate: 0.1, ..Default::default() };
    let (linear, curved) = (structure(&LINEAR), structure(&CURVED));
    let data = [record(1, 400, 1.0)];
    let (theta, theta_curved) = (fitted(&linear, &data), fitted(&curved, &data));
    let held = |n: usize| [record(2, 1 + n * BLOCK, 1.0)];
    let first = schedule.first(20.0);
    assert_eq!((first.value, first.basis), (0.2 * 20.0, Basis::Range));
    let few = schedule.next(&first, &block_scores(&linear, &theta, &held(4), BLOCK, None));
    let more = schedule.next(&few, &block_scores(&linear, &theta, &held(30), BLOCK, None));
    let better = schedule.next(&more, &block_scores(&curved, &theta_curved, &held(30), BLOCK, None));
    assert!(few.value < first.value && few.basis == Basis::FewBlocks, "{few:?}");
    assert!(more.value < few.value, "{few:?} {more:?}");
    // A much better model halves the margin at most: its errors are known where records have been.
    assert_eq!((better.value, better.basis), (0.5 * more.value, Basis::Kept));
    let mut last = better;
    for _ in 0..5 {
        last = schedule.next(&last, &block_scores(&curved, &theta_curved, &held(30), BLOCK, None));
    }
    assert!(last.basis == Basis::Quantile && last.value < 0.3, "{last:?}");
    // Errors that grow widen it at once, and without data nothing changes.
    assert_eq!(schedule.next(&last, &[5.0; 20]).value, 5.0);
    assert_eq!(schedule.next(&last, &[]), last);
}

/// Outside of what was identified no margin from inside keeps its promise; the distance widens it in the right
/// direction, and inside it changes nothing.
#[test]
fn the_distance_from_what_was_identified_widens_the_margin_outside_of_it() {
    let (rate, model) = (0.1, structure(&LINEAR));
    let passed = |size: f64, scaled: bool| {
        let mut count = 0;
        for s in 0..60 {
            let at = 7000 + 10 * s;
            let data = [record(at, 400, 1.0)];
            let theta = fitted(&model, &data);
            let boundary = learn(Space::of(&model), &data, &BoundaryKeys::default()).unwrap();
            let scores =
                |e: Experiment| block_scores(&model, &theta, &[e], BLOCK, scaled.then_some(&boundary));
            let q = margin(&scores(record(at + 1, 1 + 30 * BLOCK, 1.0)), rate).unwrap().value;
            count += scores(record(at + 2, 1 + 20 * BLOCK, size)).iter().filter(|s| **s > q).count();
        }
        count as f64 / 1200.0
    };
    assert!(passed(1.0, true) <= 1.3 * rate && passed(1.0, false) <= 1.3 * rate);
    let (scaled, plain) = (passed(1.6, true), passed(1.6, false));
    assert!(plain > 5.0 * rate && scaled < 0.9 * plain, "scaled {scaled}, unscaled {plain}");
}

#[test]
fn a_free_run_that_leaves_all_bounds_has_no_finite_margin() {
    let model = structure(&["y(t-1)", "u(t-1)"]);
    let e = record(3, 2000, 1.0);
    let scores = block_scores(&model, &[3.0, 1.0], &[e], BLOCK, None);
    assert_eq!(margin(&scores, 0.1).unwrap().value, f64::INFINITY);
}
